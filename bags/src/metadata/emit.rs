//! The YAML text of rosbag2 metadata, byte for byte as written by rosbag2 (with yaml-cpp).
//!
//! Not written with serde, whose YAML writers indent sequences differently.

use std::fmt::Write;
use std::time::Duration;

use super::{FORMAT_VERSION, HUMBLE_VERSION, Metadata, RecordedQos};

/// rosbag2's value for an infinite duration: `RMW_DURATION_INFINITE`, 2^63 - 1 ns.
pub(super) const INFINITE: (u64, u64) = (9_223_372_036, 854_775_807);

/// The text of metadata.yaml.
pub(super) fn file_text(metadata: &Metadata) -> String {
    let mut text = Text::default();
    text.line(0, "rosbag2_bagfile_information:");
    text.metadata(2, metadata);
    text.finish()
}

/// The text of the metadata record inside an MCAP file: the same without the root key.
pub(super) fn record_text(metadata: &Metadata) -> String {
    let mut text = Text::default();
    text.metadata(0, metadata);
    text.finish()
}

/// The text of the channel metadata `offered_qos_profiles`.
pub(super) fn qos_text(profiles: &[RecordedQos], version: u32) -> String {
    let mut text = Text { has_policy_numbers: version == HUMBLE_VERSION, ..Text::default() };
    text.qos_sequence(0, profiles);
    text.finish()
}

#[derive(Default)]
struct Text {
    out: String,
    /// Whether QoS policies are written as numbers.
    has_policy_numbers: bool,
}

impl Text {
    fn line(&mut self, indent: usize, line: impl std::fmt::Display) {
        // Writing to a String cannot fail.
        let _ = writeln!(self.out, "{:indent$}{line}", "");
    }

    fn finish(mut self) -> String {
        self.out.truncate(self.out.trim_end_matches('\n').len());
        self.out
    }

    fn metadata(&mut self, at: usize, metadata: &Metadata) {
        let is_of_humble = metadata.version == HUMBLE_VERSION;
        let version = if is_of_humble { HUMBLE_VERSION } else { FORMAT_VERSION };
        self.line(at, format_args!("version: {version}"));
        self.line(at, format_args!("storage_identifier: {}", scalar(&metadata.storage_identifier)));
        self.line(at, "duration:");
        self.line(at + 2, format_args!("nanoseconds: {}", nanoseconds(metadata.duration)));
        self.line(at, "starting_time:");
        self.line(at + 2, format_args!("nanoseconds_since_epoch: {}", metadata.starting_time));
        self.line(at, format_args!("message_count: {}", metadata.message_count));
        self.sequence(at, "topics_with_message_count", metadata.topics.is_empty());
        for topic in &metadata.topics {
            self.line(at + 2, "- topic_metadata:");
            let inner = at + 6;
            self.line(inner, format_args!("name: {}", scalar(&topic.name)));
            self.line(inner, format_args!("type: {}", scalar(&topic.type_name)));
            self.line(inner, format_args!("serialization_format: {}", scalar(&topic.serialization_format)));
            if is_of_humble {
                let profiles = if topic.offered_qos.is_empty() {
                    String::new()
                } else {
                    qos_text(&topic.offered_qos, HUMBLE_VERSION)
                };
                self.line(inner, format_args!("offered_qos_profiles: {}", scalar(&profiles)));
            } else {
                self.sequence(inner, "offered_qos_profiles", topic.offered_qos.is_empty());
                if !topic.offered_qos.is_empty() {
                    self.qos_sequence(inner + 2, &topic.offered_qos);
                }
            }
            self.line(inner, format_args!("type_description_hash: {}", scalar(&topic.type_hash)));
            self.line(at + 4, format_args!("message_count: {}", topic.message_count));
        }
        self.line(at, format_args!("compression_format: {}", scalar(&metadata.compression_format)));
        self.line(at, format_args!("compression_mode: {}", scalar(&metadata.compression_mode)));
        self.sequence(at, "relative_file_paths", metadata.relative_file_paths.is_empty());
        for path in &metadata.relative_file_paths {
            self.line(at + 2, format_args!("- {}", scalar(path)));
        }
        self.sequence(at, "files", metadata.files.is_empty());
        for file in &metadata.files {
            self.line(at + 2, format_args!("- path: {}", scalar(&file.path)));
            self.line(at + 4, "starting_time:");
            self.line(at + 6, format_args!("nanoseconds_since_epoch: {}", file.starting_time));
            self.line(at + 4, "duration:");
            self.line(at + 6, format_args!("nanoseconds: {}", nanoseconds(file.duration)));
            self.line(at + 4, format_args!("message_count: {}", file.message_count));
        }
        if metadata.custom_data.is_empty() {
            self.line(at, "custom_data: ~");
        } else {
            self.line(at, "custom_data:");
            for (key, value) in &metadata.custom_data {
                self.line(at + 2, format_args!("{}: {}", scalar(key), scalar(value)));
            }
        }
        self.line(at, format_args!("ros_distro: {}", scalar(&metadata.ros_distro)));
    }

