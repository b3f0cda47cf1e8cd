//! Tests the pages for users: runs every command in `sh` blocks and transcripts, and reads every robot file,
//! description of servos and world file in `toml` blocks. Rust snippets are compiled as documentation tests
//! (`src/lib.rs`).
//!
//! A `ros2` command is replaced by the `downbeat` command with the same arguments. The reader's home
//! directory is empty, and what each command takes is kept in `target/first_hour/steps`.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use common::new_user::NewUser;
use common::{Running, WATCHDOG, robot_file};
use downbeat::modules::humanoid::Humanoid;
use downbeat::modules::servo_bus::Description;
use downbeat::robot::RobotFile;

const PAGES: [&str; 25] = [
    "README.md",
    "docs/bags.md",
    "docs/compose.md",
    "docs/darwin_op.md",
    "docs/football.md",
    "docs/foxglove.md",
    "docs/install.md",
    "docs/libraries.md",
    "docs/log.md",
    "docs/ros2_commands.md",
    "docs/running_robot.md",
    "docs/messages.md",
    "docs/network.md",
    "docs/physics.md",
    "docs/px4.md",
    "docs/robot_files.md",
    "docs/ros2_users.md",
    "docs/sensors.md",
    "docs/servos.md",
    "docs/state_machine.md",
    "docs/page.md",
    "docs/vision.md",
    "docs/walking.md",
    "docs/your_robot.md",
    "modules/README.md",
];

/// Commands that other tests run, or that change the machine.
const ELSEWHERE: [&str; 49] = [
    "cargo xtask",
    "cargo test",
    "cargo run --release --features physics -- run robots/darwin_op_physics.toml", // tests/physics.rs
    "cargo run --release --features physics,mujoco", // needs MuJoCo: the tests of downbeat-physics
    "cargo run --release --features football -- match robots/seeing_", // tests/football.rs
    "cargo run --release --features football -- match --processes", // tests/football_processes.rs
    "cargo run --release --features sensors",        // tests/sensors.rs
    "cargo run --release --features px4",            // tests/px4.rs, as the next five
    "ros2 topic pub -r 10 /setpoint_pose",
    "ros2 service call /arm ",
    "ros2 service call /offboard",
    "ros2 service call /land",
    "DOWNBEAT_PX4_RELEASE=1.15 downbeat topic echo",
    "downbeat vision calibrate",                    // tests/football.rs
    "downbeat bag replay robots/seeing_match.toml", // tests/football.rs
    "downbeat bag debug",                           // tests/bag_debug/, as the next two
    "downbeat bag replay bags/recordings/darwin_op_walk_simulated.toml bags/recordings/darwin_op_walk_simulated --with",
    "downbeat bag bisect",
    "downbeat top --plot", // tests/top.rs
    "downbeat doctor",     // tests/doctor.rs; some machines have problems
    "downbeat servo scan", // tests/servos.rs, as the next three
    "downbeat servo setup",
    "downbeat servo calibrate",
    "downbeat servo tune",
    "echo 1 | sudo",
    "c++ ", // tests/library.rs, as the next two
    "ros2 topic echo --once /out",
    "ros2 topic pub --once /in",
    "ros2 lifecycle set /head_", // tests/controllers.rs, as the next one
    "ros2 topic pub --once /head_by_hand",
    "cargo run --release --features mqtt", // docs/network.md is read with the feature
    "pip install",
    "cargo install", // cargo xtask crates
    "colcon ",       // cargo xtask colcon, as the next four
    "ros2 run downbeat ",
    "ros2 launch ",
    "git clone",
    "mkdir -p ros_ws",
    ". ",
    "python3 -m venv",
    "sha256sum ", // cargo xtask dist --test, as the next two
    "tar ",
    "export PATH",
    "apt install",
    "systemctl ",
    "journalctl ",
    "cd ",
    "sudo ",
    "duckdb ",
];

