//! Compares requests and responses of replayed modules with the recorded ones.

use std::collections::BTreeMap;

use downbeat_bags::{Comparer, FieldDifference, FieldRule, TopicDescription};
use downbeat_msgs::downbeat_interfaces::msg::ModuleEvent;

use super::plan::Plan;
use super::report::{Difference, TopicReport, What};

/// The calls of all services of replayed modules.
#[derive(Default)]
pub(super) struct Calls(BTreeMap<Row, Both>);

/// The messages of one module to one service, in order.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord)]
enum Row {
    Requests { service: String, client: String },
    Answers { service: String, server: String },
}

#[derive(Default)]
struct Both {
    recorded: Vec<Sent>,
    replayed: Vec<Sent>,
    /// The recording was interrupted: calls without a counterpart at its end are not a difference.
    is_open: bool,
}

struct Sent {
    /// Time of the cycle in which it joined, nanoseconds since the epoch.
    time: i64,
    outcome: String,
    /// `None` for a request that no server received.
    data: Option<Vec<u8>>,
}

impl Calls {
    pub(super) fn recorded(&mut self, plan: &Plan, events: &[ModuleEvent]) {
        for event in events {
            if let Some((row, sent)) = sent(plan, event, |module| plan.replays(module)) {
                self.0.entry(row).or_default().recorded.push(sent);
            }
        }
    }

    /// Adds an event of a core with these modules.
    pub(super) fn replayed(&mut self, plan: &Plan, event: &ModuleEvent, is_there: impl Fn(&str) -> bool) {
        if let Some((row, sent)) = sent(plan, event, is_there) {
            self.0.entry(row).or_default().replayed.push(sent);
        }
    }

    pub(super) fn interrupted(&mut self, module: &str) {
        for (row, both) in &mut self.0 {
            both.is_open |= row.module() == module;
        }
    }

    pub(super) fn finish(self, plan: &Plan, rules: &[FieldRule]) -> Vec<TopicReport> {
        let end = plan.cycles.end();
        self.0.into_iter().map(|(row, both)| both.compare(&row, plan, rules, end)).collect()
    }
}

impl Row {
    fn module(&self) -> &str {
        let (Self::Requests { client: module, .. } | Self::Answers { server: module, .. }) = self;
        module
    }
}

fn sent(plan: &Plan, event: &ModuleEvent, is_there: impl Fn(&str) -> bool) -> Option<(Row, Sent)> {
    let (service, time) = (event.service.clone(), event.stamp.as_nanos());
    if plan.cycles.begin().is_some_and(|begin| time <= begin) {
        return None;
    }
    let request = |data| {
        let row = Row::Requests { service: service.clone(), client: event.module.clone() };
        is_there(&event.module).then(|| (row, Sent { time, outcome: "sent".to_owned(), data }))
    };
    match event.kind {
        ModuleEvent::REQUEST => request(Some(event.data.clone())),
        ModuleEvent::ANSWER if event.outcome == ModuleEvent::NO_SERVER => request(None),
        ModuleEvent::ANSWER => {
            let server = plan.servers.get(&event.service).filter(|server| is_there(server))?;
            let row = Row::Answers { service: service.clone(), server: server.clone() };
            let outcome = match event.outcome {
                ModuleEvent::ANSWERED => "answered".to_owned(),
                ModuleEvent::REFUSED => format!("refused: {}", event.reason),
                _ => format!("{} does not run", event.reason),
            };
            Some((row, Sent { time, outcome, data: Some(event.data.clone()) }))
        }
        _ => None,
    }
}

impl Both {
    fn compare(self, row: &Row, plan: &Plan, rules: &[FieldRule], end: i64) -> TopicReport {
        let (service, topic, part) = match row {
            Row::Requests { service, client } => {
                (service, format!("/{service} requests of {client}"), "Request")
            }
            Row::Answers { service, .. } => (service, format!("/{service} answers"), "Response"),
        };
        let type_name = plan.service_types.get(service).map(|name| format!("{name}_{part}"));
        let info = TopicDescription {
            name: format!("/{service}"),
            type_name: type_name.unwrap_or_default(),
            ..TopicDescription::default()
        };
        let comparer = Comparer::new(&info, rules);
        let is_attached = plan.attached.iter().any(|name| name == row.module());
        let mut report = TopicReport {
            topic,
            modules: vec![row.module().to_owned()],
            is_ignored: comparer.ignores_all(),
            compared: 0,
            different: 0,
            first: None,
        };
        let mut note = |time: i64, what: Option<What>| {
            let number = report.compared;
            report.compared += 1;
            let Some(what) = what.filter(|_| !report.is_ignored) else { return };
            report.different += 1;
            let topic = report.topic.clone();
            report.first.get_or_insert(Difference { topic, number, time, what });
        };
        // Calls that joined while the robot stopped are not compared.
        let (mut recorded, mut replayed) = (self.recorded.into_iter(), self.replayed.into_iter());
        let is_before_end = |sent: &Sent| sent.time < end;
        loop {
            match (recorded.next(), replayed.next()) {
                (Some(one), Some(other)) if is_before_end(&one) || !is_attached => {
                    let what = difference(&one, &other, &comparer);
                    let is_late = is_attached && plan.cycles.is_recorded() && one.time != other.time;
                    note(one.time, what.or(is_late.then_some(What::Time { replayed: other.time })));
                }
                (Some(one), None) if is_before_end(&one) && !self.is_open => {
                    note(one.time, Some(What::Missing))
                }
                (None, Some(other)) if is_before_end(&other) && !self.is_open => {
                    note(other.time, Some(What::Extra))
                }
                (None, None) => break,
                _ => {}
            }
        }
        report
    }
}

fn difference(recorded: &Sent, replayed: &Sent, comparer: &Comparer) -> Option<What> {
    let (Some(one), Some(other)) = (&recorded.data, &replayed.data) else { return None };
    if recorded.outcome != replayed.outcome {
        let (first, second) = (recorded.outcome.clone(), replayed.outcome.clone());
        return Some(What::Field(FieldDifference { path: "outcome".to_owned(), first, second }));
    }
    comparer.compare(one, other).map(What::Field)
}
