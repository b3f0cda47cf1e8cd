//! A robot that a learned policy keeps on its feet, in a simulated world.
#![cfg(all(feature = "physics", feature = "policy"))]
#![allow(clippy::unwrap_used, missing_docs)]

use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use downbeat::App;
use downbeat::bags::Reader;
use downbeat::executor::{Context, Module, Publication, Received, Setup, SetupError, Time};
use downbeat::msgs::geometry_msgs::msg::Vector3Stamped;
use downbeat::msgs::nav_msgs::msg::Odometry;
use downbeat::replay::{ReplayOptions, replay};
use downbeat::running::{PreparedRobot, RecordPlan};

const ROBOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/darwin_op_balances.toml");

/// When the robot stands ready, and is pushed.
const PUSH: Duration = Duration::from_millis(2500);
const END: Duration = Duration::from_millis(4500);

/// Pushes the trunk once, and notes how far it is tilted.
struct Pusher {
    /// In N s.
    impulse: [f64; 2],
    has_policy: bool,
    start: Option<Time>,
    has_pushed: bool,
    /// In rad.
    tilt: Arc<Mutex<f64>>,
}

struct Ports {
    push: Publication<Vector3Stamped>,
}

impl Pusher {
    fn on_truth(&mut self, truth: Received<'_, Odometry>, ctx: &mut Context<'_, Ports>) {
        let q = &truth.pose.pose.orientation;
        *self.tilt.lock().unwrap() = libm::acos((1.0 - 2.0 * (q.x * q.x + q.y * q.y)).clamp(-1.0, 1.0));
        let now = ctx.now();
        if self.start.is_none() {
            ctx.set("balance", "enabled", self.has_policy);
        }
        let start = *self.start.get_or_insert(now);
        if now.saturating_since(start) >= PUSH && !std::mem::replace(&mut self.has_pushed, true) {
            let mut push = Vector3Stamped::default();
            "torso".clone_into(&mut push.header.frame_id);
            [push.vector.x, push.vector.y] = self.impulse;
            ctx.publish(ctx.ports.push, push);
        }
    }
}

impl Module for Pusher {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        setup.subscribe("ground_truth/odom", Self::on_truth)?;
        Ok(Ports { push: setup.publish("push")? })
    }
}

/// Runs the robot, with a bag if there is a path for one, and returns how far it is tilted two seconds after
/// a push, in rad.
fn tilt_after(impulse: [f64; 2], has_policy: bool, bag: Option<&Path>) -> f64 {
    let file = App::with_built_in_kinds().robot_file(ROBOT).unwrap();
    let mut prepared = PreparedRobot::simulated(file, Some(END)).unwrap();
    let tilt = Arc::<Mutex<f64>>::default();
    let pusher = Pusher { impulse, has_policy, start: None, has_pushed: false, tilt: Arc::clone(&tilt) };
    prepared.core().add("pusher", pusher).unwrap();
    if let Some(bag) = bag {
        let plan = RecordPlan::of_robot(bag, prepared.file(), None);
        prepared.record(plan).unwrap();
    }
    let running = prepared.start().unwrap();
    let watchdog = Instant::now() + Duration::from_secs(300);
    while !running.is_finished() {
        assert!(Instant::now() < watchdog, "{END:?} of simulated time took five minutes");
        std::thread::sleep(Duration::from_millis(5));
    }
    running.stop().unwrap();
    let tilt = *tilt.lock().unwrap();
    tilt
}

#[test]
fn a_push_that_throws_the_robot_over_does_not_with_the_policy_and_the_run_replays() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let push = [0.8, 0.0];
    let [without, with_it] = [tilt_after(push, false, None), tilt_after(push, true, Some(&bag))];
    assert!(without > 1.0 && with_it < 0.5, "{without} rad without the policy, {with_it} with it");

    let file = App::with_built_in_kinds().robot_file(ROBOT).unwrap();
    let mut pool = App::with_built_in_kinds().robot_file(ROBOT).unwrap();
    pool.launcher.choice = "pool".parse().unwrap();
    for file in [file, pool] {
        let report = replay(file, &Reader::open(&bag).unwrap(), &ReplayOptions::default()).unwrap();
        assert!(report.modules.iter().any(|module| module == "balance"), "{:?}", report.modules);
        report.assert_same().unwrap();
    }
}
