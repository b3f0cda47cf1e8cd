//! A sample, or one fragment of it, that is written to a datagram.

use crate::wire::{Data, DataFragment, EntityId, MessageBuilder};

use super::history::Entry;
use super::pacer::Load;

/// Samples up to this size are sent before the queue of a pacer.
const SMALL: usize = 4096;

impl Load {
    pub fn of(entry: &Entry) -> Self {
        if entry.payload.len() <= SMALL { Self::Small } else { Self::Bulk }
    }
}

/// A sample, or one fragment of it.
#[derive(Clone, Copy)]
pub(super) enum Part {
    Whole,
    Fragment { number: u32, size: u16 },
}

/// Returns the number of fragments of a sample.
pub(super) fn fragment_count(entry: &Entry, fragment_size: u16) -> u32 {
    entry.payload.len().div_ceil(fragment_size.into()) as u32
}

impl Part {
    /// Returns the part of a sample to send if `fragment` is next.
    pub fn of(entry: &Entry, fragment_size: u16, fragment: u32) -> Self {
        match entry.payload.len() > usize::from(fragment_size) {
            true => Self::Fragment { number: fragment, size: fragment_size },
            false => Self::Whole,
        }
    }

    /// The range of the part in the payload.
    pub fn range(self, entry: &Entry) -> std::ops::Range<usize> {
        match self {
            Self::Whole => 0..entry.payload.len(),
            Self::Fragment { number, size } => {
                let start = (number as usize - 1) * usize::from(size);
                start.min(entry.payload.len())..(start + usize::from(size)).min(entry.payload.len())
            }
        }
    }

    pub fn len(self, entry: &Entry) -> usize {
        self.range(entry).len()
    }

    pub fn end(self) -> u64 {
        match self {
            Self::Whole => 0,
            Self::Fragment { number, size } => u64::from(number) * u64::from(size),
        }
    }

    pub fn is_last(self, entry: &Entry) -> bool {
        self.range(entry).end == entry.payload.len()
    }

    pub fn fits(self, entry: &Entry, builder: &MessageBuilder<'_>) -> bool {
        // A timestamp may precede the part, and zeros up to a multiple of four may follow.
        const REST: usize = 16;
        let overhead = match self {
            Self::Whole => MessageBuilder::DATA_OVERHEAD,
            Self::Fragment { .. } => MessageBuilder::DATA_FRAGMENT_OVERHEAD,
        };
        builder.remaining() >= overhead + entry.inline_qos.encoded_len() + self.len(entry) + REST
    }

    /// Writes the part. The caller ensures that it fits.
    pub fn emit(self, entry: &Entry, reader: EntityId, writer: EntityId, builder: &mut MessageBuilder<'_>) {
        builder.info_timestamp(Some(entry.timestamp));
        let (number, inline_qos) = (entry.number, entry.inline_qos);
        let is_written = match self {
            Self::Whole => {
                builder.data(&Data { reader, writer, number, inline_qos, payload: entry.payload() })
            }
            Self::Fragment { number: first, size } => builder.data_fragment(&DataFragment {
                reader,
                writer,
                number,
                first,
                count: 1,
                fragment_size: size,
                sample_size: entry.payload.len() as u32,
                inline_qos,
                payload: &entry.payload[self.range(entry)],
                is_key: false,
            }),
        };
        debug_assert!(is_written, "a part that fits was not written");
    }
}
