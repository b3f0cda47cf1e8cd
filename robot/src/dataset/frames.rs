//! From the messages of a bag to frames at equal distances.
//!
//! A frame has what was known at its time: of every topic the last message that had been received by then.

use std::collections::VecDeque;
use std::num::NonZeroU32;

use bytes::Bytes;
use downbeat_bags::{BagMessage, Reader, Selection, TopicId};
use downbeat_edge::Interfaces;
use downbeat_msgs::cdr;
use downbeat_msgs::sensor_msgs::msg::{CompressedImage, Image};

use super::picture::PictureFile;
use super::vectors::{MOST_NUMBERS, numbers};
use super::writer::{DatasetWriter, FrameValue};
use super::{DatasetError, Demonstration, Late, NumberTopic, PictureTopic, time_of_frame};
use crate::table::Decoder;

/// A picture or a state that is older than this in a frame, in ns, is reported.
const OLD: i64 = 250_000_000;

/// An episode whose states pause for longer, in ns, is none: nobody moves, or the clock was set.
const LONGEST_PAUSE: i64 = 60_000_000_000;

/// The type of the messages that say where episodes begin and end, and its values.
pub(super) const EPISODE: &str = "downbeat_interfaces/msg/Episode";
const STARTED: u64 = 1;
const KEPT: u64 = 2;

/// A topic of numbers in a bag.
pub(super) struct Numbers<'a> {
    topic: &'a NumberTopic,
    id: TopicId,
    decoder: Decoder,
}

/// A topic of pictures in a bag.
struct Pictures<'a> {
    topic: &'a PictureTopic,
    id: TopicId,
    decoder: Decoder,
    is_compressed: bool,
}

/// The topics of a bag that a data set is made of.
pub(super) struct Topics<'a> {
    bag: &'a Reader,
    state: Numbers<'a>,
    action: Numbers<'a>,
    pictures: Vec<Pictures<'a>>,
    episodes: Option<(TopicId, Decoder)>,
}

/// What was found in the messages of a bag before frames are made of them.
#[derive(Default)]
pub(super) struct Survey {
    state: Names,
    action: Names,
    sizes: Vec<Option<[usize; 2]>>,
}

/// Names of numbers in the order in which they appeared, and whether each was ever a number.
#[derive(Default)]
struct Names(Vec<(String, bool)>);

impl Names {
    fn see(&mut self, index: usize, name: String, value: f64) {
        // Nearly always in the same order.
        let place = match self.0.get(index).is_some_and(|(known, _)| *known == name) {
            true => Some(index),
            false => self.0.iter().position(|(known, _)| *known == name),
        };
        match place {
            Some(place) => self.0[place].1 |= value.is_finite(),
            None => self.0.push((name, value.is_finite())),
        }
    }

    fn of_numbers(self) -> Vec<String> {
        self.0.into_iter().filter(|(_, is_number)| *is_number).map(|(name, _)| name).collect()
    }
}

impl Survey {
    /// What all of it is. Actions are in the order of the state, as far as they have its names.
    pub(super) fn found(self) -> Found {
        let (state, mut action) = (self.state.of_numbers(), self.action.of_numbers());
        action.sort_by_key(|name| state.iter().position(|known| known == name).unwrap_or(usize::MAX));
        Found { state, action, sizes: self.sizes }
    }
}

/// What is the same in all bags.
pub(super) struct Found {
    /// Names of the numbers.
    pub(super) state: Vec<String>,
    pub(super) action: Vec<String>,
    /// Width and height of the pictures of each camera, if there was one.
    pub(super) sizes: Vec<Option<[usize; 2]>>,
}

/// A time that a policy learns from, in ns, and what is done in it.
struct Span {
    from: i64,
    to: i64,
    task: String,
}

