//! Robots of serial servos: the robot files in `robots/`, `downbeat servo`, and packets compared with
//! `dynamixel-sdk`.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::{Path, PathBuf};

use common::typed::Typed;
use common::{Running, output_of, python, record_until, recorded_messages, text_of, wait_until};
use downbeat::bags::{Reader, Selection};
use downbeat::modules::servo_bus::protocol::{Id, Instruction, Protocol, ReadEntry, WriteEntry};
use downbeat::modules::servo_emulator::PseudoTerminal;
use downbeat::msgs::cdr;
use downbeat::msgs::sensor_msgs::msg::JointState;
use serde_json::{Value, json};

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Copies a robot file and its description, with this port.
fn robot(name: &str, folder: &Path, port: &str) -> PathBuf {
    let robots = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots");
    let path = folder.join("robot.toml");
    std::fs::create_dir(folder.join("servos")).unwrap();
    let description = format!("servos/{name}.toml");
    std::fs::copy(robots.join(&description), folder.join(&description)).unwrap();
    let robot = std::fs::read_to_string(robots.join(format!("{name}.toml"))).unwrap();
    std::fs::write(&path, robot.replace(&format!("memory:{name}"), port)).unwrap();
    path
}

#[test]
fn robots_run_from_their_files_alone_and_replay_bit_for_bit() {
    for name in ["so101", "op3"] {
        let folder = tempfile::tempdir().unwrap();
        let port = folder.path().join("port");
        let (robot, bag) = (robot(name, folder.path(), text(&port)), folder.path().join("bag"));
        let arguments = ["bag", "record", "--robot", text(&robot), "--output", text(&bag)];
        record_until(&arguments, &bag, "/joint_states", 100);
        let output = output_of(&["bag", "replay", text(&robot), text(&bag), "--json"]);
        let report = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success(), "{name}: {report} {}", String::from_utf8_lossy(&output.stderr));
        let report: Value = serde_json::from_str(&report).unwrap();
        let topics = report["topics"].as_array().unwrap();
        let states = topics.iter().find(|topic| topic["topic"] == "/joint_states").unwrap();
        assert!(states.to_string().contains("compared"), "{states}");
    }
}

/// A URDF as it is for ros2_control's mock hardware: `downbeat run` drives emulated servos by it.
#[test]
fn the_servos_of_a_urdf_are_emulated_where_it_names_a_simulation() {
    let folder = tempfile::tempdir().unwrap();
    let [robot, bag] = ["robot.toml", "bag"].map(|name| folder.path().join(name));
    let joint = |name: &str| {
        format!(
            "<joint name=\"{name}\" type=\"revolute\"><limit lower=\"-1\" upper=\"1\" velocity=\"1\" effort=\"1\"/></joint>"
        )
    };
    let servo = |name: &str| {
        format!(
            "<joint name=\"{name}\"><command_interface name=\"position\"/><state_interface name=\"position\"/></joint>"
        )
    };
    let urdf = format!(
        "<?xml version=\"1.0\"?>\n<robot name=\"arm\">{}{}\n<ros2_control name=\"body\" type=\"system\"><hardware>\n\
         <plugin>mock_components/GenericSystem</plugin></hardware>{}{}</ros2_control></robot>",
        joint("pan"),
        joint("tilt"),
        servo("pan"),
        servo("tilt"),
    );
    std::fs::write(folder.path().join("arm.urdf"), urdf).unwrap();
    let text_of_robot = "[robot]\nname = \"arm\"\n[[module]]\nkind = \"servo_emulator\"\n\
                         settings = { description = \"arm.urdf\", link = \"memory:body\" }\n[[module]]\nname = \"hardware\"\n\
                         kind = \"servo_bus\"\nsettings = { description = \"arm.urdf\" }\n";
    std::fs::write(&robot, text_of_robot).unwrap();
    text_of(&["run", text(&robot), "--fast", "--duration", "2s", "--record", text(&bag)]);
    assert!(recorded_messages(&bag, "/joint_states") > 100);
    let reader = Reader::open(&bag).unwrap();
    let states = Selection::all().topics([reader.topic("/joint_states").unwrap()]);
    let state = reader.messages(states).unwrap().last().unwrap().unwrap();
    assert_eq!(cdr::from_slice::<JointState>(&state.data).unwrap().name, ["pan", "tilt"]);
    let refused = output_of(&["servo", "calibrate", text(&folder.path().join("arm.urdf"))]);
    assert!(String::from_utf8_lossy(&refused.stderr).contains("is a URDF"), "{refused:?}");
}

