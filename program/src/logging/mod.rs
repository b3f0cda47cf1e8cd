//! Logging to the console in the format of ROS 2, optionally to a file, and to `/rosout`.

mod environment;
mod file;
mod format;

use std::io::IsTerminal;

use anyhow::Context;
use tracing::level_filters::LevelFilter;
use tracing::subscriber::Interest;
use tracing::{Event, Metadata, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::Context as LayerContext;
use tracing_subscriber::prelude::*;
use tracing_subscriber::registry::LookupSpan;

use super::screen::Screen;
use super::system;
use downbeat_bridge::rosout::{LogLine, LoggerLevels, LoggerNames, Rosout, Severity};
use downbeat_robot::running::{LogTail, NodeLog};
use downbeat_robot::{LogArguments, LogLevel, RobotFile};
pub(crate) use environment::Stream;
use environment::{Colors, LogOptions};
use file::LogFile;
use format::Format;

/// The variable that selects what is logged.
const VARIABLE: &str = "DOWNBEAT_LOG";

/// rustdds logs each repair and each refused sample as an error; the bridge reports what matters. Zenoh logs
/// each failed attempt to connect as a warning, and as an error the end of what it was not told of.
macro_rules! quiet {
    () => {
        "rustdds=off,zenoh=error,zenoh::net::routing::dispatcher=off"
    };
}

const DEFAULT: &str = concat!("info,", quiet!());

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
                tail: LogTail::default(),
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
            tail: log.of_node.tail.clone(),
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
    let mut filter = format!(concat!("{},", quiet!()), level);
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

/// Filters events, and writes them to the console, to a file, and to `/rosout`.
///
/// A logger with its own level uses that; others use `DOWNBEAT_LOG`.
struct LogLayer {
    filter: Targets,
    levels: LoggerLevels,
    names: LoggerNames,
    /// `None` with `--disable-stdout-logs`.
    console: Option<Console>,
    format: Format,
    file: Option<LogFile>,
    rosout: Rosout,
    tail: LogTail,
}

/// Standard error or output, above the status block.
struct Console {
    format: Format,
    has_colors: bool,
    /// Lines begin with their priority, as systemd's journal reads it (`sd-daemon(3)`).
    is_journal: bool,
    stream: Stream,
    screen: Screen,
}

impl<S> Layer<S> for LogLayer
where
    S: Subscriber + for<'a> LookupSpan<'a>,
{
    fn register_callsite(&self, metadata: &'static Metadata<'static>) -> Interest {
        let interest = Layer::<S>::register_callsite(&self.filter, metadata);
        if interest.is_never() && self.may_be_raised(metadata) { Interest::sometimes() } else { interest }
    }

    fn enabled(&self, metadata: &Metadata<'_>, ctx: LayerContext<'_, S>) -> bool {
        self.may_be_raised(metadata) || Layer::<S>::enabled(&self.filter, metadata, ctx)
    }

    fn max_level_hint(&self) -> Option<LevelFilter> {
        let raised = self.levels.least().map(|severity| match severity {
            Severity::Debug => LevelFilter::DEBUG,
            Severity::Info => LevelFilter::INFO,
            Severity::Warn => LevelFilter::WARN,
            Severity::Error | Severity::Fatal => LevelFilter::ERROR,
        });
        // Without a hint, the filter may accept everything.
        let wanted = Layer::<S>::max_level_hint(&self.filter)?;
        Some(raised.map_or(wanted, |raised| raised.max(wanted)))
    }

    fn on_event(&self, event: &Event<'_>, ctx: LayerContext<'_, S>) {
        let line = LogLine::of(event);
        let logger = self.names.of(&line);
        let is_wanted = match self.levels.effective(&logger) {
            Some(level) => line.severity >= level,
            None => Layer::<S>::enabled(&self.filter, event.metadata(), ctx),
        };
        if is_wanted {
            if let Some(console) = &self.console {
                console.write(&line, &logger);
            }
            if let Some(file) = &self.file {
                file.write(plain(&self.format, &line, &logger));
            }
            self.tail.push(line.clone(), &logger);
            self.rosout.log(line);
        }
    }
}

impl LogLayer {
    /// Returns whether some logger has a level that accepts such an event.
    fn may_be_raised(&self, metadata: &Metadata<'_>) -> bool {
        let severity = Severity::of(*metadata.level());
        let is_ours = !["rustdds", "zenoh"].iter().any(|other| metadata.target().starts_with(other));
        metadata.is_event() && is_ours && self.levels.least().is_some_and(|least| severity >= least)
    }
}

impl Console {
    fn new(options: &LogOptions, screen: &Screen) -> Self {
        let is_terminal = match options.stream {
            Stream::Error => std::io::stderr().is_terminal(),
            Stream::Output => std::io::stdout().is_terminal(),
        };
        let has_colors = match options.colors {
            Colors::OnTerminals => is_terminal,
            Colors::Always => true,
            Colors::Never => false,
        };
        let identity = match options.stream {
            Stream::Error => system::identity_of_error(),
            Stream::Output => system::identity_of_output(),
        };
        let is_journal = options.journal.is_some() && options.journal == identity;
        let format = if is_journal { &options.journal_format } else { &options.format };
        Self {
            format: format.clone(),
            has_colors: has_colors && !is_journal,
            is_journal,
            stream: options.stream,
            screen: screen.clone(),
        }
    }

    fn write(&self, line: &LogLine, logger: &str) {
        let text = match (self.has_colors, self.is_journal) {
            (true, _) => self.colored(line, logger),
            (false, true) => with_priority(&plain(&self.format, line, logger), line.severity),
            (false, false) => plain(&self.format, line, logger),
        };
        self.screen.log(self.stream, text);
    }

    /// In the colors of rcutils.
    fn colored(&self, line: &LogLine, logger: &str) -> String {
        let mut text = String::with_capacity(128);
        text.push_str(match line.severity {
            Severity::Debug => "\x1b[32m",
            Severity::Info => "\x1b[0m",
            Severity::Warn => "\x1b[33m",
            Severity::Error | Severity::Fatal => "\x1b[31m",
        });
        self.format.write(line, logger, &mut text);
        text.push_str("\x1b[0m\n");
        text
    }
}

/// Puts the priority of syslog before each line: the journal takes every line as an entry.
fn with_priority(text: &str, severity: Severity) -> String {
    let priority = match severity {
        Severity::Debug => "<7>",
        Severity::Info => "<6>",
        Severity::Warn => "<4>",
        Severity::Error => "<3>",
        Severity::Fatal => "<2>",
    };
    text.lines().flat_map(|line| [priority, line, "\n"]).collect()
}

fn plain(format: &Format, line: &LogLine, logger: &str) -> String {
    let mut text = String::with_capacity(128);
    format.write(line, logger, &mut text);
    text.push('\n');
    text
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
