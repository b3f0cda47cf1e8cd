//! The snapshots that the recording of a robot takes by itself: when a condition on topics becomes true, and
//! when a module panics.

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use downbeat_bags::RecordingControl;
use downbeat_edge::{CoreAccess, Sink};
use downbeat_executor::{Inbox, LifeStep, Listening, Outlet, OutletInbox, Time};
use parking_lot::Mutex;

use super::StartError;
use crate::Robot;
use crate::record_options::SnapshotTriggers;
use crate::recorder::RecorderError;
use crate::snapshot_condition::SnapshotCondition;

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
            watch._outlets = watch_topics(robot, control, expression, triggers.after)?;
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

/// Evaluates a condition with each message of its topics.
fn watch_topics(
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
    let condition = SnapshotCondition::new(expression, types, control.clone(), after);
    let condition = condition.map_err(StartError::SnapshotCondition)?;
    let named: Vec<String> = condition.topics().map(str::to_owned).collect();
    let condition = Arc::new(Mutex::new(condition));
    let inbox = OutletInbox::new("snapshots", Inbox::KeepAll);
    let mut outlets = Vec::new();
    for (topic, known) in known.iter().filter(|(topic, _)| named.iter().any(|name| **name == **topic)) {
        let sink = Watching { topic: Arc::clone(topic), condition: Arc::clone(&condition) };
        let outlet = known.outlet(&mut CoreAccess::Idle(&mut robot.core), topic, &inbox, sink);
        outlets.push(outlet.map_err(RecorderError::from)?);
    }
    Ok(outlets)
}

/// Takes the messages of one topic.
struct Watching {
    topic: Arc<str>,
    condition: Arc<Mutex<SnapshotCondition>>,
}

impl Sink for Watching {
    fn take(&mut self, time: Time, cdr: Bytes) {
        self.condition.lock().take(&self.topic, time, &cdr);
    }
}
