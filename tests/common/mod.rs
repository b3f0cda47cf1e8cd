//! Helpers of the tests: the program in a separate process, robot files, and real rclpy.
#![allow(dead_code, clippy::unwrap_used, clippy::missing_panics_doc, missing_docs)]

pub mod browser;
#[path = "../../bridge/tests/common/hosts.rs"]
pub mod hosts;
#[path = "../../bridge/tests/common/matrix.rs"]
pub mod matrix;
pub mod new_user;
pub mod program;
#[path = "../../bridge/tests/common/rclpy.rs"]
pub mod rclpy;
#[path = "../../bags/tests/bags/stock_readers.rs"]
mod stock_readers;
pub mod typed;

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::{Arc, LazyLock, Mutex};
use std::time::{Duration, Instant};

use downbeat::bags::Reader;
use test_machine::free_domain;

/// A robot without a device: its behaviour depends only on its inputs and the time.
pub const QUIET_ROBOT: &str = r#"
[robot]
name = "quiet"

[[module]]
name = "motion"
kind = "stand_nod_wave"

[[module]]
name = "mux"
kind = "joint_command_mux"
"#;

/// Long enough for a busy machine.
pub const WATCHDOG: Duration = Duration::from_secs(60);

/// The program behind [`rclpy::Peer`].
pub const PEER_SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/bridge/tests/rclpy/peer.py");

/// The program behind [`rclpy::Peer::cyclonedds`].
pub const CYCLONEDDS_SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/bridge/tests/cyclonedds/peer.py");

