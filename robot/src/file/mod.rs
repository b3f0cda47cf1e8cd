//! Reading of robot files; [`crate`] describes the format.

#[cfg(feature = "football")]
mod apart;
mod arguments;
mod carried;
mod expose;
mod features;
mod include;
mod latency;
mod launcher;
mod module;
mod networks;
mod record;
mod source;
mod table;
mod view;
mod yaml_line;

use std::path::{Path, PathBuf};

use downbeat_bags::{FieldRule, FieldRuleError};
use downbeat_bridge::expose::TopicPattern;
use downbeat_bridge::middleware::Engine;
use downbeat_bridge::ros::{RemapRule, RemapRules};
use downbeat_edge::Interfaces;
use downbeat_files::toml;

use super::{Catalog, RosArgs};
pub(crate) use downbeat_files::suggestion;
pub use expose::{ActionEntry, ExposeEntry, ExposeSection, LifecycleEntry, ServiceEntry, TopicChoice};
pub use features::{ClockChoice, NodeFeatures};
pub(crate) use latency::LatencyEntry;
pub use launcher::{LauncherChoice, LauncherEntry};
pub use module::ModuleEntry;
pub use networks::NetworkEntry;
pub use record::RecordEntry;
pub use source::RobotFileError;
pub use source::{Given, ParameterPlace, Place, Source, toml_string};
pub(crate) use table::list_of;
use table::{Table, Value};
#[cfg(feature = "view")]
pub use view::FOXGLOVE_PORT;
pub use view::{ViewAccess, ViewEntry};

type Result<T> = std::result::Result<T, RobotFileError>;

/// The contents of a robot file. Names of topics and settings are checked when the robot is built.
pub struct RobotFile {
    /// Its text.
    pub source: Source,
    /// The kinds, launchers and interfaces that the file can name.
    pub catalog: Catalog,
    /// True if the file specifies the namespace.
    pub(crate) has_namespace: bool,
    /// The name of the robot.
    pub name: String,
    /// The namespace of the ROS 2 node, `/` for none.
    pub namespace: String,
    /// The name of the ROS 2 node, before remapping rules apply.
    pub node: String,
    /// The remapping rules: first those from the arguments, then those of the file.
    pub remaps: RemapRules,
    /// True if nothing is logged to `/rosout`, regardless of `[expose]`.
    pub is_rosout_disabled: bool,
    /// How the process phase runs.
    pub launcher: LauncherEntry,
    /// The modules, in the order of registration.
    pub modules: Vec<ModuleEntry>,
    /// What is exposed to ROS 2.
    pub expose: ExposeSection,
    /// Further networks, to which some of the entries in `expose` belong.
    pub networks: Vec<NetworkEntry>,
    /// What is recorded, and how.
    pub record: RecordEntry,
    /// Chains that are measured while the robot runs.
    pub(crate) latencies: Vec<LatencyEntry>,
    /// How a bag of the robot is replayed.
    pub replay: ReplaySection,
    /// The server for Foxglove, Lichtblick and PlotJuggler; `None` for no server.
    pub view: ViewEntry,
}

/// A value and its line.
#[derive(Clone)]
pub(crate) struct Located<T> {
    pub(crate) line: usize,
    pub(crate) value: T,
}

impl RobotFile {
    /// Reads a robot file that uses only built-in kinds, launchers and interfaces.
    ///
    /// # Errors
    /// Returns an error with path and line if the file, or a parameter file that it names, cannot be read or
    /// is invalid.
    pub fn read(path: &Path) -> Result<Self> {
        Self::read_with(path, &Catalog::built_in(), &RosArgs::default())
    }

    /// Reads a robot file that uses the kinds, launchers and interfaces of a catalog, or the carried robot of
    /// that name (`downbeat robots list`) where there is no such file, and applies the
    /// arguments of ROS 2 programs: remapping rules take precedence over those of the file, parameters over
    /// its settings.
    ///
    /// # Errors
    /// Returns an error with path and line if the file, or a parameter file, cannot be read or is invalid;
    /// also if an argument is invalid.
    pub fn read_with(path: &Path, catalog: &Catalog, arguments: &RosArgs) -> Result<Self> {
        Self::read_from(Source::read(&carried::located(path)?, "the robot file")?, catalog, arguments)
    }