#[test]
fn an_emulated_robot_in_simulated_time_gives_the_same_bag_in_every_run() {
    for (name, cycles) in [("so101", 2000), ("op3", 2500)] {
        let folder = tempfile::tempdir().unwrap();
        let robot = robot(name, folder.path(), &format!("memory:{name}"));
        let [one, two] = ["one", "two"].map(|bag| folder.path().join(bag));
        for bag in [&one, &two] {
            text_of(&["run", text(&robot), "--fast", "--duration", "20s", "--record", text(bag)]);
        }
        let states = recorded_messages(&one, "/joint_states");
        assert!((cycles - 100..cycles).contains(&states), "{name}: {states} states in 20 s");
        // `diagnostics` of the process contains times of this machine.
        text_of(&["bag", "diff", text(&one), text(&two), "--ignore", "diagnostics"]);
    }
}

#[test]
fn a_wrong_description_is_refused_with_both_files_and_lines() {
    let folder = tempfile::tempdir().unwrap();
    let robot = robot("so101", folder.path(), "memory:so101");
    let description = folder.path().join("servos/so101.toml");
    let good = std::fs::read_to_string(&description).unwrap();
    let refusal = |bad: String| {
        assert_ne!(bad, good);
        std::fs::write(&description, bad).unwrap();
        let output = output_of(&["check", text(&robot)]);
        assert!(!output.status.success());
        String::from_utf8(output.stderr).unwrap().replace(&format!("{}/", folder.path().display()), "")
    };
    let same_id = refusal(good.replace("id = 2\n", "id = 1\n"));
    assert!(
        same_id.contains("robot.toml:17: ")
            && same_id.contains(
                "servos/so101.toml:27: joint \"shoulder_lift\" has the id 1 of \"shoulder_pan\" (line 22) on the same bus; give one \
                 of the two another id, with `downbeat servo set-id`"
            ),
        "{same_id}"
    );
    let no_limits = refusal(good.replace("limits = [-1.69, 1.69]\n", ""));
    assert!(
        no_limits.contains(
            "servos/so101.toml:32: joint \"elbow_flex\" needs \"limits\", its smallest and largest angle in rad, such as limits = \
             [-1.5, 1.5]"
        ),
        "{no_limits}"
    );
}

/// The servos of a robot in `robots/`, emulated by the program.
struct Servos {
    _emulator: Running,
    _folder: tempfile::TempDir,
    port: PathBuf,
    options: Vec<String>,
}

impl Servos {
    fn of(robot: &str, baud: u32) -> Self {
        Self::with_faults(robot, baud, &[])
    }

    fn with_faults(robot: &str, baud: u32, faults: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let port = folder.path().join("port");
        let description = format!("robots/servos/{robot}.toml");
        let faults: Vec<&str> = faults.iter().flat_map(|fault| ["--fault", fault]).collect();
        let emulate = ["emulate", "servos", &description, "--link", text(&port)];
        let emulator = Running::start(&[&emulate[..], &faults].concat());
        wait_until("the emulated servos are there", || port.exists());
        // Answers may be late on a busy machine.
        let options = ["--timeout-ms", "200", "--baud", &baud.to_string()].map(str::to_owned).to_vec();
        Self { _emulator: emulator, _folder: folder, port, options }
    }

    /// Runs `downbeat servo`, which must succeed.
    fn servo(&self, command: &str, arguments: &[&str]) -> String {
        text_of(&self.line(command, arguments))
    }

    /// Runs `downbeat servo`, which must fail.
    fn refused(&self, command: &str, arguments: &[&str]) -> String {
        let output = output_of(&self.line(command, arguments));
        assert!(!output.status.success(), "{arguments:?}");
        String::from_utf8(output.stderr).unwrap()
    }

