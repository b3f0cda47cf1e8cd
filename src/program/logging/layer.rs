//! Filters log events and distributes them.

use std::io::IsTerminal;

use crate::bridge::rosout::{LogLine, LoggerLevels, LoggerNames, Rosout, Severity};
use tracing::level_filters::LevelFilter;
use tracing::subscriber::Interest;
use tracing::{Event, Metadata, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::Context;
use tracing_subscriber::registry::LookupSpan;

use super::environment::{Colors, LogOptions, Stream};
use super::file::LogFile;
use super::format::Format;
use crate::program::screen::Screen;

/// Filters events, and writes them to the console, to a file, and to `/rosout`.
///
/// A logger with its own level uses that; others use `DOWNBEAT_LOG`.
pub(super) struct LogLayer {
    pub(super) filter: Targets,
    pub(super) levels: LoggerLevels,
    pub(super) names: LoggerNames,
    /// `None` with `--disable-stdout-logs`.
    pub(super) console: Option<Console>,
    pub(super) format: Format,
    pub(super) file: Option<LogFile>,
    pub(super) rosout: Rosout,
}

/// Standard error or output, above the status block.
pub(super) struct Console {
    format: Format,
    has_colors: bool,
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

    fn enabled(&self, metadata: &Metadata<'_>, ctx: Context<'_, S>) -> bool {
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

    fn on_event(&self, event: &Event<'_>, ctx: Context<'_, S>) {
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
            self.rosout.log(line);
        }
    }
}

impl LogLayer {
    /// Whether some logger has a level that accepts such an event.
    fn may_be_raised(&self, metadata: &Metadata<'_>) -> bool {
        let severity = Severity::of(*metadata.level());
        let is_ours = !metadata.target().starts_with("rustdds");
        metadata.is_event() && is_ours && self.levels.least().is_some_and(|least| severity >= least)
    }
}

impl Console {
    pub(super) fn new(options: &LogOptions, screen: &Screen) -> Self {
        let is_terminal = match options.stream {
            Stream::Error => std::io::stderr().is_terminal(),
            Stream::Output => std::io::stdout().is_terminal(),
        };
        let has_colors = match options.colors {
            Colors::OnTerminals => is_terminal,
            Colors::Always => true,
            Colors::Never => false,
        };
        Self { format: options.format.clone(), has_colors, stream: options.stream, screen: screen.clone() }
    }

    fn write(&self, line: &LogLine, logger: &str) {
        let text =
            if self.has_colors { self.colored(line, logger) } else { plain(&self.format, line, logger) };
        self.screen.log(self.stream, &text);
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

fn plain(format: &Format, line: &LogLine, logger: &str) -> String {
    let mut text = String::with_capacity(128);
    format.write(line, logger, &mut text);
    text.push('\n');
    text
}
