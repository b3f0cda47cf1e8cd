//! Reading robot files; [`crate::robot`] says what they look like.

mod source;
mod table;

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::path::Path;
use std::time::Duration;

use downbeat_bags::Compression;
use downbeat_executor::SettingValue;
use downbeat_msgs::qos::{Durability, History, QosProfile, Reliability};
use toml::de::DeTable;

use super::kinds::{KINDS, Kind};
pub use source::RobotFileError;
pub(crate) use source::{Source, suggestion};
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
    pub launcher: LauncherChoice,
    /// The modules, in the order of registration.
    pub modules: Vec<ModuleEntry>,
    /// What ROS 2 sees.
    pub expose: Vec<ExposeEntry>,
    /// What a recording holds.
    pub record: RecordEntry,
}

/// How the process phase runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LauncherChoice {
    /// On one thread.
    #[default]
    Linear,
    /// On so many threads.
    Pool(NonZeroUsize),
}

/// A module of a robot file.
pub struct ModuleEntry {
    pub(crate) line: usize,
    /// The name, unique in the robot.
    pub name: String,
    /// What it is.
    pub kind: &'static Kind,
    pub(crate) settings: BTreeMap<String, Located<SettingValue>>,
    pub(crate) remaps: BTreeMap<String, Located<String>>,
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
    /// If it cannot be read, or says something that cannot be; with path and line.
    pub fn read(path: &Path) -> Result<Self> {
        Self::parse(Source::read(path)?)
    }

    pub(crate) fn parse(source: Source) -> Result<Self> {
        let text = source.text().to_owned();
        let document = DeTable::parse(&text).map_err(|error| {
            let line = source.line_of(&error.span().unwrap_or_default());
            source.error(line, error.message())
        })?;
        let mut root = Table::new(&source, "a robot file", 1, document.get_ref());
        let mut robot = root.require("robot")?.table("[robot]")?;
        let name = identifier(robot.require("name")?)?;
        let namespace = robot.take("namespace").map_or(Ok("/"), |value| value.text())?.to_owned();
        let launcher = launcher(&mut robot)?;
        robot.finish()?;
        let modules = root.require("module")?.list()?.into_iter().map(module).collect::<Result<Vec<_>>>()?;
        let expose = root.take("expose").map_or(Ok(Vec::new()), expose)?;
        let record = root.take("record").map_or(Ok(RecordEntry::default()), record)?;
        root.finish()?;
        Ok(Self { source, name, namespace, launcher, modules, expose, record })
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
        Self { line: 1, topics: None, compression: Compression::default() }
    }
}

fn launcher(robot: &mut Table<'_>) -> Result<LauncherChoice> {
    let (launcher, threads) = (robot.take("launcher"), robot.take("threads"));
    let threads = threads.map(|value| Ok((value, value.count()?))).transpose()?;
    match (launcher.map(|value| Ok((value, value.text()?))).transpose()?, threads) {
        (None | Some((_, "linear")), None) => Ok(LauncherChoice::Linear),
        (None | Some((_, "linear")), Some((value, _))) => {
            Err(value.error("\"threads\" goes with launcher = \"pool\""))
        }
        (Some((_, "pool")), threads) => {
            let threads = threads.and_then(|(_, count)| NonZeroUsize::new(count as usize));
            let available = || std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
            Ok(LauncherChoice::Pool(threads.unwrap_or_else(available)))
        }
        (Some((value, other)), _) => {
            let hint = suggestion(other, ["linear", "pool"]);
            Err(value.error(format!("unknown launcher \"{other}\"{hint}")))
        }
    }
}

fn module(value: Value<'_>) -> Result<ModuleEntry> {
    let mut table = value.table("[[module]]")?;
    let kind_value = table.require("kind")?;
    let kind_name = kind_value.text()?;
    let kind = KINDS.iter().find(|kind| kind.name == kind_name).ok_or_else(|| {
        let hint = suggestion(kind_name, KINDS.iter().map(|kind| kind.name));
        kind_value.error(format!("unknown kind of module \"{kind_name}\"{hint}"))
    })?;
    let name_value = table.take("name");
    let line = name_value.map_or(kind_value.line(), |value| value.line());
    let name = name_value.map_or(Ok(kind.name.to_owned()), identifier)?;
    let settings = located(table.take("settings"), "settings", |value| value.setting())?;
    let remaps = located(table.take("remap"), "remap", |value| Ok(value.text()?.to_owned()))?;
    table.finish()?;
    Ok(ModuleEntry { line, name, kind, settings, remaps })
}

fn located<T>(
    value: Option<Value<'_>>,
    name: &str,
    read: impl Fn(Value<'_>) -> Result<T>,
) -> Result<BTreeMap<String, Located<T>>> {
    let Some(value) = value else { return Ok(BTreeMap::new()) };
    let entries = value.table(name)?.take_rest().into_iter();
    entries.map(|(key, value)| Ok((key, Located { line: value.line(), value: read(value)? }))).collect()
}

fn expose(value: Value<'_>) -> Result<Vec<ExposeEntry>> {
    let mut table = value.table("[expose]")?;
    let mut entries = Vec::new();
    for (key, direction) in [("out", Direction::Out), ("in", Direction::In)] {
        for value in table.take(key).map_or(Ok(Vec::new()), |value| value.list())? {
            entries.push(expose_entry(value, direction)?);
        }
    }
    table.finish()?;
    Ok(entries)
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
    table.finish()?;
    Ok(RecordEntry { line, topics, compression })
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
