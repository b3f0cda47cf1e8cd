//! The state of a core between its cycles.

use std::sync::Arc;

use super::agenda::Agenda;
use super::detached::DetachedModule;
use super::members::{Member, Members, ModuleInfo};
use super::stage::{Askers, Stage};
use crate::module::{Link, Place, StepOutcome};
use crate::observe::Inspector;
use crate::threads::Watchdog;
use crate::{Clock, ModuleId, SettingInfo, Time};

/// The state of the core besides its stage and its mechanisms.
pub(crate) struct CoreState {
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) link: Arc<Link>,
    pub(crate) members: Members,
    pub(crate) agenda: Agenda,
    /// By slot.
    pub(crate) detached: Vec<Option<DetachedModule>>,
    /// The modules that have made requests in this cycle, in the order of registration.
    pub(crate) askers: Askers,
    /// The runs of detached modules that joined in this sync phase, in the order in which they ended.
    pub(crate) steps: Vec<StepOutcome>,
    /// The modules whose last callback has run, by their position in the order of registration.
    pub(crate) leaving: Vec<u64>,
    /// The times of pending restarts after a panic, by the module's position in the order of registration.
    pub(crate) restarts: Vec<(Time, u64)>,
    /// Removed modules whose removal has not been reported to the mechanisms.
    pub(crate) gone: Vec<ModuleId>,
    /// True if modules leave or are gone, or detached modules have run, so that the sync phase has to clean
    /// up at its end.
    pub(crate) has_ends: bool,
    /// Slots of the stage that were freed in this sync phase.
    pub(crate) freed_slots: Vec<usize>,
    pub(crate) inspector: Inspector,
    pub(crate) watchdog: Watchdog,
    /// Counts the cycles from 0.
    pub(crate) cycle: u64,
    pub(crate) life: CoreLife,
    pub(crate) pause: Pause,
    /// The settings that the most recently refused module had declared.
    pub(crate) refused_settings: Vec<SettingInfo>,
    /// True if modules' commands to themselves are dropped, except for their removal.
    pub(crate) drops_commands_to_self: bool,
}

/// The lifecycle of a core.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CoreLife {
    New,
    Running,
    Stopped,
}

/// Whether the whole core is paused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Pause {
    #[default]
    Running,
    /// Paused, after this number of further cycles.
    Paused { steps: u32 },
}

impl CoreState {
    pub(crate) fn new(clock: Arc<dyn Clock>, link: Arc<Link>) -> Self {
        Self {
            clock,
            inspector: Inspector::new(Arc::clone(&link.timing)),
            link,
            members: Members::default(),
            agenda: Agenda::default(),
            detached: Vec::new(),
            askers: Askers::default(),
            steps: Vec::new(),
            leaving: Vec::new(),
            restarts: Vec::new(),
            gone: Vec::new(),
            has_ends: false,
            freed_slots: Vec::new(),
            watchdog: Watchdog::new(),
            cycle: 0,
            life: CoreLife::New,
            pause: Pause::default(),
            refused_settings: Vec::new(),
            drops_commands_to_self: false,
        }
    }

    pub(crate) fn free_detached_slot(&mut self) -> usize {
        self.detached.iter().position(Option::is_none).unwrap_or_else(|| {
            self.detached.push(None);
            self.detached.len() - 1
        })
    }

    /// Marks a module whose last callback has run; it is removed at the end of the sync phase.
    pub(crate) fn leave(&mut self, order: u64) {
        self.leaving.push(order);
        self.has_ends = true;
    }

    /// The detached module, unless it is gone.
    pub(crate) fn detached(&mut self, module: ModuleId) -> Option<&mut DetachedModule> {
        let Place::Detached(slot) = module.place else { return None };
        self.detached.get_mut(slot)?.as_mut().filter(|known| known.id == module)
    }

    /// The descriptions of the modules, in the order of registration.
    pub(crate) fn modules(&self, stage: &Stage) -> Vec<ModuleInfo> {
        let describe = |member: &Member| {
            let (state, is_paused) = match member.id.place {
                Place::Attached(slot) => stage.cells.look(slot, |cell| (cell.state(), cell.is_paused()))?,
                Place::Detached(slot) => {
                    self.detached[slot].as_ref().map(|module| (module.state, module.is_paused))?
                }
            };
            let is_detached = matches!(member.id.place, Place::Detached(_));
            let (name, role, restarts) = (Arc::clone(&member.name), member.role(), member.restarts);
            let panic = member.panic.clone();
            Some(ModuleInfo { name, state, role, is_detached, is_paused, restarts, panic })
        };
        self.members.iter().filter_map(describe).collect()
    }
}
