//! The debugger in a browser: a panel beside those of a recorded bag, which show the time at which the replay
//! stands.

use std::sync::Arc;
use std::time::Duration;

use downbeat_bags::{Rate, Reader, Selection};
use downbeat_msgs::dynamic::YamlStyle;
use downbeat_robot::Catalog;
use downbeat_robot::table::Decoder;
use downbeat_view::{
    Access, Ask, BagPlayback, Host, PageOptions, Panel, PanelScript, ViewOptions, ViewServer,
};
use parking_lot::Mutex;
use serde_json::{Value, json};

use super::travel::Travel;
use super::why::why;
use super::words::{Command, HELP};
use crate::bag::view::Asks;
use crate::stop::Stop;

/// The most messages of a topic that are listed, and the longest text of one.
const MOST_LISTED: usize = 500;
const LONGEST: usize = 100;

/// The time before a cycle whose rates its graph shows.
const RATES_OVER: Duration = Duration::from_secs(2);

/// Shows the replay until the program is stopped.
pub(super) fn show(travel: Travel, bag: Reader, port: Option<u16>, catalog: &Catalog) -> anyhow::Result<()> {
    let name = bag.path().file_name().unwrap_or_default().to_string_lossy().into_owned();
    let bags: Arc<[Reader]> = [bag].into();
    let host = Debugger {
        travel: Mutex::new(travel),
        bag: Asks { bags: Arc::clone(&bags), interfaces: catalog.interfaces.clone() },
    };
    let panel = Panel {
        name: "debug".to_owned(),
        title: "Debug".to_owned(),
        module: String::new(),
        script: PanelScript::Text(include_str!("debug.panel.js").into()),
        topics: Vec::new(),
    };
    let options = ViewOptions {
        page: Some(PageOptions {
            port,
            host: Some(Arc::new(host)),
            panels: vec![panel],
            ..PageOptions::default()
        }),
        foxglove: None,
        access: Access::ReadOnly,
        ..ViewOptions::new(&name)?
    };
    let playback = BagPlayback {
        rate: Rate::new(1.0)?,
        start_offset: Duration::ZERO,
        repeats: false,
        starts_paused: true,
    };
    let stop = Stop::new()?;
    let server = ViewServer::show_bags(bags, &catalog.interfaces, playback, options)?;
    if let Some(url) = server.page_url() {
        println!("open in a browser: {url}");
    }
    while !stop.is_due() {
        stop.sleep(Duration::from_secs(1));
    }
    Ok(())
}

/// Answers what the panel asks.
struct Debugger {
    travel: Mutex<Travel>,
    bag: Asks,
}

impl Host for Debugger {
    fn answer(&self, ask: Ask<'_>) -> Option<Result<Value, String>> {
        let answer = match ask.name {
            "debug" => self.about(),
            "graph" => self.graph(),
            "snapshot" => self.snapshot(),
            "debug_command" => {
                ask.require_text("line").map_err(anyhow::Error::msg).and_then(|line| self.obey(line))
            }
            "debug_messages" => {
                ask.require_text("topic").map_err(anyhow::Error::msg).and_then(|topic| self.messages(topic))
            }
            _ => return self.bag.answer(ask),
        };
        Some(answer.map_err(|error| format!("{error:#}")))
    }
}

impl Debugger {
    fn about(&self) -> anyhow::Result<Value> {
        let mut travel = self.travel.lock();
        let cycle = travel.cycle()?;
        let index = &travel.index;
        Ok(json!({
            "about": travel.about(),
            "modules": index.modules().collect::<Vec<_>>(),
            "topics": index.topics().collect::<Vec<_>>(),
            "cycles": index.end(),
            "difference": index.difference.as_ref().map(|(_, difference)| difference),
            "help": HELP,
            "cycle": cycle,
        }))
    }

    fn graph(&self) -> anyhow::Result<Value> {
        Ok(serde_json::to_value(self.travel.lock().graph()?)?)
    }

    /// What was counted up to here, and some time before, of which the page computes rates.
    fn snapshot(&self) -> anyhow::Result<Value> {
        let [before, now] = self.travel.lock().snapshots(RATES_OVER)?;
        let mut snapshot = serde_json::to_value(now)?;
        snapshot["before"] = serde_json::to_value(before)?;
        Ok(snapshot)
    }

    /// Carries out a line as on a terminal, and answers with what it shows.
    fn obey(&self, line: &str) -> anyhow::Result<Value> {
        let mut travel = self.travel.lock();
        Ok(match Command::parse(line).map_err(anyhow::Error::msg)? {
            Command::Go(goal) => {
                travel.go_to(&goal)?;
                json!({ "cycle": travel.cycle()? })
            }
            Command::Print(topic) => match travel.message(&topic)? {
                Some(message) => json!({ "message": message }),
                None => anyhow::bail!(travel.no_message(&topic)),
            },
            Command::Module(name) => match travel.module(&name)? {
                module if module.settings.is_some() => json!({ "module": module }),
                _ => anyhow::bail!(travel.no_module(&name)),
            },
            Command::Why { topic, number } => {
                let number = match number {
                    Some(number) => number,
                    None => match travel.message(&topic)? {
                        Some(message) => message.number,
                        None => anyhow::bail!(travel.no_message(&topic)),
                    },
                };
                json!({ "why": why(&mut travel, &topic, number)? })
            }
            Command::List | Command::Notes | Command::Help | Command::Quit => {
                anyhow::bail!("\"{line}\" is for terminals")
            }
        })
    }

    /// The recorded messages of a topic in short.
    fn messages(&self, topic: &str) -> anyhow::Result<Value> {
        let bag = &self.bag.bags[0];
        let Some(id) = bag.topic(topic) else { anyhow::bail!("the bag has no topic {topic}") };
        let decoder = Decoder::of(&bag.topics()[id.index()], &self.bag.interfaces)?;
        let style = YamlStyle { flow_style: true, truncate_length: Some(8), ..YamlStyle::default() };
        let mut listed = Vec::new();
        for message in bag.messages(Selection::all().topics([id]))?.take(MOST_LISTED) {
            let message = message?;
            let content = decoder.decode(message.data)?;
            let text = content.as_message().to_yaml(&style);
            let text = text.lines().map(str::trim).collect::<Vec<_>>().join(" ");
            let text: String = text.chars().take(LONGEST).collect();
            listed.push(json!({ "time_ns": message.log_time, "text": text }));
        }
        Ok(json!({ "messages": listed, "is_cut": listed.len() == MOST_LISTED }))
    }
}
