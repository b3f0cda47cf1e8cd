//! `downbeat bag record`

pub(crate) mod arguments;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};

use crate::bag::select::absolute;
use crate::logging::Log;
use crate::new_output::Output;
use crate::run::WatchedRobot;
use crate::screen::{Screen, shorten, wrap};
use crate::status::{SEPARATOR, bag};
use crate::stop::{Key, Keyboard, Stop};
use arguments::{ExposedChoice, RecordArguments};
use downbeat_bags::{Recording, RecordingControl, RecordingSummary, StoragePreset};
use downbeat_robot::recorder::Unrecorded;
use downbeat_robot::ros_recorder::{
    QosOverrides, RosRecorder, RosRecorderOptions, TopicFilter, serve, split_events,
};
use downbeat_robot::running::RecordPlan;
use downbeat_robot::{Catalog, ClockChoice, RecordOptions, RobotFile, RosArgs};

pub(crate) fn record(
    arguments: &RecordArguments,
    catalog: &Catalog,
    ros: &RosArgs,
    screen: &Screen,
    log: &Log,
) -> anyhow::Result<()> {
    let output = arguments.output.clone().unwrap_or_else(|| {
        PathBuf::from(chrono::Local::now().format("rosbag2_%Y_%m_%d-%H_%M_%S").to_string())
    });
    arguments.force.check(Output::Bag, &output)?;
    match &arguments.robot {
        Some(robot) => record_robot(arguments, robot, output, catalog, ros, screen, log),
        None => record_from_ros(arguments, output, catalog, ros, screen),
    }
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

fn record_from_ros(
    arguments: &RecordArguments,
    output: PathBuf,
    catalog: &Catalog,
    ros: &RosArgs,
    screen: &Screen,
) -> anyhow::Result<()> {
    arguments.check()?;
    let stop = Stop::new()?.after(arguments.duration);
    let mut record = RecordOptions::default();
    record.set_cache_bytes(DEFAULT_CACHE_BYTES);
    apply(arguments, &mut record)?;
    if record.snapshot_triggers.are_some() {
        bail!(
            "--snapshot-when and --snapshot-on-panic need --robot; of ROS 2, a snapshot is asked for by ~/snapshot"
        );
    }
    let format = arguments.writing.serialization_format.as_deref().unwrap_or("cdr");
    tracing::debug!(
        "storage {}, serialization {format}, compression mode {}",
        record.writer.storage.storage(),
        arguments.writing.compression_mode
    );
    let qos_overrides = match &arguments.discovery.qos_profile_overrides_path {
        Some(path) => QosOverrides::read(path)?,
        None => QosOverrides::default(),
    };
    let (participant, node) = arguments.network.node(&arguments.node_name, catalog, ros)?;
    let options = RosRecorderOptions {
        filter: filter(arguments, |name| Ok(node.topic_name(name)?.as_str().to_owned()))?,
        qos_overrides,
        encoding: record.encoding,
        uses_sim_time: arguments.use_sim_time,
        waits_for_room: record.recording.cache_bytes == 0,
    };
    arguments.force.make_way(Output::Bag, &output, [])?;
    let mut writer = record.writer(false).create(&output)?;
    writer.on_split(split_events(&node)?);
    let recording = Recording::start_with(writer, &record.recording(false))
        .context("cannot start the thread that writes the bag")?;
    let control = recording.control();
    let services = serve(&node, &control, record.recording.takes_snapshots())?;
    let mut recorder = RosRecorder::new(&participant, &node, recording.sender(), options)?;

    let keyboard = (!arguments.disable_keyboard_controls).then(Keyboard::open).flatten();
    if keyboard.is_some() {
        tracing::info!("Press SPACE for pausing/resuming");
    }
    tracing::info!("Listening for topics...");
    tracing::info!("{}", if control.is_paused() { "Wait for recording: paused." } else { "Recording..." });
    look_and_record(arguments, &mut recorder, &recording, &stop, keyboard.as_ref(), screen);
    drop(keyboard);
    screen.show(Vec::new());
    for topic in recorder.missing() {
        tracing::warn!("nothing is recorded on {topic}: it has no publisher");
    }
    drop(recorder);
    let outcome = recording.finish();
    drop(services);
    drop(node);
    tracing::info!("Recording stopped");
    let summary = match &outcome {
        Ok(summary) => summary,
        Err(failed) => &*failed.summary,
    };
    report(summary);
    outcome.map(drop).context("the recording is not complete")
}

/// How long existing topics are searched if later ones are not.
const FIRST_LOOK: Duration = Duration::from_secs(2);
/// How often the block on the screen is updated.
const REFRESH: Duration = Duration::from_millis(250);
/// How often keys and signals are checked.
const STEP: Duration = Duration::from_millis(20);

fn look_and_record(
    arguments: &RecordArguments,
    recorder: &mut RosRecorder,
    recording: &Recording,
    stop: &Stop,
    keyboard: Option<&Keyboard>,
    screen: &Screen,
) {
    let control = recording.control();
    let started = Instant::now();
    let interval = Duration::from_millis(arguments.discovery.polling_interval);
    let (mut next_look, mut next_refresh) = (started, started);
    let (mut is_looking, mut is_failure_told) = (true, false);
    while !stop.is_due() && !control.is_stopped() {
        let now = Instant::now();
        if now >= next_look {
            next_look = now + interval;
            if is_looking {
                recorder.discover();
            } else {
                recorder.describe();
            }
            if is_looking && recorder.is_complete() {
                tracing::info!("All requested topics are subscribed. Stopping discovery...");
                is_looking = false;
            }
            is_looking &= !(arguments.discovery.no_discovery && started.elapsed() >= FIRST_LOOK);
        }
        while let Some(key) = keyboard.and_then(Keyboard::pressed) {
            act_on(key, &control);
        }
        if now >= next_refresh {
            next_refresh = now + REFRESH;
            let statistics = recording.statistics();
            if let Some(failure) = statistics.failure.as_ref().filter(|_| !is_failure_told) {
                tracing::error!("the recording has stopped: {failure}");
                is_failure_told = true;
            }
            if screen.is_terminal() {
                let (height, width) = screen.block_size();
                screen.show(shorten(wrap(bag(&statistics), SEPARATOR, width), height));
            }
        }
        stop.sleep(STEP.min(interval));
    }
}

fn act_on(key: Key, control: &RecordingControl) {
    if key == Key::Space {
        let is_paused = control.toggle_paused();
        tracing::info!("{} recording.", if is_paused { "Pausing" } else { "Resuming" });
    }
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

/// The cache of rosbag2 (each of its two buffers): 100 MiB.
const DEFAULT_CACHE_BYTES: usize = 100 * 1024 * 1024;

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
