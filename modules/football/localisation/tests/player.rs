//! A simulated Darwin OP that knows of the field only what its camera shows: it walks to places by what it
//! believes, while its head sweeps. Pictures are simulated: without noise, and without the robot itself.
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat_darwin_op::falls::Falls;
use downbeat_darwin_op::gait::Gait;
use downbeat_executor::{Inbox, Inlet, ModuleOptions, Received, SettingValue, Time};
use downbeat_football::soccer_model_msgs::msg::Ball as BallEstimate;
use downbeat_imu_filter::ImuFilter;
use downbeat_kinematics::robot_state_publisher::RobotStatePublisher;
use downbeat_localisation::Localisation;
use downbeat_msgs::builtin_interfaces;
use downbeat_msgs::diagnostic_msgs::msg::DiagnosticArray;
use downbeat_msgs::geometry_msgs::msg::{PoseStamped, PoseWithCovarianceStamped};
use downbeat_msgs::sensor_msgs::msg::{CameraInfo, Image};
use downbeat_msgs::std_msgs::msg::Header;
use downbeat_physics::camera::{Camera, Scene};
use downbeat_physics::{Ball, DARWIN_OP, Field, SimulatedRobot, SimulationOptions, WorldFile};
use downbeat_player::head::Head;
use downbeat_player::walk_to::WalkTo;
use downbeat_servos::joint_command_mux::JointCommandMux;
use downbeat_vision::Vision;
use glam::{DQuat, DVec2, DVec3};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

const SOURCES: [&str; 3] = ["falls/joint_commands", "gait/joint_commands", "head/joint_commands"];
/// Between pictures, and from the exposure until vision has the picture.
const PICTURES: Duration = Duration::from_millis(100);
const LATENCY: Duration = Duration::from_millis(50);

#[derive(Default)]
struct Heard {
    pose: Option<PoseWithCovarianceStamped>,
    ball: Option<BallEstimate>,
    diagnostics: Vec<String>,
}

struct Player {
    robot: SimulatedRobot,
    world: WorldFile,
    images: Inlet<Image>,
    infos: Inlet<CameraInfo>,
    goals: Inlet<PoseStamped>,
    heard: Arc<Mutex<Heard>>,
}

fn with(settings: &[(&str, SettingValue)]) -> ModuleOptions {
    let settings = settings.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
    ModuleOptions { settings, ..ModuleOptions::default() }
}

impl Player {
    fn new(seed: u64, start: [f64; 3], ball: [f64; 2]) -> Self {
        let mut options = SimulationOptions::darwin_op();
        options.world = WorldFile {
            field: Some(Field::default()),
            ball: Some(Ball { position: ball, ..Ball::default() }),
            ..WorldFile::default()
        };
        (options.start.position, options.start.yaw) = ([start[0], start[1]], start[2]);
        let world = options.world.clone();
        let mut robot = SimulatedRobot::new(options, seed).unwrap();
        robot.hardware_listens_to("joint_goals").unwrap();
        robot.add("imu_filter", ImuFilter::default()).unwrap();
        robot.add("falls", Falls::default()).unwrap();
        robot.add("head", Head::default()).unwrap();
        robot.add("walk_to", WalkTo::default()).unwrap();
        robot.add("vision", Vision::default()).unwrap();
        let core = robot.core();
        core.add_with("gait", Gait::default(), with(&[("start", true.into())])).unwrap();
        let sources = SOURCES.map(str::to_owned).to_vec();
        core.add_with("mux", JointCommandMux::default(), with(&[("sources", sources.into())])).unwrap();
        let description =
            [("robot_description", DARWIN_OP.to_owned().into()), ("publish_frequency", 50.0.into())];
        core.add_with("state", RobotStatePublisher::default(), with(&description)).unwrap();
        let settings = [("starts", start.to_vec().into()), ("seed", seed.cast_signed().into())];
        core.add_with("localisation", Localisation::default(), with(&settings)).unwrap();
        let heard = Arc::<Mutex<Heard>>::default();
        let sink = Arc::clone(&heard);
        let hear = move |pose: Received<'_, PoseWithCovarianceStamped>| {
            sink.lock().unwrap().pose = Some(pose.clone());
        };
        core.outlet("pose", Inbox::KeepAll, hear).unwrap().keep();
        let sink = Arc::clone(&heard);
        let hear = move |ball: Received<'_, BallEstimate>| sink.lock().unwrap().ball = Some(ball.clone());
        core.outlet("ball", Inbox::KeepAll, hear).unwrap().keep();
        let sink = Arc::clone(&heard);
        let hear = move |array: Received<'_, DiagnosticArray>| {
            let told = array.status.iter().map(|status| format!("{}: {}", status.name, status.message));
            sink.lock().unwrap().diagnostics.extend(told);
        };
        core.outlet("diagnostics", Inbox::KeepAll, hear).unwrap().keep();
        let (images, infos) =
            (core.inlet("camera/image_raw").unwrap(), core.inlet("camera/camera_info").unwrap());
        let goals = core.inlet("walk_to/pose").unwrap();
        Self { robot, world, images, infos, goals, heard }
    }

    /// One picture's time.
    fn step(&mut self) {
        let at = self.robot.now();
        let snapshot = self.robot.snapshot();
        let pose_of = |name: &str| {
            snapshot.things.iter().find(|thing| thing.0 == name).map(|thing| thing.2.world_from_body)
        };
        let data = Scene::new(&self.world, pose_of).render(&Camera::darwin_op(), &snapshot.camera.unwrap());
        self.robot.run_for(LATENCY).unwrap();
        self.infos.publish(info(at)).unwrap();
        self.images.publish(image(at, data)).unwrap();
        self.robot.run_for(PICTURES - LATENCY).unwrap();
    }

    fn walk_to(&self, [x, y]: [f64; 2]) {
        let mut goal = PoseStamped::default();
        goal.header.frame_id = "map".to_owned();
        (goal.pose.position.x, goal.pose.position.y, goal.pose.orientation.w) = (x, y, 1.0);
        self.goals.publish(goal).unwrap();
    }

    fn truth(&self) -> (DVec2, f64) {
        let pose = self.robot.snapshot().robot.world_from_body;
        let ahead = pose.rotation * DVec3::X;
        (pose.translation.truncate(), libm::atan2(ahead.y, ahead.x))
    }

    /// Errors of position (m) and heading (degrees).
    fn error(&self) -> (f64, f64) {
        let heard = self.heard.lock().unwrap();
        let pose = &heard.pose.as_ref().unwrap().pose.pose;
        let q = pose.orientation;
        let ahead = DQuat::from_xyzw(q.x, q.y, q.z, q.w) * DVec3::X;
        let (position, heading) = self.truth();
        let turned = libm::atan2(ahead.y, ahead.x) - heading;
        let turned = libm::atan2(libm::sin(turned), libm::cos(turned)).abs().to_degrees();
        (position.distance(DVec2::new(pose.position.x, pose.position.y)), turned)
    }

    /// The error of a ball that is believed in now (m), and its distance.
    fn ball_error(&self) -> Option<(f64, f64)> {
        let heard = self.heard.lock().unwrap();
        let ball = heard.ball.as_ref().filter(|ball| {
            let at = Time::from_nanos(ball.header.stamp.as_nanos());
            self.robot.now().saturating_since(at) < Duration::from_millis(100)
        })?;
        let things = self.robot.snapshot().things;
        let truth = things.iter().find(|thing| thing.0 == "ball")?.2.world_from_body.translation.truncate();
        let believed = DVec2::new(ball.point.point.x, ball.point.point.y);
        Some((believed.distance(truth), truth.distance(self.truth().0)))
    }
}

