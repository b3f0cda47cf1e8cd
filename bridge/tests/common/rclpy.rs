//! A real rclpy, or a real Cyclone DDS, in a process of its own.
#![allow(dead_code, clippy::unwrap_used, clippy::missing_panics_doc)]

use super::WATCHDOG;
use serde_json::{Value, json};
use std::ffi::{OsStr, OsString};
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};
use test_machine::interpreter;

/// A node of rclpy, or a participant of Cyclone DDS, that obeys commands. Its process ends with the value.
pub struct Peer {
    child: Child,
    commands: Option<ChildStdin>,
    answers: Receiver<Value>,
}

impl Peer {
    /// Starts node `/peer` of rclpy in a domain, or says why not and returns nothing.
    pub fn start(domain_id: u16, discovery_range: &str) -> Option<Self> {
        Self::of_domain(super::PEER_SCRIPT, domain_id, discovery_range)
    }

    /// Starts node `/peer` of the rclpy of Kilted in a domain on loopback, or says why not and returns
    /// nothing.
    pub fn kilted(domain_id: u16) -> Option<Self> {
        let python = interpreter("DOWNBEAT_KILTED_PYTHON")?;
        Some(Self::run(&mut of_domain(&python, super::PEER_SCRIPT, domain_id, "LOCALHOST")))
    }

    /// Starts a participant of Cyclone DDS in a domain on loopback, or says why not and returns nothing.
    pub fn cyclonedds(domain_id: u16) -> Option<Self> {
        Self::of_domain(super::CYCLONEDDS_SCRIPT, domain_id, "LOCALHOST")
    }

    /// Starts node `/peer` of rclpy by a command that runs the Python it is given; by itself it has no
    /// arguments yet.
    pub fn start_by(command: impl FnOnce(&OsStr) -> Command) -> Option<Self> {
        let python = python()?;
        Some(Self::run(command(&python).arg(super::PEER_SCRIPT).arg("peer")))
    }

    /// Starts a participant of Cyclone DDS by a command that runs the Python it is given.
    pub fn cyclonedds_by(command: impl FnOnce(&OsStr) -> Command) -> Option<Self> {
        let python = python()?;
        Some(Self::run(command(&python).arg(super::CYCLONEDDS_SCRIPT).arg("peer")))
    }

    fn of_domain(script: &str, domain_id: u16, discovery_range: &str) -> Option<Self> {
        Some(Self::run(&mut of_domain(&python()?, script, domain_id, discovery_range)))
    }

    /// Starts a program that obeys the commands of such a peer.
    pub fn run(command: &mut Command) -> Self {
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let output = BufReader::new(child.stdout.take().unwrap());
        let (sender, answers) = channel();
        std::thread::spawn(move || {
            // A test program that obeys commands prints other lines too.
            let lines = output.lines().map_while(Result::ok);
            for answer in lines.filter_map(|line| serde_json::from_str(&line).ok()) {
                if sender.send(answer).is_err() {
                    return;
                }
            }
        });
        let peer = Self { commands: child.stdin.take(), child, answers };
        assert_eq!(peer.answer(), json!("ready"));
        peer
    }

    /// Sends a command and returns its answer.
    pub fn ask(&mut self, command: Value) -> Value {
        self.send(command);
        self.answer()
    }

    /// Sends a command whose answer is taken with [`Peer::answer`].
    pub fn send(&mut self, command: Value) {
        writeln!(self.commands.as_mut().unwrap(), "{command}").unwrap();
    }

    /// The next messages on a topic, as many as `count`.
    pub fn take(&mut self, topic: &str, count: usize) -> Vec<Value> {
        let mut taken = Vec::new();
        super::wait_until("rclpy received the messages", || {
            let more = self.ask(json!({"do": "take", "topic": topic}));
            taken.extend(more.as_array().unwrap().iter().cloned());
            taken.len() >= count
        });
        taken
    }

    /// Sends its process a signal, as `kill` names it.
    pub fn signal(&self, signal: &str) {
        let status = Command::new("kill").arg(signal).arg(self.child.id().to_string()).status().unwrap();
        assert!(status.success());
    }

    /// Ends the node as a user's program ends.
    pub fn leave(mut self) {
        drop(self.commands.take());
        let start = Instant::now();
        while self.child.try_wait().unwrap().is_none() {
            assert!(start.elapsed() < WATCHDOG, "rclpy does not end");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// The answer to a command that was sent.
    pub fn answer(&self) -> Value {
        self.answers.recv_timeout(WATCHDOG).expect("an answer of the peer within the watchdog time")
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // It may have ended already; nothing to do then.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The interpreter that has rclpy. If there is none, reports a skipped test and returns `None`.
pub fn python() -> Option<OsString> {
    interpreter("DOWNBEAT_PYTHON")
}

fn of_domain(python: &OsStr, script: &str, domain_id: u16, discovery_range: &str) -> Command {
    let mut command = Command::new(python);
    command
        .arg(script)
        .arg("peer")
        .env("ROS_DOMAIN_ID", domain_id.to_string())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", discovery_range);
    command
}
