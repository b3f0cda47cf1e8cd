//! The changes of settings that a bag tells, made again.

use std::collections::VecDeque;

use downbeat_bags::Reader;
use downbeat_edge::setting_value;
use downbeat_executor::Core;
use downbeat_msgs::cdr;
use downbeat_msgs::downbeat_interfaces::msg::ModuleSettings;

use super::Extract;
use crate::journal;

/// The topic that tells them.
pub(crate) fn topic() -> String {
    format!("/{}", journal::SETTINGS)
}

/// Those of some modules, in the order in which they were made.
#[derive(Default)]
pub(crate) struct SettingsChanges(VecDeque<ModuleSettings>);

impl SettingsChanges {
    /// Of the modules that are wanted; none where the bag lacks the topic.
    pub(crate) fn read<E>(
        reader: &Reader,
        extract: &mut Extract,
        is_wanted: impl Fn(&str) -> bool,
    ) -> Result<Self, E>
    where
        E: super::ReadError + From<SettingsError>,
    {
        let Some(id) = reader.topic(&topic()) else { return Ok(Self(VecDeque::new())) };
        let mut changes = VecDeque::new();
        for message in extract.of::<E>(reader, id)? {
            let change: ModuleSettings = cdr::from_slice(message).map_err(SettingsError::Message)?;
            if is_wanted(&change.module) {
                changes.push_back(change);
            }
        }
        Ok(Self(changes))
    }

    /// Has the core make those that are due in its next sync phase.
    pub(crate) fn give(
        &mut self,
        core: &Core,
        is_due: impl Fn(&ModuleSettings) -> bool,
    ) -> Result<(), SettingsError> {
        while self.0.front().is_some_and(&is_due) {
            let Some(change) = self.0.pop_front() else { break };
            for parameter in change.settings {
                let value = setting_value(parameter.value).map_err(|problem| SettingsError::Value {
                    setting: format!("{}.{}", change.module, parameter.name),
                    problem,
                })?;
                // What the module refuses now, it does not have: its messages will tell.
                drop(core.handle().set(&change.module, &parameter.name, value));
            }
        }
        Ok(())
    }
}

/// Why changes of settings cannot be made again.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    /// A message is not what its topic says.
    #[error("a message of /module_settings: {0}")]
    Message(cdr::Error),
    /// A value is none that a setting can have.
    #[error("a message of /module_settings: {setting}: {problem}")]
    Value {
        /// The module and its setting.
        setting: String,
        /// What is wrong.
        problem: String,
    },
}
