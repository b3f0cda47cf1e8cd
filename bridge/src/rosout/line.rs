//! A line of the log.

use super::Severity;
use crate::ros::NodeName;
use downbeat_executor::running_module;
use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::rcl_interfaces::msg::Log;
use std::borrow::Cow;
use std::fmt::{self, Write};
use std::time::{SystemTime, UNIX_EPOCH};
use tracing::Event;
use tracing::field::{Field, Visit};

/// Longer messages are cut: they may hold what came from outside.
const LONGEST_MESSAGE: usize = 16 * 1024;

/// One event of `tracing` as a line of ROS 2.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogLine {
    /// When it was logged, by the system's clock, in nanoseconds since the Unix epoch.
    pub time_ns: i64,
    /// Its severity.
    pub severity: Severity,
    /// The module that logged it or that it is about; nothing where it is about the node as a whole.
    pub module: Option<String>,
    /// The message, followed by the other fields as `name=value`.
    pub message: String,
    /// The source file, empty if not known.
    pub file: Cow<'static, str>,
    /// The line in it, 0 if not known.
    pub line: u32,
    /// The function of a module in Python, else the path of the Rust module: `tracing` knows no functions.
    pub function: Cow<'static, str>,
}

impl LogLine {
    /// The line for an event that is logged now on this thread. Its place is that of the event, unless the
    /// fields `log.file`, `log.line` and `log.module_path` give another: so do lines of the crate `log` and
    /// of modules in other languages.
    #[must_use]
    pub fn of(event: &Event<'_>) -> Self {
        let metadata = event.metadata();
        let mut fields = Fields::default();
        event.record(&mut fields);
        Self {
            severity: Severity::of(*metadata.level()),
            module: fields.module.or_else(|| running_module().map(|name| name.to_string())),
            file: fields.file.map_or(metadata.file().unwrap_or_default().into(), Cow::Owned),
            line: fields.line.unwrap_or(metadata.line().unwrap_or_default()),
            function: fields.function.map_or(metadata.module_path().unwrap_or_default().into(), Cow::Owned),
            ..Self::now(Severity::Info, fields.message.join(fields.others))
        }
    }

    /// A line of our own, about the node.
    pub(super) fn now(severity: Severity, message: String) -> Self {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self {
            time_ns: i64::try_from(now.as_nanos()).unwrap_or(i64::MAX),
            severity,
            module: None,
            message,
            file: file!().into(),
            line: line!(),
            function: module_path!().into(),
        }
    }

    /// The name of the logger: the node's, or that of a module below it.
    #[must_use]
    pub fn logger(&self, node_logger: &str) -> String {
        self.module
            .as_ref()
            .map_or_else(|| node_logger.to_owned(), |module| format!("{node_logger}.{module}"))
    }

    /// The message for `/rosout`.
    #[must_use]
    pub fn to_message(&self, node_logger: &str) -> Log {
        Log {
            stamp: Time::from_nanos(self.time_ns),
            level: self.severity.number(),
            name: self.logger(node_logger),
            msg: self.message.clone(),
            file: self.file.to_string(),
            function: self.function.to_string(),
            line: self.line,
        }
    }
}

/// The name of a node's logger: the node `downbeat` in the namespace `/robot` has the logger `robot.downbeat`
/// (`rcl_create_node_logger_name` in rcl).
#[must_use]
pub fn logger_name(node: &NodeName) -> String {
    node.to_string().trim_start_matches('/').replace('/', ".")
}

/// The fields of an event.
#[derive(Default)]
struct Fields {
    module: Option<String>,
    file: Option<String>,
    line: Option<u32>,
    function: Option<String>,
    message: Text,
    others: Text,
}

impl Fields {
    fn add_other(&mut self, name: &str, value: fmt::Arguments<'_>) {
        self.others.add(format_args!(" {name}={value}"));
    }
}

impl Visit for Fields {
    fn record_str(&mut self, field: &Field, value: &str) {
        match field.name() {
            "message" => self.message.add(format_args!("{value}")),
            "module" => self.module = Some(value.to_owned()),
            "log.file" => self.file = Some(value.to_owned()),
            "log.module_path" => self.function = Some(value.to_owned()),
            name => self.add_other(name, format_args!("{value:?}")),
        }
    }

