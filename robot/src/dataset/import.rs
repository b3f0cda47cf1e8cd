//! A data set as a bag.

use std::collections::BTreeMap;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

use downbeat_bags::{TopicDescription, TopicId, Writer};
use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::downbeat_interfaces::msg::Episode;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::sensor_msgs::msg::{CompressedImage, JointState};
use downbeat_msgs::std_msgs::msg::Header;
use downbeat_msgs::{Message, cdr};
use parquet::record::Field;

use super::picture::format;
use super::rows::{FeatureInfo, Info, data_files, each_row, integer, numbers, picture, tasks};
use super::vectors::joint_of;
use super::writer::OF_ALL;
use super::{ACTION, DatasetError, PICTURES, STATE, time_of_frame};

/// What was found in a data set.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Imported {
    /// How many episodes.
    pub episodes: u64,
    /// How many frames in all of them.
    pub frames: u64,
    /// How many values of frames are not there: pictures that are files beside the data set, or not what
    /// their feature says.
    pub missing: u64,
    /// Features that a bag has no place for, and why.
    pub left_out: Vec<(String, &'static str)>,
}

/// The time from the last frame of an episode to the first of the next, in ns.
const BETWEEN_EPISODES: i64 = 1_000_000_000;

/// A feature and the topic that it becomes.
struct Target {
    key: String,
    kind: TargetKind,
    topic: TopicId,
}

enum TargetKind {
    Joints(FeatureInfo),
    Pictures,
}

/// A data set of LeRobot.
pub struct Dataset {
    folder: PathBuf,
    info: Info,
    tasks: BTreeMap<i64, String>,
}

impl Dataset {
    /// Opens the folder of a data set.
    ///
    /// # Errors
    /// If it is not of the version v3, or its description cannot be read.
    pub fn open(folder: &Path) -> Result<Self, DatasetError> {
        Ok(Self { folder: folder.to_owned(), info: Info::read(folder)?, tasks: tasks(folder)? })
    }

    /// How many frames it has, as it says.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.info.total_frames
    }

    /// Writes it into a bag: `joint_states`, `joint_commands`, `NAME/image_raw/compressed` for each picture
    /// `observation.images.NAME`, and `episodes`. The first frame has the time `start`, in ns since the
    /// epoch; between episodes is one second. `seen` is called with the number of written frames.
    ///
    /// # Errors
    /// If a file cannot be read, or the bag cannot be written.
    pub fn write_into(
        self,
        writer: &mut Writer,
        start: i64,
        mut seen: impl FnMut(u64),
    ) -> Result<Imported, DatasetError> {
        let Self { folder, info, tasks } = self;
        let (targets, left_out) = targets(info.features, writer)?;
        let mut imported = Imported { left_out, ..Imported::default() };
        let latched = vec![QosProfile::LATCHED.into()];
        let episodes = TopicDescription { offered_qos: latched, ..topic::<Episode>("/episodes") };
        let mut episodes = Episodes { topic: writer.add_topic(episodes)?, current: None, count: 0 };
        let (mut first, mut at) = (start, start);
        for file in data_files(&folder)? {
            each_row(&file, |row| {
                let field = |name: &str| row.get_column_iter().find(|(known, _)| *known == name);
                let whole = |name: &str| {
                    let found = field(name).and_then(|(_, field)| integer(field));
                    found.ok_or_else(|| DatasetError::file(&file, format!("a row has no number in {name}")))
                };
                let (episode, frame) = (whole("episode_index")?, whole("frame_index")?);
                if episodes.current.as_ref().is_none_or(|(known, _)| *known != episode) {
                    if episodes.current.is_some() {
                        episodes.say(writer, Episode::KEPT, at)?;
                        first = at.saturating_add(BETWEEN_EPISODES);
                    }
                    let task = tasks.get(&whole("task_index")?).cloned().unwrap_or_default();
                    episodes.current = Some((episode, task));
                    episodes.say(writer, Episode::STARTED, first)?;
                    imported.episodes += 1;
                }
                // Not the rounded seconds of the row.
                at = match whole_number(info.fps) {
                    Some(fps) => time_of_frame(first, frame.max(0), fps),
                    None => first.saturating_add((frame.max(0) as f64 / info.fps * 1e9).round() as i64),
                };
                let header = Header { stamp: stamp(at), frame_id: String::new() };
                for target in &targets {
                    let Some((_, field)) = field(&target.key) else { continue };
                    match target.message(field, &header) {
                        Some(message) => writer.write(target.topic, at, at, &message)?,
                        None => imported.missing += 1,
                    }
                }
                imported.frames += 1;
                seen(imported.frames);
                Ok(())
            })?;
        }
        if episodes.current.is_some() {
            episodes.say(writer, Episode::KEPT, at)?;
        }
        if imported.frames < info.total_frames {
            let problem = format!("{} of its {} frames are there", imported.frames, info.total_frames);
            return Err(DatasetError::file(&folder.join("data"), problem));
        }
        if let Some(kind) = &info.robot_type {
            writer.set_custom_data("robot_type", kind);
        }
        Ok(imported)
    }
}

