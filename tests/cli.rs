//! The command line as a user sees it.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::Path;

use common::{
    QUIET_ROBOT, Running, downbeat, output_of, python, record_until, robot_file, text_of, wait_until,
};
use downbeat::bags::{Reader, Selection};
use downbeat::msgs::cdr;
use downbeat::msgs::downbeat_interfaces::msg::BusExchange;
use test_machine::free_domain;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn a_robot_without_a_simulated_world_has_no_engine_to_choose() {
    let output = output_of(&["run", "robots/darwin_op.toml", "--physics", "mujoco"]);
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("no module of darwin_op simulates a world"), "{message}");
}

#[test]
fn modules_in_python_are_for_the_program_of_the_wheel() {
    let folder = tempfile::tempdir().unwrap();
    let robot = robot_file(folder.path(), |text| text.replacen("\"stand_nod_wave\"", "\"python\"", 1));
    let output = output_of(&["check", text(&robot)]);
    let message = String::from_utf8(output.stderr).unwrap();
    let wheel = "build it with `cargo xtask wheel`, install it with `pip install target/wheels/release/downbeat_robotics-*.whl`";
    assert!(message.contains(wheel), "{message}");
}

#[test]
fn check_says_what_clients_of_a_service_receive_for_a_refusal() {
    let output = text_of(&["check", "robots/darwin_op_walks.toml"]);
    for expected in [
        "  service gait/start -> /gait/start std_srvs/srv/Trigger\n    a refusal: success: false, message: the reason\n",
        "simulation_interfaces/srv/DeleteEntity\n    a refusal: result.error_message: the reason\n",
        "  action play_motion -> /play_motion ",
        "    a failure: the goal is not accepted; later, its status is ABORTED, its result has default values\n",
    ] {
        assert!(output.contains(expected), "{output}");
    }
    let json: serde_json::Value =
        serde_json::from_str(&text_of(&["check", "robots/so101.toml", "--json"])).unwrap();
    assert_eq!(json["services"][0]["refusal"], "success: false, message: the reason");
}

#[test]
fn errors_in_a_robot_file_contain_file_line_and_the_nearest_name() {
    let folder = tempfile::tempdir().unwrap();
    let wrong =
        |from: &'static str, to: &'static str| robot_file(folder.path(), |text| text.replacen(from, to, 1));
    let cases = [
        (
            "sensor_msgs/msg/JointState",
            "sensor_msgs/JointState",
            "did you mean \"sensor_msgs/msg/JointState\"?",
        ),
        (
            "sensor_msgs/msg/JointState",
            "sensor_msgs/msg/Imu",
            "\"joint_commands\" is of type \"sensor_msgs/msg/JointState\"",
        ),
        ("\"stand_nod_wave\"", "\"stand_nod_weave\"", "did you mean \"stand_nod_wave\"?"),
        ("hold_s = 2.0", "hold_seconds = 2.0", "did you mean \"hold_s\"?"),
        ("hold_s = 2.0", "hold_s = -1.0", "out of range"),
        ("hold_s = 2.0", "hold_s = \"long\"", "expected double, found text \"long\""),
        ("\"battery_state\"", "\"battery_stat\"", "did you mean \"battery_state\"?"),
        ("remap = { joint_commands", "remap = { joint_command", "did you mean \"joint_commands\"?"),
        ("= \"joint_goals\" }", "= \"imu/data_raw\" }", "imu/data_raw"),
        ("topics = \"all\"", "topics = [\"joint_state\"]", "did you mean \"joint_states\"?"),
        ("qos = \"sensor_data\"", "qos = \"sensors\"", "did you mean \"sensor_data\"?"),
        ("    \"buttons\",", "    \"buttons\", \"buttons\",", "/buttons is exposed twice"),
        ("\"buttons\"", "{ topic = \"buttons\", as = \"1st\" }", "1st"),
        ("faults = []", "faults = [\"dead-servo:99\"]", "dead-servo"),
        ("[expose]", "[expose", "robot.toml:"),
        ("name = \"mux\"", "name = \"recorder\"", "a module that the program adds"),
        ("name = \"mux\"", "name = \"bridge\"", "a module that the program adds"),
        ("settings = { hold_s = 2.0 }", "restart = \"alway\"", "did you mean \"always\"?"),
        ("settings = { hold_s = 2.0 }", "deadline = 20", "such as \"20ms\""),
    ];
    for (from, to, expected) in cases {
        let robot = wrong(from, to);
        let changed = std::fs::read_to_string(&robot).unwrap();
        let line = changed.lines().position(|line| line.contains(to)).unwrap() + 1;
        for command in ["check", "run"] {
            let output = output_of(&[command, text(&robot)]);
            let message = String::from_utf8(output.stderr).unwrap();
            assert_eq!(output.status.code(), Some(1), "{command} with {to}: {message}");
            assert!(message.contains(expected), "{command} with {to}: {message}");
            assert!(
                message.contains(&format!("robot.toml:{line}:")),
                "{command} with {to} on {line}: {message}"
            );
        }
    }
}

