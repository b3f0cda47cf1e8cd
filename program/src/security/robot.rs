//! What a robot has in its networks over DDS.

use downbeat_bridge::middleware::{Engine, ParticipantOptions};
use downbeat_robot::RobotFile;
use downbeat_robot::running::{PreparedRobot, RecordPlan, RehearsedNetwork};
use tracing::subscriber::{NoSubscriber, with_default};

use crate::logging::Log;

/// The networks of a robot: what it has in those over DDS, and the names of the others.
pub(super) struct Networks {
    pub(super) over_dds: Vec<RehearsedNetwork>,
    pub(super) others: Vec<String>,
}

/// Exposes the robot as `run` does, but in memory, so that nothing is guessed.
pub(super) fn networks(
    file: RobotFile,
    is_recorded: bool,
    options: &ParticipantOptions,
    log: &Log,
) -> anyhow::Result<Networks> {
    // It would log each endpoint as exposed.
    let networks = with_default(NoSubscriber::default(), || -> anyhow::Result<_> {
        let mut robot = PreparedRobot::new(file.on_any_machine())?;
        let rehearsal = robot.rehearse(options, Some(&log.of_node))?;
        let folder = tempfile::tempdir()?;
        if is_recorded {
            robot.record(RecordPlan::of_robot(&folder.path().join("bag"), robot.file(), None))?;
        }
        let networks = rehearsal.networks()?;
        drop(robot);
        Ok(networks)
    })?;
    let (over_dds, others): (Vec<_>, Vec<_>) =
        networks.into_iter().partition(|network| network.options.engine == Engine::Rtps);
    let name = |network: RehearsedNetwork| network.name.unwrap_or_else(|| "[expose]".to_owned());
    Ok(Networks { over_dds, others: others.into_iter().map(name).collect() })
}
