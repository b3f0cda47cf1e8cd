//! The mechanism "settings": named, typed values of a module, set at the start and changed in the sync phase.

use std::any::Any;
use std::collections::HashMap;
use std::marker::PhantomData;
use std::ops::RangeInclusive;
use std::sync::Arc;

use super::modules::{UnknownModule, find};
use crate::cycle::Stage;
use crate::module::{Causes, Direction, Host, ModuleCell, ModuleIo, Place, SETTINGS, Use, UseEnds};
use crate::threads::{ReceiptSender, receipt};
use crate::topics::Report;
use crate::{
    Context, Core, CoreHandle, Mechanism, Module, ModuleChange, ModuleId, Port, Receipt, SettingInfo,
    SettingType, SettingValue, Setup, SetupError, Step, SyncPhase, Time, Version,
};

/// Applies changes of settings in the order of the requests: first those of other threads, then those of
/// modules.
#[derive(Default)]
pub(crate) struct Settings {
    /// Pending commands, each with the module that sent it; `None` for another thread.
    commands: Vec<(Option<ModuleId>, Command)>,
    /// The settings of detached modules, as of their last runs.
    detached: HashMap<ModuleId, Vec<SettingInfo>>,
    /// Changed settings of detached modules that have not been reported yet.
    given: Vec<(Step, Vec<(String, SettingValue)>)>,
}

enum Command {
    Set { module: String, setting: String, value: SettingValue, receipt: SetReceipt },
    Transfer { from: String, to: String, receipt: SetReceipt },
}

type SetReceipt = Option<ReceiptSender<Result<(), SettingRefused>>>;

/// The reason why a setting keeps its value.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SettingRefused {
    /// The core has no module of this name.
    #[error(transparent)]
    UnknownModule(#[from] UnknownModule),
    /// The setting or its module refuses the value.
    #[error("module \"{module}\", setting \"{setting}\": {reason}")]
    Refused {
        /// The module.
        module: String,
        /// The setting.
        setting: String,
        /// The reason of the refusal.
        reason: String,
    },
}

impl Mechanism for Settings {
    type View = ();
    type Port = SettingsPort;

    const NAME: &'static str = "settings";
    const VERSION: Version = Version::new(1, 0);

    fn view(&self) {}

    fn sync(&mut self, phase: &mut SyncPhase<'_>) {
        for (step, given) in std::mem::take(&mut self.given) {
            note_change(phase, step.module, step.time, Some(step.number), given);
        }
        phase.each_asker(SETTINGS, |cell, _| {
            let id = cell.io.id;
            if let Some(port) = cell.port::<SettingsPort>(SETTINGS) {
                self.commands.extend(port.commands.drain(..).map(|command| (Some(id), command)));
            }
        });
        for (by, command) in std::mem::take(&mut self.commands) {
            let (Command::Set { module: target, .. } | Command::Transfer { to: target, .. }) = &command;
            let is_to_self = by.is_some_and(|by| phase.module_name(by) == Some(target));
            if is_to_self && phase.state.drops_commands_to_self {
                continue;
            }
            self.apply(phase, command);
        }
    }

    fn join(&mut self, step: Step, part: Box<dyn Any + Send>) {
        if let Ok(part) = part.downcast::<Part>() {
            let Part { commands, given, infos } = *part;
            self.commands.extend(commands.into_iter().map(|command| (Some(step.module), command)));
            if !given.is_empty() {
                self.detached.insert(step.module, infos);
                self.given.push((step, given));
            }
        }
    }

    fn started(&mut self, phase: &mut SyncPhase<'_>) {
        phase.topics().open_report::<SettingsChange>();
    }
}

