//! A router, in a process of its own.

use crate::common::hosts::Hosts;
use downbeat_zenoh::Settings;
use std::io::{BufRead, BufReader, Lines, Read};
use std::process::{Child, ChildStdout, Stdio};

const LISTENS: &str = "listens";

#[test]
#[ignore = "a process that other tests start"]
fn a_router_runs_until_its_input_ends() {
    let settings = Settings::from_variables(|name| std::env::var(name).ok()).unwrap();
    let _router = downbeat_zenoh::Router::start(&settings).unwrap();
    println!("{LISTENS}");
    std::io::stdin().lock().read_to_end(&mut Vec::new()).unwrap();
}

/// The process of a router. It falls over when this is dropped.
pub struct Router {
    process: Child,
    /// Kept: the test harness of the process prints on it later too.
    _output: Lines<BufReader<ChildStdout>>,
}

impl Router {
    /// Starts that of a host; the one of host 1 connects to that of host 0.
    pub fn start(hosts: &Hosts, host: usize) -> Self {
        let mut command = hosts.command(host, std::env::current_exe().unwrap());
        let test = "router::a_router_runs_until_its_input_ends";
        command.args(["--exact", test, "--ignored", "--nocapture", "--test-threads=2"]);
        let connect = if host == 0 { "" } else { "connect/endpoints=[\"tcp/10.77.0.1:7447\"]" };
        command.env("ZENOH_CONFIG_OVERRIDE", connect);
        let mut process = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let mut output = BufReader::new(process.stdout.take().unwrap()).lines();
        assert!(
            output.by_ref().any(|line| line.unwrap() == LISTENS),
            "the router of host {host} does not start"
        );
        Self { process, _output: output }
    }

    pub fn id(&self) -> u32 {
        self.process.id()
    }
}

impl Drop for Router {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
