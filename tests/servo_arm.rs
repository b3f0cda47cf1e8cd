//! Follows docs/servo_arm.md from an empty folder, with two emulated arms that a hand turns: both are
//! calibrated, and one is the leader.
#![allow(clippy::unwrap_used, missing_docs)]
#![cfg(all(feature = "sensors", feature = "tables"))]

mod common;

use std::path::Path;
use std::process::{Command, Stdio};

use common::typed::Typed;
use common::{Running, downbeat, open_with_stock_readers, python, wait_until};
use downbeat::modules::servo_bus::Description;
use serde_json::json;
use test_machine::free_domain;

/// The blocks of the page in a language.
fn blocks(language: &str) -> Vec<String> {
    let page = include_str!("../docs/servo_arm.md");
    let start = format!("```{language}\n");
    page.split(&start).skip(1).map(|block| block.split("```").next().unwrap().to_owned()).collect()
}

/// An emulated arm that a hand turns. It ends with this.
struct Arm {
    program: Typed,
    /// The names of its joints, and their stops in rad.
    joints: Vec<(String, [f64; 2])>,
}

impl Arm {
    fn start(description: &Path, port: &Path) -> Self {
        let description = description.to_str().unwrap();
        let link = port.to_str().unwrap();
        let program = Typed::start(&["emulate", "servos", description, "--by-hand", "--link", link]);
        wait_until("the emulated arm is there", || port.exists());
        let described = Description::load(description).unwrap();
        let joints = described.bus("").unwrap().joints.iter();
        let joints = joints.map(|joint| (joint.name.clone(), [joint.min_rad, joint.max_rad])).collect();
        Self { program, joints }
    }

    fn turn(&mut self, joint: &str, angle: f64) {
        self.program.types(&format!("turn {joint} {angle}"));
    }

    /// Turns all joints at once, each to this place between its stops, or from 0 rad.
    fn turn_all(&mut self, to: impl Fn([f64; 2]) -> f64) {
        for (joint, stops) in self.joints.clone() {
            self.turn(&joint, to(stops));
        }
        // In which order they arrive is up to their ways.
        (0..self.joints.len()).for_each(|_| self.program.says("is turned"));
    }

    /// Calibrates it as the page says, on the terminal in place of the browser.
    fn calibrate(&mut self, command: &mut Command) {
        let mut calibration = Typed::start_by(command);
        calibration.says("lose their torque now");
        calibration.types("");
        calibration.says("from one stop to the other");
        self.turn_all(|[low, _]| low);
        self.turn_all(|[_, high]| high);
        calibration.types("");
        calibration.says("at 0 rad, and press Enter");
        self.turn_all(|_| 0.0);
        calibration.types("");
        for (index, (joint, _)) in self.joints.clone().iter().enumerate() {
            calibration.says(&format!("joint_{}: turn it a little", index + 1));
            self.turn(joint, 0.2);
            self.program.says("is turned");
            calibration.types("");
        }
        calibration.says("the joints are still limp");
        assert!(calibration.child.wait().unwrap().success());
    }
}

/// A reader of the page, in a folder.
struct Reader<'a> {
    folder: &'a Path,
    domain: String,
}

impl<'a> Reader<'a> {
    fn new(folder: &'a Path) -> Self {
        Self { folder, domain: free_domain().to_string() }
    }

