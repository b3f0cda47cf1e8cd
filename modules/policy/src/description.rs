//! Policy files: what a network takes from topics, and what it moves.
//!
//! `docs/policies.md` describes the format.

use std::path::Path;
use std::time::Duration;

use downbeat_files::toml::{Error, Source as Text, Spanned};
use serde::Deserialize;

/// The longest policy file, in bytes.
const LONGEST: u64 = 1 << 20;
/// The most numbers of an array.
const MOST_ELEMENTS: usize = 1 << 16;
const RATES: std::ops::RangeInclusive<f64> = 0.1..=1000.0;
const JOINT_STATE: &str = "sensor_msgs/msg/JointState";

/// A policy file.
#[derive(Clone, Debug)]
pub(crate) struct Description {
    /// The ONNX file, relative to the policy file.
    pub(crate) network: String,
    pub(crate) period: Duration,
    /// Older messages stop the policy.
    pub(crate) max_age: Duration,
    pub(crate) inputs: Vec<Port<Source>>,
    pub(crate) outputs: Vec<Port<Sink>>,
    pub(crate) memories: Vec<Memory>,
}

/// An input or output of the network, with what its numbers are.
#[derive(Clone, Debug)]
pub(crate) struct Port<T> {
    pub(crate) line: usize,
    /// Its name in the network, where it may only be left out if there is one.
    pub(crate) name: Option<String>,
    pub(crate) parts: Vec<Part<T>>,
}

#[derive(Clone, Debug)]
pub(crate) struct Part<T> {
    pub(crate) line: usize,
    pub(crate) of: T,
    pub(crate) scaling: Scaling,
}

/// Where numbers come from.
#[derive(Clone, Debug)]
pub(crate) enum Source {
    Message {
        topic: String,
        type_name: String,
        reads: Reads,
    },
    /// What an output of the network said in the last run.
    Previous(String),
}

#[derive(Clone, Debug)]
pub(crate) enum Reads {
    Fields(Vec<String>),
    Joints {
        names: Vec<String>,
        of: Quantity,
    },
    /// The direction of gravity in the frame of an IMU, from its orientation.
    Gravity,
}

/// Where numbers go to.
#[derive(Clone, Debug)]
pub(crate) struct Sink {
    pub(crate) topic: String,
    pub(crate) type_name: String,
    pub(crate) frame_id: String,
    pub(crate) writes: Writes,
}

#[derive(Clone, Debug)]
pub(crate) enum Writes {
    Fields(Vec<String>),
    Joints { names: Vec<String>, of: Quantity },
}

/// What is measured or commanded of a joint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Quantity {
    #[default]
    Position,
    Velocity,
    Effort,
}

impl Quantity {
    pub(crate) fn field(self) -> &'static str {
        match self {
            Self::Position => "position",
            Self::Velocity => "velocity",
            Self::Effort => "effort",
        }
    }
}

/// An output that is an input of the next run.
#[derive(Clone, Debug)]
pub(crate) struct Memory {
    pub(crate) line: usize,
    pub(crate) input: String,
    pub(crate) output: String,
}

/// Between the numbers of topics and those of the network. Each list has a number for each element, or one
/// for all.
#[derive(Clone, Debug)]
pub(crate) struct Scaling {
    offset: Vec<f64>,
    scale: Vec<f64>,
    limits: Option<[f64; 2]>,
}

impl Scaling {
    fn at(list: &[f64], place: usize) -> f64 {
        list.get(place).or(list.first()).copied().unwrap_or(0.0)
    }

    /// What the network takes for the number of a topic.
    pub(crate) fn to_network(&self, place: usize, number: f64) -> f64 {
        self.limited((number - Self::at(&self.offset, place)) * Self::at(&self.scale, place))
    }

    /// What a topic gets for a number of the network.
    pub(crate) fn to_topic(&self, place: usize, number: f64) -> f64 {
        self.limited(Self::at(&self.offset, place) + Self::at(&self.scale, place) * number)
    }

    fn limited(&self, number: f64) -> f64 {
        self.limits.map_or(number, |[low, high]| number.clamp(low, high))
    }
}

