//! The control tables of the Darwin OP's devices, its joints, and its units, as data.

pub mod cm730;
pub mod joints;
pub mod mx28;
pub mod units;

/// Whether an entry can be changed, and whether it is persistent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Only the device itself.
    Read,
    /// Anyone; lost without power.
    Ram,
    /// Anyone; kept without power.
    Eeprom,
}

/// One entry of a control table: one byte, or two with the low byte first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    /// Its name in the manual, in lower case.
    pub name: &'static str,
    /// Its address.
    pub address: u8,
    /// Its size in bytes, 1 or 2.
    pub size: u8,
    /// Whether it can be changed.
    pub access: Access,
    /// The factory default, or the value after switching on.
    pub initial: u16,
    /// The smallest value that may be written.
    pub min: u16,
    /// The largest value that may be written.
    pub max: u16,
    /// Its meaning, with its unit.
    pub meaning: &'static str,
}

impl Field {
    const fn read(name: &'static str, address: u8, size: u8, initial: u16) -> Self {
        let max = if size == 1 { 0xFF } else { 0xFFFF };
        Self { name, address, size, access: Access::Read, initial, min: 0, max, meaning: "" }
    }

    const fn ram(name: &'static str, address: u8, size: u8, initial: u16, max: u16) -> Self {
        Self { name, address, size, access: Access::Ram, initial, min: 0, max, meaning: "" }
    }

    const fn eeprom(name: &'static str, address: u8, size: u8, initial: u16, max: u16) -> Self {
        Self { name, address, size, access: Access::Eeprom, initial, min: 0, max, meaning: "" }
    }

    const fn at_least(mut self, min: u16) -> Self {
        self.min = min;
        self
    }

    const fn means(mut self, meaning: &'static str) -> Self {
        self.meaning = meaning;
        self
    }

    /// The address after it.
    #[must_use]
    pub const fn end(&self) -> u8 {
        self.address + self.size
    }

    /// Its value in a part of the control table that starts at `first_address`; `None` if it is not in that
    /// part.
    #[must_use]
    pub fn value_in(&self, piece: &[u8], first_address: u8) -> Option<u16> {
        let offset = usize::from(self.address.checked_sub(first_address)?);
        match (self.size, piece.get(offset..)?) {
            (1, [byte, ..]) => Some(u16::from(*byte)),
            (2, [low, high, ..]) => Some(u16::from_le_bytes([*low, *high])),
            _ => None,
        }
    }
}

/// Rejects, at compile time, a table whose fields overlap, are out of order, or exceed its end.
const fn checked<const N: usize>(table: [Field; N], length: u8) -> [Field; N] {
    let mut index = 0;
    let mut end = 0;
    while index < N {
        let field = &table[index];
        assert!(field.size == 1 || field.size == 2, "a field is one or two bytes");
        assert!(field.address >= end, "fields are in order and do not overlap");
        assert!(field.min <= field.max, "the range of a field is not empty");
        end = field.end();
        index += 1;
    }
    assert!(end <= length, "the last field is inside the table");
    table
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::joints::JOINTS;
    use super::{cm730, mx28, units};
    use downbeat_kinematics::Robot;
    use downbeat_servos::servo_bus::models::{self, Register};
    use downbeat_servos::servo_bus::protocol::Protocol;

    const ONE: Protocol = Protocol::Dynamixel1;
    const DARWIN_OP: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../robots/darwin_op.urdf");

    fn register(model: &str, name: &str) -> Register {
        models::find(model).unwrap().register(name).unwrap().clone()
    }

    #[test]
    fn a_value_is_found_in_the_part_that_contains_it() {
        let piece = [0x34, 0x12, 0xCD, 0xAB];
        assert_eq!(mx28::PRESENT_POSITION.value_in(&piece, 36), Some(0x1234));
        assert_eq!(mx28::PRESENT_SPEED.value_in(&piece, 36), Some(0xABCD));
        assert_eq!(mx28::PRESENT_LOAD.value_in(&piece, 36), None);
        assert_eq!(mx28::PRESENT_SPEED.value_in(&piece[..3], 36), None);
        assert_eq!(cm730::BUTTON.value_in(&piece, 36), None);
    }
    #[test]
    fn the_tables_of_the_emulator_agree_with_the_models() {
        let compiled = mx28::TABLE.iter().zip(std::iter::repeat("MX-28"));
        for (field, model) in compiled.chain(cm730::TABLE.iter().zip(std::iter::repeat("CM-730"))) {
            let model = models::find(model).unwrap();
            let Some(register) = model.registers.iter().find(|r| r.address == u16::from(field.address))
            else {
                assert!(field.name.starts_with("adc"), "{} has no {}", model.name, field.name);
                continue;
            };
            assert_eq!(register.size, u16::from(field.size), "{}", field.name);
            assert_eq!(register.initial, i64::from(field.initial), "{}", field.name);
        }
    }

    #[test]
    fn values_agree_with_the_conversions_of_the_darwin_op() {
        let (position, velocity) =
            (register("MX-28", "present_position"), register("MX-28", "present_velocity"));
        let raw = |register: &Register, raw: u16| {
            register.raw_in(ONE, &raw.to_le_bytes(), register.address).unwrap()
        };
        for ticks in 0..4096_u16 {
            let angle = units::radians_from_ticks(ticks, 0);
            assert_eq!(position.to_si(raw(&position, ticks) - 2048).to_bits(), angle.to_bits());
        }
        for speed in 0..2048_u16 {
            assert_eq!(
                velocity.to_si(raw(&velocity, speed)).to_bits(),
                units::speed_from_raw(speed).to_bits()
            );
        }
        let load = register("MX-28", "present_load");
        assert_eq!(load.to_si(raw(&load, 1024 + 250)), -0.25);
        assert_eq!(register("MX-28", "present_voltage").to_si(119), 11.9);
    }

    #[test]
    fn the_description_agrees_with_the_joints_of_the_hardware() {
        let robot = Robot::read(DARWIN_OP).unwrap();
        assert_eq!(robot.coordinates().len(), JOINTS.len());
        for table in &JOINTS {
            let joint = robot.joint(robot.joint_id(table.name).unwrap());
            assert_eq!(joint.axis.to_array(), table.axis.map(f64::from), "{}", table.name);
            let limits = [*joint.range().start() - table.min_rad(), *joint.range().end() - table.max_rad()];
            assert!(limits.iter().all(|difference| difference.abs() < 1e-9), "{}", table.name);
        }
    }
}