    fn line<'a>(&'a self, command: &'a str, arguments: &[&'a str]) -> Vec<&'a str> {
        let options = self.options.iter().map(String::as_str);
        ["servo", command, text(&self.port)]
            .into_iter()
            .chain(arguments.iter().copied())
            .chain(options)
            .collect()
    }
}

#[test]
fn a_scan_lists_the_devices_of_both_families() {
    let feetech = Servos::of("so101", 1_000_000);
    let found =
        feetech.servo("scan", &["--last-id", "7", "--protocol", "dynamixel1", "--protocol", "feetech_sts"]);
    let expected: String =
        (1..=6).map(|id| format!("id {id}: STS3215, firmware 3, feetech_sts at 1000000 bit/s\n")).collect();
    assert_eq!(found, expected);
    let dynamixel = Servos::of("op3", 2_000_000);
    let board = dynamixel.servo("scan", &["--last-id", "253", "--protocol", "dynamixel2"]);
    assert_eq!(
        board,
        "id 200: unknown model 0, dynamixel2 at 2000000 bit/s\n\
         id 200 seems to have switched off the power of the servos behind it, which cannot answer: a robot switches it on with \
         `power` of [[device]] (docs/servos.md)\n"
    );
}

#[test]
fn a_scan_says_that_a_board_has_switched_off_the_servos_behind_it() {
    let folder = tempfile::tempdir().unwrap();
    let port = folder.path().join("port");
    let _emulator = Running::start(&["emulate", "darwin_op", "--link", text(&port)]);
    wait_until("the emulated robot is there", || port.exists());
    let options = ["--timeout-ms", "200", "--baud", "1000000", "--protocol", "dynamixel1"];
    let servo = |command: &str, arguments: &[&str]| {
        text_of(&[&["servo", command, text(&port)][..], arguments, &options[..]].concat())
    };
    let board = servo("scan", &["--last-id", "200"]);
    let expected = format!(
        "id 200: CM-730, firmware 19, dynamixel1 at 1000000 bit/s\nid 200 has switched off the power of the servos behind it, \
         which cannot answer: `downbeat servo write {} 200 dynamixel_power 1 --baud 1000000 --protocol dynamixel1` switches it \
         on; then scan again\n",
        text(&port)
    );
    assert_eq!(board, expected);
    servo("write", &["200", "dynamixel_power", "1"]);
    wait_until("the servos answer", || servo("scan", &["--last-id", "2"]).lines().count() == 2);
}

#[test]
fn a_scan_at_another_speed_finds_nothing() {
    let servos = Servos::of("so101", 57_600);
    let error = servos.refused("scan", &["--last-id", "1", "--protocol", "feetech_sts"]);
    assert!(error.contains("no device answered; is the power on"), "{error}");
}

#[test]
fn setup_writes_a_description_with_which_the_servos_run() {
    let servos = Servos::of("so101", 1_000_000);
    let folder = tempfile::tempdir().unwrap();
    let [description, robot] = ["arm.toml", "robot.toml"].map(|name| folder.path().join(name));
    let arguments = ["--last-id", "7", "--protocol", "feetech_sts", "--output", text(&description)];
    let printed = servos.servo("setup", &arguments);
    assert!(printed.starts_with("id 1: STS3215") && printed.contains("wrote "), "{printed}");
    assert!(servos.refused("setup", &arguments).contains("exists; name another file with --output"));
    std::fs::write(
        &robot,
        "[robot]\nname = \"arm\"\n[[module]]\nname = \"hardware\"\nkind = \"servo_bus\"\nsettings = { description = \"arm.toml\" }\n",
    )
    .unwrap();
    let bag = folder.path().join("bag");
    record_until(
        &["bag", "record", "--robot", text(&robot), "--all", "--output", text(&bag)],
        &bag,
        "/joint_states",
        20,
    );
    let reader = downbeat::bags::Reader::open(&bag).unwrap();
    let states = [reader.topic("/joint_states").unwrap()];
    let messages = reader.messages(downbeat::bags::Selection::all().topics(states)).unwrap();
    let names = messages.map(|message| {
        let message = message.unwrap();
        downbeat_msgs::cdr::from_slice::<downbeat_msgs::sensor_msgs::msg::JointState>(&message.data)
            .unwrap()
            .name
    });
    let expected: Vec<String> = (1..=6).map(|id| format!("joint_{id}")).collect();
    assert_eq!(names.last().unwrap(), expected);
}