/// Commands that run until they are interrupted.
const ENDLESS: [&[&str]; 12] = [
    &["run"],
    &["match"],
    &["emulate"],
    &["bag", "record", "-a"],
    &["bag", "play"],
    &["bag", "view"],
    &["compose"],
    &["topic", "echo"],
    &["topic", "hz"],
    &["topic", "bw"],
    &["topic", "delay"],
    &["topic", "pub"],
];

/// Commands that need a running robot.
const NEEDS_ROBOT: [&str; 10] =
    ["top", "trace", "expose", "topic", "node", "service", "param", "action", "lifecycle", "ros2"];

/// Words of commands that need the walking robot.
const WALKS: [&str; 6] = ["/cmd_vel", "/push", "/motions/", "/odom", "/simulator/", "gait"];

/// A servo that was never configured.
const NEW_SERVO: &str = r#"
name = "new"
[[bus]]
name = "bus"
port = "unused"
baud = 1_000_000
protocol = "feetech_sts"
cycle_ms = 10
[[joint]]
name = "joint"
id = 1
model = "STS3215"
limits = [-1.0, 1.0]
"#;

struct Block {
    page: &'static str,
    line: usize,
    language: String,
    text: String,
}

fn blocks() -> Vec<Block> {
    let mut blocks = Vec::new();
    for page in PAGES {
        let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(page)).unwrap();
        let mut open: Option<Block> = None;
        for (number, line) in (1..).zip(text.lines()) {
            match (line.strip_prefix("```"), &mut open) {
                (Some(language), None) => {
                    let language = language.to_owned();
                    open = Some(Block { page, line: number, language, text: String::new() });
                }
                (Some(_), Some(_)) => blocks.extend(open.take()),
                (None, Some(block)) => {
                    block.text.push_str(line);
                    block.text.push('\n');
                }
                (None, None) => {}
            }
        }
        assert!(open.is_none(), "{page}: a block is not closed");
    }
    blocks
}

/// The commands of the pages with their places.
fn commands() -> Vec<(String, String)> {
    let mut commands = Vec::new();
    for block in blocks() {
        let place = format!("{}:{}", block.page, block.line);
        let joined = block.text.replace("\\\n", "");
        let lines = joined.lines().filter_map(|line| match block.language.as_str() {
            "sh" => Some(line),
            // A transcript.
            "" | "text" | "console" => line.strip_prefix("$ "),
            _ => None,
        });
        let lines = lines.filter(|line| !line.trim().is_empty() && !line.starts_with('#'));
        commands.extend(lines.map(|line| (place.clone(), line.trim().to_owned())));
    }
    commands
}

