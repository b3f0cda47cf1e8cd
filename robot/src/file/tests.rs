#![allow(clippy::unwrap_used)]
use super::*;
use std::time::Duration;

use downbeat_bags::{Storage, StorageOptions, StoragePreset};
use downbeat_bridge::middleware::Direction;
use downbeat_executor::{Idle, Inbox, LifecycleState, Restart, SettingValue, Spin, Synchrony};
use downbeat_msgs::encoding::Encoding;
use downbeat_msgs::qos::QosProfile;

fn parse(text: &str) -> Result<RobotFile> {
    RobotFile::parse(Source::new(Path::new("robots/test.toml"), text.into()), &crate::Catalog::built_in())
        .map(|(file, _)| file)
}

fn problem(text: &str) -> String {
    parse(text).err().unwrap().to_string()
}

const ROBOT: &str = "[robot]\nname = \"r\"\n[[module]]\nkind = \"darwin_op\"\n";

#[test]
fn omitted_keys_have_defaults() {
    let file = parse(ROBOT).unwrap();
    assert_eq!((file.name.as_str(), file.namespace.as_str()), ("r", "/"));
    assert_eq!(file.launcher.choice, LauncherChoice::Linear);
    assert_eq!(file.modules[0].name, "darwin_op");
    assert!(file.expose.topics.is_empty() && file.record.topics.is_none() && !file.is_emulated());
}

#[test]
fn an_exposed_topic_may_have_another_name_a_type_and_a_quality_of_service() {
    let file = parse(&format!(
        "{ROBOT}[expose]\nout = [\"a\", {{ topic = \"b\", as = \"c\", qos = {{ preset = \"sensor_data\", depth = 2 }} }}]\n\
         in = [{{ topic = \"d\", type = \"sensor_msgs/msg/JointState\", qos = \"latched\" }}]"
    ))
    .unwrap();
    let [a, b, d] = file.expose.topics.as_slice() else { panic!("three topics") };
    assert_eq!((a.direction, a.qos), (Direction::Out, QosProfile::DEFAULT.into()));
    assert_eq!(b.ros_topic.as_deref(), Some("c"));
    assert_eq!(b.qos, QosProfile::SENSOR_DATA.keep_last(2).into());
    assert_eq!((d.direction, d.qos), (Direction::In, QosProfile::LATCHED.into()));
}

#[test]
fn a_recording_is_cdr_unless_the_file_names_another_encoding() {
    assert_eq!(parse(ROBOT).unwrap().record.options.encoding, Encoding::Cdr);
    let record = |name: &str| format!("{ROBOT}[record]\nencoding = \"{name}\"");
    for encoding in Encoding::ALL {
        assert_eq!(parse(&record(encoding.as_str())).unwrap().record.options.encoding, encoding);
    }
    let problem = problem(&record("protobufs"));
    assert_eq!(problem, "robots/test.toml:6: unknown choice \"protobufs\", did you mean \"protobuf\"?");
}

#[test]
fn a_recording_is_mcap_unless_the_file_names_another_storage() {
    assert_eq!(parse(ROBOT).unwrap().record.options.writer.storage, StorageOptions::default());
    let record = |keys: &str| format!("{ROBOT}[record]\n{keys}");
    let fast =
        parse(&record("storage = \"mcap\"\npreset = \"fastwrite\"")).unwrap().record.options.writer.storage;
    assert_eq!(fast, StoragePreset::FastWrite.options().into());
    let message = problem(&record("preset = \"resilient\""));
    assert!(message.starts_with("robots/test.toml:6: unknown choice \"resilient\""), "{message}");
    let (compressed, encoded) = if cfg!(feature = "sqlite") {
        let storage =
            parse(&record("storage = \"sqlite3\"\npreset = \"none\"")).unwrap().record.options.writer.storage;
        assert_eq!(storage, StorageOptions::preset(Storage::Sqlite3, "none").unwrap());
        (
            ":7: the storage sqlite3 does not support compression",
            ":7: the storage sqlite3 does not support the encoding json",
        )
    } else {
        let not_built = ":6: this program writes no storage sqlite3, it is built without \"sqlite\"";
        (not_built, not_built)
    };
    let message = problem(&record("storage = \"sqlite3\"\ncompression = \"zstd\""));
    assert!(message.contains(compressed), "{message}");
    let message = problem(&record("storage = \"sqlite3\"\nencoding = \"json\""));
    assert!(message.contains(encoded), "{message}");
}

