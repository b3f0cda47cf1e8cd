//! A router of Zenoh for the contestants, in a process of its own as usual.

use std::process::Command;

use anyhow::Context;
use downbeat_zenoh::{Router, Settings};

use crate::contestant::Contestant;

/// A router on a free port of this machine, which runs until this is dropped.
pub struct LocalRouter {
    _process: Contestant,
    pub endpoint: String,
}

impl LocalRouter {
    pub fn start() -> anyhow::Result<Self> {
        let mut command = Command::new(std::env::current_exe()?);
        command.arg("router");
        let mut process = Contestant::spawn(command, "the router")?;
        let endpoint = process.outcome()?;
        Ok(Self { _process: process, endpoint })
    }
}

/// Runs a router until the input is closed, and prints where it listens.
pub fn run() -> anyhow::Result<()> {
    let overrides = Some(r#"listen/endpoints=["tcp/127.0.0.1:0"]"#.to_owned());
    let router = Router::start(&Settings { overrides, ..Settings::default() })?;
    let endpoint = router.locators().into_iter().next().context("the router listens nowhere")?;
    println!("{}", serde_json::to_string(&endpoint)?);
    std::io::copy(&mut std::io::stdin(), &mut std::io::sink())?;
    Ok(())
}

/// The defaults of `rmw_zenoh_cpp` with the router at this endpoint.
pub fn sessions_of(endpoint: Option<&str>) -> Settings {
    let overrides = endpoint.map(|endpoint| format!("connect/endpoints=[{endpoint:?}]"));
    Settings { overrides, ..Settings::default() }
}
