//! What a document is: modules with their ports, wires, topics, and problems with their places.

use downbeat_executor::{Core, SettingValue};
use serde::Serialize;
use serde_json::Value as Json;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use super::document::{Document, Section, canonical, matches};
use downbeat_files::toml::Error as FileError;
use downbeat_robot::running::add_diagnostics;
use downbeat_robot::{
    Catalog, KindProfile, ModuleSource, PortKind, PortProfile, PortRole, RobotFile, RobotFileError, RosArgs,
    Source,
};

/// What a document shows.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Picture {
    pub(crate) modules: Vec<ShownModule>,
    pub(crate) topics: Vec<ShownTopic>,
    pub(crate) wires: Vec<Wire>,
    pub(crate) problems: Vec<Problem>,
}

/// A module with what its kind says.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct ShownModule {
    pub(crate) name: String,
    pub(crate) kind: String,
    /// The line of its header.
    line: usize,
    /// The table of the file.
    given: Json,
    /// `None` if the kind is unknown.
    profile: Option<KindProfile>,
    pub(crate) ports: Vec<ShownPort>,
}

/// A port with the name that it has in the robot.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct ShownPort {
    #[serde(flatten)]
    pub(crate) profile: PortProfile,
    /// The name of the topic, service or action after `remap`.
    pub(crate) topic: String,
}

/// A topic, service or action of the robot.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct ShownTopic {
    pub(crate) name: String,
    #[serde(rename = "is")]
    pub(crate) what: PortKind,
    #[serde(rename = "type")]
    type_name: String,
    /// True if a module publishes or serves it.
    pub(crate) has_source: bool,
    /// True if a module subscribes to it or calls it.
    has_sink: bool,
    /// The list of `[expose]` in which it may be: for what modules publish or serve, and for what they only
    /// receive or call.
    list: &'static str,
    is_exposed: bool,
    /// The pattern that exposes it, if it is not named.
    #[serde(skip_serializing_if = "Option::is_none")]
    by_pattern: Option<String>,
    /// True if a recording has it; only for topics.
    is_recorded: bool,
}

/// A connection from a port that publishes or serves to one that subscribes or calls.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Wire {
    #[serde(rename = "is")]
    what: PortKind,
    topic: String,
    from: PortName,
    to: PortName,
    /// True if the types agree.
    is_sound: bool,
}

/// A port by name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PortName {
    pub(crate) module: String,
    pub(crate) port: String,
}

/// Something wrong, with its place.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Problem {
    /// From 1; 0 if it has no line.
    pub(crate) line: usize,
    pub(crate) problem: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) module: Option<String>,
    /// The key, such as `settings.port`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) key: Option<String>,
    pub(crate) severity: Severity,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Severity {
    /// The robot does not start.
    Error,
    /// The robot starts, and probably not as meant.
    Warning,
}

/// Draws pictures, and remembers what modules that did not change are.
pub(crate) struct Drawing {
    catalog: Catalog,
    known: HashMap<String, KnownModule>,
}

#[derive(Clone)]
struct KnownModule {
    profile: Option<KindProfile>,
    /// With lines of the module's own text, from 1.
    problem: Option<(usize, String)>,
}

impl Drawing {
    pub(crate) fn new(catalog: Catalog) -> Self {
        Self { catalog, known: HashMap::new() }
    }

    pub(crate) fn catalog(&self) -> &Catalog {
        &self.catalog
    }

    /// Forgets what modules are: their files may have changed.
    pub(crate) fn forget(&mut self) {
        self.known.clear();
    }

    /// Draws a document that is, or will be, at this path.
    pub(crate) fn draw(&mut self, document: &Document, path: &Path) -> Picture {
        // The picture has the problems; the log of the program is not for them.
        tracing::subscriber::with_default(tracing::subscriber::NoSubscriber::default(), || {
            self.drawn(document, path)
        })
    }

