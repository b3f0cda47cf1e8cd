//! `downbeat bag record`

pub(crate) mod arguments;
mod controls;
mod from_ros;

use std::path::PathBuf;

use anyhow::bail;

use crate::bag::select::absolute;
use crate::logging::Log;
use crate::new_output::Output;
use crate::run::WatchedRobot;
use crate::screen::Screen;
use crate::stop::Stop;
use arguments::{ExposedChoice, RecordArguments};
use downbeat_bags::{RecordingSummary, StoragePreset};
use downbeat_robot::recorder::Unrecorded;
use downbeat_robot::ros_recorder::TopicFilter;
use downbeat_robot::running::RecordPlan;
use downbeat_robot::{Catalog, ClockChoice, RecordOptions, RobotFile, RosArgs};

pub(crate) fn record(
    arguments: &RecordArguments,
    catalog: &Catalog,
    ros: &RosArgs,
    screen: &Screen,
    log: &Log,
) -> anyhow::Result<()> {
    let output = arguments.output.clone().unwrap_or_else(unnamed);
    arguments.force.check(Output::Bag, &output)?;
    match &arguments.robot {
        Some(robot) => record_robot(arguments, robot, output, catalog, ros, screen, log),
        None => from_ros::record(arguments, output, catalog, ros, screen),
    }
}

/// The directory of a bag without a name, as `ros2 bag record` names it.
fn unnamed() -> PathBuf {
    PathBuf::from(chrono::Local::now().format("rosbag2_%Y_%m_%d-%H_%M_%S").to_string())
}

fn record_robot(
    arguments: &RecordArguments,
    robot: &std::path::Path,
    directory: PathBuf,
    catalog: &Catalog,
    ros: &RosArgs,
    screen: &Screen,
    log: &Log,
) -> anyhow::Result<()> {
    let mut file = RobotFile::read_with(robot, catalog, ros)?;
    log.name_after(&file)?;
    // There is no node that could receive `/clock`.
    file.expose.features.clock = ClockChoice::Own;
    apply(arguments, &mut file.record.options)?;
    let record = &file.record.options;
    if record.recording.takes_snapshots() && !record.snapshot_triggers.are_some() {
        bail!(
            "snapshots of --robot need a trigger, --snapshot-when or --snapshot-on-panic: there is no ROS 2 node, so no \
             service, to ask for one"
        );
    }
    if !arguments.selection.modules.is_empty() {
        file.record.modules.clone_from(&arguments.selection.modules);
    }
    if let Some(exposed) = arguments.selection.exposed {
        file.record.exposed = Some(exposed == ExposedChoice::Only);
    }
    let mut filter = filter(arguments, |name| Ok(absolute(name)))?;
    if arguments.topics().next().is_some() || arguments.selection.is_given() {
        file.record.topics = None;
    } else {
        // The robot file selects topics; the command line excludes some.
        filter.all_topics = true;
        filter.includes_hidden = true;
    }
    let named = if filter.all_topics { Vec::new() } else { filter.topics.clone() };
    let plan = RecordPlan { directory, options: file.record.options.clone(), filter: Some(filter) };
    let stop = Stop::new()?;
    let interfaces = file.catalog.interfaces.clone();
    let mut robot = WatchedRobot::new(file)?;
    let topics: Vec<_> = robot.prepared.core().topics().cloned().collect();
    let unrecorded = Unrecorded::of(&topics, &interfaces);
    if let Some(problem) = named.iter().find_map(|name| unrecorded.problem_of(name)) {
        bail!(problem);
    }
    arguments.force.make_way(Output::Bag, &plan.directory, [])?;
    robot.prepared.record(plan)?;
    robot.run(&stop.after(arguments.duration), screen)
}

impl RecordArguments {
    /// The topics selected by name.
    fn topics(&self) -> impl Iterator<Item = &String> {
        self.topics_positional.iter().chain(&self.selection.topics)
    }

