//! Logging to the console in the format of ROS 2, optionally to a file, and to `/rosout`.

mod environment;
mod file;
mod format;
mod layer;

use crate::bridge::rosout::{LoggerLevels, LoggerNames, Rosout, Severity};
use crate::robot::{LogArguments, LogLevel, RobotFile};
use crate::running::NodeLog;
use anyhow::Context;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::prelude::*;

use super::screen::Screen;
use environment::LogOptions;
pub(crate) use environment::Stream;
use file::LogFile;
use layer::{Console, LogLayer};

/// The variable that selects what is logged.
const VARIABLE: &str = "DOWNBEAT_LOG";

/// rustdds logs each repair and each refused sample as an error; the bridge reports what matters.
const DEFAULT: &str = "info,rustdds=off";

/// The name of the logger while there is no node.
const PROGRAM: &str = "downbeat";

/// The log of the program.
#[derive(Clone)]
pub(crate) struct Log {
    /// The queue for `/rosout`, the levels of loggers, and their names.
    pub(crate) of_node: NodeLog,
    file: Option<LogFile>,
}

impl Log {
    /// Starts logging as configured by the environment, above the status block.
    pub(crate) fn start(screen: &Screen, arguments: &LogArguments) -> anyhow::Result<Self> {
        let options = LogOptions::from_variables(|name| std::env::var(name).ok())?.with(arguments);
        let given = filter_of(arguments).or_else(|| std::env::var(VARIABLE).ok());
        let log = Self {
            of_node: NodeLog {
                rosout: Rosout::new(),
                levels: LoggerLevels::starting_at(start_of(given.as_deref().unwrap_or(DEFAULT))),
                names: LoggerNames::new(PROGRAM),
            },
            file: options.file.as_deref().map(LogFile::create).transpose()?,
        };
        for (logger, level) in &arguments.loggers {
            log.of_node.levels.set(logger, severity(*level))?;
        }
        let default = || DEFAULT.parse::<Targets>().unwrap_or_default();
        let filter = given.as_deref().map(str::parse::<Targets>).transpose();
        let (filter, problem) = match filter {
            Ok(filter) => (filter.unwrap_or_else(default), None),
            Err(error) => (default(), Some(error)),
        };
        let layer = LogLayer {
            filter,
            levels: log.of_node.levels.clone(),
            names: log.of_node.names.clone(),
            console: (!arguments.is_stdout_disabled).then(|| Console::new(&options, screen)),
            format: options.format.clone(),
            file: log.file.clone(),
            rosout: log.of_node.rosout.clone(),
        };
        tracing_subscriber::registry().with(layer).try_init().context("cannot start the log")?;
        if let Some(error) = problem {
            tracing::warn!("{VARIABLE}={} is invalid: {error}", given.unwrap_or_default());
        }
        options.remarks.iter().for_each(|remark| tracing::warn!("{remark}"));
        Ok(log)
    }

    /// Names the loggers of modules after a robot without a ROS 2 node.
    pub(crate) fn name_after(&self, robot: &RobotFile) -> anyhow::Result<()> {
        self.of_node.names.set_node(&robot.node_name()?);
        Ok(())
    }

    /// Writes queued lines.
    pub(crate) fn close(&self) {
        if let Some(file) = &self.file {
            file.close();
        }
    }
}

/// The filter of `--log-level`, which overrides the environment. The parts of a logger's name may also be
/// those of a module path.
fn filter_of(arguments: &LogArguments) -> Option<String> {
    if arguments.level.is_none() && arguments.loggers.is_empty() {
        return None;
    }
    let level = arguments.level.map_or("info", LogLevel::as_filter);
    let mut filter = format!("{level},rustdds=off");
    for (logger, level) in &arguments.loggers {
        filter.push_str(&format!(",{}={}", logger.replace('.', "::"), level.as_filter()));
    }
    Some(filter)
}

/// The minimum severity of a filter for targets without a directive.
fn start_of(filter: &str) -> Severity {
    let mut general =
        filter.split(',').filter_map(|directive| directive.trim().parse::<tracing::Level>().ok());
    // A filter without a general level has no such directive, or `off`.
    general.next_back().map_or(Severity::Fatal, Severity::of)
}

fn severity(level: LogLevel) -> Option<Severity> {
    match level {
        LogLevel::Unset => None,
        LogLevel::Debug => Some(Severity::Debug),
        LogLevel::Info => Some(Severity::Info),
        LogLevel::Warn => Some(Severity::Warn),
        LogLevel::Error => Some(Severity::Error),
        LogLevel::Fatal => Some(Severity::Fatal),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_root_logger_has_the_general_level_of_the_filter() {
        for (filter, expected) in [
            (DEFAULT, Severity::Info),
            ("warn,downbeat_bridge=debug", Severity::Warn),
            ("downbeat=info, ERROR", Severity::Error),
            ("off", Severity::Fatal),
        ] {
            assert_eq!(start_of(filter), expected, "{filter}");
        }
    }
}