#[test]
fn invalid_arguments_are_refused_with_a_reason() {
    let cases: [(&[&str], &str); 15] = [
        (
            &["run", "darwin_opp"],
            "there is no such file, and no robot \"darwin_opp\" is carried; did you mean \"darwin_op\"?",
        ),
        (
            &["check", "zzz"],
            "there is no such file, and no robot \"zzz\" is carried; `downbeat robots list` names those that are",
        ),
        (
            &["robots", "copy", "darwin_opp"],
            "no robot \"darwin_opp\" is carried; did you mean \"darwin_op\"? `downbeat robots list` names",
        ),
        (
            &["robots", "copy", "zzz"],
            "no robot \"zzz\" is carried; `downbeat robots list` names those that are",
        ),
        (&["compose", "darwin_op"], "by `downbeat robots copy darwin_op FOLDER`, then `downbeat compose"),
        (&["run", "no/such.toml"], "cannot read the robot file no/such.toml"),
        (&["run", "robots/darwin_op.toml", "--domain", "400"], "0 to 232"),
        (&["bag", "info", "no/such/bag"], "no/such/bag"),
        (&["bag", "play", "no/such/bag"], "no/such/bag"),
        (&["emulate", "darwin_op", "--link", "/tmp/x", "--fault", "fire"], "unknown fault \"fire\""),
        (
            &["bag", "play", "bags/recordings/darwin_op_emulated", "--start-offset", "1h"],
            "cannot start 3600s into the bag",
        ),
        (
            &["run", "robots/darwin_op.toml", "--params-file", "no/such.yaml"],
            "cannot read the parameter file no/such.yaml",
        ),
        (&["run", "robots/darwin_op.toml", "-p", "mux.hold_s=3"], "expected module.setting:=value"),
        (&["check", "robots/darwin_op.toml", "-p", "mix.hold_s:=3"], "did you mean \"mux\"?"),
        (
            &["check", "robots/darwin_op.toml", "-p", "mux.hold_s:=long"],
            "-p mux.hold_s:=long: module \"mux\", setting \"hold_s\": expected double",
        ),
    ];
    for (arguments, expected) in cases {
        let output = output_of(arguments);
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {message}");
        assert!(message.contains(expected), "{arguments:?}: {message}");
    }
}

#[test]
fn a_port_for_viewers_that_another_program_has_is_named_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let robot = folder.path().join("robot.toml");
    std::fs::write(&robot, QUIET_ROBOT).unwrap();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap();
    for option in ["--view", "--foxglove"] {
        let output = output_of(&["run", text(&robot), &format!("{option}={}", address.port())]);
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{option}: {message}");
        assert!(
            message.contains(&format!("cannot listen for viewers on {address}: ")),
            "{option}: {message}"
        );
        let remedy = "Choose another port, or 0 for a free one, or end the program that has it";
        assert!(message.contains(remedy), "{option}: {message}");
    }
}

#[test]
fn a_listed_robot_can_be_checked_if_this_program_lacks_no_feature_for_it() {
    let listed: serde_json::Value = serde_json::from_str(&text_of(&["robots", "list", "--json"])).unwrap();
    for robot in listed.as_array().unwrap() {
        let name = robot["name"].as_str().unwrap();
        let is_complete = robot["missing_features"].as_array().unwrap().is_empty();
        let checked = output_of(&["check", name]);
        assert_eq!(checked.status.success(), is_complete, "{robot}: {checked:?}");
    }
}

