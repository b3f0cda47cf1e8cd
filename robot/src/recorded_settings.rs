//! The settings with which the modules of a recorded robot started: a bag holds them, and a replay uses them.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use downbeat_bags::metadata::Metadata;
use downbeat_executor::{SettingInfo, SettingValue};
use serde::{Deserialize, Serialize};

use super::Robot;
use super::file::{Given, Place, RobotFile};

/// The key of a bag's custom data that holds them, as JSON.
const KEY: &str = "module_settings";

/// By module and setting.
type Recorded = BTreeMap<String, BTreeMap<String, Setting>>;

#[derive(Debug, Serialize, Deserialize)]
struct Setting {
    value: Value,
    /// Whether the robot file or the command line gave it; otherwise it is the module's default, or was set
    /// while the robot ran.
    given: bool,
    /// Whether it was set while the robot ran, before the recording began.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    set: bool,
}

/// A value that reads back as it was, bit for bit: numbers with a point are texts.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Value {
    Bool(bool),
    Integer(i64),
    Double(String),
    Text(String),
    Bools(Vec<bool>),
    Bytes(Vec<u8>),
    Integers(Vec<i64>),
    Doubles(Vec<String>),
    Texts(Vec<String>),
}

/// A setting whose value in the robot file, or on the command line, is not the one with which the recording
/// began.
#[derive(Clone, Debug, PartialEq)]
pub struct ChangedSetting {
    /// The module.
    pub module: String,
    /// The setting.
    pub setting: String,
    /// The value in the recording; `None` if the module had no such setting.
    pub recorded: Option<SettingValue>,
    /// The value that is given now; `None` if none is.
    pub now: Option<SettingValue>,
    /// True if it was given for the replay, on the command line or in a parameter file, and so is used.
    /// Otherwise the recorded value is, unless there is none.
    pub is_explicit: bool,
}

/// The modules of a robot, and their settings before it started.
pub(crate) struct RecordedSettings(Vec<AtTheStart>);

struct AtTheStart {
    module: String,
    given: BTreeSet<String>,
    values: BTreeMap<String, SettingValue>,
}

impl RecordedSettings {
    pub(crate) fn of(robot: &Robot) -> Self {
        let modules = robot.file.modules.iter().map(|module| {
            let infos = robot.core.settings(&module.name).unwrap_or_default();
            AtTheStart {
                module: module.name.clone(),
                given: module.settings.keys().cloned().collect(),
                values: infos.into_iter().map(|info| (info.name, info.value)).collect(),
            }
        });
        Self(modules.collect())
    }

    /// The entry of the custom data of a bag that begins with these values.
    pub(crate) fn entry(
        &self,
        mut settings_of: impl FnMut(&str) -> Option<Vec<SettingInfo>>,
    ) -> Option<(&'static str, String)> {
        let mut recorded = Recorded::new();
        for AtTheStart { module, given, values } in &self.0 {
            let infos = settings_of(module).unwrap_or_default().into_iter();
            let settings = infos.map(|info| {
                let given = given.contains(&info.name);
                let set = values.get(&info.name).is_some_and(|value| *value != info.value);
                (info.name, Setting { value: Value::from(info.value), given, set })
            });
            recorded.insert(module.clone(), settings.collect());
        }
        (!recorded.is_empty()).then(|| (KEY, serde_json::json!(recorded).to_string()))
    }
}

/// The modules of the recorded robot. Older bags name only those with settings; `None` if a bag names none.
pub(crate) fn recorded_modules(bag: &Metadata) -> Option<BTreeSet<String>> {
    let recorded: Recorded = serde_json::from_str(bag.custom_data.get(KEY)?).ok()?;
    Some(recorded.into_keys().collect())
}

