//! Recording topics of the network: one bag, or one after another as the services of the recorder ask.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};

use super::arguments::RecordArguments;
use super::controls::{Control, Controls, Outcome, is_running, stopped};
use super::{apply, filter, report, unnamed};
use crate::new_output::{Force, Output};
use crate::screen::{Screen, shorten, wrap};
use crate::status::{SEPARATOR, bag};
use crate::stop::{Key, Keyboard, Stop};
use downbeat_bags::Recording;
use downbeat_bridge::ros::{Node, Participant};
use downbeat_robot::ros_recorder::{
    QosOverrides, RosRecorder, RosRecorderOptions, SteeredRecording, serve, split_events,
};
use downbeat_robot::{Catalog, RecordOptions, RosArgs};

/// The cache of rosbag2 (each of its two buffers): 100 MiB.
const DEFAULT_CACHE_BYTES: usize = 100 * 1024 * 1024;
/// How long existing topics are searched if later ones are not.
const FIRST_LOOK: Duration = Duration::from_secs(2);
/// How often the block on the screen is updated.
const REFRESH: Duration = Duration::from_millis(250);
/// How often keys, requests and signals are checked.
const STEP: Duration = Duration::from_millis(20);

pub(super) fn record(
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
    if record.snapshot_triggers.on_panic {
        bail!(
            "--snapshot-on-panic needs --robot: of modules of other programs it is not known that they panic"
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
    let network = Network { arguments, participant: &participant, node: &node, record, options };
    let first = network.begin(&output, network.record.recording.is_paused)?;
    let steered = SteeredRecording::new(first.recording.control());
    let services = serve(&node, &steered, network.record.recording.takes_snapshots())?;
    let controls = Controls::offer(&node)?;

    let keyboard = (!arguments.disable_keyboard_controls).then(Keyboard::open).flatten();
    if keyboard.is_some() {
        tracing::info!("Press SPACE for pausing/resuming");
    }
    let mut recorder = Recorder { network, steered, current: Some(first), last: output };
    let mut next_refresh = Instant::now();
    let outcome = loop {
        if stop.is_due() {
            break recorder.end();
        }
        if let Some(current) = recorder.current.as_mut() {
            current.look(&arguments.discovery);
            // A disk that is full, or too slow for `--slow-disk stop`.
            if current.recording.control().is_stopped() {
                break recorder.end();
            }
        }
        while let Some(control) = controls.next() {
            recorder.obey(control);
        }
        while let Some(key) = keyboard.as_ref().and_then(Keyboard::pressed) {
            recorder.act_on(key);
        }
        let now = Instant::now();
        if now >= next_refresh {
            next_refresh = now + REFRESH;
            recorder.show(screen);
        }
        stop.sleep(STEP.min(Duration::from_millis(arguments.discovery.polling_interval)));
    };
    drop(keyboard);
    screen.show(Vec::new());
    drop(services);
    outcome
}

/// What all bags of a recorder have in common.
struct Network<'a> {
    arguments: &'a RecordArguments,
    participant: &'a Participant,
    node: &'a Node,
    record: RecordOptions,
    options: RosRecorderOptions,
}

/// A bag that is being recorded.
struct Current {
    topics: RosRecorder,
    recording: Recording,
    started: Instant,
    next_look: Instant,
    is_discovering: bool,
}

impl Network<'_> {
    fn begin(&self, directory: &Path, is_paused: bool) -> anyhow::Result<Current> {
        let mut writer = self.record.writer(false).create(directory)?;
        writer.on_split(split_events(self.node)?);
        let mut options = self.record.recording(false);
        options.is_paused = is_paused;
        let recording =
            Recording::start_with(writer, &options).context("cannot start the thread that writes the bag")?;
        let mut topics =
            RosRecorder::new(self.participant, self.node, recording.sender(), self.options.clone())?;
        let triggers = &self.record.snapshot_triggers;
        if let Some(expression) = &triggers.when {
            let watched = topics.watch(expression, recording.control(), triggers.after);
            watched.map_err(|problem| anyhow::anyhow!("--snapshot-when: {problem}"))?;
        }
        tracing::info!("Listening for topics...");
        tracing::info!("{}", if is_paused { "Wait for recording: paused." } else { "Recording..." });
        let now = Instant::now();
        Ok(Current { topics, recording, started: now, next_look: now, is_discovering: true })
    }
}