fn header(at: Time) -> Header {
    let stamp = builtin_interfaces::msg::Time::from_nanos(at.as_nanos());
    Header { stamp, frame_id: "camera_optical_frame".to_owned() }
}

fn image(at: Time, data: Vec<u8>) -> Image {
    let Camera { width, height, .. } = Camera::darwin_op();
    let (header, encoding) = (header(at), "rgb8".to_owned());
    Image { header, height, width, encoding, is_bigendian: 0, step: width * 3, data }
}

fn info(at: Time) -> CameraInfo {
    let Camera { width, height, focal: [fx, fy] } = Camera::darwin_op();
    let (cx, cy) = ((f64::from(width) - 1.0) / 2.0, (f64::from(height) - 1.0) / 2.0);
    let k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0];
    CameraInfo { header: header(at), height, width, k, ..CameraInfo::default() }
}

fn share(sorted: &mut [f64], of: f64) -> f64 {
    sorted.sort_by(f64::total_cmp);
    sorted.get(((sorted.len().max(1) - 1) as f64 * of) as usize).copied().unwrap_or(f64::INFINITY)
}

#[test]
fn a_player_with_eyes_walks_over_the_field_and_knows_where_it_and_the_ball_are() {
    let (mut metres, mut degrees, mut ball_metres) = (Vec::new(), Vec::new(), Vec::new());
    let began = Instant::now();
    for seed in 1..=2 {
        let mut player = Player::new(seed, [-2.0, 1.0, 0.0], [0.5, 0.3]);
        let places = [[-0.8, 0.6], [-0.8, -0.8], [-2.5, -0.8]];
        let mut walked = 0.0;
        let mut last = player.truth().0;
        for picture in 0..600 {
            if picture % 200 == 20 {
                player.walk_to(places[picture / 200]);
            }
            player.step();
            walked += player.truth().0.distance(last);
            last = player.truth().0;
            // The gait begins after a while.
            if picture < 20 {
                continue;
            }
            let (off, turned) = player.error();
            metres.push(off);
            degrees.push(turned);
            let ball = player.ball_error().filter(|(_, distance)| *distance < 2.5);
            ball_metres.extend(ball.map(|(off, _)| off));
            if picture % 50 == 0 {
                println!(
                    "{:5.1} s at {:.2} off {off:.3} m, {turned:.1} degrees; ball {:?}",
                    picture as f64 / 10.0,
                    player.truth().0,
                    player.ball_error()
                );
            }
        }
        let heard = player.heard.lock().unwrap();
        let told: Vec<&String> =
            heard.diagnostics.iter().filter(|told| !told.starts_with("darwin_op")).collect();
        println!("{told:?}");
        drop(heard);
        assert!(player.robot.is_upright());
        assert!(walked > 2.0, "walked {walked} m");
    }
    let found = [
        share(&mut metres, 0.5),
        share(&mut metres, 0.95),
        share(&mut degrees, 0.5),
        share(&mut degrees, 0.95),
        share(&mut ball_metres, 0.5),
        share(&mut ball_metres, 0.95),
    ];
    println!(
        "pose: median {:.3} m, 95 % {:.3} m; heading: median {:.2}, 95 % {:.2} degrees; ball within 2.5 m: median {:.3} m, 95 % {:.3} m ({}); {:.1} s",
        found[0],
        found[1],
        found[2],
        found[3],
        found[4],
        found[5],
        ball_metres.len(),
        began.elapsed().as_secs_f64()
    );
    assert!(found[0] <= 0.10 && found[1] <= 0.30 && found[3] <= 5.0, "{found:?}");
    assert!(found[4] <= 0.15 && ball_metres.len() > 100, "{found:?} {}", ball_metres.len());
}
