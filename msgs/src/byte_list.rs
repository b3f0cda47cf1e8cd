//! Serde for arrays and sequences of bytes: `#[serde(with = "byte_list")]`.
//!
//! Human-readable formats (JSON, YAML) get a list of numbers, as for numbers of any other size; other formats
//! get a byte string, which is half as long as a list in CBOR and is copied as a whole. Both are accepted
//! when reading.

use std::fmt;

use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserializer, Serializer};

/// Writes bytes.
///
/// # Errors
/// Those of the serializer.
pub fn serialize<S: Serializer, T: AsRef<[u8]>>(bytes: &T, serializer: S) -> Result<S::Ok, S::Error> {
    if serializer.is_human_readable() {
        serializer.collect_seq(bytes.as_ref())
    } else {
        serializer.serialize_bytes(bytes.as_ref())
    }
}

/// Reads bytes.
///
/// # Errors
/// Those of the deserializer.
pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<u8>, D::Error> {
    if deserializer.is_human_readable() {
        deserializer.deserialize_seq(Bytes)
    } else {
        deserializer.deserialize_byte_buf(Bytes)
    }
}

/// The same for arrays: `#[serde(with = "byte_list::array")]`.
pub mod array {
    use serde::de::Error;
    use serde::{Deserializer, Serializer};

    use super::Bytes;

    /// Writes bytes.
    ///
    /// # Errors
    /// Those of the serializer.
    pub fn serialize<S: Serializer, const N: usize>(
        bytes: &[u8; N],
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        super::serialize(bytes, serializer)
    }

    /// Reads bytes.
    ///
    /// # Errors
    /// Those of the deserializer, and if there are not exactly `N`.
    pub fn deserialize<'de, D: Deserializer<'de>, const N: usize>(
        deserializer: D,
    ) -> Result<[u8; N], D::Error> {
        let bytes = if deserializer.is_human_readable() {
            deserializer.deserialize_tuple(N, Bytes)?
        } else {
            deserializer.deserialize_byte_buf(Bytes)?
        };
        let found = bytes.len();
        bytes.try_into().map_err(|_| D::Error::invalid_length(found, &&*format!("{N} bytes")))
    }
}

/// The maximum number of bytes reserved in advance.
const MOST_AT_ONCE: usize = 1 << 20;

struct Bytes;

impl<'de> Visitor<'de> for Bytes {
    type Value = Vec<u8>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("bytes, or a list of numbers below 256")
    }

    fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<Vec<u8>, E> {
        Ok(bytes.to_vec())
    }

    fn visit_byte_buf<E: Error>(self, bytes: Vec<u8>) -> Result<Vec<u8>, E> {
        Ok(bytes)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut elements: A) -> Result<Vec<u8>, A::Error> {
        let mut bytes = Vec::with_capacity(elements.size_hint().unwrap_or(0).min(MOST_AT_ONCE));
        while let Some(byte) = elements.next_element()? {
            bytes.push(byte);
        }
        Ok(bytes)
    }
}