#[test]
fn the_log_goes_to_rosout_unless_the_file_says_otherwise() {
    assert!(parse(ROBOT).unwrap().expose.features.rosout);
    assert!(parse(&format!("{ROBOT}[expose]")).unwrap().expose.features.rosout);
    assert!(!parse(&format!("{ROBOT}[expose]\nrosout = false")).unwrap().expose.features.rosout);
    let wrong = problem(&format!("{ROBOT}[expose]\nrosout = \"no\""));
    assert!(wrong.contains(":6: expected true or false, found"), "{wrong}");
}

#[test]
fn time_is_the_machines_unless_it_is_published_or_followed() {
    let clock =
        |text: &str| parse(&format!("{ROBOT}[expose]\n{text}")).map(|file| file.expose.features.clock);
    let milliseconds = |number| ClockChoice::Publish(Duration::from_millis(number));
    assert_eq!(clock("").unwrap(), ClockChoice::Own);
    assert_eq!(clock("clock = \"publish\"").unwrap(), milliseconds(25));
    assert_eq!(clock("clock = { publish_hz = 100 }").unwrap(), milliseconds(10));
    assert_eq!(clock("clock = \"follow\"").unwrap(), ClockChoice::Follow);
    for (wrong, expected) in [
        ("clock = \"folow\"", ":6: unknown choice \"folow\", did you mean \"follow\"?"),
        ("clock = { publish_hz = 0 }", ":6: expected a rate per second from 0.1 to 1000"),
        ("clock = { hz = 1 }", ":6: clock needs \"publish_hz\""),
        ("diagnostics = 1", ":6: expected true or false"),
    ] {
        let problem = clock(wrong).err().unwrap().to_string();
        assert!(problem.contains(expected), "{problem}\n  should contain\n{expected}");
    }
    let mut file = parse(ROBOT).unwrap();
    file.set_from_argument("use_sim_time:=true").unwrap();
    assert_eq!(file.expose.features.clock, ClockChoice::Follow);
    file.set_from_argument("use_sim_time:=false").unwrap();
    assert_eq!(file.expose.features.clock, ClockChoice::Own);
    let wrong = file.set_from_argument("use_sim_time:=1").unwrap_err().to_string();
    assert!(wrong.contains("use_sim_time: expected true or false"), "{wrong}");
}

#[test]
fn files_in_settings_are_relative_to_the_robot_file() {
    let module = "[[module]]\nkind = \"robot_state_publisher\"\nsettings = { robot_description = ";
    let given = |value: &str| {
        let file = parse(&format!("{ROBOT}{module}{value} }}")).unwrap();
        let module = file.modules.last().unwrap();
        module.options().settings["robot_description"].clone()
    };
    assert_eq!(given("\"stick.urdf\""), SettingValue::Text("robots/stick.urdf".into()));
    assert_eq!(given("\"/stick.urdf\""), SettingValue::Text("/stick.urdf".into()));
    assert_eq!(given("\"<robot/>\\n\""), SettingValue::Text("<robot/>\n".into()), "a text");
}

fn launcher(text: &str) -> LauncherEntry {
    parse(&format!("{ROBOT}{text}")).unwrap().launcher
}

#[test]
fn a_launcher_says_on_which_cpus_and_how_its_threads_run() {
    let entry = launcher(
        "[launcher]\nkind = \"pool\"\nthreads = 2\ncpus = [0, 1]\npriority = 80\nspin = \"50us\"\nidle = \"spin\"",
    );
    assert_eq!(entry.choice, LauncherChoice::Pool(2.try_into().unwrap()));
    assert_eq!((entry.threads.cpus, entry.threads.fifo_priority), (vec![0, 1], Some(80)));
    assert_eq!((entry.threads.spin, entry.idle), (Spin::For(Duration::from_micros(50)), Idle::Spin));
    assert_eq!(entry.line, 5);
    for (text, spin) in [("never", Spin::Never), ("always", Spin::Always), ("auto", Spin::Auto)] {
        let entry = launcher(&format!("[launcher]\nkind = \"threads\"\nspin = \"{text}\""));
        assert_eq!((entry.choice, entry.threads.spin), (LauncherChoice::Threads, spin));
    }
    let inline = parse(
        "[robot]\nname = \"r\"\nlauncher = { kind = \"linear\", cpus = [1] }\n[[module]]\nkind = \"darwin_op\"",
    );
    assert_eq!(inline.unwrap().launcher.threads.cpus, [1]);
    let short = parse("[robot]\nname = \"r\"\nlauncher = \"threads\"\n[[module]]\nkind = \"darwin_op\"");
    assert_eq!(short.unwrap().launcher.choice, LauncherChoice::Threads);
}

