//! Reads and writes values with serde, for formats without a schema: the same JSON and CBOR as for the
//! structs.

use std::cell::RefCell;
use std::fmt;

use serde::de::{DeserializeSeed, Error as _, IgnoredAny, MapAccess, SeqAccess, Unexpected, Visitor};
use serde::ser::{Error as _, SerializeMap, SerializeSeq};
use serde::{Deserializer, Serialize, Serializer};

use super::{Budget, Field, Kind, Problem, Schema, Value};

#[cfg(feature = "json")]
pub(crate) fn to_json(schema: &Schema, value: &Value<'_>) -> Result<Vec<u8>, Problem> {
    let node = Node { schema, kind: Kind::Record(0), value };
    serde_json::to_vec(&node).map_err(|error| Problem::new(error.to_string()))
}

#[cfg(feature = "json")]
pub(crate) fn from_json<'a>(schema: &Schema, bytes: &'a [u8]) -> Result<Value<'a>, Problem> {
    let budget = RefCell::new(Budget::for_input(bytes.len()));
    let mut deserializer = serde_json::Deserializer::from_slice(bytes);
    let value = Seed { schema, kind: Kind::Record(0), budget: &budget }.deserialize(&mut deserializer);
    value
        .and_then(|value| deserializer.end().map(|()| value))
        .map_err(|error| Problem::new(error.to_string()))
}

#[cfg(feature = "cbor")]
pub(crate) fn to_cbor(schema: &Schema, value: &Value<'_>) -> Result<Vec<u8>, Problem> {
    let node = Node { schema, kind: Kind::Record(0), value };
    cbor4ii::serde::to_vec(Vec::new(), &node).map_err(|error| Problem::new(error.to_string()))
}

#[cfg(feature = "cbor")]
pub(crate) fn from_cbor<'a>(schema: &Schema, bytes: &'a [u8]) -> Result<Value<'a>, Problem> {
    use cbor4ii::core::{dec::Read, utils::SliceReader};

    let budget = RefCell::new(Budget::for_input(bytes.len()));
    let mut deserializer = cbor4ii::serde::Deserializer::new(SliceReader::new(bytes));
    let value = Seed { schema, kind: Kind::Record(0), budget: &budget }
        .deserialize(&mut deserializer)
        .map_err(|error| Problem::new(error.to_string()))?;
    match deserializer.into_inner().fill(1) {
        Ok(rest) if rest.as_ref().is_empty() => Ok(value),
        _ => Err(Problem::new("there are bytes after the value")),
    }
}

/// A value to serialise.
struct Node<'n> {
    schema: &'n Schema,
    kind: Kind,
    value: &'n Value<'n>,
}

impl Serialize for Node<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self { schema, kind, value } = *self;
        match value {
            Value::Bool(value) => serializer.serialize_bool(*value),
            Value::Signed(value) => serializer.serialize_i64(*value),
            Value::Unsigned(value) => serializer.serialize_u64(*value),
            Value::Float32(value) => serializer.serialize_f32(*value),
            Value::Float64(value) => serializer.serialize_f64(*value),
            Value::Text(text) => serializer.serialize_str(text),
            Value::Absent => serializer.serialize_none(),
            Value::Moment { sec, nanosec } => {
                let mut map = serializer.serialize_map(Some(2))?;
                map.serialize_entry("sec", sec)?;
                map.serialize_entry("nanosec", nanosec)?;
                map.end()
            }
            Value::Packed(bytes) if kind == Kind::UInt8 && !serializer.is_human_readable() => {
                serializer.serialize_bytes(bytes)
            }
            Value::Packed(bytes) => {
                let width = kind.width().unwrap_or(1);
                let mut list = serializer.serialize_seq(Some(bytes.len() / width))?;
                for number in bytes.chunks_exact(width) {
                    let value = &Value::from_packed(kind, number);
                    list.serialize_element(&Node { schema, kind, value })?;
                }
                list.end()
            }
            Value::List(values) => {
                let mut list = serializer.serialize_seq(Some(values.len()))?;
                for value in values {
                    list.serialize_element(&Node { schema, kind, value })?;
                }
                list.end()
            }
            Value::Record(values) => {
                let Kind::Record(index) = kind else {
                    return Err(S::Error::custom("a record where the schema has none"));
                };
                let mut map = serializer.serialize_map(Some(values.len()))?;
                for (field, value) in schema.records[index].fields.iter().zip(values) {
                    map.serialize_entry(&field.name, &Node { schema, kind: field.kind, value })?;
                }
                map.end()
            }
        }
    }
}