#[test]
fn setup_names_two_servos_of_one_id_and_a_wrong_supply() {
    let servos = Servos::with_faults("so101", 1_000_000, &["twin:4", "supply:12.1"]);
    let folder = tempfile::tempdir().unwrap();
    let description = folder.path().join("arm.toml");
    let arguments = ["--last-id", "7", "--protocol", "feetech_sts", "--output", text(&description)];
    let output = output_of(&servos.line("setup", &arguments));
    let [printed, error] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    assert!(!output.status.success() && error.contains("is not written before that is solved"), "{error}");
    let twins =
        printed.lines().filter(|line| line.contains("Two servos may have this id")).collect::<Vec<_>>();
    assert!(
        twins.len() == 1 && twins[0].starts_with("id 4: what comes at 1000000 bit/s is not understood."),
        "{printed}"
    );
    let scanned = servos.servo("scan", &["--last-id", "7", "--protocol", "feetech_sts"]);
    assert!(scanned.contains("id 4: what comes at 1000000 bit/s is not understood: two servos"), "{scanned}");
    let read = servos.refused("read", &["4", "present_position", "--protocol", "feetech_sts"]);
    assert!(read.contains("id 4 at 1000000 bit/s is not understood. Two servos may have this id"), "{read}");
    let supply = "id 1: it measures a supply of 12.1 V, and its limits are 4.0 to 8.0 V. Is the power supply the one for a STS3215?";
    assert!(printed.contains(supply), "{printed}");
    assert!(!description.exists());
    servos.servo("setup", &[&arguments[..], &["--force"]].concat());
    assert!(description.exists());
}

/// A folder as `/dev`, with what may be plugged in beside servos.
#[test]
fn setup_finds_the_port_with_servos_among_those_that_are_there() {
    let devices = tempfile::tempdir().unwrap();
    let at = |name: &str| devices.path().join(name);
    let output = at("arm.toml");
    let asked = ["--last-id", "7", "--protocol", "feetech_sts", "--baud", "1000000", "--timeout-ms", "200"];
    let arguments =
        [&["servo", "setup", "--devices", text(devices.path()), "--output", text(&output)][..], &asked]
            .concat();
    let refused = || {
        let tried = output_of(&arguments);
        assert!(!tried.status.success() && !output.exists());
        [tried.stdout, tried.stderr].map(|bytes| String::from_utf8(bytes).unwrap())
    };
    let [_, nothing] = refused();
    assert!(nothing.contains("has no serial port of an adapter (ttyUSB*, ttyACM*"), "{nothing}");

    let _silent = PseudoTerminal::open(Some(&at("ttyUSB0"))).unwrap();
    std::fs::write(at("ttyUSB1"), "").unwrap();
    std::fs::write(at("tty1"), "").unwrap();
    let [ports, nobody] = refused();
    assert!(ports.contains("ttyUSB0: no device answered"), "{ports}");
    assert!(ports.contains("ttyUSB1 is a regular file, not a serial port"), "{ports}");
    assert!(nobody.contains("no servo was understood on") && nobody.contains("is the power on"), "{nobody}");

    std::fs::create_dir_all(at("serial/by-id")).unwrap();
    let by_id = at("serial/by-id/usb-adapter");
    std::os::unix::fs::symlink("../../ttyACM0", &by_id).unwrap();
    let so101 = "robots/servos/so101.toml";
    let _first = Running::start(&["emulate", "servos", so101, "--link", text(&at("ttyACM0"))]);
    wait_until("the emulated servos are there", || at("ttyACM0").exists());
    let printed = text_of(&arguments);
    assert!(printed.contains(&format!("the servos are on {}\n", text(&by_id))), "{printed}");
    // A port with two names is asked once.
    assert_eq!(printed.matches("id 6: STS3215").count(), 1, "{printed}");
    let written = std::fs::read_to_string(&output).unwrap();
    assert!(written.contains(&format!("port = {by_id:?}")), "{written}");

    std::fs::remove_file(&output).unwrap();
    let _second = Running::start(&["emulate", "servos", so101, "--link", text(&at("ttyACM1"))]);
    wait_until("the second ones are there", || at("ttyACM1").exists());
    let [_, several] = refused();
    let [first, second] = [text(&by_id), text(&at("ttyACM1"))].map(str::to_owned);
    assert!(several.contains(&format!("servos were found on {first}, {second}; name the port")), "{several}");
    assert!(several.contains(&format!("`downbeat servo setup {first}`")), "{several}");
}

