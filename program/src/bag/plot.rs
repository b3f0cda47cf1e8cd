//! `downbeat bag plot`

use std::collections::BTreeSet;
use std::path::PathBuf;

use anyhow::{Context, bail};
use bytes::Bytes;
use clap::Args;

use super::chart::{Chart, Curve};
use super::open;
use super::select::{Tally, absolute, each_message};
use crate::new_output::{Force, Output};
use crate::topic_field::TopicField;
use downbeat_bags::{BagMessage, Reader, RecordedTopic, TopicId};
use downbeat_bridge::edge::Interfaces;
use downbeat_msgs::definitions::nearest;
use downbeat_msgs::printable;
use downbeat_robot::Catalog;
use downbeat_robot::table::{Cell, Column, ColumnKind, Columns, DecodeError, Decoder, ELEMENT_NAMES, Survey};

/// More curves are not distinguishable.
const MOST_CURVES: usize = 40;

#[derive(Args)]
pub(crate) struct PlotArguments {
    /// A rosbag2 directory or a single file.
    pub(crate) bag: PathBuf,
    /// Fields to plot over time: "joint_states:position[3]", or by element name
    /// "joint_states:position[head_tilt]"; for an array or a message, all numbers in it:
    /// "joint_states:position", "imu/data_raw:angular_velocity".
    #[arg(required = true, value_name = "TOPIC:FIELD", value_parser = Wanted::parse)]
    pub(crate) fields: Vec<Wanted>,
    /// The new file: .svg or .png.
    #[arg(long, short, value_name = "FILE")]
    pub(crate) output: PathBuf,
    #[command(flatten)]
    pub(crate) force: Force,
    /// Width and height in pixels.
    #[arg(long, default_value = "1200x600", value_name = "WxH", value_parser = size)]
    pub(crate) size: (u32, u32),
    /// The title; default is the name of the bag.
    #[arg(long, value_name = "TEXT")]
    pub(crate) title: Option<String>,
}

/// A field of a topic.
#[derive(Clone, Debug)]
pub(crate) struct Wanted {
    topic: String,
    path: String,
}

impl Wanted {
    fn parse(text: &str) -> Result<Self, String> {
        let TopicField { topic, field } = text.parse()?;
        Ok(Self { topic: absolute(&topic), path: field })
    }

    /// Returns whether the path is the field or inside it.
    fn holds(&self, path: &str) -> bool {
        let below = path.strip_prefix(&self.path);
        below.is_some_and(|below| below.is_empty() || below.starts_with(['.', '[']))
    }
}

pub(crate) fn plot(arguments: &PlotArguments, catalog: &Catalog) -> anyhow::Result<()> {
    let bag = open(&arguments.bag)?;
    arguments.force.make_way(Output::File, &arguments.output, [])?;
    let mut curves = Vec::new();
    for wanted in &arguments.fields {
        curves.extend(curves_of(&bag, wanted, &catalog.interfaces)?);
    }
    if curves.len() > MOST_CURVES {
        bail!(
            "these are {} curves; select at most {MOST_CURVES}, as in joint_states:position[3]",
            curves.len()
        );
    }
    let name = bag.path().file_name().map(|name| name.to_string_lossy().into_owned());
    let title = arguments.title.clone().or(name).unwrap_or_default();
    let chart = Chart { title, size: arguments.size, curves };
    chart.write(&arguments.output)?;
    let (curves, path) = (chart.curves.len(), arguments.output.display());
    println!("{curves} {} in {path}", if curves == 1 { "curve" } else { "curves" });
    Ok(())
}

/// A topic of a bag.
struct Source<'a> {
    bag: &'a Reader,
    id: TopicId,
    topic: &'a RecordedTopic,
}

impl<'a> Source<'a> {
    fn new(bag: &'a Reader, id: TopicId) -> Self {
        Self { bag, id, topic: &bag.topics()[id.index()] }
    }

