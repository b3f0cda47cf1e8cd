//! A network as a module of a robot.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `NAME/observation` | std_msgs/Float32MultiArray | with each run what the network takes, in the order of the policy file |
//! | `NAME/action` | std_msgs/Float32MultiArray | with each run what it gives, before scale and limits |
//!
//! and the topics of the policy file.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use bytes::Bytes;
use downbeat_edge::foreign::{Declarations, Event, Foreign, ForeignContext, SettingDeclaration};
use downbeat_executor::{Failure, SettingValue, Time, Transition};
use downbeat_msgs::dynamic::{Array, DynamicMessage, DynamicType, DynamicView};
use downbeat_msgs::std_msgs::msg::Float32MultiArray;
use downbeat_msgs::{Message, cdr};

use crate::description::{Description, Part, Port, Quantity, Reads, Sink, Source, Writes};
use crate::network::Network;

/// The files of a policy.
pub(crate) struct Files {
    pub(crate) description: PathBuf,
    /// Where the content of a file is: in a replay, what was recorded.
    pub(crate) to_read: Box<dyn Fn(PathBuf) -> PathBuf + Send>,
}

pub(crate) struct Policy {
    path: PathBuf,
    description: Description,
    network: Network,
    /// Of each input and output in the description its place in the network.
    input_places: Vec<usize>,
    output_places: Vec<usize>,
    /// Of each memory the places of its input and output.
    memory_places: Vec<[usize; 2]>,
    ports: Ports,
    state: State,
}

/// What changes from run to run.
#[derive(Debug, Default)]
struct State {
    /// The last message of each subscription, and when it came.
    received: BTreeMap<u32, (Bytes, Time)>,
    /// What each output said in the last run.
    said: Vec<Vec<f32>>,
    /// Why it does not run at the moment, as was logged.
    pause: Option<Pause>,
    is_due: bool,
}

/// Why a policy does not run at the moment.
#[derive(Debug, PartialEq)]
enum Pause {
    /// Nothing has come on this topic yet.
    Waits(String),
    Stopped(String),
}

impl From<String> for Pause {
    fn from(problem: String) -> Self {
        Self::Stopped(problem)
    }
}

#[derive(Default)]
struct Ports {
    subscriptions: BTreeMap<u32, Subscription>,
    publishers: Vec<Publisher>,
    observation: u32,
    action: u32,
    enabled: u32,
}

struct Subscription {
    topic: String,
    of: DynamicType,
}

struct Publisher {
    number: u32,
    topic: String,
    empty: DynamicMessage,
    has_stamp: bool,
}

impl Policy {
    /// The ONNX file that a policy file names.
    pub(crate) fn network_of(description: &Path) -> Option<PathBuf> {
        Some(beside(description, &Description::read(description).ok()?.network))
    }

    pub(crate) fn load(files: &Files) -> Result<Self, String> {
        let path = files.description.clone();
        let description =
            Description::read(&(files.to_read)(path.clone())).map_err(|error| error.to_string())?;
        let file = beside(&path, &description.network);
        let network = Network::read(&(files.to_read)(file)).map_err(|error| error.to_string())?;
        let mut policy = Self {
            path,
            description,
            network,
            input_places: Vec::new(),
            output_places: Vec::new(),
            memory_places: Vec::new(),
            ports: Ports::default(),
            state: State::default(),
        };
        policy.bind()?;
        policy.forget();
        Ok(policy)
    }

    fn at(&self, line: usize, problem: impl fmt::Display) -> String {
        format!("{}:{line}: {problem}", self.path.display())
    }

