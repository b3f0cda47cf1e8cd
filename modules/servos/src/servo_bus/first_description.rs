//! A first description of what was found on a port.

use super::protocol::Protocol;
use super::tool::Found;
use std::fmt::Write;

/// The cycle of a few fast servos, and of others, in ms.
const CYCLES_MS: [u32; 2] = [10, 20];
/// How many servos are few, at the speed that is fast.
const FEW: usize = 20;
const FAST_BAUD: u32 = 1_000_000;
/// How fast joints approach their first command, in rad/s.
const APPROACH_RAD_S: f64 = 0.5;

/// The text of a description of the servos that were found on a port. Joints are named by their ids, and
/// their limits are the whole range of their servos: where the stops of the joints are is not known. `models`
/// are the files of models that are not built in.
///
/// # Errors
/// Returns a sentence if there is no servo, one is of an unknown model, or they do not all speak alike.
pub fn first_description(
    name: &str,
    port: &str,
    models: &[String],
    found: &[Found],
) -> Result<String, String> {
    if let Some(unknown) = found.iter().find(|found| found.model.is_none()) {
        let number = unknown.number.map_or("?".to_owned(), |number| number.to_string());
        return Err(format!(
            "id {} is model {number}, which is unknown: name a file with its registers with --model-file",
            unknown.id
        ));
    }
    let servos = found.iter().filter_map(|found| {
        let model = found.model.as_ref()?;
        let (goal, position) = (model.register("goal_position")?, model.register("present_position")?);
        Some((found, model, goal, position))
    });
    let mut servos: Vec<_> = servos.collect();
    servos.sort_by_key(|(found, ..)| found.id);
    let Some((first, first_model, ..)) = servos.first() else {
        return Err("no servo was found, only other devices".to_owned());
    };
    if let Some((other, ..)) = servos.iter().find(|(found, ..)| found.line != first.line) {
        let spoken = |found: &Found| {
            format!("id {} at {} bit/s in {}", found.id, found.line.baud, found.line.protocol.key())
        };
        return Err(format!(
            "the servos do not speak alike: {}, {}. Give all of a bus the same speed, with `downbeat servo write {port} ID \
             baud_rate VALUE --force` and one of them connected at a time",
            spoken(first),
            spoken(other)
        ));
    }
    let is_one_model = servos.iter().all(|(_, model, ..)| model.name == first_model.name);
    let line = first.line;
    let is_quick = line.baud >= FAST_BAUD && servos.len() <= FEW && line.protocol != Protocol::Dynamixel1;
    let cycle_ms = if is_quick { CYCLES_MS[0] } else { CYCLES_MS[1] };
    let own_models = if models.is_empty() { String::new() } else { format!("models = {models:?}\n") };
    let mut text = format!(
        "# The servos that were found on {port}. The names of joints and their limits are to be set: here, the limits\n\
         # are all that the servos can turn.\n\n\
         name = {name:?}\n{own_models}\n\
         [[bus]]\nname = {name:?}\nport = {port:?}\nbaud = {}\nprotocol = \"{}\"\ncycle_ms = {cycle_ms}\n\n\
         [defaults]\n",
        line.baud,
        line.protocol.key(),
    );
    // Writing to a text does not fail.
    if is_one_model {
        let _ = writeln!(text, "model = {:?}", first_model.name);
    }
    let _ = writeln!(text, "approach_rad_s = {APPROACH_RAD_S}");
    for (found, model, goal, position) in &servos {
        let middle = (goal.min + goal.max + 1) / 2;
        let [low, high] = [goal.min, goal.max].map(|raw| position.to_si(raw - middle));
        let _ = write!(text, "\n[[joint]]\nname = \"joint_{0}\"\nid = {0}\n", found.id);
        if !is_one_model {
            let _ = writeln!(text, "model = {:?}", model.name);
        }
        // Towards 0, so that rounding leads to no goal beyond the range.
        let [low, high] = [low, high].map(|angle| (angle * 1000.0).trunc() / 1000.0);
        let _ = writeln!(text, "limits = [{low:?}, {high:?}]");
    }
    for found in found {
        let is_servo = servos.iter().any(|(servo, ..)| servo.id == found.id);
        if let Some(model) = found.model.as_ref().filter(|_| !is_servo && found.line == line) {
            let _ = write!(
                text,
                "\n[[device]]\nname = \"device_{0}\"\nid = {0}\nmodel = {1:?}\n",
                found.id, model.name
            );
        }
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::servo_bus::Description;
    use crate::servo_bus::bus::LineSettings;
    use crate::servo_bus::models;
    use crate::servo_bus::protocol::Id;

    fn found(id: u8, model: Option<&str>, baud: u32, protocol: Protocol) -> Found {
        let model =
            model.map(|name| models::built_in().iter().find(|model| model.name == name).unwrap().clone());
        let number = Some(model.as_ref().and_then(|model| model.number).unwrap_or(4711));
        let line = LineSettings { baud, protocol };
        Found { id: Id::new(id).unwrap(), line, number, firmware: None, model, is_garbled: false }
    }

    #[test]
    fn what_was_found_is_a_valid_description() {
        for (protocol, models) in [
            (Protocol::FeetechSts, vec!["STS3215"; 6]),
            (Protocol::Dynamixel2, vec!["XM430-W350", "XL330-M288", "OpenCR"]),
            (Protocol::Dynamixel1, vec!["AX-12A", "MX-28"]),
        ] {
            let ids = (1..=models.len() as u8).zip(&models).rev();
            let devices: Vec<_> =
                ids.map(|(id, model)| found(id, Some(model), 1_000_000, protocol)).collect();
            let text = first_description("arm", "/dev/ttyUSB0", &[], &devices).unwrap();
            let description = Description::load(&text).unwrap();
            let bus = description.bus("arm").unwrap();
            assert_eq!(bus.joints.len() + bus.devices.len(), models.len(), "{text}");
            assert_eq!((bus.line.baud, bus.line.protocol), (1_000_000, protocol));
            for joint in &bus.joints {
                let goal = &joint.registers.goal;
                let [low, high] = joint.goal_range();
                assert!(
                    (goal.min..goal.min + 3).contains(&low) && (goal.max - 2..=goal.max).contains(&high),
                    "{text}"
                );
            }
        }
    }

    #[test]
    fn what_cannot_be_one_bus_is_named() {
        let sts = |id, baud| found(id, Some("STS3215"), baud, Protocol::FeetechSts);
        let refused = |found: &[Found]| first_description("arm", "/dev/ttyUSB0", &[], found).unwrap_err();
        assert!(refused(&[found(200, Some("OpenCR"), 1_000_000, Protocol::Dynamixel2)]).contains("no servo"));
        let unknown = refused(&[sts(1, 1_000_000), found(2, None, 1_000_000, Protocol::FeetechSts)]);
        assert!(unknown.contains("id 2 is model 4711, which is unknown"), "{unknown}");
        let mixed = refused(&[sts(1, 1_000_000), sts(4, 115_200)]);
        assert!(mixed.contains("id 1 at 1000000 bit/s in feetech_sts, id 4 at 115200 bit/s"), "{mixed}");
    }
}