    /// The columns for all of its messages.
    fn columns(&self, decoder: &Decoder) -> anyhow::Result<Columns> {
        let mut survey = Survey::default();
        let decode = |data| decoder.decode(data);
        self.each("looking", decode, |_, message| {
            survey.see(&message);
            Ok(())
        })?;
        Ok(survey.columns())
    }

    /// Calls a function with the times and the content of each message. Unreadable messages and parts of the
    /// bag are logged and skipped.
    fn each<T>(
        &self,
        doing: &'static str,
        decode: impl Fn(Bytes) -> Result<T, DecodeError>,
        mut act: impl FnMut([i64; 2], T) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        let mut tally = Tally::default();
        each_message(self.bag, [self.id], doing, |message| {
            let BagMessage { log_time, publish_time, data, .. } = message;
            let content = tally.readable(self.topic, decode(data));
            content.map_or(Ok(()), |content| act([log_time, publish_time], content))
        })?;
        tally.warn(self.topic);
        Ok(())
    }
}

fn curves_of(bag: &Reader, wanted: &Wanted, interfaces: &Interfaces) -> anyhow::Result<Vec<Curve>> {
    let Wanted { topic: name, path } = wanted;
    let known =
        || bag.topics().iter().map(|topic| printable(&topic.info.name)).collect::<Vec<_>>().join(", ");
    let id = bag.topic(name).with_context(|| {
        let topics = bag.topics().iter().map(|topic| topic.info.name.as_str());
        match nearest(name, topics) {
            Some(topic) => format!("the bag has no topic {name}, did you mean {}?", printable(topic)),
            None => format!("the bag has no topic {name}; it has {}", known()),
        }
    })?;
    let source = Source::new(bag, id);
    let decoder = Decoder::of(source.topic, interfaces)?;
    let columns = source.columns(&decoder)?;
    let is_number = |kind| !matches!(kind, ColumnKind::Text | ColumnKind::Bytes);
    let all: Vec<_> = columns.iter().collect();
    let is_by_number = all.iter().any(|column| wanted.holds(&column.name));
    let numbers = all.iter().enumerate().filter(|(_, column)| is_number(column.kind));
    let mut chosen: Vec<_> = numbers
        .map(|(index, column)| Chosen { index, element: Named::of(&column.name, &all), curve: None })
        // Element names are only known once a message is read.
        .filter(|chosen| wanted.holds(&all[chosen.index].name) || (!is_by_number && chosen.element.is_some()))
        .collect();
    let start = bag.start_time().unwrap_or(0);
    let mut curves: Vec<Curve> = Vec::new();
    let mut named = BTreeSet::new();
    // Only keeps numbers, since images are large.
    let rows = |data| Ok(columns.row(&decoder.decode(data)?));
    source.each("reading", rows, |[time, _], row| {
        let seconds = time.saturating_sub(start) as f64 / 1e9;
        for chosen in &mut chosen {
            let Some(value) = number(&row[chosen.index]) else { continue };
            let element = chosen.element.as_ref().and_then(|element| element.name_in(&row));
            let is_known = chosen.curve.as_ref().is_some_and(|(of, _)| of.as_deref() == element);
            if !is_known {
                let path = match (&chosen.element, element) {
                    // A curve selected by index shows the index with its name.
                    (Some(named), Some(element))
                        if wanted.path.len() > named.before.len() && is_by_number =>
                    {
                        format!("{} {element}", all[chosen.index].name)
                    }
                    (Some(named), Some(element)) => named.path(element),
                    _ => all[chosen.index].name.clone(),
                };
                if !is_by_number && !wanted.holds(&path) {
                    if named.len() < MOST_NAMED {
                        named.insert(path);
                    }
                    continue;
                }
                let name = printable(&format!("{name}:{path}")).into_owned();
                let index = curves.iter().position(|curve| curve.name == name).unwrap_or_else(|| {
                    curves.push(Curve { name, points: Vec::new() });
                    curves.len() - 1
                });
                chosen.curve = Some((element.map(str::to_owned), index));
            }
            if let Some((_, curve)) = &chosen.curve {
                curves[*curve].points.push((seconds, value));
            }
        }
        Ok(())
    })?;
    if curves.is_empty() {
        let numbers = all.iter().filter(|column| is_number(column.kind));
        let numbers: Vec<_> = numbers.map(|column| column.name.as_str()).collect();
        if let Some(meant) = suggested_path(path, &numbers, &named) {
            bail!("{name} has no number at {path}, did you mean {}?", printable(&meant));
        }
        bail!("{name} has no number at {path}; it has {}", numbers.join(", "));
    }
    Ok(curves)
}

