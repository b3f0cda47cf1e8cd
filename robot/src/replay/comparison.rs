//! Compares the messages of replayed modules with those in the bag.

use std::collections::{BTreeMap, VecDeque};
use std::iter::Peekable;
use std::ops::ControlFlow;
use std::sync::Arc;

use bytes::Bytes;
use downbeat_bags::{BagMessage, Comparer, FieldRule, Messages, Reader, Selection, TopicId};
use downbeat_edge::Interfaces;

use super::plan::Plan;
use super::report::{Difference, TopicReport, What};
use crate::encoding::RecordedType;
use crate::playback::PlaybackError;
use crate::playback::journals::Cycles;

/// The comparisons of all topics. The bag is read only as far as the replay has advanced.
pub(super) struct Comparisons {
    /// The recorded messages; `None` while the inputs of the replay read them, and pass them on.
    messages: Option<Peekable<Messages>>,
    topics: BTreeMap<TopicId, Comparison>,
    by_name: BTreeMap<String, TopicId>,
    /// See [`Cycles::begin`].
    begin: Option<i64>,
    /// The first problem with the bag; reported at the end.
    failure: Option<PlaybackError>,
}

struct Comparison {
    report: TopicReport,
    recorded_type: RecordedType,
    comparer: Comparer,
    is_shared: bool,
    is_attached: bool,
    /// Until this time messages must be published at the recorded times.
    times_until: i64,
    /// Messages without a counterpart from this time on are not a difference: the robot was stopping, or the
    /// recording was interrupted.
    open_from: i64,
    recorded: VecDeque<(i64, Bytes)>,
    replayed: VecDeque<(i64, Bytes)>,
    /// Where the messages of another module begin in `replayed`.
    starts: Vec<usize>,
}

/// How many messages ahead a message is searched for on a topic that other modules publish as well.
const WINDOW: usize = 1000;

/// A message that a replayed module published.
pub(super) struct Replayed {
    /// Without the leading slash.
    pub(super) topic: Arc<str>,
    /// The time of the cycle that published it.
    pub(super) time: i64,
    pub(super) cdr: Bytes,
}

impl Comparisons {
    pub(super) fn new(
        reader: &Reader,
        plan: &Plan,
        rules: &[FieldRule],
        interfaces: &Interfaces,
    ) -> Result<Self, PlaybackError> {
        let (mut topics, mut by_name) = (BTreeMap::new(), BTreeMap::new());
        let last_cycle = match &plan.cycles {
            Cycles::Recorded { times, .. } => times.last().copied().unwrap_or(i64::MIN),
            Cycles::OfMessages => i64::MAX,
            Cycles::Unknown => i64::MIN,
        };
        for (name, output) in &plan.outputs {
            let Some(id) = reader.topic(&format!("/{name}")) else { continue };
            let recorded = &reader.topics()[id.index()];
            let comparer = Comparer::new(&recorded.info, rules);
            let is_attached = output.modules.iter().any(|name| plan.attached.contains(name));
            let has_times = is_attached && !output.is_shared;
            topics.insert(
                id,
                Comparison {
                    report: TopicReport {
                        topic: recorded.info.name.clone(),
                        modules: output.modules.clone(),
                        is_ignored: comparer.ignores_all(),
                        compared: 0,
                        different: 0,
                        first: None,
                    },
                    recorded_type: RecordedType::of(recorded, interfaces)?,
                    comparer,
                    is_shared: output.is_shared,
                    is_attached,
                    times_until: if has_times { last_cycle } else { i64::MIN },
                    open_from: i64::MAX,
                    recorded: VecDeque::new(),
                    replayed: VecDeque::new(),
                    starts: Vec::new(),
                },
            );
            by_name.insert(name.clone(), id);
        }
        // Each detached module advances through the whole bag, before the inputs of the others do.
        let messages = match plan.detached.is_empty() {
            true => None,
            false => Some(reader.messages(Selection::all().topics(topics.keys().copied()))?.peekable()),
        };
        Ok(Self { messages, topics, by_name, begin: plan.cycles.begin(), failure: None })
    }

    /// The topics whose recorded messages have to be [passed on](Self::recorded).
    pub(super) fn fed_topics(&self) -> Vec<TopicId> {
        if self.messages.is_some() { Vec::new() } else { self.topics.keys().copied().collect() }
    }

    /// Reads the remaining messages from there.
    pub(super) fn read_from(&mut self, rest: Option<Peekable<Messages>>) {
        self.messages = self.messages.take().or(rest);
    }

    /// The messages from now on come from other modules than those before.
    pub(super) fn next_modules(&mut self) {
        self.topics.values_mut().for_each(|topic| topic.starts.push(topic.replayed.len()));
    }

    /// Adds a replayed message.
    pub(super) fn replayed(&mut self, replayed: Replayed) {
        let Some(id) = self.by_name.get(&*replayed.topic).copied() else { return };
        let Some(topic) = self.topics.get_mut(&id) else { return };
        if self.begin.is_some_and(|begin| replayed.time <= begin) {
            return;
        }
        topic.replayed.push_back((replayed.time, replayed.cdr));
        if topic.is_shared {
            return;
        }
        while self.topics.get(&id).is_some_and(|topic| topic.recorded.is_empty()) {
            if self.read_next().is_break() {
                return;
            }
        }
        if let Some(topic) = self.topics.get_mut(&id) {
            topic.compare_in_order();
        }
    }

