//! `downbeat emulate`

use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::Duration;

use anyhow::Context;
use downbeat_darwin_op::emulator::{
    self as darwin_op_emulator, Emulator, EmulatorOptions, Fault, FaultParseError, check_fault,
};
use downbeat_servos::servo_bus::Description;

use super::input;
use super::stop::Stop;

pub(crate) fn darwin_op(link: PathBuf, seed: u64, faults: &[String]) -> anyhow::Result<()> {
    let stop = Stop::new()?;
    let emulator = darwin_op_emulator::start(options(&link, seed, faults, check_fault)?)?;
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
    is_turned_by_hand: bool,
) -> anyhow::Result<()> {
    let description = Description::load(description)?;
    let stop = Stop::new()?;
    let plan = description.bus(bus)?;
    let has_servo = |id| plan.joints.iter().any(|joint| joint.id == id);
    let options = options(&link, seed, faults, |fault| fault.check(has_servo))?;
    let emulator = Emulator::start_servos(plan, options)?;
    tracing::info!("the emulated servos of {} are at {}", description.name, link.display());
    let lines = is_turned_by_hand.then(input::lines).transpose()?;
    let mut in_hand: Vec<String> = Vec::new();
    while !stop.is_due() {
        for line in lines.iter().flat_map(mpsc::Receiver::try_iter) {
            match turn(&emulator, &line) {
                Ok(joint) => in_hand.extend(joint),
                Err(problem) => tracing::error!("{problem}"),
            }
        }
        for joint in in_hand.extract_if(.., |joint| !emulator.is_in_hand(joint)) {
            println!("{joint} is turned");
        }
        stop.sleep(Duration::from_millis(20));
    }
    emulator.stop();
    Ok(())
}

/// Does what a line says: `turn JOINT RAD`. Returns the joint.
fn turn(emulator: &Emulator, line: &str) -> Result<Option<String>, String> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let (joint, angle) = match words[..] {
        [] => return Ok(None),
        ["turn", joint, angle] => (joint, angle),
        _ => return Err(format!("{line:?} is no instruction; one is: turn JOINT RAD")),
    };
    let angle = angle.parse().ok().filter(|angle: &f64| angle.is_finite());
    let angle = angle.ok_or_else(|| format!("{line:?} names no angle in rad"))?;
    let is_joint = emulator.turn_by_hand(joint, angle);
    is_joint.then(|| Some(joint.to_owned())).ok_or_else(|| format!("there is no joint \"{joint}\""))
}

fn options(
    link: &Path,
    seed: u64,
    faults: &[String],
    check: impl Fn(Fault) -> Result<Fault, FaultParseError>,
) -> anyhow::Result<EmulatorOptions> {
    let parse = |text: &String| check(text.parse()?);
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