/// One servo is put on the other way round, and one so that its travel passes the end of its turn.
#[test]
fn a_calibration_by_hand_finds_stops_zeros_and_signs() {
    let folder = tempfile::tempdir().unwrap();
    let [real, description, port] = ["real.toml", "arm.toml", "port"].map(|name| folder.path().join(name));
    let arm = |joints: [&str; 3]| {
        let joint =
            |(id, keys): (usize, &str)| format!("[[joint]]\nname = \"joint_{id}\"\nid = {id}\n{keys}\n");
        let joints: String = (1..).zip(joints).map(joint).collect();
        format!(
            "name = \"arm\"\n[[bus]]\nname = \"arm\"\nport = \"/dev/none\"\nbaud = 1_000_000\nprotocol = \"feetech_sts\"\n\
             cycle_ms = 10\n[defaults]\nmodel = \"STS3215\"\n{joints}"
        )
    };
    let stops = "limits = [-1.2, 1.5]";
    let (turned_round, at_the_end) = (
        format!("{stops}\nzero = 2100\nsign = -1"),
        format!("{stops}\nregisters = {{ homing_offset = -1852 }}"),
    );
    std::fs::write(&real, arm([&turned_round, &at_the_end, stops])).unwrap();
    std::fs::write(&description, arm(["limits = [-3.0, 3.0]  # to be calibrated"; 3])).unwrap();
    let mut hand = Typed::start(&["emulate", "servos", text(&real), "--link", text(&port), "--by-hand"]);
    wait_until("the emulated servos are there", || port.exists());
    let mut arm = Typed::start(&[
        "servo",
        "calibrate",
        text(&description),
        "--port",
        text(&port),
        "--timeout-ms",
        "200",
        "--margin",
        "0.1",
    ]);
    arm.says("lose their torque now");
    arm.types("");
    arm.says("from one stop to the other");
    let mut turn = |joint: usize, angle: f64| {
        hand.types(&format!("turn joint_{joint} {angle}"));
        hand.says(&format!("joint_{joint} is turned"));
    };
    for joint in [1, 2] {
        [-1.2, 1.5, 0.0].into_iter().for_each(|angle| turn(joint, angle));
    }
    arm.types("");
    arm.says("joint_2 passed the end of what servo 2 counts");
    arm.says("joint_3 was not turned, and stays as it is described");
    arm.says("at 0 rad, and press Enter");
    arm.types("");
    arm.says("joint_1: turn it a little");
    arm.types("");
    arm.says("joint_1 was turned by less than 3 degrees");
    arm.says("joint_1: turn it a little");
    turn(1, 0.3);
    arm.types("");
    arm.says("joint_2: turn it a little");
    turn(2, 0.3);
    arm.types("");
    arm.says("the joints are still limp");
    assert!(arm.child.wait().unwrap().success());

    let calibrated = downbeat::modules::servo_bus::Description::load(text(&description)).unwrap();
    let joints = &calibrated.bus("arm").unwrap().joints;
    let near =
        |value: f64, expected: f64| assert!((value - expected).abs() < 0.01, "{value}, not {expected}");
    for joint in &joints[..2] {
        near(joint.min_rad, -1.1);
        near(joint.max_rad, 1.4);
    }
    assert_eq!(joints.iter().map(|joint| joint.sign).collect::<Vec<_>>(), [-1.0, 1.0, 1.0]);
    near(joints[0].registers.position.to_si(joints[0].zero - 2100), 0.0);
    let read =
        ["servo", "read", text(&port), "2", "present_position", "--timeout-ms", "200", "--baud", "1000000"];
    let read = text_of(&[&read[..], &["--protocol", "feetech_sts"]].concat());
    let position = read.split_whitespace().nth(1).unwrap().parse().unwrap();
    near(joints[1].angle(position), 0.3);
    assert!((1000..3000).contains(&joints[1].zero), "its travel is in the middle of the turn now");
    assert_eq!([joints[2].min_rad, joints[2].max_rad], [-3.0, 3.0]);
    let text = std::fs::read_to_string(&description).unwrap();
    assert_eq!(text.matches("# to be calibrated").count(), 3, "{text}");
}

