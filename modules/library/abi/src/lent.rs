//! Values of settings in the C interface.

use crate::{ABI_VERSION, ValueV1, value};
use downbeat_executor::SettingValue;
use std::ffi::{CStr, CString, c_char, c_void};

/// A value that a library may read.
#[derive(Debug)]
pub struct LentValue {
    value: SettingValue,
    /// Of bools and texts, in the form of C.
    bytes: Vec<u8>,
    _texts: Vec<CString>,
    pointers: Vec<*const c_char>,
}

impl LentValue {
    /// Keeps a value in the form of C.
    #[must_use]
    pub fn new(value: SettingValue) -> Self {
        let bytes = match &value {
            SettingValue::Bool(value) => vec![u8::from(*value)],
            SettingValue::Bools(values) => values.iter().map(|&value| u8::from(value)).collect(),
            SettingValue::Text(text) => c_string(text).into_bytes_with_nul(),
            _ => Vec::new(),
        };
        let texts: Vec<CString> = match &value {
            SettingValue::Texts(texts) => texts.iter().map(|text| c_string(text)).collect(),
            _ => Vec::new(),
        };
        let pointers = texts.iter().map(|text| text.as_ptr()).collect();
        Self { value, bytes, _texts: texts, pointers }
    }

    /// The value in the form of C, which points into this one.
    #[must_use]
    pub fn in_c(&self) -> ValueV1 {
        fn one<T>(value: &T) -> (*const c_void, usize) {
            (std::ptr::from_ref(value).cast(), 1)
        }
        fn all<T>(values: &[T]) -> (*const c_void, usize) {
            (values.as_ptr().cast(), values.len())
        }
        let (kind, (data, count)) = match &self.value {
            SettingValue::Bool(_) => (value::BOOL, all(&self.bytes)),
            SettingValue::Integer(integer) => (value::INTEGER, one(integer)),
            SettingValue::Double(double) => (value::DOUBLE, one(double)),
            SettingValue::Text(_) => {
                let (data, count) = all(&self.bytes);
                (value::TEXT, (data, count - 1))
            }
            SettingValue::Bytes(bytes) => (value::BYTES, all(bytes)),
            SettingValue::Bools(_) => (value::BOOLS, all(&self.bytes)),
            SettingValue::Integers(integers) => (value::INTEGERS, all(integers)),
            SettingValue::Doubles(doubles) => (value::DOUBLES, all(doubles)),
            SettingValue::Texts(_) => (value::TEXTS, all(&self.pointers)),
        };
        ValueV1 {
            abi_version: ABI_VERSION,
            struct_size: size_of::<ValueV1>() as u32,
            kind,
            reserved: 0,
            data,
            count,
        }
    }
}

// SAFETY: the pointers point to the texts, which move with the value.
#[expect(unsafe_code, reason = "pointers into the same struct")]
unsafe impl Send for LentValue {}

/// A text for C, without what C ends a text at.
#[must_use]
pub fn c_string(text: &str) -> CString {
    CString::new(text.replace('\0', "")).unwrap_or_default()
}

/// Reads a value of a library.
///
/// # Errors
/// If it is no value of this interface.
///
/// # Safety
/// `value` is null or points to a value as downbeat.h describes it.
#[expect(unsafe_code, reason = "reads what a library points to")]
pub unsafe fn value_of(value: *const ValueV1) -> Result<SettingValue, String> {
    // SAFETY: by the contract of this function.
    let given = unsafe { head_of(value) }?;
    // `data` points to `count` elements of this type.
    unsafe fn all<T: Copy>(given: &ValueV1) -> Vec<T> {
        if given.count == 0 {
            return Vec::new();
        }
        // SAFETY: by the contract of this function.
        unsafe { std::slice::from_raw_parts(given.data.cast::<T>(), given.count) }.to_vec()
    }
    let one_of = |count: usize| match count {
        1 => Ok(()),
        _ => Err(format!("a single value has count 1, not {count}")),
    };
    // SAFETY: by the contract of `value_of`, `data` points to `count` elements of the type that `kind` stands
    // for.
    unsafe {
        Ok(match given.kind {
            value::BOOL => {
                one_of(given.count)?;
                SettingValue::Bool(all::<u8>(given)[0] != 0)
            }
            value::INTEGER => {
                one_of(given.count)?;
                SettingValue::Integer(all(given)[0])
            }
            value::DOUBLE => {
                one_of(given.count)?;
                SettingValue::Double(all(given)[0])
            }
            value::TEXT => SettingValue::Text(utf8(all(given))?),
            value::BYTES => SettingValue::Bytes(all(given)),
            value::BOOLS => SettingValue::Bools(all::<u8>(given).into_iter().map(|byte| byte != 0).collect()),
            value::INTEGERS => SettingValue::Integers(all(given)),
            value::DOUBLES => SettingValue::Doubles(all(given)),
            value::TEXTS => {
                let texts = all::<*const c_char>(given).into_iter().map(|text| text_of(text, "the text"));
                SettingValue::Texts(texts.collect::<Result<_, _>>()?)
            }
            other => return Err(format!("{other} is no kind of value")),
        })
    }
}

/// Checks a value of a library, apart from its data.
///
/// # Safety
/// As [`value_of`].
#[expect(unsafe_code, reason = "reads what a library points to")]
pub(crate) unsafe fn head_of<'a>(value: *const ValueV1) -> Result<&'a ValueV1, String> {
    // SAFETY: by the contract of this function.
    let given = unsafe { value.as_ref() }.ok_or("the value is NULL")?;
    check_struct("downbeat_value_v1", given.abi_version, given.struct_size, size_of::<ValueV1>())?;
    if given.data.is_null() && given.count > 0 {
        return Err("the data of the value are NULL".to_owned());
    }
    Ok(given)
}

/// Reads a text of a library.
///
/// # Errors
/// If it is null or not in UTF-8.
///
/// # Safety
/// `text` is null or points to a text with a terminating zero.
#[expect(unsafe_code, reason = "reads what a library points to")]
pub unsafe fn text_of(text: *const c_char, what: &str) -> Result<String, String> {
    if text.is_null() {
        return Err(format!("{what} is NULL"));
    }
    // SAFETY: by the contract of this function.
    utf8(unsafe { CStr::from_ptr(text) }.to_bytes().to_vec())
}

fn utf8(bytes: Vec<u8>) -> Result<String, String> {
    String::from_utf8(bytes).map_err(|error| format!("the text is not in UTF-8: {error}"))
}

/// Checks the head of a struct that the other side passes.
///
/// # Errors
/// If its version or size is not that of this interface.
pub fn check_struct(what: &str, version: u32, size: u32, expected: usize) -> Result<(), String> {
    if version != ABI_VERSION || (size as usize) < expected {
        return Err(format!(
            "{what} declares version {version} and {size} bytes, expected version {ABI_VERSION} and {expected} bytes: set \
             abi_version to DOWNBEAT_ABI_VERSION and struct_size to sizeof({what})"
        ));
    }
    Ok(())
}