#[test]
fn every_robot_file_on_a_page_is_read() {
    let mut read = 0;
    for Block { page, line, text, .. } in blocks().into_iter().filter(|block| block.language == "toml") {
        if text.contains("[dependencies]") || text.contains("[package]") {
            continue;
        }
        if text.contains("[[bus]]") || text.contains("[[joint]]") || text.contains("[[device]]") {
            let bus = NEW_SERVO.split("[[joint]]").next().unwrap().replace("feetech_sts", "dynamixel2");
            let whole = if text.contains("[[bus]]") { text } else { bus + text.as_str() };
            Description::parse("description", &whole)
                .map_err(|error| format!("{page}:{line}: {error}"))
                .unwrap();
            continue;
        }
        if text.contains("[stand_degrees]") {
            let folder = tempfile::tempdir().unwrap();
            let urdf = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots/op3.urdf");
            std::fs::copy(urdf, folder.path().join("my_humanoid.urdf")).unwrap();
            let file = folder.path().join("my_humanoid.toml");
            std::fs::write(&file, text).unwrap();
            Humanoid::read(file.to_str().unwrap())
                .map_err(|error| format!("{page}:{line}: {error}"))
                .unwrap();
            continue;
        }
        if text.contains("[[picture]]") {
            continue; // tests/football.rs
        }
        if text.contains("[floor]") {
            #[cfg(feature = "physics")]
            downbeat_physics::WorldFile::parse(&text, "world")
                .map_err(|error| format!("{page}:{line}: {error}"))
                .unwrap();
            continue;
        }
        let is_left_out = match page {
            "docs/network.md" => !cfg!(all(feature = "leagues", feature = "mqtt")),
            "docs/px4.md" => !cfg!(feature = "px4"),
            "docs/sensors.md" => !cfg!(feature = "sensors"),
            "docs/state_machine.md" => !cfg!(feature = "state_machine"),
            "docs/vision.md" => !cfg!(feature = "football"),
            _ => false,
        };
        if is_left_out {
            continue;
        }
        let folder = tempfile::tempdir().unwrap();
        let mut file = String::new();
        if !text.contains("[robot]") {
            file.push_str("[robot]\nname = \"robot\"\n");
        }
        file.push_str(&text);
        if !text.contains("[[module]]") {
            file.push_str("\n[[module]]\nkind = \"stand_nod_wave\"\n");
        }
        std::fs::write(folder.path().join("params.yaml"), "/**:\n  ros__parameters: {}\n").unwrap();
        // The file that `[[include]]` names.
        let included = "[robot]\nname = \"player\"\n[[module]]\nname = \"hardware\"\nkind = \"darwin_op\"\n";
        std::fs::create_dir(folder.path().join("football")).unwrap();
        std::fs::write(folder.path().join("football/player.toml"), included).unwrap();
        // The folder that `interfaces` names.
        let services = folder.path().join("src/site_msgs/srv");
        std::fs::create_dir_all(&services).unwrap();
        std::fs::write(services.join("Level.srv"), "float64 angle\n---\nbool is_level\n").unwrap();
        let path = folder.path().join("robot.toml");
        std::fs::write(&path, file).unwrap();
        RobotFile::read(&path).map_err(|error| format!("{page}:{line}: {error}")).unwrap();
        read += 1;
    }
    assert!(read >= 5, "only {read} robot files were found");
}

#[test]
fn the_robot_on_the_page_about_robots_runs() {
    let folder = tempfile::tempdir().unwrap();
    let page = || blocks().into_iter().filter(|block| block.page == "docs/your_robot.md");
    let written = |name: &str, part: &str| {
        let block = page().find(|block| block.language == "toml" && block.text.contains(part)).unwrap();
        std::fs::write(folder.path().join(name), block.text).unwrap();
    };
    written("robot_servos.toml", "[[bus]]");
    written("robot.toml", "[robot]");
    let robot = folder.path().join("robot.toml");
    let output = common::text_of(&["run", robot.to_str().unwrap(), "--fast", "--duration", "2s"]);
    assert!(!output.contains("WARN") && !output.contains("ERROR"), "{output}");
}

#[test]
fn the_names_of_robotis_can_be_exposed() {
    let folder = tempfile::tempdir().unwrap();
    let is_page = |block: &Block| block.page == "docs/darwin_op.md" && block.text.contains("/robotis/");
    let block = blocks().into_iter().find(is_page).unwrap();
    let robot = robot_file(folder.path(), |text| {
        let modules = text.split("[expose]").next().unwrap();
        format!("{modules}\n[[module]]\nkind = \"imu_filter\"\n{}", block.text)
    });
    let checked = common::text_of(&["check", robot.to_str().unwrap()]);
    for name in ["present_joint_states", "goal_joint_states", "open_cr/imu", "set_joint_states"] {
        assert!(checked.contains(&format!("/robotis/{name}")), "{name}: {checked}");
    }
}

