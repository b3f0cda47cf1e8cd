//! The framing of an MCAP file: the positions of its records.
//!
//! Every length is checked against the size of the file before anything is allocated, so a damaged file costs
//! no more than an intact one.

use std::io::{self, Read, Seek, SeekFrom};

use mcap::McapError;
use mcap::records::{Record, op};

use super::source::{Input, Source};

/// Opcode and length.
pub(super) const RECORD_HEADER: u64 = 1 + 8;

/// The position of a record.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub(super) opcode: u8,
    /// The offset of its opcode.
    pub(super) offset: u64,
    /// The length of its body, after opcode and length.
    pub(super) body_length: u64,
}

impl Place {
    pub(super) fn end(&self) -> u64 {
        self.offset + RECORD_HEADER + self.body_length
    }
}

/// The next item in a file.
pub(super) enum Next {
    Record(Place),
    /// The range ends after a complete record.
    End,
    /// An incomplete record starts here.
    Torn,
}

/// An MCAP file that is read record by record.
pub(super) struct RecordFile {
    input: Box<dyn Input>,
    length: u64,
    position: u64,
}

impl RecordFile {
    pub(super) fn open(source: &Source) -> io::Result<Self> {
        Ok(Self { input: source.open()?, length: source.length()?, position: 0 })
    }

    pub(super) fn length(&self) -> u64 {
        self.length
    }

    pub(super) fn seek(&mut self, offset: u64) -> io::Result<()> {
        // Relative, since an absolute seek would discard the buffer.
        match i64::try_from(i128::from(offset) - i128::from(self.position)) {
            Ok(distance) => self.input.seek_relative(distance)?,
            Err(_) => {
                self.input.seek(SeekFrom::Start(offset))?;
            }
        }
        self.position = offset;
        Ok(())
    }

    /// Reads `length` bytes from here, which must be in the file.
    pub(super) fn read(&mut self, length: u64) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.read_into(&mut bytes, length)?;
        Ok(bytes)
    }

    /// Like `read`, into reused memory.
    pub(super) fn read_into(&mut self, bytes: &mut Vec<u8>, length: u64) -> io::Result<()> {
        bytes.clear();
        let available = self.length.saturating_sub(self.position);
        if length > available {
            return Err(too_short(length, self.position, available));
        }
        bytes.reserve(usize::try_from(length).map_err(io::Error::other)?);
        let read = self.input.by_ref().take(length).read_to_end(bytes)? as u64;
        if read < length {
            // The file was truncated meanwhile.
            return Err(too_short(length, self.position, read));
        }
        self.position += length;
        Ok(())
    }

    /// Reads a record, including opcode and length.
    pub(super) fn read_record(&mut self, place: &Place) -> io::Result<Vec<u8>> {
        self.seek(place.offset)?;
        self.read(RECORD_HEADER + place.body_length)
    }

    /// The place of the record at `offset`, in the range that ends at `end`.
    pub(super) fn place_at(&mut self, offset: u64, end: u64) -> io::Result<Next> {
        let left = end.saturating_sub(offset);
        if left == 0 {
            return Ok(Next::End);
        }
        if left < RECORD_HEADER {
            return Ok(Next::Torn);
        }
        self.seek(offset)?;
        let header = self.read(RECORD_HEADER)?;
        let mut length = [0; 8];
        length.copy_from_slice(&header[1..]);
        let place = Place { opcode: header[0], offset, body_length: u64::from_le_bytes(length) };
        // 0 is not an opcode: file systems leave zeros if a power failure prevented writing the data.
        if place.opcode == 0 || place.body_length > left - RECORD_HEADER {
            return Ok(Next::Torn);
        }
        Ok(Next::Record(place))
    }
}

fn too_short(expected: u64, at: u64, there: u64) -> io::Error {
    let found = format!("expected {expected} bytes at byte {at}, found {there}");
    io::Error::new(io::ErrorKind::UnexpectedEof, found)
}

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

/// Whether ROS 2 can represent the times of a message: others are left out.
pub(super) fn are_ros_times(log_time: u64, publish_time: u64) -> bool {
    i64::try_from(log_time.max(publish_time)).is_ok()
}
