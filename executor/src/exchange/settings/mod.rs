//! The mechanism "settings": named, typed values of a module, set at the start and changed in the sync phase.

mod api;

use std::any::Any;
use std::collections::HashMap;
use std::marker::PhantomData;
use std::sync::Arc;

use super::modules::{UnknownModule, find};
use crate::cycle::Stage;
use crate::module::{Causes, ModuleCell, Place, SETTINGS};
use crate::threads::ReceiptSender;
use crate::topics::Report;
use crate::{
    Mechanism, ModuleChange, ModuleId, Port, SettingInfo, SettingValue, SetupError, Step, SyncPhase, Time,
    Version,
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
        let result = result.map(drop).map_err(refused);
        cell.answer(|| answer(receipt, result));
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
