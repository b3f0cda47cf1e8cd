//! A condition on topics at which a recording takes a snapshot.

use std::collections::BTreeSet;
use std::time::Duration;

use downbeat_bags::RecordingControl;
use downbeat_executor::Time;
use downbeat_msgs::dynamic::DynamicType;
#[cfg(feature = "state_machine")]
use downbeat_state_machine::Condition;

/// Evaluates a condition with each message of its topics, and asks for the snapshots.
#[cfg(feature = "state_machine")]
pub(crate) struct SnapshotCondition {
    condition: Condition,
    control: RecordingControl,
    after: Duration,
    /// Whether it cannot be evaluated, which was logged.
    is_broken: bool,
}

#[cfg(feature = "state_machine")]
impl SnapshotCondition {
    /// What an expression names as topics, with `_` for `/`.
    pub(crate) fn variables(expression: &str) -> Result<BTreeSet<String>, String> {
        Condition::variables(expression)
    }

    /// `types` are the topics that there are, without the leading slash. Snapshots go on for `after` their
    /// triggers. The error is a sentence.
    pub(crate) fn new<'a>(
        expression: &str,
        types: impl IntoIterator<Item = (&'a str, DynamicType)>,
        control: RecordingControl,
        after: Duration,
    ) -> Result<Self, String> {
        let condition = Condition::new(expression, types)?;
        Ok(Self { condition, control, after, is_broken: false })
    }

    pub(crate) fn topics(&self) -> impl Iterator<Item = &str> {
        self.condition.topics()
    }

    /// Takes a message of a topic.
    pub(crate) fn take(&mut self, topic: &str, time: Time, cdr: &[u8]) {
        self.condition.take(topic, time, cdr);
        match self.condition.becomes_true(time) {
            Ok(becomes_true) => {
                if becomes_true && self.control.snapshot_around(time.as_nanos(), self.after) {
                    tracing::info!("taking a snapshot: its condition became true");
                }
                self.is_broken = false;
            }
            Err(error) if !std::mem::replace(&mut self.is_broken, true) => {
                tracing::warn!("the condition of snapshots is not evaluated: {error}");
            }
            Err(_) => {}
        }
    }
}

/// There is none in this program.
#[cfg(not(feature = "state_machine"))]
pub(crate) enum SnapshotCondition {}

#[cfg(not(feature = "state_machine"))]
impl SnapshotCondition {
    pub(crate) fn variables(expression: &str) -> Result<BTreeSet<String>, String> {
        use crate::features::built_without;
        Err(format!("`{expression}` is not evaluated: this program is {}", built_without("state_machine")))
    }

    pub(crate) fn new<'a>(
        expression: &str,
        _: impl IntoIterator<Item = (&'a str, DynamicType)>,
        _: RecordingControl,
        _: Duration,
    ) -> Result<Self, String> {
        Err(Self::variables(expression).err().unwrap_or_default())
    }

    pub(crate) fn topics(&self) -> impl Iterator<Item = &str> {
        std::iter::empty()
    }

    pub(crate) fn take(&mut self, _: &str, _: Time, _: &[u8]) {
        match *self {}
    }
}
