//! Tags, varints and lengths.

use crate::interchange::Problem;

/// The wire type of a field, which determines its length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WireType {
    Varint = 0,
    Fixed64 = 1,
    Delimited = 2,
    Fixed32 = 5,
}

pub(super) fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

pub(super) fn put_tag(out: &mut Vec<u8>, number: u32, wire_type: WireType) {
    put_varint(out, u64::from(number) << 3 | wire_type as u64);
}

pub(super) fn put_bytes(out: &mut Vec<u8>, number: u32, bytes: &[u8]) {
    put_tag(out, number, WireType::Delimited);
    put_varint(out, bytes.len() as u64);
    out.extend_from_slice(bytes);
}

/// Appends the output of `write`, preceded by its length.
pub(super) fn put_delimited<E>(
    out: &mut Vec<u8>,
    number: u32,
    write: impl FnOnce(&mut Vec<u8>) -> Result<(), E>,
) -> Result<(), E> {
    put_tag(out, number, WireType::Delimited);
    let start = out.len();
    write(out)?;
    // The length is a varint: it is inserted once it is known.
    let mut length = Vec::with_capacity(10);
    put_varint(&mut length, (out.len() - start) as u64);
    out.splice(start..start, length);
    Ok(())
}

/// Reads the fields of a message one after another.
#[derive(Clone, Debug)]
pub(super) struct Fields<'a> {
    bytes: &'a [u8],
    position: usize,
    /// The offset of the bytes in the whole input, for errors.
    origin: usize,
}

/// The content after a tag.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Content<'a> {
    Varint(u64),
    Fixed64([u8; 8]),
    Fixed32([u8; 4]),
    Delimited(&'a [u8]),
}

/// A field: its number, its content, and the offset of the content.
pub(super) struct Part<'a> {
    pub(super) number: u32,
    pub(super) content: Content<'a>,
    pub(super) offset: usize,
}

impl<'a> Fields<'a> {
    pub(super) fn new(bytes: &'a [u8], origin: usize) -> Self {
        Self { bytes, position: 0, origin }
    }

    /// The next field, `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<Part<'a>>, Problem> {
        if self.position == self.bytes.len() {
            return Ok(None);
        }
        let start = self.offset();
        let tag = self.varint()?;
        let number = match u32::try_from(tag >> 3) {
            Ok(number @ 1..=0x1fff_ffff) => number,
            _ => return Err(Problem::at(start, format!("{} is not a field number", tag >> 3))),
        };
        let offset = self.offset();
        let content = match tag & 7 {
            0 => Content::Varint(self.varint()?),
            1 => Content::Fixed64(self.array()?),
            2 => {
                let length = self.varint()?;
                let length = usize::try_from(length).unwrap_or(usize::MAX);
                let content = self.take(length)?;
                let offset = self.offset() - content.len();
                return Ok(Some(Part { number, content: Content::Delimited(content), offset }));
            }
            5 => Content::Fixed32(self.array()?),
            3 | 4 => return Err(Problem::at(start, "groups are not supported: proto3 has none")),
            other => return Err(Problem::at(start, format!("{other} is not a wire type"))),
        };
        Ok(Some(Part { number, content, offset }))
    }

    /// The next number of a packed list, with its offset.
    pub(super) fn next_varint(&mut self) -> Result<Option<(u64, usize)>, Problem> {
        let offset = self.offset();
        if self.position == self.bytes.len() { Ok(None) } else { Ok(Some((self.varint()?, offset))) }
    }

    fn offset(&self) -> usize {
        self.origin + self.position
    }

    fn varint(&mut self) -> Result<u64, Problem> {
        let start = self.offset();
        let mut value = 0;
        for shift in (0..70).step_by(7) {
            let [byte] = self.array()?;
            // Only one bit of the tenth byte fits; the others are dropped, as in all implementations.
            value |= u64::from(byte & 0x7f).checked_shl(shift).unwrap_or(0);
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err(Problem::at(start, "a varint has more than 10 bytes"))
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], Problem> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], Problem> {
        let rest = &self.bytes[self.position..];
        match rest.get(..count) {
            Some(bytes) => {
                self.position += count;
                Ok(bytes)
            }
            None => {
                let text = format!("needs {count} more bytes, but there are only {}", rest.len());
                Err(Problem::at(self.offset(), text))
            }
        }
    }
}
