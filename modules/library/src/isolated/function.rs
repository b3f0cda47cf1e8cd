//! The functions of a library, in words for reports.

use super::wire::ask;
use downbeat_edge::foreign::Event;
use downbeat_executor::Transition;
use std::collections::BTreeMap;

/// A function of a library, and what it is called for. Numbers are those of the module's declarations.
#[derive(Clone, Copy, Debug)]
pub(super) enum Function {
    Create,
    Setup,
    Message(u32),
    Request(u32),
    Reply(u32),
    Setting(u32),
    Timer(u32),
    Task(u32),
    EachRun,
    Transition(Transition),
    Accept(u32),
    Save,
    Restore,
    Variables,
}

/// What has a name in a module.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Declared {
    Subscription,
    Server,
    Client,
    Setting,
}

/// The topics, services and settings that a module has declared.
pub(super) type Names = BTreeMap<(Declared, u32), String>;

impl Declared {
    /// What a question of a child declares.
    pub fn of(tag: u8) -> Option<Self> {
        match tag {
            ask::SUBSCRIPTION => Some(Self::Subscription),
            ask::SERVER => Some(Self::Server),
            ask::CLIENT => Some(Self::Client),
            ask::SETTING => Some(Self::Setting),
            _ => None,
        }
    }
}

impl Function {
    /// The function that takes an event.
    pub fn handling(event: &Event) -> Self {
        match *event {
            Event::Message { subscription, .. } => Self::Message(subscription),
            Event::Request { server, .. } => Self::Request(server),
            Event::Reply { client, .. } => Self::Reply(client),
            Event::Setting { setting } => Self::Setting(setting),
            Event::Timer { timer } => Self::Timer(timer),
            Event::Task { task } => Self::Task(task),
            Event::EachRun => Self::EachRun,
        }
    }

    /// Its name in the interface, and what it was called for.
    pub fn words(self, names: &Names) -> String {
        let named = |declared, number: u32| match names.get(&(declared, number)) {
            Some(name) => format!("\"{name}\""),
            None => number.to_string(),
        };
        match self {
            Self::Create => "`create`".to_owned(),
            Self::Setup => "`setup`".to_owned(),
            Self::Message(number) => {
                format!("`handle` for a message of {}", named(Declared::Subscription, number))
            }
            Self::Request(number) => format!("`handle` for a request of {}", named(Declared::Server, number)),
            Self::Reply(number) => format!("`handle` for a reply of {}", named(Declared::Client, number)),
            Self::Setting(number) => {
                format!("`handle` for a value of {}", named(Declared::Setting, number))
            }
            Self::Timer(number) => format!("`handle` for timer {number}"),
            Self::Task(number) => format!("`handle` for task {number}"),
            Self::EachRun => "`handle` for the end of a run".to_owned(),
            Self::Transition(transition) => format!("`{transition}`"),
            Self::Accept(number) => format!("`accept` for {}", named(Declared::Setting, number)),
            Self::Save => "`save`".to_owned(),
            Self::Restore => "`restore`".to_owned(),
            Self::Variables => "`variables`".to_owned(),
        }
    }
}
