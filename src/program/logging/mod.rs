//! Where log events go: to the console as ROS 2 writes it, to a file where one is asked for, and to `/rosout`.

mod environment;
mod file;
mod format;
mod layer;

use std::sync::{Arc, PoisonError, RwLock};

use anyhow::Context;
use downbeat::bridge::ros::NodeName;
use downbeat::bridge::rosout::{LoggerLevels, Rosout, logger_name};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::prelude::*;

use super::screen::Screen;
use environment::LogOptions;
pub(crate) use environment::Stream;
use file::LogFile;
use layer::{Console, LogLayer};

/// The variable that says what is logged.
const VARIABLE: &str = "DOWNBEAT_LOG";

/// The DDS engine reports each repair and each refused sample as an error; what matters of it the bridge tells.
const DEFAULT: &str = "info,rustdds=off";

/// The name of the logger while there is no node.
const PROGRAM: &str = "downbeat";

/// The log of the program.
#[derive(Clone)]
pub(crate) struct Log {
    /// What waits for `/rosout`.
    pub(crate) rosout: Rosout,
    /// The levels that loggers are given, which tools may change.
    levels: LoggerLevels,
    node_logger: Arc<RwLock<String>>,
    file: Option<LogFile>,
}

impl Log {
    /// Sends log events where the environment says, above the status block.
    pub(crate) fn start(screen: &Screen) -> anyhow::Result<Self> {
        let options = LogOptions::from_variables(|name| std::env::var(name).ok())?;
        let log = Self {
            rosout: Rosout::new(),
            levels: LoggerLevels::default(),
            node_logger: Arc::new(RwLock::new(PROGRAM.into())),
            file: options.file.as_deref().map(LogFile::create).transpose()?,
        };
        let given = std::env::var(VARIABLE).ok();
        let filter = given.as_deref().map(EnvFilter::try_new).transpose();
        let (filter, problem) = match filter {
            Ok(filter) => (filter.unwrap_or_else(|| EnvFilter::new(DEFAULT)), None),
            Err(error) => (EnvFilter::new(DEFAULT), Some(error)),
        };
        let layer = LogLayer {
            filter,
            levels: log.levels.clone(),
            node_logger: Arc::clone(&log.node_logger),
            console: Console::new(&options, screen),
            file: log.file.clone(),
            rosout: log.rosout.clone(),
        };
        tracing_subscriber::registry().with(layer).try_init().context("cannot start the log")?;
        if let Some(error) = problem {
            tracing::warn!("{VARIABLE}={} is not understood: {error}", given.unwrap_or_default());
        }
        options.remarks.iter().for_each(|remark| tracing::warn!("{remark}"));
        Ok(log)
    }

    /// Lines are from now on those of a node.
    pub(crate) fn name_by(&self, node: &NodeName) {
        *self.node_logger.write().unwrap_or_else(PoisonError::into_inner) = logger_name(node);
    }

    /// Writes what still waits to be written.
    pub(crate) fn close(&self) {
        if let Some(file) = &self.file {
            file.close();
        }
    }
}
