//! In a replay, inputs take effect in the same cycle as when they were recorded, even if several cycles ran
//! at one time.
#![allow(clippy::unwrap_used, missing_docs)]

use std::path::{Path, PathBuf};
use std::time::Duration;

use downbeat::App;
use downbeat::bags::{Reader, Selection, WriterOptions};
use downbeat::executor::{Context, Job, Module, Publication, Received, Setting, Setup, SetupError};
use downbeat::msgs::std_msgs::msg::{Float64, String as Text};
use downbeat::replay::{ReplayOptions, ReplayReport, replay};
use downbeat::running::{PreparedRobot, RecordPlan};

/// Takes pictures in jobs, like a simulated camera: the results arrive at the same simulated time, in a later
/// cycle.
struct Camera;

impl Module for Camera {
    type Ports = Job<u32>;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Job<u32>, SetupError> {
        let picture = setup.publish("picture")?;
        let job = setup.job(move |_: &mut Self, result, ctx: &mut Context<'_, Job<u32>>| {
            let number: u32 = result.unwrap();
            ctx.publish(picture, Text { data: format!("picture {number}") });
            if number.is_multiple_of(3) {
                ctx.publish(picture, Text { data: format!("another picture {number}") });
                ctx.set("stepper", "brightness", i64::from(number));
            }
        });
        let mut pictures = 0;
        setup.every(Duration::from_millis(10), move |_: &mut Self, ctx| {
            pictures += 1;
            let number = pictures;
            ctx.spawn(*ctx.ports, move || number);
        })?;
        Ok(job)
    }
}

/// Does its work in several cycles at one time, and publishes the cycle in which each input arrived.
#[derive(Default)]
struct Stepper {
    step: u32,
}

#[derive(Clone, Copy)]
struct StepperPorts {
    steps: Publication<Float64>,
    seen: Publication<Text>,
    brightness: Setting<i64>,
}

impl Module for Stepper {
    type Ports = StepperPorts;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<StepperPorts, SetupError> {
        setup.every(Duration::from_millis(10), |stepper: &mut Self, ctx| {
            stepper.step = 0;
            ctx.publish(ctx.ports.steps, Float64::default());
        })?;
        setup.subscribe("steps", |stepper: &mut Self, _: Received<'_, Float64>, ctx| {
            stepper.step += 1;
            let brightness = *ctx.get(ctx.ports.brightness);
            ctx.publish(
                ctx.ports.seen,
                Text { data: format!("brightness {brightness} in step {}", stepper.step) },
            );
            if stepper.step < 6 {
                ctx.publish(ctx.ports.steps, Float64::default());
            }
        })?;
        setup.subscribe("picture", |stepper: &mut Self, picture: Received<'_, Text>, ctx| {
            ctx.publish(ctx.ports.seen, Text { data: format!("{} in step {}", picture.data, stepper.step) });
        })?;
        Ok(StepperPorts {
            steps: setup.publish("steps")?,
            seen: setup.publish("seen")?,
            brightness: setup.setting("brightness", 0_i64, "set by the camera")?,
        })
    }
}

const ROBOT: &str = "[robot]\nname = \"stepping\"\n\
    [[module]]\nkind = \"camera\"\nname = \"camera\"\n\
    [[module]]\nkind = \"stepper\"\nname = \"stepper\"\n\
    [record]\ntopics = \"all\"\n";

fn app() -> App {
    App::new().kind("camera", "takes pictures", || Camera).kind("stepper", "works in steps", Stepper::default)
}

/// Records the robot for a second of simulated time.
fn recorded(folder: &Path) -> (PathBuf, PathBuf) {
    let (robot, bag) = (folder.join("robot.toml"), folder.join("bag"));
    std::fs::write(&robot, ROBOT).unwrap();
    let file = app().robot_file(&robot).unwrap();
    let mut prepared = PreparedRobot::simulated(file, Some(Duration::from_secs(1))).unwrap();
    let plan = RecordPlan::of_robot(&bag, prepared.file(), None);
    prepared.record(plan).unwrap();
    let running = prepared.start().unwrap();
    wait_until(|| running.is_finished());
    assert_eq!(running.stop().unwrap().unwrap().lost_count(), 0);
    (robot, bag)
}

fn wait_until(is_done: impl Fn() -> bool) {
    let watchdog = std::time::Instant::now() + Duration::from_secs(60);
    while !is_done() {
        assert!(std::time::Instant::now() < watchdog, "the robot has not finished in a minute");
        std::thread::yield_now();
    }
}

fn replayed(robot: &Path, bag: &Path, modules: &[&str], launcher: &str) -> ReplayReport {
    let mut file = app().robot_file(robot).unwrap();
    file.launcher.choice = launcher.parse().unwrap();
    let modules = modules.iter().map(|&name| name.to_owned()).collect();
    let options = ReplayOptions { modules, ..ReplayOptions::default() };
    replay(file, &Reader::open(bag).unwrap(), &options).unwrap()
}

/// A copy of the bag without a topic.
fn without(bag: &Path, topic: &str) -> PathBuf {
    let reader = Reader::open(bag).unwrap();
    let target = bag.with_file_name("without");
    let custom_data = reader.metadata().unwrap().custom_data.clone();
    let options = custom_data
        .into_iter()
        .fold(WriterOptions::new(), |options, (key, value)| options.custom_data(key, value));
    let mut writer = options.create(&target).unwrap();
    let topics = reader.topics().iter();
    let kept: Vec<_> = topics
        .map(|known| (known.info.name != topic).then(|| writer.add_topic(known.info.clone()).unwrap()))
        .collect();
    for message in reader.messages(Selection::all()).unwrap() {
        let message = message.unwrap();
        if let Some(id) = kept[message.topic.index()] {
            writer.write(id, message.log_time, message.publish_time, &message.data).unwrap();
        }
    }
    writer.finish().unwrap();
    target
}

#[test]
fn messages_and_settings_of_a_module_that_is_left_out_join_in_their_cycles() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = recorded(folder.path());
    for launcher in ["linear", "pool:2"] {
        for modules in [&["stepper"] as &[_], &["camera"], &[]] {
            let report = replayed(&robot, &bag, modules, launcher);
            report.assert_same().unwrap_or_else(|error| panic!("{modules:?} under {launcher}: {error}"));
        }
    }
}

#[test]
fn a_bag_without_the_cycles_of_messages_is_replayed_by_their_times() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = recorded(folder.path());
    let older = without(&bag, "/cycle_messages");
    replayed(&robot, &older, &["camera"], "linear").assert_same().unwrap();
    // The messages of the camera arrive too early.
    let report = replayed(&robot, &older, &["stepper"], "linear");
    assert!(report.different() > 0 && report.has_recorded_cycles, "{report}");
    assert_eq!(report.missing_inputs, ["cycle_messages"]);
}
