//! The module that binds a network to topics.

use downbeat_edge::Interfaces;
use downbeat_executor::{Heard, ModuleOptions, Probe, SettingValue};
use downbeat_kind::ModuleSource;
use downbeat_msgs::geometry_msgs::msg::{Twist, TwistStamped};
use downbeat_msgs::sensor_msgs::msg::{Imu, JointState};
use downbeat_msgs::std_msgs::msg::Float32MultiArray;
use std::path::Path;
use std::time::Duration;
use tempfile::TempDir;

use crate::onnx::linear;

/// A robot with a policy, which takes `matrix` times what the file binds.
struct Robot {
    probe: Probe,
    _folder: TempDir,
}

impl Robot {
    fn new<const N: usize>(matrix: &[[f32; N]], file: &str) -> Result<Self, String> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("legs.onnx"), linear(matrix)).unwrap();
        std::fs::write(folder.path().join("legs.toml"), file).unwrap();
        let mut probe = Probe::new();
        add(&mut probe, folder.path())?;
        Ok(Self { probe, _folder: folder })
    }

    fn hear<T: Clone + Send + Sync + 'static>(&mut self, topic: &str) -> Heard<T> {
        self.probe.listen(topic).unwrap()
    }

    fn measure(&mut self, positions: &[(&str, f64)]) {
        let (name, position) =
            positions.iter().map(|(name, position)| ((*name).to_owned(), *position)).unzip();
        self.probe.publish("joint_states", JointState { name, position, ..JointState::default() }).unwrap();
    }

    fn advance(&mut self, milliseconds: u64) {
        self.probe.advance(Duration::from_millis(milliseconds)).unwrap();
    }
}

fn add(probe: &mut Probe, folder: &Path) -> Result<(), String> {
    let kind = downbeat_policy::kinds().remove(0);
    let mut source = ModuleSource::new("legs", folder);
    source.keys.insert("file".to_owned(), SettingValue::Text("legs.toml".to_owned()));
    let added = kind.add_to(probe.core(), "legs", ModuleOptions::default(), &source, &Interfaces::carried());
    // Without the folder, which differs from run to run.
    added.map_err(|error| error.to_string().replace(&format!("{}/", folder.display()), ""))
}

/// Two knees that go to half of what is between them and 1 rad.
const KNEES: &str = r#"
network = "legs.onnx"
rate_hz = 50

[[input]]
values = [{ joints = ["l_knee", "r_knee"], offset = 1.0, scale = [1.0, -2.0], limits = [-3.0, 3.0] }]

[[output]]
values = [{ joints = ["l_knee", "r_knee"], offset = [1.0, 0.0], scale = 0.5, limits = [0.0, 2.0] }]
"#;

const BOTH: [[f32; 2]; 2] = [[1.0, 0.0], [0.0, 1.0]];

#[test]
fn joints_are_scaled_moved_and_limited_at_the_rate() {
    let mut robot = Robot::new(&BOTH, KNEES).unwrap();
    let (commands, observations) =
        (robot.hear::<JointState>("joint_commands"), robot.hear("legs/observation"));
    robot.advance(100);
    assert!(commands.take().is_empty(), "it waits for the joints");
    for _ in 0..50 {
        robot.measure(&[("r_knee", 0.25), ("other", 7.0), ("l_knee", 1.5)]);
        robot.advance(10);
    }
    let all = commands.take();
    assert!((24..=26).contains(&all.len()), "{} in half a second", all.len());
    let command = all.last().unwrap();
    assert_eq!(command.name, ["l_knee", "r_knee"]);
    // (1.5 - 1) x 1 = 0.5, and (0.25 - 1) x -2 = 1.5.
    assert_eq!(command.position, [1.0 + 0.25, 0.75]);
    assert!(command.velocity.is_empty() && command.header.stamp.nanosec > 0);
    assert_eq!(observations.take_last().map(|last: Float32MultiArray| last.data), Some(vec![0.5, 1.5]));
    robot.measure(&[("r_knee", -40.0), ("l_knee", -40.0)]);
    robot.advance(20);
    let command = commands.take_last().unwrap();
    assert_eq!(command.position, [0.0, 1.5], "limited on both sides");
}

#[test]
fn it_stops_with_its_inputs_and_by_its_setting() {
    let mut robot = Robot::new(&BOTH, KNEES).unwrap();
    let commands = robot.hear::<JointState>("joint_commands");
    robot.measure(&[("r_knee", 0.25), ("l_knee", 1.5)]);
    robot.advance(480);
    assert!(commands.take().len() > 20);
    robot.advance(100);
    let _ = commands.take();
    robot.advance(1000);
    assert!(commands.take().is_empty(), "the joints have been silent for half a second");
    for (name, position) in [("l_hip", 1.0), ("l_knee", f64::NAN)] {
        robot.measure(&[("r_knee", 0.25), (name, position)]);
        robot.advance(100);
        assert!(commands.take().is_empty(), "{name} {position}");
    }
    robot.measure(&[("r_knee", 0.25), ("l_knee", 1.5)]);
    robot.advance(100);
    assert!(!commands.take().is_empty());
    robot.probe.set("legs", "enabled", SettingValue::Bool(false)).unwrap();
    robot.measure(&[("r_knee", 0.25), ("l_knee", 1.5)]);
    robot.advance(100);
    assert!(commands.take().is_empty());
}

