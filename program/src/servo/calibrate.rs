//! `downbeat servo calibrate`

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, bail};
use downbeat_msgs::user_file;
use downbeat_servos::servo_bus::{Calibrator, Description, JointCalibration, ZeroPose};

use super::description_edit::with_calibration;
use super::dialogue::{DONE, Dialogue};
use super::{OfDescription, text_of};

/// Leads through the calibration of a bus, and writes what was found into its description. Limits are inside
/// of the stops by the margin, in rad.
pub(super) fn calibrate(options: &OfDescription, margin: f64) -> anyhow::Result<()> {
    let path = &options.description;
    let text = text_of(path)?;
    let description = Description::load(&path.to_string_lossy())?;
    let mut dialogue = Dialogue::new(options.page, "Calibrated")?;
    let found = turned(options, margin, &description, &mut dialogue)
        .and_then(|found| write(path, text, found, &mut dialogue));
    dialogue.end(found)
}

/// Asks for everything that is to be turned, and returns what that says of each joint.
fn turned(
    options: &OfDescription,
    margin: f64,
    description: &Description,
    dialogue: &mut Dialogue,
) -> anyhow::Result<Vec<JointCalibration>> {
    let plan = description.bus(&options.bus)?;
    let begin = format!("All joints of \"{}\" lose their torque now: hold the robot", plan.name);
    dialogue.ask(&begin, &[DONE], None)?;
    let slack = Duration::from_millis(options.timeout_ms);
    let mut bus = Calibrator::begin(plan, options.port.as_deref().unwrap_or(&plan.port), slack)?;

    dialogue.ask("Turn each joint by hand from one stop to the other", &[DONE], Some(&mut bus))?;
    for note in bus.take_stops()? {
        dialogue.say(note);
    }
    let middle = ("middle", "the middle between their stops");
    let pose = "Bring all joints to where they are to be at 0 rad";
    let pose = match &*dialogue.ask(pose, &[DONE, middle], Some(&mut bus))? {
        "middle" => ZeroPose::Middle,
        _ => ZeroPose::Here,
    };
    bus.take_zeros(pose);
    let names: Vec<String> = bus.joints().map(|joint| joint.name).collect();
    for (index, name) in names.iter().enumerate() {
        if !bus.is_calibrated(index) {
            continue;
        }
        bus.begin_nudge(index);
        let nudge = format!("{name}: turn it a little in its positive direction");
        let keep = ("keep", "the sign of the description");
        while dialogue.ask(&nudge, &[DONE, keep], Some(&mut bus))? != "keep" && !bus.take_sign(index) {
            dialogue.say(format!("{name} was turned by less than 3 degrees."));
        }
    }

    let found = bus.results(margin);
    if found.is_empty() {
        bail!("no joint was turned; {} stays as it is", options.description.display());
    }
    Ok(found)
}

/// Writes what was found into the description.
fn write(
    path: &Path,
    text: String,
    found: Vec<JointCalibration>,
    dialogue: &mut Dialogue,
) -> anyhow::Result<()> {
    let mut calibrated = text;
    let mut written = Vec::new();
    for joint in found {
        let with_it = with_calibration(&calibrated, &joint).with_context(|| path.display().to_string())?;
        // What cannot be read again is not written: limits that were kept may not fit to a new zero.
        match Description::parse(&path.to_string_lossy(), &with_it) {
            Ok(_) => {
                calibrated = with_it;
                written.push(joint);
            }
            Err(problem) => dialogue.say(format!("{} stays as it is described: {problem}", joint.name)),
        }
    }
    if written.is_empty() {
        bail!("nothing was written");
    }
    user_file::replace(path, &calibrated).with_context(|| format!("cannot write {}", path.display()))?;
    for joint in &written {
        let limits = joint
            .limits
            .map_or("as described".to_owned(), |[low, high]| format!("{low:.3} to {high:.3} rad"));
        let JointCalibration { name, zero, sign, .. } = joint;
        dialogue.say(format!("{name:<20} zero {zero:>6}  sign {sign:>2}  limits {limits}"));
    }
    dialogue.say(format!("wrote {}; the joints are still limp", path.display()));
    Ok(())
}
