//! Hosts of their own: network namespaces of this machine, with a switch or a bad line between them.

use std::fmt::Display;
use std::io::{BufRead, BufReader};
use std::mem::ManuallyDrop;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};

const FORWARDER: &str = include_str!("forwarder.py");

/// What is between the hosts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line {
    /// A switch that nobody else is on.
    Good,
    /// As [`Cable::BAD`].
    Bad,
}

/// What a line does to frames, in each direction.
#[derive(Clone, Copy, Debug)]
pub struct Cable {
    pub delay_ms: f64,
    /// The share of the frames that are lost.
    pub loss: f64,
    /// Frames beyond it wait, and are lost when more than 256 kB wait.
    pub mbit_per_s: Option<f64>,
}

impl Cable {
    pub const BAD: Self = Self { delay_ms: 20.0, loss: 0.02, mbit_per_s: None };
}

/// A cable that is plugged in, until this is dropped.
pub struct Plugged(Child);

impl Drop for Plugged {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Hosts `10.77.0.1`, `10.77.0.2` and so on. They go when this is dropped.
pub struct Hosts {
    names: Vec<String>,
    switch: String,
    prefix: String,
    plugged: Option<Plugged>,
}

impl Hosts {
    const CABLE: &str = "cable";
    /// Tells a test that it runs on one of the hosts: how their names begin, and how many there are.
    const VARIABLE: &str = "DOWNBEAT_HOSTS";

    /// Makes two hosts on a switch, or says why not and returns nothing: only root may, and not on every
    /// machine.
    pub fn new() -> Option<Self> {
        Self::on(Line::Good)
    }

    /// The same, with a line to choose.
    pub fn on(line: Line) -> Option<Self> {
        let mut hosts = Self::made(2, line == Line::Bad)?;
        if line == Line::Bad {
            hosts.plugged = Some(hosts.plug(Cable::BAD));
        }
        Some(hosts)
    }

    /// Several hosts on a switch, of which host 1 is elsewhere, behind a cable that is not plugged in.
    pub fn with_a_far_one(count: usize) -> Option<Self> {
        Self::made(count, true)
    }

    fn made(count: usize, is_one_far: bool) -> Option<Self> {
        // Tests of one process may run side by side.
        static MADE: AtomicU32 = AtomicU32::new(0);
        let number = MADE.fetch_add(1, Ordering::Relaxed);
        let hosts = Self::of(&format!("downbeat_{}_{number}", std::process::id()), count);
        if !test_machine::has_program("ip") {
            test_machine::missing("ip", "Debian: the package iproute2");
            return None;
        }
        if let Err(error) = hosts.make(is_one_far) {
            test_machine::skipped(&format!("separate hosts need root and network namespaces: {error}"));
            return None;
        }
        Some(hosts)
    }

    fn of(prefix: &str, count: usize) -> Self {
        let of = |host: &dyn Display| format!("{prefix}_{host}");
        let names = (0..count).map(|host| of(&host)).collect();
        Self { names, switch: of(&"switch"), prefix: prefix.to_owned(), plugged: None }
    }

    /// The hosts, in a process that [`Hosts::run_again`] has started.
    pub fn around() -> Option<ManuallyDrop<Self>> {
        let variable = std::env::var(Self::VARIABLE).ok()?;
        let (prefix, count) = variable.rsplit_once(' ').unwrap();
        // They belong to the process that made them.
        Some(ManuallyDrop::new(Self::of(prefix, count.parse().unwrap())))
    }

    /// Runs a test of this program once more, on one of the hosts.
    pub fn run_again(&self, host: usize, test: &str) {
        let mut command = self.command(host, std::env::current_exe().unwrap());
        command.args(["--exact", test, "--nocapture", "--include-ignored"]);
        let variable = format!("{} {}", self.prefix, self.names.len());
        let status = command.env(Self::VARIABLE, variable).status().unwrap();
        assert!(status.success(), "{test} failed on its host");
    }

