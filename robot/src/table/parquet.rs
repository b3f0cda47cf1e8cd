//! Tables as files of Apache Parquet, <https://parquet.apache.org/docs/file-format/>.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, TimeUnit, Type as PhysicalType};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::types::Type;

use super::{Cell, ColumnKind, Columns};

/// Number of rows that are buffered and written as one group. A group is also limited in bytes.
const ROWS_OF_A_GROUP: usize = 8192;
const BYTES_OF_A_GROUP: usize = 32 * 1024 * 1024;

/// A Parquet file that is being written. A row contains two times in nanoseconds since the epoch and the
/// columns of a message.
pub struct ParquetTable {
    writer: SerializedFileWriter<File>,
    kinds: Vec<ColumnKind>,
    times: [Vec<Cell>; 2],
    /// The buffered cells of each column.
    columns: Vec<Vec<Cell>>,
    /// Size of the buffered text and binary data.
    bytes: usize,
}

impl ParquetTable {
    /// Creates the file, or overwrites it if it exists. `times` are the names of the time columns.
    ///
    /// # Errors
    /// Returns an error if the file cannot be written.
    pub fn create(path: &Path, times: [&str; 2], columns: &Columns) -> Result<Self, ParquetError> {
        let mut fields = times.map(time_field).into_iter().collect::<Result<Vec<_>, _>>()?;
        for column in columns.iter() {
            fields.push(field(&column.name, column.kind)?);
        }
        let schema = Type::group_type_builder("message").with_fields(fields).build()?;
        let properties = WriterProperties::builder().set_compression(Compression::SNAPPY).build();
        let writer = SerializedFileWriter::new(File::create(path)?, Arc::new(schema), Arc::new(properties))?;
        let kinds: Vec<_> = columns.iter().map(|column| column.kind).collect();
        let columns = vec![Vec::new(); kinds.len()];
        Ok(Self { writer, kinds, times: Default::default(), columns, bytes: 0 })
    }

    /// Adds a message.
    ///
    /// # Errors
    /// Returns an error if the file cannot be written.
    pub fn push(&mut self, times: [i64; 2], row: Vec<Cell>) -> Result<(), ParquetError> {
        for (column, time) in self.times.iter_mut().zip(times) {
            column.push(Cell::Int(time));
        }
        for (column, cell) in self.columns.iter_mut().zip(row) {
            self.bytes += match &cell {
                Cell::Text(text) => text.len(),
                Cell::Bytes(bytes) => bytes.len(),
                _ => 0,
            };
            column.push(cell);
        }
        let is_full = self.times[0].len() >= ROWS_OF_A_GROUP || self.bytes >= BYTES_OF_A_GROUP;
        if is_full { self.write_group() } else { Ok(()) }
    }

    /// Writes the buffered rows and completes the file.
    ///
    /// # Errors
    /// Returns an error if the file cannot be written.
    pub fn finish(mut self) -> Result<(), ParquetError> {
        if !self.times[0].is_empty() {
            self.write_group()?;
        }
        self.writer.close()?;
        Ok(())
    }

    fn write_group(&mut self) -> Result<(), ParquetError> {
        let mut group = self.writer.next_row_group()?;
        let times = self.times.iter_mut().map(|times| (ColumnKind::Int, times));
        let fields = self.kinds.iter().copied().zip(&mut self.columns);
        for (kind, cells) in times.chain(fields) {
            if let Some(column) = group.next_column()? {
                write_column(column, kind, cells)?;
            }
            cells.clear();
        }
        group.close()?;
        self.bytes = 0;
        Ok(())
    }
}

fn time_field(name: &str) -> Result<Arc<Type>, ParquetError> {
    let nanoseconds = LogicalType::timestamp(true, TimeUnit::NANOS);
    let field = Type::primitive_type_builder(name, PhysicalType::INT64)
        .with_repetition(Repetition::OPTIONAL)
        .with_logical_type(Some(nanoseconds));
    Ok(Arc::new(field.build()?))
}

fn field(name: &str, kind: ColumnKind) -> Result<Arc<Type>, ParquetError> {
    let (physical, logical) = match kind {
        ColumnKind::Bool => (PhysicalType::BOOLEAN, None),
        ColumnKind::Int => (PhysicalType::INT64, None),
        ColumnKind::UInt => (PhysicalType::INT64, Some(LogicalType::integer(64, false))),
        ColumnKind::Float32 => (PhysicalType::FLOAT, None),
        ColumnKind::Float64 => (PhysicalType::DOUBLE, None),
        ColumnKind::Text => (PhysicalType::BYTE_ARRAY, Some(LogicalType::String)),
        ColumnKind::Bytes => (PhysicalType::BYTE_ARRAY, None),
    };
    let field = Type::primitive_type_builder(name, physical)
        .with_repetition(Repetition::OPTIONAL)
        .with_logical_type(logical);
    Ok(Arc::new(field.build()?))
}

fn write_column(
    mut column: SerializedColumnWriter<'_>,
    kind: ColumnKind,
    cells: &[Cell],
) -> Result<(), ParquetError> {
    let writer = &mut column;
    match kind {
        ColumnKind::Bool => write_cells::<BoolType>(writer, cells, |cell| match cell {
            Cell::Bool(value) => Some(*value),
            _ => None,
        }),
        ColumnKind::Int | ColumnKind::UInt => write_cells::<Int64Type>(writer, cells, |cell| match cell {
            Cell::Int(value) => Some(*value),
            Cell::UInt(value) => Some(value.cast_signed()),
            _ => None,
        }),
        ColumnKind::Float32 => write_cells::<FloatType>(writer, cells, |cell| match cell {
            Cell::Float32(value) => Some(*value),
            _ => None,
        }),
        ColumnKind::Float64 => write_cells::<DoubleType>(writer, cells, |cell| match cell {
            Cell::Float64(value) => Some(*value),
            _ => None,
        }),
        ColumnKind::Text | ColumnKind::Bytes => {
            write_cells::<ByteArrayType>(writer, cells, |cell| match cell {
                Cell::Text(text) => Some(ByteArray::from(text.as_str())),
                Cell::Bytes(bytes) => Some(ByteArray::from(bytes.clone())),
                _ => None,
            })
        }
    }?;
    column.close()
}

fn write_cells<T: DataType>(
    column: &mut SerializedColumnWriter<'_>,
    cells: &[Cell],
    value: impl Fn(&Cell) -> Option<T::T>,
) -> Result<(), ParquetError> {
    let values: Vec<Option<T::T>> = cells.iter().map(value).collect();
    let is_there: Vec<i16> = values.iter().map(|value| i16::from(value.is_some())).collect();
    let values: Vec<T::T> = values.into_iter().flatten().collect();
    column.typed::<T>().write_batch(&values, Some(&is_there), None)?;
    Ok(())
}
