//! The columns of a table and the cells of a row.

use std::collections::{BTreeMap, BTreeSet};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use downbeat_msgs::dynamic::{Array, DynamicMessage, MessageRef, ValueRef};
use serde_json::Value as Json;

use super::{MOST_ELEMENTS, Place, Visit, visit};

/// A column.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Column {
    /// The path of the field: `position[3]`.
    pub name: String,
    /// The type of its cells.
    pub kind: ColumnKind,
}

/// The type of the cells of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "named as what it holds")]
pub enum ColumnKind {
    Bool,
    /// Integers that fit into an `i64`.
    Int,
    /// `uint64`.
    UInt,
    Float32,
    Float64,
    /// Text; also arrays of many elements as JSON.
    Text,
    Bytes,
}

/// A cell of a row.
#[derive(Clone, Debug, PartialEq)]
#[expect(missing_docs, reason = "named as what it holds")]
pub enum Cell {
    /// Empty: the sequence in this row is shorter than in other rows.
    Nothing,
    Bool(bool),
    Int(i64),
    UInt(u64),
    Float32(f32),
    Float64(f64),
    Text(String),
    Bytes(Vec<u8>),
}

impl Cell {
    /// Returns the text for CSV: numbers in a form that parses to the same bits, bytes in Base64 (RFC 4648).
    #[must_use]
    pub fn to_text(&self) -> String {
        match self {
            Self::Nothing => String::new(),
            Self::Bool(value) => value.to_string(),
            Self::Int(value) => value.to_string(),
            Self::UInt(value) => value.to_string(),
            Self::Float32(value) => value.to_string(),
            Self::Float64(value) => value.to_string(),
            Self::Text(text) => text.clone(),
            Self::Bytes(bytes) => STANDARD.encode(bytes),
        }
    }
}

/// Determines the columns of a table from all messages, which define the lengths of its sequences.
#[derive(Debug, Default)]
pub struct Survey {
    leaves: BTreeMap<Place, Column>,
    whole: BTreeSet<Place>,
}

impl Survey {
    /// Takes a message into account.
    pub fn see(&mut self, message: &DynamicMessage) {
        visit(message.as_message(), self);
    }

    /// Returns the columns for all messages that were taken into account.
    #[must_use]
    pub fn columns(mut self) -> Columns {
        // If an array turned out too long, its first elements get no columns either.
        for place in &self.whole {
            self.leaves.retain(|leaf, _| !(leaf.len() > place.len() && leaf.starts_with(place)));
        }
        let indices = self.leaves.keys().enumerate().map(|(index, place)| (place.clone(), index)).collect();
        Columns { columns: self.leaves.into_values().collect(), indices, whole: self.whole }
    }
}

impl Visit for Survey {
    fn leaf(&mut self, place: &[usize], path: &str, value: ValueRef<'_>) {
        if !self.leaves.contains_key(place) {
            let column = Column { name: path.to_owned(), kind: kind_of(value) };
            self.leaves.insert(place.to_vec(), column);
        }
    }

    fn is_whole(&mut self, place: &[usize], array: &Array) -> bool {
        let is_new = matches!(array, Array::UInt8(_)) || array.len() > MOST_ELEMENTS;
        if is_new {
            self.whole.insert(place.to_vec());
        }
        is_new || self.whole.contains(place)
    }
}

/// The columns of a table, in the order of the fields.
#[derive(Debug)]
pub struct Columns {
    columns: Vec<Column>,
    indices: BTreeMap<Place, usize>,
    whole: BTreeSet<Place>,
}

impl Columns {
    /// Iterates over the columns.
    pub fn iter(&self) -> impl Iterator<Item = &Column> {
        self.columns.iter()
    }

    /// Returns the cells of a message, one per column. Fields without a column, which the survey did not see,
    /// are omitted.
    #[must_use]
    pub fn row(&self, message: &DynamicMessage) -> Vec<Cell> {
        let mut row = Row { columns: self, cells: vec![Cell::Nothing; self.columns.len()] };
        visit(message.as_message(), &mut row);
        row.cells
    }
}

struct Row<'a> {
    columns: &'a Columns,
    cells: Vec<Cell>,
}

impl Visit for Row<'_> {
    fn leaf(&mut self, place: &[usize], _: &str, value: ValueRef<'_>) {
        if let Some(&index) = self.columns.indices.get(place) {
            self.cells[index] = cell_of(value);
        }
    }

    fn is_whole(&mut self, place: &[usize], _: &Array) -> bool {
        self.columns.whole.contains(place)
    }
}

