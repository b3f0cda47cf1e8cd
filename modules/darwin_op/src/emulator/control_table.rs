//! The memory of a device.

use crate::hardware::protocol::StatusError;
use crate::hardware::tables::{Access, Field};
use std::ops::Range;

/// The memory of a device, with its access rules.
#[derive(Clone, Debug)]
pub(super) struct ControlTable {
    bytes: Vec<u8>,
    fields: &'static [Field],
}

impl ControlTable {
    pub(super) fn new(fields: &'static [Field], length: u8) -> Self {
        let mut table = Self { bytes: vec![0; usize::from(length)], fields };
        table.reset(|_| true);
        table
    }

    /// Resets the fields selected by `which` to their initial values.
    pub(super) fn reset(&mut self, which: impl Fn(&Field) -> bool) {
        for field in self.fields.iter().filter(|field| which(field)) {
            self.set(field, field.initial);
        }
    }

    pub(super) fn get(&self, field: &Field) -> u16 {
        field.value_in(&self.bytes, 0).unwrap_or(0)
    }

    /// Sets a field internally, without access rules.
    pub(super) fn set(&mut self, field: &Field, value: u16) {
        let bytes = value.to_le_bytes();
        let size = usize::from(field.size);
        self.bytes[span(field)].copy_from_slice(&bytes[..size]);
    }

    /// Reads bytes, or returns the error for a range beyond the end.
    pub(super) fn read(&self, address: u8, length: u8) -> Result<&[u8], StatusError> {
        let begin = usize::from(address);
        self.bytes.get(begin..begin + usize::from(length)).ok_or(StatusError::RANGE)
    }

    /// Writes from outside: either everything, or nothing with an error.
    ///
    /// With `is_locked`, persistent fields may not be written. Bytes between fields are ignored.
    pub(super) fn write(&mut self, address: u8, data: &[u8], is_locked: bool) -> Result<(), StatusError> {
        let written = usize::from(address)..usize::from(address) + data.len();
        if written.is_empty() || written.end > self.bytes.len() {
            return Err(StatusError::RANGE);
        }
        let mut after = self.clone();
        after.bytes[written.clone()].copy_from_slice(data);
        for field in self.fields.iter().filter(|field| overlaps(&span(field), &written)) {
            let refused = match field.access {
                Access::Read => true,
                Access::Eeprom => is_locked,
                Access::Ram => false,
            };
            if refused || !(field.min..=field.max).contains(&after.get(field)) {
                return Err(StatusError::RANGE);
            }
        }
        self.bytes = after.bytes;
        Ok(())
    }
}

fn span(field: &Field) -> Range<usize> {
    usize::from(field.address)..usize::from(field.end())
}

fn overlaps(one: &Range<usize>, other: &Range<usize>) -> bool {
    one.start < other.end && other.start < one.end
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hardware::tables::mx28;

    fn servo() -> ControlTable {
        ControlTable::new(&mx28::TABLE, mx28::LENGTH)
    }

    #[test]
    fn written_values_can_be_read() {
        let mut table = servo();
        assert_eq!(table.write(26, &[1, 2, 3, 0, 0x34, 0x02], false), Ok(()));
        assert_eq!(table.read(26, 6), Ok(&[1, 2, 3, 0, 0x34, 0x02][..]));
        assert_eq!(table.get(&mx28::GOAL_POSITION), 0x0234);
    }

    #[test]
    fn a_write_that_touches_a_read_only_field_changes_nothing() {
        let mut table = servo();
        let before = table.bytes.clone();
        assert_eq!(table.write(34, &[1, 0, 5, 5], false), Err(StatusError::RANGE));
        assert_eq!(table.bytes, before);
    }

    #[test]
    fn a_value_or_an_address_out_of_range_is_refused() {
        let mut table = servo();
        assert_eq!(table.write(24, &[2], false), Err(StatusError::RANGE));
        assert_eq!(table.write(73, &[0, 0], false), Err(StatusError::RANGE));
        assert_eq!(table.write(24, &[], false), Err(StatusError::RANGE));
        assert_eq!(table.read(73, 2), Err(StatusError::RANGE));
    }

    #[test]
    fn locked_persistent_fields_cannot_be_written() {
        let mut table = servo();
        assert_eq!(table.write(5, &[0], true), Err(StatusError::RANGE));
        assert_eq!(table.write(5, &[0], false), Ok(()));
        assert_eq!(table.write(24, &[1], true), Ok(()));
    }
}
