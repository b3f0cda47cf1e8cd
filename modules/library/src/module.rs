//! A library in the process of the robot.

use crate::LibraryOptions;
use crate::instance::{Instance, event_in_c};
use crate::library::Library;
use crate::variables::Shown;
use crate::watch::Watch;
use downbeat_edge::foreign::{Declarations, Event, Foreign, ForeignContext, SavedState};
use downbeat_executor::{Failure, SettingValue, Transition};
use std::fmt;

/// A module of a library that this process has loaded.
pub(crate) struct LibraryModule {
    instance: Instance,
    options: LibraryOptions,
    /// Of a library that is reloaded.
    watch: Option<Watch>,
    shown: Shown,
}

impl LibraryModule {
    pub(crate) fn load(options: &LibraryOptions) -> Result<Self, String> {
        let path = &options.path;
        // Before loading, so that a later change is noticed.
        let watch = options.is_reloaded.then(|| Watch::new(path));
        let library = if options.is_reloaded { Library::load_copy(path) } else { Library::load(path) };
        let library = library.map_err(|error| error.to_string())?;
        let instance = Instance::new(library, &options.module)?;
        tracing::debug!(module = options.module, "loaded {} from {}", instance.sort(), path.display());
        Ok(Self { instance, options: options.clone(), watch, shown: Shown::default() })
    }
}

impl Foreign for LibraryModule {
    fn setup(&mut self, declarations: &mut Declarations) -> Result<(), String> {
        if self.watch.is_some() {
            declarations.reload();
        }
        self.instance.setup(declarations)
    }

    fn handle(&mut self, event: Event, context: &mut ForeignContext<'_, '_>) -> Result<(), Failure> {
        Ok(self.instance.handle(&event_in_c(&event), context)?)
    }

    fn transition(
        &mut self,
        transition: Transition,
        context: &mut ForeignContext<'_, '_>,
    ) -> Result<(), String> {
        self.instance.transition(transition, context)
    }

    fn accept(&mut self, setting: u32, value: &SettingValue) -> Result<(), String> {
        self.instance.accept(setting, value.clone())
    }

    fn successor(&mut self) -> Result<Option<Box<dyn Foreign>>, String> {
        if !self.watch.as_mut().is_some_and(Watch::has_changed) {
            return Ok(None);
        }
        Ok(Some(Box::new(Self::load(&self.options)?)))
    }

    fn save(&mut self) -> Result<SavedState, String> {
        Ok(Box::new(self.instance.save()?))
    }

    fn restore(&mut self, state: SavedState) -> Result<(), String> {
        self.instance.restore(&state_of(state)?)
    }

    fn debug(&self) -> Option<&dyn fmt::Debug> {
        self.shown.keep(self.instance.variables())
    }
}

/// The bytes that a version saved.
pub(crate) fn state_of(state: SavedState) -> Result<Vec<u8>, String> {
    state.downcast().map(|state| *state).map_err(|_| "the state is of another kind of module".to_owned())
}