/// Deserialises one value of a kind.
#[derive(Clone, Copy)]
struct Seed<'s> {
    schema: &'s Schema,
    kind: Kind,
    budget: &'s RefCell<Budget>,
}

/// Deserialises the content of a field.
struct FieldSeed<'s> {
    seed: Seed<'s>,
    field: &'s Field,
}

impl Seed<'_> {
    fn spend<E: serde::de::Error>(self, bytes: usize) -> Result<(), E> {
        self.budget.borrow_mut().spend(bytes).map_err(|problem| E::custom(problem.text))
    }

    fn integer<E: serde::de::Error>(self, integer: i128, found: Unexpected<'_>) -> Result<Value<'static>, E> {
        match self.kind {
            Kind::Float32 => Ok(Value::Float32(integer as f32)),
            Kind::Float64 => Ok(Value::Float64(integer as f64)),
            kind => Value::integer(kind, integer).ok_or_else(|| E::invalid_value(found, &self)),
        }
    }
}

impl<'de> DeserializeSeed<'de> for Seed<'_> {
    type Value = Value<'de>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        self.spend(size_of::<Value<'_>>())?;
        match self.kind {
            Kind::Record(_) => deserializer.deserialize_map(self),
            Kind::Text { .. } | Kind::WideText { .. } => deserializer.deserialize_string(self),
            _ => deserializer.deserialize_any(self),
        }
    }
}

