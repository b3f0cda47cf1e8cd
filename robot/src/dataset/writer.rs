//! A data set that is being written.

use std::fs;
use std::path::{Path, PathBuf};

use parquet::data_type::ByteArray;
use parquet::file::metadata::KeyValue;
use serde_json::{Map, Value, json};

use super::columns::{Cells, Column, ColumnFile};
use super::picture::PictureFile;
use super::statistics::{Levels, Statistics};
use super::{DatasetError, Feature, FeatureKind, VERSION};

/// Files of a folder, bytes of a file of data, and of a group of rows in it. The first two are what LeRobot
/// writes, and are part of the data set.
const FILES_OF_A_FOLDER: u64 = 1000;
const MEGABYTES_OF_A_FILE: u64 = 100;
const BYTES_OF_A_GROUP: usize = 32 << 20;
const ROWS_OF_A_GROUP: usize = 8192;

/// Pictures of an episode that are all looked at for statistics; of those that follow, one of ten.
const ALL_LOOKED_AT: usize = 100;
const LOOKED_AT_LATER: usize = 10;

/// A value of a feature in a frame.
pub(super) enum FrameValue<'a> {
    Numbers(Vec<f32>),
    Picture(&'a PictureFile),
}

/// Columns that every data set has, beside its features.
pub(super) const OF_ALL: [&str; 5] = ["timestamp", "frame_index", "episode_index", "index", "task_index"];

/// A data set in a folder.
pub(super) struct DatasetWriter {
    folder: PathBuf,
    fps: u32,
    robot_type: Option<String>,
    features: Vec<Feature>,
    /// Of the features, and [`OF_ALL`]: rows that are not written yet.
    columns: Vec<Column>,
    rows: usize,
    bytes: usize,
    file: Option<ColumnFile>,
    /// Bytes in the file, and its number.
    written: u64,
    number: u64,
    tasks: Vec<String>,
    episodes: Vec<Episode>,
    frames: i64,
    current: Option<Current>,
}

/// An episode that is complete.
struct Episode {
    task: usize,
    from: i64,
    to: i64,
    file: u64,
    statistics: Vec<Statistics>,
}

/// The episode that is being written.
struct Current {
    task: usize,
    from: i64,
    /// Of each feature, by its kind.
    seen: Vec<Seen>,
}

enum Seen {
    Numbers(Vec<Vec<f32>>),
    Pictures { count: usize, levels: Box<Levels> },
}

impl DatasetWriter {
    /// Begins a data set in a folder that is empty.
    pub(super) fn create(
        folder: &Path,
        fps: u32,
        robot_type: Option<String>,
        features: Vec<Feature>,
    ) -> Self {
        let column = |feature: &Feature| {
            let cells = match &feature.kind {
                FeatureKind::Picture { .. } => Cells::Pictures(Vec::new()),
                FeatureKind::Numbers { names } if names.len() == 1 => Cells::Floats(Vec::new()),
                FeatureKind::Numbers { .. } => Cells::FloatLists(Vec::new()),
            };
            Column { name: feature.key.clone(), cells }
        };
        let of_all = OF_ALL.map(|name| {
            let cells = match name {
                "timestamp" => Cells::Floats(Vec::new()),
                _ => Cells::Integers(Vec::new()),
            };
            Column { name: name.to_owned(), cells }
        });
        let columns = features.iter().map(column).chain(of_all).collect();
        Self {
            folder: folder.to_owned(),
            fps,
            robot_type,
            features,
            columns,
            rows: 0,
            bytes: 0,
            file: None,
            written: 0,
            number: 0,
            tasks: Vec::new(),
            episodes: Vec::new(),
            frames: 0,
            current: None,
        }
    }