fn kind_of(value: ValueRef<'_>) -> ColumnKind {
    match value {
        ValueRef::Bool(_) => ColumnKind::Bool,
        ValueRef::UInt64(_) => ColumnKind::UInt,
        ValueRef::Float32(_) => ColumnKind::Float32,
        ValueRef::Float64(_) => ColumnKind::Float64,
        ValueRef::Array(Array::UInt8(_)) => ColumnKind::Bytes,
        ValueRef::String(_) | ValueRef::WString(_) | ValueRef::Array(_) | ValueRef::Message(_) => {
            ColumnKind::Text
        }
        _ => ColumnKind::Int,
    }
}

fn cell_of(value: ValueRef<'_>) -> Cell {
    match value {
        ValueRef::Bool(value) => Cell::Bool(value),
        ValueRef::UInt64(value) => Cell::UInt(value),
        ValueRef::Float32(value) => Cell::Float32(value),
        ValueRef::Float64(value) => Cell::Float64(value),
        ValueRef::String(text) | ValueRef::WString(text) => Cell::Text(text.to_owned()),
        ValueRef::Array(Array::UInt8(bytes)) => Cell::Bytes(bytes.clone()),
        ValueRef::Array(_) | ValueRef::Message(_) => Cell::Text(json(value).to_string()),
        other => other.as_i64().map_or(Cell::Nothing, Cell::Int),
    }
}

fn json(value: ValueRef<'_>) -> Json {
    match value {
        ValueRef::Bool(value) => value.into(),
        ValueRef::UInt64(value) => value.into(),
        // JSON has no NaN and no infinity; they become null.
        ValueRef::Float32(value) => value.into(),
        ValueRef::Float64(value) => value.into(),
        ValueRef::String(text) | ValueRef::WString(text) => text.into(),
        ValueRef::Message(message) => object(message),
        ValueRef::Array(array) => array.iter().map(json).collect(),
        other => other.as_i64().into(),
    }
}

fn object(message: MessageRef<'_>) -> Json {
    message.fields().map(|(name, value)| (name.to_owned(), json(value))).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use downbeat_msgs::dynamic::DynamicType;

    use super::*;

    const TEXT: &str = "bool on\nuint64 count\nfloat32 mass\nuint8[] data\nPart[] parts\nint16[] many\n\
        ================================================================================\n\
        MSG: my_msgs/Part\nint32 id\nfloat64[2] at\n";

    fn message(change: impl Fn(&mut DynamicMessage)) -> DynamicMessage {
        let of = DynamicType::from_definition_text("my_msgs/msg/Robot", "ros2msg", TEXT).unwrap();
        let mut message = DynamicMessage::new(&of);
        change(&mut message);
        message
    }

    #[test]
    fn columns_are_in_the_order_of_the_fields_for_any_order_of_messages() {
        let short = message(|message| message.set("count", u64::MAX).unwrap());
        let long = message(|message| {
            message.resize("parts", 1).unwrap();
            message.set("parts[0].at", vec![1.5, f64::NAN]).unwrap();
            message.set("data", vec![1_u8, 2, 255]).unwrap();
        });
        let mut survey = Survey::default();
        for message in [&short, &long] {
            survey.see(message);
        }
        let columns = survey.columns();
        let names: Vec<_> = columns.iter().map(|column| column.name.as_str()).collect();
        assert_eq!(names, ["on", "count", "mass", "data", "parts[0].id", "parts[0].at[0]", "parts[0].at[1]"]);
        let texts: Vec<_> = columns.row(&long).iter().map(Cell::to_text).collect();
        assert_eq!(texts, ["false", "0", "0", "AQL/", "0", "1.5", "NaN"]);
        let row = columns.row(&short);
        assert_eq!((&row[1], &row[4]), (&Cell::UInt(u64::MAX), &Cell::Nothing));
    }

    #[test]
    fn an_array_of_many_elements_has_one_column_in_all_rows() {
        let few = message(|message| message.set("many", vec![1_i16, 2]).unwrap());
        let many = message(|message| message.set("many", vec![7_i16; MOST_ELEMENTS + 1]).unwrap());
        for order in [[&few, &many], [&many, &few]] {
            let mut survey = Survey::default();
            for message in order {
                survey.see(message);
            }
            let columns = survey.columns();
            assert_eq!(columns.iter().last().unwrap().name, "many");
            assert_eq!(columns.row(&few).last(), Some(&Cell::Text("[1,2]".to_owned())));
        }
    }
}
