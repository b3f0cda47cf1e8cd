//! A new user's environment, and what a program does in it.

use std::ffi::OsStr;
use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::{Context, bail, ensure};

use crate::steps::{run, workspace};
use crate::{node, python};

/// An empty home outside of the checkout, which is removed when this is dropped.
pub(crate) struct Home(tempfile::TempDir);

impl Home {
    pub(crate) fn new() -> anyhow::Result<Self> {
        Ok(Self(tempfile::Builder::new().prefix("new_user").tempdir()?))
    }

    pub(crate) fn path(&self) -> &Path {
        self.0.path()
    }

    /// A command of the user: in her home, with little of the environment of this process.
    pub(crate) fn command(&self, program: impl AsRef<OsStr>) -> Command {
        let mut command = Command::new(program);
        command.env_clear().env("HOME", self.path()).current_dir(self.path());
        for kept in ["PATH", "RUSTUP_HOME", "RUSTUP_TOOLCHAIN", "SSL_CERT_FILE", "LANG"] {
            if let Some(value) = std::env::var_os(kept) {
                command.env(kept, value);
            }
        }
        // Cargo runs this program with it; without it, rustup would install a toolchain in her home.
        if let (None, Some(home)) = (std::env::var_os("RUSTUP_HOME"), std::env::home_dir()) {
            command.env("RUSTUP_HOME", home.join(".rustup"));
        }
        command
    }
}

/// What a robot did for a subscriber of rclpy that was there before.
#[derive(Debug)]
pub(crate) struct Arrival {
    /// From the start of the program to the first joint state at the subscriber.
    pub(crate) first_joint_state: Duration,
    /// The most memory that the program had, in bytes, in its first second.
    pub(crate) memory: u64,
}

impl Arrival {
    /// Runs the robot with a command that is an installed program.
    pub(crate) fn of(mut program: Command) -> anyhow::Result<Self> {
        Self::at("/joint_states", 20, program.args(["run", "darwin_op"]))
    }

