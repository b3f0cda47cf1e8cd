//! The message index behind a chunk: which messages it should have.

use std::collections::BTreeMap;
use std::io;

use mcap::records::op;

use super::records::{Next, RecordFile};

/// The messages of a chunk according to the index records behind it. Empty if there are none.
#[derive(Debug, Default)]
pub(super) struct MessageIndex {
    /// Channel and log time, by offset in the content of the chunk.
    messages: BTreeMap<u64, (u16, u64)>,
}

/// The channel, the length of the entries, and the length of an entry.
const CHANNEL: u64 = 2;
const ENTRIES: u64 = CHANNEL + 4;
const ENTRY: u64 = 8 + 8;

impl MessageIndex {
    /// Reads the records from `offset`, where a chunk ends.
    pub(super) fn read(input: &mut RecordFile, offset: u64) -> io::Result<Self> {
        let mut index = Self::default();
        each_behind(input, offset, |input, place| {
            let body = input.read(place.body_length)?;
            let Some((channel, rest)) = body.split_first_chunk() else { return Ok(()) };
            let channel = u16::from_le_bytes(*channel);
            for entry in rest.get(4..).unwrap_or_default().chunks_exact(ENTRY as usize) {
                let (time, offset) = entry.split_at(8);
                let number =
                    |bytes: &[u8]| bytes.iter().rev().fold(0, |sum, byte| sum << 8 | u64::from(*byte));
                index.messages.insert(number(offset), (channel, number(time)));
            }
            Ok(())
        })?;
        Ok(index)
    }

    /// The number of messages, if there is an index.
    pub(super) fn count(&self) -> Option<u64> {
        (!self.messages.is_empty()).then_some(self.messages.len() as u64)
    }

    /// Channel and log time of the message at `offset`.
    pub(super) fn at(&self, offset: u64) -> Option<(u16, u64)> {
        self.messages.get(&offset).copied()
    }

    /// The offsets of messages after `offset`.
    pub(super) fn offsets_after(&self, offset: u64) -> impl Iterator<Item = u64> {
        self.messages.range(offset.saturating_add(1)..).map(|(offset, _)| *offset)
    }

    /// The messages from `offset` on that are not in `read`, by channel: their number, and the times of the
    /// first and the last.
    pub(super) fn without(&self, offset: u64, read: &[u64]) -> impl Iterator<Item = (u16, u64, u64, u64)> {
        let mut lost = BTreeMap::new();
        for (offset, (channel, time)) in self.messages.range(offset..) {
            if read.binary_search(offset).is_err() {
                let (count, first, last) = lost.entry(*channel).or_insert((0, *time, *time));
                *count += 1;
                (*first, *last) = ((*first).min(*time), (*last).max(*time));
            }
        }
        lost.into_iter().map(|(channel, (count, first, last))| (channel, count, first, last))
    }
}

/// The number of messages that the index records from `offset` declare, if there are any.
pub(super) fn declared_behind(input: &mut RecordFile, offset: u64) -> io::Result<Option<u64>> {
    let mut declared = None;
    each_behind(input, offset, |_, place| {
        let entries = place.body_length.saturating_sub(ENTRIES) / ENTRY;
        declared = Some(declared.unwrap_or(0_u64).saturating_add(entries));
        Ok(())
    })?;
    Ok(declared)
}

/// The number of messages of a chunk with index records of that total length for that many channels, if it is
/// the length of such records.
pub(super) fn declared_by_length(length: u64, channels: u64) -> Option<u64> {
    let headers = channels.checked_mul(super::records::RECORD_HEADER + ENTRIES)?;
    let entries = length.checked_sub(headers)?;
    (channels > 0 && entries.is_multiple_of(ENTRY)).then_some(entries / ENTRY)
}

fn each_behind(
    input: &mut RecordFile,
    mut offset: u64,
    mut each: impl FnMut(&mut RecordFile, super::records::Place) -> io::Result<()>,
) -> io::Result<()> {
    let end = input.length();
    while let Next::Record(place) = input.place_at(offset, end)? {
        if place.opcode != op::MESSAGE_INDEX
            || place.body_length < ENTRIES
            || !(place.body_length - ENTRIES).is_multiple_of(ENTRY)
        {
            break;
        }
        offset = place.end();
        each(input, place)?;
    }
    Ok(())
}