impl Current {
    /// Looks for new topics, and finds out what types look like.
    fn look(&mut self, discovery: &super::arguments::DiscoveryArguments) {
        let now = Instant::now();
        if now < self.next_look {
            return;
        }
        self.next_look = now + Duration::from_millis(discovery.polling_interval);
        if !self.is_discovering {
            return self.topics.describe();
        }
        self.topics.discover();
        if self.topics.is_complete() {
            tracing::info!("All requested topics are subscribed. Stopping discovery...");
            self.is_discovering = false;
        }
        self.is_discovering &= !(discovery.no_discovery && self.started.elapsed() >= FIRST_LOOK);
    }
}

/// A recorder that records again if it is asked to.
struct Recorder<'a> {
    network: Network<'a>,
    steered: SteeredRecording,
    current: Option<Current>,
    /// The directory of the latest bag.
    last: PathBuf,
}

impl Recorder<'_> {
    fn obey(&mut self, control: Control) {
        match control {
            Control::Record(uri, reply) => reply.answer(self.record_again(&uri)),
            Control::Stop(reply) => {
                if let Err(error) = self.end() {
                    tracing::error!("{error:#}");
                }
                stopped(reply);
            }
            Control::StartDiscovery(reply) => reply.answer(match &mut self.current {
                None => Err("nothing is being recorded".to_owned()),
                Some(current) if current.is_discovering => Err("discovery is running already".to_owned()),
                Some(current) => {
                    current.is_discovering = true;
                    current.next_look = Instant::now();
                    Ok(())
                }
            }),
            Control::StopDiscovery(reply) => reply.answer(match &mut self.current {
                Some(current) if current.is_discovering => {
                    current.is_discovering = false;
                    Ok(())
                }
                _ => Err("discovery is not running".to_owned()),
            }),
            Control::IsDiscoveryRunning(reply) => {
                is_running(reply, self.current.as_ref().is_some_and(|current| current.is_discovering));
            }
        }
    }

    fn record_again(&mut self, uri: &str) -> Result<(), String> {
        if self.current.is_some() {
            return Err("a recording is running already: stop it first".to_owned());
        }
        let directory = match uri.strip_prefix("file://").unwrap_or(uri) {
            "" => {
                let named = self.network.arguments.output.clone().unwrap_or_else(unnamed);
                Force::default().next_run(&named).map_err(|error| format!("{error:#}"))?
            }
            directory => PathBuf::from(directory),
        };
        let is_paused = self.steered.control().is_paused();
        let begun = self.network.begin(&directory, is_paused).map_err(|error| format!("{error:#}"))?;
        self.steered.replace(begun.recording.control());
        tracing::info!("recording into {}", directory.display());
        (self.current, self.last) = (Some(begun), directory);
        Ok(())
    }

    /// Finishes the bag, if one is being recorded.
    fn end(&mut self) -> anyhow::Result<()> {
        let Some(Current { topics, recording, .. }) = self.current.take() else { return Ok(()) };
        for topic in topics.missing() {
            tracing::warn!("nothing is recorded on {topic}: it has no publisher");
        }
        for name in topics.missing_for_condition() {
            tracing::warn!("--snapshot-when was never evaluated: no topic that is published is \"{name}\"");
        }
        drop(topics);
        let outcome = recording.finish();
        tracing::info!("Recording stopped");
        report(match &outcome {
            Ok(summary) => summary,
            Err(failed) => &failed.summary,
        });
        outcome.map(drop).with_context(|| format!("the recording {} is not complete", self.last.display()))
    }

    fn act_on(&self, key: Key) {
        if key == Key::Space {
            let is_paused = self.steered.control().toggle_paused();
            tracing::info!("{} recording.", if is_paused { "Pausing" } else { "Resuming" });
        }
    }

    fn show(&self, screen: &Screen) {
        if !screen.is_terminal() {
            return;
        }
        let block = self.current.as_ref().map_or_else(Vec::new, |current| {
            let (height, width) = screen.block_size();
            shorten(wrap(bag(&current.recording.statistics()), SEPARATOR, width), height)
        });
        screen.show(block);
    }
}