impl Settings {
    fn apply(&self, phase: &mut SyncPhase<'_>, command: Command) {
        match command {
            Command::Set { module, setting, value, receipt } => match find(phase, &module) {
                Ok(id) => set(phase, id, setting, value, receipt),
                Err(unknown) => answer(receipt, Err(unknown.into())),
            },
            Command::Transfer { from, to, receipt } => match (find(phase, &from), find(phase, &to)) {
                (Ok(from), Ok(to)) => {
                    self.transfer(phase, from, to);
                    answer(receipt, Ok(()));
                }
                (Err(unknown), _) | (_, Err(unknown)) => answer(receipt, Err(unknown.into())),
            },
        }
    }

    fn transfer(&self, phase: &mut SyncPhase<'_>, from: ModuleId, to: ModuleId) {
        let given = self.infos(phase.stage, from);
        let taken = self.infos(phase.stage, to);
        for SettingInfo { name, value, .. } in given {
            let is_taken =
                |info: &SettingInfo| info.name == name && !info.is_read_only && info.value != value;
            if taken.iter().any(is_taken) {
                set(phase, to, name, value, None);
            }
        }
    }

    /// The settings of a module; those of a detached module with the values after its last run.
    fn infos(&self, stage: &Stage, module: ModuleId) -> Vec<SettingInfo> {
        match module.place {
            Place::Attached(slot) => {
                let infos = stage
                    .cells
                    .look(slot, |cell| cell.io.look::<SettingsPort>(SETTINGS).map(|port| port.infos.clone()));
                infos.flatten().unwrap_or_default()
            }
            Place::Detached(_) => self.detached.get(&module).cloned().unwrap_or_default(),
        }
    }
}

fn set(phase: &mut SyncPhase<'_>, id: ModuleId, setting: String, value: SettingValue, receipt: SetReceipt) {
    let (now, is_attached) = (phase.now(), matches!(id.place, Place::Attached(_)));
    phase.change(id, Causes::SETTINGS, 0, move |cell| {
        let (module, result) = (cell.name().to_string(), put(cell, &setting, value));
        let given = result.as_ref().ok().map(|value| (setting.clone(), value.clone()));
        let refused = |reason| SettingRefused::Refused { module, setting, reason };
        answer(receipt, result.map(drop).map_err(refused));
        if let Some(port) = cell.port::<SettingsPort>(SETTINGS) {
            port.given.extend(given);
        }
        if !is_attached {
            cell.io.ask(SETTINGS);
        }
    });
    if is_attached
        && let Some(cell) = phase.attached(id)
        && let Some(port) = cell.port::<SettingsPort>(SETTINGS)
    {
        let given = std::mem::take(&mut port.given);
        note_change(phase, id, now, None, given);
    }
}

/// Sets a setting of the module, unless the setting or the module refuses the value. Returns the new value.
fn put(cell: &mut ModuleCell, setting: &str, value: SettingValue) -> Result<SettingValue, String> {
    let none = SettingsPort::default();
    let (index, value) = cell.io.look::<SettingsPort>(SETTINGS).unwrap_or(&none).check(setting, value)?;
    cell.accept_setting(index, &value)?;
    if let Some(port) = cell.port::<SettingsPort>(SETTINGS) {
        port.put(index, value.clone());
    }
    Ok(value)
}

/// Publishes the change if the module is a part and the topic has subscribers. Observers are not replayed, so
/// their changes are left out.
fn note_change(
    phase: &mut SyncPhase<'_>,
    module: ModuleId,
    time: Time,
    step: Option<u64>,
    settings: Vec<(String, SettingValue)>,
) {
    if settings.is_empty() || !phase.is_part(module) || !phase.topics().hears::<SettingsChange>() {
        return;
    }
    if let Some(member) = phase.state.members.get(module.order) {
        let module = Arc::clone(&member.name);
        phase.report(SettingsChange { time, module, step, settings });
    }
}

/// Sends the result of a change, or logs a refusal if there is no receipt.
fn answer(receipt: SetReceipt, result: Result<(), SettingRefused>) {
    match (receipt, result) {
        (Some(receipt), result) => receipt.send(result),
        (None, Err(refused)) => tracing::warn!("setting not changed: {refused}"),
        (None, Ok(())) => {}
    }
}

