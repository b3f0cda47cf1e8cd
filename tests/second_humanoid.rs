//! A second humanoid walks, by files alone: its description, its numbers, its servos, its robot file.
#![cfg(feature = "physics")]
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat::App;
use downbeat::executor::{Context, Module, Publication, Received, Setup, SetupError};
use downbeat::msgs::geometry_msgs::msg::Twist;
use downbeat::msgs::nav_msgs::msg::Odometry;
use downbeat::msgs::std_msgs::msg::{Bool, String as Text};
use downbeat::running::PreparedRobot;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// When each command begins, in s, and its velocity: forward and to the left in m/s, to the left in rad/s.
const COMMANDS: [(f64, [f64; 3]); 5] = [
    (0.0, [0.0; 3]),
    (3.0, [0.08, 0.0, 0.0]),
    (13.0, [0.0, 0.0, 0.4]),
    (18.0, [0.06, 0.0, -0.2]),
    (23.0, [0.0; 3]),
];
const END_S: f64 = 27.0;

/// A moment of the walk.
#[derive(Clone, Debug)]
struct Moment {
    time: f64,
    position: [f64; 3],
    yaw: f64,
    /// Of the trunk from the vertical, in rad.
    tilt: f64,
}

#[derive(Default)]
struct Seen {
    moments: Vec<Moment>,
    odometry: [f64; 2],
    states: Vec<String>,
    is_walking: bool,
}

/// Commands the robot by the table, and notes where it is.
struct Walker {
    seen: Arc<Mutex<Seen>>,
    start: Option<downbeat::executor::Time>,
}

struct Ports {
    cmd_vel: Publication<Twist>,
}

impl Walker {
    fn command(&mut self, ctx: &mut Context<'_, Ports>) {
        let time = self.time(ctx);
        let (_, [forward, left, turn]) = *COMMANDS.iter().rfind(|(start, _)| *start <= time).unwrap();
        let mut twist = Twist::default();
        [twist.linear.x, twist.linear.y, twist.angular.z] = [forward, left, turn];
        if twist != Twist::default() {
            ctx.publish(ctx.ports.cmd_vel, twist);
        }
    }

    fn time(&mut self, ctx: &Context<'_, Ports>) -> f64 {
        let now = ctx.now();
        now.saturating_since(*self.start.get_or_insert(now)).as_secs_f64()
    }

    fn on_truth(&mut self, truth: Received<'_, Odometry>, ctx: &mut Context<'_, Ports>) {
        let (p, q) = (&truth.pose.pose.position, &truth.pose.pose.orientation);
        let moment = Moment {
            time: self.time(ctx),
            position: [p.x, p.y, p.z],
            yaw: libm::atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z)),
            tilt: libm::acos((1.0 - 2.0 * (q.x * q.x + q.y * q.y)).clamp(-1.0, 1.0)),
        };
        self.seen.lock().unwrap().moments.push(moment);
    }
}

impl Module for Walker {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        setup.every(Duration::from_millis(100), Self::command)?;
        setup.subscribe("ground_truth/odom", Self::on_truth)?;
        setup.subscribe("odom", |walker: &mut Self, odometry: Received<'_, Odometry>, _| {
            let position = &odometry.pose.pose.position;
            walker.seen.lock().unwrap().odometry = [position.x, position.y];
        })?;
        setup.subscribe("robot_state", |walker: &mut Self, state: Received<'_, Text>, _| {
            walker.seen.lock().unwrap().states.push(state.data.clone());
        })?;
        setup.subscribe("walking", |walker: &mut Self, walking: Received<'_, Bool>, _| {
            walker.seen.lock().unwrap().is_walking = walking.data;
        })?;
        Ok(Ports { cmd_vel: setup.publish("cmd_vel")? })
    }
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn a_robot_of_other_dimensions_and_servos_walks_and_turns_and_does_not_fall() {
    let file = App::with_built_in_kinds().robot_file(root().join("robots/op3_walks.toml")).unwrap();
    let mut prepared = PreparedRobot::simulated(file, Some(Duration::from_secs_f64(END_S))).unwrap();
    let seen = Arc::<Mutex<Seen>>::default();
    prepared.core().add("walker", Walker { seen: Arc::clone(&seen), start: None }).unwrap();
    let running = prepared.start().unwrap();
    let watchdog = Instant::now() + Duration::from_secs(300);
    while !running.is_finished() {
        assert!(Instant::now() < watchdog, "{END_S} simulated seconds took five minutes");
        std::thread::sleep(Duration::from_millis(5));
    }
    running.stop().unwrap();

    let seen = seen.lock().unwrap();
    let at = |time: f64| seen.moments.iter().rfind(|moment| moment.time <= time).unwrap();
    let walked = |from: f64, to: f64| {
        let [from, to] = [from, to].map(|time| at(time).position);
        libm::hypot(to[0] - from[0], to[1] - from[1])
    };
    let turned = at(18.0).yaw - at(13.0).yaw;
    let most_tilted = seen.moments.iter().map(|moment| moment.tilt).fold(0.0, f64::max);
    let forward = walked(3.0, 13.0);
    println!(
        "walked {forward:.3} m in 10 s, turned by {turned:.3} rad in 5 s, tilted by at most {most_tilted:.3} rad"
    );
    for step in 0..14 {
        println!("{:?}", at(f64::from(step) * 2.0));
    }
    assert!(seen.states.iter().all(|state| state == "upright"), "{:?}", seen.states);
    assert!(most_tilted < 0.6, "it was tilted by {most_tilted} rad");
    assert!((0.5..1.1).contains(&forward), "it walked {forward} m in 10 s");
    assert!(turned > 1.0, "it turned by {turned} rad in 5 s");
    assert!(walked(18.0, 23.0) > 0.15, "it walked {} m in a curve", walked(18.0, 23.0));
    assert!(walked(26.0, 27.0) < 0.01 && !seen.is_walking, "it does not stand");
    let [x, y, _] = at(END_S).position;
    let off = libm::hypot(seen.odometry[0] - x, seen.odometry[1] - y);
    assert!(off < 0.25, "the odometry is {off} m off");
}

/// The test of the room: whatever is particular to that robot is in files of robots.
#[test]
fn no_code_of_modules_names_that_robot() {
    let mut folders = vec![root().join("modules")];
    let mut read = 0;
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path: PathBuf = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = std::fs::read_to_string(&path).unwrap().to_lowercase();
                assert!(!text.contains("op3"), "{} names the robot", path.display());
                read += 1;
            }
        }
    }
    assert!(read > 100);
}
