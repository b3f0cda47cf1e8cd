//! The changes of settings of a running robot as a ROS message, so that a bag holds them and replay can repeat them.

use downbeat_bridge::expose::parameter_value;
use downbeat_executor::{
    Context, Core, Module, ModuleOptions, Publication, Received, Role, SettingsChange, Setup, SetupError,
};
use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::downbeat_interfaces::msg::ModuleSettings;
use downbeat_msgs::rcl_interfaces::msg::Parameter;

/// The topic on which the changes are published.
pub const TOPIC: &str = "module_settings";

/// Publishes each change of a module's settings on [`TOPIC`].
pub struct SettingsJournal;

impl SettingsJournal {
    /// The name of the module.
    pub const MODULE_NAME: &'static str = "settings_journal";

    /// Adds the journal to a core.
    ///
    /// # Errors
    /// If another module has the name or the topic.
    pub fn add(core: &mut Core) -> Result<(), SetupError> {
        let options = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
        core.add_with(Self::MODULE_NAME, Self, options)
    }

    fn on_change(
        &mut self,
        change: Received<'_, SettingsChange>,
        ctx: &mut Context<'_, Publication<ModuleSettings>>,
    ) {
        ctx.publish(*ctx.ports, message(&change));
    }
}

impl Module for SettingsJournal {
    type Ports = Publication<ModuleSettings>;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Self::Ports, SetupError> {
        let publication = setup.publish(TOPIC)?;
        setup.subscribe(SettingsChange::TOPIC, Self::on_change)?;
        Ok(publication)
    }
}

fn message(change: &SettingsChange) -> ModuleSettings {
    let parameter =
        |(name, value): &(String, _)| Parameter { name: name.clone(), value: parameter_value(value) };
    ModuleSettings {
        stamp: Time::from_nanos(change.time.as_nanos()),
        module: change.module.to_string(),
        step: change.step.unwrap_or(0),
        settings: change.settings.iter().map(parameter).collect(),
    }
}