/// Gives the modules of a robot file the settings with which they were recorded, except for settings that
/// were given for the replay and those that name files. Returns what differs. A bag without settings changes
/// nothing.
pub(crate) fn use_recorded_settings(file: &mut RobotFile, bag: &Metadata) -> Vec<ChangedSetting> {
    let recorded = bag.custom_data.get(KEY).and_then(|text| serde_json::from_str::<Recorded>(text).ok());
    let mut recorded = recorded.unwrap_or_default();
    let mut changes = Vec::new();
    for module in &mut file.modules {
        let Some(settings) = recorded.remove(&module.name) else { continue };
        let line = Place::Line(module.line);
        let is_new = |(name, given): &(&String, &Given)| !settings.contains_key(*name) && !given.is_wildcard;
        for (name, given) in module.settings.iter().filter(is_new) {
            let now = Some(given.value.clone());
            let (module, setting) = (module.name.clone(), name.clone());
            // There is no other value to use.
            changes.push(ChangedSetting { module, setting, recorded: None, now, is_explicit: true });
        }
        for (name, Setting { value, given: was_given, set }) in settings {
            let Ok(value) = SettingValue::try_from(value) else { continue };
            if module.kind.files().contains(&name) {
                continue;
            }
            let given = module.settings.get(&name);
            let is_explicit = given.is_some_and(|given| given.place.is_for_this_run());
            let now = given.map(|given| given.value.clone());
            let is_same = now.clone().is_some_and(|now| now.into_kind_of(&value).as_ref() == Ok(&value));
            if is_same || (now.is_none() && !was_given && !set) {
                continue;
            }
            if !is_explicit {
                // A module that has no such setting any more goes without.
                let given = Given { place: line.clone(), value: value.clone(), is_wildcard: true };
                module.settings.insert(name.clone(), given);
            }
            // What was set while the robot ran is no change of the file.
            if now.is_some() || was_given {
                let module = module.name.clone();
                changes.push(ChangedSetting {
                    module,
                    setting: name,
                    recorded: Some(value),
                    now,
                    is_explicit,
                });
            }
        }
    }
    changes
}

impl fmt::Display for ChangedSetting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { module, setting, recorded, now, is_explicit } = self;
        write!(f, "{module}.{setting}: ")?;
        match (recorded, now) {
            (Some(recorded), Some(now)) if *is_explicit => {
                write!(f, "recorded with {recorded}, replayed with {now} as given for the replay")
            }
            (Some(recorded), Some(now)) => {
                write!(
                    f,
                    "replayed with {recorded} as recorded; it is {now} now, give it with -p {module}.{setting}:={now} to replay with that"
                )
            }
            (Some(recorded), None) => {
                write!(f, "replayed with {recorded} as recorded; the robot file no longer gives it")
            }
            (None, Some(now)) => write!(f, "replayed with {now}; the recorded module had no such setting"),
            (None, None) => Ok(()),
        }
    }
}

impl From<SettingValue> for Value {
    fn from(value: SettingValue) -> Self {
        match value {
            SettingValue::Bool(value) => Self::Bool(value),
            SettingValue::Integer(value) => Self::Integer(value),
            SettingValue::Double(value) => Self::Double(value.to_string()),
            SettingValue::Text(text) => Self::Text(text),
            SettingValue::Bools(values) => Self::Bools(values),
            SettingValue::Bytes(values) => Self::Bytes(values),
            SettingValue::Integers(values) => Self::Integers(values),
            SettingValue::Doubles(values) => Self::Doubles(values.iter().map(f64::to_string).collect()),
            SettingValue::Texts(texts) => Self::Texts(texts),
        }
    }
}

impl TryFrom<Value> for SettingValue {
    type Error = std::num::ParseFloatError;

    fn try_from(value: Value) -> Result<Self, Self::Error> {
        Ok(match value {
            Value::Bool(value) => Self::Bool(value),
            Value::Integer(value) => Self::Integer(value),
            Value::Double(value) => Self::Double(value.parse()?),
            Value::Text(text) => Self::Text(text),
            Value::Bools(values) => Self::Bools(values),
            Value::Bytes(values) => Self::Bytes(values),
            Value::Integers(values) => Self::Integers(values),
            Value::Doubles(values) => {
                Self::Doubles(values.iter().map(|value| value.parse()).collect::<Result<_, _>>()?)
            }
            Value::Texts(texts) => Self::Texts(texts),
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn values_read_back_bit_for_bit() {
        let numbers = vec![0.1, -0.0, 1.0 / 3.0, f64::MIN_POSITIVE / 4.0, f64::INFINITY, 1e300];
        let values = [
            SettingValue::Bool(true),
            SettingValue::Integer(i64::MIN),
            SettingValue::Double(1.0),
            SettingValue::Text("a \"text\"\nof two lines".to_owned()),
            SettingValue::Bools(vec![]),
            SettingValue::Bytes(vec![0, 255]),
            SettingValue::Integers(vec![i64::MAX]),
            SettingValue::Texts(vec!["ä".to_owned()]),
        ];
        let read_back = |value: &SettingValue| {
            let text = serde_json::to_string(&Value::from(value.clone())).unwrap();
            SettingValue::try_from(serde_json::from_str::<Value>(&text).unwrap()).unwrap()
        };
        values.iter().for_each(|value| assert_eq!(read_back(value), *value));
        let SettingValue::Doubles(found) = read_back(&SettingValue::Doubles(numbers.clone())) else {
            panic!()
        };
        assert!(
            found.iter().map(|number| number.to_bits()).eq(numbers.iter().map(|number| number.to_bits()))
        );
    }
}
