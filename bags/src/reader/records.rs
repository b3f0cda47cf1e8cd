//! The framing of an MCAP file: the positions of its records.
//!
//! Every length is checked against the size of the file before anything is allocated, so a damaged file costs
//! no more than an intact one.

use std::io::{self, Read, Seek, SeekFrom};

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
    Torn {
        offset: u64,
    },
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
            return Ok(Next::Torn { offset });
        }
        self.seek(offset)?;
        let header = self.read(RECORD_HEADER)?;
        let mut length = [0; 8];
        length.copy_from_slice(&header[1..]);
        let place = Place { opcode: header[0], offset, body_length: u64::from_le_bytes(length) };
        // 0 is not an opcode: file systems leave zeros if a power failure prevented writing the data.
        if place.opcode == 0 || place.body_length > left - RECORD_HEADER {
            return Ok(Next::Torn { offset });
        }
        Ok(Next::Record(place))
    }
}

fn too_short(expected: u64, at: u64, there: u64) -> io::Error {
    let found = format!("expected {expected} bytes at byte {at}, found {there}");
    io::Error::new(io::ErrorKind::UnexpectedEof, found)
}
