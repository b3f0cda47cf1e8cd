//! Parses records whose lengths may be invalid.
//!
//! The parser of `mcap` allocates up to 4 GiB for a string before checking that it exists, and assumes a
//! minimum length of some records. So lengths are checked here first.

use mcap::McapError;
use mcap::records::{Record, op};

/// Parses the body of a record, borrowing from `body`.
///
/// # Errors
/// The problem, as the end of a sentence about the record's location.
pub(super) fn parse(opcode: u8, body: &[u8]) -> Result<Record<'_>, String> {
    let mut rest = body;
    if layout(opcode).iter().any(|part| part.skip(&mut rest).is_none()) {
        return Err(format!(
            "a record with opcode {opcode} and {} bytes is shorter than it should be",
            body.len()
        ));
    }
    mcap::parse_record(opcode, body).map_err(|error| match error {
        McapError::Io(source) => source.to_string(),
        McapError::Parse(source) => format!("a record is invalid ({source})"),
        other => other.to_string(),
    })
}

/// A part of a record.
enum Part {
    Bytes(usize),
    /// A length in 4 bytes, and that many bytes.
    Text,
    /// A length in 4 bytes, and pairs of strings until at least that many bytes are consumed.
    TextPairs,
    /// A length in 4 bytes, and items of a fixed size.
    Items(usize),
}

/// The parts of a record, up to the last one whose length the parser trusts.
fn layout(opcode: u8) -> &'static [Part] {
    use Part::{Bytes, Items, Text, TextPairs};
    match opcode {
        op::HEADER => &[Text, Text],
        op::FOOTER => &[Bytes(20)],
        op::SCHEMA => &[Bytes(2), Text, Text, Bytes(4)],
        op::CHANNEL => &[Bytes(2 + 2), Text, Text, TextPairs],
        op::MESSAGE => &[Bytes(2 + 4 + 8 + 8)],
        op::CHUNK => &[Bytes(8 + 8 + 8 + 4), Text, Bytes(8)],
        op::MESSAGE_INDEX => &[Bytes(2), Items(8 + 8)],
        op::CHUNK_INDEX => &[Bytes(4 * 8), Items(2 + 8), Bytes(8), Text, Bytes(8 + 8)],
        op::ATTACHMENT => &[Bytes(8 + 8), Text, Text, Bytes(8 + 4)],
        op::ATTACHMENT_INDEX => &[Bytes(5 * 8), Text, Text],
        op::STATISTICS => &[Bytes(8 + 2 + 4 * 4 + 8 + 8), Items(2 + 8)],
        op::METADATA => &[Text, TextPairs],
        op::METADATA_INDEX => &[Bytes(8 + 8), Text],
        op::SUMMARY_OFFSET => &[Bytes(1 + 8 + 8)],
        op::DATA_END => &[Bytes(4)],
        _ => &[],
    }
}

impl Part {
    /// `None` if the input is too short.
    fn skip(&self, rest: &mut &[u8]) -> Option<()> {
        match self {
            Self::Bytes(count) => skip(rest, *count),
            Self::Text => {
                let length = length(rest)?;
                skip(rest, length)
            }
            Self::TextPairs => {
                let length = length(rest)?;
                let before = rest.len();
                while before - rest.len() < length {
                    Self::Text.skip(rest)?;
                    Self::Text.skip(rest)?;
                }
                Some(())
            }
            Self::Items(size) => {
                let length = length(rest)?;
                skip(rest, length.div_ceil(*size).checked_mul(*size)?)
            }
        }
    }
}

fn skip(rest: &mut &[u8], count: usize) -> Option<()> {
    *rest = rest.get(count..)?;
    Some(())
}

fn length(rest: &mut &[u8]) -> Option<usize> {
    let (length, behind) = rest.split_first_chunk::<4>()?;
    *rest = behind;
    usize::try_from(u32::from_le_bytes(*length)).ok()
}