#[test]
fn every_command_has_help() {
    let commands: [(&[&str], &str); 12] = [
        (&["--help"], "ROS_DOMAIN_ID"),
        (&["run", "--help"], "500ms, 10s, 5min, 1h"),
        (&["check", "--help"], "without running it"),
        (&["run", "--help"], "MODULE.SETTING:=VALUE"),
        (&["bag", "--help"], "Play a bag"),
        (&["bag", "info", "--help"], "ros2 bag info"),
        (&["bag", "record", "--help"], "from the very first message"),
        (&["bag", "play", "--help"], "with the time of the bag"),
        (&["interface", "--help"], "then from AMENT_PREFIX_PATH"),
        (&["interface", "show", "--help"], "sensor_msgs/msg/JointState"),
        (&["interface", "decode", "--help"], "CDR with its four-byte header"),
        (&["emulate", "darwin_op", "--help"], "dead-servo:5@3s..6s"),
    ];
    for (command, word) in commands {
        let help = text_of(command).split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(help.contains(word), "{word:?} in the help of {command:?}: {help}");
    }
    let check = text_of(&["check", "robots/darwin_op.toml"]);
    for word in ["hardware", "joint_states", "sensor_msgs/msg/JointState", "emulated", "hold_s"] {
        assert!(check.contains(word), "{word} in {check}");
    }
    assert!(text_of(&["check", "robots/darwin_op_serial.toml"]).contains("/dev/ttyUSB0"));
    assert!(text_of(&["check", "--kinds"]).contains("darwin_op_emulator"));
}

#[test]
fn a_run_with_a_duration_ends_and_each_run_has_its_own_bag() {
    let domain = free_domain().to_string();
    let folder = tempfile::tempdir().unwrap();
    let on_two_threads = |text: String| text.replace("[robot]", "[robot]\nlauncher = \"pool\"\nthreads = 2");
    let (robot, bag) = (robot_file(folder.path(), on_two_threads), folder.path().join("bag"));
    let arguments = ["run", text(&robot), "--domain", &domain, "--duration", "1s", "--record", text(&bag)];
    let output = text_of(&arguments);
    assert!(output.contains("exposed to ROS 2: /joint_states") && output.contains("lost 0"), "{output}");
    let before = std::fs::read(bag.join("bag_0.mcap")).unwrap();
    let second = folder.path().join("bag_2");
    let again = text_of(&arguments);
    assert!(
        again.contains("lost 0") && again.contains(&format!("recording into {}", text(&second))),
        "{again}"
    );
    assert_eq!(std::fs::read(bag.join("bag_0.mcap")).unwrap(), before);
    let first_time = |bag: &Path| Reader::open(bag).unwrap().metadata().unwrap().starting_time;
    assert!(first_time(&second) > first_time(&bag));
    assert!(text_of(&["bag", "info", text(&second)]).contains("bag_2_0.mcap"));
    text_of(&[&arguments[..], &["--force"]].concat());
    assert_ne!(std::fs::read(bag.join("bag_0.mcap")).unwrap(), before);
    assert!(!folder.path().join("bag_3").exists());
}

#[test]
fn a_robot_runs_with_all_options_for_its_modules() {
    let domain = free_domain().to_string();
    let folder = tempfile::tempdir().unwrap();
    let ways = |text: String| {
        let module =
            "restart = { times = 3, backoff = \"500ms\" }\ndeadline = \"1s\"\ninitial_state = \"active\"\n";
        text.replace("[expose]", "synchrony = \"every_cycle\"\n[expose]")
            .replace("[[module]]\n", &format!("[[module]]\n{module}"))
            .replace("kind = \"darwin_op\"\n", "kind = \"darwin_op\"\ncpus = [0]\ninbox = \"all\"\n")
            + "\n[launcher]\nkind = \"threads\"\nspin = \"never\"\nidle = \"park\"\n"
    };
    let (robot, bag) = (robot_file(folder.path(), ways), folder.path().join("bag"));
    assert!(text_of(&["check", text(&robot)]).contains("each module on its own thread"));
    let arguments = ["run", text(&robot), "--domain", &domain, "--record", text(&bag)];
    let output = record_until(&arguments, &bag, "/joint_states", 100);
    assert!(output.contains("lost 0"), "{output}");
}