#[test]
fn errors_in_a_launcher_contain_the_line() {
    let cases = [
        ("[launcher]\nthreads = 2", ":5: [launcher] needs \"kind\""),
        ("[launcher]\nkind = \"pol\"", ":6: unknown launcher \"pol\", did you mean \"pool\"?"),
        (
            "[launcher]\nkind = \"threads\"\nthreads = 2",
            ":7: only the launcher \"pool\" has a number of \"threads\"",
        ),
        ("[launcher]\nkind = \"pool\"\ncpus = [-1]", ":7: expected the number of a CPU, from 0, found -1"),
        ("[launcher]\nkind = \"pool\"\ncpus = []", ":7: expected the numbers of CPUs, found none"),
        (
            "[launcher]\nkind = \"pool\"\npriority = 100",
            ":7: expected a SCHED_FIFO priority from 1, the lowest, to 99",
        ),
        (
            "[launcher]\nkind = \"pool\"\nspin = \"alway\"",
            ":7: unknown choice \"alway\", did you mean \"always\"?",
        ),
        ("[launcher]\nkind = \"pool\"\nspin = \"50\"", ":7: \"50\" is not a time"),
        ("[launcher]\nkind = \"linear\"\nspin = \"never\"", ":7: \"spin\" is for the threads of"),
        ("[launcher]\nkind = \"pool\"\nidle = \"sleep\"", ":7: unknown choice \"sleep\""),
        (
            "[launcher]\nkind = \"pool\"\nprio = 3",
            ":7: [launcher] has no \"prio\", did you mean \"priority\"?",
        ),
    ];
    for (text, expected) in cases {
        let problem = problem(&format!("{ROBOT}{text}"));
        assert!(problem.contains(expected), "{problem}\n  should contain\n{expected}");
    }
    let twice = "[robot]\nname = \"r\"\nlauncher = \"pool\"\n[launcher]\nkind = \"pool\"\n[[module]]\nkind = \"darwin_op\"";
    assert!(problem(twice).contains(":4: the launcher is given here and in [robot]"));
}

fn options(text: &str) -> downbeat_executor::ModuleOptions {
    parse(&format!("{ROBOT}{text}")).unwrap().modules[0].options()
}

#[test]
fn a_module_says_when_it_runs_and_what_happens_after_a_panic() {
    let second = Duration::from_secs(1);
    let given = options("initial_state = \"inactive\"\ndeadline = \"20ms\"\ncpus = [1]\npriority = 7");
    assert_eq!(given.initial_state, LifecycleState::Inactive);
    assert_eq!(given.deadline, Some(Duration::from_millis(20)));
    assert_eq!((given.thread.cpus, given.thread.fifo_priority), (vec![1], Some(7)));
    for (text, restart) in [
        ("", Restart::Never),
        ("restart = \"never\"", Restart::Never),
        ("restart = \"always\"", Restart::Always { backoff: second }),
        ("restart = 2", Restart::Times { limit: 2, backoff: second }),
        (
            "restart = { times = 3, backoff = \"500ms\" }",
            Restart::Times { limit: 3, backoff: Duration::from_millis(500) },
        ),
        ("restart = { times = \"always\", backoff = \"1min\" }", Restart::Always { backoff: 60 * second }),
    ] {
        assert_eq!(options(text).restart, restart, "{text}");
    }
    for (text, synchrony) in [
        ("", Synchrony::Detached(crate::Kind::INBOX)),
        ("inbox = 3", Synchrony::Detached(Inbox::KeepLast(3.try_into().unwrap()))),
        ("synchrony = \"detached\"\ninbox = \"all\"", Synchrony::Detached(Inbox::KeepAll)),
        ("synchrony = \"when_due\"", Synchrony::WhenDue),
        ("synchrony = \"every_cycle\"", Synchrony::EveryCycle),
    ] {
        assert_eq!(options(text).synchrony, synchrony, "{text}");
    }
    let motion = format!("{ROBOT}[[module]]\nkind = \"stand_nod_wave\"\nsynchrony = \"detached\"");
    let motion = parse(&motion).unwrap().modules[1].options();
    assert_eq!(motion.synchrony, Synchrony::Detached(crate::Kind::INBOX));
}