    /// Begins an episode.
    pub(super) fn begin(&mut self, task: &str) {
        let known = self.tasks.iter().position(|known| known == task);
        let task = known.unwrap_or_else(|| {
            self.tasks.push(task.to_owned());
            self.tasks.len() - 1
        });
        let seen = self.features.iter().map(|feature| match feature.kind {
            FeatureKind::Numbers { .. } => Seen::Numbers(Vec::new()),
            FeatureKind::Picture { .. } => Seen::Pictures { count: 0, levels: Box::default() },
        });
        self.current = Some(Current { task, from: self.frames, seen: seen.collect() });
    }

    /// Adds a frame to the episode: a value for each feature, in their order.
    pub(super) fn push(&mut self, frame: Vec<FrameValue<'_>>) -> Result<(), DatasetError> {
        let Some(current) = &mut self.current else { return Ok(()) };
        let (of_features, of_all) = self.columns.split_at_mut(self.features.len());
        for ((value, column), seen) in frame.into_iter().zip(of_features).zip(&mut current.seen) {
            match (value, &mut column.cells, seen) {
                (FrameValue::Numbers(values), cells, Seen::Numbers(rows)) => {
                    self.bytes += 4 * values.len();
                    match cells {
                        Cells::Floats(cells) => cells.extend(&values),
                        Cells::FloatLists(cells) => cells.push(values.clone()),
                        _ => {}
                    }
                    rows.push(values);
                }
                (FrameValue::Picture(picture), Cells::Pictures(cells), Seen::Pictures { count, levels }) => {
                    self.bytes += picture.bytes.len();
                    cells.push(ByteArray::from(picture.bytes.clone()));
                    let is_early = *count < ALL_LOOKED_AT;
                    if is_early || count.is_multiple_of(LOOKED_AT_LATER) {
                        let rgb = picture.rgb().map_err(DatasetError::Picture)?;
                        levels.add(picture.size, &rgb, if is_early { 1 } else { LOOKED_AT_LATER as u64 });
                    }
                    *count += 1;
                }
                _ => {}
            }
        }
        let (index, episode) = (self.frames, self.episodes.len() as i64);
        let in_episode = index - current.from;
        let seconds = in_episode as f64 / f64::from(self.fps);
        for (column, value) in of_all.iter_mut().zip([0, in_episode, episode, index, current.task as i64]) {
            match &mut column.cells {
                Cells::Floats(cells) => cells.push(seconds as f32),
                Cells::Integers(cells) => cells.push(value),
                _ => {}
            }
        }
        self.frames += 1;
        self.rows += 1;
        if self.rows >= ROWS_OF_A_GROUP || self.bytes >= BYTES_OF_A_GROUP {
            self.write_rows()
        } else {
            Ok(())
        }
    }

    /// Ends the episode. One without frames is none.
    pub(super) fn end(&mut self) -> Result<(), DatasetError> {
        let Some(current) = self.current.take().filter(|current| self.frames > current.from) else {
            return Ok(());
        };
        self.write_rows()?;
        let file = self.number;
        if self.written >= MEGABYTES_OF_A_FILE << 20 {
            self.finish_file()?;
        }
        let statistics = current.seen.iter().map(|seen| match seen {
            Seen::Numbers(rows) => Statistics::of_rows(rows.iter().map(Vec::as_slice)),
            Seen::Pictures { levels, .. } => levels.statistics(),
        });
        let (from, to) = (current.from, self.frames);
        let of_all = statistics_of_all(self.fps, from..to, self.episodes.len(), current.task);
        let statistics = statistics.chain(of_all).collect();
        self.episodes.push(Episode { task: current.task, from, to, file, statistics });
        Ok(())
    }

    /// Completes the data set. Returns how many episodes and frames it has.
    pub(super) fn finish(mut self) -> Result<(usize, i64), DatasetError> {
        if self.episodes.is_empty() {
            return Err(DatasetError::Empty);
        }
        self.finish_file()?;
        let meta = self.folder.join("meta");
        create_folder(&meta)?;
        self.write_tasks(&meta.join("tasks.parquet"))?;
        self.write_episodes(&meta)?;
        write_json(&meta.join("stats.json"), &self.statistics())?;
        write_json(&meta.join("info.json"), &self.info())?;
        Ok((self.episodes.len(), self.frames))
    }

