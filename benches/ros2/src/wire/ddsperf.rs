//! Cyclone DDS in C: `ddsperf` of Debian's package `cyclonedds-tools`.

use std::process::{Command, Stdio};

use anyhow::Context;

use super::Trips;

/// Measures round trips of 100 bytes between two processes, the one that asks with the first configuration.
pub fn round_trips(seconds: f64, domain: u16, configurations: &[String; 2]) -> anyhow::Result<Trips> {
    let ddsperf = |mode: &[&str], configuration: &str| {
        let mut command = Command::new("ddsperf");
        let seconds = seconds.ceil().max(2.0) + 1.0;
        command.args(["-i", &domain.to_string(), "-D", &seconds.to_string(), "-T", "KS"]);
        command.args(mode).env("CYCLONEDDS_URI", configuration);
        command
    };
    let mut pong = ddsperf(&["pong"], &configurations[1])
        .stdout(Stdio::null())
        .spawn()
        .context("no ddsperf (cyclonedds-tools)")?;
    let ping = ddsperf(&["ping", "size", "100"], &configurations[0]).output();
    pong.kill()?;
    pong.wait()?;
    let output = String::from_utf8(ping?.stdout)?;
    // One line per second with half of a round-trip time: "… mean 35.1us min 28.3us 50% 33.9us 90% 41.2us 99%
    // 60.3us max …".
    let mut lines = output.lines().filter(|line| line.contains("mean"));
    let line = lines.next_back().with_context(|| format!("ddsperf measured nothing: {output}"))?;
    let figure = |name: &str| {
        let mut words = line.split_ascii_whitespace().skip_while(|word| *word != name).skip(1);
        let text = words.next().with_context(|| format!("no {name} in {line:?}"))?;
        text.trim_end_matches("us").parse::<f64>().with_context(|| format!("{name} in {line:?}"))
    };
    Ok(Trips { p50_us: 2.0 * figure("50%")?, p99_us: 2.0 * figure("99%")? })
}