#[test]
fn every_command_on_a_page_runs() {
    let mut place = Place::new();
    // The running robot, and whether it is the walking one.
    let mut robot: Option<(bool, Running)> = None;
    let mut servo: Option<Running> = None;
    let mut done = BTreeSet::new();
    let mut problems = Vec::new();
    for (page, command) in commands() {
        if ELSEWHERE.iter().any(|known| command.starts_with(known)) || !done.insert(command.clone()) {
            continue;
        }
        let built_with = command.strip_prefix("cargo run --release ").and_then(|rest| rest.split_once("-- "));
        let (features, rewritten) = match built_with {
            Some((features, arguments)) => (features, format!("downbeat {arguments}")),
            None => ("", command.clone()),
        };
        if features.contains("physics") && !cfg!(feature = "physics")
            || features.contains("football") && !cfg!(feature = "football")
        {
            continue;
        }
        let rewritten = rewritten
            .replace("ros2 ", "downbeat ")
            .replace("/tmp/robot", place.folder.join("emulated").to_str().unwrap())
            .replace("/tmp/arm", place.folder.join("arm").to_str().unwrap());
        let walks = WALKS.iter().any(|part| command.contains(part));
        if walks && !cfg!(feature = "physics") {
            continue;
        }
        let rewritten = if command.starts_with("downbeat servo ") {
            servo.get_or_insert_with(|| place.start_servo());
            // Answers may be late on a busy machine.
            rewritten.replace("/dev/ttyUSB0", "ttyUSB0 --timeout-ms 200")
        } else {
            rewritten
        };
        let words: Vec<&str> =
            rewritten.split_whitespace().skip_while(|word| *word != "downbeat").skip(1).collect();
        let Some(first) = words.first() else {
            problems.push(format!("{page}: no test runs `{command}`"));
            continue;
        };
        if rewritten.starts_with("downbeat new") {
            continue; // tests/first_hour.rs
        }
        if command.contains("old_db3_bag") {
            continue; // needs the feature `sqlite`: bags/tests/bags/sqlite.rs
        }
        let needs_robot = NEEDS_ROBOT.contains(first) || command.starts_with("ros2 ") || words == ["graph"];
        if let Some((_, mut robot)) = robot.take_if(|(is_walking, _)| !needs_robot || *is_walking != walks) {
            robot.interrupt();
        }
        if needs_robot && robot.is_none() {
            robot = Some((walks, place.start_robot(walks)));
        }
        place.prepare_for(&words);
        let began = Instant::now();
        problems.extend(place.run(&page, &command, &rewritten, &words));
        place.user.has_done(&page, &command, began.elapsed().as_secs_f64(), Vec::new());
    }
    for mut running in robot.into_iter().map(|(_, robot)| robot).chain(servo) {
        running.interrupt();
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
    assert!(done.len() > 20, "only {} commands were found", done.len());
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().flatten() {
        if entry.path().is_dir() {
            copy(&entry.path(), &to.join(entry.file_name()));
        } else {
            std::fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
        }
    }
}

/// A folder with the files that the commands of the pages name.
struct Place {
    folder: PathBuf,
    _temporary: tempfile::TempDir,
    user: NewUser,
}

impl Place {
    fn new() -> Self {
        let temporary = tempfile::tempdir().unwrap();
        let folder = temporary.path().to_owned();
        copy(&Path::new(env!("CARGO_MANIFEST_DIR")).join("robots"), &folder.join("robots"));
        // One page changes the exposed endpoints with this service, another one switches the torque.
        let exposed = "[expose]\nexpose_service = true\nservices = [\"torque\"]\n";
        let demo = robot_file(&folder, |text| text.replace("[expose]\n", exposed));
        std::fs::write(folder.join("new_servo.toml"), NEW_SERVO).unwrap();
        std::fs::rename(demo, folder.join("robots/darwin_op.toml")).unwrap();
        // It says at once what it exposes.
        let robot = format!("{}\n[expose]\nout = [\"motion/joint_commands\"]\n", common::QUIET_ROBOT);
        std::fs::write(folder.join("robot.toml"), robot).unwrap();
        let user = NewUser::new("pages", &folder.join("home"));
        Self { folder, _temporary: temporary, user }
    }

    fn command(&self) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_downbeat"));
        self.user.settle(command.current_dir(&self.folder));
        command
    }

    fn start_robot(&self, walks: bool) -> Running {
        let walking = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/darwin_op_walks.toml");
        let file = if walks { walking } else { "robots/darwin_op.toml" };
        let robot = Running::start_by(self.command().args(["run", file]));
        robot.wait_for_output("exposed to ROS 2: /joint_states");
        let is_seen = || self.command().args(["top", "--once"]).output().unwrap().status.success();
        common::wait_until("the robot can be inspected", is_seen);
        robot
    }

    /// Starts an emulated servo at `ttyUSB0`.
    fn start_servo(&self) -> Running {
        let port = self.folder.join("ttyUSB0");
        let emulate = ["emulate", "servos", "new_servo.toml", "--link", "ttyUSB0"];
        let servo = Running::start_by(self.command().args(emulate));
        common::wait_until("the emulated servo is there", || port.exists());
        servo
    }

    /// Creates the bags that a command reads, and removes existing outputs.
    fn prepare_for(&self, words: &[&str]) {
        for (position, word) in words.iter().enumerate() {
            let is_output = position > 0 && ["-o", "--output", "--record"].contains(&words[position - 1]);
            let path = self.folder.join(word);
            if is_output && path.exists() {
                if path.is_dir() {
                    std::fs::remove_dir_all(path).unwrap()
                } else {
                    std::fs::remove_file(path).unwrap()
                }
            } else if !is_output && *word == "two" && !path.exists() {
                // A copy of the same run, so that `bag diff` finds no difference.
                std::fs::create_dir(&path).unwrap();
                for file in std::fs::read_dir(self.folder.join("one")).unwrap() {
                    let file = file.unwrap();
                    std::fs::copy(file.path(), path.join(file.file_name())).unwrap();
                }
            } else if !is_output && ["my_run", "one", "killed"].contains(word) && !path.exists() {
                let mut record = self.command();
                record.args(["run", "robots/darwin_op.toml", "--duration", "3s", "--record", word]);
                let output = record.output().unwrap();
                assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
                if *word == "killed" {
                    let file = path.join("killed_0.mcap");
                    let bytes = std::fs::read(&file).unwrap();
                    std::fs::write(&file, &bytes[..bytes.len() / 2]).unwrap();
                }
            }
        }
    }

    /// Runs a command in a shell, as a reader of the page would. Returns the problem, if any.
    fn run(&self, page: &str, command: &str, rewritten: &str, words: &[&str]) -> Option<String> {
        let mut shell = Command::new("sh");
        shell.args(["-c", &format!("exec {}", rewritten.trim_start_matches("exec "))]);
        if rewritten.contains(['|', ';']) || !rewritten.starts_with("downbeat") {
            shell = Command::new("sh");
            shell.args(["-c", rewritten]);
        }
        self.user.settle(shell.current_dir(&self.folder).stdin(Stdio::null()));
        let ends = |word: &&&str| ["--duration", "--once", "-1", "--into"].contains(*word);
        let is_endless =
            ENDLESS.iter().any(|begin| words.starts_with(begin)) && words.iter().find(ends).is_none();
        let mut running = Running::start_by(&mut shell);
        if is_endless {
            let started = Instant::now();
            while running.output().is_empty() && running.is_running() {
                assert!(started.elapsed() < WATCHDOG, "{page}: `{command}` prints nothing");
                std::thread::sleep(Duration::from_millis(20));
            }
            if running.is_running() {
                running.signal("-INT");
            }
        }
        let started = Instant::now();
        while running.is_running() && started.elapsed() < WATCHDOG / 2 {
            std::thread::sleep(Duration::from_millis(5));
        }
        if running.is_running() {
            running.signal("-INT");
            running.wait();
            return Some(format!("{page}: `{command}` does not end:\n{}", running.output()));
        }
        let status = running.wait();
        let output = running.output();
        // A page may also show an error, which its text explains.
        let shown = ["cannot decode CDR", "the replay differs from the bag in"];
        let is_expected = status.success() || shown.iter().any(|error| output.contains(error));
        let is_well = is_expected && !output.contains("panicked");
        (!is_well).then(|| format!("{page}: `{command}` ends with {status}:\n{output}"))
    }
}
