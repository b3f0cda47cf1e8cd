//! Descriptions of settings.

use std::ops::RangeInclusive;

use super::setting_value::{SettingType, SettingValue};

/// A description of a setting, see [`Core::settings`](crate::Core::settings).
#[derive(Clone, Debug, PartialEq)]
pub struct SettingInfo {
    /// The name, unique in the module.
    pub name: String,
    /// The purpose and unit, for users.
    pub description: String,
    /// The current value.
    pub value: SettingValue,
    /// The allowed range of numbers; `None` for no limit.
    pub range: Option<RangeInclusive<f64>>,
    /// The allowed texts; empty for no limit.
    pub choices: Vec<String>,
    /// True if the setting cannot change after the start.
    pub is_read_only: bool,
}

impl SettingInfo {
    pub(crate) fn new(name: &str, default: impl SettingType, description: &str) -> Self {
        let (name, description) = (name.to_owned(), description.to_owned());
        let (value, choices) = (default.into_value(), Vec::new());
        Self { name, description, value, range: None, choices, is_read_only: false }
    }

    pub(crate) fn check(&self, value: SettingValue) -> Result<SettingValue, String> {
        let value = value.into_kind_of(&self.value)?;
        if let Some(range) = &self.range
            && let Some(number) = value.numbers().into_iter().find(|number| !range.contains(number))
        {
            return Err(format!("{number} is out of range, {} to {} is allowed", range.start(), range.end()));
        }
        if let SettingValue::Text(text) = &value
            && !self.choices.is_empty()
            && !self.choices.contains(text)
        {
            return Err(format!("\"{text}\" is none of {}", self.choices.join(", ")));
        }
        Ok(value)
    }
}
