//! Converts messages by the rules, in both directions.

use std::borrow::Cow;

use super::object::{Object, resolve};
use super::rules::{Rule, rule_of};
use super::schemas;
use crate::encoding::Encoding;
use crate::interchange::{Budget, Field, Kind, Problem, Schema, Shape, Value};

/// Converts a message type to and from one of Foxglove's.
#[derive(Clone)]
pub(crate) struct Mapping {
    rule: &'static Rule,
    schema: Schema,
}

impl std::fmt::Debug for Mapping {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Mapping").field(&self.rule.foxglove).finish()
    }
}

impl Mapping {
    /// Returns the mapping of a type that has a rule, if its definition matches the rule.
    pub(crate) fn new(type_name: &str, definition: &Schema, encoding: Encoding) -> Option<Self> {
        let rule = rule_of(type_name)?;
        let mut schema = schemas::schema(rule.foxglove)?;
        if encoding == Encoding::FoxgloveFlatBuffers {
            // Matrices have upper-case names in Protobuf only.
            let fields = schema.records.iter_mut().flat_map(|record| &mut record.fields);
            fields.for_each(|field| field.name.make_ascii_lowercase());
        }
        is_applicable(rule, definition, 0, &schema, 0).then_some(Self { rule, schema })
    }

    /// Foxglove's schema.
    pub(crate) fn schema(&self) -> &Schema {
        &self.schema
    }

    /// Converts a message to Foxglove's type.
    pub(crate) fn to_foxglove<'v>(
        &self,
        definition: &Schema,
        mut value: Value<'v>,
    ) -> Result<Value<'v>, Problem> {
        to_foxglove(self.rule, Object::new(definition, 0, &mut value), &self.schema, 0)
    }

    /// Converts a message to the ROS 2 type.
    pub(crate) fn to_ros<'v>(&self, definition: &Schema, mut value: Value<'v>) -> Result<Value<'v>, Problem> {
        to_ros(self.rule, Object::new(&self.schema, 0, &mut value), definition, 0)
    }
}

fn is_applicable(rule: &Rule, ros: &Schema, ros_record: usize, foxglove: &Schema, record: usize) -> bool {
    let is_same = rule.same.iter().all(|(theirs, ours)| {
        match (resolve(foxglove, record, theirs), resolve(ros, ros_record, ours)) {
            (Some((theirs, _)), Some((ours, _))) => are_alike((foxglove, theirs), (ros, ours)),
            _ => false,
        }
    });
    let is_each = rule.each.is_none_or(|(theirs, ours, element)| {
        let places = (resolve(foxglove, record, theirs), resolve(ros, ros_record, ours), rule_of(element));
        match places {
            (Some((theirs, _)), Some((ours, _)), Some(rule)) => match (theirs.kind, ours.kind) {
                (Kind::Record(theirs), Kind::Record(ours)) => {
                    is_applicable(rule, ros, ours, foxglove, theirs)
                }
                _ => false,
            },
            _ => false,
        }
    });
    is_same && is_each
}

/// Returns whether the values of one field can be converted to the other.
fn are_alike((foxglove, theirs): (&Schema, &Field), (ros, ours): (&Schema, &Field)) -> bool {
    theirs.is_list() == ours.is_list() && are_kinds_alike((foxglove, theirs.kind), (ros, ours.kind))
}

fn are_kinds_alike((foxglove, theirs): (&Schema, Kind), (ros, ours): (&Schema, Kind)) -> bool {
    match (theirs, ours) {
        (Kind::Time, Kind::Record(index)) => ros.records[index].name == "builtin_interfaces.msg.Time",
        (Kind::Record(theirs), Kind::Record(ours)) => {
            let (theirs, ours) = (&foxglove.records[theirs].fields, &ros.records[ours].fields);
            theirs.len() == ours.len()
                && theirs
                    .iter()
                    .zip(ours)
                    .all(|(a, b)| a.name == b.name && are_alike((foxglove, a), (ros, b)))
        }
        (Kind::Float64, Kind::Float64 | Kind::Float32)
        | (Kind::Fixed32, Kind::UInt32)
        | (Kind::UInt8 | Kind::Enumeration(_), Kind::UInt8)
        | (Kind::Text { .. }, Kind::Text { .. }) => true,
        _ => false,
    }
}

fn to_foxglove<'v>(
    rule: &Rule,
    mut ros: Object<'_, 'v>,
    schema: &Schema,
    record: usize,
) -> Result<Value<'v>, Problem> {
    let mut made = Value::zero(schema, Kind::Record(record), &mut Budget::for_input(0))?;
    let mut foxglove = Object::new(schema, record, &mut made);
    for (theirs, ours) in rule.same {
        let (from, value) = ros.field(ours)?;
        let value = std::mem::replace(value, Value::Absent);
        let (to, place) = foxglove.field(theirs)?;
        *place =
            convert(value, (ros.schema, from), (schema, to)).map_err(|problem| problem.in_field(ours))?;
    }
    if let Some((theirs, ours, element)) = rule.each {
        let (from, elements) = ros.take_list(ours)?;
        let to = foxglove.field(theirs)?.0.kind;
        let (Some(rule), Kind::Record(from), Kind::Record(to)) = (rule_of(element), from, to) else {
            return Err(Problem::new("is not a list of messages").in_field(ours));
        };
        let elements = elements.into_iter().enumerate().map(|(index, mut element)| {
            to_foxglove(rule, Object::new(ros.schema, from, &mut element), schema, to)
                .map_err(|problem| problem.at_index(index).in_field(ours))
        });
        foxglove.put(theirs, Value::List(elements.collect::<Result<_, _>>()?))?;
    }
    if let Some(special) = &rule.special {
        (special.to_foxglove)(&mut ros, &mut foxglove)?;
    }
    Ok(made)
}

