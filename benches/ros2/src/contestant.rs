//! The processes of a pair.

use std::io::{BufRead, BufReader, Lines};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;

use anyhow::{Context, bail};
use serde::de::DeserializeOwned;

use crate::role::{GO, Role};

/// The software that a contestant uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Kind {
    Downbeat,
    Rclpy,
    Cyclone,
}

impl Kind {
    pub fn name(self) -> &'static str {
        match self {
            Self::Downbeat => "downbeat",
            Self::Rclpy => "rclpy",
            Self::Cyclone => "Cyclone DDS, Python",
        }
    }
}

/// The work of a pair.
#[derive(Clone, Copy, Debug)]
pub struct Task {
    pub size: usize,
    pub window: usize,
    pub seconds: f64,
    pub domain_id: u16,
}

/// A running contestant; killed when dropped.
pub struct Contestant {
    process: Child,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Contestant {
    pub fn start(kind: Kind, role: Role, task: &Task) -> anyhow::Result<Self> {
        Self::start_with(kind, role, task, &[])
    }

    /// Like `start`, with options that only some contestants know.
    pub fn start_with(kind: Kind, role: Role, task: &Task, more: &[&str]) -> anyhow::Result<Self> {
        let mut command = match kind {
            Kind::Downbeat => {
                let mut command = Command::new(std::env::current_exe()?);
                command.arg("peer");
                command
            }
            Kind::Rclpy => python("rclpy_peer.py")?,
            Kind::Cyclone => python("cyclone_peer.py")?,
        };
        let role = clap::ValueEnum::to_possible_value(&role).context("a role has a name")?;
        command
            .args(["--role", role.get_name(), "--size", &task.size.to_string()])
            .args(more)
            .args(["--window", &task.window.to_string(), "--seconds", &task.seconds.to_string()])
            .env("ROS_DOMAIN_ID", task.domain_id.to_string())
            .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            .env("CYCLONEDDS_URI", CYCLONE_ON_THIS_MACHINE);
        Self::spawn(command, kind.name())
    }

    /// Starts a command whose input and output are like those of a contestant.
    pub fn spawn(mut command: Command, name: &str) -> anyhow::Result<Self> {
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut process = command.spawn().with_context(|| format!("cannot start {name}"))?;
        let stdout = process.stdout.take().context("its output is piped")?;
        Ok(Self { process, lines: BufReader::new(stdout).lines() })
    }

    /// Waits until the contestant has found its peer.
    pub fn wait_for_go(&mut self) -> anyhow::Result<()> {
        match self.line()? {
            line if line == GO => Ok(()),
            line => bail!("expected {GO:?}, found {line:?}"),
        }
    }

    pub fn outcome<T: DeserializeOwned>(&mut self) -> anyhow::Result<T> {
        let line = self.line()?;
        serde_json::from_str(&line).with_context(|| line)
    }

    fn line(&mut self) -> anyhow::Result<String> {
        Ok(self.lines.next().context("the contestant ended before it printed anything")??)
    }

    /// The processor time that the process has used so far.
    pub fn processor_time(&self) -> anyhow::Result<Duration> {
        processor_time(self.process.id())
    }

    /// The seconds that the threads of the process have run so far.
    pub fn on_processor(&self) -> anyhow::Result<f64> {
        on_processor(self.process.id())
    }

    /// The resident memory of the process in bytes.
    pub fn resident_bytes(&self) -> anyhow::Result<u64> {
        resident_bytes(self.process.id())
    }

    /// Closes the input of the process and returns the object that it then prints.
    pub fn result<T: DeserializeOwned>(&mut self) -> anyhow::Result<T> {
        drop(self.process.stdin.take());
        self.outcome()
    }

    /// Closes the input of the process and returns the number that it then prints.
    pub fn count(&mut self) -> anyhow::Result<u64> {
        drop(self.process.stdin.take());
        let line = self.line()?;
        line.parse().with_context(|| line)
    }

    /// Closes the input of the process, which ends it.
    pub fn end(mut self) -> anyhow::Result<()> {
        drop(self.process.stdin.take());
        let status = self.process.wait()?;
        anyhow::ensure!(status.success(), "the contestant ended with {status}");
        Ok(())
    }
}

impl Drop for Contestant {
    fn drop(&mut self) {
        // Fails only if the process has already ended.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Disables multicast, which rclpy does not receive on this interface.
pub const CYCLONE_ON_THIS_MACHINE: &str = "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name=\"lo\" \
    multicast=\"false\"/></Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery>\
    <ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>\
    <Peers><Peer address=\"127.0.0.1\"/></Peers></Discovery></Domain></CycloneDDS>";

/// The command that runs a Python program of this package with the interpreter that has rclpy and cyclonedds.
fn python(program: &str) -> anyhow::Result<Command> {
    let python = std::env::var_os("DOWNBEAT_PYTHON").context(
        "DOWNBEAT_PYTHON names no interpreter that has rclpy and cyclonedds; `cargo xtask test` makes target/venv/bin/python",
    )?;
    let mut command = Command::new(python);
    command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("python").join(program));
    Ok(command)
}

/// The user and system time of a process, with a resolution of 10 ms.
fn processor_time(process: u32) -> anyhow::Result<Duration> {
    const TICKS_PER_SECOND: u64 = 100; // USER_HZ of Linux
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat"))?;
    // The fields follow the name, which is in brackets and may contain anything.
    let (_, fields) = stat.rsplit_once(')').context("/proc/PID/stat has a name")?;
    let mut times = fields.split_ascii_whitespace().skip(11).map(str::parse::<u64>);
    let (user, system) = (times.next().context("user time")??, times.next().context("system time")??);
    Ok(Duration::from_millis((user + system) * 1000 / TICKS_PER_SECOND))
}

/// The seconds that the present threads of a process have run, to the nanosecond.
pub fn on_processor(process: u32) -> anyhow::Result<f64> {
    let mut nanoseconds = 0;
    for task in std::fs::read_dir(format!("/proc/{process}/task"))? {
        // A thread may have ended.
        let Ok(text) = std::fs::read_to_string(task?.path().join("schedstat")) else { continue };
        nanoseconds += text.split(' ').next().context("/proc/PID/task/TID/schedstat")?.parse::<u64>()?;
    }
    Ok(nanoseconds as f64 / 1e9)
}

/// The resident memory of a process.
pub fn resident_bytes(process: u32) -> anyhow::Result<u64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status"))?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).context("VmRSS")?;
    let kibibytes: u64 = line.trim().trim_end_matches("kB").trim().parse()?;
    Ok(kibibytes * 1024)
}
