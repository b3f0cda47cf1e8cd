//! The runs of detached modules as a ROS message, so that a bag holds them and replay can repeat them.

use downbeat_executor::{
    Context, Core, DetachedStep, Module, ModuleOptions, Publication, Received, Role, Setup, SetupError,
};
use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::downbeat_interfaces::msg::ModuleStep;

/// The topic on which the runs are published.
pub const TOPIC: &str = "module_steps";

/// Publishes each run of a detached module on [`TOPIC`]: an observer, so that it tells the last runs too.
pub struct StepJournal;

impl StepJournal {
    /// Adds the journal to a core.
    ///
    /// # Errors
    /// If another module has the name or the topic.
    pub fn add(core: &mut Core) -> Result<(), SetupError> {
        let options = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
        core.add_with("step_journal", Self, options)
    }

    fn on_step(&mut self, step: Received<'_, DetachedStep>, ctx: &mut Context<'_, Publication<ModuleStep>>) {
        ctx.publish(*ctx.ports, message(&step));
    }
}

impl Module for StepJournal {
    type Ports = Publication<ModuleStep>;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Self::Ports, SetupError> {
        let publication = setup.publish(TOPIC)?;
        setup.subscribe(DetachedStep::TOPIC, Self::on_step)?;
        Ok(publication)
    }
}

fn message(step: &DetachedStep) -> ModuleStep {
    ModuleStep {
        stamp: Time::from_nanos(step.time.as_nanos()),
        module: step.module.to_string(),
        step: step.step,
        cycle: step.cycle,
        is_stop: step.is_stop,
        topics: step.inputs.iter().map(|input| input.topic.to_string()).collect(),
        skipped: step.inputs.iter().map(|input| input.skipped).collect(),
        counts: step.inputs.iter().map(|input| input.received).collect(),
    }
}
