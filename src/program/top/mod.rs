//! `downbeat top`

mod app;
mod grid;

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use crate::executor::Snapshot;
use crate::inspect::Client;
use anyhow::{Context, bail};
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event, KeyEventKind};

use super::choose::choose;
use super::cli::TopArguments;
use app::{Action, App};
use grid::{Grid, Sort, summary};

const REFRESH: Duration = Duration::from_millis(500);

pub(crate) fn top(arguments: &TopArguments) -> anyhow::Result<()> {
    let mut client = Client::connect(&choose(arguments.robot.as_deref())?)?;
    let snapshot = client.snapshot()?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&snapshot)?);
        return Ok(());
    }
    if arguments.once {
        print_once(&client, &snapshot);
        return Ok(());
    }
    if !std::io::stdout().is_terminal() {
        bail!("standard output is no terminal; --once prints what there is to see, --json all numbers");
    }
    let app = App::new(client.robot().to_string(), snapshot);
    let mut terminal = ratatui::try_init().context("cannot use this terminal")?;
    let outcome = show(&mut terminal, client, app);
    ratatui::restore();
    outcome
}

/// Rates are those since the robot's start.
fn print_once(client: &Client, snapshot: &Snapshot) {
    let start = Snapshot::default();
    for line in summary(&client.robot().to_string(), &start, snapshot) {
        println!("{line}");
    }
    let (modules, topics) = (Grid::of_modules, Grid::of_topics);
    for grid in [modules(&start, snapshot, Sort::Order), topics(&start, snapshot, Sort::Order)] {
        println!();
        grid.lines().for_each(|line| println!("{line}"));
    }
}

fn show(terminal: &mut DefaultTerminal, mut client: Client, mut app: App) -> anyhow::Result<()> {
    let mut next_update = Instant::now() + REFRESH;
    loop {
        terminal.draw(|frame| app.draw(frame)).context("cannot draw on the terminal")?;
        let rest = next_update.saturating_duration_since(Instant::now());
        if event::poll(rest).context("cannot read from the terminal")? {
            let action = match event::read().context("cannot read from the terminal")? {
                Event::Key(key) if key.kind != KeyEventKind::Release => app.press(key),
                _ => None,
            };
            match action {
                Some(Action::Quit) => return Ok(()),
                Some(Action::Pause) => client.pause()?,
                Some(Action::Resume) => client.resume()?,
                Some(Action::Step) => client.step()?,
                // Nothing to ask of the robot: the screen changes, the numbers stay.
                None => continue,
            }
        }
        app.update(client.snapshot()?);
        next_update = Instant::now() + REFRESH;
    }
}