/// The features that have a topic, and why others have none.
#[allow(clippy::type_complexity)]
fn targets(
    features: BTreeMap<String, FeatureInfo>,
    writer: &mut Writer,
) -> Result<(Vec<Target>, Vec<(String, &'static str)>), DatasetError> {
    let (mut targets, mut left_out) = (Vec::new(), Vec::new());
    for (key, feature) in features {
        let camera = key.strip_prefix(PICTURES).map(topic_name);
        let (kind, topic) = match (key.as_str(), feature.dtype.as_str(), camera) {
            (STATE, _, _) => (TargetKind::Joints(feature), topic::<JointState>("/joint_states")),
            (ACTION, _, _) => (TargetKind::Joints(feature), topic::<JointState>("/joint_commands")),
            (_, "image", Some(camera)) => {
                let name = format!("/{camera}/image_raw/compressed");
                (TargetKind::Pictures, topic::<CompressedImage>(&name))
            }
            (key, _, _) if OF_ALL.contains(&key) => continue,
            (_, "video", _) => {
                left_out.push((key, "it is a video; record the data set with pictures"));
                continue;
            }
            _ => {
                left_out.push((key, "a bag has no message for it"));
                continue;
            }
        };
        let topic = writer.add_topic(topic)?;
        targets.push(Target { key, kind, topic });
    }
    Ok((targets, left_out))
}

/// The topic that says where episodes begin and end.
struct Episodes {
    topic: TopicId,
    /// The number of the episode in the data set, and its task.
    current: Option<(i64, String)>,
    count: u32,
}

impl Episodes {
    fn say(&mut self, writer: &mut Writer, state: u8, at: i64) -> Result<(), DatasetError> {
        let task = self.current.as_ref().map(|(_, task)| task.clone()).unwrap_or_default();
        let message = Episode { stamp: stamp(at), number: self.count, state, task };
        if state == Episode::KEPT {
            self.count += 1;
        }
        Ok(writer.write(self.topic, at, at, &cdr::to_vec(&message))?)
    }
}

impl Target {
    /// A message with the value of a field.
    fn message(&self, field: &Field, header: &Header) -> Option<Vec<u8>> {
        let header = header.clone();
        match &self.kind {
            TargetKind::Pictures => {
                let file = picture(field)?;
                let format = format(&file).to_owned();
                Some(cdr::to_vec(&CompressedImage { header, format, data: file.to_vec() }))
            }
            TargetKind::Joints(feature) => {
                let mut joints = JointState { header, ..JointState::default() };
                for (index, value) in numbers(field)?.into_iter().enumerate() {
                    let name = feature.name(index);
                    let (joint, array) = joint_of(&name);
                    let at = joints.name.iter().position(|known| known == joint).unwrap_or_else(|| {
                        joints.name.push(joint.to_owned());
                        joints.name.len() - 1
                    });
                    let values = match array {
                        "velocity" => &mut joints.velocity,
                        "effort" => &mut joints.effort,
                        _ => &mut joints.position,
                    };
                    values.resize(values.len().max(at + 1), f64::NAN);
                    values[at] = value;
                }
                for values in [&mut joints.position, &mut joints.velocity, &mut joints.effort] {
                    if !values.is_empty() {
                        values.resize(joints.name.len(), f64::NAN);
                    }
                }
                Some(cdr::to_vec(&joints))
            }
        }
    }
}

/// A name that topics may have: `.` separates, and what they may not have becomes `_`.
fn topic_name(name: &str) -> String {
    let letter = |letter: char| match letter {
        '.' => '/',
        letter if letter.is_ascii_alphanumeric() => letter,
        _ => '_',
    };
    name.chars().map(letter).collect()
}

fn topic<M: Message>(name: &str) -> TopicDescription {
    TopicDescription {
        name: name.to_owned(),
        type_name: M::TYPE_NAME.to_owned(),
        definition: M::DEFINITION.to_owned(),
        type_hash: M::TYPE_HASH.to_owned(),
        offered_qos: vec![QosProfile::default().into()],
        ..TopicDescription::default()
    }
}

fn stamp(at: i64) -> Time {
    let (sec, nanosec) = (at.div_euclid(1_000_000_000), at.rem_euclid(1_000_000_000));
    Time { sec: i32::try_from(sec).unwrap_or(i32::MAX), nanosec: nanosec as u32 }
}

fn whole_number(fps: f64) -> Option<NonZeroU32> {
    NonZeroU32::new(fps as u32).filter(|whole| f64::from(whole.get()) == fps)
}