    /// Finds what the description names in the network.
    fn bind(&mut self) -> Result<(), String> {
        let (inputs, outputs) = (self.network.inputs(), self.network.outputs());
        let file = &self.description.network;
        let find = |what: &str, ports: &[crate::Port], name: Option<&String>, line: usize| match (name, ports)
        {
            (None, [_]) => Ok(0),
            (None, _) => {
                let all: Vec<String> = ports.iter().map(ToString::to_string).collect();
                Err(self
                    .at(line, format!("{file} has the {what}s {}: give the `name` of one", all.join(", "))))
            }
            (Some(name), _) => ports.iter().position(|port| port.name == *name).ok_or_else(|| {
                let names = ports.iter().map(|port| port.name.as_str());
                let nearest = downbeat_files::suggestion(name, names);
                self.at(line, format!("{file} has no {what} \"{name}\"{nearest}"))
            }),
        };
        let memories = self.description.memories.iter().map(|memory| {
            let input = find("input", inputs, Some(&memory.input), memory.line)?;
            let output = find("output", outputs, Some(&memory.output), memory.line)?;
            if inputs[input].count() != outputs[output].count() {
                let problem = format!("{} does not fit {}", outputs[output], inputs[input]);
                return Err(self.at(memory.line, problem));
            }
            Ok([input, output])
        });
        let memories = memories.collect::<Result<Vec<_>, _>>()?;
        let free: Vec<crate::Port> = (0..inputs.len())
            .filter(|place| memories.iter().all(|[input, _]| input != place))
            .map(|place| inputs[place].clone())
            .collect();
        let mut input_places = Vec::new();
        for port in &self.description.inputs {
            // The name may be left out if all others are memories.
            let found = &free[find("input", &free, port.name.as_ref(), port.line)?];
            let place = inputs.iter().position(|input| input == found).unwrap_or_default();
            if input_places.contains(&place) {
                return Err(self.at(port.line, format!("\"{}\" is bound twice", found.name)));
            }
            input_places.push(place);
            let count = |part: &Part<Source>| match &part.of {
                Source::Previous(output) => {
                    Ok(outputs[find("output", outputs, Some(output), part.line)?].count())
                }
                source => Ok(source.count().unwrap_or_default()),
            };
            let counts = port.parts.iter().map(count).collect::<Result<Vec<_>, String>>()?;
            let abouts: Vec<String> = port.parts.iter().map(|part| part.of.about()).collect();
            self.fits("input", found, port, &counts, &abouts)?;
        }
        if let Some(port) = free.iter().find(|port| input_places.iter().all(|place| inputs[*place] != **port))
        {
            let problem = format!("input {port} of {file} is not bound: it needs an [[input]]");
            return Err(self.at(1, problem));
        }
        let mut output_places = Vec::new();
        for port in &self.description.outputs {
            let place = find("output", outputs, port.name.as_ref(), port.line)?;
            output_places.push(place);
            let counts: Vec<usize> = port.parts.iter().map(|part| part.of.count()).collect();
            let abouts: Vec<String> = port.parts.iter().map(|part| part.of.topic.clone()).collect();
            self.fits("output", &outputs[place], port, &counts, &abouts)?;
        }
        (self.input_places, self.output_places, self.memory_places) = (input_places, output_places, memories);
        Ok(())
    }

    fn fits<T>(
        &self,
        what: &str,
        found: &crate::Port,
        port: &Port<T>,
        counts: &[usize],
        abouts: &[String],
    ) -> Result<(), String> {
        let bound: usize = counts.iter().sum();
        if bound == found.count() {
            return Ok(());
        }
        let parts = counts.iter().zip(abouts).map(|(count, about)| format!("{count} of {about}"));
        let parts = parts.collect::<Vec<_>>().join(", ");
        let file = &self.description.network;
        let problem =
            format!("{what} {found} of {file} has {} numbers, and {bound} are bound: {parts}", found.count());
        Err(self.at(port.line, problem))
    }

    /// Forgets what was received and said, as at the start.
    fn forget(&mut self) {
        let said = self.network.outputs().iter().map(|port| vec![0.0; port.count()]).collect();
        self.state = State { said, ..State::default() };
    }

