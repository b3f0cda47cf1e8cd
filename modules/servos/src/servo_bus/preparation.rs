//! How a device is checked, configured and brought into service.

use super::joint::Joint;
use super::limp::{Limp, Reach, reach_of};
use super::line::{ECHO, Line, Trouble};
use super::models::{Access, Model, Register};
use super::protocol::{Id, Protocol, StatusError};

/// Why a device could not be taken into service.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum PrepareError {
    Trouble(Trouble),
    /// It is not what is declared.
    OtherModel(String),
    Unsuitable(String),
}

impl From<Trouble> for PrepareError {
    fn from(trouble: Trouble) -> Self {
        match trouble {
            Trouble::Refused(error) => Self::Unsuitable(format!("it rejects its settings: {error}")),
            Trouble::Echo => Self::Unsuitable(ECHO.to_owned()),
            trouble => Self::Trouble(trouble),
        }
    }
}

/// Persistent settings that can be written while a servo has torque. All others may change what its goal
/// means, or where it can be, and a servo with torque would then turn.
const HARMLESS: [&str; 13] = [
    "return_delay",
    "status_return_level",
    "p_gain",
    "i_gain",
    "d_gain",
    "temperature_limit",
    "min_voltage_limit",
    "max_voltage_limit",
    "max_torque",
    "current_limit",
    "alarm_led",
    "led_alarm_condition",
    "shutdown",
];

/// Checks a device and writes those of its persistent settings that differ. Returns the first bytes of its
/// table.
///
/// Persistent settings are written only if they differ, since that memory wears out.
pub(crate) fn prepare_device(
    line: &mut Line<'_>,
    id: Id,
    model: &Model,
    wanted: &[(&Register, i64)],
) -> Result<Vec<u8>, PrepareError> {
    let known = [
        "model_number",
        "firmware_version",
        "status_return_level",
        "min_position_limit",
        "max_position_limit",
    ];
    let checked = known
        .iter()
        .filter_map(|name| model.register(name))
        .chain(wanted.iter().map(|(register, _)| *register));
    let end = checked.map(Register::end).max().unwrap_or(0);
    let settings = line.read(id, 0, end)?;
    let protocol = line.protocol;
    let value =
        |name: &str| model.register(name).and_then(|register| register.raw_in(protocol, &settings, 0));
    if let (Some(expected), Some(found)) = (model.number, value("model_number"))
        && found != i64::from(expected)
    {
        let article =
            if model.name.starts_with(['B', 'C', 'D', 'G', 'J', 'K', 'P', 'Q', 'T', 'U', 'V', 'W', 'Y', 'Z'])
            {
                "a"
            } else {
                "an"
            };
        return Err(PrepareError::OtherModel(format!(
            "it is model {found}, not {article} {} ({expected})",
            model.name
        )));
    }
    if let (Some(oldest), Some(firmware)) = (model.oldest_firmware, value("firmware_version"))
        && firmware < oldest
    {
        return Err(PrepareError::Unsuitable(format!(
            "its firmware is {firmware}; update it to {oldest} or later"
        )));
    }
    if let (Some(min), Some(max)) = (value("min_position_limit"), value("max_position_limit"))
        && min >= max
    {
        return Err(PrepareError::Unsuitable(format!(
            "it turns without end: its position limits are {min} and {max}; set them with `downbeat servo write`"
        )));
    }
    let differing: Vec<_> = wanted
        .iter()
        .filter(|(register, value)| register.raw_in(protocol, &settings, 0) != Some(*value))
        .collect();
    let needs_torque_off = |register: &Register| {
        register.access == Access::Eeprom
            && (model.eeprom_needs_torque_off || !HARMLESS.contains(&&*register.name))
    };
    if differing.iter().any(|(register, _)| needs_torque_off(register))
        && let Some(torque) = model.register("torque_enable")
    {
        line.write(id, torque.address, &torque.bytes(protocol, 0))?;
    }
    // Until this is set, writes may not be answered.
    let (level, others): (Vec<_>, Vec<_>) =
        differing.into_iter().partition(|(register, _)| register.name == "status_return_level");
    for (register, value) in level {
        line.write_unanswered(id, register.address, &register.bytes(protocol, value))?;
    }
    for (register, value) in others {
        line.write(id, register.address, &register.bytes(protocol, value))?;
    }
    Ok(settings)
}

/// What determines how hard a servo pulls.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Softness {
    /// D, I, P.
    pub(crate) gains: [Option<i64>; 3],
    /// The raw torque limit.
    pub(crate) torque_limit: Option<i64>,
}