impl<'a> Topics<'a> {
    pub(super) fn of(
        bag: &'a Reader,
        what: &'a Demonstration,
        interfaces: &Interfaces,
    ) -> Result<Self, DatasetError> {
        let find = |name: &str| {
            let name = format!("/{}", name.trim_start_matches('/'));
            let id = bag.topic(&name).ok_or_else(|| {
                let known = bag.topics().iter().map(|topic| topic.info.name.as_str());
                let known: Vec<_> = known.collect();
                DatasetError::NoTopic {
                    bag: bag.path().to_owned(),
                    topic: name.clone(),
                    known: known.join(", "),
                }
            })?;
            let recorded = &bag.topics()[id.index()];
            let decoder = Decoder::of(recorded, interfaces)
                .map_err(|error| DatasetError::Decode { topic: name, problem: error.to_string() })?;
            Ok::<_, DatasetError>((id, decoder))
        };
        let numbers = |topic: &'a NumberTopic| {
            let (id, decoder) = find(&topic.topic)?;
            Ok::<_, DatasetError>(Numbers { topic, id, decoder })
        };
        let pictures = what.pictures.iter().map(|topic| {
            let (id, decoder) = find(&topic.topic)?;
            let type_name = decoder.message_type().name().to_string();
            let is_compressed = match type_name.as_str() {
                "sensor_msgs/msg/Image" => false,
                "sensor_msgs/msg/CompressedImage" => true,
                _ => return Err(DatasetError::NoPictures { topic: topic.topic.clone(), type_name }),
            };
            Ok(Pictures { topic, id, decoder, is_compressed })
        });
        let with_episodes = bag.topics().iter().find(|topic| topic.info.type_name == EPISODE);
        Ok(Self {
            bag,
            state: numbers(&what.state)?,
            action: numbers(&what.action)?,
            pictures: pictures.collect::<Result<_, _>>()?,
            episodes: with_episodes.map(|topic| find(&topic.info.name)).transpose()?,
        })
    }

    /// Looks at names and sizes, which are to be the same in all bags.
    pub(super) fn survey(&self, survey: &mut Survey) -> Result<(), DatasetError> {
        for (numbers, names) in [(&self.state, &mut survey.state), (&self.action, &mut survey.action)] {
            for message in self.messages([numbers.id])? {
                for (index, (name, value)) in numbers.of(message.data)?.into_iter().enumerate() {
                    names.see(index, name, value);
                }
                if names.0.len() > MOST_NUMBERS {
                    return Err(DatasetError::TooMany { topic: numbers.topic.topic.clone() });
                }
            }
        }
        survey.sizes.resize(self.pictures.len(), None);
        for (pictures, size) in self.pictures.iter().zip(&mut survey.sizes) {
            if size.is_none()
                && let Some(first) = self.messages([pictures.id])?.next()
            {
                *size = Some(pictures.of(first.data)?.size);
            }
        }
        Ok(())
    }

    /// Writes the frames of each episode of the bag, and calls back with each message. Returns how many parts
    /// of the bag cannot be read.
    pub(super) fn write(
        &self,
        what: &Demonstration,
        survey: &Found,
        writer: &mut DatasetWriter,
        late: &mut Vec<Late>,
        seen: &mut dyn FnMut(),
    ) -> Result<usize, DatasetError> {
        let spans = self.spans(&what.task)?;
        let mut sampler = Sampler::new(self, what, survey, spans, writer, late);
        let ids = [self.state.id, self.action.id].into_iter();
        let ids = ids.chain(self.pictures.iter().map(|pictures| pictures.id));
        let ids: Vec<_> = ids.chain(self.episodes.iter().map(|(id, _)| *id)).collect();
        let mut damaged = 0;
        for message in self.bag.messages(Selection::all().topics(ids))? {
            match message {
                Ok(message) => {
                    sampler.advance_to(message.log_time)?;
                    sampler.hold(message)?;
                    seen();
                }
                Err(error) => {
                    tracing::warn!("{error}");
                    damaged += 1;
                }
            }
        }
        sampler.advance_to(i64::MAX)?;
        Ok(damaged)
    }

    /// The messages of these topics, without parts of the bag that cannot be read: [`write`](Self::write)
    /// reads all of them again, and counts those.
    fn messages(
        &self,
        ids: impl IntoIterator<Item = TopicId>,
    ) -> Result<impl Iterator<Item = BagMessage>, DatasetError> {
        Ok(self.bag.messages(Selection::all().topics(ids))?.flatten())
    }

    /// The kept episodes; without messages about them the whole bag, while there are states, is one.
    fn spans(&self, task: &str) -> Result<Vec<Span>, DatasetError> {
        let Some((id, decoder)) = &self.episodes else {
            let mut times = self.messages([self.state.id])?.map(|message| message.log_time);
            let Some(from) = times.next() else { return Ok(Vec::new()) };
            let to = times.last().unwrap_or(from);
            return Ok(vec![Span { from, to, task: task.to_owned() }]);
        };
        let (mut spans, mut open) = (Vec::new(), None);
        let warn = |what: &str| tracing::warn!("{}: {what}", self.bag.path().display());
        if self.bag.topics()[id.index()].message_count == 0 {
            warn("it has a topic of episodes, and none was begun");
        }
        for message in self.messages([*id])? {
            let episode = decoder.decode(message.data).map_err(|error| DatasetError::Decode {
                topic: self.bag.topics()[id.index()].info.name.clone(),
                problem: error.to_string(),
            })?;
            let text = episode.get("task").ok().and_then(|value| value.as_str()).unwrap_or_default();
            match episode.get("state").ok().and_then(|value| value.as_u64()) {
                Some(STARTED) => {
                    if open.replace((message.log_time, text.to_owned())).is_some() {
                        warn("an episode was begun before the one before it had ended, which is left out");
                    }
                }
                Some(KEPT) => {
                    if let Some((from, said)) = open.take() {
                        let task = if said.is_empty() { task.to_owned() } else { said };
                        spans.push(Span { from, to: message.log_time, task });
                    } else {
                        warn("an episode was kept whose beginning is not in the bag; it is left out");
                    }
                }
                _ => open = None,
            }
        }
        if open.is_some() {
            warn("its last episode was neither kept nor discarded, and is left out");
        }
        Ok(spans)
    }
}