#[test]
fn offsets_are_found_by_eye_with_joints_that_go_slowly_to_zero_and_are_moved_by_steps() {
    let folder = tempfile::tempdir().unwrap();
    let [description, port] = ["arm.toml", "port"].map(|name| folder.path().join(name));
    let arm = "name = \"arm\"\n[[bus]]\nname = \"arm\"\nport = \"/dev/none\"\nbaud = 1_000_000\nprotocol = \"feetech_sts\"\n\
               cycle_ms = 10\n[defaults]\nmodel = \"STS3215\"\n[[joint]]\nname = \"pan\"\nid = 1\nlimits = [-1.0, 1.0]\n\
               offset = 5 # before\n[[joint]]\nname = \"tilt\"\nid = 2\nlimits = [-1.0, 1.0]\nsign = -1\n[[joint]]\n\
               name = \"wheel\"\nid = 3\nmode = \"velocity\"\nmax_velocity_rad_s = 3.0\n";
    std::fs::write(&description, arm).unwrap();
    let _emulator = Running::start(&["emulate", "servos", text(&description), "--link", text(&port)]);
    wait_until("the emulated servos are there", || port.exists());
    let of_line = ["--baud", "1000000", "--protocol", "feetech_sts", "--timeout-ms", "200"];
    let read = |id: &str, register: &str| -> i64 {
        let read = text_of(&[&["servo", "read", text(&port), id, register][..], &of_line].concat());
        read.split_whitespace().nth(1).unwrap().parse().unwrap()
    };
    let tune = ["servo", "tune", text(&description), "--port", text(&port), "--timeout-ms", "200"];
    let mut arm = Typed::start(&tune);
    arm.says("get their torque now, and go slowly to 0 rad");
    assert_eq!(read("1", "torque_enable"), 0);
    arm.types("");
    arm.says("wheel is driven by velocities or efforts, and has no offset");
    arm.says("pan: move it until");
    for answer in ["++", "+", "-", "-"] {
        arm.types(answer);
        arm.says("pan: move it until");
    }
    arm.types("");
    arm.says("tilt: move it until");
    arm.types("++");
    arm.says("tilt: move it until");
    // Further than any tolerance.
    for _ in 0..21 {
        arm.types("++");
        arm.says("tilt: move it until");
    }
    arm.types("++");
    arm.says("tilt cannot be moved further");
    arm.types("+1");
    arm.says("\"+1\" is no answer");
    (0..21).for_each(|_| arm.types("--"));
    arm.types("");
    arm.says("lose their torque now");
    arm.types("");
    arm.says("wrote ");
    assert!(arm.child.wait().unwrap().success());
    // A servo of 4096 steps, of which 2048 is the middle; the second one counts the other way.
    assert_eq!((read("1", "goal_position"), read("2", "goal_position")), (2048 + 5 + 9, 2048 - 10));
    assert_eq!((read("1", "torque_enable"), read("2", "torque_enable")), (0, 0));
    let tuned = std::fs::read_to_string(&description).unwrap();
    assert!(
        tuned.contains("offset = 14 # before\n") && tuned.contains("sign = -1\noffset = -10\n"),
        "{tuned}"
    );
}

