//! A topic as the columns of a table.

use downbeat::table::{Cell, ColumnKind, Decoder, Survey};
use downbeat_bags::{Reader, ReaderError, RecordedTopic, Selection};
use downbeat_edge::Interfaces;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyByteArray, PyList};

use super::errors::exception;

/// The messages of a topic, a row each.
pub(super) struct Table {
    times: [Vec<i64>; 2],
    columns: Vec<(String, ColumnKind, Vec<Cell>)>,
}

/// Why a topic cannot be read as a table.
pub(super) enum TableError {
    Reader(ReaderError),
    Message(String),
}

impl Table {
    pub(super) fn read(
        reader: &Reader,
        topic: &RecordedTopic,
        selection: &Selection,
    ) -> Result<Self, TableError> {
        let fail = |error: downbeat::table::DecodeError| {
            TableError::Message(format!("{}: {error}", topic.info.name))
        };
        let decoder = Decoder::of(topic, &Interfaces::carried()).map_err(fail)?;
        // All messages determine the columns, then the rows are read.
        let mut survey = Survey::default();
        for message in reader.messages(selection.clone()).map_err(TableError::Reader)? {
            survey.see(&decoder.decode(message.map_err(TableError::Reader)?.data).map_err(fail)?);
        }
        let columns = survey.columns();
        let mut times = [Vec::new(), Vec::new()];
        let mut cells: Vec<Vec<Cell>> = columns.iter().map(|_| Vec::new()).collect();
        for message in reader.messages(selection.clone()).map_err(TableError::Reader)? {
            let message = message.map_err(TableError::Reader)?;
            times[0].push(message.log_time);
            times[1].push(message.publish_time);
            let row = columns.row(&decoder.decode(message.data).map_err(fail)?);
            cells.iter_mut().zip(row).for_each(|(column, cell)| column.push(cell));
        }
        let named = columns.iter().map(|column| (column.name.clone(), column.kind));
        Ok(Self {
            times,
            columns: named.zip(cells).map(|((name, kind), cells)| (name, kind, cells)).collect(),
        })
    }
}

impl From<TableError> for PyErr {
    fn from(error: TableError) -> Self {
        match error {
            TableError::Reader(error) => exception(error),
            TableError::Message(text) => PyValueError::new_err(text),
        }
    }
}

/// Times of receipt and of publication, and for each column its name, the type of its cells in NumPy, its
/// cells as bytes or a list, and where it has none, whether each row has a cell.
pub(super) fn to_python(py: Python<'_>, table: Table) -> PyResult<Bound<'_, PyAny>> {
    let columns = PyList::empty(py);
    for (name, kind, cells) in &table.columns {
        columns.append(column(py, name, *kind, cells)?)?;
    }
    let [received, published] = table.times.map(|times| bytes_of(&times, |time| time.to_le_bytes()));
    let times = (PyByteArray::new(py, &received), PyByteArray::new(py, &published));
    Ok((times.0, times.1, columns).into_pyobject(py)?.into_any())
}

fn column<'py>(py: Python<'py>, name: &str, kind: ColumnKind, cells: &[Cell]) -> PyResult<Bound<'py, PyAny>> {
    let dtype = match kind {
        ColumnKind::Bool => "bool",
        ColumnKind::Int => "int64",
        ColumnKind::UInt => "uint64",
        ColumnKind::Float32 => "float32",
        ColumnKind::Float64 => "float64",
        ColumnKind::Text | ColumnKind::Bytes => "object",
    };
    let is_there: Vec<u8> = cells.iter().map(|cell| u8::from(*cell != Cell::Nothing)).collect();
    let mask = is_there.contains(&0).then(|| PyByteArray::new(py, &is_there));
    let values = match kind {
        ColumnKind::Text | ColumnKind::Bytes => {
            let list = PyList::empty(py);
            for cell in cells {
                match cell {
                    Cell::Text(text) => list.append(text)?,
                    Cell::Bytes(bytes) => list.append(pyo3::types::PyBytes::new(py, bytes))?,
                    _ => list.append(py.None())?,
                }
            }
            list.into_any()
        }
        _ => {
            let bytes: Vec<u8> = match kind {
                ColumnKind::Bool => bytes_of(cells, |cell| [u8::from(*cell == Cell::Bool(true))]),
                ColumnKind::Int => {
                    bytes_of(cells, |cell| if let Cell::Int(value) = cell { *value } else { 0 }.to_le_bytes())
                }
                ColumnKind::UInt => bytes_of(cells, |cell| {
                    if let Cell::UInt(value) = cell { *value } else { 0 }.to_le_bytes()
                }),
                ColumnKind::Float32 => bytes_of(cells, |cell| {
                    if let Cell::Float32(value) = cell { *value } else { f32::NAN }.to_le_bytes()
                }),
                _ => bytes_of(cells, |cell| {
                    if let Cell::Float64(value) = cell { *value } else { f64::NAN }.to_le_bytes()
                }),
            };
            PyByteArray::new(py, &bytes).into_any()
        }
    };
    Ok((name, dtype, values, mask).into_pyobject(py)?.into_any())
}

fn bytes_of<T, const N: usize>(values: &[T], bytes: impl Fn(&T) -> [u8; N]) -> Vec<u8> {
    values.iter().flat_map(bytes).collect()
}
