//! `downbeat bag replay`

use std::path::PathBuf;

use anyhow::anyhow;
use clap::Args;
use downbeat_bags::{FieldDifference, FieldRule, Reader};
use downbeat_bridge::expose::TopicPattern;
use downbeat_robot::replay::{
    Difference, ReplayOptions, ReplayReport, Simulators, Strictness, TopicReport, What,
    replay as replay_robot,
};
use downbeat_robot::{Catalog, ChangedSetting, LastVersion, LauncherChoice, RobotFile, RosArgs};
use serde_json::{Value, json};

use super::open;
use super::what_if::what_if;
use crate::logging::Log;
use crate::parameters::ParameterArguments;

/// What is replayed, for the commands that replay.
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

#[derive(Args)]
pub(crate) struct ReplayArguments {
    #[command(flatten)]
    pub(crate) replayed: ReplayedArguments,
    /// Fail if a topic of the chosen modules was not compared. Topics of --except and topics of plain Rust
    /// types, which no bag contains, are only listed.
    #[arg(long)]
    pub(crate) strict: bool,
    /// Run the modules on one thread (linear), on n threads (pool:4) or each on its own (threads), instead of
    /// the robot file's launcher. The result is the same.
    #[arg(long)]
    pub(crate) launcher: Option<LauncherChoice>,
    /// Print the report as JSON.
    #[arg(long)]
    pub(crate) json: bool,
    /// What if: replay twice, with this change and without, and say where the two runs part:
    /// gait.period=0.7, period=0.7 if only one module has it, brain=other.scxml for another version of a
    /// module's file, or robot=OTHER.toml. May be given more than once.
    #[arg(long, value_name = "CHANGE", conflicts_with_all = ["strict", "json", "launcher"])]
    pub(crate) with: Vec<String>,
    /// The new folder for a report of --with in Markdown, with plots of both runs over each other.
    #[arg(long, value_name = "FOLDER", requires = "with")]
    pub(crate) report: Option<PathBuf>,
}

pub(crate) fn replay(
    arguments: &ReplayArguments,
    catalog: &Catalog,
    ros: &RosArgs,
    log: &Log,
) -> anyhow::Result<()> {
    if !arguments.with.is_empty() {
        let report = arguments.report.as_deref();
        return what_if(&arguments.replayed, &arguments.with, report, catalog, ros, log);
    }
    let (mut file, reader, options) = arguments.replayed.open(catalog, ros, log)?;
    if let Some(launcher) = arguments.launcher.clone() {
        file.launcher.choice = launcher;
    }
    let report = replay_robot(file, &reader, &options)?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&as_json(&report))?);
    } else {
        print!("{report}");
    }
    let strictness = if arguments.strict { Strictness::EveryTopic } else { Strictness::AnyTopic };
    report.check(strictness).map_err(|not_same| anyhow!("{}", not_same.problem()))
}

/// Warns of lost messages noted by the recorder: a robot replayed without some of its input may differ for
/// that reason.
fn warn_of_lost_messages(reader: &Reader) {
    let lost = reader.metadata().and_then(|metadata| metadata.custom_data.get("lost_messages"));
    if let Some(lost) = lost {
        tracing::warn!("messages were lost during the recording, so the replay may differ: {lost}");
    }
}

fn as_json(report: &ReplayReport) -> Value {
    let detached = report.detached.iter().map(|(module, runs)| json!({ "module": module, "runs": runs }));
    let left_out = report.left_out.iter().map(|left| json!({ "module": left.module, "reason": left.reason }));
    let topics = report.topics.iter().map(|topic| {
        let TopicReport { topic, modules, is_ignored, compared, different, first } = topic;
        json!({
            "topic": topic,
            "modules": modules,
            "is_ignored": is_ignored,
            "compared": compared,
            "different": different,
            "first_difference": first.as_ref().map(difference),
        })
    });
    let not_compared = report.not_compared.iter().map(
        |topic| json!({ "topic": topic.topic, "reason": topic.reason.to_string(), "is_gap": topic.is_gap() }),
    );
    json!({
        "robot": report.robot,
        "modules": report.modules,
        "cycles": report.cycles,
        "has_recorded_cycles": report.has_recorded_cycles,
        "detached": detached.collect::<Vec<_>>(),
        "left_out": left_out.collect::<Vec<_>>(),
        "changed_sources": report.changed_sources,
        "versions": report.versions,
        "changed_settings": report.changed_settings.iter().map(changed_setting).collect::<Vec<_>>(),
        "inputs": report.inputs,
        "missing_inputs": report.missing_inputs,
        "topics": topics.collect::<Vec<_>>(),
        "not_compared": not_compared.collect::<Vec<_>>(),
        "compared": report.compared(),
        "first_difference": report.first_difference().map(difference),
        "different": report.different(),
        "bag_seconds": report.bag_duration.as_secs_f64(),
        "seconds": report.took.as_secs_f64(),
    })
}

fn changed_setting(changed: &ChangedSetting) -> Value {
    json!({
        "module": changed.module,
        "setting": changed.setting,
        "recorded": changed.recorded.as_ref().map(ToString::to_string),
        "now": changed.now.as_ref().map(ToString::to_string),
        "replayed": if changed.is_explicit { "now" } else { "recorded" },
    })
}

fn difference(difference: &Difference) -> Value {
    let Difference { topic, number, time, what } = difference;
    let what = match what {
        What::Field(FieldDifference { path, first, second }) => {
            json!({ "kind": "field", "field": path, "recorded": first, "replayed": second })
        }
        What::Time { replayed } => json!({ "kind": "time", "replayed_ns": replayed }),
        What::Missing => json!({ "kind": "missing" }),
        What::Extra => json!({ "kind": "extra" }),
    };
    json!({ "topic": topic, "message": number, "time_ns": time, "what": what })
}