    /// Reads a text as the file that is, or will be, at the path of the source.
    ///
    /// # Errors
    /// As [`read_with`](Self::read_with).
    pub fn read_from(source: Source, catalog: &Catalog, arguments: &RosArgs) -> Result<Self> {
        let folder = source.path().parent().map(Path::to_owned).unwrap_or_default();
        let (mut file, parameter_files) = Self::parse(source, catalog)?;
        file.apply_names(arguments);
        for Located { line, value: name } in parameter_files {
            file.set_from_parameter_file(&folder.join(name)).map_err(|error| match error {
                RobotFileError::File(toml::Error::Unreadable { .. }) => {
                    file.source.error(line, error.to_string())
                }
                other => other,
            })?;
        }
        file.apply_parameters(arguments)?;
        Ok(file)
    }

    /// Parses the text without the parameter files that it names.
    ///
    /// # Errors
    /// Returns an error with path and line if the text is invalid.
    pub fn read_alone(source: Source, catalog: &Catalog) -> Result<Self> {
        Ok(Self::parse(source, catalog)?.0)
    }

    /// Parses the text without the parameter files that it names, which are returned with it.
    pub(crate) fn parse(source: Source, catalog: &Catalog) -> Result<(Self, Vec<Located<String>>)> {
        Self::parse_inside(source, catalog, &[])
    }

    /// Parses the text of a file that these files include, from the outside in.
    fn parse_inside(
        source: Source,
        catalog: &Catalog,
        outside: &[PathBuf],
    ) -> Result<(Self, Vec<Located<String>>)> {
        let inside: Vec<PathBuf> = outside.iter().cloned().chain([source.path().to_owned()]).collect();
        let content = Source::new(source.path(), source.text().to_owned());
        let document = content.table()?;
        let mut root = Table::new(&source, "a robot file", 1, document.get_ref());
        let mut robot = root.require("robot")?.table("[robot]")?;
        // Included files belong to the same robot.
        let mut catalog = catalog.clone();
        if outside.is_empty() {
            catalog.interfaces = catalog.interfaces.separate();
        }
        let catalog = &catalog;
        let interface_folders = interface_folders(robot.take("interfaces"), &catalog.interfaces)?;
        let name = identifier(robot.require("name")?)?;
        let namespace = robot.take("namespace").map(|value| value.text().map(str::to_owned)).transpose()?;
        let node = robot.take("node").map_or(Ok(name.clone()), identifier)?;
        let remaps = robot.take("remap").map_or(Ok(RemapRules::default()), remaps)?;
        let launcher = launcher::launcher(&mut root, &mut robot, catalog)?;
        let parameter_files = robot.take("params").map_or(Ok(Vec::new()), |value| value.list())?;
        let parameter_files = parameter_files
            .iter()
            .map(|value| Ok(Located { line: value.line(), value: value.text()?.to_owned() }))
            .collect::<Result<_>>()?;
        robot.finish()?;
        let modules = match root.peek("include") {
            None => root.require("module")?.list()?,
            Some(_) => root.take("module").map_or(Ok(Vec::new()), |value| value.list())?,
        };
        let mut modules =
            modules.into_iter().map(|value| module::module(value, catalog)).collect::<Result<Vec<_>>>()?;
        modules.iter_mut().for_each(|module| module.source.interfaces.clone_from(&interface_folders));
        for value in root.take("include").map_or(Ok(Vec::new()), |value| value.list())? {
            modules.extend(include::include(value, catalog, &inside)?);
        }
        let expose = root.take("expose").map(|value| expose::expose(value, &catalog.interfaces));
        let mut expose = expose.transpose()?.unwrap_or_default();
        let networks = root
            .take("networks")
            .map_or(Ok(Vec::new()), |value| networks::networks(value, &catalog.interfaces, &mut expose))?;
        let record = root.take("record").map_or(Ok(RecordEntry::default()), record::record)?;
        let latencies = root.take("latency").map_or(Ok(Vec::new()), latency::latencies)?;
        let replay = root.take("replay").map_or(Ok(ReplaySection::default()), replay)?;
        let view = root.take("view").map_or(Ok(ViewEntry::default()), view::view)?;
        root.finish()?;
        let file = Self {
            source,
            catalog: catalog.clone(),
            name,
            has_namespace: namespace.is_some(),
            namespace: namespace.unwrap_or_else(|| "/".to_owned()),
            node,
            remaps,
            is_rosout_disabled: false,
            launcher,
            modules,
            expose,
            networks,
            record,
            latencies,
            replay,
            view,
        };
        Ok((file, parameter_files))
    }