#[test]
fn registers_are_read_and_written_by_name() {
    let servos = Servos::of("so101", 1_000_000);
    assert_eq!(servos.servo("ping", &["3"]), "id 3: STS3215, firmware 3, feetech_sts at 1000000 bit/s\n");
    let all = servos.servo("read", &["3"]);
    assert!(all.lines().count() > 40 && all.contains("present_temperature"), "{all}");
    servos.servo("write", &["3", "torque_limit", "500"]);
    let read = servos.servo("read", &["3", "torque_limit"]);
    assert!(read.contains(" 500 ") && read.contains("0.5000 1"), "{read}");
    let error = servos.refused("read", &["3", "present_positoin"]);
    assert!(
        error.contains("STS3215 has no register \"present_positoin\", did you mean \"present_position\"?"),
        "{error}"
    );
    assert!(servos.refused("write", &["3", "torque_limit", "5000"]).contains("takes 0 to 1000, not 5000"));
    assert!(servos.refused("ping", &["99", "--protocol", "feetech_sts"]).contains("no answer from id 99"));
}

#[test]
fn a_dangerous_write_needs_force() {
    let servos = Servos::of("so101", 1_000_000);
    let force = |text: &str| text.contains("repeat with --force if that is intended");
    assert!(force(&servos.refused("write", &["3", "max_position_limit", "3000"])));
    assert!(force(&servos.refused("write", &["3", "baud_rate", "4"])));
    assert!(servos.refused("write", &["3", "id", "9"]).contains("use `downbeat servo set-id`"));
    servos.servo("write", &["3", "goal_position", "3000"]);
    let jump = servos.refused("write", &["3", "torque_enable", "1"]);
    assert!(jump.contains("rad from the position: it would jump; write goal_position first"), "{jump}");
    servos.servo("write", &["3", "torque_enable", "1", "--force"]);
    servos.servo("write", &["3", "max_position_limit", "3500", "--force"]);
    assert!(servos.servo("read", &["3", "max_position_limit"]).contains(" 3500 "));
}

#[test]
fn a_servo_gets_another_id_if_that_is_free() {
    let servos = Servos::of("so101", 1_000_000);
    assert!(servos.refused("set-id", &["3", "4"]).contains("id 4 is taken"));
    assert_eq!(servos.servo("set-id", &["3", "9"]), "id 3 is now id 9\n");
    assert!(servos.servo("ping", &["9"]).starts_with("id 9: STS3215"));
    assert!(servos.refused("ping", &["3", "--protocol", "feetech_sts"]).contains("no answer from id 3"));
}

fn id(raw: u8) -> Id {
    Id::new(raw).unwrap()
}

/// Instructions, with the corresponding calls of `dynamixel-sdk`.
fn instructions() -> Vec<(Protocol, Instruction, Value)> {
    let mut all = Vec::new();
    let stuffed = vec![0xFF, 0xFF, 0xFD, 0xFD, 0x00];
    for (protocol, number) in [(Protocol::Dynamixel1, 1), (Protocol::Dynamixel2, 2)] {
        let (write, id_7) = (stuffed.clone(), id(7));
        all.extend([
            (protocol, Instruction::Ping { id: id_7 }, json!([number, "ping", 7])),
            (
                protocol,
                Instruction::Read { id: id_7, address: 36, length: 8 },
                json!([number, "read", 7, 36, 8]),
            ),
            (
                protocol,
                Instruction::Write { id: id_7, address: 30, data: write.clone() },
                json!([number, "write", 7, 30, write]),
            ),
            (
                protocol,
                Instruction::RegWrite { id: id_7, address: 30, data: write.clone() },
                json!([number, "reg_write", 7, 30, write]),
            ),
            (protocol, Instruction::Action { id: id_7 }, json!([number, "action", 7])),
        ]);
        let entries = vec![(id(1), vec![0xFF, 0xFF]), (id(2), vec![0xFD, 3])];
        let raw = [1, 0xFF, 0xFF, 2, 0xFD, 3];
        let sync_write = Instruction::SyncWrite { address: 30, length: 2, entries };
        all.push((protocol, sync_write, json!([number, "sync_write", 30, 2, raw])));
    }
    let bulk = |protocol, raw: Vec<u8>, number| {
        let entries = vec![
            ReadEntry { id: id(200), address: 24, length: 27 },
            ReadEntry { id: id(1), address: 36, length: 8 },
        ];
        (protocol, Instruction::BulkRead { entries }, json!([number, "bulk_read", raw]))
    };
    all.push(bulk(Protocol::Dynamixel1, vec![27, 200, 24, 8, 1, 36], 1));
    all.push(bulk(Protocol::Dynamixel2, vec![200, 24, 0, 27, 0, 1, 36, 0, 8, 0], 2));
    let two = Protocol::Dynamixel2;
    all.push((two, Instruction::Reboot { id: id(7) }, json!([2, "reboot", 7])));
    let ids = vec![id(1), id(2), id(20)];
    all.push((
        two,
        Instruction::SyncRead { address: 126, length: 21, ids: ids.clone() },
        json!([2, "sync_read", 126, 21, [1, 2, 20]]),
    ));
    let fast = Instruction::FastSyncRead { address: 126, length: 21, ids };
    all.push((two, fast, json!([2, "fast_sync_read", 126, 21, [1, 2, 20]])));
    let entries = vec![ReadEntry { id: id(9), address: 144, length: 3 }];
    all.push((two, Instruction::FastBulkRead { entries }, json!([2, "fast_bulk_read", [9, 144, 0, 3, 0]])));
    let entries = vec![WriteEntry { id: id(3), address: 600, data: stuffed.clone() }];
    let raw = [&[3, 600_u16.to_le_bytes()[0], 600_u16.to_le_bytes()[1], 5, 0][..], &stuffed].concat();
    all.push((two, Instruction::BulkWrite { entries }, json!([2, "bulk_write", raw])));
    all
}