impl Numbers<'_> {
    fn of(&self, data: Bytes) -> Result<Vec<(String, f64)>, DatasetError> {
        let failed = |problem| DatasetError::Decode { topic: self.topic.topic.clone(), problem };
        let message = self.decoder.decode(data).map_err(|error| failed(error.to_string()))?;
        numbers(&message, &self.topic.fields).map_err(failed)
    }
}

impl Pictures<'_> {
    fn of(&self, data: Bytes) -> Result<PictureFile, DatasetError> {
        let failed = |problem| DatasetError::Decode { topic: self.topic.topic.clone(), problem };
        let data = self.decoder.to_cdr(data).map_err(|error| failed(error.to_string()))?;
        let picture = match self.is_compressed {
            true => cdr::from_slice::<CompressedImage>(&data).map(PictureFile::of_file),
            false => cdr::from_slice::<Image>(&data).map(|image| PictureFile::of_pixels(&image)),
        };
        picture.map_err(|error| failed(error.to_string()))?.map_err(failed)
    }
}

/// What was last received on a topic of numbers.
struct HeldNumbers<'a> {
    names: &'a [String],
    values: Vec<Option<f64>>,
    at: i64,
}

impl HeldNumbers<'_> {
    fn hold(&mut self, numbers: Vec<(String, f64)>, at: i64) {
        let numbers = numbers.into_iter().enumerate().filter(|(_, (_, value))| value.is_finite());
        for (index, (name, value)) in numbers {
            // Nearly always in the same order.
            let is_here = self.names.get(index) == Some(&name);
            let place =
                if is_here { Some(index) } else { self.names.iter().position(|known| *known == name) };
            if let Some(place) = place {
                self.values[place] = Some(value);
                self.at = at;
            }
        }
    }
}

/// The picture that was last received on a topic.
struct HeldPicture {
    data: Bytes,
    at: i64,
    file: Option<PictureFile>,
}

/// Makes frames while messages are received.
struct Sampler<'a> {
    topics: &'a Topics<'a>,
    fps: NonZeroU32,
    spans: VecDeque<Span>,
    /// The time of the first frame of the episode, and the number of the next.
    next: Option<(i64, i64)>,
    state: HeldNumbers<'a>,
    action: HeldNumbers<'a>,
    /// For each number of the action the place of that name in the state, which it has before it is
    /// commanded.
    action_in_state: Vec<Option<usize>>,
    pictures: Vec<Option<HeldPicture>>,
    sizes: &'a [Option<[usize; 2]>],
    writer: &'a mut DatasetWriter,
    late: &'a mut Vec<Late>,
}

impl<'a> Sampler<'a> {
    fn new(
        topics: &'a Topics<'a>,
        what: &Demonstration,
        survey: &'a Found,
        spans: Vec<Span>,
        writer: &'a mut DatasetWriter,
        late: &'a mut Vec<Late>,
    ) -> Self {
        let held = |names: &'a [String]| HeldNumbers { names, values: vec![None; names.len()], at: 0 };
        let in_state = |name: &String| survey.state.iter().position(|known| known == name);
        Self {
            topics,
            fps: what.fps,
            spans: spans.into(),
            next: None,
            state: held(&survey.state),
            action: held(&survey.action),
            action_in_state: survey.action.iter().map(in_state).collect(),
            pictures: topics.pictures.iter().map(|_| None).collect(),
            sizes: &survey.sizes,
            writer,
            late,
        }
    }

