//! What is replayed, for the commands that replay.

use std::path::PathBuf;

use clap::Args;
use downbeat_bags::{FieldRule, Reader};
use downbeat_bridge::expose::TopicPattern;
use downbeat_robot::replay::{ReplayOptions, Simulators};
use downbeat_robot::{Catalog, LastVersion, RobotFile, RosArgs};

use super::open;
use crate::logging::Log;
use crate::parameters::ParameterArguments;

#[derive(Args)]
pub(crate) struct ReplayedArguments {
    /// The robot file of the recording. Settings have the values with which the recording began, unless
    /// --param or --params-file give others.
    #[arg(value_name = "ROBOT.toml")]
    pub(crate) robot: PathBuf,
    /// A rosbag2 directory or an MCAP file.
    pub(crate) bag: PathBuf,
    /// Run only these modules; messages of others are input.
    #[arg(long, num_args = 1.., value_name = "MODULE")]
    pub(crate) modules: Vec<String>,
    /// Tolerance for numbers: "joint_states:position=1e-6", "imu/*=0.1%"; without a topic it applies
    /// everywhere. May be given more than once; the last one that matches a field applies.
    #[arg(long, value_name = "[TOPIC][:FIELD]=AMOUNT", value_parser = FieldRule::tolerance)]
    pub(crate) tolerance: Vec<FieldRule>,
    /// Do not compare this: "diagnostics", "imu/data_raw:header.stamp", ":header.stamp". May be given more
    /// than once.
    #[arg(long, value_name = "[TOPIC][:FIELD]", value_parser = FieldRule::ignore)]
    pub(crate) ignore: Vec<FieldRule>,
    /// Exclude these topics from the comparison: names, or patterns such as "camera/*".
    #[arg(long, num_args = 1.., value_name = "TOPIC", value_parser = TopicPattern::new)]
    pub(crate) except: Vec<TopicPattern>,
    /// Run the simulators of the robot again too, from their seeds, and compare what they publish: the bag
    /// must be of simulated time (`--fast`). Modules that drive a simulated device then drive it again,
    /// instead of running on its recorded answers.
    #[arg(long, conflicts_with = "modules")]
    pub(crate) simulators: bool,
    /// Run modules in other languages in the last version that was recorded, instead of the files as they are
    /// now.
    #[arg(long)]
    pub(crate) recorded_sources: bool,
    #[command(flatten)]
    pub(crate) parameters: ParameterArguments,
}

impl ReplayedArguments {
    /// Reads the robot file and opens the bag.
    pub(crate) fn open(
        &self,
        catalog: &Catalog,
        ros: &RosArgs,
        log: &Log,
    ) -> anyhow::Result<(RobotFile, Reader, ReplayOptions)> {
        let file = self.parameters.read_robot(&self.robot, catalog, ros)?;
        log.name_after(&file)?;
        let reader = open(&self.bag)?;
        warn_of_lost_messages(&reader);
        let given = if self.modules.is_empty() { &file.replay.modules } else { &self.modules };
        let rules = file.replay.rules.iter().chain(&self.tolerance).chain(&self.ignore).cloned();
        let options = ReplayOptions {
            modules: given.clone(),
            rules: rules.collect(),
            except: file.replay.except.iter().chain(&self.except).cloned().collect(),
            simulators: if self.simulators { Simulators::RunAgain } else { Simulators::LeftOut },
            last_version: match self.recorded_sources {
                true => LastVersion::AsRecorded,
                false => LastVersion::AsItIs,
            },
        };
        Ok((file, reader, options))
    }
}

/// Warns of lost messages noted by the recorder: a robot replayed without some of its input may differ for
/// that reason.
fn warn_of_lost_messages(reader: &Reader) {
    let lost = reader.metadata().and_then(|metadata| metadata.custom_data.get("lost_messages"));
    if let Some(lost) = lost {
        tracing::warn!("messages were lost during the recording, so the replay may differ: {lost}");
    }
}