#[test]
fn settings_come_from_parameter_files_and_the_command_line_in_their_order() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, parameters: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, parameters).unwrap();
        path
    };
    let named = |text: String| text.replace("[robot]", "[robot]\nparams = [\"of_robot.yaml\"]");
    let robot = robot_file(folder.path(), named);
    let hold_s = |more: &[&str]| {
        let output = text_of(&[&["check", text(&robot)], more].concat());
        let line = output.lines().find(|line| line.contains("hold_s")).unwrap();
        line.split_whitespace().nth(2).unwrap().to_owned()
    };
    file("of_robot.yaml", "darwin_op:\n  ros__parameters:\n    mux.hold_s: 3.0\n");
    assert_eq!(hold_s(&[]), "3");
    let one = file("one.yaml", "/**:\n  ros__parameters:\n    mux: {hold_s: 4.0}\n");
    let two = file("two.yaml", "/darwin_op:\n  ros__parameters:\n    mux.hold_s: 5.0\n");
    let files = ["--params-file", text(&one), "--params-file", text(&two)];
    assert_eq!(hold_s(&files[..2]), "4");
    assert_eq!(hold_s(&files), "5");
    assert_eq!(hold_s(&[&["-p", "mux.hold_s:=6", "-p", "mux.hold_s:=7"], &files[..]].concat()), "7");

    let dumped = text_of(&["check", text(&robot), "--dump-params", "-p", "mux.hold_s:=0.25"]);
    let dumped = file("dumped.yaml", &dumped);
    assert_eq!(hold_s(&["--params-file", text(&dumped)]), "0.25");

    let other = file("other.yaml", "/other:\n  ros__parameters:\n    mux.hold_s: 9.0\n");
    let output = text_of(&["check", text(&robot), "--params-file", text(&other)]);
    assert!(output.contains("nothing in it applies to the node /darwin_op; it is for /other"), "{output}");

    let wrong = file("wrong.yaml", "/darwin_op:\n  ros__parameters:\n    mux:\n      hold: 9.0\n");
    for command in ["check", "run"] {
        let output = output_of(&[command, text(&robot), "--params-file", text(&wrong)]);
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{message}");
        let expected = ["wrong.yaml:4: module \"mux\" has no setting \"hold\"", "did you mean \"hold_s\"?"];
        assert!(expected.iter().all(|expected| message.contains(expected)), "{message}");
    }
}

/// Lists are set, because rcl does not accept empty ones.
#[test]
fn a_real_ros_node_reads_the_parameters_that_check_writes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("dumped.yaml");
    let offsets = format!("hardware.offset_ticks:={:?}", [0; 20]);
    let lists = ["-p", "emulator.faults:=[\"drop:0.01\"]", "-p", &offsets];
    let robot = ["check", "robots/darwin_op.toml", "--dump-params", "-p", "mux.hold_s:=3"];
    std::fs::write(&path, text_of(&[&robot[..], &lists[..]].concat())).unwrap();
    let Some(read) = python("load_parameters.py", &[&path]) else { return };
    assert_eq!(read["mux.hold_s"], serde_json::json!(["DOUBLE", 3.0]));
    assert_eq!(read["hardware.p_gain"], serde_json::json!(["INTEGER", 32]));
    assert_eq!(read["hardware.port"], serde_json::json!(["STRING", "memory:darwin_op"]));
    assert_eq!(read["emulator.faults"], serde_json::json!(["STRING_ARRAY", ["drop:0.01"]]));
    assert_eq!(read["hardware.offset_ticks"], serde_json::json!(["INTEGER_ARRAY", vec![0; 20]]));
}

