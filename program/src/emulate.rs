//! `downbeat emulate`

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context;
use downbeat_darwin_op::emulator::{self as darwin_op_emulator, Emulator, EmulatorOptions, Fault, has_unit};
use downbeat_servos::servo_bus::Description;
use downbeat_servos::servo_bus::protocol::Id;

use super::stop::Stop;

pub(crate) fn darwin_op(link: PathBuf, seed: u64, faults: &[String]) -> anyhow::Result<()> {
    let stop = Stop::new()?;
    let emulator = darwin_op_emulator::start(options(&link, seed, faults, has_unit)?)?;
    tracing::info!("an emulated Darwin OP is at {}", link.display());
    serve(&stop, emulator);
    Ok(())
}

pub(crate) fn servos(
    description: &str,
    bus: &str,
    link: PathBuf,
    seed: u64,
    faults: &[String],
) -> anyhow::Result<()> {
    let description = Description::load(description)?;
    let stop = Stop::new()?;
    let plan = description.bus(bus)?;
    let has_servo = |id| plan.joints.iter().any(|joint| joint.id == id);
    let emulator = Emulator::start_servos(plan, options(&link, seed, faults, has_servo)?)?;
    tracing::info!("the emulated servos of {} are at {}", description.name, link.display());
    serve(&stop, emulator);
    Ok(())
}

fn options(
    link: &Path,
    seed: u64,
    faults: &[String],
    has_servo: impl Fn(Id) -> bool,
) -> anyhow::Result<EmulatorOptions> {
    let parse = |text: &String| text.parse::<Fault>()?.check(&has_servo);
    let faults = faults
        .iter()
        .map(|text| parse(text).with_context(|| format!("--fault {text}")))
        .collect::<Result<_, _>>()?;
    Ok(EmulatorOptions { link: Some(link.to_owned()), seed, faults, ..EmulatorOptions::default() })
}

fn serve(stop: &Stop, emulator: Emulator) {
    while !stop.is_due() {
        stop.sleep(Duration::from_secs(1));
    }
    emulator.stop();
}
