//! Reading robot files; [`crate::robot`] says what they look like.

mod features;
mod launcher;
mod module;
mod place;
mod source;
mod table;

use std::path::Path;
use std::time::Duration;

use downbeat_bags::Compression;
use downbeat_msgs::encoding::Encoding;
use downbeat_msgs::qos::{Durability, History, QosProfile, Reliability};
use toml::de::DeTable;

pub use features::{ClockChoice, NodeFeatures};
pub use launcher::{LauncherChoice, LauncherEntry};
pub use module::ModuleEntry;
pub(crate) use place::{Given, ParameterPlace, Place};
pub use source::RobotFileError;
pub(crate) use source::{Source, suggestion};
pub(crate) use table::list_of;
use table::{Table, Value};

type Result<T> = std::result::Result<T, RobotFileError>;

/// What a robot file says. Names of topics and settings are checked when the robot is built.
pub struct RobotFile {
    pub(crate) source: Source,
    /// The name of the ROS 2 node.
    pub name: String,
    /// The namespace of the ROS 2 node, `/` for none.
    pub namespace: String,
    /// How the process phase runs.
    pub launcher: LauncherEntry,
    /// The modules, in the order of registration.
    pub modules: Vec<ModuleEntry>,
    /// What ROS 2 sees.
    pub expose: Vec<ExposeEntry>,
    /// What the ROS 2 node has besides.
    pub features: NodeFeatures,
    /// What a recording holds.
    pub record: RecordEntry,
}

/// Whether ROS 2 receives a topic or sends it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// The robot publishes, ROS 2 subscribes.
    Out,
    /// ROS 2 publishes, the robot subscribes.
    In,
}

/// A topic that ROS 2 sees.
pub struct ExposeEntry {
    pub(crate) line: usize,
    /// The topic in the robot.
    pub topic: String,
    /// The topic in ROS 2.
    pub ros_topic: String,
    /// Its type, where the file names it.
    pub type_name: Option<String>,
    /// Which way it goes.
    pub direction: Direction,
    /// Its quality of service.
    pub qos: QosProfile,
}

/// What a recording holds.
pub struct RecordEntry {
    pub(crate) line: usize,
    /// The topics, or nothing for all of them.
    pub topics: Option<Vec<String>>,
    /// How the bag is compressed.
    pub compression: Compression,
    /// How its messages are serialised.
    pub encoding: Encoding,
}

/// A value and its line.
#[derive(Clone)]
pub(crate) struct Located<T> {
    pub(crate) line: usize,
    pub(crate) value: T,
}

impl RobotFile {
    /// Reads a robot file.
    ///
    /// # Errors
    /// If it, or a parameter file that it names, cannot be read or says something that cannot be; with path and
    /// line.
    pub fn read(path: &Path) -> Result<Self> {
        let (mut file, parameter_files) = Self::parse(Source::read(path, "robot file")?)?;
        let folder = path.parent().map(Path::to_owned).unwrap_or_default();
        for Located { line, value: name } in parameter_files {
            file.set_from_parameter_file(&folder.join(name)).map_err(|error| match error {
                RobotFileError::Unreadable { .. } => file.source.error(line, error.to_string()),
                other => other,
            })?;
        }
        Ok(file)
    }

    /// Reads what the text says, without the parameter files that it names.
    pub(crate) fn parse(source: Source) -> Result<(Self, Vec<Located<String>>)> {
        let text = source.text().to_owned();
        let document = DeTable::parse(&text).map_err(|error| {
            let line = source.line_of(&error.span().unwrap_or_default());
            source.error(line, error.message())
        })?;
        let mut root = Table::new(&source, "a robot file", 1, document.get_ref());
        let mut robot = root.require("robot")?.table("[robot]")?;
        let name = identifier(robot.require("name")?)?;
        let namespace = robot.take("namespace").map_or(Ok("/"), |value| value.text())?.to_owned();
        let launcher = launcher::launcher(&mut root, &mut robot)?;
        let parameter_files = robot.take("params").map_or(Ok(Vec::new()), |value| value.list())?;
        let parameter_files = parameter_files
            .iter()
            .map(|value| Ok(Located { line: value.line(), value: value.text()?.to_owned() }))
            .collect::<Result<_>>()?;
        robot.finish()?;
        let modules = root.require("module")?.list()?;
        let modules = modules.into_iter().map(module::module).collect::<Result<Vec<_>>>()?;
        let (expose, features) = root.take("expose").map_or(Ok(Default::default()), expose)?;
        let record = root.take("record").map_or(Ok(RecordEntry::default()), record)?;
        root.finish()?;
        Ok((Self { source, name, namespace, launcher, modules, expose, features, record }, parameter_files))
    }

    /// The file's path.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.source.path()
    }

    /// True if a part of the robot is emulated.
    #[must_use]
    pub fn is_emulated(&self) -> bool {
        self.modules.iter().any(|module| module.kind.is_emulated)
    }
}

impl Default for RecordEntry {
    fn default() -> Self {
        Self { line: 1, topics: None, compression: Compression::default(), encoding: Encoding::default() }
    }
}

