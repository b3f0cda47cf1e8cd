//! Values of settings.

use std::fmt;

/// A value of a setting. The kinds match the types of ROS 2 parameters.
#[derive(Clone, Debug, PartialEq)]
pub enum SettingValue {
    /// True or false.
    Bool(bool),
    /// A whole number.
    Integer(i64),
    /// A number; whole numbers are converted.
    Double(f64),
    /// Text.
    Text(String),
    /// Booleans.
    Bools(Vec<bool>),
    /// Bytes; whole numbers from 0 to 255 are converted.
    Bytes(Vec<u8>),
    /// Whole numbers.
    Integers(Vec<i64>),
    /// Numbers.
    Doubles(Vec<f64>),
    /// Texts.
    Texts(Vec<String>),
}

impl SettingValue {
    pub(crate) fn kind(&self) -> &'static str {
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

    /// All numbers of the value; empty if its kind has none.
    pub(crate) fn numbers(&self) -> Vec<f64> {
        match self {
            Self::Integer(value) => vec![*value as f64],
            Self::Double(value) => vec![*value],
            Self::Integers(values) => values.iter().map(|&value| value as f64).collect(),
            Self::Doubles(values) => values.clone(),
            Self::Bytes(values) => values.iter().map(|&value| value.into()).collect(),
            Self::Bool(_) | Self::Text(_) | Self::Bools(_) | Self::Texts(_) => Vec::new(),
        }
    }

    fn is_empty_list(&self) -> bool {
        match self {
            Self::Bools(values) => values.is_empty(),
            Self::Bytes(values) => values.is_empty(),
            Self::Integers(values) => values.is_empty(),
            Self::Doubles(values) => values.is_empty(),
            Self::Texts(values) => values.is_empty(),
            Self::Bool(_) | Self::Integer(_) | Self::Double(_) | Self::Text(_) => false,
        }
    }

    /// Converts the value to the kind of `pattern`, as in an assignment to a setting.
    ///
    /// # Errors
    /// If the conversion would lose information; the error is a text.
    pub fn into_kind_of(self, pattern: &Self) -> Result<Self, String> {
        Ok(match (self, pattern) {
            (Self::Integer(value), Self::Double(_)) => Self::Double(value as f64),
            (Self::Integers(values), Self::Doubles(_)) => {
                Self::Doubles(values.into_iter().map(|value| value as f64).collect())
            }
            (Self::Integers(values), Self::Bytes(_)) => {
                let byte = |value| u8::try_from(value).map_err(|_| format!("expected bytes, found {value}"));
                Self::Bytes(values.into_iter().map(byte).collect::<Result<_, _>>()?)
            }
            (value, pattern) if value.kind() == pattern.kind() => value,
            // An empty list in a file has no element type, and ROS 2 tools choose one.
            (value, Self::Bools(_)) if value.is_empty_list() => Self::Bools(Vec::new()),
            (value, Self::Bytes(_)) if value.is_empty_list() => Self::Bytes(Vec::new()),
            (value, Self::Integers(_)) if value.is_empty_list() => Self::Integers(Vec::new()),
            (value, Self::Doubles(_)) if value.is_empty_list() => Self::Doubles(Vec::new()),
            (value, Self::Texts(_)) if value.is_empty_list() => Self::Texts(Vec::new()),
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

/// A Rust type of settings.
pub trait SettingType: Clone + Send + 'static {
    /// Converts to the value of a setting.
    fn into_value(self) -> SettingValue;
    /// The value in this type; `None` if the setting has another kind.
    fn from_value(value: &SettingValue) -> Option<&Self>;
}

/// For settings whose kind is known only at run time, from the default value.
impl SettingType for SettingValue {
    fn into_value(self) -> SettingValue {
        self
    }

    fn from_value(value: &SettingValue) -> Option<&Self> {
        Some(value)
    }
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