    fn drawn(&mut self, document: &Document, path: &Path) -> Picture {
        if let Some(error) = document.syntax_error() {
            let problem = problem(error.line, error.problem);
            return Picture {
                modules: Vec::new(),
                topics: Vec::new(),
                wires: Vec::new(),
                problems: vec![problem],
            };
        }
        let sections = document.sections();
        let mut problems = Vec::new();
        let mut modules = Vec::new();
        let mut known = HashMap::new();
        for section in &sections {
            let text = &document.text()[section.range.clone()];
            let module = self.known.remove(text).unwrap_or_else(|| self.examine(text, section, path));
            let first = document.line_of(section.range.start);
            if let Some((line, text)) = &module.problem {
                problems.push(Problem {
                    module: Some(section.name.clone()),
                    key: key_of(text, section, document.line(first + line - 1)),
                    ..problem(first + line - 1, text.clone())
                });
            }
            let ports = module
                .profile
                .iter()
                .flat_map(|profile| &profile.ports)
                .map(|port| ShownPort { topic: remapped(&section.given, &port.name), profile: port.clone() });
            modules.push(ShownModule {
                name: section.name.clone(),
                kind: section.kind.clone(),
                line: first,
                given: section.given.clone(),
                ports: ports.collect(),
                profile: module.profile.clone(),
            });
            known.insert(text.to_owned(), module);
        }
        self.known = known;
        let wires = wires(&modules);
        let topics = topics(&modules, document);
        // A file that begins has no problems yet.
        if !document.text().trim().is_empty()
            && let Err(error) = self.check(document, path)
        {
            let found = located(error, path, document, &sections);
            if problems.iter().all(|known| known.line != found.line || found.line == 0) {
                problems.push(found);
            }
        }
        problems.extend(warnings(&modules, &topics));
        problems.sort_by_key(|problem| (problem.severity == Severity::Warning, problem.line));
        Picture { modules, topics, wires, problems }
    }

    /// Checks the whole file as `downbeat check` does.
    fn check(&self, document: &Document, path: &Path) -> Result<(), RobotFileError> {
        let source = Source::new(path, document.text().to_owned());
        let file = RobotFile::read_from(source, &self.catalog, &RosArgs::default())?.on_any_machine();
        let mut core = Core::new();
        add_diagnostics(&mut core, &file).map_err(|error| file.source.error(1, error.to_string()))?;
        let robot = file.build(core)?;
        robot.exposed()?;
        Ok(())
    }

    /// Finds out what one module is, and what is wrong with it alone.
    fn examine(&self, text: &str, section: &Section, path: &Path) -> KnownModule {
        // The text of the module is the rest of a file whose first line is the robot.
        let source = Source::new(path, format!("robot = {{ name = \"robot\" }}\n{text}"));
        let parsed = RobotFile::read_alone(source, &self.catalog).map(RobotFile::on_any_machine);
        let own_line = |error: RobotFileError| match error {
            RobotFileError::File(FileError::Line { line, problem, .. }) => {
                (line.saturating_sub(1).max(1), problem)
            }
            other => (1, other.to_string()),
        };
        let named = ModuleSource::new(section.name.clone(), "");
        let plain = || self.catalog.profile(&section.kind, &BTreeMap::new(), &named);
        match parsed {
            Err(error) => KnownModule { profile: plain(), problem: Some(own_line(error)) },
            Ok(file) => {
                let problem = file.build_modules(Core::new(), |_, _| None).err().map(own_line);
                let module = file.modules.first();
                let profile = module.and_then(|module| {
                    let settings: BTreeMap<String, SettingValue> =
                        module.options().settings.into_iter().collect();
                    let profile = self.catalog.profile(module.kind.name(), &settings, &module.source)?;
                    // Wrong settings hide the ports; those of the defaults are better than none.
                    let is_hidden = profile.needs.is_some() && profile.ports.is_empty();
                    let shown = if is_hidden {
                        self.catalog.profile(module.kind.name(), &BTreeMap::new(), &module.source)
                    } else {
                        None
                    };
                    let ports = shown.map(|plain| plain.ports).unwrap_or_default();
                    Some(if is_hidden { KindProfile { ports, ..profile } } else { profile })
                });
                KnownModule { profile, problem }
            }
        }
    }
}

