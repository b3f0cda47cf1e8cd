//! `downbeat bag play`

use std::time::{Duration, Instant};

use anyhow::Context;
use downbeat::bags::{BagMessage, Playback, PlaybackOptions, Rate, Reader, Recording, Step, WriterOptions};
use downbeat::bridge::ros::{MessageType, Node, Publisher};
use downbeat::encoding::RecordedType;
use downbeat::executor::{Core, ManualClock, Time};
use downbeat::msgs::qos::QosProfile;
use downbeat::playback;
use downbeat::recorder::{self, WhenFull};
use downbeat::robot::{RobotFile, RosArgs};

use crate::program::cli::PlayArguments;
use crate::program::run::node;
use crate::program::stop::Stop;

pub(crate) fn play(arguments: &PlayArguments, ros: &RosArgs) -> anyhow::Result<()> {
    let reader = Reader::open(&arguments.bag)?;
    for truncation in reader.truncation() {
        tracing::warn!("{truncation}");
    }
    match &arguments.into {
        Some(robot) => play_into(&reader, robot, arguments, ros),
        None => play_to_ros(&reader, arguments, ros),
    }
}

fn play_into(
    reader: &Reader,
    robot: &std::path::Path,
    arguments: &PlayArguments,
    ros: &RosArgs,
) -> anyhow::Result<()> {
    let clock = ManualClock::new(Time::from_nanos(reader.start_time().unwrap_or(0)));
    let file = RobotFile::read_with(robot, ros)?;
    file.refuse_devices()?;
    let mut robot = file.on_any_machine().build(Core::new().with_clock(clock.clone()))?;
    let recording = arguments
        .record
        .as_ref()
        .map(|directory| -> anyhow::Result<Recording> {
            let writer = WriterOptions::new().custom_data("played_from", arguments.bag.display().to_string());
            let recording = Recording::start(writer.create(directory)?, Recording::DEFAULT_QUEUE_BYTES)?;
            let published: Vec<_> = robot.core.topics().filter(|topic| topic.is_published).cloned().collect();
            let wait = WhenFull::Wait;
            let encoding = arguments.encoding.unwrap_or_default();
            recorder::record(&mut robot.core, &recording, &published, wait, encoding, |_| {
                QosProfile::DEFAULT
            })?;
            Ok(recording)
        })
        .transpose()?;
    let played = playback::play_into(&mut robot.core, &clock, reader, &arguments.topics)?;
    println!("played {played} messages into {}", robot.file.name);
    if let Some(recording) = recording {
        let summary = recording.finish()?;
        let (messages, lost) = (summary.message_count(), summary.lost_count());
        println!("recorded {messages} messages, lost {lost}, in {}", summary.path.display());
    }
    Ok(())
}

/// How long publishers wait to be found at the most: samples written before that reach nobody.
const DISCOVERY: Duration = Duration::from_secs(3);

fn play_to_ros(reader: &Reader, arguments: &PlayArguments, ros: &RosArgs) -> anyhow::Result<()> {
    let options = PlaybackOptions {
        rate: Rate::new(arguments.rate)?,
        start_offset: arguments.start_offset.unwrap_or_default(),
        topics: (!arguments.topics.is_empty()).then(|| {
            arguments.topics.iter().map(|topic| format!("/{}", topic.trim_start_matches('/'))).collect()
        }),
    };
    let mut playback = Playback::open(reader, &options)?;
    let stop = Stop::new()?;
    let (_, node) = node("downbeat_bag_play", arguments.domain, ros)?;
    let publishers = publishers(reader, &options, &node)?;
    wait_for_subscriptions(&publishers, &stop);
    let (started, mut played, mut refused) = (Instant::now(), 0_u64, 0_u64);
    while !stop.is_due() {
        match playback.step(started.elapsed()) {
            Step::Due(BagMessage { topic, data, .. }) => {
                let Some((publisher, recorded)) = publishers.get(topic.index()).and_then(Option::as_ref)
                else {
                    continue;
                };
                let data = match recorded.as_ref().map_or(Ok(data.clone()), |recorded| recorded.to_cdr(data))
                {
                    Ok(data) => data,
                    Err(error) => {
                        tracing::warn!("{}: {error}", publisher.topic().as_str());
                        continue;
                    }
                };
                match publisher.publish(data) {
                    Ok(()) => played += 1,
                    Err(error) => {
                        refused += 1;
                        tracing::debug!("{}: {error}", publisher.topic().as_str());
                    }
                }
            }
            Step::Wait(time) => stop.sleep(time),
            Step::Failed(error) => tracing::warn!("{error}"),
            Step::Paused | Step::Finished => break,
        }
    }
    println!("played {played} messages; {refused} were refused by the middleware");
    Ok(())
}

/// Who publishes a topic, and what makes CDR of its messages if they are something else.
type Played = (Publisher, Option<RecordedType>);

fn wait_for_subscriptions(publishers: &[Option<Played>], stop: &Stop) {
    let started = Instant::now();
    let is_heard = |(publisher, _): &Played| publisher.matched_subscriptions() > 0;
    while !publishers.iter().flatten().all(is_heard) && started.elapsed() < DISCOVERY && !stop.is_due() {
        stop.sleep(Duration::from_millis(50));
    }
}

/// A publisher for each topic that is played, at the position of its id.
fn publishers(
    reader: &Reader,
    options: &PlaybackOptions,
    node: &Node,
) -> anyhow::Result<Vec<Option<Played>>> {
    let is_played = |name: &String| options.topics.as_ref().is_none_or(|topics| topics.contains(name));
    let publisher = |topic: &downbeat::bags::RecordedTopic| -> anyhow::Result<Option<Played>> {
        let info = &topic.info;
        if !is_played(&info.name) {
            return Ok(None);
        }
        // CDR is passed through, also of types that are not compiled in.
        let recorded = info.format.as_ref().map(|_| RecordedType::of(topic)).transpose()?;
        let type_name = recorded.as_ref().map_or(&*info.type_name, |recorded| recorded.message_type().name());
        let message_type = MessageType::new(type_name)?;
        let qos = info.offered_qos.first().map_or(QosProfile::DEFAULT, |offered| offered.to_profile());
        let publisher = node.publish(&info.name, &message_type, qos);
        let publisher = publisher.with_context(|| format!("cannot publish {}", info.name))?;
        Ok(Some((publisher, recorded)))
    };
    reader.topics().iter().map(publisher).collect()
}