fn to_ros<'v>(
    rule: &Rule,
    mut foxglove: Object<'_, 'v>,
    schema: &Schema,
    record: usize,
) -> Result<Value<'v>, Problem> {
    let mut made = Value::zero(schema, Kind::Record(record), &mut Budget::for_input(0))?;
    made.initialize(schema, record);
    let mut ros = Object::new(schema, record, &mut made);
    if let Some(special) = &rule.special {
        (special.to_ros)(&mut foxglove, &mut ros)?;
    }
    for (theirs, ours) in rule.same {
        let (from, value) = foxglove.field(theirs)?;
        let value = std::mem::replace(value, Value::Absent);
        let (to, place) = ros.field(ours)?;
        *place = convert(value, (foxglove.schema, from), (schema, to))
            .map_err(|problem| problem.in_field(theirs))?;
    }
    if let Some((theirs, ours, element)) = rule.each {
        let (from, elements) = foxglove.take_list(theirs)?;
        let to = ros.field(ours)?.0.kind;
        let (Some(rule), Kind::Record(from), Kind::Record(to)) = (rule_of(element), from, to) else {
            return Err(Problem::new("is not a list of messages").in_field(theirs));
        };
        let elements = elements.into_iter().enumerate().map(|(index, mut element)| {
            to_ros(rule, Object::new(foxglove.schema, from, &mut element), schema, to)
                .map_err(|problem| problem.at_index(index).in_field(theirs))
        });
        ros.put(ours, Value::List(elements.collect::<Result<_, _>>()?))?;
    }
    Ok(made)
}

/// Converts a value to the type of another field; the two [are alike](are_alike).
fn convert<'v>(
    value: Value<'v>,
    from: (&Schema, &Field),
    to: (&Schema, &Field),
) -> Result<Value<'v>, Problem> {
    match value {
        // A missing value is zero, also in lists of a fixed length.
        Value::Absent => Value::absent(to.0, to.1, &mut Budget::for_input(0)),
        Value::Packed(bytes) if bytes.is_empty() && matches!(to.1.shape, Shape::Array(_)) => {
            Value::absent(to.0, to.1, &mut Budget::for_input(0))
        }
        Value::Packed(bytes) => Ok(Value::Packed(convert_numbers(bytes, from.1.kind, to.1.kind))),
        Value::List(values) => {
            let values = values.into_iter().enumerate().map(|(index, value)| {
                convert_one(value, (from.0, from.1.kind), (to.0, to.1.kind))
                    .map_err(|problem| problem.at_index(index))
            });
            Ok(Value::List(values.collect::<Result<_, _>>()?))
        }
        value => convert_one(value, (from.0, from.1.kind), (to.0, to.1.kind)),
    }
}

fn convert_one<'v>(
    value: Value<'v>,
    from: (&Schema, Kind),
    to: (&Schema, Kind),
) -> Result<Value<'v>, Problem> {
    match (value, from.1, to.1) {
        (Value::Record(values), Kind::Record(_), Kind::Time) => match values[..] {
            [Value::Signed(sec), Value::Unsigned(nanosec)] => {
                Ok(Value::Moment { sec, nanosec: u32::try_from(nanosec).unwrap_or(u32::MAX) })
            }
            _ => Err(Problem::new("is not a time")),
        },
        (Value::Moment { sec, nanosec }, Kind::Time, Kind::Record(_)) => match i32::try_from(sec) {
            Ok(sec) => Ok(Value::Record(vec![Value::Signed(sec.into()), Value::Unsigned(nanosec.into())])),
            Err(_) => Err(Problem::new(format!("{sec} s do not fit the 32 bits of ROS 2"))),
        },
        (Value::Record(values), Kind::Record(source), Kind::Record(target)) => {
            let fields = from.0.records[source].fields.iter().zip(&to.0.records[target].fields);
            let values = values.into_iter().zip(fields).map(|(value, (source, target))| {
                convert(value, (from.0, source), (to.0, target))
                    .map_err(|problem| problem.in_field(&source.name))
            });
            Ok(Value::Record(values.collect::<Result<_, _>>()?))
        }
        (Value::Float32(value), _, Kind::Float64) => Ok(Value::Float64(value.into())),
        (Value::Float64(value), _, Kind::Float32) => Ok(Value::Float32(value as f32)),
        (value, ..) => Ok(value),
    }
}

fn convert_numbers<'v>(bytes: Cow<'v, [u8]>, from: Kind, to: Kind) -> Cow<'v, [u8]> {
    match (from, to) {
        (Kind::Float32, Kind::Float64) => {
            let singles = bytes.as_chunks().0.iter().map(|single| f32::from_le_bytes(*single));
            singles.flat_map(|single| f64::from(single).to_le_bytes()).collect()
        }
        (Kind::Float64, Kind::Float32) => {
            let doubles = bytes.as_chunks().0.iter().map(|double| f64::from_le_bytes(*double));
            doubles.flat_map(|double| (double as f32).to_le_bytes()).collect()
        }
        _ => bytes,
    }
}