    fn write_rows(&mut self) -> Result<(), DatasetError> {
        if self.rows == 0 {
            return Ok(());
        }
        let file = match &mut self.file {
            Some(file) => file,
            none => {
                let path = self.folder.join(place("data", self.number));
                create_folder(path.parent().unwrap_or(&self.folder))?;
                none.insert(ColumnFile::create(&path, &self.columns, Vec::new())?)
            }
        };
        file.write(&self.columns)?;
        self.columns.iter_mut().for_each(|column| column.cells.clear());
        self.written += self.bytes as u64;
        (self.rows, self.bytes) = (0, 0);
        Ok(())
    }

    /// What follows is in the next file.
    fn finish_file(&mut self) -> Result<(), DatasetError> {
        if let Some(file) = self.file.take() {
            file.finish()?;
            self.number += 1;
            self.written = 0;
        }
        Ok(())
    }

    /// The texts of the tasks. LeRobot reads the file with pandas, and finds the texts as its index.
    fn write_tasks(&self, path: &Path) -> Result<(), DatasetError> {
        let numbers = (0..self.tasks.len() as i64).collect();
        let columns = [
            Column { name: "task_index".to_owned(), cells: Cells::Integers(numbers) },
            Column { name: "task".to_owned(), cells: Cells::Texts(self.tasks.clone()) },
        ];
        let column = |name: &str, kind: &str, in_numpy: &str| json!({ "name": name, "field_name": name, "pandas_type": kind, "numpy_type": in_numpy, "metadata": null });
        let note = json!({
            "index_columns": ["task"],
            "column_indexes": [],
            "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
            "creator": { "library": "downbeat", "version": env!("CARGO_PKG_VERSION") },
            "pandas_version": "2.0.0",
        });
        let notes = vec![KeyValue::new("pandas".to_owned(), note.to_string())];
        let mut file = ColumnFile::create(path, &columns, notes)?;
        file.write(&columns)?;
        Ok(file.finish()?)
    }

    fn write_episodes(&self, meta: &Path) -> Result<(), DatasetError> {
        let integers = |name: &str, of: &dyn Fn(&Episode) -> i64| Column {
            name: name.to_owned(),
            cells: Cells::Integers(self.episodes.iter().map(of).collect()),
        };
        let [folders, files] = [|file: u64| file / FILES_OF_A_FOLDER, |file| file % FILES_OF_A_FOLDER];
        let mut columns = vec![
            Column {
                name: "episode_index".to_owned(),
                cells: Cells::Integers((0..self.episodes.len() as i64).collect()),
            },
            Column {
                name: "tasks".to_owned(),
                cells: Cells::TextLists(
                    self.episodes.iter().map(|episode| vec![self.tasks[episode.task].clone()]).collect(),
                ),
            },
            integers("length", &|episode| episode.to - episode.from),
            integers("data/chunk_index", &|episode| folders(episode.file) as i64),
            integers("data/file_index", &|episode| files(episode.file) as i64),
            integers("dataset_from_index", &|episode| episode.from),
            integers("dataset_to_index", &|episode| episode.to),
        ];
        for (at, (key, is_picture)) in self.keys().enumerate() {
            let of_all: Vec<_> = self.episodes.iter().map(|episode| &episode.statistics[at]).collect();
            for (place, (name, _)) in of_all[0].named().enumerate() {
                let values = of_all.iter().map(|statistics| {
                    statistics.named().nth(place).map(|(_, values)| values.to_vec()).unwrap_or_default()
                });
                let cells = match is_picture {
                    true => Cells::Colours(values.filter_map(|values| values.try_into().ok()).collect()),
                    false => Cells::DoubleLists(values.collect()),
                };
                columns.push(Column { name: format!("stats/{key}/{name}"), cells });
            }
            let counts = of_all.iter().map(|statistics| vec![statistics.count() as i64]).collect();
            columns.push(Column { name: format!("stats/{key}/count"), cells: Cells::IntegerLists(counts) });
        }
        columns.push(integers("meta/episodes/chunk_index", &|_| 0));
        columns.push(integers("meta/episodes/file_index", &|_| 0));
        let path = meta.join(place("episodes", 0));
        create_folder(path.parent().unwrap_or(meta))?;
        let mut file = ColumnFile::create(&path, &columns, Vec::new())?;
        file.write(&columns)?;
        Ok(file.finish()?)
    }

