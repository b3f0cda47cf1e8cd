//! The changes of settings.

use downbeat_bridge::expose::parameter_value;
use downbeat_executor::SettingsChange;
use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::downbeat_interfaces::msg::ModuleSettings;
use downbeat_msgs::rcl_interfaces::msg::Parameter;

pub(super) fn message(change: &SettingsChange) -> ModuleSettings {
    let parameter =
        |(name, value): &(String, _)| Parameter { name: name.clone(), value: parameter_value(value) };
    ModuleSettings {
        stamp: Time::from_nanos(change.time.as_nanos()),
        module: change.module.to_string(),
        step: change.step.unwrap_or(0),
        settings: change.settings.iter().map(parameter).collect(),
    }
}
