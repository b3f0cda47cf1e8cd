//! Random values of any type with `serde::Deserialize`: a deserializer that invents the requested values.

use std::fmt;

use serde::de::value::BorrowedStrDeserializer;
use serde::de::{DeserializeOwned, DeserializeSeed, Deserializer, Error, MapAccess, SeqAccess, Visitor};

/// A deterministic source of values.
pub struct Random(fuzzing::Random);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(fuzzing::Random::new(seed))
    }

    pub fn value<T: DeserializeOwned>(&mut self) -> T {
        T::deserialize(&mut *self).unwrap_or_else(|error| panic!("{}: {error}", std::any::type_name::<T>()))
    }

    fn float(&mut self) -> f64 {
        match self.0.below(12) {
            0 => 0.0,
            1 => -0.0,
            2 => f64::INFINITY,
            3 => f64::NEG_INFINITY,
            4 => f64::NAN,
            5 => f64::from(f32::MAX),
            6 => f64::MIN_POSITIVE,
            _ => (self.0.bits() as i64) as f64 / 1e12,
        }
    }

    fn text(&mut self) -> String {
        // No zero character: C strings end there.
        const CHARACTERS: [char; 8] = ['a', 'Z', ' ', '\n', '"', 'ü', '漢', '\u{1f600}'];
        (0..self.0.below(8)).map(|_| CHARACTERS[self.0.below(8)]).collect()
    }
}

/// The only error: a type that messages never have.
#[derive(Debug)]
pub struct Unsupported(String);

impl fmt::Display for Unsupported {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Unsupported {}

impl Error for Unsupported {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self(message.to_string())
    }
}

macro_rules! integers {
    ($($method:ident $visit:ident $integer:ty),*) => {$(
        fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unsupported> {
            visitor.$visit(self.0.bits() as $integer)
        }
    )*};
}

impl<'de> Deserializer<'de> for &mut Random {
    type Error = Unsupported;

    integers!(
        deserialize_i8 visit_i8 i8, deserialize_u8 visit_u8 u8, deserialize_i16 visit_i16 i16,
        deserialize_u16 visit_u16 u16, deserialize_i32 visit_i32 i32, deserialize_u32 visit_u32 u32,
        deserialize_i64 visit_i64 i64, deserialize_u64 visit_u64 u64
    );

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unsupported> {
        visitor.visit_bool(self.0.below(2) == 1)
    }

    fn deserialize_f32<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unsupported> {
        visitor.visit_f32(self.float() as f32)
    }

    fn deserialize_f64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unsupported> {
        visitor.visit_f64(self.float())
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unsupported> {
        visitor.visit_string(self.text())
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        visitor: V,
    ) -> Result<V::Value, Unsupported> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unsupported> {
        let left = [0, 1, 1, 2, 3][self.0.below(5)];
        visitor.visit_seq(Parts { random: self, left, names: &[] })
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, left: usize, visitor: V) -> Result<V::Value, Unsupported> {
        visitor.visit_seq(Parts { random: self, left, names: &[] })
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        names: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Unsupported> {
        visitor.visit_map(Parts { random: self, left: 0, names })
    }

    fn deserialize_any<V: Visitor<'de>>(self, _visitor: V) -> Result<V::Value, Unsupported> {
        Err(Unsupported("a type that messages never have".into()))
    }

    serde::forward_to_deserialize_any! {
        i128 u128 char str bytes byte_buf option unit unit_struct tuple_struct map enum identifier ignored_any
    }
}

/// The remaining elements of a sequence or fields of a struct.
struct Parts<'a> {
    random: &'a mut Random,
    left: usize,
    names: &'static [&'static str],
}

impl<'de> SeqAccess<'de> for Parts<'_> {
    type Error = Unsupported;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, Unsupported> {
        if self.left == 0 {
            return Ok(None);
        }
        self.left -= 1;
        seed.deserialize(&mut *self.random).map(Some)
    }
}

impl<'de> MapAccess<'de> for Parts<'_> {
    type Error = Unsupported;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, Unsupported> {
        match self.names.split_first() {
            Some((name, rest)) => {
                self.names = rest;
                seed.deserialize(BorrowedStrDeserializer::new(name)).map(Some)
            }
            None => Ok(None),
        }
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, Unsupported> {
        seed.deserialize(&mut *self.random)
    }
}
