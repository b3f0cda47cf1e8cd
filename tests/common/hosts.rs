//! Hosts of their own: network namespaces of this machine, with a switch between them.

use std::path::Path;
use std::process::{Command, Output};

/// Two hosts, `10.77.0.1` and `10.77.0.2`, on a switch that nobody else is on. They go when this is dropped.
pub struct Hosts {
    names: [String; 2],
    switch: String,
}

impl Hosts {
    const CABLE: &str = "cable";

    /// Makes them, or says why not and returns nothing: only root may, and not on every machine.
    pub fn new() -> Option<Self> {
        let of = |host: &str| format!("downbeat_{}_{host}", std::process::id());
        let hosts = Self { names: [of("a"), of("b")], switch: of("switch") };
        if let Err(error) = hosts.make() {
            let line = format!("skipped: hosts of their own need root and network namespaces: {error}\n");
            // Past the capture of test output, which shows nothing of a test that passes.
            let _ = std::io::Write::write_all(&mut std::io::stderr(), line.as_bytes());
            return None;
        }
        Some(hosts)
    }

    fn make(&self) -> Result<(), String> {
        let (switch, cable) = (&*self.switch, Self::CABLE);
        try_ip(&["netns", "add", switch])?;
        try_ip(&["-n", switch, "link", "add", "switch", "type", "bridge"])?;
        try_ip(&["-n", switch, "link", "set", "switch", "up"])?;
        let [a, b] = &self.names;
        for (name, port, address) in [(a, "port0", "10.77.0.1/24"), (b, "port1", "10.77.0.2/24")] {
            try_ip(&["netns", "add", name])?;
            try_ip(&[
                "-n", switch, "link", "add", port, "type", "veth", "peer", "name", cable, "netns", name,
            ])?;
            try_ip(&["-n", switch, "link", "set", port, "master", "switch", "up"])?;
            try_ip(&["-n", name, "address", "add", address, "dev", cable])?;
            try_ip(&["-n", name, "link", "set", "lo", "up"])?;
            try_ip(&["-n", name, "link", "set", cable, "up"])?;
            try_ip(&["-n", name, "route", "add", "224.0.0.0/4", "dev", cable])?;
        }
        Ok(())
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
    let told = String::from_utf8_lossy(&stderr);
    if status.success() { Ok(()) } else { Err(told.trim().to_owned()) }
}