    /// What is typed for a line of the page. The ports are in the folder, and there is no browser.
    fn command(&self, line: &str) -> Command {
        let typed = line
            .replace("ros2 ", "downbeat ")
            .replace("/dev/ttyACM", self.folder.join("ttyACM").to_str().unwrap())
            .replace("--page 0", "--timeout-ms 1000")
            .replace("--name", "--timeout-ms 1000 --baud 1000000 --protocol feetech_sts --last-id 7 --name");
        let mut shell = Command::new("sh");
        let program = Path::new(env!("CARGO_BIN_EXE_downbeat")).parent().unwrap();
        let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap());
        let settled = downbeat(&[]);
        shell
            .args(["-c", &format!("exec {typed}")])
            .envs(settled.get_envs().filter_map(|(name, value)| Some((name, value?))));
        shell
            .current_dir(self.folder)
            .env("PATH", path)
            .env("ROS_DOMAIN_ID", &self.domain)
            .stdin(Stdio::null());
        shell
    }

    /// Where the first joint of the follower is, the shoulder's, in rad.
    fn position(&self) -> f64 {
        let echo = "ros2 topic echo --once --field position /joint_states sensor_msgs/msg/JointState";
        let printed = self.types(echo);
        let mut words = printed.split(|letter: char| !(letter.is_ascii_digit() || "-.e".contains(letter)));
        words.find_map(|word| word.parse().ok()).unwrap_or_else(|| panic!("{printed}"))
    }

    /// Types a line, which must succeed, and returns what is printed.
    fn types(&self, line: &str) -> String {
        let output = self.command(line).output().unwrap();
        let text =
            [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).concat();
        assert!(output.status.success(), "{line}: {text}");
        text
    }
}

#[test]
fn an_evening_leads_from_an_empty_folder_to_a_data_set_and_a_trajectory() {
    let folder = tempfile::tempdir().unwrap();
    let reader = Reader::new(folder.path());
    let of_arm = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots/servos/so101.toml");
    let [mut follower, mut leader] =
        ["ttyACM0", "ttyACM1"].map(|port| Arm::start(&of_arm, &folder.path().join(port)));

    let pages = blocks("sh");
    let lines: Vec<Vec<&str>> = pages.iter().map(|block| block.lines().collect()).collect();
    let [setups, calibrations, run, follow, demonstrate, trajectory, export, import] = &*lines else {
        panic!("{lines:?}")
    };
    for line in setups {
        let printed = reader.types(line);
        assert!(printed.contains("STS3215"), "{printed}");
    }
    for (line, arm) in calibrations.iter().zip([&mut follower, &mut leader]) {
        arm.calibrate(&mut reader.command(line));
    }
    assert_eq!(calibrations.len(), 2);
    for name in ["follower.toml", "leader.toml"] {
        let description = folder.path().join(name);
        let found = Description::load(description.to_str().unwrap()).unwrap();
        for (found, (joint, [low, high])) in found.bus("").unwrap().joints.iter().zip(&follower.joints) {
            let limits = [found.min_rad - low, high - found.max_rad];
            // The margin, rounded towards the middle, and two steps of a servo.
            assert!(limits.iter().all(|inside| (0.03..0.04).contains(inside)), "{joint}: {limits:?}");
            assert_eq!(found.sign, 1.0, "{joint}");
        }
    }
    let robot = blocks("toml").remove(0).replace("kind = \"camera\"", "kind = \"camera_emulator\"");
    let robot =
        robot.replace("device = \"/dev/video0\", width = 640, height = 480", "width = 64, height = 48");
    std::fs::write(folder.path().join("robot.toml"), robot).unwrap();

    let mut robot = Running::start_by(&mut reader.command(&run[0].replace("--view", "")));
    robot.wait_for_output("exposed to ROS 2: /episodes");
    reader.types("ros2 topic echo --once /leader/joint_states sensor_msgs/msg/JointState");
    let printed = reader.types(follow[0]);
    assert!(printed.contains("goes to the leader"), "{printed}");
    let [set_task, start, keep, start_again, discard] = &demonstrate[..] else { panic!("{demonstrate:?}") };
    reader.types(set_task);
    assert!(reader.types(start).contains("episode 0 begins"));
    leader.turn("shoulder_pan", 0.6);
    wait_until("the follower is where the leader is", || (reader.position() - 0.6).abs() < 0.03);
    leader.turn("shoulder_pan", 0.1);
    wait_until("it goes back with it", || (reader.position() - 0.1).abs() < 0.03);
    assert!(reader.types(keep).contains("episode 0 is kept"));
    reader.types(start_again);
    assert!(reader.types(discard).contains("episode 1 is discarded"));

    for line in trajectory {
        let printed = reader.types(line);
        assert!(line.contains("/follow std") || printed.contains("SUCCEEDED"), "{printed}");
    }
    wait_until("the arm is at the end of the trajectory", || (reader.position() - 0.2).abs() < 0.03);
    robot.interrupt();
    assert!(robot.wait().success(), "{}", robot.output());

    let printed = reader.types(export[0]);
    assert!(printed.contains("wrote 1 episodes with"), "{printed}");
    open_with_stock_readers(&folder.path().join("demonstrations"));
    if let Some(found) = python("read_dataset.py", &[&folder.path().join("dataset")]) {
        assert_eq!(found["episodes"][0]["tasks"], json!(["put the red cube into the box"]));
        assert_eq!(found["names"]["observation.state"][0], "joint_1.pos");
        let column = |key: &str| -> Vec<f64> {
            found[key].as_array().unwrap().iter().map(|frame| frame[0].as_f64().unwrap()).collect()
        };
        let highest = |key: &str| column(key).into_iter().fold(f64::MIN, f64::max);
        assert!((highest("action") - 0.6).abs() < 0.05, "{}", highest("action"));
        assert!((highest("state") - 0.6).abs() < 0.05, "{}", highest("state"));
        assert!(found["pictures"]["observation.images.front"][0].as_u64().unwrap() > 3);
    }
    for line in import {
        reader.types(line);
    }
}

