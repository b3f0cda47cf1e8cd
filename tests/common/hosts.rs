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

    /// Makes them, or says why not and returns nothing: only root may.
    pub fn new() -> Option<Self> {
        let of = |host: &str| format!("downbeat_{}_{host}", std::process::id());
        let hosts = Self { names: [of("a"), of("b")], switch: of("switch") };
        let switch = &hosts.switch;
        if let Err(error) = try_ip(&["netns", "add", switch]) {
            let line = format!("skipped: hosts of their own need root and network namespaces: {error}\n");
            // Past the capture of test output, which shows nothing of a test that passes.
            let _ = std::io::Write::write_all(&mut std::io::stderr(), line.as_bytes());
            return None;
        }
        ip(&["-n", switch, "link", "add", "switch", "type", "bridge"]);
        ip(&["-n", switch, "link", "set", "switch", "up"]);
        for (name, port, address) in
            [(&hosts.names[0], "port0", "10.77.0.1/24"), (&hosts.names[1], "port1", "10.77.0.2/24")]
        {
            ip(&["netns", "add", name]);
            ip(&[
                "-n",
                switch,
                "link",
                "add",
                port,
                "type",
                "veth",
                "peer",
                "name",
                Self::CABLE,
                "netns",
                name,
            ]);
            ip(&["-n", switch, "link", "set", port, "master", "switch", "up"]);
            ip(&["-n", name, "address", "add", address, "dev", Self::CABLE]);
            ip(&["-n", name, "link", "set", "lo", "up"]);
            ip(&["-n", name, "link", "set", Self::CABLE, "up"]);
            ip(&["-n", name, "route", "add", "224.0.0.0/4", "dev", Self::CABLE]);
        }
        Some(hosts)
    }

    /// A command on one of the hosts, 0 or 1. `ip` becomes the program, so that its process is the program's.
    pub fn command(&self, host: usize, program: impl AsRef<Path>) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.names[host]]).arg(program.as_ref());
        command.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET").env_remove("ROS_DOMAIN_ID");
        command
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
