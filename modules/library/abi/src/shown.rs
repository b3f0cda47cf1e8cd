//! Values of a library as texts for people. Unlike settings, they are read in part if they are long, and
//! their texts may be damaged: bytes that are not UTF-8 become U+FFFD.

#![expect(unsafe_code, reason = "reads what a library points to")]

use crate::lent::head_of;
use crate::{ValueV1, value};
use std::ffi::c_char;
use std::fmt::Write;

/// A value as `Debug` of Rust writes it, cut after about `longest` bytes.
///
/// # Errors
/// If it is no value of this interface.
///
/// # Safety
/// `value` is null or points to a value as downbeat.h describes it.
pub unsafe fn shown_value(value: *const ValueV1, longest: usize) -> Result<String, String> {
    // SAFETY: by the contract of this function.
    let given = unsafe { head_of(value) }?;
    match given.kind {
        value::TEXT => {
            // SAFETY: by the contract of this function.
            let (text, left) = unsafe { text_in(given, longest) };
            Ok(match left {
                0 => format!("{text:?}"),
                left => format!("{text:?}... and {left} more bytes"),
            })
        }
        value::BOOL | value::INTEGER | value::DOUBLE if given.count != 1 => {
            Err(format!("a single value has count 1, not {}", given.count))
        }
        // SAFETY: by the contract of this function, there is one element.
        value::BOOL | value::INTEGER | value::DOUBLE => Ok(unsafe { shown_element(given, 0, longest) }),
        value::BYTES..=value::TEXTS => {
            let mut text = "[".to_owned();
            for index in 0..given.count {
                let separator = if index > 0 { ", " } else { "" };
                if text.len() > longest {
                    let _ = write!(text, "{separator}... and {} more", given.count - index);
                    break;
                }
                // SAFETY: by the contract of this function, there are `count` elements.
                let _ = write!(text, "{separator}{}", unsafe { shown_element(given, index, longest) });
            }
            text.push(']');
            Ok(text)
        }
        other => Err(format!("{other} is no kind of value")),
    }
}

/// A text as it is, cut after `longest` bytes, and the number of bytes that are left out.
///
/// # Errors
/// If it is no value of this interface, or not a text.
///
/// # Safety
/// As [`shown_value`].
pub unsafe fn shown_text(value: *const ValueV1, longest: usize) -> Result<(String, usize), String> {
    // SAFETY: by the contract of this function.
    let given = unsafe { head_of(value) }?;
    match given.kind {
        // SAFETY: by the contract of this function.
        value::TEXT => Ok(unsafe { text_in(given, longest) }),
        other => Err(format!("a value without a name is a text, not of kind {other}")),
    }
}

/// A name in one line, cut after `longest` bytes; `None` if it is null.
///
/// # Safety
/// `name` is null or points to a text with a terminating zero.
#[must_use]
pub unsafe fn shown_name(name: *const c_char, longest: usize) -> Option<String> {
    if name.is_null() {
        return None;
    }
    // SAFETY: by the contract of this function.
    let (name, is_cut) = unsafe { start_of(name, longest) };
    let mut shown = String::new();
    for letter in name.chars() {
        match letter.is_control() {
            true => shown.extend(letter.escape_default()),
            false => shown.push(letter),
        }
    }
    if is_cut {
        shown.push_str("...");
    }
    Some(shown)
}

/// One element of a value, or its only one.
///
/// # Safety
/// The data of the value are elements of the type that its kind stands for, and `index` is below their count.
unsafe fn shown_element(given: &ValueV1, index: usize, longest: usize) -> String {
    /// Reads an element wherever it lies.
    ///
    /// # Safety
    /// As [`shown_element`]; the elements are of this type.
    unsafe fn read<T>(given: &ValueV1, index: usize) -> T {
        // SAFETY: by the contract of this function.
        unsafe { given.data.cast::<T>().add(index).read_unaligned() }
    }
    // SAFETY: by the contract of this function; texts are null or end with a zero.
    unsafe {
        match given.kind {
            value::BOOL | value::BOOLS => (read::<u8>(given, index) != 0).to_string(),
            value::INTEGER | value::INTEGERS => read::<i64>(given, index).to_string(),
            value::DOUBLE | value::DOUBLES => format!("{:?}", read::<f64>(given, index)),
            value::TEXTS => match read::<*const c_char>(given, index) {
                text if text.is_null() => "NULL".to_owned(),
                text => match start_of(text, longest) {
                    (text, true) => format!("{text:?}..."),
                    (text, false) => format!("{text:?}"),
                },
            },
            _ => read::<u8>(given, index).to_string(),
        }
    }
}

/// The text of a value, at most `longest` bytes, and the number of bytes that are left out.
///
/// # Safety
/// The data of the value are `count` bytes.
unsafe fn text_in(given: &ValueV1, longest: usize) -> (String, usize) {
    if given.count == 0 {
        return (String::new(), 0);
    }
    // SAFETY: by the contract of this function, and not null as there is at least one.
    let bytes = unsafe { std::slice::from_raw_parts(given.data.cast::<u8>(), given.count) };
    let end = end_within(bytes, longest);
    (String::from_utf8_lossy(&bytes[..end]).into_owned(), bytes.len() - end)
}

/// The start of a text with a terminating zero, at most `longest` bytes, and whether the text goes on.
///
/// # Safety
/// `text` points to a text with a terminating zero.
unsafe fn start_of(text: *const c_char, longest: usize) -> (String, bool) {
    // SAFETY: by the contract of this function, all bytes up to the zero can be read.
    let count = (0..=longest).take_while(|&index| unsafe { text.add(index).read() } != 0).count();
    // SAFETY: as before.
    let bytes = unsafe { std::slice::from_raw_parts(text.cast::<u8>(), count) };
    let end = end_within(bytes, longest);
    (String::from_utf8_lossy(&bytes[..end]).into_owned(), end < count)
}

/// Where to cut a text so that at most `longest` bytes remain, without half of a character at their end.
fn end_within(bytes: &[u8], longest: usize) -> usize {
    if bytes.len() <= longest {
        return bytes.len();
    }
    // A character has at most four bytes; those after its first begin with the bits 10.
    let ends = (longest.saturating_sub(3)..=longest).rev();
    ends.into_iter().find(|&end| bytes[end] & 0xc0 != 0x80).unwrap_or(longest)
}