impl Source {
    /// How many numbers it gives; `None` if the network says so.
    pub(crate) fn count(&self) -> Option<usize> {
        match self {
            Self::Message { reads: Reads::Fields(names) | Reads::Joints { names, .. }, .. } => {
                Some(names.len())
            }
            Self::Message { reads: Reads::Gravity, .. } => Some(3),
            Self::Previous(_) => None,
        }
    }

    /// As errors name it.
    pub(crate) fn about(&self) -> String {
        match self {
            Self::Message { topic, .. } => topic.clone(),
            Self::Previous(output) => format!("the last {output}"),
        }
    }
}

impl Sink {
    pub(crate) fn count(&self) -> usize {
        let (Writes::Fields(names) | Writes::Joints { names, .. }) = &self.writes;
        names.len()
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawFile {
    network: String,
    rate_hz: Spanned<f64>,
    max_age: Option<Spanned<String>>,
    #[serde(default)]
    input: Vec<Spanned<RawPort<RawSource>>>,
    #[serde(default)]
    output: Vec<Spanned<RawPort<RawSink>>>,
    #[serde(default)]
    memory: Vec<Spanned<RawMemory>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPort<T> {
    name: Option<String>,
    values: Vec<Spanned<T>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawMemory {
    input: String,
    output: String,
}

#[derive(Deserialize)]
#[serde(untagged, expecting = "a number, or a list of numbers")]
enum Numbers {
    One(f64),
    Many(Vec<f64>),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawSource {
    topic: Option<String>,
    r#type: Option<String>,
    fields: Option<Vec<String>>,
    array: Option<String>,
    count: Option<usize>,
    joints: Option<Vec<String>>,
    #[serde(default)]
    of: Quantity,
    #[serde(default)]
    gravity: bool,
    previous: Option<String>,
    offset: Option<Numbers>,
    scale: Option<Numbers>,
    limits: Option<[f64; 2]>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawSink {
    topic: Option<String>,
    r#type: Option<String>,
    fields: Option<Vec<String>>,
    joints: Option<Vec<String>>,
    #[serde(default)]
    of: Quantity,
    #[serde(default)]
    frame_id: String,
    offset: Option<Numbers>,
    scale: Option<Numbers>,
    limits: Option<[f64; 2]>,
}

impl Description {
    pub(crate) fn read(path: &Path) -> Result<Self, Error> {
        let text = Text::read(path, "the policy file", LONGEST)?;
        let raw: RawFile = text.parse()?;
        let rate = *raw.rate_hz.get_ref();
        if !RATES.contains(&rate) {
            let problem = format!("rate_hz is {rate}; {} to {} are possible", RATES.start(), RATES.end());
            return Err(text.error(raw.rate_hz.span().start, problem));
        }
        let age = |given: &Spanned<String>| {
            let parsed = downbeat_files::duration::parse(given.get_ref());
            parsed.map_err(|problem| text.error(given.span().start, format!("max_age: {problem}")))
        };
        let max_age = raw.max_age.as_ref().map_or(Ok(Duration::from_millis(500)), age)?;
        let memories = raw.memory.into_iter().map(|memory| {
            let line = text.line_of(memory.span().start);
            let RawMemory { input, output } = memory.into_inner();
            Memory { line, input, output }
        });
        let inputs = ports(&text, raw.input, &source)?;
        let outputs = ports(&text, raw.output, &sink)?;
        if outputs.is_empty() {
            return Err(text.error_on(1, "it has no [[output]]: what becomes of what the network says?"));
        }
        Ok(Self {
            network: raw.network,
            period: Duration::from_secs_f64(1.0 / rate),
            max_age,
            inputs,
            outputs,
            memories: memories.collect(),
        })
    }
}

/// A part of a port with how many numbers it has, where that is known.
type Read<T> = (T, Option<usize>, Scaling);

fn ports<R, T>(
    text: &Text<'_>,
    raw: Vec<Spanned<RawPort<R>>>,
    read: &dyn Fn(R) -> Result<Read<T>, String>,
) -> Result<Vec<Port<T>>, Error> {
    let mut ports = Vec::new();
    for port in raw {
        let line = text.line_of(port.span().start);
        let RawPort { name, values } = port.into_inner();
        let mut parts = Vec::new();
        for value in values {
            let line = text.line_of(value.span().start);
            let (of, count, scaling) =
                read(value.into_inner()).map_err(|problem| text.error_on(line, problem))?;
            for (name, list) in [("offset", &scaling.offset), ("scale", &scaling.scale)] {
                if let Some(count) = count.filter(|count| list.len() != 1 && list.len() != *count) {
                    let problem = format!("{name} has {} numbers for {count} values", list.len());
                    return Err(text.error_on(line, problem));
                }
            }
            parts.push(Part { line, of, scaling });
        }
        ports.push(Port { line, name, parts });
    }
    Ok(ports)
}

fn scaling(
    offset: Option<Numbers>,
    scale: Option<Numbers>,
    limits: Option<[f64; 2]>,
) -> Result<Scaling, String> {
    let list = |name: &str, given: Option<Numbers>, default: f64| {
        let list = match given {
            None => vec![default],
            Some(Numbers::One(number)) => vec![number],
            Some(Numbers::Many(numbers)) => numbers,
        };
        match list.iter().find(|number| !number.is_finite()) {
            Some(number) => Err(format!("{name} has {number}, which is no finite number")),
            None => Ok(list),
        }
    };
    if let Some([low, high]) = limits.filter(|[low, high]| low.is_nan() || high.is_nan() || low > high) {
        return Err(format!("limits are [{low}, {high}]; the first one has to be the lower one"));
    }
    Ok(Scaling { offset: list("offset", offset, 0.0)?, scale: list("scale", scale, 1.0)?, limits })
}

fn source(raw: RawSource) -> Result<Read<Source>, String> {
    let scaling = scaling(raw.offset, raw.scale, raw.limits)?;
    let elements = match (raw.array, raw.count) {
        (Some(array), Some(count @ 1..=MOST_ELEMENTS)) => {
            Some((0..count).map(|place| format!("{array}[{place}]")).collect())
        }
        (None, None) => None,
        _ => {
            return Err(format!(
                "an array needs a count of 1 to {MOST_ELEMENTS}: of its elements that are used"
            ));
        }
    };
    let gravity = raw.gravity.then_some(());
    let (reads, type_name, topic) = match (raw.fields, elements, raw.joints, gravity, raw.previous) {
        (Some(fields), None, None, None, None) => (Reads::Fields(fields), None, None),
        (None, Some(elements), None, None, None) => (Reads::Fields(elements), None, None),
        (None, None, Some(names), None, None) => {
            (Reads::Joints { names, of: raw.of }, Some(JOINT_STATE), Some("joint_states"))
        }
        (None, None, None, Some(()), None) => (Reads::Gravity, Some("sensor_msgs/msg/Imu"), Some("imu/data")),
        (None, None, None, None, Some(output)) => return Ok((Source::Previous(output), None, scaling)),
        _ => {
            return Err("it has to have one of `fields`, `array`, `joints`, `gravity = true` and `previous`"
                .to_owned());
        }
    };
    let topic = raw.topic.or_else(|| topic.map(str::to_owned)).ok_or("it needs a `topic`")?;
    let type_name = raw.r#type.or_else(|| type_name.map(str::to_owned));
    let type_name = type_name.ok_or("it needs the `type` of the topic, such as \"sensor_msgs/msg/Imu\"")?;
    let source = Source::Message { topic, type_name, reads };
    let count = source.count();
    Ok((source, count, scaling))
}

fn sink(raw: RawSink) -> Result<Read<Sink>, String> {
    let scaling = scaling(raw.offset, raw.scale, raw.limits)?;
    let (writes, type_name, topic) = match (raw.fields, raw.joints) {
        (Some(fields), None) => (Writes::Fields(fields), None, None),
        (None, Some(names)) => {
            (Writes::Joints { names, of: raw.of }, Some(JOINT_STATE), Some("joint_commands"))
        }
        _ => return Err("it has to have either `fields` or `joints`".to_owned()),
    };
    let topic = raw.topic.or_else(|| topic.map(str::to_owned)).ok_or("it needs a `topic`")?;
    let type_name = raw.r#type.or_else(|| type_name.map(str::to_owned));
    let type_name =
        type_name.ok_or("it needs the `type` of the topic, such as \"geometry_msgs/msg/Twist\"")?;
    let sink = Sink { topic, type_name, frame_id: raw.frame_id, writes };
    let count = sink.count();
    Ok((sink, Some(count), scaling))
}
