//! How a module in another language joins a core: in its versions on disk, or in those of a bag.

use std::sync::Arc;

use downbeat_edge::Interfaces;
use downbeat_edge::foreign::{self, ForeignModule};
use downbeat_executor::{Core, SetupError};
use downbeat_kind::LoadForeign;

use super::live::Live;
use super::recorded::Recorded;
use crate::ModuleEntry;

impl ModuleEntry {
    /// Adds the module to a core, one in another language in the version that is in force.
    pub(crate) fn add_to(&self, core: &mut Core, interfaces: &Interfaces) -> Result<(), SetupError> {
        match self.kind.loader() {
            Some(load) => self.add_foreign(&load, core, interfaces),
            None => self.kind.add_to(core, &self.name, self.options(), &self.source, interfaces),
        }
    }

    /// The files of a module of a running robot, and what is known of them; `None` for a module in Rust.
    pub(crate) fn live(&self) -> Option<Live> {
        self.kind.loader().map(|load| self.live_by(load))
    }

    fn live_by(&self, load: Arc<LoadForeign>) -> Live {
        let files = self.kind.source_files(&self.source);
        Live::new(load, &self.source, files, Arc::clone(&self.versions.live))
    }

    fn add_foreign(
        &self,
        load: &Arc<LoadForeign>,
        core: &mut Core,
        interfaces: &Interfaces,
    ) -> Result<(), SetupError> {
        let (name, options, source) = (&self.name, self.options(), &self.source);
        let (versions, recorded_failure): (Arc<dyn foreign::Versions>, _) = match &self.versions.recorded {
            Some(versions) => {
                let files = self.kind.source_files(source);
                let recorded = Recorded::new(Arc::clone(load), source, files, Arc::clone(versions));
                let failure = recorded.failure().map(str::to_owned);
                (Arc::new(recorded), failure)
            }
            None => (Arc::new(self.live_by(Arc::clone(load))), None),
        };
        let (interfaces, of_module) = (interfaces.clone(), options.clone());
        let make =
            move || ForeignModule::of_versions(Arc::clone(&versions), interfaces.clone(), of_module.clone());
        if let Some(failure) = recorded_failure {
            return core.add_stopped(name, make, options, &failure);
        }
        let added = core.add_restartable(name, make.clone(), options.clone());
        let may_be_late = self.versions.may_be_late && source.is_reloaded();
        match (added, self.versions.live.failure().filter(|_| may_be_late)) {
            (Err(error), Some(failure)) => {
                tracing::error!("{error}; it starts when its file is saved");
                core.add_stopped(name, make, options, &failure)
            }
            (added, _) => added,
        }
    }
}
