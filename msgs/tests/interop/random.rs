//! Random values of any type, generated from its definition.

use downbeat_msgs_definitions::{Catalog, Element, FieldType, Primitive, Shape, TypeName};
use fuzzing::Random;
use serde_json::{Map, Value};

/// A value of a message, with floating-point numbers as hexadecimal strings of their bits, so that each bit
/// counts, and JSON can represent infinities and NaN.
///
/// The same seed, name and number give the same value.
pub fn random_message(catalog: &Catalog, name: &TypeName, seed: u64, number: usize) -> Value {
    // FNV-1a.
    let text = format!("{name} {number}");
    let seed = text.bytes().fold(seed, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3));
    Values { catalog, random: Random::new(seed) }.message(name, 0)
}

/// Characters whose UTF-8 and UTF-16 have each length. None is zero: C strings end there.
const CHARACTERS: [char; 14] = [
    'a',
    'Z',
    ' ',
    '\t',
    '\n',
    '"',
    '\\',
    '\u{7f}',
    'ü',
    '\u{7ff}',
    '漢',
    '\u{ffff}',
    '\u{1f600}',
    '\u{10ffff}',
];

/// Lengths of sequences, shorter on deeper levels: nested messages grow quickly.
const LENGTHS_OF_MESSAGES: [&[u64]; 3] = [&[0, 1, 2, 3], &[0, 1, 2], &[0, 0, 1]];
const LENGTHS: [&[u64]; 3] = [&[0, 1, 3, 17], &[0, 1, 2, 3], &[0, 1, 2]];

struct Values<'a> {
    catalog: &'a Catalog,
    random: Random,
}

impl Values<'_> {
    fn message(&mut self, name: &TypeName, depth: usize) -> Value {
        let fields = &self.catalog.message(name).unwrap_or_else(|error| panic!("{error}")).fields;
        let values = fields.iter().map(|field| (field.name.clone(), self.field(&field.field_type, depth)));
        Value::Object(values.collect::<Map<_, _>>())
    }

    fn field(&mut self, field_type: &FieldType, depth: usize) -> Value {
        let element = &field_type.element;
        let bound = match field_type.shape {
            Shape::Single => return self.element(element, depth),
            Shape::Array(count) => return (0..count).map(|_| self.element(element, depth)).collect(),
            Shape::Bounded(bound) => Some(bound),
            Shape::Sequence => None,
        };
        let is_of_messages = matches!(element, Element::Message(_));
        let lengths = if is_of_messages { LENGTHS_OF_MESSAGES } else { LENGTHS };
        let length = match bound {
            Some(bound) if depth < 2 && self.random.below(10) < 3 => bound,
            _ => (*self.random.choose(lengths[depth.min(2)])).min(bound.unwrap_or(u64::MAX)),
        };
        (0..length).map(|_| self.element(element, depth)).collect()
    }

    fn element(&mut self, element: &Element, depth: usize) -> Value {
        match element {
            Element::Primitive(primitive) => self.primitive(*primitive),
            Element::String { bound } => self.text(*bound, char::len_utf8).into(),
            Element::WString { bound } => self.text(*bound, char::len_utf16).into(),
            Element::Message(name) => self.message(name, depth + 1),
        }
    }

    fn primitive(&mut self, primitive: Primitive) -> Value {
        match (primitive, primitive.range()) {
            (Primitive::Float32, _) => format!("{:08x}", self.float32()).into(),
            (Primitive::Float64, _) => format!("{:016x}", self.float64()).into(),
            (_, Some((least, greatest))) => {
                let between = least + i128::from(self.random.bits()) % (greatest - least + 1);
                let value = *self.random.choose(&[least, greatest, 0, between]);
                i64::try_from(value).map_or_else(|_| (value as u64).into(), Value::from)
            }
            (_, None) => (self.random.below(2) == 1).into(),
        }
    }

    /// The bits of a number; of NaNs only those that conversions between the two sizes preserve.
    fn float32(&mut self) -> u32 {
        let edges = [0, 1 << 31, 0x7f80_0000, 0xff80_0000, 0x7fc0_0000, 0xffc1_2345, 1, 0x7f7f_ffff];
        let bits =
            if self.random.below(3) == 0 { *self.random.choose(&edges) } else { self.random.bits() as u32 };
        if f32::from_bits(bits).is_nan() { bits | 1 << 22 } else { bits }
    }

    fn float64(&mut self) -> u64 {
        let edges =
            [0, 1 << 63, 0x7ff << 52, 0xfff << 52, 0x7ff8 << 48, 0xfff8_0000_0001_2345, 1, (0x7ff << 52) - 1];
        let bits = if self.random.below(3) == 0 { *self.random.choose(&edges) } else { self.random.bits() };
        if f64::from_bits(bits).is_nan() { bits | 1 << 51 } else { bits }
    }

    fn text(&mut self, bound: Option<u64>, size: fn(char) -> usize) -> String {
        if let Some(bound) = bound.filter(|_| self.random.below(10) < 3) {
            return "x".repeat(bound as usize);
        }
        let mut text = String::new();
        let mut left = bound.map_or(usize::MAX, |bound| bound as usize);
        for _ in 0..*self.random.choose(&[0, 0, 1, 3, 8, 25]) {
            let character = *self.random.choose(&CHARACTERS);
            match left.checked_sub(size(character)) {
                Some(rest) => left = rest,
                None => break,
            }
            text.push(character);
        }
        text
    }
}