impl<'de> Visitor<'de> for Seed<'_> {
    type Value = Value<'de>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.kind {
            Kind::Record(index) => write!(f, "a map with the fields of {}", self.schema.records[index].name),
            kind => write!(f, "a value of {kind:?}"),
        }
    }

    fn visit_bool<E: serde::de::Error>(self, value: bool) -> Result<Self::Value, E> {
        match self.kind {
            Kind::Bool => Ok(Value::Bool(value)),
            _ => Err(E::invalid_type(Unexpected::Bool(value), &self)),
        }
    }

    fn visit_i64<E: serde::de::Error>(self, value: i64) -> Result<Self::Value, E> {
        self.integer(value.into(), Unexpected::Signed(value))
    }

    fn visit_u64<E: serde::de::Error>(self, value: u64) -> Result<Self::Value, E> {
        self.integer(value.into(), Unexpected::Unsigned(value))
    }

    fn visit_f64<E: serde::de::Error>(self, value: f64) -> Result<Self::Value, E> {
        match self.kind {
            Kind::Float32 => Ok(Value::Float32(value as f32)),
            Kind::Float64 => Ok(Value::Float64(value)),
            _ => Err(E::invalid_type(Unexpected::Float(value), &self)),
        }
    }

    /// `null` is a number that JSON cannot represent.
    fn visit_unit<E: serde::de::Error>(self) -> Result<Self::Value, E> {
        match self.kind {
            Kind::Float32 | Kind::Float64 => self.visit_f64(f64::NAN),
            _ => Err(E::invalid_type(Unexpected::Unit, &self)),
        }
    }

    fn visit_none<E: serde::de::Error>(self) -> Result<Self::Value, E> {
        self.visit_unit()
    }

    fn visit_borrowed_str<E: serde::de::Error>(self, text: &'de str) -> Result<Self::Value, E> {
        match self.kind {
            Kind::Text { .. } | Kind::WideText { .. } => Ok(Value::Text(text.into())),
            _ => Err(E::invalid_type(Unexpected::Str(text), &self)),
        }
    }

    fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<Self::Value, E> {
        self.visit_string(text.to_owned())
    }

    fn visit_string<E: serde::de::Error>(self, text: String) -> Result<Self::Value, E> {
        match self.kind {
            Kind::Text { .. } | Kind::WideText { .. } => Ok(Value::Text(text.into())),
            _ => Err(E::invalid_type(Unexpected::Str(&text), &self)),
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let Kind::Record(index) = self.kind else {
            return Err(A::Error::invalid_type(Unexpected::Map, &self));
        };
        let fields = &self.schema.records[index].fields;
        self.spend(size_of::<Value<'_>>() * fields.len())?;
        let mut values: Vec<Option<Value<'de>>> = vec![None; fields.len()];
        while let Some(key) = map.next_key::<String>()? {
            match fields.iter().position(|field| field.name == key) {
                Some(index) if values[index].is_some() => {
                    return Err(A::Error::custom(format!("duplicate field `{key}`")));
                }
                Some(index) => {
                    let seed =
                        FieldSeed { seed: Seed { kind: fields[index].kind, ..self }, field: &fields[index] };
                    values[index] = Some(map.next_value_seed(seed)?);
                }
                None => {
                    map.next_value::<IgnoredAny>()?;
                }
            }
        }
        let values = fields.iter().zip(values).map(|(field, value)| {
            value.ok_or_else(|| A::Error::custom(format!("missing field `{}`", field.name)))
        });
        Ok(Value::Record(values.collect::<Result<_, _>>()?))
    }
}

impl<'de> DeserializeSeed<'de> for FieldSeed<'_> {
    type Value = Value<'de>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        let name = &self.field.name;
        let value = if !self.field.is_list() {
            self.seed.deserialize(deserializer)
        } else if self.seed.kind == Kind::UInt8 && !deserializer.is_human_readable() {
            deserializer.deserialize_byte_buf(self)
        } else {
            deserializer.deserialize_seq(self)
        };
        value.map_err(|error| D::Error::custom(format!("field `{name}`: {error}")))
    }
}

impl<'de> Visitor<'de> for FieldSeed<'_> {
    type Value = Value<'de>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a list of {:?}", self.field.kind)
    }

    fn visit_borrowed_bytes<E: serde::de::Error>(self, bytes: &'de [u8]) -> Result<Self::Value, E> {
        self.field.check_count(bytes.len()).map_err(|problem| E::custom(problem.text))?;
        Ok(Value::Packed(bytes.into()))
    }

    fn visit_bytes<E: serde::de::Error>(self, bytes: &[u8]) -> Result<Self::Value, E> {
        self.visit_byte_buf(bytes.to_vec())
    }

    fn visit_byte_buf<E: serde::de::Error>(self, bytes: Vec<u8>) -> Result<Self::Value, E> {
        self.field.check_count(bytes.len()).map_err(|problem| E::custom(problem.text))?;
        Ok(Value::Packed(bytes.into()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut elements: A) -> Result<Self::Value, A::Error> {
        let FieldSeed { seed, field } = self;
        let (mut packed, mut list) = (Vec::new(), Vec::new());
        let mut count = 0;
        while let Some(value) = elements.next_element_seed(seed)? {
            match (field.kind.width(), value.bits()) {
                (Some(width), Some(bits)) => packed.extend_from_slice(&bits.to_le_bytes()[..width]),
                _ => list.push(value),
            }
            count += 1;
        }
        field.check_count(count).map_err(|problem| A::Error::custom(problem.text))?;
        Ok(if field.kind.width().is_some() { Value::Packed(packed.into()) } else { Value::List(list) })
    }
}
