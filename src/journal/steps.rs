//! The runs of detached modules.

use downbeat_executor::DetachedStep;
use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::downbeat_interfaces::msg::ModuleStep;

pub(super) fn message(step: &DetachedStep) -> ModuleStep {
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
