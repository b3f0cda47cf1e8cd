//! Demonstrations as data sets of LeRobot, from which policies learn, and back: the format LeRobotDataset
//! v3.0, <https://huggingface.co/docs/lerobot/lerobot-dataset-v3>.
//!
//! A data set has frames at equal distances: the state of the robot, the action that it was given, and
//! pictures. Frames belong to episodes, and each episode to a task in words. Positions are in rad, velocities
//! in rad/s, where the messages have them so; names of numbers are those of joints with `.pos`, `.vel` or
//! `.eff`.

mod columns;
mod frames;
mod import;
mod picture;
mod rows;
mod statistics;
mod vectors;
mod writer;

use std::io;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};
use std::time::Duration;

use downbeat_bags::{Reader, ReaderError};
use downbeat_edge::Interfaces;
use parquet::errors::ParquetError;

use frames::{Survey, Topics};
pub use import::{Dataset, Imported};
use writer::DatasetWriter;

/// The version of the format, as data sets say it.
const VERSION: &str = "v3.0";

/// Which topics of a bag a data set is made of.
#[derive(Clone, Debug)]
pub struct Demonstration {
    /// Frames per second.
    pub fps: NonZeroU32,
    /// What the robot does: `observation.state`.
    pub state: NumberTopic,
    /// What it was commanded: `action`. A number without a command has the value of its name in the state.
    pub action: NumberTopic,
    /// What it sees.
    pub pictures: Vec<PictureTopic>,
    /// The task of episodes for which the bag has none.
    pub task: String,
    /// The kind of robot, for people.
    pub robot_type: Option<String>,
}

/// A topic with numbers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NumberTopic {
    /// Its name.
    pub topic: String,
    /// The fields that are meant, numbers or arrays of them. Without any, `position` of messages that name
    /// its elements, else all numbers outside of headers and of arrays of more than 1000 elements.
    pub fields: Vec<String>,
}

/// A topic with pictures: `sensor_msgs/Image` or `sensor_msgs/CompressedImage`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PictureTopic {
    /// The name of the camera in the data set: `front` for `observation.images.front`.
    pub name: String,
    /// The name of the topic.
    pub topic: String,
}

/// The time of a frame, in ns, with the first one at `first`.
fn time_of_frame(first: i64, number: i64, fps: NonZeroU32) -> i64 {
    let (number, fps) = (i128::from(number), i128::from(fps.get()));
    let since = (number * 1_000_000_000 + fps / 2) / fps;
    first.saturating_add(i64::try_from(since).unwrap_or(i64::MAX))
}

/// A column of a data set.
struct Feature {
    key: String,
    kind: FeatureKind,
}

enum FeatureKind {
    Numbers { names: Vec<String> },
    Picture { size: [usize; 2] },
}

const STATE: &str = "observation.state";
const ACTION: &str = "action";
const PICTURES: &str = "observation.images.";

/// What was written.
#[derive(Clone, Debug)]
pub struct Exported {
    /// How many episodes.
    pub episodes: usize,
    /// How many frames in all of them.
    pub frames: u64,
    /// Topics of which frames have something old.
    pub late: Vec<Late>,
    /// How many parts of the bags could not be read; they are logged.
    pub damaged: usize,
}

/// A topic of which frames have something older than a quarter of a second.
#[derive(Clone, Debug)]
pub struct Late {
    /// The topic.
    pub topic: String,
    /// How many frames.
    pub late: u64,
    /// Of how many.
    pub frames: u64,
    /// The age of the oldest, in ns.
    oldest: i64,
}

impl Late {
    /// How old the oldest was in a frame.
    #[must_use]
    pub fn oldest(&self) -> Duration {
        Duration::from_nanos(self.oldest.unsigned_abs())
    }
}

