//! The contents of a bag, printed like `ros2 bag info`.
//!
//! The layout is that of `rosbag2_py/format_bag_metadata.cpp`, branch jazzy.

use std::path::Path;
use std::time::Duration;
use std::{fmt, fs, io};

use downbeat_msgs::printable;

use crate::metadata::NEVER;
use crate::reader::{Reader, RecordedTopic, Truncation};
use crate::sizes::{ServiceCalls, TopicSizes};
use crate::topic::{SERVICE_EVENT_TOPIC, SERVICE_EVENT_TYPE, is_service_event};

/// The contents of a bag. Its [`Display`](fmt::Display) output equals that of `ros2 bag info`, except that
/// times of day are UTC (not local time); for an interrupted recording it also lists what is missing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BagInfo {
    /// The bag files, relative to the directory.
    pub files: Vec<String>,
    /// Bytes of all files of the bag.
    pub size: u64,
    /// `mcap` or `sqlite3`.
    pub storage_identifier: String,
    /// `jazzy`, or `unknown`.
    pub ros_distro: String,
    /// From the first to the last message.
    pub duration: Duration,
    /// The receive time of the first message, in nanoseconds since the epoch; [`NEVER`] without messages.
    pub starting_time: i64,
    /// The number of messages, without service events.
    pub message_count: u64,
    /// The topics, without those of service events.
    pub topics: Vec<RecordedTopic>,
    /// The services whose events were recorded.
    pub services: Vec<ServiceEvents>,
    /// The missing item.
    pub truncation: Vec<Truncation>,
    /// Sizes that require reading all messages, if they were computed. If present, they are printed like
    /// `ros2 bag info --verbose`.
    pub sizes: Option<TopicSizes>,
}

/// A service whose events were recorded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServiceEvents {
    /// Service name.
    pub name: String,
    /// ROS type name of the service.
    pub type_name: String,
    /// Recorded events.
    pub event_count: u64,
    /// `cdr`.
    pub serialization_format: String,
}

/// The column of the values.
const INDENT: usize = 19;

impl BagInfo {
    /// Collects the contents of a bag.
    ///
    /// # Errors
    /// Returns an error if the bag's files are no longer accessible.
    pub fn of(reader: &Reader) -> io::Result<Self> {
        let is_event = |topic: &&RecordedTopic| is_service_event(&topic.info.name, &topic.info.type_name);
        let topics: Vec<RecordedTopic> =
            reader.topics().iter().filter(|topic| !is_event(topic)).cloned().collect();
        let services = reader.topics().iter().filter(is_event).map(ServiceEvents::of).collect();
        let relative = |path: &Path| {
            let below = path.strip_prefix(reader.path()).ok().filter(|below| !below.as_os_str().is_empty());
            below.unwrap_or(path).display().to_string()
        };
        let metadata = reader.metadata();
        Ok(Self {
            files: match metadata {
                Some(metadata) if reader.path().is_dir() => metadata.relative_file_paths.clone(),
                _ => reader.files().map(relative).collect(),
            },
            size: size(reader)?,
            storage_identifier: reader.storage_identifier().to_owned(),
            ros_distro: metadata
                .map(|metadata| metadata.ros_distro.clone())
                .filter(|distro| !distro.is_empty())
                .unwrap_or_else(|| "unknown".to_owned()),
            duration: reader.duration(),
            starting_time: reader.start_time().unwrap_or(NEVER),
            message_count: topics.iter().map(|topic| topic.message_count).sum(),
            topics,
            services,
            truncation: reader.truncation().cloned().collect(),
            sizes: None,
        })
    }
}

impl BagInfo {
    /// The size column, if known.
    fn size_of(&self, topic: &str) -> String {
        let size = self.sizes.as_ref().map(|sizes| Size(sizes.bytes_of(topic)));
        size.map_or_else(String::new, |size| format!("Size Contribution: {size} | "))
    }
}

impl ServiceEvents {
    /// The topic of its events.
    #[must_use]
    pub fn event_topic(&self) -> String {
        format!("{}{SERVICE_EVENT_TOPIC}", self.name)
    }

    fn of(topic: &RecordedTopic) -> Self {
        let without = |text: &str, ending: &str| text.strip_suffix(ending).unwrap_or(text).to_owned();
        Self {
            name: without(&topic.info.name, SERVICE_EVENT_TOPIC),
            type_name: without(&topic.info.type_name, SERVICE_EVENT_TYPE),
            event_count: topic.message_count,
            serialization_format: topic.serialization_format.clone(),
        }
    }
}