/// Settings of a module that changed while the core ran, published on [`SettingsChange::TOPIC`] if the topic
/// has subscribers. A replay uses it to repeat the change at the same point.
#[derive(Clone, Debug, PartialEq)]
pub struct SettingsChange {
    /// For a module inside the cycle, the time of the cycle whose sync phase applied the change; for a
    /// detached module, the time of its first run with the new values.
    pub time: Time,
    /// The module's name.
    pub module: Arc<str>,
    /// For a detached module, the number of the first run with the new values.
    pub step: Option<u64>,
    /// The name and value of each setting, in the order in which they were set.
    pub settings: Vec<(String, SettingValue)>,
}

impl SettingsChange {
    /// The topic on which changes are published.
    pub const TOPIC: &'static str = "executor/settings";
}

impl Report for SettingsChange {
    const TOPIC: &'static str = Self::TOPIC;
    const NUMBER: usize = 1;
}

/// A module's key to one of its settings, read with [`Context::get`](crate::Context::get).
pub struct Setting<T> {
    pub(crate) index: usize,
    kind: PhantomData<fn() -> T>,
}

impl<T> Setting<T> {
    fn new(index: usize) -> Self {
        Self { index, kind: PhantomData }
    }
}

impl<T> Clone for Setting<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Setting<T> {}

/// The settings of one module, and its requests to change those of other modules.
#[derive(Default)]
pub(crate) struct SettingsPort {
    infos: Vec<SettingInfo>,
    /// The settings whose callbacks have to be called.
    changed: Vec<usize>,
    /// The settings changed since the last run; only for a module on another thread.
    given: Vec<(String, SettingValue)>,
    commands: Vec<Command>,
}

impl Port for SettingsPort {
    fn changed(&mut self, change: ModuleChange<'_>) -> bool {
        if let ModuleChange::Panicked = change {
            self.commands.clear();
        }
        false
    }

    fn split_off(&mut self) -> Option<Box<dyn Any + Send>> {
        let given = std::mem::take(&mut self.given);
        let infos = if given.is_empty() { Vec::new() } else { self.infos.clone() };
        Some(Box::new(Part { commands: std::mem::take(&mut self.commands), given, infos }))
    }
}

/// The output of a detached module's run.
struct Part {
    commands: Vec<Command>,
    /// The settings changed before the run, in order.
    given: Vec<(String, SettingValue)>,
    /// All settings of the module, if some have changed.
    infos: Vec<SettingInfo>,
}

impl SettingsPort {
    pub(crate) fn declared(&self) -> Vec<SettingInfo> {
        self.infos.clone()
    }

    /// Adds a setting, with the given value or else its default.
    fn declare(
        &mut self,
        module: &str,
        mut info: SettingInfo,
        given: Option<SettingValue>,
    ) -> Result<usize, SetupError> {
        if self.position(&info.name).is_some() {
            return Err(SetupError::DuplicateSetting { module: module.into(), setting: info.name });
        }
        let value = given.unwrap_or_else(|| info.value.clone());
        info.value = info.check(value).map_err(|refusal| SetupError::SettingValue {
            module: module.into(),
            setting: info.name.clone(),
            refusal,
        })?;
        self.infos.push(info);
        Ok(self.infos.len() - 1)
    }

    fn value(&self, index: usize) -> Option<&SettingValue> {
        self.infos.get(index).map(|info| &info.value)
    }

    /// The index of a setting, and the value converted to its type. The error states why the value is
    /// refused.
    fn check(&self, name: &str, value: SettingValue) -> Result<(usize, SettingValue), String> {
        let index = self.position(name).ok_or_else(|| {
            let known: Vec<_> = self.infos.iter().map(|info| info.name.as_str()).collect();
            format!("there is no such setting; there is {}", known.join(", "))
        })?;
        if self.infos[index].is_read_only {
            return Err("it is read-only; give it in the robot file".into());
        }
        Ok((index, self.infos[index].check(value)?))
    }

