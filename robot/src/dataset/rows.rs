//! Reads the files of a data set.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use bytes::Bytes;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::{Field, Row};
use serde::Deserialize;
use std::collections::BTreeMap;

use super::{DatasetError, VERSION};

/// `meta/info.json`, as far as it is used.
#[derive(Deserialize)]
pub(super) struct Info {
    codebase_version: String,
    pub(super) fps: f64,
    #[serde(default)]
    pub(super) total_frames: u64,
    #[serde(default)]
    pub(super) robot_type: Option<String>,
    pub(super) features: BTreeMap<String, FeatureInfo>,
}

/// A feature in it.
#[derive(Deserialize)]
pub(super) struct FeatureInfo {
    pub(super) dtype: String,
    #[serde(default)]
    names: Option<Names>,
}

/// The names of numbers. Older data sets name their group too.
#[derive(Deserialize)]
#[serde(untagged)]
enum Names {
    List(Vec<String>),
    Groups(BTreeMap<String, Vec<String>>),
    Other(serde::de::IgnoredAny),
}

impl FeatureInfo {
    /// The name of a number.
    pub(super) fn name(&self, index: usize) -> String {
        let names = match &self.names {
            Some(Names::List(names)) => Some(names),
            Some(Names::Groups(groups)) => groups.values().next(),
            _ => None,
        };
        names.and_then(|names| names.get(index).cloned()).unwrap_or_else(|| index.to_string())
    }
}

impl Info {
    /// Reads it, and checks that this version of the format is known.
    pub(super) fn read(folder: &Path) -> Result<Self, DatasetError> {
        let path = folder.join("meta/info.json");
        let text = fs::read_to_string(&path)
            .map_err(|error| DatasetError::file(&path, format!("it is no data set of LeRobot: {error}")))?;
        let info: Self = serde_json::from_str(&text).map_err(|error| DatasetError::file(&path, error))?;
        let Self { codebase_version, fps, .. } = &info;
        if !codebase_version.starts_with("v3.") {
            let problem = format!(
                "the version of the format is {codebase_version}, not {VERSION}; convert it with \
                 `python -m lerobot.datasets.v30.convert_dataset_v21_to_v30`"
            );
            return Err(DatasetError::file(&path, problem));
        }
        if !(*fps > 0.0 && fps.is_finite()) {
            return Err(DatasetError::file(&path, format!("{fps} frames per second are not possible")));
        }
        Ok(info)
    }
}

/// The texts of the tasks, by their numbers.
pub(super) fn tasks(folder: &Path) -> Result<BTreeMap<i64, String>, DatasetError> {
    let mut tasks = BTreeMap::new();
    each_row(&folder.join("meta/tasks.parquet"), |row| {
        let (mut number, mut text) = (None, None);
        for (_, field) in row.get_column_iter() {
            match field {
                Field::Str(task) => text = Some(task.clone()),
                field => number = number.or(integer(field)),
            }
        }
        tasks.extend(number.zip(text));
        Ok(())
    })?;
    Ok(tasks)
}

/// The files with frames, in their order.
pub(super) fn data_files(folder: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let data = folder.join("data");
    let entries = |folder: &Path| -> Result<Vec<PathBuf>, DatasetError> {
        let read = fs::read_dir(folder).and_then(|entries| {
            entries.map(|entry| entry.map(|entry| entry.path())).collect::<Result<Vec<_>, _>>()
        });
        let mut paths = read.map_err(|error| DatasetError::file(folder, error))?;
        paths.sort();
        Ok(paths)
    };
    let mut files = Vec::new();
    for folder in entries(&data)?.iter().filter(|path| path.is_dir()) {
        files.extend(
            entries(folder)?.into_iter().filter(|path| path.extension().is_some_and(|is| is == "parquet")),
        );
    }
    Ok(files)
}

/// Calls back with each row of a file.
pub(super) fn each_row(
    path: &Path,
    mut act: impl FnMut(&Row) -> Result<(), DatasetError>,
) -> Result<(), DatasetError> {
    let failed = |problem: String| DatasetError::file(path, problem);
    let file = File::open(path).map_err(|error| failed(error.to_string()))?;
    let reader = SerializedFileReader::new(file).map_err(|error| failed(error.to_string()))?;
    for row in reader.get_row_iter(None).map_err(|error| failed(error.to_string()))? {
        act(&row.map_err(|error| failed(error.to_string()))?)?;
    }
    Ok(())
}

pub(super) fn integer(field: &Field) -> Option<i64> {
    match field {
        Field::Int(value) => Some(i64::from(*value)),
        Field::Long(value) => Some(*value),
        Field::UInt(value) => Some(i64::from(*value)),
        _ => None,
    }
}

/// A number, or those of a list.
pub(super) fn numbers(field: &Field) -> Option<Vec<f64>> {
    let one = |field: &Field| match field {
        Field::Float(value) => Some(f64::from(*value)),
        Field::Double(value) => Some(*value),
        field => integer(field).map(|value| value as f64),
    };
    match field {
        Field::ListInternal(list) => list.elements().iter().map(one).collect(),
        field => one(field).map(|value| vec![value]),
    }
}

/// The file of a picture.
pub(super) fn picture(field: &Field) -> Option<Bytes> {
    let Field::Group(row) = field else { return None };
    row.get_column_iter().find_map(|(_, field)| match field {
        Field::Bytes(bytes) => Some(Bytes::copy_from_slice(bytes.data())),
        _ => None,
    })
}
