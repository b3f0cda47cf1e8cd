//! Starts modules again whose files were saved after they had stopped.
//!
//! A module that runs looks at its files itself, and replaces itself in its own time. One that has stopped cannot: its callback raised an
//! exception, it could not be loaded, or it refused to become active.

use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use downbeat_edge::Interfaces;
use downbeat_edge::foreign::{Versions, prepare};
use downbeat_executor::{CoreHandle, RestartRefused, SettingValue};

use super::StartError;
use crate::robot::{Live, RobotFile};

/// How often files are looked at.
const PERIOD: Duration = Duration::from_millis(200);
/// How long the core may take for a restart, before it is left to itself.
const PATIENCE: Duration = Duration::from_secs(10);

/// The thread that watches the files, until this is dropped.
pub(super) struct Revival {
    /// Nothing is sent: the thread ends when it is dropped.
    stop: Option<SyncSender<()>>,
    thread: Option<JoinHandle<()>>,
}

/// A module that is reloaded.
struct Watched {
    name: String,
    live: Live,
    settings: BTreeMap<String, SettingValue>,
}

impl Revival {
    /// Watches the files of the modules that the robot file reloads; `None` without such modules.
    pub(super) fn start(file: &RobotFile, core: CoreHandle) -> Result<Option<Self>, StartError> {
        let reloaded = file.modules.iter().filter(|module| module.reloads());
        let watched = reloaded.filter_map(|module| {
            let (name, settings) = (module.name.clone(), module.options().settings);
            Some(Watched { name, live: module.kind.live(&module.source)?, settings })
        });
        let watched: Vec<Watched> = watched.collect();
        if watched.is_empty() {
            return Ok(None);
        }
        let (stop, stopped) = sync_channel(0);
        let interfaces = file.catalog.interfaces.clone();
        let watch = move || run(&watched, &interfaces, &core, &stopped);
        let thread = std::thread::Builder::new().name("reload".to_owned()).spawn(watch);
        let thread = thread.map_err(|source| StartError::Thread { what: "reloading modules", source })?;
        Ok(Some(Self { stop: Some(stop), thread: Some(thread) }))
    }
}

impl Drop for Revival {
    fn drop(&mut self) {
        self.stop = None;
        if self.thread.take().is_some_and(|thread| thread.join().is_err()) {
            tracing::error!("the thread that reloads modules ended by a panic");
        }
    }
}

fn run(watched: &[Watched], interfaces: &Interfaces, core: &CoreHandle, stopped: &Receiver<()>) {
    while stopped.recv_timeout(PERIOD) == Err(RecvTimeoutError::Timeout) {
        for module in watched.iter().filter(|module| module.live.was_saved_after_the_end()) {
            module.revive(interfaces, core);
        }
    }
}

impl Watched {
    fn revive(&self, interfaces: &Interfaces, core: &CoreHandle) {
        let (module, source) = (self.name.as_str(), self.live.source());
        let fails = |reason: &dyn std::fmt::Display| {
            tracing::error!(module, "{source} was saved and still does not start: {reason}");
        };
        // On this thread, so that no cycle waits for it.
        match prepare(&self.live, module, self.settings.clone(), interfaces) {
            Ok(prepared) => self.live.set_prepared(prepared),
            Err(reason) => return fails(&reason),
        }
        match core.restart(module).wait(PATIENCE) {
            Some(Ok(())) => tracing::info!(module, "{source} was saved: it starts again with it"),
            Some(Err(RestartRefused::Setup(error))) => fails(&error),
            // Its restart policy was faster, it was removed, or the robot stops.
            Some(Err(RestartRefused::Runs { .. } | RestartRefused::UnknownModule(_))) | None => {}
        }
    }
}