/// Polls a condition for which there is no event.
pub fn wait_until(what: &str, mut condition: impl FnMut() -> bool) {
    let start = Instant::now();
    while !condition() {
        assert!(start.elapsed() < WATCHDOG, "gave up waiting until {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// The program with these arguments, limited to loopback, in a domain of this process.
pub fn downbeat(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_downbeat"));
    command
        .args(arguments)
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .env("ROS_DOMAIN_ID", own_domain().to_string())
        .env_remove("DOWNBEAT_LOG")
        .current_dir(env!("CARGO_MANIFEST_DIR"));
    command
}

/// The domain of programs to which a test gives no other.
pub fn own_domain() -> u16 {
    static DOMAIN: LazyLock<u16> = LazyLock::new(free_domain);
    *DOMAIN
}

/// Runs the program until it ends.
pub fn output_of(arguments: &[&str]) -> Output {
    downbeat(arguments).stdin(Stdio::null()).output().unwrap()
}

/// Runs the program, which must succeed, and returns its standard output and standard error.
pub fn text_of(arguments: &[&str]) -> String {
    let output = output_of(arguments);
    let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
    assert!(output.status.success(), "{arguments:?}: {text}");
    text
}

/// Records until the bag has `count` messages on a topic, however long that takes. Returns the output of the
/// program.
pub fn record_until(arguments: &[&str], bag: &Path, topic: &str, count: u64) -> String {
    let output = run_until_recorded(arguments, bag, topic, count);
    open_with_stock_readers(bag);
    output
}

/// The same of a bag in an encoding that the stock readers do not know.
pub fn run_until_recorded(arguments: &[&str], bag: &Path, topic: &str, count: u64) -> String {
    let mut recording = Running::start(arguments);
    let start = Instant::now();
    while recorded_messages(bag, topic) < count {
        assert!(
            start.elapsed() < WATCHDOG,
            "{count} messages of {topic} are not recorded:\n{}",
            recording.output()
        );
        assert!(recording.is_running(), "{}", recording.output());
        // Not more often: reading a growing bag takes processor time from the recorded robot.
        std::thread::sleep(Duration::from_millis(100));
    }
    recording.interrupt();
    recording.output()
}

/// Opens a bag with the readers that others wrote, which must find the messages that we find.
#[track_caller]
pub fn open_with_stock_readers(bag: &Path) {
    let folder = tempfile::tempdir().unwrap();
    std::os::unix::fs::symlink(bag, folder.path().join("bag")).unwrap();
    stock_readers::open_bags(folder.path());
}

/// Returns the number of messages on a topic of a bag, which may still be being written.
pub fn recorded_messages(bag: &Path, topic: &str) -> u64 {
    let Ok(reader) = Reader::open(bag) else { return 0 };
    reader.topic(topic).map_or(0, |topic| reader.topics()[topic.index()].message_count)
}

/// A running program, which is killed when dropped.
pub struct Running {
    child: Child,
    output: Arc<Mutex<String>>,
}

impl Running {
    pub fn start(arguments: &[&str]) -> Self {
        Self::start_with(arguments, &[])
    }

    /// Starts the program with environment variables.
    pub fn start_with(arguments: &[&str], variables: &[(&str, &Path)]) -> Self {
        Self::start_by(downbeat(arguments).envs(variables.iter().copied()))
    }

    pub fn start_by(command: &mut Command) -> Self {
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let output = Arc::default();
        collect(child.stdout.take().unwrap(), &output);
        collect(child.stderr.take().unwrap(), &output);
        Self { child, output }
    }

    /// Returns the output so far.
    pub fn output(&self) -> String {
        self.output.lock().unwrap().clone()
    }

    pub fn wait_for_output(&self, text: &str) {
        let start = Instant::now();
        while !self.output().contains(text) {
            assert!(
                start.elapsed() < WATCHDOG,
                "the program does not print {text:?}, but\n{}",
                self.output()
            );
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    pub fn is_running(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }

    pub fn signal(&self, signal: &str) {
        let status = Command::new("kill").arg(signal).arg(self.child.id().to_string()).status().unwrap();
        assert!(status.success());
    }

    /// Waits for the end of the process and of its output.
    pub fn wait(&mut self) -> ExitStatus {
        let mut status = None;
        wait_until("the program ends", || {
            status = self.child.try_wait().unwrap();
            status.is_some()
        });
        wait_until("its output ends", || Arc::strong_count(&self.output) == 1);
        status.unwrap()
    }

    /// Interrupts the program as Ctrl-C does and checks that it succeeds.
    pub fn interrupt(&mut self) {
        self.signal("-INT");
        assert!(self.wait().success(), "{}", self.output());
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // Fails only if the process has already ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
        if std::thread::panicking() {
            eprintln!("the program printed:\n{}", self.output());
        }
    }
}

fn collect(stream: impl std::io::Read + Send + 'static, output: &Arc<Mutex<String>>) {
    let output = Arc::clone(output);
    std::thread::spawn(move || {
        for line in BufReader::new(stream).lines().map_while(Result::ok) {
            let mut output = output.lock().unwrap();
            output.push_str(&line);
            output.push('\n');
        }
    });
}

/// Copies the robot file of the demo and gives it a separate port; `edit` changes the text further.
pub fn robot_file(folder: &Path, edit: impl Fn(String) -> String) -> PathBuf {
    let demo = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots/darwin_op.toml");
    let port = folder.join("port");
    let text = std::fs::read_to_string(demo).unwrap().replace("memory:darwin_op", port.to_str().unwrap());
    let path = folder.join("robot.toml");
    std::fs::write(&path, edit(text)).unwrap();
    path
}

/// Runs a program of `tests/python` and returns its output as JSON. If there is no Python, prints a message
/// and returns `None`.
pub fn python(program: &str, arguments: &[&Path]) -> Option<serde_json::Value> {
    let python = rclpy::python()?;
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python").join(program);
    let mut command = Command::new(python);
    command.arg(script).args(arguments).env("ROS_DOMAIN_ID", own_domain().to_string());
    let output = command.output().unwrap();
    assert!(output.status.success(), "{program}: {}", String::from_utf8_lossy(&output.stderr));
    Some(serde_json::from_slice(&output.stdout).unwrap())
}
