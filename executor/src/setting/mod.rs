//! Settings: named, typed values of a module, given at the start and changed in the sync phase.

mod change;
mod sync;

use std::fmt;
use std::marker::PhantomData;
use std::ops::RangeInclusive;

pub use change::SettingsChange;
pub(crate) use sync::SettingsMechanism;

use crate::receipt::ReceiptSender;
use crate::{SettingRefused, SetupError};

/// A value of a setting. The kinds are those of ROS 2 parameters.
#[derive(Clone, Debug, PartialEq)]
pub enum SettingValue {
    /// True or false.
    Bool(bool),
    /// A whole number.
    Integer(i64),
    /// A number; whole numbers are taken too.
    Double(f64),
    /// Text.
    Text(String),
    /// Truth values.
    Bools(Vec<bool>),
    /// Bytes; whole numbers from 0 to 255 are taken too.
    Bytes(Vec<u8>),
    /// Whole numbers.
    Integers(Vec<i64>),
    /// Numbers.
    Doubles(Vec<f64>),
    /// Texts.
    Texts(Vec<String>),
}

impl SettingValue {
    fn kind(&self) -> &'static str {
        match self {
            Self::Bool(_) => "bool",
            Self::Integer(_) => "integer",
            Self::Double(_) => "double",
            Self::Text(_) => "text",
            Self::Bools(_) => "list of bools",
            Self::Bytes(_) => "list of bytes",
            Self::Integers(_) => "list of integers",
            Self::Doubles(_) => "list of doubles",
            Self::Texts(_) => "list of texts",
        }
    }

    /// The numbers in it; none in what holds no numbers.
    fn numbers(&self) -> Vec<f64> {
        match self {
            Self::Integer(value) => vec![*value as f64],
            Self::Double(value) => vec![*value],
            Self::Integers(values) => values.iter().map(|&value| value as f64).collect(),
            Self::Doubles(values) => values.clone(),
            Self::Bytes(values) => values.iter().map(|&value| value.into()).collect(),
            Self::Bool(_) | Self::Text(_) | Self::Bools(_) | Self::Texts(_) => Vec::new(),
        }
    }

    /// The value as the kind of `pattern`, where nothing is lost by it.
    fn into_kind_of(self, pattern: &Self) -> Result<Self, String> {
        Ok(match (self, pattern) {
            (Self::Integer(value), Self::Double(_)) => Self::Double(value as f64),
            (Self::Integers(values), Self::Doubles(_)) => {
                Self::Doubles(values.into_iter().map(|value| value as f64).collect())
            }
            (Self::Integers(values), Self::Bytes(_)) => {
                let byte = |value| u8::try_from(value).map_err(|_| format!("expected bytes, found {value}"));
                Self::Bytes(values.into_iter().map(byte).collect::<Result<_, _>>()?)
            }
            // An empty list in a file has no kind of its own.
            (Self::Integers(values), Self::Texts(_)) if values.is_empty() => Self::Texts(Vec::new()),
            (Self::Integers(values), Self::Bools(_)) if values.is_empty() => Self::Bools(Vec::new()),
            (value, pattern) if value.kind() == pattern.kind() => value,
            (value, pattern) => {
                return Err(format!("expected {}, found {} {value}", pattern.kind(), value.kind()));
            }
        })
    }
}

impl fmt::Display for SettingValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bool(value) => write!(f, "{value}"),
            Self::Integer(value) => write!(f, "{value}"),
            Self::Double(value) => write!(f, "{value}"),
            Self::Text(value) => write!(f, "{value:?}"),
            Self::Bools(values) => write!(f, "{values:?}"),
            Self::Bytes(values) => write!(f, "{values:?}"),
            Self::Integers(values) => write!(f, "{values:?}"),
            Self::Doubles(values) => write!(f, "{values:?}"),
            Self::Texts(values) => write!(f, "{values:?}"),
        }
    }
}