#[test]
fn packets_are_those_of_dynamixel_sdk() {
    let instructions = instructions();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("instructions.json");
    let asked: Vec<&Value> = instructions.iter().map(|(_, _, asked)| asked).collect();
    std::fs::write(&file, serde_json::to_string(&asked).unwrap()).unwrap();
    let Some(packets) = python("dynamixel_packets.py", &[&file]) else { return };
    let Some(packets) = packets.as_array() else {
        test_machine::missing("the Python package dynamixel-sdk", "`cargo xtask python` installs it");
        return;
    };
    assert_eq!(packets.len(), instructions.len());
    for ((protocol, instruction, _), packet) in instructions.iter().zip(packets) {
        let ours: String =
            instruction.to_bytes(*protocol).unwrap().iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(ours, packet.as_str().unwrap(), "{protocol} {instruction:?}");
    }
}

/// The page shows the steps that the terminal asks for, with a hand that turns all joints.
#[test]
fn a_six_joint_arm_is_calibrated_in_the_page() {
    let Some(mut script) = common::browser::script("calibrate.mjs") else { return };
    let folder = tempfile::tempdir().unwrap();
    let so101 = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots/servos/so101.toml");
    let so101 = std::fs::read_to_string(so101).unwrap();
    // The arm is put together so that two joints are elsewhere than the description says.
    let real = so101.replace("name = \"elbow_flex\"\n", "name = \"elbow_flex\"\nzero = 1900\n");
    let real = real.replace("name = \"shoulder_lift\"\n", "name = \"shoulder_lift\"\nsign = -1\n");
    assert_eq!((real.matches("zero").count(), real.matches("sign =").count()), (2, 1));
    std::fs::write(folder.path().join("real.toml"), &real).unwrap();
    let description = folder.path().join("arm.toml");
    std::fs::write(&description, so101).unwrap();
    let output = script.env("DOWNBEAT_FOLDER", folder.path()).output().unwrap();
    let said = [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    assert!(output.status.success(), "{}", said.concat());

    let of = |path: &Path| downbeat::modules::servo_bus::Description::load(text(path)).unwrap();
    let (found, real) = (of(&description), of(&folder.path().join("real.toml")));
    let (found, real) = (&found.bus("arm").unwrap().joints, &real.bus("arm").unwrap().joints);
    for (found, real) in found.iter().zip(real) {
        assert_eq!(found.sign, real.sign, "{}", found.name);
        assert!((found.zero - real.zero).abs() < 3, "{}: {}, not {}", found.name, found.zero, real.zero);
    }
}
