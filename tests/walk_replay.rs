//! A walk with a push, a fall and a get-up, recorded in simulated time, replays bit for bit. All data is
//! simulated.
//!
//! The bag depends on gait, motions, falls and physics. `cargo xtask record-walk` records it again after a
//! change to them.
#![cfg(feature = "physics")]
#![allow(clippy::unwrap_used, missing_docs)]

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use downbeat::App;
use downbeat::bags::{Reader, Selection};
use downbeat::bridge::expose::TopicPattern;
use downbeat::executor::{Inbox, Module, Publication, Received, Setup, SetupError, Time};
use downbeat::msgs::cdr;
use downbeat::msgs::geometry_msgs::msg::{Twist, Vector3Stamped};
use downbeat::msgs::std_msgs::msg::{Bool, String as Text};
use downbeat::replay::{ReplayOptions, ReplayReport, replay};
use downbeat::robot::{LauncherChoice, RobotFile};
use downbeat::running::{PreparedRobot, RecordPlan, SIMULATION_START};

fn recordings() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("bags/recordings")
}

fn bag() -> PathBuf {
    recordings().join("darwin_op_walk_simulated")
}

fn robot() -> RobotFile {
    App::with_built_in_kinds().robot_file(recordings().join("darwin_op_walk_simulated.toml")).unwrap()
}

/// Steers and pushes the robot, as a ROS 2 operator would. It is not in the robot file, so a replay takes its
/// messages from the bag.
struct Operator;

struct Ports {
    cmd_vel: Publication<Twist>,
    push: Publication<Vector3Stamped>,
}

/// The time after the start of the first walking command.
const WALK: Duration = Duration::from_secs(2);
/// The time of the push.
const PUSH: Duration = Duration::from_millis(4500);

impl Module for Operator {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        setup.every(Duration::from_millis(100), |_, ctx| {
            let since_start = ctx.now().saturating_since(SIMULATION_START);
            if since_start >= WALK {
                let mut twist = Twist::default();
                twist.linear.x = 0.1;
                ctx.publish(ctx.ports.cmd_vel, twist);
            }
            if since_start == PUSH {
                let mut push = Vector3Stamped::default();
                push.header.frame_id = "torso".into();
                push.vector.x = 3.0;
                ctx.publish(ctx.ports.push, push);
            }
        })?;
        Ok(Ports { cmd_vel: setup.publish("cmd_vel")?, push: setup.publish("push")? })
    }
}

/// Not a test: `cargo xtask record-walk` runs it to record the bag again.
#[test]
#[ignore = "records the bag of the other tests"]
fn record_the_walk() {
    let _ = std::fs::remove_dir_all(bag());
    let mut prepared = PreparedRobot::simulated(robot(), None).unwrap();
    prepared.core().add("operator", Operator).unwrap();
    let (handle, mut has_fallen, mut upright) = (prepared.core().handle(), false, 0);
    let watch = move |state: Received<'_, Text>| {
        has_fallen |= state.data == "falling";
        upright += u32::from(has_fallen && state.data == "upright");
        // The recording ends one second after the robot has got up, because its state is published on changes
        // and once a second.
        if upright == 2 {
            handle.stop();
        }
    };
    prepared.core().outlet("robot_state", Inbox::KeepAll, watch).unwrap().keep();
    let plan = RecordPlan::of_robot(&bag(), prepared.file(), None);
    prepared.record(plan).unwrap();
    let running = prepared.start().unwrap();
    let watchdog = Instant::now() + Duration::from_secs(600);
    while !running.is_finished() {
        assert!(Instant::now() < watchdog, "the robot has not fallen and got up in ten minutes");
        std::thread::yield_now();
    }
    let summary = running.stop().unwrap().unwrap();
    assert_eq!(summary.lost_count(), 0);
}

fn replayed(launcher: LauncherChoice) -> ReplayReport {
    let mut file = robot();
    file.launcher.choice = launcher;
    let of_simulator = ["ground_truth/*", "simulation", "simulator/**"];
    let except = of_simulator.map(|topic| TopicPattern::new(topic).unwrap()).into();
    let options = ReplayOptions { except, ..ReplayOptions::default() };
    replay(file, &Reader::open(bag()).unwrap(), &options).unwrap()
}

#[test]
fn the_recorded_walk_repeats_bit_for_bit_under_every_launcher() {
    let launchers = [LauncherChoice::Linear, "pool:2".parse().unwrap(), LauncherChoice::Threads];
    for launcher in launchers {
        let report = replayed(launcher);
        for topic in ["/joint_states", "/joint_goals", "/bus/exchanges", "/imu/data"] {
            let compared =
                report.topics.iter().find(|known| known.topic == topic).map(|known| known.compared);
            assert!(compared.is_some_and(|compared| compared > 1000), "{topic} in {report}");
        }
        report.assert_same().unwrap();
    }
}

/// The messages of a topic with their times since the start.
fn recorded<T: downbeat::msgs::Message>(topic: &str) -> Vec<(Duration, T)> {
    let reader = Reader::open(bag()).unwrap();
    let messages = reader.messages(Selection::all().topics(reader.topic(topic))).unwrap();
    let messages = messages.map(|found| {
        let found = found.unwrap();
        let time = Time::from_nanos(found.log_time).saturating_since(SIMULATION_START);
        (time, cdr::from_slice(&found.data).unwrap())
    });
    messages.collect()
}

#[test]
fn the_recorded_robot_walks_falls_when_it_is_pushed_and_gets_up() {
    let metadata = Reader::open(bag()).unwrap().metadata().unwrap().clone();
    assert_eq!(metadata.custom_data.get("emulated").map(String::as_str), Some("true"));
    let walks = recorded::<Bool>("/walking");
    assert!(walks.iter().any(|(time, walking)| walking.data && *time < PUSH));
    let mut states: Vec<(Duration, String)> =
        recorded::<Text>("/robot_state").into_iter().map(|(time, state)| (time, state.data)).collect();
    states.dedup_by(|later, earlier| later.1 == earlier.1);
    let names: Vec<&str> = states.iter().map(|(_, name)| name.as_str()).collect();
    assert_eq!((names[0], names.last()), ("upright", Some(&"upright")), "{states:?}");
    assert!(states[1].0 >= PUSH && names.contains(&"getting_up"), "{states:?}");
}
