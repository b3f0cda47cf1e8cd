//! Extends a project that `downbeat new` creates, as a user does, and tests errors of the library in a user's
//! app. The projects as they are created are tested by `tests/first_hour.rs`.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use common::rclpy::Peer;
use common::{
    Running, open_with_stock_readers, output_of, own_domain, recorded_messages, text_of, wait_until,
};
use downbeat::executor::{Module, Publication, Setup, SetupError};
use downbeat::{App, AppError};
use serde_json::{Value, json};
use test_machine::free_domain;
use user_msgs::my_msgs::msg::Tilt;

/// The root of the repository, which is the checkout of the new projects.
const CHECKOUT: &str = env!("CARGO_MANIFEST_DIR");

/// A project outside the workspace.
struct Project {
    name: &'static str,
    folder: PathBuf,
}

impl Project {
    fn new(name: &'static str, arguments: &[&str]) -> Self {
        let folder = Path::new(CHECKOUT).join("target/newcomer").join(name);
        if folder.exists() {
            std::fs::remove_dir_all(&folder).unwrap();
        }
        text_of(&[&["new", folder.to_str().unwrap()], arguments].concat());
        Self { name, folder }
    }

    fn add(&self, file: &str, path: &str) {
        std::fs::copy(Path::new(CHECKOUT).join("tests/newcomer").join(file), self.folder.join(path)).unwrap();
    }

    /// Runs cargo offline and returns its output.
    fn cargo(&self, arguments: &[&str]) -> String {
        let mut command = Command::new(env!("CARGO"));
        let command = command.args(arguments).arg("--offline").current_dir(&self.folder).stdin(Stdio::null());
        let output = command.env("CARGO_TERM_COLOR", "never").output().unwrap();
        let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
        assert!(output.status.success(), "cargo {arguments:?}: {text}");
        text
    }

    /// The program that cargo built, limited to loopback.
    fn program(&self, arguments: &[&str]) -> Command {
        let target =
            std::env::var_os("CARGO_TARGET_DIR").map_or(Path::new(CHECKOUT).join("target"), PathBuf::from);
        let mut command = Command::new(Path::new(CHECKOUT).join(target).join("debug").join(self.name));
        command
            .args(arguments)
            .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            .env("ROS_DOMAIN_ID", own_domain().to_string())
            .env_remove("DOWNBEAT_LOG")
            .current_dir(&self.folder)
            .stdin(Stdio::null());
        command
    }

    /// Runs the program, which must succeed, and returns its output.
    fn text_of(&self, arguments: &[&str]) -> String {
        let output = self.program(arguments).output().unwrap();
        let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
        assert!(output.status.success(), "{arguments:?}: {text}");
        text
    }

    /// Runs the program, which must fail, and returns its error.
    fn error_of(&self, arguments: &[&str]) -> String {
        let output = self.program(arguments).output().unwrap();
        assert!(!output.status.success(), "{arguments:?}");
        [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat()
    }
}

#[test]
fn a_project_is_not_overwritten_and_its_name_is_checked() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("nao");
    let path = path.to_str().unwrap();
    text_of(&["new", path, "--git", "https://example.org/downbeat.git", "--rev", "1f2e3d"]);
    let manifest = Path::new(path).join("Cargo.toml");
    let text = std::fs::read_to_string(&manifest).unwrap();
    assert!(
        text.contains("downbeat = { git = \"https://example.org/downbeat.git\", rev = \"1f2e3d\" }"),
        "{text}"
    );
    std::fs::write(Path::new(path).join("notes"), "mine").unwrap();
    let cases: [(&[&str], &str); 4] = [
        (
            &["new", path],
            "exists already and is not empty; choose another name, or write into it with --force",
        ),
        (&["new", "my-robot"], "did you mean \"my_robot\"?"),
        (&["new", "std_msgs"], "did you mean \"my_std_msgs\"?"),
        (&["new", path, "--git", "https://example.org"], "--rev"),
    ];
    for (arguments, expected) in cases {
        let output = output_of(arguments);
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && message.contains(expected), "{arguments:?}: {message}");
    }
    text_of(&["new", path, "--force"]);
    assert!(std::fs::read_to_string(&manifest).unwrap().contains(CHECKOUT));
    assert!(Path::new(path).join("notes").exists());
}

