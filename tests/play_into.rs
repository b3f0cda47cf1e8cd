//! A bag that is played into the modules of a robot: the recorded messages are published again.
#![allow(clippy::unwrap_used, missing_docs)]

use std::path::Path;
use std::time::Duration;

use downbeat::bags::{Reader, Recording, Selection, WriterOptions};
use downbeat::bridge::edge::Interfaces;
use downbeat::executor::{
    Context, Core, ManualClock, Module, ModuleOptions, Publication, Received, Setup, SetupError, Synchrony,
    Time, TopicInfo,
};
use downbeat::journal::CycleJournal;
use downbeat::msgs::encoding::Encoding;
use downbeat::msgs::qos::QosProfile;
use downbeat::msgs::std_msgs::msg::Float64;
use downbeat::playback::{play_into, start_time};
use downbeat::recorder::{WhenFull, record};

/// A module whose output depends on the cycles: on their number between two inputs, and on whether an input
/// joins before or after a timer has fired.
#[derive(Default)]
struct Integrator {
    cycles: f64,
    sum: f64,
}

type Out = Publication<Float64>;

impl Module for Integrator {
    type Ports = Out;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Out, SetupError> {
        let out = setup.publish("out")?;
        setup.subscribe(
            "command",
            |module: &mut Self, command: Received<'_, Float64>, ctx: &mut Context<'_, Out>| {
                module.sum += command.data / module.cycles;
                ctx.publish(*ctx.ports, Float64 { data: module.sum });
            },
        )?;
        setup.every(Duration::from_millis(10), |module: &mut Self, ctx: &mut Context<'_, Out>| {
            module.sum *= 1.1;
            ctx.publish(*ctx.ports, Float64 { data: module.sum });
        })?;
        setup.each_run(|module: &mut Self, _| module.cycles += 1.0);
        Ok(out)
    }
}

fn robot(clock: &ManualClock) -> Core {
    let mut core = Core::new().with_clock(clock.clone());
    let options = ModuleOptions { synchrony: Synchrony::EveryCycle, ..ModuleOptions::default() };
    core.add_with("integrator", Integrator::default(), options).unwrap();
    core
}

fn start_recording(core: &mut Core, folder: &Path) -> Recording {
    let writer = WriterOptions::new().custom_data("robot", "r").create(folder).unwrap();
    let recording = Recording::start(writer, Recording::DEFAULT_QUEUE_BYTES).unwrap();
    let topics: Vec<TopicInfo> = core.topics().cloned().collect();
    let (cdr, carried) = (Encoding::Cdr, Interfaces::carried());
    record(core, &recording, &topics, WhenFull::Wait, cdr, &carried, |_| QosProfile::DEFAULT).unwrap();
    recording
}

fn published(bag: &Path) -> Vec<(i64, Vec<u8>)> {
    let reader = Reader::open(bag).unwrap();
    let messages = reader.messages(Selection::all().topics(reader.topic("/out"))).unwrap();
    messages
        .map(|message| message.unwrap())
        .map(|message| (message.log_time, message.data.to_vec()))
        .collect()
}

#[test]
fn messages_join_in_the_cycles_in_which_they_were_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (folder.path().join("first"), folder.path().join("second"));
    let clock = ManualClock::new(Time::from_nanos(1_000_000_000));
    let mut core = robot(&clock);
    let command = core.inlet::<Float64>("command").unwrap();
    CycleJournal::add(&mut core).unwrap();
    let recording = start_recording(&mut core, &first);
    for cycle in 0..200_u64 {
        // Independent of the timers and of the rate of messages.
        clock.advance(Duration::from_micros(1700 + cycle % 7 * 1300));
        if cycle % 3 == 1 {
            command.publish(Float64 { data: f64::from(u32::try_from(cycle).unwrap()) }).unwrap();
        }
        core.cycle().unwrap();
    }
    core.stop();
    recording.finish().unwrap();

    let reader = Reader::open(&first).unwrap();
    let clock = ManualClock::new(start_time(&reader).unwrap());
    let mut core = robot(&clock);
    let recording = start_recording(&mut core, &second);
    assert_eq!(play_into(&mut core, &clock, &reader, &[], &Interfaces::carried()).unwrap(), 67);
    recording.finish().unwrap();
    let (recorded, played) = (published(&first), published(&second));
    assert!(recorded.len() > 100, "{}", recorded.len());
    assert_eq!(played, recorded);
}