/// A servo that has come into service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Prepared {
    /// Its present position, and the errors beside it.
    pub(crate) position: i64,
    pub(crate) error: StatusError,
    /// Where its goals may be.
    pub(crate) reach: Reach,
    /// Whether it has torque, with its present position as goal.
    pub(crate) has_torque: bool,
}

/// Checks a servo and configures it for the cycle: answers without delay to all instructions, gains and
/// limits of the joint, and its present position as goal and torque, if torque is wanted and the position can
/// be a goal; else no torque.
pub(crate) fn prepare(
    line: &mut Line<'_>,
    joint: &Joint,
    softness: Softness,
    wants_torque: bool,
) -> Result<Prepared, PrepareError> {
    let (registers, protocol) = (&joint.registers, line.protocol);
    let is_persistent =
        |register: &Register| register.access == Access::Eeprom || register.name == "status_return_level";
    let current = registers.current_limit.as_ref();
    let limits =
        current.zip(joint.max_current_a).map(|(register, current)| (register, register.from_si(current)));
    let gains = registers.gains.iter().zip(softness.gains);
    let gains = gains.filter_map(|(register, gain)| register.as_ref().zip(gain));
    // What the description sets replaces what the model sets. Goal and torque are set below.
    let is_replaced = |(register, _): &&(Register, i64)| {
        [&joint.goal_register().name, &registers.goal.name, &registers.torque.name].contains(&&register.name)
            || joint.further.iter().any(|(other, _)| other.name == register.name)
    };
    let of_model = joint.model.at_start.iter().filter(|entry| !is_replaced(entry));
    let at_start = of_model.chain(&joint.further).map(|(register, value)| (register, *value));
    let torque_limit = registers.torque_limit.as_ref().zip(softness.torque_limit);
    let (persistent, mut volatile): (Vec<_>, Vec<_>) = at_start
        .chain(gains)
        .chain(limits)
        .chain(torque_limit)
        .partition(|(register, _)| is_persistent(register));
    let settings = prepare_device(line, joint.id, &joint.model, &persistent)?;
    let reach = reach_of(joint, protocol, &settings, &persistent);
    if let (Some(watchdog), true) = (joint.model.register("bus_watchdog"), joint.drive.is_some()) {
        // One that has stopped the servo lets nothing else be written.
        line.write(joint.id, watchdog.address, &watchdog.bytes(protocol, 0))?;
    }
    let (position, error) = line.read_position(joint)?;
    let has_torque = wants_torque && Limp::of(joint, reach, position, error).is_none();
    let torque = &registers.torque;
    if has_torque {
        volatile.push((joint.goal_register(), if joint.drive.is_some() { 0 } else { position }));
    } else {
        // First, as some servos switch their torque on when anything makes them move.
        line.write(joint.id, torque.address, &torque.bytes(protocol, 0))?;
    }
    for (address, bytes) in blocks(&joint.model, protocol, volatile) {
        line.write(joint.id, address, &bytes)?;
    }
    if has_torque {
        line.write(joint.id, torque.address, &torque.bytes(protocol, 1))?;
    }
    Ok(Prepared { position, error, reach, has_torque })
}

/// Joins values of neighbouring registers into as few writes as possible. A single byte that belongs to no
/// register is written as 0.
fn blocks(model: &Model, protocol: Protocol, mut values: Vec<(&Register, i64)>) -> Vec<(u16, Vec<u8>)> {
    values.sort_by_key(|(register, _)| register.address);
    let mut blocks: Vec<(u16, Vec<u8>)> = Vec::new();
    for (register, value) in values {
        let bytes = register.bytes(protocol, value);
        let is_unused =
            |address: u16| !model.registers.iter().any(|r| (r.address..r.end()).contains(&address));
        if let Some((first, block)) = blocks.last_mut() {
            let end = *first + block.len() as u16;
            if end + 1 == register.address && is_unused(end) {
                block.push(0);
            }
            if *first + block.len() as u16 == register.address {
                block.extend(bytes);
                continue;
            }
        }
        blocks.push((register.address, bytes));
    }
    blocks
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::models::find;
    use super::*;

    #[test]
    fn neighbouring_registers_are_written_together() {
        let model = find("MX-28").unwrap();
        let value = |name: &str, value| (model.register(name).unwrap(), value);
        let values = ["d_gain", "i_gain", "p_gain", "goal_position", "moving_speed"];
        let written = blocks(model, Protocol::Dynamixel1, values.map(|name| value(name, 7)).to_vec());
        assert_eq!(written, [(26, vec![7, 7, 7, 0, 7, 0, 7, 0])]);
        let apart = vec![value("torque_enable", 1), value("d_gain", 2)];
        assert_eq!(
            blocks(model, Protocol::Dynamixel1, apart),
            [(24, vec![1]), (26, vec![2])],
            "25 is the LED"
        );
    }
}
