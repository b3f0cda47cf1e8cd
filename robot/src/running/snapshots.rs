//! The snapshots that the recording of a robot takes by itself: when a condition on topics becomes true, and
//! when a module panics.

use downbeat_bags::RecordingControl;
use downbeat_executor::{LifeStep, Listening, Outlet};

use super::StartError;
use crate::Robot;
use crate::record_options::SnapshotTriggers;

/// Takes snapshots while it is there. Dropped after the core has stopped.
#[derive(Default)]
pub(super) struct SnapshotWatch {
    _outlets: Vec<Outlet>,
    _listening: Option<Listening>,
}

impl SnapshotWatch {
    pub(super) fn start(
        robot: &mut Robot,
        control: &RecordingControl,
        triggers: &SnapshotTriggers,
    ) -> Result<Self, StartError> {
        let mut watch = Self::default();
        if let Some(expression) = &triggers.when {
            watch._outlets = condition::watch(robot, control, expression, triggers.after)?;
        }
        if triggers.on_panic {
            let (control, clock, after) = (control.clone(), robot.core.clock(), triggers.after);
            watch._listening = Some(robot.core.handle().on_transition(move |event| {
                if let LifeStep::Panicked { .. } = event.step
                    && control.snapshot_around(clock.now().as_nanos(), after)
                {
                    tracing::info!("taking a snapshot: {} panicked", event.module);
                }
            }));
        }
        Ok(watch)
    }
}

#[cfg(feature = "state_machine")]
mod condition {
    use std::sync::Arc;
    use std::time::Duration;

    use bytes::Bytes;
    use downbeat_bags::RecordingControl;
    use downbeat_edge::{CoreAccess, Sink};
    use downbeat_executor::{Inbox, Outlet, OutletInbox, Time};
    use downbeat_state_machine::Condition;
    use parking_lot::Mutex;

    use super::StartError;
    use crate::Robot;
    use crate::recorder::RecorderError;

    /// Evaluates the condition with each message of its topics.
    pub(super) fn watch(
        robot: &mut Robot,
        control: &RecordingControl,
        expression: &str,
        after: Duration,
    ) -> Result<Vec<Outlet>, StartError> {
        let interfaces = robot.file.catalog.interfaces.clone();
        let known =
            robot.core.topics().filter_map(|topic| Some((topic.name.clone(), interfaces.message_in(topic)?)));
        let known: Vec<_> = known.collect();
        let types = known.iter().filter_map(|(topic, known)| Some((&**topic, known.dynamic()?)));
        let condition = Condition::new(expression, types).map_err(StartError::SnapshotCondition)?;
        let named: Vec<String> = condition.topics().map(str::to_owned).collect();
        let watched =
            Arc::new(Mutex::new(Watched { condition, control: control.clone(), after, is_broken: false }));
        let inbox = OutletInbox::new("snapshots", Inbox::KeepAll);
        let mut outlets = Vec::new();
        for (topic, known) in known.iter().filter(|(topic, _)| named.iter().any(|name| **name == **topic)) {
            let sink = Watching { topic: Arc::clone(topic), watched: Arc::clone(&watched) };
            let outlet = known.outlet(&mut CoreAccess::Idle(&mut robot.core), topic, &inbox, sink);
            outlets.push(outlet.map_err(RecorderError::from)?);
        }
        Ok(outlets)
    }

    struct Watched {
        condition: Condition,
        control: RecordingControl,
        after: Duration,
        /// Whether it cannot be evaluated, which was logged.
        is_broken: bool,
    }

    /// Takes the messages of one topic.
    struct Watching {
        topic: Arc<str>,
        watched: Arc<Mutex<Watched>>,
    }

    impl Sink for Watching {
        fn take(&mut self, time: Time, cdr: Bytes) {
            let Watched { condition, control, after, is_broken } = &mut *self.watched.lock();
            condition.take(&self.topic, time, &cdr);
            match condition.becomes_true(time) {
                Ok(true) => {
                    if control.snapshot_around(time.as_nanos(), *after) {
                        tracing::info!("taking a snapshot: its condition became true");
                    }
                    *is_broken = false;
                }
                Ok(false) => *is_broken = false,
                Err(error) if !std::mem::replace(is_broken, true) => {
                    tracing::warn!("the condition of snapshots is not evaluated: {error}");
                }
                Err(_) => {}
            }
        }
    }
}

#[cfg(not(feature = "state_machine"))]
mod condition {
    use std::time::Duration;

    use downbeat_bags::RecordingControl;
    use downbeat_executor::Outlet;

    use super::StartError;
    use crate::Robot;
    use crate::features::built_without;

    pub(super) fn watch(
        _: &mut Robot,
        _: &RecordingControl,
        expression: &str,
        _: Duration,
    ) -> Result<Vec<Outlet>, StartError> {
        let problem =
            format!("`{expression}` is not evaluated: this program is {}", built_without("state_machine"));
        Err(StartError::SnapshotCondition(problem))
    }
}
