//! Measures how long participants that join at the same time need to know each other, with DDS Security and
//! without it.

use std::sync::Arc;
use std::time::{Duration, Instant};

use downbeat_bridge::middleware::{Middleware, ParticipantOptions, join};

use crate::keystore::{self, ENCLAVES, LocalKeystore};
use crate::peer::on_this_machine;

/// How long they may take.
const PATIENCE: Duration = Duration::from_secs(30);

#[derive(clap::Args)]
pub struct Options {
    /// Number of participants, in one process.
    #[arg(long, default_value_t = 10)]
    participants: usize,
    /// Number of rounds; the median and the longest are printed.
    #[arg(long, default_value_t = 5)]
    rounds: usize,
    /// The ROS domain.
    #[arg(long, default_value_t = 103)]
    domain: u16,
}

pub fn run(options: &Options) -> anyhow::Result<()> {
    anyhow::ensure!(options.rounds > 0, "--rounds must be at least 1");
    let keystore = LocalKeystore::create(options.domain)?;
    println!(
        "| {} participants | all know all, median | longest |\n| --- | --- | --- |",
        options.participants
    );
    for (name, is_secured) in [("without security", false), ("with security", true)] {
        let times = (0..options.rounds).map(|_| gather(options, is_secured.then_some(&keystore)));
        let mut times = times.collect::<anyhow::Result<Vec<_>>>()?;
        times.sort_unstable();
        let ms = |time: Duration| time.as_secs_f64() * 1e3;
        println!("| {name} | {:.0} ms | {:.0} ms |", ms(times[times.len() / 2]), ms(times[times.len() - 1]));
    }
    Ok(())
}

/// Lets participants join, and returns the time until each knows, or has authenticated, all others.
fn gather(options: &Options, keystore: Option<&LocalKeystore>) -> anyhow::Result<Duration> {
    let start = Instant::now();
    let participant = |index: usize| {
        let enclave = ENCLAVES[index % ENCLAVES.len()];
        let security = keystore.map(|keystore| keystore::options(keystore.path(), enclave));
        Ok(join(&ParticipantOptions { security, ..on_this_machine(options.domain)? })?)
    };
    let participants: Vec<Arc<dyn Middleware>> =
        (0..options.participants).map(participant).collect::<anyhow::Result<_>>()?;
    let known = |participant: &Arc<dyn Middleware>| match participant.security() {
        Some(state) => state().authenticated,
        None => participant.remote_participants().map_or(0, |others| others.len()),
    };
    while participants.iter().any(|participant| known(participant) + 1 < participants.len()) {
        anyhow::ensure!(start.elapsed() < PATIENCE, "they do not know each other after {PATIENCE:?}");
        std::thread::sleep(Duration::from_millis(1));
    }
    Ok(start.elapsed())
}