    fn declare(&mut self, declarations: &mut Declarations) -> Result<(), String> {
        let mut ports = Ports::default();
        let define = |declarations: &Declarations, line: usize, name: &str| {
            declarations.definition(name).map_err(|problem| self.at(line, problem))
        };
        for part in self.description.inputs.iter().flat_map(|port| &port.parts) {
            let Source::Message { topic, type_name, reads } = &part.of else { continue };
            let of = define(declarations, part.line, type_name)?;
            if let Reads::Fields(fields) = reads {
                self.are_numbers(part.line, fields, &of)?;
            }
            match ports.subscriptions.values().find(|known| known.topic == *topic) {
                Some(known) if known.of.name() != of.name() => {
                    let problem = format!("{topic} is a {} above, and a {type_name} here", known.of.name());
                    return Err(self.at(part.line, problem));
                }
                Some(_) => {}
                None => {
                    let number = declarations.subscribe(topic, type_name, None);
                    ports.subscriptions.insert(number, Subscription { topic: topic.clone(), of });
                }
            }
        }
        for part in self.description.outputs.iter().flat_map(|port| &port.parts) {
            let Sink { topic, type_name, frame_id, writes } = &part.of;
            let of = define(declarations, part.line, type_name)?;
            let mut empty = DynamicMessage::new(&of);
            if let Writes::Fields(fields) = writes {
                self.are_numbers(part.line, fields, &of)?;
            }
            if !frame_id.is_empty() {
                let set = empty.set("header.frame_id", frame_id.as_str());
                set.map_err(|problem| self.at(part.line, problem))?;
            }
            match ports.publishers.iter().find(|known| known.topic == *topic) {
                Some(known) if known.empty != empty => {
                    let problem = format!("{topic} has another `type` or `frame_id` above");
                    return Err(self.at(part.line, problem));
                }
                Some(_) => {}
                None => {
                    let number = declarations.publish(topic, type_name, None);
                    let has_stamp = empty.get("header.stamp.sec").is_ok();
                    ports.publishers.push(Publisher { number, topic: topic.clone(), empty, has_stamp });
                }
            }
        }
        let module = declarations.module_name().to_owned();
        [ports.observation, ports.action] = ["observation", "action"].map(|name| {
            declarations.publish(&format!("{module}/{name}"), Float32MultiArray::TYPE_NAME, None)
        });
        let enabled = SettingDeclaration {
            name: "enabled".to_owned(),
            description: "whether the policy runs; without, it publishes nothing".to_owned(),
            default: SettingValue::Bool(true),
            range: None,
            is_read_only: false,
        };
        (ports.enabled, _) = declarations.setting(enabled)?;
        declarations.every(self.description.period);
        declarations.each_run();
        self.ports = ports;
        Ok(())
    }

    /// Refuses fields that are no numbers. Elements of sequences are only known in messages.
    fn are_numbers(&self, line: usize, fields: &[String], of: &DynamicType) -> Result<(), String> {
        let empty = DynamicMessage::new(of);
        for field in fields {
            let (path, is_element) = match field.split_once('[') {
                Some((array, _)) => (array, true),
                None => (field.as_str(), false),
            };
            let value = empty.get(path).map_err(|problem| self.at(line, problem))?;
            let fits = if is_element { value.as_array().is_some() } else { value.as_f64().is_some() };
            if !fits {
                return Err(self.at(line, format!("{path} of a {} is no number", of.name())));
            }
        }
        Ok(())
    }

    /// Runs the network once, and publishes what follows.
    ///
    /// # Errors
    /// Why it cannot at the moment.
    fn run(&mut self, context: &mut ForeignContext<'_, '_>) -> Result<(), Pause> {
        let now = context.now();
        for (number, Subscription { topic, .. }) in &self.ports.subscriptions {
            let Some((_, time)) = self.state.received.get(number) else {
                return Err(Pause::Waits(topic.clone()));
            };
            if now.saturating_since(*time) > self.description.max_age {
                let age = self.description.max_age.as_secs_f64();
                return Err(format!("{topic} has been silent for more than {age} s").into());
            }
        }
        let mut inputs: Vec<Vec<f32>> = vec![Vec::new(); self.network.inputs().len()];
        let mut observation = Vec::new();
        for (port, place) in self.description.inputs.iter().zip(&self.input_places) {
            let numbers = &mut inputs[*place];
            for part in &port.parts {
                self.observe(part, numbers)?;
            }
            observation.extend_from_slice(numbers);
        }
        for [input, output] in &self.memory_places {
            inputs[*input].clone_from(&self.state.said[*output]);
        }
        if observation.iter().any(|number| !number.is_finite()) {
            return Err("its observation has a number that is not finite".to_owned().into());
        }
        let given: Vec<&[f32]> = inputs.iter().map(Vec::as_slice).collect();
        let said = self.network.run(&given)?;
        if said.iter().flatten().any(|number| !number.is_finite()) {
            return Err("the network says a number that is not finite".to_owned().into());
        }
        self.state.said = said;
        self.act(now, context)?;
        let action = self.output_places.iter().flat_map(|place| &self.state.said[*place]).copied().collect();
        for (publisher, data) in [(self.ports.observation, observation), (self.ports.action, action)] {
            let message = Float32MultiArray { data, ..Float32MultiArray::default() };
            context.publish(publisher, &cdr::to_vec(&message)).map_err(|error| error.to_string())?;
        }
        Ok(())
    }