#[test]
fn errors_in_a_module_contain_the_line() {
    let cases = [
        ("synchrony = \"detach\"", ":5: unknown choice \"detach\", did you mean \"detached\"?"),
        ("inbox = 0", ":5: expected a number of batches above 0, or \"all\", found 0"),
        ("synchrony = \"when_due\"\ninbox = 2", ":6: \"inbox\" needs synchrony = \"detached\""),
        ("synchrony = \"every_cycle\"\ncpus = [0]", ":6: \"cpus\" and \"priority\" of a module need"),
        ("priority = 0", ":5: expected a SCHED_FIFO priority"),
        ("initial_state = \"finalized\"", ":5: unknown choice \"finalized\""),
        ("initial_state = \"inactiv\"", ":5: unknown choice \"inactiv\", did you mean \"inactive\"?"),
        ("restart = 0", ":5: expected \"never\", \"always\", or how many times, found 0"),
        ("restart = \"alway\"", ":5: unknown choice \"alway\", did you mean \"always\"?"),
        ("restart = { backoff = \"1s\" }", ":5: restart needs \"times\""),
        (
            "restart = { times = 1, back_off = \"1s\" }",
            ":5: restart has no \"back_off\", did you mean \"backoff\"?",
        ),
        ("deadline = 20", ":5: expected a time with its unit, such as \"20ms\", found 20"),
        ("deadline = \"20\"", ":5: \"20\" is not a time; write 500ms"),
        ("deadline = \"5m\"", ":5: \"5m\" is not a time; write 5min for minutes, 5ms for milliseconds"),
        ("deadline = \"0ms\"", ":5: \"0ms\" is not a valid time: it must be above 0"),
        ("name = \"recorder\"", ":5: \"recorder\" is the name of a module that the program adds"),
        ("name = \"bridge\"", ":5: \"bridge\" is the name of a module that the program adds"),
    ];
    for (text, expected) in cases {
        let problem = problem(&format!("{ROBOT}{text}"));
        assert!(problem.contains(expected), "{problem}\n  should contain\n{expected}");
    }
}

#[test]
fn errors_contain_file_line_and_the_nearest_name() {
    let wrong_type = format!("{ROBOT}[expose]\nin = [{{ topic = \"x\", type = \"sensor_msgs/Imu\" }}]");
    let expected = "robots/test.toml:6: unknown topic type \"sensor_msgs/Imu\", \
                    did you mean \"sensor_msgs/msg/Imu\"?";
    assert_eq!(problem(&wrong_type), expected);
    let cases = [
        ("[robot]\nnmae = \"r\"", "test.toml:1: [robot] needs \"name\""),
        (
            "[robot]\nname = \"r\"\nluncher = \"pool\"",
            ":3: [robot] has no \"luncher\", did you mean \"launcher\"?",
        ),
        (
            "[robot]\nname = \"r\"\nlauncher = \"lineal\"",
            ":3: unknown launcher \"lineal\", did you mean \"linear\"?",
        ),
        (
            "[robot]\nname = \"r\"\nthreads = 0\nlauncher = \"pool\"",
            ":3: expected a whole number greater than 0",
        ),
        ("[robot]\nname = \"1r\"", ":2: \"1r\" is not a valid name"),
        (
            "[robot]\nname = \"r\"\n[[module]]\nkind = \"darwin\"",
            ":4: unknown kind of module \"darwin\", did you mean \"darwin_op\"?",
        ),
        (
            "[robot]\nname = \"r\"\n[[module]]\nkind = \"library\"\nsettings = { path = \"a.so\" }",
            ":5: \"path\" of a library is not a setting: it stands next to `kind`",
        ),
        ("[robot]\nname = r", ":2:"),
    ];
    for (text, expected) in cases {
        let problem = problem(text);
        assert!(problem.contains(expected), "{problem}\n  should contain\n{expected}");
    }
    let wrong_qos = format!("{ROBOT}[expose]\nout = [\n  {{ topic = \"x\", qos = \"sensor\" }}\n]");
    assert!(problem(&wrong_qos).contains(":7: unknown QoS preset \"sensor\", did you mean \"sensor_data\"?"));
    let mixed = "[robot]\nname = \"r\"\n[[module]]\nkind = \"darwin_op\"\nsettings.offsets = [1, \"a\"]";
    assert!(problem(mixed).contains(
        ":5: expected a list of numbers only, of texts only, or of booleans only, found [1, \"a\"]"
    ));
}

#[test]
fn an_unknown_kind_of_a_project_is_looked_for_in_its_program() {
    let files = [
        ("Cargo.toml", "[package]\nname = \"my_rover\"\n[dependencies]\ndownbeat = \"1\"\n"),
        ("robot.toml", "[robot]\nname = \"r\"\n[[module]]\nkind = \"patrol\"\n"),
    ];
    let folder = folder(&files);
    let read = RobotFile::read(&folder.path().join("robot.toml")).map(|_| ());
    let problem = read.unwrap_err().to_string();
    let expected = "unknown kind of module \"patrol\"; kinds of the project my_rover are in its own program: `cargo run --release -- run";
    assert!(problem.contains(expected), "{problem}");
}

