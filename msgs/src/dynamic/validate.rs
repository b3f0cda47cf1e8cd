//! Whether bytes are a message of a type, without the message: several times faster than reading it.

use downbeat_msgs_definitions::{Element, FieldType, Primitive, Shape};

use super::DynamicType;
use super::model::FieldLayout;
use super::wire::decode_value;
use crate::WString;
use crate::cdr::{self, Cdr, FromReader, Problem, Reader, Text};

impl DynamicType {
    /// Checks that a serialised message, including the header, is one of this type: with the same result as
    /// [`DynamicMessage::from_cdr`](super::DynamicMessage::from_cdr), but without memory for its values.
    ///
    /// # Errors
    /// See [`cdr::from_slice`].
    pub fn validate_cdr(&self, bytes: &[u8]) -> cdr::Result<()> {
        message(self, self.index(), &mut Reader::new(bytes)?)
    }
}

fn message(of: &DynamicType, index: usize, reader: &mut Reader<'_>) -> cdr::Result<()> {
    let layout = of.layout().message(index);
    reader.message(|reader| {
        if layout.fields.is_empty() {
            return reader.empty_message();
        }
        let mut fields = layout.fields.iter();
        fields.try_for_each(|field| value(of, field, reader).map_err(|error| error.in_field(&field.name)))
    })
}

fn value(of: &DynamicType, field: &FieldLayout, reader: &mut Reader<'_>) -> cdr::Result<()> {
    let FieldType { element, shape } = &field.field_type;
    if *shape == Shape::Single {
        return match element {
            Element::Message(_) => message(of, field.nested, reader),
            Element::String { bound } => text(*bound, reader),
            Element::Primitive(_) | Element::WString { .. } => decode_value(of, field, reader).map(drop),
        };
    }
    let is_primitive = matches!(element, Element::Primitive(_));
    reader.elements(is_primitive, |reader| elements(of, field, reader))
}

fn elements(of: &DynamicType, field: &FieldLayout, reader: &mut Reader<'_>) -> cdr::Result<()> {
    let FieldType { element, shape } = &field.field_type;
    match element {
        Element::Primitive(Primitive::Bool) => {
            let count = reader.length_of(*shape, bool::LEAST_SIZE)?;
            bool::decode_vec(count, reader).map(drop)
        }
        Element::Primitive(primitive) => {
            let size = primitive.size();
            let count = reader.length_of(*shape, size)?;
            if count > 0 {
                // Without elements, there is no padding either.
                reader.align(size)?;
                reader.bytes(count.saturating_mul(size))?;
            }
            Ok(())
        }
        Element::String { bound } => {
            let count = reader.length_of(*shape, String::LEAST_SIZE)?;
            (0..count).try_for_each(|index| text(*bound, reader).map_err(|error| error.at_index(index)))
        }
        Element::WString { bound } => {
            let count = reader.length_of(*shape, WString::LEAST_SIZE)?;
            let texts = WString::decode_vec(count, reader)?;
            within(texts.longest(), *bound, reader)
        }
        Element::Message(_) => {
            let least_size = of.layout().message(field.nested).least_size;
            let count = reader.length_of(*shape, least_size)?;
            (0..count).try_for_each(|index| {
                message(of, field.nested, reader).map_err(|error| error.at_index(index))
            })
        }
    }
}

fn text(bound: Option<u64>, reader: &mut Reader<'_>) -> cdr::Result<()> {
    let text = <&str>::from_reader(reader)?;
    within(text.len(), bound, reader)
}

fn within(found: usize, bound: Option<u64>, reader: &Reader<'_>) -> cdr::Result<()> {
    let Some(bound) = bound else { return Ok(()) };
    let bound = usize::try_from(bound).unwrap_or(usize::MAX);
    if found > bound { Err(reader.error(Problem::Bound { found, bound })) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::super::DynamicMessage;
    use super::*;

    const DEFINITION: &str = "\
bool[] flags
string<=5 name
string[2] pair
string<=3[] words
wstring wide
wstring<=4[<=2] wides
float64[] numbers
uint8[3] bytes
Point[] points
Point one
Nothing nothing
================================================================================
MSG: demo_msgs/Point
float32 x
int64 y
bool z
================================================================================
MSG: demo_msgs/Nothing
";

    #[test]
    fn the_same_bytes_are_valid_as_for_reading() {
        let of = DynamicType::from_definition_text("demo_msgs/msg/All", "ros2msg", DEFINITION).unwrap();
        let mut message = DynamicMessage::new(&of);
        message.set("name", "abc").unwrap();
        message.set("flags", vec![true, false, true]).unwrap();
        message.set("numbers", vec![1.0, 2.5]).unwrap();
        let mut state = 7_u32;
        let mut random = |below: usize| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as usize % below.max(1)
        };
        let whole = message.to_cdr();
        let mut tally = [0, 0];
        for _ in 0..20_000 {
            let mut bytes = whole.clone();
            for _ in 0..random(3) {
                let at = random(bytes.len());
                bytes[at] = [0, 1, 2, 3, 4, 7, 255, 128][random(8)];
            }
            if random(8) == 0 {
                bytes.truncate(random(bytes.len()));
            }
            let read = DynamicMessage::from_cdr(&of, &bytes).is_ok();
            assert_eq!(of.validate_cdr(&bytes).is_ok(), read, "{bytes:?}");
            tally[usize::from(read)] += 1;
        }
        assert!(tally.iter().all(|count| *count > 1000), "{tally:?}");
    }
}