    /// Appends the numbers of a part of an input.
    fn observe(&self, part: &Part<Source>, numbers: &mut Vec<f32>) -> Result<(), Pause> {
        let mut add = |place: usize, number: f64| numbers.push(part.scaling.to_network(place, number) as f32);
        let (topic, reads) = match &part.of {
            Source::Message { topic, reads, .. } => (topic, reads),
            Source::Previous(output) => {
                let place = self.network.outputs().iter().position(|port| port.name == *output);
                let said = place.map(|place| &self.state.said[place]);
                said.into_iter()
                    .flatten()
                    .enumerate()
                    .for_each(|(place, number)| add(place, f64::from(*number)));
                return Ok(());
            }
        };
        let found = self.ports.subscriptions.iter().find(|(_, known)| known.topic == *topic);
        let message = found.and_then(|(number, known)| {
            self.state.received.get(number).map(|(bytes, _)| DynamicView::new(&known.of, bytes))
        });
        let message = message.ok_or_else(|| Pause::Waits(topic.clone()))?;
        let wrong = |problem: &dyn fmt::Display| Pause::Stopped(format!("{topic}: {problem}"));
        let message = message.map_err(|error| wrong(&error))?;
        let number = |path: &str| {
            let value = message.get(path).map_err(|error| wrong(&error))?;
            value.as_f64().ok_or_else(|| wrong(&format!("{path} is no number")))
        };
        match reads {
            Reads::Fields(fields) => {
                for (place, field) in fields.iter().enumerate() {
                    add(place, number(field)?);
                }
            }
            Reads::Joints { names, of } => {
                let message = message.to_message().map_err(|error| wrong(&error))?;
                let read = |path| message.get(path).ok().and_then(|value| value.as_array());
                let (known, values) = (read("name"), read(of.field()));
                for (place, name) in names.iter().enumerate() {
                    let index =
                        known.and_then(|known| known.iter().position(|known| known.as_str() == Some(name)));
                    let index = index.ok_or_else(|| wrong(&format!("it has no joint {name}")))?;
                    let value = values.and_then(|values| values.get(index)).and_then(|value| value.as_f64());
                    add(place, value.ok_or_else(|| wrong(&format!("{name} has no {}", of.field())))?);
                }
            }
            Reads::Gravity => {
                if number("orientation_covariance[0]")? < 0.0 {
                    return Err(wrong(&"it has no orientation: its covariance begins with -1"));
                }
                let [x, y, z, w] = ["x", "y", "z", "w"].map(|axis| number(&format!("orientation.{axis}")));
                let down = gravity([x?, y?, z?, w?]).ok_or_else(|| wrong(&"its orientation is none"))?;
                down.into_iter().enumerate().for_each(|(place, number)| add(place, number));
            }
        }
        Ok(())
    }

    /// Publishes what the network said.
    fn act(&self, now: Time, context: &mut ForeignContext<'_, '_>) -> Result<(), String> {
        for publisher in &self.ports.publishers {
            let mut message = publisher.empty.clone();
            let mut joints = Joints::default();
            for (port, place) in self.description.outputs.iter().zip(&self.output_places) {
                let mut said = self.state.said[*place].iter();
                for part in &port.parts {
                    let numbers = said.by_ref().take(part.of.count()).enumerate();
                    let numbers =
                        numbers.map(|(place, number)| part.scaling.to_topic(place, f64::from(*number)));
                    if part.of.topic != publisher.topic {
                        numbers.for_each(drop);
                        continue;
                    }
                    match &part.of.writes {
                        Writes::Fields(fields) => {
                            for (field, number) in fields.iter().zip(numbers) {
                                message.set(field, number).map_err(|error| error.to_string())?;
                            }
                        }
                        Writes::Joints { names, of } => joints.add(names, *of, numbers),
                    }
                }
            }
            joints.fill(&mut message)?;
            if publisher.has_stamp {
                let nanos = now.as_nanos();
                let stamp =
                    [("sec", nanos.div_euclid(1_000_000_000)), ("nanosec", nanos.rem_euclid(1_000_000_000))];
                for (field, number) in stamp {
                    message
                        .set(&format!("header.stamp.{field}"), number)
                        .map_err(|error| error.to_string())?;
                }
            }
            let cdr = message.to_cdr().into();
            context.publish_shared(publisher.number, &cdr).map_err(|error| error.to_string())?;
        }
        Ok(())
    }
}

