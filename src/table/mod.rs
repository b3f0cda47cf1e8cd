//! Messages of a topic as rows of a table, for spreadsheets, data frames and plots.
//!
//! Each number, truth value and text has a column of its own, named by its path: `header.stamp.sec`, `position[3]`. A
//! sequence has as many columns as its longest has elements; bytes, and arrays of more than [`MOST_ELEMENTS`], have one.
//!
//! ```
//! use downbeat::table::{Cell, Survey};
//! use downbeat::msgs::dynamic::{DynamicMessage, DynamicType};
//!
//! let legs = DynamicType::from_definition_text("my_msgs/msg/Legs", "ros2msg", "string name\nfloat64[] angles\n")?;
//! let mut left = DynamicMessage::new(&legs);
//! left.set("angles", vec![0.5, 0.25])?;
//! let right = DynamicMessage::new(&legs);
//!
//! let mut survey = Survey::default();
//! survey.see(&left);
//! survey.see(&right);
//! let columns = survey.columns();
//! let names: Vec<_> = columns.iter().map(|column| column.name.as_str()).collect();
//! assert_eq!(names, ["name", "angles[0]", "angles[1]"]);
//! assert_eq!(columns.row(&left)[2], Cell::Float64(0.25));
//! assert_eq!(columns.row(&right)[2], Cell::Nothing);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod columns;
mod decoder;
mod leaves;
#[cfg(feature = "tables")]
mod parquet;

pub use columns::{Cell, Column, ColumnKind, Columns, Survey};
pub use decoder::{DecodeError, Decoder};
pub use leaves::MOST_ELEMENTS;
#[cfg(feature = "tables")]
pub use parquet::ParquetTable;