    /// Excludes messages of the modules inside the cycle from `time` on from the comparison.
    pub(super) fn end_before(&mut self, time: i64) {
        for topic in self.topics.values_mut().filter(|topic| topic.is_attached) {
            topic.open_from = topic.open_from.min(time);
        }
    }

    /// The recording was interrupted: the bag may lack the last messages of the module, or the runs that
    /// published them.
    pub(super) fn interrupted(&mut self, module: &str) {
        for topic in self.topics.values_mut() {
            if topic.report.modules.iter().any(|name| name == module) {
                topic.open_from = i64::MIN;
            }
        }
    }

    /// The first difference so far on topics whose messages come from one module.
    pub(super) fn first_difference(&self) -> Option<&Difference> {
        let differences = self.topics.values().filter_map(|topic| topic.report.first.as_ref());
        differences.min_by_key(|difference| difference.time)
    }

    /// Compares the remaining messages.
    pub(super) fn finish(mut self) -> Result<Vec<TopicReport>, PlaybackError> {
        while self.read_next().is_continue() {}
        if let Some(failure) = self.failure {
            return Err(failure);
        }
        let topics = self.topics.into_values().map(|mut topic| {
            if topic.is_shared {
                topic.compare_in_any_order();
            } else {
                topic.compare_in_order();
                topic.compare_rest();
            }
            topic.report
        });
        Ok(topics.collect())
    }

    fn read_next(&mut self) -> ControlFlow<()> {
        match self.messages.as_mut().and_then(Iterator::next) {
            None => return ControlFlow::Break(()),
            Some(Ok(message)) => self.recorded(message),
            Some(Err(error)) => drop(self.failure.get_or_insert(error.into())),
        }
        ControlFlow::Continue(())
    }

    /// Adds a recorded message.
    pub(super) fn recorded(&mut self, message: BagMessage) {
        let Some(topic) = self.topics.get_mut(&message.topic) else { return };
        if self.begin.is_some_and(|begin| message.log_time <= begin) {
            return;
        }
        match topic.recorded_type.to_cdr(message.data) {
            Ok(cdr) => topic.recorded.push_back((message.log_time, cdr)),
            Err(error) => drop(self.failure.get_or_insert(error.into())),
        }
        if !topic.is_shared {
            topic.compare_in_order();
        }
    }
}

impl Comparison {
    fn compare_in_order(&mut self) {
        while !self.recorded.is_empty() && !self.replayed.is_empty() {
            let (Some((recorded_time, recorded)), Some((replayed_time, replayed))) =
                (self.recorded.pop_front(), self.replayed.pop_front())
            else {
                return;
            };
            let is_late = recorded_time <= self.times_until && recorded_time != replayed_time;
            let what = match self.comparer.compare(&recorded, &replayed) {
                Some(field) => Some(What::Field(field)),
                None if is_late && !self.report.is_ignored => Some(What::Time { replayed: replayed_time }),
                None => None,
            };
            self.note(recorded_time, what);
        }
    }

    /// Reports the remaining messages if one of the two sides is empty.
    fn compare_rest(&mut self) {
        for (time, _) in std::mem::take(&mut self.recorded) {
            if time < self.open_from && !self.report.is_ignored {
                self.note(time, Some(What::Missing));
            }
        }
        for (time, _) in std::mem::take(&mut self.replayed) {
            if time < self.open_from && !self.report.is_ignored {
                self.note(time, Some(What::Extra));
            }
        }
    }

    /// Each replayed message must be among the recorded ones, those of a module in the same order; other
    /// messages may be between them.
    fn compare_in_any_order(&mut self) {
        let starts = std::mem::take(&mut self.starts);
        // Recorded messages that were found.
        let mut is_found = vec![false; self.recorded.len()];
        let mut from = 0;
        for (number, (time, replayed)) in std::mem::take(&mut self.replayed).into_iter().enumerate() {
            if starts.contains(&number) {
                // Detached modules are replayed one after the other.
                from = 0;
            }
            let is_left = |(index, _): &(usize, _)| !is_found.get(*index).copied().unwrap_or(false);
            let ahead = || self.recorded.iter().enumerate().skip(from).filter(is_left).take(WINDOW);
            let same =
                ahead().find(|(_, (_, recorded))| self.comparer.compare(recorded, &replayed).is_none());
            if let Some((index, _)) = same {
                from = index + 1;
                if let Some(is_found) = is_found.get_mut(index) {
                    *is_found = true;
                }
                self.note(time, None);
                continue;
            }
            let nearest =
                ahead().map(|(_, message)| message).min_by_key(|(recorded, _)| recorded.abs_diff(time));
            let difference =
                nearest.and_then(|(at, recorded)| Some((*at, self.comparer.compare(recorded, &replayed)?)));
            match difference {
                Some((at, field)) => self.note(at, Some(What::Field(field))),
                None if time < self.open_from => self.note(time, Some(What::Extra)),
                None => {}
            }
        }
    }

    fn note(&mut self, time: i64, what: Option<What>) {
        let number = self.report.compared;
        self.report.compared += 1;
        let Some(what) = what else { return };
        self.report.different += 1;
        let topic = &self.report.topic;
        self.report.first.get_or_insert_with(|| Difference { topic: topic.clone(), number, time, what });
    }
}
