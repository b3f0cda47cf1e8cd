//! Columns of Parquet as data sets have them: numbers, lists of numbers, pictures and text, without gaps.
//!
//! Lists are written as Arrow writes them,
//! <https://github.com/apache/parquet-format/blob/master/LogicalTypes.md>.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, Type as PhysicalType};
use parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{ColumnPath, Type, TypePtr};

/// A column and its values.
pub(super) struct Column {
    pub(super) name: String,
    pub(super) cells: Cells,
}

/// The values of a column, row by row.
pub(super) enum Cells {
    Integers(Vec<i64>),
    Floats(Vec<f32>),
    Texts(Vec<String>),
    FloatLists(Vec<Vec<f32>>),
    DoubleLists(Vec<Vec<f64>>),
    IntegerLists(Vec<Vec<i64>>),
    TextLists(Vec<Vec<String>>),
    /// One number for each of three colours, as an array of three rows and one column: `[[[r]], [[g]],
    /// [[b]]]`.
    Colours(Vec<[f64; 3]>),
    /// The bytes of pictures.
    Pictures(Vec<ByteArray>),
}

impl Cells {
    pub(super) fn clear(&mut self) {
        match self {
            Self::Integers(cells) => cells.clear(),
            Self::Floats(cells) => cells.clear(),
            Self::Texts(cells) => cells.clear(),
            Self::FloatLists(cells) => cells.clear(),
            Self::DoubleLists(cells) => cells.clear(),
            Self::IntegerLists(cells) => cells.clear(),
            Self::TextLists(cells) => cells.clear(),
            Self::Colours(cells) => cells.clear(),
            Self::Pictures(cells) => cells.clear(),
        }
    }

    fn schema(&self, name: &str) -> Result<TypePtr, ParquetError> {
        let text = Some(LogicalType::String);
        match self {
            Self::Integers(_) => leaf(name, PhysicalType::INT64, None),
            Self::Floats(_) => leaf(name, PhysicalType::FLOAT, None),
            Self::Texts(_) => leaf(name, PhysicalType::BYTE_ARRAY, text),
            Self::FloatLists(_) => list(name, leaf(ELEMENT, PhysicalType::FLOAT, None)?),
            Self::DoubleLists(_) => list(name, leaf(ELEMENT, PhysicalType::DOUBLE, None)?),
            Self::IntegerLists(_) => list(name, leaf(ELEMENT, PhysicalType::INT64, None)?),
            Self::TextLists(_) => list(name, leaf(ELEMENT, PhysicalType::BYTE_ARRAY, text)?),
            Self::Colours(_) => {
                let number = leaf(ELEMENT, PhysicalType::DOUBLE, None)?;
                list(name, list(ELEMENT, list(ELEMENT, number)?)?)
            }
            Self::Pictures(_) => {
                let fields = vec![
                    leaf(BYTES, PhysicalType::BYTE_ARRAY, None)?,
                    // Of a file beside the data set; what is in the data set has none.
                    Arc::new(
                        Type::primitive_type_builder("path", PhysicalType::BYTE_ARRAY)
                            .with_repetition(Repetition::OPTIONAL)
                            .with_logical_type(text)
                            .build()?,
                    ),
                ];
                let group = Type::group_type_builder(name).with_repetition(Repetition::REQUIRED);
                Ok(Arc::new(group.with_fields(fields).build()?))
            }
        }
    }

    fn write(&self, group: &mut SerializedRowGroupWriter<'_, File>) -> Result<(), ParquetError> {
        match self {
            Self::Integers(cells) => write::<Int64Type>(group, cells, None, None),
            Self::Floats(cells) => write::<FloatType>(group, cells, None, None),
            Self::Texts(cells) => write::<ByteArrayType>(group, &texts(cells), None, None),
            Self::FloatLists(cells) => write_lists::<FloatType>(group, cells),
            Self::DoubleLists(cells) => write_lists::<DoubleType>(group, cells),
            Self::IntegerLists(cells) => write_lists::<Int64Type>(group, cells),
            Self::TextLists(cells) => {
                write_lists::<ByteArrayType>(group, &cells.iter().map(|cell| texts(cell)).collect::<Vec<_>>())
            }
            Self::Colours(cells) => {
                let present = vec![3; cells.len() * 3];
                write::<DoubleType>(
                    group,
                    &cells.concat(),
                    Some(&present),
                    Some(&[0, 1, 1].repeat(cells.len())),
                )
            }
            Self::Pictures(cells) => {
                write::<ByteArrayType>(group, cells, None, None)?;
                write::<ByteArrayType>(group, &[], Some(&vec![0; cells.len()]), None)
            }
        }
    }
}

