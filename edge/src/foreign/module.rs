//! A module in another language as a module of a core: its versions, and what is passed to it.

use super::contract::{Event, Foreign, ForeignContext, MakeForeign, Ports, ReplyEncoded, SavedState};
use super::declarations::Declarations;
use super::versions::{Life, Made, OneVersion, StopsByPanic, Versions};
use bytes::Bytes;
use downbeat_executor::{Context, ModuleOptions, SettingValue, Transition};
use parking_lot::Mutex;
use std::sync::Arc;

/// A [`Foreign`] as a module of a core, see [`ForeignModule::new`].
pub struct ForeignModule {
    /// `None` once the module has a successor.
    pub(super) foreign: Option<Box<dyn Foreign>>,
    pub(super) versions: Arc<dyn Versions>,
    /// Of a successor: the version, for a recording.
    pub(super) description: Option<Vec<u8>>,
    pub(super) interfaces: crate::Interfaces,
    pub(super) options: ModuleOptions,
    /// Set for a successor, and for one that goes on because its successor was refused.
    pub(super) declared: Option<Arc<Declarations>>,
    pub(super) ports: Ports,
}

impl ForeignModule {
    /// A module whose [`Foreign`] `make` makes: in its setup, and again after each panic.
    #[must_use]
    pub fn new(make: Arc<MakeForeign>, interfaces: crate::Interfaces, options: ModuleOptions) -> Self {
        Self::of_versions(Arc::new(OneVersion(make)), interfaces, options)
    }

    /// A module whose versions are known: what they are made from is
    /// [described](downbeat_executor::Setup::made_from).
    #[must_use]
    pub fn of_versions(
        versions: Arc<dyn Versions>,
        interfaces: crate::Interfaces,
        options: ModuleOptions,
    ) -> Self {
        Self {
            foreign: None,
            versions,
            description: None,
            interfaces,
            options,
            declared: None,
            ports: Ports::default(),
        }
    }

    /// The same with a module that was set up.
    fn prepared(
        &self,
        foreign: Box<dyn Foreign>,
        declared: Arc<Declarations>,
        options: ModuleOptions,
    ) -> Self {
        let new = Self::of_versions(Arc::clone(&self.versions), self.interfaces.clone(), options);
        Self { foreign: Some(foreign), declared: Some(declared), ..new }
    }

    pub(super) fn take(&mut self, event: Event, context: &mut Context<'_>) {
        let Self { foreign: Some(foreign), ports, versions, .. } = self else { return };
        let _noting = StopsByPanic(&**versions);
        if let Err(failure) = foreign.handle(event, &mut ForeignContext { context, ports }) {
            // Not `panic!`, which would log the place in this file.
            std::panic::resume_unwind(Box::new(failure));
        }
    }

    /// Takes a request of the server with this number.
    pub(super) fn take_request(
        &mut self,
        server: u32,
        cdr: Bytes,
        reply: ReplyEncoded,
        context: &mut Context<'_>,
    ) {
        let request = self.ports.requests;
        self.ports.requests += 1;
        self.ports.open.insert(request, reply);
        self.take(Event::Request { server, request, cdr }, context);
    }

    /// Takes the end of a call of the client with this number.
    pub(super) fn take_reply(
        &mut self,
        client: u32,
        call: u64,
        result: Result<Bytes, String>,
        context: &mut Context<'_>,
    ) {
        self.take(Event::Reply { client, call, result }, context);
    }

    pub(super) fn make_transition(
        &mut self,
        transition: Transition,
        context: &mut Context<'_>,
    ) -> Result<(), String> {
        let Self { foreign: Some(foreign), ports, versions, .. } = self else { return Ok(()) };
        let _noting = StopsByPanic(&**versions);
        let result = foreign.transition(transition, &mut ForeignContext { context, ports });
        match (&result, transition) {
            (_, Transition::Shutdown) => {}
            (Ok(()), Transition::Activate) => versions.note(Life::Runs),
            (Ok(()), _) => {}
            (Err(_), _) => versions.note(Life::Stopped),
        }
        result
    }

    /// Schedules the next reload of a replay.
    pub(super) fn schedule_reload(&self, context: &mut Context<'_>) {
        let due = self.versions.next_reload().filter(|due| *due > context.now());
        if let (Some(task), Some(due)) = (self.ports.reload, due) {
            context.schedule_after(task, due.saturating_since(context.now()));
        }
    }

    /// Lets a newer version take over, if there is one.
    pub(super) fn look_for_successor(&mut self, context: &mut Context<'_>) {
        let Some(foreign) = &mut self.foreign else { return };
        let (module, now) = (context.module_name().to_owned(), context.now());
        let successor = match self.versions.successor(&mut **foreign, now) {
            Ok(None) => return,
            Ok(Some(successor)) => self.prepare_successor(successor, context),
            Err(reason) => Err(reason),
        };
        let source = self.versions.source();
        let (successor, declarations) = match successor {
            Ok(successor) => successor,
            Err(reason) => {
                tracing::error!(
                    module,
                    "{source} was saved and is not reloaded, the version before goes on: {reason}"
                );
                return;
            }
        };
        let (Some(current), Some(declared)) = (self.foreign.take(), self.declared.clone()) else { return };
        let options = self.options_for(&declarations, context);
        tracing::info!(module, "{source} was saved and is reloaded");
        let mut new = self.prepared(successor, Arc::new(declarations), options.clone());
        new.description = self.versions.describe(Made::Reloaded(now));
        let fallback = self.prepared(current, declared, options.clone());
        context.replace_self(options, first_then_new(new), first_then_new(fallback));
    }

    fn prepare_successor(
        &mut self,
        mut successor: Box<dyn Foreign>,
        context: &mut Context<'_>,
    ) -> Result<(Box<dyn Foreign>, Declarations), String> {
        // What was set while the module ran comes before what it was given at the start.
        let mut given = self.options.settings.clone();
        given.extend(self.settings(context));
        let mut declarations =
            Declarations::new(context.module_name(), given).with_interfaces(self.interfaces.clone());
        successor.setup(&mut declarations)?;
        let state = self.foreign.as_mut().map_or_else(|| Ok(Box::new(()) as SavedState), |old| old.save())?;
        successor.restore(state)?;
        Ok((successor, declarations))
    }

    /// The current values of the settings.
    fn settings(&self, context: &Context<'_>) -> Vec<(String, SettingValue)> {
        let names = self.declared.iter().flat_map(|declared| &declared.settings);
        let values = self.ports.settings.iter().map(|&setting| context.get(setting).clone());
        names.map(|setting| setting.name.clone()).zip(values).collect()
    }

    /// The options with which a successor joins: settings that it has too keep their values.
    fn options_for(&self, declarations: &Declarations, context: &Context<'_>) -> ModuleOptions {
        let mut options = self.options.clone();
        let is_declared = |name: &str| declarations.settings.iter().any(|setting| setting.name == name);
        options.settings.extend(self.settings(context).into_iter().filter(|(name, _)| is_declared(name)));
        options
    }
}

/// A factory that returns `module` first, and then modules that are made anew.
fn first_then_new(module: ForeignModule) -> impl FnMut() -> ForeignModule + Send + 'static {
    let (versions, interfaces, options) =
        (Arc::clone(&module.versions), module.interfaces.clone(), module.options.clone());
    let first = Mutex::new(Some(module));
    move || {
        let first = first.lock().take();
        first.unwrap_or_else(|| {
            ForeignModule::of_versions(Arc::clone(&versions), interfaces.clone(), options.clone())
        })
    }
}
