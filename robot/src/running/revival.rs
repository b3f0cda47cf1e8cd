//! Starts modules again whose files were saved after they had stopped.
//!
//! A module that runs looks at its files itself, and replaces itself in its own time. One that has stopped
//! cannot: its callback raised an exception, it could not be loaded, or it refused to become active.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use downbeat_edge::foreign::{Versions, prepare};
use downbeat_executor::{
    Core, CoreHandle, Inbox, ModuleEvent, ModuleEventKind, ModuleOptions, OutletInbox, Received,
    RestartRefused,
};

use super::StartError;
use super::newcomers::Newcomers;
use crate::{Live, RobotFile};

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
    options: ModuleOptions,
}

/// What the thread works with.
struct Watch {
    modules: Vec<Watched>,
    file: Arc<RobotFile>,
    core: CoreHandle,
    newcomers: Newcomers,
    /// Whether a module was made since this was last false.
    is_news: Arc<AtomicBool>,
}

impl Revival {
    /// Watches the files of the modules that the robot file reloads; `None` without such modules.
    pub(super) fn start(
        file: &Arc<RobotFile>,
        core: &mut Core,
        newcomers: Newcomers,
    ) -> Result<Option<Self>, StartError> {
        let reloaded = file.modules.iter().filter(|module| module.reloads());
        let watched = reloaded.filter_map(|module| {
            let (name, options) = (module.name.clone(), module.options());
            Some(Watched { name, live: module.live()?, options })
        });
        let modules: Vec<Watched> = watched.collect();
        if modules.is_empty() {
            return Ok(None);
        }
        let is_news = Arc::new(AtomicBool::new(false));
        let (of_outlet, inbox) = (Arc::clone(&is_news), OutletInbox::new("reload", Inbox::KeepAll));
        let note = move |event: Received<'_, ModuleEvent>| {
            if matches!(event.kind, ModuleEventKind::Made { .. }) {
                of_outlet.store(true, Ordering::Relaxed);
            }
        };
        core.outlet(ModuleEvent::TOPIC, &inbox, note)?.keep();
        let watch = Watch { modules, file: Arc::clone(file), core: core.handle(), newcomers, is_news };
        let (stop, stopped) = sync_channel(0);
        let thread = std::thread::Builder::new().name("reload".to_owned()).spawn(move || watch.run(&stopped));
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

impl Watch {
    fn run(&self, stopped: &Receiver<()>) {
        while stopped.recv_timeout(PERIOD) == Err(RecvTimeoutError::Timeout) {
            for module in self.modules.iter().filter(|module| module.live.was_saved_after_the_end()) {
                self.revive(module);
            }
            if self.is_news.swap(false, Ordering::Relaxed) {
                self.newcomers.look(&self.file);
            }
        }
    }

    fn revive(&self, Watched { name, live, options }: &Watched) {
        let (module, source) = (name.as_str(), live.source());
        let fails = |reason: &dyn std::fmt::Display| {
            tracing::error!(module, "{source} was saved and still does not start: {reason}");
        };
        // On this thread, so that no cycle waits for it.
        match prepare(live, module, options.settings.clone(), &self.file.catalog.interfaces) {
            Ok(prepared) => {
                let (_, declared) = &prepared;
                self.newcomers.expect(&self.file, declared, options);
                live.set_prepared(prepared);
            }
            Err(reason) => return fails(&reason),
        }
        match self.core.restart(module).wait(PATIENCE) {
            Some(Ok(())) => tracing::info!(module, "{source} was saved: it starts again with it"),
            Some(Err(RestartRefused::Setup(error))) => fails(&error),
            // Its restart policy was faster, it was removed, or the robot stops.
            Some(Err(RestartRefused::Runs { .. } | RestartRefused::UnknownModule(_))) | None => {}
        }
    }
}
