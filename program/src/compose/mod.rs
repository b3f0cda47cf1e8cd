//! `downbeat compose`

mod child;
mod composer;
mod disk;
mod document;
mod picture;
mod templates;
#[cfg(test)]
mod tests;

use std::io::{BufRead, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use serde_json::{Value, json};

use crate::cli::ComposeArguments;
use crate::output::is_of_closed_terminal;
use crate::own_command::own_command;
use crate::stop::Stop;
use child::Runner;
use composer::Composer;
use downbeat_robot::Catalog;
use downbeat_view::{Ask, Host, PageOptions, ViewOptions, ViewServer};

pub(crate) fn compose(arguments: &ComposeArguments, catalog: &Catalog) -> anyhow::Result<()> {
    refuse_carried(&arguments.robot)?;
    let stop = Stop::new()?;
    let composer = Composer::open(&arguments.robot, catalog.clone(), runner()?)
        .with_context(|| format!("cannot open {}", arguments.robot.display()))?;
    let composer = Arc::new(composer);
    let result = match arguments.stdio {
        true => serve_lines(&composer, &stop),
        false => serve(&composer, arguments.port, &stop),
    };
    // Threads that answer questions may keep the composer itself.
    composer.stop_robot();
    result
}

/// Robots inside the program are read, not edited.
fn refuse_carried(robot: &Path) -> anyhow::Result<()> {
    let name = robot.to_str().filter(|name| !robot.exists() && downbeat_robots::find(name).is_some());
    match name {
        None => Ok(()),
        Some(name) => anyhow::bail!(
            "{name} is a robot inside this program, which cannot be edited: write it into a folder by `downbeat robots copy {name} \
             FOLDER`, then `downbeat compose FOLDER/{name}.toml`"
        ),
    }
}

/// This program, for robots.
fn runner() -> anyhow::Result<Runner> {
    let (program, arguments) = own_command("compose")?;
    Ok(Runner { program, arguments })
}

/// Answers questions of the page.
struct Editor(Arc<Composer>);

impl Host for Editor {
    fn answer(&self, ask: Ask<'_>) -> Option<Result<Value, String>> {
        Some(ask.check_access().and_then(|()| self.0.ask(ask.name, ask.arguments)))
    }
}

const LOOK: Duration = Duration::from_millis(250);

fn serve(composer: &Arc<Composer>, port: Option<u16>, stop: &Stop) -> anyhow::Result<()> {
    let path = composer.path().display().to_string();
    let host: Arc<dyn Host> = Arc::new(Editor(Arc::clone(composer)));
    let page = PageOptions { port, start: "compose.html", host: Some(host), ..PageOptions::default() };
    let options = ViewOptions { foxglove: None, page: Some(page), ..ViewOptions::new("compose")? };
    let server = ViewServer::start_page(options)?;
    println!("{path}");
    println!("open in a browser: {}", server.page_url().unwrap_or_default());
    while !stop.is_due() {
        stop.sleep(LOOK);
    }
    Ok(())
}

/// Answers lines until standard input ends.
fn serve_lines(composer: &Arc<Composer>, stop: &Stop) -> anyhow::Result<()> {
    let of_thread = Arc::clone(composer);
    let thread = std::thread::Builder::new().name("lines".to_owned());
    let thread = thread.spawn(move || answer_lines(&of_thread)).context("cannot start a thread")?;
    while !stop.is_due() && !thread.is_finished() {
        stop.sleep(LOOK);
    }
    // Otherwise it waits for a line until the process ends.
    let ended = thread.is_finished().then(|| thread.join());
    ended.map_or(Ok(()), |answered| answered.unwrap_or_else(|_| anyhow::bail!("answering a line panicked")))
}

/// Answers `{"id": …, "ask": …, …}` by `{"id": …, "ok": …}` or `{"id": …, "error": …}`, in the order of the
/// questions.
fn answer_lines(composer: &Composer) -> anyhow::Result<()> {
    for line in std::io::stdin().lock().lines() {
        let line = match line {
            // The terminal was closed.
            Err(error) if is_of_closed_terminal(&error) => break,
            line => line.context("cannot read standard input")?,
        };
        let answer = match serde_json::from_str::<Value>(&line) {
            Err(error) => json!({ "id": null, "error": format!("this is no JSON: {error}") }),
            Ok(question) => {
                let answer = composer.ask(question["ask"].as_str().unwrap_or_default(), &question);
                match answer {
                    Ok(ok) => json!({ "id": question["id"], "ok": ok }),
                    Err(error) => json!({ "id": question["id"], "error": error }),
                }
            }
        };
        writeln!(std::io::stdout().lock(), "{answer}").context("cannot write standard output")?;
    }
    Ok(())
}
