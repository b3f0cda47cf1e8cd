//! Reports of sensors in the form of `diagnostics` (REP-107).

use std::fmt::Display;
use std::time::Duration;

use downbeat_executor::{Context, Publication, Time};
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus, KeyValue};
use downbeat_msgs::std_msgs::msg::Header;

/// How often a status is published that does not change.
const PERIOD: Duration = Duration::from_secs(1);

/// Publishes the status of a sensor once a second, and when its level changes.
#[derive(Debug, Default)]
pub(crate) struct Reporter {
    last: Option<(Time, u8)>,
}

/// What a sensor reports beside the level.
pub(crate) struct Status {
    pub(crate) message: String,
    /// The device, for example "LD19 (emulated)".
    pub(crate) hardware_id: String,
    pub(crate) values: Vec<KeyValue>,
}

impl Reporter {
    /// Publishes what `status` returns, if that is due at this level.
    pub(crate) fn report<P>(
        &mut self,
        level: u8,
        topic: Publication<DiagnosticArray>,
        ctx: &mut Context<'_, P>,
        status: impl FnOnce() -> Status,
    ) {
        let now = ctx.now();
        if self.last.is_some_and(|(at, last)| now < at + PERIOD && last == level) {
            return;
        }
        self.last = Some((now, level));
        let Status { message, hardware_id, values } = status();
        let name = format!("{}: sensor", ctx.module_name());
        let status = vec![DiagnosticStatus { level, name, message, hardware_id, values }];
        ctx.publish(topic, DiagnosticArray { header: header(now, ""), status });
    }
}

/// What is wrong with a device, in words: logged once, and for the status.
#[derive(Debug, Default)]
pub(crate) struct Complaint(String);

impl Complaint {
    /// Replaces what is said, and logs it if it is something else.
    pub(crate) fn say<P>(&mut self, what: &str, ctx: &Context<'_, P>) {
        if self.0 != what && !what.is_empty() {
            tracing::warn!("{}: {what}", ctx.module_name());
        }
        what.clone_into(&mut self.0);
    }

    /// Nothing is wrong.
    pub(crate) fn clear(&mut self) {
        self.0.clear();
    }

    /// What was said last; empty if nothing is wrong.
    pub(crate) fn text(&self) -> &str {
        &self.0
    }
}

/// A value of a status.
pub(crate) fn value(key: &str, value: impl Display) -> KeyValue {
    KeyValue { key: key.to_owned(), value: value.to_string() }
}

/// A header with this stamp.
pub(crate) fn header(stamp: Time, frame_id: &str) -> Header {
    Header { stamp: Stamp::from_nanos(stamp.as_nanos()), frame_id: frame_id.to_owned() }
}