/// A folder with these files.
fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in files {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    folder
}

const INCLUDED: &str = "[robot]\nname = \"player\"\n\n[[module]]\nname = \"mux\"\nkind = \"joint_command_mux\"\n\n\
     [[module]]\nname = \"hardware\"\nkind = \"darwin_op\"\nremap = { joint_states = \"/states\" }\nsettings = { port = \"unused\", board = \"cm740\" }\n";

#[test]
fn an_included_robot_is_in_its_namespace_with_settings_of_its_own() {
    let robot = "[robot]\nname = \"two\"\n\
         [[include]]\nrobot = \"player.toml\"\nnamespace = \"blue_1\"\nsettings = { hardware = { port = \"memory:blue_1\" } }\n\
         [[include]]\nrobot = \"player.toml\"\nnamespace = \"red/two\"\n";
    let folder = folder(&[("robot.toml", robot), ("player.toml", INCLUDED)]);
    let file = RobotFile::read(&folder.path().join("robot.toml")).unwrap();
    let names: Vec<_> = file.modules.iter().map(|module| module.name.as_str()).collect();
    assert_eq!(names, ["blue_1/mux", "blue_1/hardware", "red/two/mux", "red/two/hardware"]);
    let [_, blue, _, red] = file.modules.as_slice() else { panic!("four modules") };
    let port = |module: &ModuleEntry| module.options().settings["port"].clone();
    assert_eq!(port(blue), SettingValue::Text("memory:blue_1".to_owned()));
    assert_eq!(port(red), SettingValue::Text("unused".to_owned()));
    assert_eq!(blue.options().settings["board"], SettingValue::Text("cm740".to_owned()));
    assert_eq!(red.options().resolved("imu/data_raw"), "red/two/imu/data_raw");
    assert_eq!(red.options().resolved("joint_states"), "/states");
    let robot = file.build(downbeat_executor::Core::new()).unwrap();
    let topics: Vec<_> = robot.core.topics().map(|topic| topic.name.to_string()).collect();
    for topic in ["blue_1/joint_goals", "red/two/joint_goals", "states", "red/two/imu/data_raw"] {
        assert!(topics.iter().any(|known| known == topic), "{topic}: {topics:?}");
    }
}

#[test]
fn errors_of_an_included_robot_name_the_file_and_the_line_that_cause_them() {
    let include = |more: &str| {
        format!("[robot]\nname = \"two\"\n[[include]]\nrobot = \"player.toml\"\nnamespace = \"a\"\n{more}")
    };
    let problem = |robot: &str, included: &str| {
        let folder = folder(&[("robot.toml", robot), ("player.toml", included)]);
        let file = RobotFile::read(&folder.path().join("robot.toml"));
        let error = match file {
            Ok(file) => file.build(downbeat_executor::Core::new()).err().unwrap(),
            Err(error) => error,
        };
        error.to_string().replace(&format!("{}/", folder.path().display()), "")
    };
    let wrong = INCLUDED.replace("board = \"cm740\"", "bord = 1");
    assert!(
        problem(&include(""), &wrong).starts_with("player.toml:12: "),
        "{}",
        problem(&include(""), &wrong)
    );
    let given = "settings = { hardware = { bord = 1 } }";
    assert!(problem(&include(given), INCLUDED).starts_with("robot.toml:6: "));
    let unknown = "settings = { hardwear = { port = \"p\" } }";
    let unknown = problem(&include(unknown), INCLUDED);
    assert!(
        unknown.starts_with("robot.toml:6: ") && unknown.contains("did you mean \"hardware\"?"),
        "{unknown}"
    );
    let missing = problem(&include("").replace("player.toml", "nobody.toml"), INCLUDED);
    assert!(missing.starts_with("robot.toml:4: cannot read the robot file nobody.toml"), "{missing}");
    assert_eq!(
        problem(&include("").replace("\"a\"", "\"1 a\""), INCLUDED),
        "robot.toml:5: \"1 a\" is not a namespace; use letters, digits and _, with / between parts, such as \"blue_1\""
    );
    let itself = problem(&include("").replace("player.toml", "robot.toml"), INCLUDED);
    assert!(itself.ends_with("robot.toml includes itself"), "{itself}");
}