#[test]
fn a_separate_emulated_robot_is_driven_over_its_port_and_its_faults_are_reported() {
    let domain = free_domain().to_string();
    let folder = tempfile::tempdir().unwrap();
    let port = folder.path().join("serial");
    let faults = ["--fault", "dead-servo:5@2s..3s", "--fault", "close-port@7s..7.2s"];
    let mut arguments = vec!["emulate", "darwin_op", "--link", text(&port)];
    arguments.extend(faults);
    let mut emulator = Running::start(&arguments);
    wait_until("the port exists", || port.exists());
    let serial = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots/darwin_op_serial.toml");
    let robot = folder.path().join("robot.toml");
    let file = std::fs::read_to_string(serial).unwrap().replace("/dev/ttyUSB0", text(&port));
    std::fs::write(&robot, file).unwrap();
    let bag = folder.path().join("bag");
    let mut running = Running::start(&["run", text(&robot), "--domain", &domain, "--record", text(&bag)]);
    running.wait_for_output("servo 5 (r_el) does not answer");
    running.wait_for_output("servo 5 (r_el) is back");
    running.wait_for_output("lost the serial port");
    wait_until("joint states arrive over the port again", || has_joint_states_of_a_second_opening(&bag));
    running.interrupt();
    emulator.interrupt();
    assert!(!port.exists(), "the link is removed");
}

/// Returns whether a bag has joint states after the port was opened, closed and opened again.
fn has_joint_states_of_a_second_opening(bag: &Path) -> bool {
    let Ok(reader) = Reader::open(bag) else { return false };
    let (Some(exchanges), Some(states)) = (reader.topic("/bus/exchanges"), reader.topic("/joint_states"))
    else {
        return false;
    };
    let (mut openings, mut has_states) = (0, false);
    for message in reader.messages(Selection::all().topics([exchanges, states])).unwrap().map(Result::unwrap)
    {
        if message.topic == states {
            has_states = openings >= 2;
            continue;
        }
        let exchange: BusExchange = cdr::from_slice(&message.data).unwrap();
        let is_opening = exchange.kind == BusExchange::OPEN && exchange.outcome == BusExchange::OK;
        openings += usize::from(is_opening);
    }
    has_states
}

#[cfg(unix)]
#[test]
fn a_pipe_or_a_device_in_place_of_a_file_is_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let fifo = folder.path().join("fifo.toml");
    assert!(std::process::Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    let robot = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/darwin_op.toml");
    let bag = concat!(env!("CARGO_MANIFEST_DIR"), "/bags/tests/data/jazzy_mcap");
    let huge = folder.path().join("huge.toml");
    std::fs::File::create(&huge).unwrap().set_len(1 << 40).unwrap();
    let files = [
        (fifo.to_str().unwrap(), "only regular files are read"),
        ("/dev/zero", "only regular files are read"),
        ("/dev/random", "only regular files are read"),
        (huge.to_str().unwrap(), "at most 67108864 are read"),
    ];
    for (file, expected) in files {
        let commands: [&[&str]; 5] = [
            &["check", file],
            &["run", file],
            &["check", robot, "--ros-args", "--params-file", file],
            &["bag", "record", "--all", "--qos-profile-overrides-path", file, "--output", "never"],
            &["bag", "play", bag, "--qos-profile-overrides-path", file],
        ];
        for command in commands {
            let output = output_of(command);
            let error = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(1), "{command:?}: {error}");
            assert!(error.contains(expected), "{command:?}: {error}");
        }
    }
    assert_eq!(output_of(&["bag", "info", fifo.to_str().unwrap()]).status.code(), Some(1));
}

#[cfg(unix)]
#[test]
fn a_bag_with_a_name_that_is_not_utf_8_is_refused_before_recording() {
    use std::os::unix::ffi::OsStrExt;
    let folder = tempfile::tempdir().unwrap();
    let name = folder.path().join(std::ffi::OsStr::from_bytes(b"run_\xff"));
    let bag = concat!(env!("CARGO_MANIFEST_DIR"), "/bags/tests/data/jazzy_mcap");
    let output = downbeat(&["bag", "convert", bag, "--output"]).arg(&name).output().unwrap();
    let error = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{error}");
    assert!(error.contains("is not UTF-8"), "{error}");
    assert!(!name.exists());
}