fn problem(line: usize, problem: String) -> Problem {
    Problem { line, problem, module: None, key: None, severity: Severity::Error }
}

fn remapped(given: &Json, port: &str) -> String {
    let topic = given.get("remap").and_then(|remap| remap.get(port)).and_then(Json::as_str);
    canonical(topic.unwrap_or(port)).to_owned()
}

/// The key that a problem speaks of, or that of its line.
fn key_of(problem: &str, section: &Section, line: &str) -> Option<String> {
    let quoted = |word: &str| {
        let (_, rest) = problem.split_once(&format!("{word} \""))?;
        rest.split_once('"').map(|(name, _)| name)
    };
    let has =
        |table: &str, name: &str| section.given.get(table).is_some_and(|table| table.get(name).is_some());
    if let Some(setting) = quoted("setting") {
        return Some(format!("settings.{setting}"));
    }
    let name = quoted("topic").or_else(|| quoted("service")).or_else(|| quoted("has no"));
    match name {
        Some(name) if has("remap", name) => Some(format!("remap.{name}")),
        Some(name) if section.given.get(name).is_some() => Some(name.to_owned()),
        _ => {
            let keys = || section.given.as_object().into_iter().flat_map(|keys| keys.keys());
            let on_line = line.split_once('=').map(|(key, _)| key.trim());
            let quoted = keys().find(|key| problem.contains(&format!("\"{key}\"")));
            quoted.or_else(|| keys().find(|key| Some(key.as_str()) == on_line)).cloned()
        }
    }
}

/// The place of an error of the whole file.
fn located(error: RobotFileError, path: &Path, document: &Document, sections: &[Section]) -> Problem {
    let (line, text) = match error {
        RobotFileError::File(FileError::Line { path: of, line, problem }) if of == path => (line, problem),
        other => return problem(0, other.to_string()),
    };
    let lines = |section: &Section| {
        document.line_of(section.range.start)..=document.line_of(section.range.end.saturating_sub(1))
    };
    let section = sections.iter().find(|section| lines(section).contains(&line));
    Problem {
        module: section.map(|section| section.name.clone()),
        key: section.and_then(|section| key_of(&text, section, document.line(line))),
        ..problem(line, text)
    }
}

fn is_source(role: PortRole) -> bool {
    matches!(role, PortRole::Publishes | PortRole::Serves)
}

/// Why a port cannot be connected to another.
pub(crate) fn refusal(from: &ShownPort, to: &ShownPort) -> Option<String> {
    let (source, sink) = (&from.profile, &to.profile);
    if !is_source(source.role) || is_source(sink.role) {
        return Some(
            "a wire leads from what a module publishes or serves to what a module subscribes to or calls"
                .to_owned(),
        );
    }
    if source.what != sink.what {
        return Some(format!(
            "\"{}\" and \"{}\" are not both topics, services or actions",
            source.name, sink.name
        ));
    }
    (source.type_name != sink.type_name).then(|| {
        format!("\"{}\" is {}, \"{}\" is {}", source.name, source.type_name, sink.name, sink.type_name)
    })
}

fn each_port(modules: &[ShownModule]) -> impl Iterator<Item = (&ShownModule, &ShownPort)> {
    modules.iter().flat_map(|module| module.ports.iter().map(move |port| (module, port)))
}

fn wires(modules: &[ShownModule]) -> Vec<Wire> {
    let mut wires = Vec::new();
    for (from, source) in each_port(modules).filter(|(_, port)| is_source(port.profile.role)) {
        for (to, sink) in each_port(modules).filter(|(_, port)| !is_source(port.profile.role)) {
            if source.topic == sink.topic && source.profile.what == sink.profile.what {
                let name = |module: &ShownModule, port: &ShownPort| PortName {
                    module: module.name.clone(),
                    port: port.profile.name.clone(),
                };
                wires.push(Wire {
                    what: source.profile.what,
                    topic: source.topic.clone(),
                    from: name(from, source),
                    to: name(to, sink),
                    is_sound: source.profile.type_name == sink.profile.type_name,
                });
            }
        }
    }
    wires
}