fn expose(value: Value<'_>) -> Result<(Vec<ExposeEntry>, NodeFeatures)> {
    let mut table = value.table("[expose]")?;
    let mut entries = Vec::new();
    for (key, direction) in [("out", Direction::Out), ("in", Direction::In)] {
        for value in table.take(key).map_or(Ok(Vec::new()), |value| value.list())? {
            entries.push(expose_entry(value, direction)?);
        }
    }
    let features = NodeFeatures::take(&mut table)?;
    table.finish()?;
    Ok((entries, features))
}

fn expose_entry(value: Value<'_>, direction: Direction) -> Result<ExposeEntry> {
    let line = value.line();
    let Some(mut table) = value.as_table("an exposed topic") else {
        let topic = value.text()?.to_owned();
        let ros_topic = topic.clone();
        return Ok(ExposeEntry {
            line,
            topic,
            ros_topic,
            type_name: None,
            direction,
            qos: QosProfile::DEFAULT,
        });
    };
    let topic = table.require("topic")?.text()?.to_owned();
    let ros_topic = table.take("as").map_or(Ok(topic.as_str()), |value| value.text())?.to_owned();
    let type_name = table.take("type").map(type_name).transpose()?;
    let qos = table.take("qos").map_or(Ok(QosProfile::DEFAULT), qos)?;
    table.finish()?;
    Ok(ExposeEntry { line, topic, ros_topic, type_name, direction, qos })
}

fn type_name(value: Value<'_>) -> Result<String> {
    let name = value.text()?;
    if downbeat_msgs::TYPE_NAMES.contains(&name) {
        return Ok(name.to_owned());
    }
    let hint = suggestion(name, downbeat_msgs::TYPE_NAMES.iter().copied());
    Err(value.error(format!("unknown topic type \"{name}\"{hint}")))
}

/// A preset by name, or a table that says how it differs from one.
fn qos(value: Value<'_>) -> Result<QosProfile> {
    let preset = |value: Value<'_>| {
        let name = value.text()?;
        QosProfile::preset(name).ok_or_else(|| {
            value.error(format!("unknown QoS preset \"{name}\"{}", suggestion(name, QosProfile::PRESETS)))
        })
    };
    let Some(mut table) = value.as_table("qos") else { return preset(value) };
    let mut qos = table.take("preset").map_or(Ok(QosProfile::DEFAULT), preset)?;
    if let Some(value) = table.take("reliability") {
        qos.reliability =
            choice(value, &[("reliable", Reliability::Reliable), ("best_effort", Reliability::BestEffort)])?;
    }
    if let Some(value) = table.take("durability") {
        let choices = [("volatile", Durability::Volatile), ("transient_local", Durability::TransientLocal)];
        qos.durability = choice(value, &choices)?;
    }
    let depth = table.take("depth").map(|value| value.count()).transpose()?;
    if let Some(depth) = depth {
        qos.history = History::KeepLast(depth);
    }
    if let Some(value) = table.take("history")
        && choice(value, &[("keep_last", false), ("keep_all", true)])?
    {
        if depth.is_some() {
            return Err(value.error("\"depth\" goes with history = \"keep_last\""));
        }
        qos.history = History::KeepAll;
    }
    if let Some(value) = table.take("deadline_ms") {
        qos.deadline = Some(Duration::from_millis(value.count()?.into()));
    }
    table.finish()?;
    Ok(qos)
}

fn choice<T: Copy>(value: Value<'_>, choices: &[(&str, T)]) -> Result<T> {
    let name = value.text()?;
    choices.iter().find(|(known, _)| *known == name).map(|&(_, choice)| choice).ok_or_else(|| {
        let hint = suggestion(name, choices.iter().map(|&(known, _)| known));
        value.error(format!("unknown choice \"{name}\"{hint}"))
    })
}

fn record(value: Value<'_>) -> Result<RecordEntry> {
    let mut table = value.table("[record]")?;
    let topics = table.take("topics");
    let line = topics.map_or(table.line(), |value| value.line());
    let topics = match topics {
        Some(value) if value.text().is_ok_and(|text| text == "all") => None,
        Some(value) => {
            let names = value.list().map_err(|_| value.error("expected \"all\" or a list of topics"))?;
            Some(names.iter().map(|name| Ok(name.text()?.to_owned())).collect::<Result<_>>()?)
        }
        None => None,
    };
    let compression = match table.take("compression") {
        Some(value) => choice(value, &[("none", Compression::None), ("zstd", Compression::Zstd)])?,
        None => Compression::default(),
    };
    let encoding = match table.take("encoding") {
        Some(value) => choice(value, &Encoding::ALL.map(|encoding| (encoding.as_str(), encoding)))?,
        None => Encoding::default(),
    };
    table.finish()?;
    Ok(RecordEntry { line, topics, compression, encoding })
}

/// A name that is valid for a ROS 2 node.
fn identifier(value: Value<'_>) -> Result<String> {
    let name = value.text()?;
    let is_valid = name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    if is_valid {
        return Ok(name.to_owned());
    }
    Err(value
        .error(format!("\"{name}\" is not a name; use letters, digits and _, not beginning with a digit")))
}

#[cfg(test)]
mod tests;
