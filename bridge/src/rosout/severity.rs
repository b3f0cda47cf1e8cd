//! The severity of a line.

use std::fmt;
use tracing::Level;

/// A level of `rcl_interfaces/msg/Log` and of loggers, with the numbers of rcutils.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Severity {
    /// For finding faults. The level `trace` of `tracing`, which ROS 2 does not have, counts as this.
    Debug = 10,
    /// An event.
    Info = 20,
    /// Something is not as it should be; it goes on.
    Warn = 30,
    /// Something has failed.
    Error = 40,
    /// The program ends. Nothing in `tracing` is of this level, but a logger may be set to it.
    Fatal = 50,
}

impl Severity {
    /// All, from the least.
    pub const ALL: [Self; 5] = [Self::Debug, Self::Info, Self::Warn, Self::Error, Self::Fatal];

    /// The severity of an event of `tracing`.
    #[must_use]
    pub fn of(level: Level) -> Self {
        match level {
            Level::ERROR => Self::Error,
            Level::WARN => Self::Warn,
            Level::INFO => Self::Info,
            Level::DEBUG | Level::TRACE => Self::Debug,
        }
    }

    /// The severity of that number, if there is one.
    #[must_use]
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|severity| u32::from(severity.number()) == number)
    }

    /// As in `rcl_interfaces/msg/Log` and `rcl_interfaces/msg/LoggerLevel`.
    #[must_use]
    pub fn number(self) -> u8 {
        self as u8
    }

    /// As ROS 2 writes it: `WARN`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Debug => "DEBUG",
            Self::Info => "INFO",
            Self::Warn => "WARN",
            Self::Error => "ERROR",
            Self::Fatal => "FATAL",
        }
    }
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use downbeat_msgs::rcl_interfaces::msg::Log;

    #[test]
    fn the_numbers_are_those_of_the_message() {
        let numbers = Severity::ALL.map(Severity::number);
        assert_eq!(numbers, [Log::DEBUG, Log::INFO, Log::WARN, Log::ERROR, Log::FATAL]);
        assert_eq!(Severity::from_number(30), Some(Severity::Warn));
        assert_eq!(Severity::from_number(0), None);
        assert_eq!(Severity::from_number(300), None);
    }

    #[test]
    fn what_ros_has_no_word_for_is_debug() {
        assert_eq!(Severity::of(Level::TRACE), Severity::Debug);
        assert_eq!(Severity::of(Level::ERROR).to_string(), "ERROR");
    }
}
