//! Playing into the modules of a robot.

use std::path::Path;

use downbeat_bags::{Reader, Recording, WriterOptions};
use downbeat_executor::{Core, ManualClock};
use downbeat_msgs::qos::QosProfile;
use downbeat_robot::playback;
use downbeat_robot::recorder::{self, Unrecorded, WhenFull};
use downbeat_robot::{Catalog, RobotFile, RosArgs};

use super::PlayArguments;
use crate::logging::Log;
use crate::new_output::Output;

pub(super) fn play_into(
    reader: &Reader,
    robot: &Path,
    arguments: &PlayArguments,
    catalog: &Catalog,
    ros: &RosArgs,
    log: &Log,
) -> anyhow::Result<()> {
    if let Some(directory) = &arguments.record {
        arguments.force.make_way(Output::Bag, directory, [reader.path()])?;
    }
    let clock = ManualClock::new(playback::start_time(reader)?);
    let file = RobotFile::read_with(robot, catalog, ros)?;
    log.name_after(&file)?;
    file.refuse_devices()?;
    let mut robot = file.on_any_machine().build(Core::new().with_clock(clock.clone()))?;
    let recording = arguments
        .record
        .as_ref()
        .map(|directory| -> anyhow::Result<Recording> {
            let writer = WriterOptions::new().custom_data("played_from", reader.path().display().to_string());
            let published: Vec<_> = robot.core.topics().filter(|topic| topic.is_published).cloned().collect();
            let unrecorded = Unrecorded::of(&published, &robot.file.catalog.interfaces);
            unrecorded.warn();
            let writer = unrecorded.note(writer).create(directory)?;
            let recording = Recording::start(writer, Recording::DEFAULT_QUEUE_BYTES)?;
            let wait = WhenFull::Wait;
            let encoding = arguments.encoding.unwrap_or_default();
            let interfaces = &robot.file.catalog.interfaces;
            let qos_of = |_: &str| QosProfile::DEFAULT;
            recorder::record(&mut robot.core, &recording, &published, wait, encoding, interfaces, qos_of)?;
            Ok(recording)
        })
        .transpose()?;
    let played = playback::play_into(
        &mut robot.core,
        &clock,
        reader,
        &arguments.topics.topics,
        &robot.file.catalog.interfaces,
    )?;
    println!("played {played} messages into {}", robot.file.name);
    if let Some(recording) = recording {
        let summary = recording.finish()?;
        let (messages, lost) = (summary.message_count(), summary.lost_count());
        println!("recorded {messages} messages, lost {lost}, in {}", summary.path.display());
    }
    Ok(())
}
