//! A new user's environment, and what a program does in it.

use std::ffi::OsStr;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::{Context, ensure};

use crate::python;

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
        command
    }
}

/// What `downbeat run darwin_op` did for a subscriber of rclpy that was there before.
#[derive(Debug)]
pub(crate) struct Arrival {
    /// From the start of the program to the first joint state at the subscriber.
    pub(crate) first_joint_state: Duration,
    /// The most memory that the program had, in bytes, in its first second.
    pub(crate) memory: u64,
}

impl Arrival {
    /// Runs the robot with an installed program.
    pub(crate) fn of(program: &Path, home: &Home) -> anyhow::Result<Self> {
        let domain = test_machine::free_domain().to_string();
        let variables = [("ROS_DOMAIN_ID", domain.as_str()), ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")];
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/install/first_joint_state.py");
        let mut subscriber = Command::new(python::interpreter()?);
        subscriber.arg(script).arg("60").envs(variables).stdout(Stdio::piped());
        let mut subscriber = Ended(subscriber.spawn().context("cannot run Python")?);
        let output = subscriber.0.stdout.take().context("the subscriber has no output")?;
        let mut lines = BufReader::new(output).lines();
        let mut next = || lines.next().context("the subscriber ended")?.context("its output");
        ensure!(next()? == "ready", "the subscriber is not ready");
        let start = SystemTime::now().duration_since(UNIX_EPOCH)?;
        let mut robot = home.command(program);
        robot.args(["run", "darwin_op"]).envs(variables).stdout(Stdio::null());
        let robot = Ended(robot.spawn().with_context(|| program.display().to_string())?);
        let line = next().context("`downbeat run darwin_op` sent no joint state to rclpy")?;
        let (time, joints) = line.split_once(' ').context("the subscriber's line")?;
        ensure!(joints == "20", "a joint state of {joints} joints");
        let first_joint_state = Duration::from_secs_f64(time.parse()?).saturating_sub(start);
        std::thread::sleep(Duration::from_secs(1));
        Ok(Self { first_joint_state, memory: most_memory(robot.0.id())? })
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

/// A process that ends with this.
struct Ended(Child);

impl Drop for Ended {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