#[test]
fn fields_gravity_and_what_was_said_become_fields() {
    let file = r#"
network = "legs.onnx"
rate_hz = 100

[[input]]
name = "obs"
values = [
    { gravity = true },
    { topic = "cmd_vel", type = "geometry_msgs/msg/Twist", fields = ["linear.x"], scale = 2.0 },
    { previous = "action" },
]

[[output]]
values = [
    { topic = "base/cmd_vel", type = "geometry_msgs/msg/TwistStamped", frame_id = "base_link", fields = ["twist.linear.x"] },
    { topic = "base/cmd_vel", type = "geometry_msgs/msg/TwistStamped", frame_id = "base_link", fields = ["twist.angular.z"], scale = -1.0 },
]
"#;
    // Of gravity along x and z, of the command, and of what was said.
    let matrix = [[1.0, 0.0], [0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [0.0, 0.0], [0.0, 0.5]];
    let mut robot = Robot::new(&matrix, file).unwrap();
    let moves = robot.hear::<TwistStamped>("base/cmd_vel");
    let mut imu = Imu::default();
    // Pitched down by 90 degrees: x points to the ground.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    (imu.orientation.y, imu.orientation.w) = (half, half);
    robot.probe.publish("imu/data", imu.clone()).unwrap();
    let mut command = Twist::default();
    command.linear.x = 0.25;
    robot.probe.publish("cmd_vel", command).unwrap();
    robot.advance(30);
    let first = moves.take_last().unwrap();
    assert_eq!((first.header.frame_id.as_str(), first.twist.angular.z.abs()), ("base_link", 0.0));
    assert!((first.twist.linear.x - 1.5).abs() < 1e-6, "{first:?}");
    (imu.orientation.y, imu.orientation.w) = (0.0, 1.0);
    robot.probe.publish("imu/data", imu.clone()).unwrap();
    robot.advance(200);
    let level = moves.take_last().unwrap().twist;
    // Down is -1, which adds up with half of what was said before.
    assert!((level.linear.x - 0.5).abs() < 1e-6 && (level.angular.z - 2.0).abs() < 1e-3, "{level:?}");
    imu.orientation_covariance[0] = -1.0;
    robot.probe.publish("imu/data", imu).unwrap();
    robot.advance(100);
    assert!(moves.take().is_empty(), "an IMU without orientation");
}

#[test]
fn what_does_not_fit_is_refused_with_names() {
    let refused = |from: &str, to: &str| {
        assert!(KNEES.contains(from));
        match Robot::new(&BOTH, &KNEES.replacen(from, to, 1)) {
            Ok(_) => panic!("{to} is accepted"),
            Err(problem) => problem,
        }
    };
    let wrong_count = refused(
        r#"joints = ["l_knee", "r_knee"], offset = 1.0, scale = [1.0, -2.0]"#,
        r#"joints = ["l_knee"]"#,
    );
    assert!(
        wrong_count.contains(
            "legs.toml:5: input obs (1 x 2) of legs.onnx has 2 numbers, and 1 are bound: 1 of joint_states"
        ),
        "{wrong_count}"
    );
    for (from, to, expected) in [
        ("scale = [1.0, -2.0]", "scale = [1.0, -2.0, 3.0]", "legs.toml:6: scale has 3 numbers for 2 values"),
        ("limits = [-3.0, 3.0]", "limits = [3.0, -3.0]", "legs.toml:6: limits are [3, -3]"),
        ("[[input]]", "[[input]]\nname = \"ops\"", "legs.onnx has no input \"ops\""),
        ("rate_hz = 50", "rate_hz = 0", "legs.toml:3: rate_hz is 0; 0.1 to 1000 are possible"),
        ("rate_hz = 50", "rate_hz = 50\nrate = 1", "unknown field `rate`"),
        ("rate_hz = 50", "rate_hz = 50\nmax_age = \"5\"", "legs.toml:4: max_age"),
        ("legs.onnx", "arms.onnx", "arms.onnx: "),
        (
            "{ joints = [\"l_knee\", \"r_knee\"], offset = 1.0",
            "{ topic = \"imu/data\", type = \"sensor_msgs/msg/Imu\", fields = [\"a.x\", \"b\"], offset = 1.0",
            "legs.toml:6: ",
        ),
        (
            "{ joints = [\"l_knee\", \"r_knee\"], offset = 1.0",
            "{ previous = \"actions\"",
            "legs.onnx has no output \"actions\"",
        ),
        (
            "{ joints = [\"l_knee\", \"r_knee\"], offset = 1.0",
            "{ offset = 1.0",
            "it has to have one of `fields`",
        ),
    ] {
        let problem = refused(from, to);
        assert!(problem.contains(expected), "{problem}");
    }
    let output = &KNEES[KNEES.find("[[output]]").unwrap()..];
    assert!(refused(output, "").contains("no [[output]]"));
    let input = &KNEES[KNEES.find("[[input]]").unwrap()..KNEES.find("[[output]]").unwrap()];
    let unbound = refused(input, "");
    assert!(unbound.contains("input obs (1 x 2) of legs.onnx is not bound"), "{unbound}");
}