    /// Keeps a message until the next one.
    fn hold(&mut self, message: BagMessage) -> Result<(), DatasetError> {
        let BagMessage { topic, log_time: at, data, .. } = message;
        // One topic can be both.
        if topic == self.topics.state.id {
            self.state.hold(self.topics.state.of(data.clone())?, at);
        }
        if topic == self.topics.action.id {
            self.action.hold(self.topics.action.of(data.clone())?, at);
        }
        for (pictures, held) in self.topics.pictures.iter().zip(&mut self.pictures) {
            if topic == pictures.id {
                *held = Some(HeldPicture { data: data.clone(), at, file: None });
            }
        }
        Ok(())
    }

    /// Writes the frames before a time.
    fn advance_to(&mut self, time: i64) -> Result<(), DatasetError> {
        while let Some(span) = self.spans.front() {
            if time <= span.from {
                return Ok(());
            }
            let (from, to) = (span.from, span.to);
            if self.next.is_none() && self.missing().is_none() {
                self.writer.begin(&span.task);
                // What completed it may have come later than its beginning.
                self.next = Some((from.max(self.newest()), 0));
            }
            if let Some((first, mut number)) = self.next {
                loop {
                    let at = time_of_frame(first, number, self.fps);
                    if at >= time || at > to {
                        break;
                    }
                    self.write(at)?;
                    number += 1;
                }
                self.next = Some((first, number));
            }
            if time <= to {
                return Ok(());
            }
            if self.next.take().is_none() {
                tracing::warn!(
                    "{}: an episode has no frames: {}",
                    self.topics.bag.path().display(),
                    self.missing().unwrap_or_default()
                );
            }
            self.writer.end()?;
            self.spans.pop_front();
        }
        Ok(())
    }

    /// What was not received yet.
    fn missing(&self) -> Option<String> {
        let state = self.state.values.iter().position(Option::is_none);
        if let Some(at) = state {
            return Some(format!("{} did not come before it ended", self.state.names[at]));
        }
        let uncommanded =
            |at: &usize| self.action.values[*at].is_none() && self.action_in_state[*at].is_none();
        if let Some(at) = (0..self.action.values.len()).find(uncommanded) {
            return Some(format!("{} was not commanded before it ended", self.action.names[at]));
        }
        let none = self.pictures.iter().position(Option::is_none)?;
        Some(format!("{} has no picture before it ended", self.topics.pictures[none].topic.topic))
    }

    /// When the last of what is held was received.
    fn newest(&self) -> i64 {
        let pictures = self.pictures.iter().flatten().map(|picture| picture.at);
        pictures.chain([self.state.at, self.action.at]).max().unwrap_or_default()
    }

    fn write(&mut self, at: i64) -> Result<(), DatasetError> {
        let state: Vec<f32> =
            self.state.values.iter().map(|value| value.unwrap_or_default() as f32).collect();
        let action = self.action.values.iter().zip(&self.action_in_state);
        let action = action.map(|(value, in_state)| match (value, in_state) {
            (Some(value), _) => *value as f32,
            (None, Some(place)) => state[*place],
            (None, None) => 0.0,
        });
        let action = action.collect();
        self.late.iter_mut().for_each(|late| late.frames += 1);
        let age = at.saturating_sub(self.state.at);
        if age > LONGEST_PAUSE {
            let topic = self.topics.state.topic.topic.clone();
            return Err(DatasetError::Pause { topic, seconds: age as f64 / 1e9 });
        }
        note_age(self.late, 0, age);
        for (number, held) in self.pictures.iter_mut().enumerate() {
            let Some(held) = held else { continue };
            note_age(self.late, number + 1, at - held.at);
            if held.file.is_none() {
                let pictures = &self.topics.pictures[number];
                let file = pictures.of(held.data.clone())?;
                if let Some(Some(before)) = self.sizes.get(number)
                    && *before != file.size
                {
                    let (topic, before, now) = (pictures.topic.topic.clone(), *before, file.size);
                    return Err(DatasetError::Sizes { topic, before, now });
                }
                held.file = Some(file);
            }
        }
        let pictures = self.pictures.iter().flatten().filter_map(|held| held.file.as_ref());
        let numbers = [FrameValue::Numbers(state), FrameValue::Numbers(action)];
        self.writer.push(numbers.into_iter().chain(pictures.map(FrameValue::Picture)).collect())
    }
}

/// Notes how old something in a frame is, in ns.
fn note_age(late: &mut [Late], number: usize, age: i64) {
    if let Some(late) = late.get_mut(number).filter(|_| age > OLD) {
        late.late += 1;
        late.oldest = late.oldest.max(age);
    }
}
