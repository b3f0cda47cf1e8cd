//! `downbeat servo tune`

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, bail};
use downbeat_msgs::user_file;
use downbeat_servos::servo_bus::{Description, JointOffset, Tuner};

use super::description_edit::with_offset;
use super::dialogue::{Answer, DONE, Dialogue};
use super::{OfDescription, text_of};

/// What moves a joint, and by how many steps of its servo.
const MOVES: [(Answer, i64); 4] = [
    (("+", "a step forward"), 1),
    (("-", "a step back"), -1),
    (("++", "ten steps forward"), 10),
    (("--", "ten steps back"), -10),
];

/// Finds the offsets of joints by eye, and adds them to those in the description.
pub(super) fn tune(options: &OfDescription) -> anyhow::Result<()> {
    let text = text_of(&options.description)?;
    let description = Description::load(&options.description.to_string_lossy())?;
    let mut dialogue = Dialogue::new(options.page, "Tuned")?;
    let tuned = moved(options, &description, &mut dialogue)
        .and_then(|moved| write(&options.description, text, &moved, &mut dialogue));
    dialogue.end(tuned)
}

/// Asks of each joint where it is to be, and returns by how much it was moved.
fn moved(
    options: &OfDescription,
    description: &Description,
    dialogue: &mut Dialogue,
) -> anyhow::Result<Vec<JointOffset>> {
    let plan = description.bus(&options.bus)?;
    let name = &plan.name;
    let begin = format!(
        "All joints of \"{name}\" get their torque now, and go slowly to 0 rad: clear the surroundings"
    );
    dialogue.ask(&begin, &[DONE], None)?;
    let slack = Duration::from_millis(options.timeout_ms);
    let (mut bus, notes) = Tuner::begin(plan, options.port.as_deref().unwrap_or(&plan.port), slack)?;
    notes.into_iter().for_each(|note| dialogue.say(note));
    let tuned = at_zero(&mut bus, dialogue);
    // Whatever happened.
    let end = dialogue.ask("All joints lose their torque now: hold the robot", &[DONE], Some(&mut bus));
    let released = bus.release();
    tuned.and(end.map(drop))?;
    released?;
    Ok(bus.offsets().collect())
}

fn at_zero(bus: &mut Tuner, dialogue: &mut Dialogue) -> anyhow::Result<()> {
    bus.go_to_zero(|| dialogue.goes_on())?;
    let joints: Vec<_> = bus.offsets().map(|offset| (offset.name, offset.reference.to_degrees())).collect();
    let answers: Vec<Answer> = [DONE].into_iter().chain(MOVES.map(|(answer, _)| answer)).collect();
    for (index, (name, degrees)) in joints.iter().enumerate() {
        let question = format!("{name}: move it until it is where it is to be at {degrees:.1} degrees");
        loop {
            let answer = dialogue.ask(&question, &answers, Some(bus))?;
            let Some((_, steps)) = MOVES.iter().find(|((typed, _), _)| *typed == answer) else { break };
            if !bus.step(index, *steps)? {
                dialogue.say(format!(
                    "{name} cannot be moved further: an offset is at most 20 degrees; `downbeat servo calibrate` finds another zero"
                ));
            }
        }
    }
    Ok(())
}

/// Writes the offsets into the description.
fn write(path: &Path, text: String, moved: &[JointOffset], dialogue: &mut Dialogue) -> anyhow::Result<()> {
    let moved: Vec<_> = moved.iter().filter(|offset| offset.steps != 0).collect();
    if moved.is_empty() {
        bail!("no joint was moved; {} stays as it is", path.display());
    }
    let mut tuned = text;
    let mut written = Vec::new();
    for offset in moved {
        let with_it = with_offset(&tuned, offset).with_context(|| path.display().to_string())?;
        // Limits may not fit to the new zero; the other joints keep what was found.
        match Description::parse(&path.to_string_lossy(), &with_it) {
            Ok(_) => {
                tuned = with_it;
                written.push(offset);
            }
            Err(problem) => dialogue.say(format!("{} stays as it is described: {problem}", offset.name)),
        }
    }
    if written.is_empty() {
        bail!("nothing was written");
    }
    user_file::replace(path, &tuned).with_context(|| format!("cannot write {}", path.display()))?;
    for JointOffset { name, steps, angle, .. } in written {
        dialogue.say(format!("{name:<20} offset {steps:+} ({:+.2} degrees)", angle.to_degrees()));
    }
    dialogue.say(format!("wrote {}", path.display()));
    Ok(())
}