    /// Sets a checked value; the module's callback runs in its next run.
    fn put(&mut self, index: usize, value: SettingValue) {
        if self.infos[index].value != value {
            self.infos[index].value = value;
            if !self.changed.contains(&index) {
                self.changed.push(index);
            }
        }
    }

    fn take_change(&mut self) -> Option<usize> {
        (!self.changed.is_empty()).then(|| self.changed.remove(0))
    }

    fn position(&self, name: &str) -> Option<usize> {
        self.infos.iter().position(|info| info.name == name)
    }
}

impl<M: Module> Setup<'_, M> {
    /// Declares a setting; the key is for [`Context::get`].
    ///
    /// # Errors
    /// If the name is used twice, or the given value has another type.
    pub fn setting<T: SettingType>(
        &mut self,
        name: &str,
        default: T,
        description: &str,
    ) -> Result<Setting<T>, SetupError> {
        self.declare_setting(SettingInfo::new(name, default, description))
    }

    /// Declares a setting that must lie in a range.
    ///
    /// # Errors
    /// If the name is used twice, or the default or the given value has another type or is out of range.
    pub fn setting_in<T: SettingType>(
        &mut self,
        name: &str,
        default: T,
        range: RangeInclusive<f64>,
        description: &str,
    ) -> Result<Setting<T>, SetupError> {
        let range = Some(range);
        self.declare_setting(SettingInfo { range, ..SettingInfo::new(name, default, description) })
    }

    /// Declares a setting that is set before the start and cannot change after it.
    ///
    /// # Errors
    /// If the name is used twice, or the given value has another type.
    ///
    /// ```
    /// # use std::time::Duration;
    /// # use downbeat_executor::{Core, ManualClock, Module, ModuleOptions, Setup, SetupError, Time};
    /// struct Servos;
    ///
    /// impl Module for Servos {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         setup.read_only_setting("port", "/dev/ttyUSB0".to_owned(), "serial device")?;
    ///         Ok(())
    ///     }
    /// }
    ///
    /// let settings = [("port".to_owned(), "/dev/ttyACM0".to_owned().into())].into();
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add_with("servos", Servos, ModuleOptions { settings, ..ModuleOptions::default() })?;
    /// let refused = core.handle().set("servos", "port", "/dev/null".to_owned());
    /// core.cycle()?;
    /// assert!(refused.try_take().unwrap().is_err());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn read_only_setting<T: SettingType>(
        &mut self,
        name: &str,
        default: T,
        description: &str,
    ) -> Result<Setting<T>, SetupError> {
        self.declare_setting(SettingInfo {
            is_read_only: true,
            ..SettingInfo::new(name, default, description)
        })
    }

    /// Declares a text setting with fixed choices, which is set before the start and cannot change after it.
    ///
    /// # Errors
    /// If the name is used twice, or the default or the given value is not one of the choices.
    ///
    /// ```
    /// # use downbeat_executor::{Core, Module, ModuleOptions, Setup, SetupError};
    /// struct Camera;
    ///
    /// impl Module for Camera {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         setup.read_only_choice("format", "rgb8", &["rgb8", "mono8"], "of the pixels")?;
    ///         Ok(())
    ///     }
    /// }
    ///
    /// let settings = [("format".to_owned(), "rbg8".to_owned().into())].into();
    /// let options = ModuleOptions { settings, ..ModuleOptions::default() };
    /// let refused = Core::new().add_with("camera", Camera, options).unwrap_err();
    /// assert!(refused.to_string().contains("\"rbg8\" is none of rgb8, mono8"));
    /// ```
    pub fn read_only_choice(
        &mut self,
        name: &str,
        default: &str,
        choices: &[&str],
        description: &str,
    ) -> Result<Setting<String>, SetupError> {
        let choices = choices.iter().map(|&choice| choice.to_owned()).collect();
        self.declare_setting(SettingInfo {
            choices,
            is_read_only: true,
            ..SettingInfo::new(name, default.to_owned(), description)
        })
    }

    /// Calls `callback` when the value of a setting has changed.
    pub fn on_change<T, F>(&mut self, setting: Setting<T>, callback: F)
    where
        F: FnMut(&mut M, &mut Context<'_, M::Ports>) + Send + 'static,
    {
        let next = |io: &mut ModuleIo, _| io.port::<SettingsPort>(SETTINGS)?.take_change();
        self.steps.add_chosen(Causes::SETTINGS, next, setting.index, callback);
    }

    /// The initial value of a setting, for modules that need it before they run.
    #[must_use]
    pub fn value<T: SettingType>(&self, setting: Setting<T>) -> Option<&T> {
        self.io.look::<SettingsPort>(SETTINGS)?.value(setting.index).and_then(T::from_value)
    }

    /// Calls `check` with each new value of a setting before it takes effect while the module runs. If
    /// `check` returns an error text, the value is refused and nothing changes. `check` runs in the sync
    /// phase, or on the module's thread if the module is detached.
    ///
    /// ```
    /// # use std::time::Duration;
    /// # use downbeat_executor::{Core, ManualClock, Module, ModuleOptions, Setup, SetupError, Time};
    /// struct Camera;
    ///
    /// impl Module for Camera {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         let width = setup.setting("width", 640_i64, "of the image, pixels")?;
    ///         setup.accept_if(width, |_, width| match width % 16 {
    ///             0 => Ok(()),
    ///             _ => Err(format!("{width} is not a multiple of 16")),
    ///         });
    ///         Ok(())
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add("camera", Camera)?;
    /// let refused = core.handle().set("camera", "width", 600_i64);
    /// core.cycle()?;
    /// assert!(refused.try_take().unwrap().unwrap_err().to_string().contains("600 is not a multiple of 16"));
    /// assert_eq!(core.settings("camera").unwrap()[0].value, 640_i64.into());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn accept_if<T, F>(&mut self, setting: Setting<T>, mut check: F)
    where
        T: SettingType,
        F: FnMut(&mut M, &T) -> Result<(), String> + Send + 'static,
    {
        let check = move |module: &mut M, value: &SettingValue| {
            T::from_value(value).map_or(Ok(()), |value| check(module, value))
        };
        self.steps.checks.push((setting.index, Box::new(check)));
    }

    /// An error that refuses the given value of a setting, with a reason.
    #[must_use]
    pub fn refuse_value<T>(&self, setting: Setting<T>, refusal: impl Into<String>) -> SetupError {
        let settings = self.io.look::<SettingsPort>(SETTINGS).map_or(&[][..], |port| &port.infos);
        SetupError::SettingValue {
            module: self.io.name.to_string(),
            setting: settings.get(setting.index).map(|info| info.name.clone()).unwrap_or_default(),
            refusal: refusal.into(),
        }
    }

    fn declare_setting<T: SettingType>(&mut self, info: SettingInfo) -> Result<Setting<T>, SetupError> {
        let given = self.take_given_setting(&info.name);
        let (name, place) = (Arc::clone(&self.io.name), self.io.id.place);
        let port = self.io.open_own::<SettingsPort>(SETTINGS);
        let index = port.declare(&name, info, given)?;
        if let Place::Detached(_) = place {
            let info = port.infos[index].clone();
            if let Some(settings) = settings_of(self.host) {
                settings.detached.entry(self.io.id).or_default().push(info);
            }
            self.uses.push(Use {
                of: SETTINGS,
                direction: Direction::In,
                index,
                ends: UseEnds::AtEnd,
                give_back: |host, module, _| {
                    settings_of(host).map(|settings| settings.detached.remove(&module));
                },
            });
        }
        Ok(Setting::new(index))
    }
}