    fn record_u64(&mut self, field: &Field, value: u64) {
        match field.name() {
            "log.line" => self.line = u32::try_from(value).ok(),
            name => self.add_other(name, format_args!("{value}")),
        }
    }

    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        match field.name() {
            "message" => self.message.add(format_args!("{value:?}")),
            // Written with `%`, and so without quotes.
            "module" => self.module = Some(format!("{value:?}")),
            name => self.add_other(name, format_args!("{value:?}")),
        }
    }
}

/// A text that does not grow without end.
#[derive(Default)]
struct Text(String);

impl Text {
    fn add(&mut self, text: fmt::Arguments<'_>) {
        // Fails where the text is full, and then has its end already.
        let _ = self.write_fmt(text);
    }

    fn join(mut self, other: Self) -> String {
        self.add(format_args!("{}", other.0));
        match self.0.strip_prefix(' ') {
            Some(without_message) => without_message.to_owned(),
            None => self.0,
        }
    }
}

impl Write for Text {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let room = LONGEST_MESSAGE.saturating_sub(self.0.len());
        if text.len() <= room {
            self.0.push_str(text);
            return Ok(());
        }
        if room > 0 {
            let end = (0..=room).rev().find(|&end| text.is_char_boundary(end)).unwrap_or(0);
            self.0.push_str(&text[..end]);
            self.0.push('…');
            // Past the limit even where no character fitted, so that it is cut once.
            while self.0.len() < LONGEST_MESSAGE {
                self.0.push(' ');
            }
        }
        Err(fmt::Error)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::rosout::Rosout;
    use tracing_subscriber::prelude::*;

    fn lines(log: impl FnOnce()) -> Vec<LogLine> {
        let rosout = Rosout::new();
        tracing::subscriber::with_default(tracing_subscriber::registry().with(rosout.layer()), log);
        std::iter::from_fn(|| rosout.take()).collect()
    }

    #[test]
    fn a_line_tells_the_message_with_its_fields_and_where_it_was_logged() {
        let line = line!() + 2;
        let lines = lines(|| {
            tracing::warn!(servo = 5, joint = "l_knee", error = %"no answer", "is {}", "silent");
        });
        let [logged] = lines.as_slice() else { panic!("one line: {lines:?}") };
        assert_eq!(logged.message, "is silent servo=5 joint=\"l_knee\" error=no answer");
        assert_eq!((logged.severity, logged.line), (Severity::Warn, line));
        assert!(logged.file.ends_with("rosout/line.rs") && logged.function.ends_with("rosout::line::tests"));
        let message = logged.to_message("robot.downbeat");
        assert_eq!((message.name.as_str(), message.level), ("robot.downbeat", Log::WARN));
        assert!(message.stamp.sec > 1_700_000_000);
    }

    #[test]
    fn a_line_of_another_language_has_its_own_place() {
        let lines = lines(|| {
            tracing::info!(log.file = "walk.py", log.line = 12_u32, log.module_path = "on_imu", "steps");
        });
        let message = lines[0].to_message("downbeat");
        assert_eq!((&*message.file, message.line, &*message.function), ("walk.py", 12, "on_imu"));
        assert_eq!(message.msg, "steps");
    }

    #[test]
    fn a_module_has_a_logger_below_that_of_the_node() {
        let lines = lines(|| {
            tracing::error!(module = "walker", "panicked");
            let name = String::from("eye");
            tracing::error!(module = %name, "panicked");
            tracing::info!(only = "fields");
        });
        assert_eq!(lines[0].logger("robot.downbeat"), "robot.downbeat.walker");
        assert_eq!(lines[0].message, "panicked");
        assert_eq!(lines[1].logger("downbeat"), "downbeat.eye");
        assert_eq!((lines[2].logger("downbeat"), &*lines[2].message), ("downbeat".into(), "only=\"fields\""));
    }

    #[test]
    fn loggers_of_nodes_are_named_as_rcl_names_them() {
        for (namespace, expected) in
            [("/", "downbeat"), ("/robot", "robot.downbeat"), ("/a/b", "a.b.downbeat")]
        {
            assert_eq!(logger_name(&NodeName::new(namespace, "downbeat").unwrap()), expected);
        }
    }

    #[test]
    fn a_message_without_end_is_cut_between_characters() {
        let lines = lines(|| tracing::info!(more = 1, "{}", "ä".repeat(LONGEST_MESSAGE)));
        let message = &lines[0].message;
        assert!(
            message.len() < LONGEST_MESSAGE + 8 && message.trim_end().ends_with("ä…"),
            "{}",
            message.len()
        );
    }
}
