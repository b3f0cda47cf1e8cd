//! The debugger on a terminal: a line for each command.

use std::io::{BufRead, IsTerminal, Write};

use super::protocol::{Cycle, Messages, Run};
use anyhow::Context;

use super::travel::Travel;
use super::why::why;
use super::words::{Command, Goal, HELP};
use crate::stop::Stop;

/// Runs the replay once, and says how it went.
pub(super) fn pass(travel: &mut Travel) -> anyhow::Result<()> {
    let stop = Stop::new()?;
    let progress = indicatif::ProgressBar::new(travel.about().cycles.unwrap_or(0));
    if let Some(reason) = &travel.about().no_checkpoints {
        tracing::warn!("{reason}");
    }
    travel.pass(|cycles| {
        progress.set_position(cycles);
        !stop.is_due()
    })?;
    progress.finish_and_clear();
    println!("{} cycles of {}", travel.index.end(), travel.about().robot);
    let count = travel.about().notes.len();
    if count > 0 {
        println!("{count} notes on what differs from the recorded run: `notes` lists them");
    }
    match &travel.index.difference {
        Some((_, difference)) => {
            println!("first difference: {}\n`go difference` goes there", difference.trim())
        }
        None => println!("no difference from the bag"),
    }
    travel.go_to(&Goal::Start)
}

/// Runs these commands, then those of the standard input.
pub(super) fn run(travel: &mut Travel, commands: &[String]) -> anyhow::Result<()> {
    let stop = Stop::new()?;
    pass(travel)?;
    show(travel)?;
    let mut last = None;
    let given = commands.iter().map(|line| Ok(line.clone()));
    let is_terminal = std::io::stdin().is_terminal();
    let typed = std::iter::from_fn(|| {
        if is_terminal {
            print!("> ");
            // Nothing is lost if it is not shown.
            let _ = std::io::stdout().flush();
        }
        let mut line = String::new();
        match std::io::stdin().lock().read_line(&mut line) {
            Ok(0) => None,
            Ok(_) => Some(Ok(line)),
            Err(error) => Some(Err(error)),
        }
    });
    for line in given.chain(typed) {
        let line = line?;
        if stop.is_due() {
            break;
        }
        let command = match (line.trim(), last.take()) {
            ("", None) => continue,
            ("", Some(command)) => command,
            (line, _) => match Command::parse(line) {
                Ok(command) => command,
                Err(problem) => {
                    println!("{problem}");
                    continue;
                }
            },
        };
        if command == Command::Quit {
            break;
        }
        if let Err(problem) = obey(travel, &command) {
            println!("{problem:#}");
        }
        last = Some(command);
    }
    Ok(())
}

fn obey(travel: &mut Travel, command: &Command) -> anyhow::Result<()> {
    match command {
        Command::Go(goal) => {
            travel.go_to(goal)?;
            show(travel)?;
        }
        Command::Print(topic) => match travel.message(topic)? {
            Some(message) => {
                println!("{} #{}, {}", message.topic, message.number, message.type_name);
                println!("{}", message.yaml.trim_end());
            }
            None => println!("{}", travel.no_message(topic)),
        },
        Command::Why { topic, number } => {
            let number = match number {
                Some(number) => *number,
                None => travel.message(topic)?.with_context(|| travel.no_message(topic))?.number,
            };
            print!("{}", why(travel, topic, number)?.text());
        }
        Command::Module(name) => {
            let module = travel.module(name)?;
            let Some(settings) = module.settings else {
                println!("{}", travel.no_module(name));
                return Ok(());
            };
            for (name, value) in settings {
                println!("  {name}: {value}");
            }
            match module.state {
                Some(state) => println!("{state}"),
                None => println!(
                    "  it shows nothing of itself: `debug` of the trait Module does, `variables` in C and C++"
                ),
            }
        }
        Command::List => {
            for module in travel.index.modules() {
                println!("  {module}");
            }
            for (topic, count) in travel.index.topics() {
                println!("  {topic}: {count} messages");
            }
        }
        Command::Notes => travel.about().notes.iter().for_each(|note| println!("  {note}")),
        Command::Help => print!("{HELP}"),
        Command::Quit => {}
    }
    Ok(())
}

fn show(travel: &mut Travel) -> anyhow::Result<()> {
    let cycle = travel.cycle()?;
    print!("{}", text_of(&cycle, travel.about().start_ns));
    Ok(())
}

/// What happened in a cycle, in lines.
fn text_of(cycle: &Cycle, start_ns: i64) -> String {
    let seconds = (cycle.time_ns - start_ns) as f64 / 1e9;
    let mut text = format!("cycle #{}, {seconds:.6} s into the bag ({})\n", cycle.cycle, cycle.time_ns);
    for messages in &cycle.given {
        text += &format!("  from the bag: {}\n", messages.name());
    }
    let width = cycle.runs.iter().map(|run| run.module.len()).max().unwrap_or(0);
    for Run { module, causes, step, received, published, got, gave } in &cycle.runs {
        let causes = match causes.as_slice() {
            [] => "messages".to_owned(),
            causes => causes.join(", "),
        };
        let step = step.map(|step| format!(" (run {step})")).unwrap_or_default();
        let list = |title: &str, messages: &[Messages]| match messages {
            [] => String::new(),
            messages => {
                format!("; {title} {}", messages.iter().map(Messages::name).collect::<Vec<_>>().join(", "))
            }
        };
        let (received, published) = (list("received", received), list("published", published));
        text += &format!("  {module:width$}  {causes}{step}{received}{published}\n");
        for event in got.iter().map(|got| &got.event).chain(gave) {
            text += &format!("  {:width$}    {event}\n", "");
        }
    }
    for event in &cycle.events {
        text += &format!("  {event}\n");
    }
    if let Some(difference) = &cycle.difference {
        let lines = difference.trim().lines().map(str::trim).collect::<Vec<_>>().join(" ");
        text += &format!("  differs from the bag since {lines}\n");
    }
    text
}