fn settings_of(host: &mut dyn Host) -> Option<&mut Settings> {
    host.mechanism(SETTINGS)?.downcast_mut()
}

impl<P> Context<'_, P> {
    /// The value of a setting in this cycle.
    #[must_use]
    pub fn get<T: SettingType>(&self, setting: Setting<T>) -> &T {
        let port = self.look::<SettingsPort>(SETTINGS);
        match port.and_then(|port| port.value(setting.index)).and_then(T::from_value) {
            Some(value) => value,
            None => self.foreign("read a setting with"),
        }
    }

    /// Changes a setting of this module or another. A refused value is logged, and nothing changes.
    pub fn set(&mut self, module: &str, setting: &str, value: impl Into<SettingValue>) {
        let (module, setting, value) = (module.to_owned(), setting.to_owned(), value.into());
        self.set_later(Command::Set { module, setting, value, receipt: None });
    }

    /// Copies the current values of the settings of `from` to `to` in the sync phase, for all settings that
    /// both have and `to` does not refuse. This is for a module that replaces another.
    ///
    /// ```
    /// # use downbeat_executor::{Core, ManualClock, Module, ModuleOptions, Setup, SetupError, Time};
    /// struct Gait;
    ///
    /// impl Module for Gait {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         let step = setup.setting("step_length", 0.03, "m")?;
    ///         // The name by which the next gait is asked for.
    ///         setup.subscribe::<String, _>("next_gait", move |_, name, ctx| {
    ///             let old = ctx.module_name().to_owned();
    ///             assert!(*ctx.get(step) > 0.0);
    ///             ctx.add(&name, Gait, ModuleOptions::default());
    ///             ctx.transfer_settings(&old, &name); // Additions come before settings.
    ///         })
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// let settings = [("step_length".to_owned(), 0.05.into())].into();
    /// core.add_with("walk", Gait, ModuleOptions { settings, ..ModuleOptions::default() })?;
    /// core.inlet("next_gait")?.publish("trot".to_owned())?;
    /// core.cycle()?;
    /// core.cycle()?;
    /// assert_eq!(core.settings("trot").unwrap()[0].value, 0.05.into());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn transfer_settings(&mut self, from: &str, to: &str) {
        self.set_later(Command::Transfer { from: from.to_owned(), to: to.to_owned(), receipt: None });
    }

    fn set_later(&mut self, command: Command) {
        self.io().ask(SETTINGS);
        self.io().open_own::<SettingsPort>(SETTINGS).commands.push(command);
    }
}