    /// Rejects the same combinations as `ros2bag/verb/record.py`, with the same messages.
    fn check(&self) -> anyhow::Result<()> {
        let selection = &self.selection;
        let is_open = selection.all || selection.regex.is_some();
        let has_topics = self.topics().next().is_some();
        if !selection.is_given() && !has_topics {
            bail!(
                "Need to specify at least one option out of --all, --all-topics, --all-services, --services, --topics, \
                 --topic-types or --regex"
            );
        }
        let (types, topics) = (!selection.topic_types.is_empty(), selection.all_topics);
        if selection.exclude_regex.is_some() && !(is_open || topics || types || selection.all_services) {
            bail!(
                "--exclude-regex argument requires either --all, --all-topics, --topic-types, --all-services or --regex"
            );
        }
        if !(selection.exclude_topics.is_empty() || is_open || topics || types) {
            bail!("--exclude-topics argument requires either --all, --all-topics, --topic-types or --regex");
        }
        if !(selection.exclude_topic_types.is_empty() || is_open || topics || types) {
            bail!("--exclude-topic-types argument requires either --all, --all-topics or --regex");
        }
        if !(selection.exclude_services.is_empty() || is_open || selection.all_services) {
            bail!("--exclude-services argument requires either --all, --all-services or --regex");
        }
        if (selection.all || selection.all_services) && !selection.services.is_empty() {
            tracing::warn!("--all or --all-services will override --services");
        }
        if (selection.all || selection.all_topics) && has_topics {
            tracing::warn!("--all or --all-topics will override --topics");
        }
        if (selection.all || selection.all_topics || selection.all_services) && selection.regex.is_some() {
            tracing::warn!("--all, --all-topics or --all-services will override --regex");
        }
        Ok(())
    }
}

/// The selection, with absolute names.
fn filter(
    arguments: &RecordArguments,
    absolute: impl Fn(&str) -> anyhow::Result<String>,
) -> anyhow::Result<TopicFilter> {
    let selection = &arguments.selection;
    let names =
        |names: &[String]| names.iter().map(|name| absolute(name)).collect::<anyhow::Result<Vec<_>>>();
    Ok(TopicFilter {
        all_topics: selection.all || selection.all_topics,
        all_services: selection.all || selection.all_services,
        topics: arguments.topics().map(|name| absolute(name)).collect::<anyhow::Result<_>>()?,
        topic_types: selection.topic_types.clone(),
        services: names(&selection.services)?,
        regex: selection.regex.clone(),
        exclude_regex: selection.exclude_regex.clone(),
        exclude_topics: names(&selection.exclude_topics)?,
        exclude_topic_types: selection.exclude_topic_types.clone(),
        exclude_services: names(&selection.exclude_services)?,
        includes_hidden: arguments.discovery.include_hidden_topics,
        includes_unpublished: arguments.discovery.include_unpublished_topics,
        ignores_leaves: arguments.discovery.ignore_leaf_topics,
    })
}

fn report(summary: &RecordingSummary) {
    let (messages, lost) = (summary.message_count(), summary.lost_count());
    println!("recorded {messages} messages, lost {lost}, in {}", summary.path.display());
    for topic in summary.topics.iter().filter(|topic| topic.lost > 0) {
        println!("  {}: {} lost", topic.name, topic.lost);
    }
    if summary.deleted > 0 {
        println!("  {} more were in deleted files", summary.deleted);
    }
}

/// Overrides the options with the command line.
fn apply(arguments: &RecordArguments, options: &mut RecordOptions) -> anyhow::Result<()> {
    arguments.options.apply(options)?;
    let storage = &mut options.writer.storage;
    if arguments.writing.zstd {
        let (mcap, fast) = (storage.mcap_mut()?, StoragePreset::ZstdFast.options());
        (mcap.compression, mcap.level) = (fast.compression, fast.level);
    }
    if let Some(path) = &arguments.writing.storage_config_file {
        *storage = storage.clone().with_config_file(path)?;
    }
    match options.refusal() {
        Some(reason) => bail!(reason),
        None => Ok(()),
    }
}