/// A Rust type that a setting can have.
pub trait SettingType: Clone + Send + 'static {
    /// The value as a setting holds it.
    fn into_value(self) -> SettingValue;
    /// The value as the module reads it; nothing if the setting is of another kind.
    fn from_value(value: &SettingValue) -> Option<&Self>;
}

macro_rules! setting_types {
    ($($type:ty => $kind:ident),* $(,)?) => {$(
        impl SettingType for $type {
            fn into_value(self) -> SettingValue {
                SettingValue::$kind(self)
            }

            fn from_value(value: &SettingValue) -> Option<&Self> {
                match value {
                    SettingValue::$kind(value) => Some(value),
                    _ => None,
                }
            }
        }

        impl From<$type> for SettingValue {
            fn from(value: $type) -> Self {
                Self::$kind(value)
            }
        }
    )*};
}

setting_types! {
    bool => Bool,
    i64 => Integer,
    f64 => Double,
    String => Text,
    Vec<bool> => Bools,
    Vec<u8> => Bytes,
    Vec<i64> => Integers,
    Vec<f64> => Doubles,
    Vec<String> => Texts,
}

/// A module's key to one of its settings, read with [`Context::get`](crate::Context::get).
pub struct Setting<T> {
    pub(crate) index: usize,
    kind: PhantomData<fn() -> T>,
}

impl<T> Setting<T> {
    pub(crate) fn new(index: usize) -> Self {
        Self { index, kind: PhantomData }
    }
}

impl<T> Clone for Setting<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Setting<T> {}

/// What a setting is, see [`Core::settings`](crate::Core::settings).
#[derive(Clone, Debug, PartialEq)]
pub struct SettingInfo {
    /// The name, unique in the module.
    pub name: String,
    /// What it is for, with its unit.
    pub description: String,
    /// The value in force.
    pub value: SettingValue,
    /// The numbers it may have; nothing for no limit.
    pub range: Option<RangeInclusive<f64>>,
    /// True if it does not change after the start.
    pub is_read_only: bool,
}

impl SettingInfo {
    pub(crate) fn new(name: &str, default: impl SettingType, description: &str) -> Self {
        let (name, description) = (name.to_owned(), description.to_owned());
        Self { name, description, value: default.into_value(), range: None, is_read_only: false }
    }

    fn check(&self, value: SettingValue) -> Result<SettingValue, String> {
        let value = value.into_kind_of(&self.value)?;
        if let Some(range) = &self.range
            && let Some(number) = value.numbers().into_iter().find(|number| !range.contains(number))
        {
            return Err(format!("{number} is out of range, {} to {} is allowed", range.start(), range.end()));
        }
        Ok(value)
    }
}

/// The settings of one module.
#[derive(Default)]
pub(crate) struct Settings {
    infos: Vec<SettingInfo>,
    changed: Vec<usize>,
}