impl Core {
    /// The settings of a module; `None` if there is no such module.
    #[must_use]
    pub fn settings(&self, module: &str) -> Option<Vec<SettingInfo>> {
        let id = self.state.members.find(module)?.id;
        Some(self.mechanisms.get::<Settings>(SETTINGS)?.infos(&self.stage, id))
    }

    /// The settings declared by the module whose setup failed most recently; for descriptions of modules that
    /// lack a required setting.
    #[must_use]
    pub fn refused_settings(&self) -> &[SettingInfo] {
        &self.state.refused_settings
    }
}

impl CoreHandle {
    /// Changes a setting of a module.
    pub fn set(
        &self,
        module: &str,
        setting: &str,
        value: impl Into<SettingValue>,
    ) -> Receipt<Result<(), SettingRefused>> {
        let (module, setting, value) = (module.to_owned(), setting.to_owned(), value.into());
        self.set_later(|receipt| Command::Set { module, setting, value, receipt })
    }

    /// Copies the values of the settings of `from` to `to`, see
    /// [`Context::transfer_settings`](crate::Context::transfer_settings).
    pub fn transfer_settings(&self, from: &str, to: &str) -> Receipt<Result<(), SettingRefused>> {
        let (from, to) = (from.to_owned(), to.to_owned());
        self.set_later(|receipt| Command::Transfer { from, to, receipt })
    }

    /// The settings of a module with their values; `None` if there is no such module.
    #[must_use = "the answer is in the receipt"]
    pub fn settings(&self, module: &str) -> Receipt<Option<Vec<SettingInfo>>> {
        let module = module.to_owned();
        self.ask(move |phase| {
            let id = phase.state.members.find(&module)?.id;
            Some(phase.mechanisms.get::<Settings>(SETTINGS)?.infos(phase.stage, id))
        })
    }

