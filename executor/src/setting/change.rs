//! What is told of settings that were changed.

use std::sync::Arc;

use crate::{SettingValue, Time};

/// Settings of a module that got other values while the core ran, as published on [`SettingsChange::TOPIC`] when somebody
/// subscribes to it: with it a replay changes them again at the same place.
#[derive(Clone, Debug, PartialEq)]
pub struct SettingsChange {
    /// Of a module inside the cycle the time of the cycle in whose sync phase it got them; of a detached one the time of its
    /// first run with them.
    pub time: Time,
    /// The module's name.
    pub module: Arc<str>,
    /// Of a detached module, the first run with them.
    pub step: Option<u64>,
    /// Name and value of each, in the order in which they were given.
    pub settings: Vec<(String, SettingValue)>,
}

impl SettingsChange {
    /// The topic on which changes are published.
    pub const TOPIC: &'static str = "executor/settings";
}