impl Settings {
    /// Adds a setting, with the value it was given or else its default.
    pub(crate) fn declare(
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

    pub(crate) fn infos(&self) -> &[SettingInfo] {
        &self.infos
    }

    pub(crate) fn value(&self, index: usize) -> Option<&SettingValue> {
        self.infos.get(index).map(|info| &info.value)
    }

    /// The place of a setting and the value it would have. Errors say what is wrong with it.
    pub(crate) fn check(&self, name: &str, value: SettingValue) -> Result<(usize, SettingValue), String> {
        let index = self.position(name).ok_or_else(|| {
            let known: Vec<_> = self.infos.iter().map(|info| info.name.as_str()).collect();
            format!("there is no such setting; there is {}", known.join(", "))
        })?;
        if self.infos[index].is_read_only {
            return Err("it is read-only; give it in the robot file".into());
        }
        Ok((index, self.infos[index].check(value)?))
    }

    /// Changes a value that was checked; the module is told when it runs next.
    pub(crate) fn put(&mut self, index: usize, value: SettingValue) {
        if self.infos[index].value != value {
            self.infos[index].value = value;
            if !self.changed.contains(&index) {
                self.changed.push(index);
            }
        }
    }

    pub(crate) fn has_changes(&self) -> bool {
        !self.changed.is_empty()
    }

    pub(crate) fn take_change(&mut self) -> Option<usize> {
        (!self.changed.is_empty()).then(|| self.changed.remove(0))
    }

    fn position(&self, name: &str) -> Option<usize> {
        self.infos.iter().position(|info| info.name == name)
    }
}

/// Tells who asked for a change how it went, in the log where nobody waits for the answer.
///
/// Returns the value if it was accepted.
pub(crate) fn report(
    module: &str,
    setting: &str,
    result: Result<SettingValue, String>,
    receipt: Option<ReceiptSender<Result<(), SettingRefused>>>,
) -> Option<SettingValue> {
    let (module, setting) = (module.to_owned(), setting.to_owned());
    let (value, result) = match result {
        Ok(value) => (Some(value), Ok(())),
        Err(reason) => (None, Err(SettingRefused::Refused { module, setting, reason })),
    };
    match (receipt, result) {
        (Some(receipt), result) => receipt.send(result),
        (None, Err(refused)) => tracing::warn!("setting not changed: {refused}"),
        (None, Ok(())) => {}
    }
    value
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn set(settings: &mut Settings, name: &str, value: SettingValue) -> Result<(), String> {
        settings.check(name, value).map(|(index, value)| settings.put(index, value))
    }

    fn gain() -> SettingInfo {
        let (name, description) = ("gain".into(), String::new());
        SettingInfo {
            name,
            description,
            value: SettingValue::Double(1.0),
            range: Some(0.0..=4.0),
            is_read_only: false,
        }
    }

    #[test]
    fn a_whole_number_is_a_valid_double() {
        let mut settings = Settings::default();
        settings.declare("m", gain(), Some(SettingValue::Integer(2))).unwrap();
        assert_eq!(settings.value(0), Some(&SettingValue::Double(2.0)));
    }

    #[test]
    fn whole_numbers_are_valid_bytes_where_they_fit() {
        let mut settings = Settings::default();
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
            let mut settings = Settings::default();
            let empty = Vec::<i64>::new();
            settings.declare("m", SettingInfo { value: list, range: None, ..gain() }, None).unwrap();
            set(&mut settings, "gain", empty.into()).unwrap();
        }
    }

    #[test]
    fn each_number_of_a_list_must_lie_in_the_range() {
        let mut settings = Settings::default();
        settings.declare("m", SettingInfo { value: vec![1.0, 2.0].into(), ..gain() }, None).unwrap();
        assert!(
            set(&mut settings, "gain", vec![3.0, 4.5].into()).unwrap_err().starts_with("4.5 is out of range")
        );
        set(&mut settings, "gain", vec![3.0, 4.0].into()).unwrap();
    }

    #[test]
    fn a_setting_changed_twice_before_its_module_runs_is_announced_once() {
        let mut settings = Settings::default();
        settings.declare("m", gain(), None).unwrap();
        set(&mut settings, "gain", 2.0.into()).unwrap();
        set(&mut settings, "gain", 3.0.into()).unwrap();
        assert_eq!((settings.take_change(), settings.take_change()), (Some(0), None));
    }

    #[test]
    fn a_value_of_another_kind_or_out_of_range_is_refused_and_changes_nothing() {
        let mut settings = Settings::default();
        settings.declare("m", gain(), None).unwrap();
        for (value, word) in [(SettingValue::Bool(true), "expected double"), (5.0.into(), "out of range")] {
            let refusal = set(&mut settings, "gain", value).unwrap_err();
            assert!(refusal.contains(word), "{refusal}");
        }
        assert_eq!(settings.value(0), Some(&SettingValue::Double(1.0)));
        assert!(!settings.has_changes());
        assert!(set(&mut settings, "gian", 1.0.into()).unwrap_err().contains("gain"));
    }
}