/// What is commanded of joints. A quantity that a joint has none of is not a number, as everywhere in ROS.
#[derive(Default)]
struct Joints {
    names: Vec<String>,
    numbers: [Vec<f64>; 3],
}

impl Joints {
    const QUANTITIES: [Quantity; 3] = [Quantity::Position, Quantity::Velocity, Quantity::Effort];

    fn add(&mut self, names: &[String], of: Quantity, numbers: impl Iterator<Item = f64>) {
        for (name, number) in names.iter().zip(numbers) {
            let place = self.names.iter().position(|known| known == name).unwrap_or_else(|| {
                self.names.push(name.clone());
                self.names.len() - 1
            });
            let list = &mut self.numbers[of as usize];
            if list.len() <= place {
                list.resize(place + 1, f64::NAN);
            }
            list[place] = number;
        }
    }

    fn fill(self, message: &mut DynamicMessage) -> Result<(), String> {
        if self.names.is_empty() {
            return Ok(());
        }
        let count = self.names.len();
        let mut set =
            |field: &str, array: Array| message.set(field, array).map_err(|error| error.to_string());
        set("name", Array::String(self.names))?;
        for (of, mut list) in Self::QUANTITIES.into_iter().zip(self.numbers) {
            if !list.is_empty() {
                list.resize(count, f64::NAN);
                set(of.field(), Array::Float64(list))?;
            }
        }
        Ok(())
    }
}

/// The direction in which things fall, in the frame of what has this orientation; `None` if it is none.
fn gravity([x, y, z, w]: [f64; 4]) -> Option<[f64; 3]> {
    let square = x * x + y * y + z * z + w * w;
    // The third row of the rotation, negated.
    let down = [2.0 * (w * y - x * z), -2.0 * (y * z + w * x), x * x + y * y - z * z - w * w];
    (square.is_finite() && square > 0.25).then(|| down.map(|number| number / square))
}

/// A file beside another one.
fn beside(file: &Path, name: &str) -> PathBuf {
    file.parent().unwrap_or(Path::new("")).join(name)
}

/// What it last received and said.
impl fmt::Debug for Policy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Policy")
            .field("network", &self.network)
            .field("said", &self.state.said)
            .field("pause", &self.state.pause)
            .finish_non_exhaustive()
    }
}

impl Foreign for Policy {
    fn debug(&self) -> Option<&dyn fmt::Debug> {
        Some(self)
    }

    fn setup(&mut self, declarations: &mut Declarations) -> Result<(), String> {
        self.declare(declarations)
    }

    fn handle(&mut self, event: Event, context: &mut ForeignContext<'_, '_>) -> Result<(), Failure> {
        match event {
            Event::Message { subscription, cdr, time, .. } => {
                self.state.received.insert(subscription, (cdr, time));
            }
            Event::Timer { .. } => self.state.is_due = true,
            // After all messages of the cycle, whichever came first.
            Event::EachRun if std::mem::take(&mut self.state.is_due) => {
                if context.setting(self.ports.enabled)? != &SettingValue::Bool(true) {
                    return Ok(());
                }
                let pause = self.run(context).err();
                if pause != self.state.pause {
                    let module = context.module_name();
                    match &pause {
                        Some(Pause::Stopped(problem)) => {
                            tracing::warn!(module, "it moves nothing: {problem}")
                        }
                        Some(Pause::Waits(topic)) => tracing::info!(module, "the policy waits for {topic}"),
                        None => tracing::info!(module, "the policy runs"),
                    }
                    self.state.pause = pause;
                }
            }
            Event::Setting { .. } => self.forget(),
            _ => {}
        }
        Ok(())
    }

    fn transition(&mut self, transition: Transition, _: &mut ForeignContext<'_, '_>) -> Result<(), String> {
        if transition == Transition::Activate {
            self.forget();
        }
        Ok(())
    }
}
