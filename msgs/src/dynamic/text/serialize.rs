//! Serialises dynamic messages with serde: maps of field names, like the generated structs.

use serde::ser::{Serialize, SerializeMap, Serializer};

use crate::dynamic::{Array, DynamicMessage, MessageRef, Messages, ValueRef};

impl Serialize for DynamicMessage {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.as_message().serialize(serializer)
    }
}

impl Serialize for MessageRef<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.fields().count()))?;
        for (name, value) in self.fields() {
            map.serialize_entry(name, &value)?;
        }
        map.end()
    }
}

impl Serialize for ValueRef<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match *self {
            Self::Bool(value) => serializer.serialize_bool(value),
            Self::Int8(value) => serializer.serialize_i8(value),
            Self::UInt8(value) => serializer.serialize_u8(value),
            Self::Int16(value) => serializer.serialize_i16(value),
            Self::UInt16(value) => serializer.serialize_u16(value),
            Self::Int32(value) => serializer.serialize_i32(value),
            Self::UInt32(value) => serializer.serialize_u32(value),
            Self::Int64(value) => serializer.serialize_i64(value),
            Self::UInt64(value) => serializer.serialize_u64(value),
            Self::Float32(value) => serializer.serialize_f32(value),
            Self::Float64(value) => serializer.serialize_f64(value),
            Self::String(text) | Self::WString(text) => serializer.serialize_str(text),
            Self::Message(message) => message.serialize(serializer),
            Self::Array(array) => array.serialize(serializer),
        }
    }
}

impl Serialize for Array {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            // Like `byte_list` for the structs.
            Self::UInt8(bytes) if !serializer.is_human_readable() => serializer.serialize_bytes(bytes),
            array => each_array!(array, values => values.serialize(serializer)),
        }
    }
}

impl Serialize for Messages {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq((0..self.len()).filter_map(|index| self.get(index)))
    }
}