/// Why there is no data set, or no bag of one.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// A bag lacks a topic.
    #[error("{bag} has no topic {topic}; it has {known}", bag = bag.display())]
    NoTopic {
        /// The bag.
        bag: PathBuf,
        /// The topic.
        topic: String,
        /// What it has.
        known: String,
    },
    /// A topic has no pictures.
    #[error("{topic} has messages of {type_name}, not sensor_msgs/msg/Image or CompressedImage")]
    NoPictures {
        /// The topic.
        topic: String,
        /// Its type.
        type_name: String,
    },
    /// A topic of pictures has no message.
    #[error("{topic} has no picture in any bag")]
    NoPicture {
        /// The topic.
        topic: String,
    },
    /// Messages cannot be used.
    #[error("{topic}: {problem}")]
    Decode {
        /// The topic.
        topic: String,
        /// The problem.
        problem: String,
    },
    /// A picture in a data set cannot be decoded.
    #[error("a picture cannot be decoded: {0}")]
    Picture(String),
    /// A topic has too many numbers.
    #[error("{topic} has more than 1000 numbers; name the fields, such as {topic}:position")]
    TooMany {
        /// The topic.
        topic: String,
    },
    /// A topic has no numbers.
    #[error("{topic} has no numbers in any message")]
    NoNumbers {
        /// The topic.
        topic: String,
    },
    /// Pictures of a topic differ in size.
    #[error(
        "{topic} has a picture of {} x {} pixels after those of {} x {}; a data set has one size for each camera",
        now[0], now[1], before[0], before[1]
    )]
    Sizes {
        /// The topic.
        topic: String,
        /// Width and height of the first.
        before: [usize; 2],
        /// Width and height of another.
        now: [usize; 2],
    },
    /// The states of an episode have a gap.
    #[error(
        "{topic} pauses for {seconds:.0} s in an episode, or the clock was set; `downbeat bag cut` takes the part before or after it"
    )]
    Pause {
        /// The topic.
        topic: String,
        /// How long.
        seconds: f64,
    },
    /// There are no frames.
    #[error("no episode has a frame: see above, and `downbeat bag info`")]
    Empty,
    /// A bag cannot be read.
    #[error(transparent)]
    Read(#[from] ReaderError),
    /// A file of a data set cannot be read or written.
    #[error("{path}: {problem}", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The problem.
        problem: String,
    },
    /// A table of a data set cannot be written.
    #[error(transparent)]
    Table(#[from] ParquetError),
    /// A bag cannot be written.
    #[error(transparent)]
    Bag(#[from] downbeat_bags::WriterError),
}

impl DatasetError {
    fn file(path: &Path, problem: impl ToString) -> Self {
        Self::File { path: path.to_owned(), problem: problem.to_string() }
    }

    fn write(path: &Path, error: io::Error) -> Self {
        Self::file(path, format!("cannot be written: {error}"))
    }
}

/// Makes a data set of bags, in a folder that is empty or does not exist. `seen` is called with each message
/// that was read.
///
/// Each kept episode of a bag is one of the data set, as messages of `downbeat_interfaces/Episode` say it; a
/// bag without these is one episode. A frame has of each topic the last message that was received before it.
///
/// # Errors
/// If a bag lacks a topic, its messages cannot be used, there is no frame, or the folder cannot be written.
pub fn export(
    bags: &[Reader],
    what: &Demonstration,
    folder: &Path,
    interfaces: &Interfaces,
    mut seen: impl FnMut(),
) -> Result<Exported, DatasetError> {
    let topics = bags.iter().map(|bag| Topics::of(bag, what, interfaces)).collect::<Result<Vec<_>, _>>()?;
    let mut survey = Survey::default();
    topics.iter().try_for_each(|topics| topics.survey(&mut survey))?;
    let survey = survey.found();
    for (topic, names) in [(&what.state, &survey.state), (&what.action, &survey.action)] {
        if names.is_empty() {
            return Err(DatasetError::NoNumbers { topic: topic.topic.clone() });
        }
    }
    let numbers = |key: &str, names: &[String]| Feature {
        key: key.to_owned(),
        kind: FeatureKind::Numbers { names: names.to_vec() },
    };
    let mut features = vec![numbers(STATE, &survey.state), numbers(ACTION, &survey.action)];
    for (topic, size) in what.pictures.iter().zip(&survey.sizes) {
        let size = size.ok_or_else(|| DatasetError::NoPicture { topic: topic.topic.clone() })?;
        let key = format!("{PICTURES}{}", topic.name);
        features.push(Feature { key, kind: FeatureKind::Picture { size } });
    }
    let names = [&what.state.topic].into_iter().chain(what.pictures.iter().map(|pictures| &pictures.topic));
    let mut late: Vec<_> =
        names.map(|topic| Late { topic: topic.clone(), late: 0, frames: 0, oldest: 0 }).collect();
    let mut writer = DatasetWriter::create(folder, what.fps.get(), what.robot_type.clone(), features);
    let mut damaged = 0;
    for topics in &topics {
        damaged += topics.write(what, &survey, &mut writer, &mut late, &mut seen)?;
    }
    let (episodes, frames) = writer.finish()?;
    late.retain(|late| late.late > 0);
    Ok(Exported { episodes, frames: frames.unsigned_abs(), late, damaged })
}