/// The leader is another program: the robot files of the page, with emulators beside the hardware.
#[test]
fn an_arm_follows_a_leader_over_the_network() {
    let folder = tempfile::tempdir().unwrap();
    let reader = Reader::new(folder.path());
    let files = blocks("toml");
    let [whole, leader, expose] = &files[..] else { panic!("{files:?}") };
    let of_arm = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots/servos/so101.toml");
    for name in ["leader.toml", "follower.toml"] {
        std::fs::copy(&of_arm, folder.path().join(name)).unwrap();
    }
    let emulated = |text: &str, name: &str| {
        let hardware = format!("settings = {{ description = \"{name}.toml\" }}");
        assert!(text.contains(&hardware), "{text}");
        let with_port = format!("settings = {{ description = \"{name}.toml\", port = \"memory:{name}\" }}");
        let emulator = format!(
            "[[module]]\nname = \"emulator\"\nkind = \"servo_emulator\"\nremap = {{ hand = \"leader/hand\" }}\n\
             settings = {{ description = \"{name}.toml\", link = \"memory:{name}\" }}\n\n"
        );
        text.replacen("[[module]]", &format!("{emulator}[[module]]"), 1).replace(&hardware, &with_port)
    };
    let hand = "in = [{ topic = \"leader/hand\", type = \"sensor_msgs/msg/JointState\" }, {";
    let leader = emulated(leader, "leader").replace("in = [{", hand);
    // Hardware of the follower, and who follows.
    let modules: Vec<&str> = whole.split("\n\n").collect();
    let module =
        |name: &str| modules.iter().find(|module| module.contains(&format!("name = {name:?}"))).unwrap();
    let follower = ["follower", "leader_arm", "mux"].map(|name| *module(name)).join("\n\n");
    let follower = format!("{follower}\n\n{expose}");
    let follower = format!("[robot]\nname = \"follower\"\n\n{}", emulated(&follower, "follower"));
    let mut robots = [("leader", leader), ("follower", follower)].map(|(name, text)| {
        let file = folder.path().join(format!("{name}_robot.toml"));
        std::fs::write(&file, text).unwrap();
        let robot = Running::start_by(&mut reader.command(&format!("downbeat run {name}_robot.toml")));
        robot.wait_for_output("joint_states");
        robot
    });
    reader.types("ros2 service call /follow std_srvs/srv/SetBool \"{data: true}\"");
    let turned = "{name: [shoulder_pan], position: [-0.5]}";
    let hand = format!("ros2 topic pub --once -w 1 /leader/hand sensor_msgs/msg/JointState \"{turned}\"");
    wait_until("the follower is where the leader is", || {
        // Again and again: a servo that still has its torque is not turned.
        reader.types(&hand);
        (reader.position() + 0.5).abs() < 0.03
    });
    robots.iter_mut().for_each(Running::interrupt);
}
