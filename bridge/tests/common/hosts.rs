//! Hosts of their own: network namespaces of this machine, with a switch or a bad line between them.

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
    /// 2 % of the frames are lost in each direction, the others take 20 ms.
    Bad,
}

/// Two hosts, `10.77.0.1` and `10.77.0.2`. They go when this is dropped.
pub struct Hosts {
    names: [String; 2],
    switch: String,
    prefix: String,
    forwarder: Option<Child>,
}

impl Hosts {
    const CABLE: &str = "cable";
    /// Tells a test that it runs on host 0: how the names of the hosts begin.
    const VARIABLE: &str = "DOWNBEAT_HOSTS";

    /// Makes hosts on a switch, or says why not and returns nothing: only root may, and not on every machine.
    pub fn new() -> Option<Self> {
        Self::on(Line::Good)
    }

    /// The same, with a line to choose.
    pub fn on(line: Line) -> Option<Self> {
        // Tests of one process may run side by side.
        static MADE: AtomicU32 = AtomicU32::new(0);
        let number = MADE.fetch_add(1, Ordering::Relaxed);
        let mut hosts = Self::of(&format!("downbeat_{}_{number}", std::process::id()));
        if !test_machine::has_program("ip") {
            test_machine::missing("ip", "Debian: the package iproute2");
            return None;
        }
        if let Err(error) = hosts.make(line) {
            test_machine::skipped(&format!("separate hosts need root and network namespaces: {error}"));
            return None;
        }
        Some(hosts)
    }

    fn of(prefix: &str) -> Self {
        let of = |host: &str| format!("{prefix}_{host}");
        Self { names: [of("a"), of("b")], switch: of("switch"), prefix: prefix.to_owned(), forwarder: None }
    }

    /// The hosts, in a process that [`Hosts::run_again`] has started on host 0.
    pub fn around() -> Option<ManuallyDrop<Self>> {
        let prefix = std::env::var(Self::VARIABLE).ok()?;
        // They belong to the process that made them.
        Some(ManuallyDrop::new(Self::of(&prefix)))
    }

    /// Runs a test of this program once more, on host 0.
    pub fn run_again(&self, test: &str) {
        let mut command = self.command(0, std::env::current_exe().unwrap());
        command.args(["--exact", test, "--nocapture", "--include-ignored"]);
        let status = command.env(Self::VARIABLE, &self.prefix).status().unwrap();
        assert!(status.success(), "{test} failed on its host");
    }

    fn make(&mut self, line: Line) -> Result<(), String> {
        let (switch, cable) = (&*self.switch, Self::CABLE);
        try_ip(&["netns", "add", switch])?;
        if line == Line::Good {
            try_ip(&["-n", switch, "link", "add", "switch", "type", "bridge"])?;
            try_ip(&["-n", switch, "link", "set", "switch", "up"])?;
        }
        let [a, b] = &self.names;
        for (name, port, address) in [(a, "port0", "10.77.0.1/24"), (b, "port1", "10.77.0.2/24")] {
            try_ip(&["netns", "add", name])?;
            try_ip(&[
                "-n", switch, "link", "add", port, "type", "veth", "peer", "name", cable, "netns", name,
            ])?;
            match line {
                Line::Good => try_ip(&["-n", switch, "link", "set", port, "master", "switch", "up"])?,
                // The forwarder takes frames as a cable does, not several in one.
                Line::Bad => {
                    try_ip(&["-n", name, "link", "set", cable, "gso_max_segs", "1"])?;
                    try_ip(&["-n", switch, "link", "set", port, "up"])?;
                }
            }
            try_ip(&["-n", name, "address", "add", address, "dev", cable])?;
            try_ip(&["-n", name, "link", "set", "lo", "up"])?;
            try_ip(&["-n", name, "link", "set", cable, "up"])?;
            try_ip(&["-n", name, "route", "add", "224.0.0.0/4", "dev", cable])?;
        }
        if line == Line::Bad {
            self.forwarder = Some(self.forward()?);
        }
        Ok(())
    }

    fn forward(&self) -> Result<Child, String> {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.switch, "python3", "-c", FORWARDER, "port0", "port1"]);
        command.args(["--delay-ms", "20", "--loss", "0.02"]).stdout(Stdio::piped());
        let mut forwarder = command.spawn().map_err(|error| error.to_string())?;
        let mut line = String::new();
        let _ = BufReader::new(forwarder.stdout.take().unwrap()).read_line(&mut line);
        if line.trim() == "ready" { Ok(forwarder) } else { Err("the forwarder does not start".into()) }
    }

    /// A command on one of the hosts, 0 or 1. `ip` becomes the program, so that its process is the program's.
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
        if let Some(mut forwarder) = self.forwarder.take() {
            let _ = forwarder.kill();
            let _ = forwarder.wait();
        }
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
