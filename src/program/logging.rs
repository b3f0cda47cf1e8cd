//! Where log events go.

use std::io::IsTerminal;

use tracing_subscriber::EnvFilter;

use downbeat::robot::{LogArguments, LogLevel};

use super::screen::Screen;

/// The variable that says what is logged.
const VARIABLE: &str = "DOWNBEAT_LOG";

/// The DDS engine reports each repair and each refused sample as an error; what matters of it the bridge tells.
const DEFAULT: &str = "info,rustdds=off";

/// Sends log events to standard error, above the status block.
pub(crate) fn start(screen: &Screen, arguments: &LogArguments) {
    let given = filter_of(arguments).or_else(|| std::env::var(VARIABLE).ok());
    let filter = given.as_deref().map(EnvFilter::try_new).transpose();
    let (filter, problem) = match filter {
        Ok(filter) => (filter.unwrap_or_else(|| EnvFilter::new(DEFAULT)), None),
        Err(error) => (EnvFilter::new(DEFAULT), Some(error)),
    };
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(screen.clone())
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        .init();
    if let Some(error) = problem {
        tracing::warn!("{VARIABLE}={} is not understood: {error}", given.unwrap_or_default());
    }
}

/// What `--ros-args` say, which win over the environment. The parts of a logger's name are those of a module path.
fn filter_of(arguments: &LogArguments) -> Option<String> {
    if arguments.is_stdout_disabled {
        return Some("off".into());
    }
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