    fn make(&self, is_one_far: bool) -> Result<(), String> {
        let (switch, cable) = (&*self.switch, Self::CABLE);
        try_ip(&["netns", "add", switch])?;
        try_ip(&["-n", switch, "link", "add", "switch", "type", "bridge"])?;
        try_ip(&["-n", switch, "link", "set", "switch", "up"])?;
        if is_one_far {
            try_ip(&["-n", switch, "link", "add", "near", "type", "veth", "peer", "name", "near_end"])?;
            try_ip(&["-n", switch, "link", "set", "near", "master", "switch", "up"])?;
            try_ip(&["-n", switch, "link", "set", "near_end", "up"])?;
        }
        for (host, name) in self.names.iter().enumerate() {
            let (port, address) = (&*format!("port{host}"), &*format!("10.77.0.{}/24", host + 1));
            try_ip(&["netns", "add", name])?;
            try_ip(&[
                "-n", switch, "link", "add", port, "type", "veth", "peer", "name", cable, "netns", name,
            ])?;
            if is_one_far {
                // The forwarder takes frames as a cable does, not several in one.
                try_ip(&["-n", name, "link", "set", cable, "gso_max_segs", "1"])?;
            }
            if is_one_far && host == 1 {
                try_ip(&["-n", switch, "link", "set", port, "up"])?;
            } else {
                try_ip(&["-n", switch, "link", "set", port, "master", "switch", "up"])?;
            }
            try_ip(&["-n", name, "address", "add", address, "dev", cable])?;
            try_ip(&["-n", name, "link", "set", "lo", "up"])?;
            try_ip(&["-n", name, "link", "set", cable, "up"])?;
            try_ip(&["-n", name, "route", "add", "224.0.0.0/4", "dev", cable])?;
        }
        Ok(())
    }

    /// Connects the far host. To pull the cable loses what is on it; no host sees that its link is gone.
    pub fn plug(&self, cable: Cable) -> Plugged {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.switch, "python3", "-c", FORWARDER, "near_end", "port1"]);
        for (option, value) in [("--delay-ms", cable.delay_ms), ("--loss", cable.loss)] {
            command.args([option, &value.to_string()]);
        }
        if let Some(rate) = cable.mbit_per_s {
            command.args(["--mbit-per-s", &rate.to_string()]);
        }
        let mut plugged = Plugged(command.stdout(Stdio::piped()).spawn().unwrap());
        let mut line = String::new();
        let _ = BufReader::new(plugged.0.stdout.take().unwrap()).read_line(&mut line);
        assert_eq!(line.trim(), "ready", "the forwarder does not start");
        plugged
    }

    /// A command on one of the hosts. `ip` becomes the program, so that its process is the program's.
    pub fn command(&self, host: usize, program: impl AsRef<Path>) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.names[host]]).arg(program.as_ref());
        command.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET").env_remove("ROS_DOMAIN_ID");
        command
    }

    /// Takes away the way for multicast: what is sent to a group goes nowhere.
    pub fn without_multicast(&self) {
        for name in &self.names {
            ip(&["-n", name, "route", "delete", "224.0.0.0/4"]);
        }
    }

    /// Out of the switch: host 0 sees that its link is gone, host 1 only that nothing comes.
    pub fn pull_the_cable(&self) {
        ip(&["-n", &self.switch, "link", "set", "port0", "down"]);
    }

    pub fn put_the_cable_back(&self) {
        ip(&["-n", &self.switch, "link", "set", "port0", "up"]);
    }
}

impl Drop for Hosts {
    fn drop(&mut self) {
        self.plugged = None;
        for name in self.names.iter().chain([&self.switch]) {
            // Not all may have been made.
            let _ = try_ip(&["netns", "delete", name]);
        }
    }
}

fn ip(arguments: &[&str]) {
    if let Err(error) = try_ip(arguments) {
        panic!("ip {}: {error}", arguments.join(" "));
    }
}

fn try_ip(arguments: &[&str]) -> Result<(), String> {
    let Output { status, stderr, .. } =
        Command::new("ip").args(arguments).output().map_err(|error| error.to_string())?;
    let text = String::from_utf8_lossy(&stderr);
    if status.success() { Ok(()) } else { Err(text.trim().to_owned()) }
}