fn topics(modules: &[ShownModule], document: &Document) -> Vec<ShownTopic> {
    let (expose, record) = (document.table("expose"), document.table("record"));
    let mut topics: BTreeMap<(PortKind, &str), ShownTopic> = BTreeMap::new();
    for (_, port) in each_port(modules) {
        let topic = topics.entry((port.profile.what, &port.topic)).or_insert_with(|| ShownTopic {
            name: port.topic.clone(),
            what: port.profile.what,
            type_name: port.profile.type_name.clone(),
            has_source: false,
            has_sink: false,
            list: "",
            is_exposed: false,
            by_pattern: None,
            is_recorded: port.profile.what == PortKind::Topic && is_recorded(&record, &port.topic),
        });
        match is_source(port.profile.role) {
            true => topic.has_source = true,
            false => topic.has_sink = true,
        }
    }
    for topic in topics.values_mut() {
        topic.list = match (topic.what, topic.has_source) {
            (PortKind::Topic, true) => "out",
            (PortKind::Topic, false) => "in",
            (PortKind::Service, true) => "services",
            (PortKind::Service, false) => "calls",
            (PortKind::Action, true) => "actions",
            (PortKind::Action, false) => "action_calls",
        };
        // Outgoing topics may come in too; only the usual way is a tick.
        let Some(entries) = expose.get(topic.list).and_then(Json::as_array) else { continue };
        let named = |entry: &Json| {
            let key = ["topic", "service", "action"].iter().find_map(|key| entry.get(key)?.as_str());
            key.or(entry.as_str()).map(str::to_owned)
        };
        let is_named = entries.iter().filter_map(named).any(|name| canonical(&name) == topic.name);
        let pattern = entries.iter().find_map(|entry| {
            let pattern = named(entry).filter(|pattern| matches(pattern, &topic.name))?;
            let except = entry.get("except").and_then(Json::as_array);
            let type_name = entry.get("type").and_then(Json::as_str);
            let is_meant = type_name.is_none_or(|name| name == topic.type_name)
                && except.is_none_or(|except| !except.iter().any(|except| is_chosen(except, &topic.name)));
            is_meant.then_some(pattern)
        });
        topic.is_exposed = is_named || pattern.is_some();
        topic.by_pattern = pattern.filter(|_| !is_named);
    }
    topics.into_values().collect()
}

fn is_chosen(entry: &Json, topic: &str) -> bool {
    entry.as_str().is_some_and(|text| canonical(text) == topic || matches(text, topic))
}

fn is_recorded(record: &Json, topic: &str) -> bool {
    let any = |key: &str| {
        let list = record.get(key)?.as_array()?;
        Some(list.iter().any(|entry| is_chosen(entry, topic)))
    };
    any("topics").unwrap_or(true) && !any("except").unwrap_or(false)
}

/// What is probably not meant: nothing that a module receives comes from anywhere, or a command goes nowhere.
fn warnings(modules: &[ShownModule], topics: &[ShownTopic]) -> Vec<Problem> {
    let lonely = |module: &ShownModule| {
        let sinks = module.ports.iter().filter(|port| port.profile.role == PortRole::Subscribes);
        let is_fed = |port: &ShownPort| {
            let topic = topics.iter().find(|topic| topic.name == port.topic && topic.what == PortKind::Topic);
            topic.is_some_and(|topic| topic.has_source || topic.is_exposed)
        };
        let sinks: Vec<_> = sinks.collect();
        let is_lonely = !sinks.is_empty() && !sinks.iter().any(|port| is_fed(port));
        is_lonely.then(|| {
            let names: Vec<_> = sinks.iter().map(|port| port.topic.as_str()).collect();
            Problem {
                line: module.line,
                problem: format!("nothing publishes what \"{}\" receives: {}", module.name, names.join(", ")),
                module: Some(module.name.clone()),
                key: None,
                severity: Severity::Warning,
            }
        })
    };
    modules.iter().filter_map(lonely).collect()
}