    fn sequence(&mut self, at: usize, key: &str, is_empty: bool) {
        self.line(at, format_args!("{key}:"));
        if is_empty {
            self.line(at + 2, "[]");
        }
    }

    fn qos_sequence(&mut self, at: usize, profiles: &[RecordedQos]) {
        if profiles.is_empty() {
            self.line(at, "[]");
        }
        for qos in profiles {
            let has_numbers = self.has_policy_numbers;
            let policy = |name: &'static str, number: u64| {
                if has_numbers { number.to_string() } else { name.to_owned() }
            };
            self.line(at, format_args!("- history: {}", policy(qos.history.name(), qos.history.number())));
            let at = at + 2;
            self.line(at, format_args!("depth: {}", qos.depth));
            self.line(
                at,
                format_args!("reliability: {}", policy(qos.reliability.name(), qos.reliability.number())),
            );
            self.line(
                at,
                format_args!("durability: {}", policy(qos.durability.name(), qos.durability.number())),
            );
            self.duration(at, "deadline", qos.deadline);
            self.duration(at, "lifespan", qos.lifespan);
            self.line(
                at,
                format_args!("liveliness: {}", policy(qos.liveliness.name(), qos.liveliness.number())),
            );
            self.duration(at, "liveliness_lease_duration", qos.liveliness_lease_duration);
            self.line(
                at,
                format_args!("avoid_ros_namespace_conventions: {}", qos.avoid_ros_namespace_conventions),
            );
        }
    }

    fn duration(&mut self, at: usize, key: &str, duration: Option<Duration>) {
        let (sec, nsec) =
            duration.map_or(INFINITE, |duration| (duration.as_secs(), u64::from(duration.subsec_nanos())));
        self.line(at, format_args!("{key}:"));
        self.line(at + 2, format_args!("sec: {sec}"));
        self.line(at + 2, format_args!("nsec: {nsec}"));
    }
}

fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

/// Plain if every YAML reader reads it as a string, else in double quotes.
fn scalar(text: &str) -> String {
    if is_plain(text) {
        return text.to_owned();
    }
    let mut quoted = String::from("\"");
    for character in text.chars() {
        match character {
            '"' => quoted.push_str("\\\""),
            '\\' => quoted.push_str("\\\\"),
            '\n' => quoted.push_str("\\n"),
            '\t' => quoted.push_str("\\t"),
            '\r' => quoted.push_str("\\r"),
            // Readers bound how deep brackets are nested before they know which of them are in strings:
            // `downbeat_msgs::yaml` does.
            '[' => quoted.push_str("\\x5b"),
            '{' => quoted.push_str("\\x7b"),
            // YAML 1.2, section 5.1: these must be escaped to be printable.
            control if control.is_control() || matches!(control, '\u{2028}' | '\u{2029}' | '\u{feff}') => {
                let _ = write!(quoted, "\\u{:04x}", u32::from(control));
            }
            other => quoted.push(other),
        }
    }
    quoted.push('"');
    quoted
}

fn is_plain(text: &str) -> bool {
    // YAML 1.1 readers (PyYAML, yaml-cpp) read these as booleans or null.
    const RESERVED: [&str; 9] = ["true", "false", "yes", "no", "on", "off", "null", "y", "n"];
    let starts_like_a_name = text.starts_with(|c: char| c.is_ascii_alphabetic() || c == '/' || c == '_');
    starts_like_a_name
        && text.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '/' | '_' | '.' | '-'))
        && !RESERVED.contains(&text.to_ascii_lowercase().as_str())
}

#[cfg(test)]
mod tests {
    use super::scalar;

    #[test]
    fn text_that_yaml_would_read_as_another_type_is_quoted() {
        for text in
            ["true", "No", "~", "", "1.0", "- a", "a: b", "a #b", "line\nbreak", "\"", "\u{7}", "null"]
        {
            let read: String =
                serde_norway::from_str(&scalar(text)).unwrap_or_else(|error| panic!("{text:?}: {error}"));
            assert_eq!(read, text);
            assert!(scalar(text).starts_with('"'), "{text:?}");
        }
        assert_eq!(scalar("/joint_states"), "/joint_states");
    }
}