    fn set_later(&self, command: impl FnOnce(SetReceipt) -> Command) -> Receipt<Result<(), SettingRefused>> {
        let (sender, receipt) = receipt();
        if !self.link.is_closed() {
            let command = command(Some(sender));
            self.link.post(SETTINGS, |settings: &mut Settings| settings.commands.push((None, command)));
        }
        receipt
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn set(settings: &mut SettingsPort, name: &str, value: SettingValue) -> Result<(), String> {
        settings.check(name, value).map(|(index, value)| settings.put(index, value))
    }

    fn gain() -> SettingInfo {
        let (name, description) = ("gain".into(), String::new());
        SettingInfo {
            name,
            description,
            value: SettingValue::Double(1.0),
            range: Some(0.0..=4.0),
            choices: Vec::new(),
            is_read_only: false,
        }
    }

    #[test]
    fn a_whole_number_is_a_valid_double() {
        let mut settings = SettingsPort::default();
        settings.declare("m", gain(), Some(SettingValue::Integer(2))).unwrap();
        assert_eq!(settings.value(0), Some(&SettingValue::Double(2.0)));
    }

    #[test]
    fn whole_numbers_are_valid_bytes_where_they_fit() {
        let mut settings = SettingsPort::default();
        let mask = SettingInfo { value: vec![1_u8].into(), range: Some(0.0..=254.0), ..gain() };
        settings.declare("m", mask, Some(vec![0_i64, 254].into())).unwrap();
        assert_eq!(settings.value(0), Some(&vec![0_u8, 254].into()));
        for (wrong, word) in [(256_i64, "found 256"), (-1, "found -1"), (255, "255 is out of range")] {
            let refusal = set(&mut settings, "gain", vec![wrong].into()).unwrap_err();
            assert!(refusal.contains(word), "{refusal}");
        }
    }

    #[test]
    fn an_empty_list_is_valid_for_every_list() {
        for list in [SettingValue::Bools(vec![true]), vec![1_u8].into(), vec![0.5].into()] {
            let mut settings = SettingsPort::default();
            let empty = Vec::<i64>::new();
            settings.declare("m", SettingInfo { value: list, range: None, ..gain() }, None).unwrap();
            set(&mut settings, "gain", empty.into()).unwrap();
        }
    }

    #[test]
    fn each_number_of_a_list_must_lie_in_the_range() {
        let mut settings = SettingsPort::default();
        settings.declare("m", SettingInfo { value: vec![1.0, 2.0].into(), ..gain() }, None).unwrap();
        assert!(
            set(&mut settings, "gain", vec![3.0, 4.5].into()).unwrap_err().starts_with("4.5 is out of range")
        );
        set(&mut settings, "gain", vec![3.0, 4.0].into()).unwrap();
    }

    #[test]
    fn a_setting_changed_twice_before_its_module_runs_is_announced_once() {
        let mut settings = SettingsPort::default();
        settings.declare("m", gain(), None).unwrap();
        set(&mut settings, "gain", 2.0.into()).unwrap();
        set(&mut settings, "gain", 3.0.into()).unwrap();
        assert_eq!((settings.take_change(), settings.take_change()), (Some(0), None));
    }

    #[test]
    fn a_value_of_another_kind_or_out_of_range_is_refused_and_changes_nothing() {
        let mut settings = SettingsPort::default();
        settings.declare("m", gain(), None).unwrap();
        for (value, word) in [(SettingValue::Bool(true), "expected double"), (5.0.into(), "out of range")] {
            let refusal = set(&mut settings, "gain", value).unwrap_err();
            assert!(refusal.contains(word), "{refusal}");
        }
        assert_eq!(settings.value(0), Some(&SettingValue::Double(1.0)));
        assert!(settings.take_change().is_none());
        assert!(set(&mut settings, "gian", 1.0.into()).unwrap_err().contains("gain"));
    }
}