/// The most paths with names of elements among which the nearest is sought.
const MOST_NAMED: usize = 1000;

/// The path that is most similar to a wrong one: of a number, of an element by its name, or of an array or
/// message.
fn suggested_path(path: &str, numbers: &[&str], named: &BTreeSet<String>) -> Option<String> {
    let mut known: BTreeSet<&str> = numbers.iter().copied().chain(named.iter().map(String::as_str)).collect();
    // Whole arrays and messages are paths too.
    known.extend(numbers.iter().flat_map(|number| {
        number.char_indices().filter(|(_, letter)| ['.', '['].contains(letter)).map(|(end, _)| &number[..end])
    }));
    nearest(path, known).map(str::to_owned)
}

/// A column of numbers.
struct Chosen<'a> {
    index: usize,
    element: Option<Named<'a>>,
    /// The curve of its numbers, and the element name for which it was determined.
    curve: Option<(Option<String>, usize)>,
}

/// An element of an array with a parallel array of names, as in `JointState`.
struct Named<'a> {
    /// The path before and after the index: `position` and an empty string.
    before: &'a str,
    behind: &'a str,
    /// The column with its name.
    name: usize,
}

impl<'a> Named<'a> {
    fn of(column: &'a str, all: &[&Column]) -> Option<Self> {
        let (before, rest) = column.rsplit_once('[')?;
        let (number, behind) = rest.split_once(']')?;
        let parent = before.rfind('.').map_or("", |end| &before[..=end]);
        let length = |array: &str, behind: &str| {
            let of_array = all.iter().filter(|column| {
                let rest = column.name.strip_prefix(array).and_then(|rest| rest.strip_prefix('['));
                let behind_number = rest.and_then(|rest| rest.split_once(']'));
                behind_number.is_some_and(|(_, rest)| rest == behind)
            });
            of_array.count()
        };
        ELEMENT_NAMES.into_iter().find_map(|names| {
            let names = format!("{parent}{names}");
            let wanted = format!("{names}[{number}]");
            let is_it = |column: &&Column| column.name == wanted && column.kind == ColumnKind::Text;
            let name = all.iter().position(is_it)?;
            (length(&names, "") == length(before, behind)).then_some(Self { before, behind, name })
        })
    }

    /// Its name in a message.
    fn name_in<'r>(&self, row: &'r [Cell]) -> Option<&'r str> {
        match &row[self.name] {
            Cell::Text(name) if !name.is_empty() => Some(name),
            _ => None,
        }
    }

    fn path(&self, element: &str) -> String {
        format!("{}[{element}]{}", self.before, self.behind)
    }
}

fn number(cell: &Cell) -> Option<f64> {
    match cell {
        Cell::Bool(value) => Some(f64::from(u8::from(*value))),
        Cell::Int(value) => Some(*value as f64),
        Cell::UInt(value) => Some(*value as f64),
        Cell::Float32(value) => Some(f64::from(*value)),
        Cell::Float64(value) => Some(*value),
        Cell::Nothing | Cell::Text(_) | Cell::Bytes(_) => None,
    }
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let parts =
        text.split_once('x').and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    parts
        .filter(|(width, height)| (200..=10_000).contains(width) && (100..=10_000).contains(height))
        .ok_or_else(|| {
            "write width and height in pixels, 200x100 to 10000x10000, such as 1200x600".to_owned()
        })
}