    /// Parses a text that contains only the keys `out` and `in` of `[expose]`, for a network of this engine.
    pub(crate) fn parse_entries(
        text: &str,
        interfaces: &Interfaces,
        engine: Option<Engine>,
    ) -> Result<Vec<ExposeEntry>> {
        let source = Source::new(Path::new("expose"), text.to_owned());
        let document = source.table()?;
        expose::entries(Table::new(&source, "[expose]", 1, document.get_ref()), interfaces, engine)
    }

    /// The file's path.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.source.path()
    }

    /// Returns true if a part of the robot is emulated.
    #[must_use]
    pub fn is_emulated(&self) -> bool {
        self.modules.iter().any(|module| module.kind.is_emulated())
    }

    /// Creates an error that points to a place.
    pub fn error_at(&self, place: &Place, problem: impl Into<String>) -> RobotFileError {
        match place {
            Place::Line(line) => self.source.error(*line, problem),
            Place::Included(source, line) => source.error(*line, problem),
            Place::Parameter(place) => place.error(problem),
            Place::Argument(argument) => {
                RobotFileError::Argument { argument: argument.clone(), problem: problem.into() }
            }
        }
    }
}

fn choice<T: Copy>(value: Value<'_>, choices: &[(&str, T)]) -> Result<T> {
    let name = value.text()?;
    choices.iter().find(|(known, _)| *known == name).map(|&(_, choice)| choice).ok_or_else(|| {
        let hint = suggestion(name, choices.iter().map(|&(known, _)| known));
        value.error(format!("unknown choice \"{name}\"{hint}"))
    })
}

/// Reads `remap` in `[robot]`: the keys are the left sides of remapping rules, the values the right sides.
fn remaps(value: Value<'_>) -> Result<RemapRules> {
    let rule = |(from, to): (String, Value<'_>)| {
        let rule = format!("{from}:={}", to.text()?);
        rule.parse::<RemapRule>().map_err(|error| to.error(error.to_string()))
    };
    value.table("remap")?.take_rest().into_iter().map(rule).collect()
}

/// Reads `interfaces` in `[robot]`: folders with packages of messages, services and actions, relative to the
/// file.
fn interface_folders(value: Option<Value<'_>>, interfaces: &Interfaces) -> Result<Vec<PathBuf>> {
    let values = value.map_or(Ok(Vec::new()), |value| value.list())?;
    let folder = |value: Value<'_>| {
        let folder = value.path().parent().unwrap_or(Path::new("")).join(value.text()?);
        interfaces.learn_folder(&folder).map_err(|error| value.error(error.to_string()))?;
        Ok(folder)
    };
    values.into_iter().map(folder).collect()
}

/// Reads a name that is valid for a ROS 2 node.
fn identifier(value: Value<'_>) -> Result<String> {
    let name = value.text()?;
    let is_valid = name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    if is_valid {
        return Ok(name.to_owned());
    }
    Err(value.error(format!(
        "\"{name}\" is not a valid name; use letters, digits and _, and do not begin with a digit"
    )))
}

/// Default options for replaying a bag of the robot; the command line overrides them.
#[derive(Clone, Debug, Default)]
pub struct ReplaySection {
    /// The modules to replay; empty for all that can be replayed.
    pub modules: Vec<String>,
    /// Rules for comparing the fields of what they publish.
    pub rules: Vec<FieldRule>,
    /// Topics that are not compared.
    pub except: Vec<TopicPattern>,
}

fn replay(value: Value<'_>) -> Result<ReplaySection> {
    let mut table = value.table("[replay]")?;
    let modules = table.take("modules").map_or(Ok(Vec::new()), |value| value.list())?;
    let modules = modules.iter().map(|value| Ok(value.text()?.to_owned())).collect::<Result<_>>()?;
    let mut rules = Vec::new();
    for (key, read) in RULES {
        for value in table.take(key).map_or(Ok(Vec::new()), |value| value.list())? {
            rules.push(read(value.text()?).map_err(|error| value.error(error.to_string()))?);
        }
    }
    let mut except = Vec::new();
    for value in table.take("except").map_or(Ok(Vec::new()), |value| value.list())? {
        except.push(TopicPattern::new(value.text()?).map_err(|error| value.error(error.to_string()))?);
    }
    table.finish()?;
    Ok(ReplaySection { modules, rules, except })
}

type ReadRule = fn(&str) -> std::result::Result<FieldRule, FieldRuleError>;

const RULES: [(&str, ReadRule); 2] = [("tolerance", FieldRule::tolerance), ("ignore", FieldRule::ignore)];

#[cfg(test)]
mod tests;
