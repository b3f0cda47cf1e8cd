//! `downbeat emulate`

use std::path::PathBuf;
use std::time::Duration;

use crate::modules::darwin_op_emulator::{Emulator, EmulatorOptions, Fault};
use anyhow::Context;

use super::stop::Stop;

pub(crate) fn darwin_op(link: PathBuf, seed: u64, faults: &[String]) -> anyhow::Result<()> {
    let faults = faults
        .iter()
        .map(|text| text.parse::<Fault>().with_context(|| format!("--fault {text}")))
        .collect::<Result<_, _>>()?;
    let stop = Stop::new()?;
    let options = EmulatorOptions { link: Some(link.clone()), seed, faults, ..EmulatorOptions::default() };
    let emulator = Emulator::start(options)?;
    tracing::info!("an emulated Darwin OP is at {}", link.display());
    while !stop.is_due() {
        stop.sleep(Duration::from_secs(1));
    }
    emulator.stop();
    Ok(())
}
