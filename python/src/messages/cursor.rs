//! Reads plain little-endian CDR, the only form that messages in Python keep: see [`super::from_cdr`].

use std::sync::Arc;

use downbeat_msgs::definitions::{Element, Shape};

use super::types::{Field, MessageType, least_size_of_element};

/// A position in the body of a message: the bytes after the header.
#[derive(Clone, Copy)]
pub(super) struct Cursor<'a> {
    pub(super) body: &'a [u8],
    pub(super) at: usize,
}

/// What is wrong with the bytes, as the end of a sentence.
pub(super) type Read<T> = Result<T, String>;

impl<'a> Cursor<'a> {
    pub(super) fn align(&mut self, alignment: usize) {
        self.at = (self.at + alignment - 1) & !(alignment - 1);
    }

    pub(super) fn bytes(&mut self, count: usize) -> Read<&'a [u8]> {
        let end = self.at.checked_add(count);
        match end.and_then(|end| self.body.get(self.at..end)) {
            Some(bytes) => {
                self.at += count;
                Ok(bytes)
            }
            None => Err(self.too_short(count)),
        }
    }

    /// A number of `N` bytes.
    #[inline]
    pub(super) fn number<const N: usize>(&mut self) -> Read<[u8; N]> {
        self.align(N);
        match self.body.get(self.at..).and_then(|rest| rest.first_chunk::<N>()) {
            Some(bytes) => {
                self.at += N;
                Ok(*bytes)
            }
            None => Err(self.too_short(N)),
        }
    }

    /// A length of elements of at least this size.
    pub(super) fn length(&mut self, least_size: usize) -> Read<usize> {
        let count = u32::from_le_bytes(self.number()?) as usize;
        let left = self.body.len() - self.at;
        if count.saturating_mul(least_size) > left {
            return Err(format!(
                "declares {count} elements of at least {least_size} bytes at byte {}, but only {left} bytes follow",
                self.at
            ));
        }
        Ok(count)
    }

    /// The length of an array or sequence.
    pub(super) fn count(&mut self, field: &Field) -> Read<usize> {
        let least_size = least_size_of_element(&field.of.element);
        match field.of.shape {
            Shape::Single => Ok(1),
            Shape::Array(count) => usize::try_from(count).map_err(|_| "is too large".to_owned()),
            Shape::Sequence => self.length(least_size),
            Shape::Bounded(bound) => match self.length(least_size)? {
                count if count as u64 > bound => {
                    Err(format!("has {count} elements, its type allows {bound}"))
                }
                count => Ok(count),
            },
        }
    }

    pub(super) fn text(&mut self, bound: Option<u64>) -> Read<&'a str> {
        let length = self.length(1)?;
        let start = self.at;
        // Some implementations write an empty string without its zero.
        let Some((terminator, text)) = self.bytes(length)?.split_last() else { return Ok("") };
        if *terminator != 0 {
            return Err(format!(
                "a string ends with a zero byte, found {terminator:#04x} at byte {}",
                self.at - 1
            ));
        }
        check_bound(text.len(), bound)?;
        std::str::from_utf8(text)
            .map_err(|error| format!("the string is not UTF-8 at byte {}", start + error.valid_up_to()))
    }

    pub(super) fn wide_text(&mut self, bound: Option<u64>) -> Read<String> {
        let length = self.length(4)?;
        check_bound(length, bound)?;
        let units = self.bytes(length * 4)?.as_chunks::<4>().0.iter().map(|unit| {
            let unit = u32::from_le_bytes(*unit);
            u16::try_from(unit)
                .map_err(|_| format!("the wide string is not UTF-16: {unit:#x} is invalid in it"))
        });
        let units = units.collect::<Read<Vec<u16>>>()?;
        String::from_utf16(&units).map_err(|_| "the wide string is not UTF-16".to_owned())
    }

    /// Skips a field without checking more than its length.
    pub(super) fn skip(&mut self, field: &Field) -> Read<()> {
        let count = self.count(field)?;
        if count == 0 {
            return Ok(()); // No padding either.
        }
        let result = match &field.of.element {
            Element::Primitive(primitive) => {
                self.align(primitive.size());
                self.bytes(count.saturating_mul(primitive.size())).map(drop)
            }
            Element::String { .. } => (0..count).try_for_each(|_| {
                let length = self.length(1)?;
                self.bytes(length).map(drop)
            }),
            Element::WString { .. } => (0..count).try_for_each(|_| {
                let length = self.length(4)?;
                self.bytes(length * 4).map(drop)
            }),
            Element::Message(nested) => match nested.uniform {
                Some((width, size)) => {
                    self.align(width);
                    self.bytes(count.saturating_mul(size)).map(drop)
                }
                None => (0..count).try_for_each(|_| self.skip_message(nested)),
            },
        };
        result.map_err(|problem| in_field(&field.name, &problem))
    }

    pub(super) fn skip_message(&mut self, of: &Arc<MessageType>) -> Read<()> {
        if of.fields.is_empty() {
            return self.bytes(1).map(drop); // A message without fields is sent as one byte.
        }
        of.fields.iter().try_for_each(|field| self.skip(field))
    }

    #[cold]
    fn too_short(&self, count: usize) -> String {
        let left = self.body.len().saturating_sub(self.at);
        format!("needs {count} more bytes at byte {}, but only {left} bytes follow", self.at)
    }
}

fn check_bound(found: usize, bound: Option<u64>) -> Read<()> {
    match bound {
        Some(bound) if found as u64 > bound => {
            Err(format!("has the length {found}, its type allows {bound}"))
        }
        _ => Ok(()),
    }
}

/// Prepends a field to a problem.
#[cold]
pub(super) fn in_field(name: &str, problem: &str) -> String {
    format!("field `{name}`: {problem}")
}
