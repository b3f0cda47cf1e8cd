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
    use super::{cm730, mx28};

    #[test]
    fn a_value_is_found_in_the_part_that_contains_it() {
        let piece = [0x34, 0x12, 0xCD, 0xAB];
        assert_eq!(mx28::PRESENT_POSITION.value_in(&piece, 36), Some(0x1234));
        assert_eq!(mx28::PRESENT_SPEED.value_in(&piece, 36), Some(0xABCD));
        assert_eq!(mx28::PRESENT_LOAD.value_in(&piece, 36), None);
        assert_eq!(mx28::PRESENT_SPEED.value_in(&piece[..3], 36), None);
        assert_eq!(cm730::BUTTON.value_in(&piece, 36), None);
    }
}