impl fmt::Display for BagInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let end =
            i128::from(self.starting_time) + i128::try_from(self.duration.as_nanos()).unwrap_or(i128::MAX);
        writeln!(f)?;
        write!(f, "{:INDENT$}", "Files:")?;
        let files: Vec<_> = self.files.iter().map(|file| printable(file).into_owned()).collect();
        lines(f, INDENT, &files)?;
        writeln!(f, "{:INDENT$}{}", "Bag size:", Size(self.size))?;
        writeln!(f, "{:INDENT$}{}", "Storage id:", self.storage_identifier)?;
        writeln!(f, "{:INDENT$}{}", "ROS Distro:", printable(&self.ros_distro))?;
        let (seconds, nanoseconds) = (self.duration.as_secs(), self.duration.subsec_nanos());
        writeln!(f, "{:INDENT$}{seconds}.{nanoseconds:09}s", "Duration:")?;
        writeln!(f, "{:INDENT$}{}", "Start:", TimePoint(i128::from(self.starting_time)))?;
        writeln!(f, "{:INDENT$}{}", "End:", TimePoint(end))?;
        writeln!(f, "{:INDENT$}{}", "Messages:", self.message_count)?;
        write!(f, "{:INDENT$}", "Topic information:")?;
        let topics = self.topics.iter().map(|topic| {
            let size = self.size_of(&topic.info.name);
            format!(
                "Topic: {} | Type: {} | Count: {} | {size}Serialization Format: {}",
                printable(&topic.info.name),
                printable(&topic.info.type_name),
                topic.message_count,
                printable(&topic.serialization_format)
            )
        });
        lines(f, INDENT, &topics.collect::<Vec<_>>())?;
        writeln!(f, "{:INDENT$}{}", "Service:", self.services.len())?;
        write!(f, "Service information: ")?;
        let services = self.services.iter().map(|service| {
            let ServiceEvents { name, type_name, event_count, serialization_format } = service;
            let counts = self.sizes.as_ref().map_or_else(
                || format!("Event Count: {event_count} | "),
                |sizes| {
                    let ServiceCalls { requests, responses } = sizes.calls_of(name);
                    let size = self.size_of(&service.event_topic());
                    format!("Request Count: {requests} | Response Count: {responses} | {size}")
                },
            );
            format!(
                "Service: {} | Type: {} | {counts}Serialization Format: {}",
                printable(name),
                printable(type_name),
                printable(serialization_format)
            )
        });
        let services: Vec<String> = services.collect();
        // The original prints no line break here if there are no services.
        if !services.is_empty() {
            lines(f, INDENT + 2, &services)?;
        }
        if !self.truncation.is_empty() {
            if services.is_empty() {
                writeln!(f)?;
            }
            for truncation in &self.truncation {
                writeln!(f, "Warning:           {truncation}")?;
            }
        }
        Ok(())
    }
}

/// Prints one item per line, the first one on the current line.
fn lines(f: &mut fmt::Formatter<'_>, indent: usize, lines: &[String]) -> fmt::Result {
    if lines.is_empty() {
        return writeln!(f);
    }
    for (number, line) in lines.iter().enumerate() {
        let indent = if number == 0 { 0 } else { indent };
        writeln!(f, "{:indent$}{line}", "")?;
    }
    Ok(())
}

/// The size of the directory including metadata.yaml, or of the single file.
fn size(reader: &Reader) -> io::Result<u64> {
    if !reader.path().is_dir() {
        return Ok(reader.files_length());
    }
    let mut size = 0;
    for entry in fs::read_dir(reader.path())? {
        let metadata = entry?.metadata()?;
        if metadata.is_file() {
            size += metadata.len();
        }
    }
    Ok(size)
}

struct Size(u64);

impl fmt::Display for Size {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const UNITS: [&str; 4] = ["KiB", "MiB", "GiB", "TiB"];
        if self.0 < 1024 {
            return write!(f, "{} B", self.0);
        }
        let mut size = self.0 as f64 / 1024.0;
        let mut unit = 0;
        while size >= 1024.0 && unit + 1 < UNITS.len() {
            size /= 1024.0;
            unit += 1;
        }
        write!(f, "{size:.1} {}", UNITS[unit])
    }
}

/// Nanoseconds since the epoch as `Nov 21 2026 03:15:23.877473869 (1795230923.877473869)`.
struct TimePoint(i128);

impl fmt::Display for TimePoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const MONTHS: [&str; 12] =
            ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"];
        let (seconds, nanoseconds) = (self.0.div_euclid(1_000_000_000), self.0.rem_euclid(1_000_000_000));
        let (days, second_of_day) = (seconds.div_euclid(86_400), seconds.rem_euclid(86_400));
        let (year, month, day) = civil_from_days(days);
        let (hour, minute, second) = (second_of_day / 3600, second_of_day / 60 % 60, second_of_day % 60);
        let month = MONTHS[usize::try_from(month - 1).map_err(|_| fmt::Error)?];
        write!(f, "{month} {day:2} {year} {hour:02}:{minute:02}:{second:02}.{nanoseconds:09} ")?;
        write!(f, "({seconds}.{nanoseconds:09})")
    }
}

/// Year, month and day of a number of days since 1970-01-01.
///
/// # References
/// Howard Hinnant, "chrono-Compatible Low-Level Date Algorithms", `civil_from_days`.
fn civil_from_days(days: i128) -> (i128, i128, i128) {
    let days = days + 719_468; // from 0000-03-01
    let era = days.div_euclid(146_097);
    let day_of_era = days.rem_euclid(146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted_month = (5 * day_of_year + 2) / 153; // from March
    let day = day_of_year - (153 * shifted_month + 2) / 5 + 1;
    let month = if shifted_month < 10 { shifted_month + 3 } else { shifted_month - 9 };
    (year_of_era + era * 400 + i128::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use super::{Size, TimePoint};

    #[test]
    fn times_are_written_as_calendar_dates() {
        // Dates from `date -u -d @N`.
        for (seconds, expected) in [
            (0, "Jan  1 1970 00:00:00.000000000 (0.000000000)"),
            (951_782_400, "Feb 29 2000 00:00:00.000000000 (951782400.000000000)"),
            (1_795_230_923, "Nov 21 2026 03:15:23.000000000 (1795230923.000000000)"),
            (4_107_542_399, "Feb 28 2100 23:59:59.000000000 (4107542399.000000000)"),
        ] {
            assert_eq!(TimePoint(seconds * 1_000_000_000).to_string(), expected);
        }
    }

    #[test]
    fn sizes_have_one_decimal_from_a_kibibyte_on() {
        let text = |size| Size(size).to_string();
        assert_eq!(
            [text(0), text(1023), text(1024), text(165_419)],
            ["0 B", "1023 B", "1.0 KiB", "161.5 KiB"]
        );
        assert_eq!(text(3 << 30), "3.0 GiB");
        assert_eq!(text(5 << 50), "5120.0 TiB");
    }
}