/// Code shared by the program, projects and the wheel is compiled once only if their manifests agree.
#[test]
fn the_program_projects_and_the_wheel_have_the_same_features_and_profiles() {
    let table = |path: &str| -> toml::Table {
        std::fs::read_to_string(Path::new(CHECKOUT).join(path)).unwrap().parse().unwrap()
    };
    let names =
        |table: &toml::Table| table["features"].as_table().unwrap().keys().cloned().collect::<Vec<_>>();
    let [downbeat, start, program] =
        ["Cargo.toml", "start/Cargo.toml", "start/program/Cargo.toml"].map(table);
    assert_eq!(names(&start), names(&downbeat));
    assert_eq!(names(&program), names(&downbeat));
    let config = table("program/src/new/templates/shared/cargo_config.toml");
    assert_eq!(program["profile"], config["profile"]);
    for key in ["codegen-units", "strip", "package"] {
        assert_eq!(downbeat["profile"]["release"][key], config["profile"]["release"][key], "{key}");
    }
    let [mut python, wheel] = ["python/Cargo.toml", "start/program/wheel/Cargo.toml"].map(table);
    // A feature for the tests of the wheel only.
    python["features"].as_table_mut().unwrap().remove("as_tested");
    python["dependencies"].as_table_mut().unwrap().remove("shared-build");
    assert_eq!(python["features"], wheel["features"]);
    let packages =
        |table: &toml::Table| table["dependencies"].as_table().unwrap().keys().cloned().collect::<Vec<_>>();
    assert_eq!(packages(&python), packages(&wheel));
    let passed_on = std::fs::read_to_string(Path::new(CHECKOUT).join("start/src/main.rs")).unwrap();
    for name in names(&downbeat) {
        assert!(passed_on.contains(&format!("\"{name}\"")), "start/src/main.rs does not pass on {name}");
    }
}

/// The value of an entry of a list of objects.
fn entry<'a>(list: &'a Value, key: &str, name: &str) -> &'a Value {
    let found = list.as_array().unwrap().iter().find(|entry| entry[key] == name);
    found.unwrap_or_else(|| panic!("{name} in {list}"))
}