const ELEMENT: &str = "element";
const BYTES: &str = "bytes";

fn leaf(name: &str, physical: PhysicalType, logical: Option<LogicalType>) -> Result<TypePtr, ParquetError> {
    let leaf = Type::primitive_type_builder(name, physical).with_repetition(Repetition::REQUIRED);
    Ok(Arc::new(leaf.with_logical_type(logical).build()?))
}

fn list(name: &str, element: TypePtr) -> Result<TypePtr, ParquetError> {
    let repeated = Type::group_type_builder("list").with_repetition(Repetition::REPEATED);
    let repeated = Arc::new(repeated.with_fields(vec![element]).build()?);
    let list = Type::group_type_builder(name).with_repetition(Repetition::REQUIRED);
    Ok(Arc::new(list.with_logical_type(Some(LogicalType::List)).with_fields(vec![repeated]).build()?))
}

fn texts(cells: &[String]) -> Vec<ByteArray> {
    cells.iter().map(|text| ByteArray::from(text.as_str())).collect()
}

/// Lists that are never empty.
fn write_lists<T: DataType>(
    group: &mut SerializedRowGroupWriter<'_, File>,
    lists: &[Vec<T::T>],
) -> Result<(), ParquetError> {
    let repeated: Vec<i16> =
        lists.iter().flat_map(|list| (0..list.len()).map(|at| i16::from(at > 0))).collect();
    let present = vec![1; repeated.len()];
    write::<T>(group, &lists.concat(), Some(&present), Some(&repeated))
}

fn write<T: DataType>(
    group: &mut SerializedRowGroupWriter<'_, File>,
    values: &[T::T],
    present: Option<&[i16]>,
    repeated: Option<&[i16]>,
) -> Result<(), ParquetError> {
    let Some(mut column) = group.next_column()? else { return Ok(()) };
    column.typed::<T>().write_batch(values, present, repeated)?;
    column.close()
}

/// A file of such columns that is being written.
pub(super) struct ColumnFile {
    writer: SerializedFileWriter<File>,
}

impl ColumnFile {
    /// Creates the file. The columns need no rows yet. `notes` are entries of its metadata.
    pub(super) fn create(
        path: &Path,
        columns: &[Column],
        notes: Vec<KeyValue>,
    ) -> Result<Self, ParquetError> {
        let mut properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_key_value_metadata(Some(notes));
        for column in columns.iter().filter(|column| matches!(column.cells, Cells::Pictures(_))) {
            // They are compressed already, and no two are the same.
            let path = ColumnPath::new(vec![column.name.clone(), BYTES.to_owned()]);
            properties = properties
                .set_column_compression(path.clone(), Compression::UNCOMPRESSED)
                .set_column_dictionary_enabled(path.clone(), false)
                .set_column_statistics_enabled(path, EnabledStatistics::None);
        }
        let fields = columns.iter().map(|column| column.cells.schema(&column.name));
        let fields = fields.collect::<Result<Vec<_>, _>>()?;
        let schema = Type::group_type_builder("schema").with_fields(fields).build()?;
        let file = File::create(path)?;
        let writer = SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties.build()))?;
        Ok(Self { writer })
    }

    /// Writes the rows of the columns, those given to [`create`](Self::create), as a group.
    pub(super) fn write(&mut self, columns: &[Column]) -> Result<(), ParquetError> {
        let mut group = self.writer.next_row_group()?;
        columns.iter().try_for_each(|column| column.cells.write(&mut group))?;
        group.close()?;
        Ok(())
    }

    pub(super) fn finish(self) -> Result<(), ParquetError> {
        self.writer.close().map(drop)
    }
}
