//! Structs from values in which floating-point numbers are strings of their bits.

use serde::de::value::{MapDeserializer, SeqDeserializer, StringDeserializer};
use serde::de::{DeserializeOwned, Deserializer, Error as _, IntoDeserializer, Visitor};
use serde_json::{Error, Value};

/// The struct that has that value.
pub fn from_exact<T: DeserializeOwned>(value: &Value) -> T {
    T::deserialize(Exact(value)).unwrap_or_else(|error| panic!("{}: {error}", std::any::type_name::<T>()))
}

#[derive(Clone, Copy)]
struct Exact<'a>(&'a Value);

impl Exact<'_> {
    fn bits(self) -> Result<u64, Error> {
        let digits = self.0.as_str().ok_or_else(|| Error::custom(format!("{} for a number", self.0)))?;
        u64::from_str_radix(digits, 16).map_err(Error::custom)
    }
}

impl<'de> Deserializer<'de> for Exact<'_> {
    type Error = Error;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        match self.0 {
            Value::Array(values) => visitor.visit_seq(SeqDeserializer::new(values.iter().map(Exact))),
            Value::Object(fields) => {
                let entries =
                    fields.iter().map(|(name, value)| (StringDeserializer::new(name.clone()), Exact(value)));
                visitor.visit_map(MapDeserializer::new(entries))
            }
            plain => plain.clone().deserialize_any(visitor),
        }
    }

    fn deserialize_f32<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        let bits = u32::try_from(self.bits()?).map_err(Error::custom)?;
        visitor.visit_f32(f32::from_bits(bits))
    }

    fn deserialize_f64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_f64(f64::from_bits(self.bits()?))
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, Error> {
        visitor.visit_newtype_struct(self)
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 char str string bytes byte_buf option unit unit_struct seq tuple
        tuple_struct map struct enum identifier ignored_any
    }
}

impl<'de> IntoDeserializer<'de, Error> for Exact<'_> {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

/// The first difference between two values; `None` if they are equal.
pub fn first_difference(expected: &Value, found: &Value) -> Option<String> {
    match (expected, found) {
        (Value::Array(expected), Value::Array(found)) if expected.len() == found.len() => {
            let mut pairs = expected.iter().zip(found).enumerate();
            pairs.find_map(|(index, (a, b))| Some(format!("[{index}]{}", first_difference(a, b)?)))
        }
        (Value::Object(expected), Value::Object(found)) if expected.keys().eq(found.keys()) => {
            let mut pairs = expected.iter().zip(found.values());
            pairs.find_map(|((name, a), b)| Some(format!(".{name}{}", first_difference(a, b)?)))
        }
        (expected, found) if expected == found => None,
        (expected, found) => Some(format!(": expected {expected}, found {found}")),
    }
}