    /// The keys of all columns, and whether each has pictures.
    fn keys(&self) -> impl Iterator<Item = (&str, bool)> {
        let of_features = self
            .features
            .iter()
            .map(|feature| (feature.key.as_str(), matches!(feature.kind, FeatureKind::Picture { .. })));
        of_features.chain(OF_ALL.map(|name| (name, false)))
    }

    fn statistics(&self) -> Value {
        let of =
            |at: usize| self.episodes.iter().map(move |episode| &episode.statistics[at]).collect::<Vec<_>>();
        let all = self.keys().enumerate();
        let all = all.map(|(at, (key, is_picture))| {
            (key.to_owned(), Statistics::together(&of(at)).to_json(is_picture))
        });
        Value::Object(all.collect())
    }

    fn info(&self) -> Value {
        let features = self.features.iter().map(|feature| {
            let described = match &feature.kind {
                FeatureKind::Numbers { names } => {
                    json!({ "dtype": "float32", "shape": [names.len()], "names": names })
                }
                FeatureKind::Picture { size: [width, height] } => {
                    json!({ "dtype": "image", "shape": [height, width, 3], "names": ["height", "width", "channels"] })
                }
            };
            (feature.key.clone(), described)
        });
        let of_all = OF_ALL.map(|name| {
            let kind = if name == "timestamp" { "float32" } else { "int64" };
            (name.to_owned(), json!({ "dtype": kind, "shape": [1], "names": null }))
        });
        let features: Map<_, _> = features.chain(of_all).collect();
        let data_path = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet";
        json!({
            "codebase_version": VERSION,
            "robot_type": self.robot_type,
            "total_episodes": self.episodes.len(),
            "total_frames": self.frames,
            "total_tasks": self.tasks.len(),
            "chunks_size": FILES_OF_A_FOLDER,
            "data_files_size_in_mb": MEGABYTES_OF_A_FILE,
            "video_files_size_in_mb": 200,
            "fps": self.fps,
            "splits": { "train": format!("0:{}", self.episodes.len()) },
            "data_path": data_path,
            "video_path": null,
            "features": features,
        })
    }
}

/// Of the columns [`OF_ALL`] of an episode.
fn statistics_of_all(
    fps: u32,
    frames: std::ops::Range<i64>,
    episode: usize,
    task: usize,
) -> impl Iterator<Item = Statistics> {
    let rows = frames.clone().map(|index| {
        let in_episode = index - frames.start;
        [in_episode as f32 / fps as f32, in_episode as f32, episode as f32, index as f32, task as f32]
    });
    let rows: Vec<_> = rows.collect();
    (0..OF_ALL.len()).map(move |at| Statistics::of_rows(rows.iter().map(|row| &row[at..=at])))
}

/// The place of a file, by its number.
fn place(of: &str, number: u64) -> PathBuf {
    let (folder, file) = (number / FILES_OF_A_FOLDER, number % FILES_OF_A_FOLDER);
    PathBuf::from(of).join(format!("chunk-{folder:03}")).join(format!("file-{file:03}.parquet"))
}

fn create_folder(path: &Path) -> Result<(), DatasetError> {
    fs::create_dir_all(path).map_err(|error| DatasetError::write(path, error))
}

fn write_json(path: &Path, content: &Value) -> Result<(), DatasetError> {
    fs::write(path, format!("{content:#}\n")).map_err(|error| DatasetError::write(path, error))
}