    /// Runs a command that starts a robot, up to its first message on a topic of joint states, and interrupts
    /// it.
    pub(crate) fn at(topic: &str, joints: usize, robot: &mut Command) -> anyhow::Result<Self> {
        let domain = test_machine::free_domain().to_string();
        let variables = [("ROS_DOMAIN_ID", domain.as_str()), ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")];
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/install/first_joint_state.py");
        let mut subscriber = Command::new(python::interpreter()?);
        subscriber.arg(script).args(["60", topic]).envs(variables).stdout(Stdio::piped());
        let mut subscriber = Ended(subscriber.process_group(0).spawn().context("cannot run Python")?);
        let output = subscriber.0.stdout.take().context("the subscriber has no output")?;
        let mut lines = BufReader::new(output).lines();
        let mut next = || lines.next().context("the subscriber ended")?.context("its output");
        ensure!(next()? == "ready", "the subscriber is not ready");
        let start = SystemTime::now().duration_since(UNIX_EPOCH)?;
        robot.envs(variables).stdout(Stdio::null()).process_group(0);
        let mut running = Ended(robot.spawn().with_context(|| format!("cannot run {robot:?}"))?);
        let line = next().with_context(|| format!("{robot:?} sent nothing on {topic} to rclpy"))?;
        let (time, found) = line.split_once(' ').context("the subscriber's line")?;
        ensure!(found.parse() == Ok(joints), "a joint state of {found} joints on {topic}");
        let first_joint_state = Duration::from_secs_f64(time.parse()?).saturating_sub(start);
        std::thread::sleep(Duration::from_secs(1));
        let memory = most_memory(running.0.id())?;
        running.interrupt().with_context(|| format!("{robot:?}, interrupted"))?;
        Ok(Self { first_joint_state, memory })
    }
}

/// Runs the robot with a command that is an installed program and looks at it in a browser: from the start of
/// the program until the robot moves there.
pub(crate) fn first_look(mut robot: Command) -> anyhow::Result<Duration> {
    let modules = node::modules()?.context("Node.js is missing")?;
    let script = workspace().join("bridge/view/tests/page/first_look.mjs");
    let domain = test_machine::free_domain().to_string();
    robot.args(["run", "darwin_op", "--view=0"]).env("ROS_DOMAIN_ID", domain);
    robot
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .process_group(0);
    let start = Instant::now();
    let mut running = Ended(robot.spawn().with_context(|| format!("cannot run {robot:?}"))?);
    let printed = running.0.stderr.take().context("the robot has no standard error")?;
    let mut lines = BufReader::new(printed).lines();
    let page = lines.find_map(|line| Some(line.ok()?.strip_prefix("open in a browser: ")?.to_owned()));
    let page = page.context("it prints no address")?;
    // Nobody else reads what it prints.
    let rest = std::thread::spawn(move || lines.for_each(drop));
    let mut browser = Command::new("node");
    browser.arg(script).env("DOWNBEAT_PAGE", page).env("DOWNBEAT_NODE_MODULES", modules);
    let chromium =
        std::env::var_os("DOWNBEAT_CHROMIUM").unwrap_or_else(|| OsStr::new("/usr/bin/chromium").to_owned());
    run(browser.env("DOWNBEAT_CHROMIUM", chromium))?;
    let seen = start.elapsed();
    running.interrupt()?;
    rest.join().map_err(|_| anyhow::anyhow!("what reads the robot's output has panicked"))?;
    Ok(seen)
}

/// What a way of installing costs.
pub(crate) struct Figures {
    pub(crate) install: Duration,
    /// On the disk, in bytes.
    pub(crate) size: u64,
    pub(crate) arrival: Arrival,
}

impl Figures {
    /// The line above those of [`print`](Self::print).
    pub(crate) fn print_header() {
        println!("{:<8}{:>12}{:>12}{:>20}{:>12}", "way", "install", "size", "first joint state", "memory");
    }

    pub(crate) fn print(&self, way: &str) {
        println!(
            "{way:<8}{:>10.1} s{:>9.1} MB{:>17} ms{:>9.1} MB",
            self.install.as_secs_f64(),
            self.size as f64 / 1e6,
            self.arrival.first_joint_state.as_millis(),
            self.arrival.memory as f64 / 1e6,
        );
    }
}

/// The largest resident size of a process so far, in bytes.
fn most_memory(process: u32) -> anyhow::Result<u64> {
    let path = PathBuf::from(format!("/proc/{process}/status"));
    let status = std::fs::read_to_string(&path).context("the robot ended")?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).context("no VmHWM")?;
    let kilobytes: u64 = line.trim().trim_end_matches(" kB").trim().parse()?;
    Ok(kilobytes * 1024)
}

/// A process that ends with this, with its group, which it leads.
struct Ended(Child);

impl Ended {
    /// Interrupts the process as Ctrl-C does, and waits until it ends.
    fn interrupt(&mut self) -> anyhow::Result<()> {
        let sent = Command::new("kill").args(["-INT", &self.0.id().to_string()]).status()?;
        ensure!(sent.success(), "kill failed: {sent}");
        let end = Instant::now() + Duration::from_secs(30);
        loop {
            match self.0.try_wait()? {
                Some(status) if status.success() => return Ok(()),
                Some(status) => bail!("it ended with {status}"),
                None if Instant::now() > end => bail!("it runs on"),
                None => std::thread::sleep(Duration::from_millis(20)),
            }
        }
    }
}

impl Drop for Ended {
    fn drop(&mut self) {
        if let Ok(None) = self.0.try_wait() {
            // A launcher has started the robot in its group.
            let _ = Command::new("kill").args(["-KILL", "--", &format!("-{}", self.0.id())]).status();
            let _ = self.0.wait();
        }
    }
}
