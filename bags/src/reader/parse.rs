//! Parsing of records whose lengths may be wrong.
//!
//! The parser of `mcap` takes memory for a text before it looks whether the text is there, up to 4 GiB, and takes the least
//! length of some records for granted. So lengths are looked at here first.

use mcap::McapError;
use mcap::records::{Record, op};

/// Parses the body of a record. What is borrowed is of `body`.
///
/// # Errors
/// What is wrong, as the end of a sentence about where the record is.
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
        McapError::Parse(source) => format!("a record is not as it should be ({source})"),
        other => other.to_string(),
    })
}

/// A part of a record.
enum Part {
    Bytes(usize),
    /// A length in 4 bytes, and so many bytes.
    Text,
    /// A length in 4 bytes, and pairs of texts until at least so many bytes are used up.
    TextPairs,
    /// The same with items of so many bytes.
    Items(usize),
}

/// The parts of a record, up to the last that the parser trusts.
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
    /// `None` if there is less than that.
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
