//! `downbeat bag debug`: a replay that goes forwards and backwards.
//!
//! The debugger starts engines, processes of this program that replay. A checkpoint is a copy of an engine
//! that stands at a cycle and waits; going back is going forwards from a copy of a checkpoint.

mod engine;
mod fork;
#[cfg(feature = "view")]
mod page;
mod protocol;
mod terminal;
mod travel;
mod why;
mod words;

use std::path::PathBuf;

use clap::Args;
use downbeat_bags::{Reader, Storage};
use downbeat_robot::replay::ReplaySession;
use downbeat_robot::{Catalog, RobotFile, RosArgs};

use super::replayed::ReplayedArguments;
use crate::logging::Log;
use travel::Travel;

#[derive(Args)]
pub(crate) struct DebugArguments {
    #[command(flatten)]
    pub(crate) replayed: ReplayedArguments,
    /// Carry out these commands before those of the standard input, one line each; see `help` there.
    #[arg(long, short = 'c', value_name = "COMMAND")]
    pub(crate) command: Vec<String>,
    /// Show it in a browser, on this port: 7373 if none is given, 0 for a free one.
    #[cfg(feature = "view")]
    #[arg(long, value_name = "PORT", num_args = 0..=1)]
    pub(crate) page: Option<Option<u16>>,
    /// Replay for the debugger at this socket.
    #[arg(long, hide = true, value_name = "SOCKET")]
    pub(crate) engine: Option<PathBuf>,
}

pub(crate) fn debug(
    arguments: &DebugArguments,
    catalog: &Catalog,
    ros: &RosArgs,
    log: &Log,
) -> anyhow::Result<()> {
    let (file, reader, options) = arguments.replayed.open(catalog, ros, log)?;
    if let Some(socket) = &arguments.engine {
        let no_checkpoints = no_checkpoints(&file, &reader);
        return engine::serve(ReplaySession::open(file, &reader, &options)?, socket, no_checkpoints);
    }
    let mut travel = Travel::start()?;
    #[cfg(feature = "view")]
    if let Some(port) = arguments.page {
        terminal::pass(&mut travel)?;
        return page::show(travel, reader, port, catalog);
    }
    terminal::run(&mut travel, &arguments.command)
}

/// Why a replay cannot be copied; `None` if it can.
fn no_checkpoints(file: &RobotFile, reader: &Reader) -> Option<String> {
    let isolated = file.modules.iter().find(|module| module.is_isolated());
    if let Some(module) = isolated {
        return Some(format!(
            "{} runs in a process of its own, which cannot be copied, so going back starts anew each time",
            module.name
        ));
    }
    let is_sqlite = reader.storage() == Storage::Sqlite3;
    is_sqlite.then(|| {
        "SQLite cannot be read by copies of a process, so going back starts anew each time; `downbeat bag convert` makes an MCAP bag"
            .to_owned()
    })
}