#[test]
fn a_users_device_and_messages_are_exposed_recorded_decoded_and_replayed() {
    let domain = free_domain();
    let robot = Project::new("grown_robot", &[]);
    robot.add("robot.rs", "src/main.rs");
    robot.add("sonar.rs", "src/sonar.rs");
    robot.add("robot.toml", "robot.toml");
    robot.cargo(&["build"]);

    let bag = robot.folder.join("bag");
    let run = ["run", "robot.toml", "--domain", &domain.to_string(), "--record", bag.to_str().unwrap()];
    let mut running = Running::start_by(&mut robot.program(&run));

    let heard = robot.text_of(&[
        "topic",
        "echo",
        "/sonar/echo",
        "--once",
        "--domain",
        &domain.to_string(),
        "--timeout",
        "60",
    ]);
    assert!(heard.contains("frame_id: sonar") && heard.contains("distance: "), "{heard}");
    if let Some(mut peer) = Peer::start(domain, "LOCALHOST") {
        let changed = json!({"sonar.speed": 331.5, "level_head.gain": 1.5});
        let parameters = |call: &str, argument: Value| json!({"do": "parameters", "node": "/grown_robot", "call": call, "argument": argument});
        let answer = peer.ask(parameters("set_parameters", changed));
        assert!(answer.to_string().matches("\"successful\":true").count() == 2, "{answer}");
        let answer = peer.ask(parameters("get_parameters", json!(["sonar.speed"])));
        assert!(answer.to_string().contains("331.5"), "{answer}");
        peer.leave();
    }
    let top = robot.text_of(&["top", "grown_robot", "--json"]);
    assert!(top.contains("\"sonar\"") && top.contains("\"sonar/echo\""), "{top}");
    wait_until("the robot has recorded enough", || recorded_messages(&bag, "/sonar/exchanges") > 30);
    running.interrupt();

    let bag = bag.to_str().unwrap();
    let information = robot.text_of(&["bag", "info", bag]);
    for wanted in ["sonar_msgs/msg/Exchange", "sonar_msgs/msg/Echo", "level_head_msgs/msg/HeadTilt"] {
        assert!(information.contains(wanted), "{information}");
    }
    open_with_stock_readers(Path::new(bag));

    let report = robot.text_of(&["bag", "replay", "robot.toml", bag, "--strict", "--json"]);
    let report: Value = serde_json::from_str(&report[report.find('{').unwrap()..]).unwrap();
    for topic in ["/sonar/exchanges", "/sonar/echo", "/head_tilt", "/joint_commands"] {
        let topic = entry(&report["topics"], "topic", topic);
        assert!(topic["compared"].as_u64() > Some(0) && topic["different"] == 0, "{topic}");
    }
    // The requests to the device differ from the recorded ones.
    let differs = robot.error_of(&["bag", "replay", "robot.toml", bag, "-p", "sonar.pulses:=2"]);
    assert!(differs.contains("/sonar/exchanges"), "{differs}");
}

/// Declares a topic but publishes nothing.
struct Silent;

impl Module for Silent {
    type Ports = Publication<Tilt>;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Publication<Tilt>, SetupError> {
        setup.publish("tilt")
    }
}

fn silent_robot(folder: &Path, name: &str) -> PathBuf {
    let path = folder.join(format!("{name}.toml"));
    let text = format!(
        "[robot]\nname = \"{name}\"\n\n[[module]]\nname = \"silent\"\nkind = \"silent\"\n\n[expose]\nout = [\"tilt\"]\n"
    );
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn two_kinds_with_one_name_are_refused_by_all_functions_of_the_app() {
    let app = App::new().kind("silent", "the first", || Silent).kind("silent", "the second", || Silent);
    let error = app.catalog().map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("there are two kinds of modules named \"silent\""), "{error}");
    assert!(matches!(app.robot_file("nowhere.toml"), Err(AppError::Catalog(_))));
    assert!(matches!(app.replay("nowhere.toml", "no/bag"), Err(AppError::Catalog(_))));
}

#[test]
fn an_exposed_topic_of_an_unregistered_type_is_an_error_that_names_the_line_to_add() {
    let folder = tempfile::tempdir().unwrap();
    let file = silent_robot(folder.path(), "unregistered");
    let app = App::new().kind("silent", "publishes nothing", || Silent);
    let error = app.start(&file).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("unregistered.toml:9:"), "{error}");
    assert!(error.contains("\"tilt\"") && error.contains(".interfaces(user_msgs::INTERFACES)"), "{error}");
}

#[test]
fn two_robots_run_in_one_process_and_stop_independently() {
    let folder = tempfile::tempdir().unwrap();
    let app = App::new().interfaces(user_msgs::INTERFACES).kind("silent", "publishes nothing", || Silent);
    let [first, second] = ["left", "right"].map(|name| app.start(silent_robot(folder.path(), name)).unwrap());
    let names = [&first, &second].map(|robot| robot.node().unwrap().node().name().to_string());
    assert_eq!(names, ["/left", "/right"]);
    first.stop().unwrap();
    assert!(!second.is_finished());
    let modules = second.core().modules().wait(common::WATCHDOG).unwrap();
    assert!(modules.iter().any(|module| &*module.name == "silent"));
    second.stop().unwrap();
}
