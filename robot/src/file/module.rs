//! `[[module]]` in a robot file.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use downbeat_darwin_op::emulator::MemoryPorts;
use downbeat_executor::{
    Inbox, LifecycleState, ModuleOptions, Restart, SettingValue, Synchrony, ThreadOptions,
};
use downbeat_kind::{Kind, ModuleSource};

use super::table::{Table, Value};
use super::{Given, Located, Place, RobotFileError, Source, choice, identifier, launcher, suggestion};
use crate::Catalog;
use crate::features::missing_kind;
use crate::journal;
use crate::latencies;
use crate::versions::VersionsOfModule;

type Result<T> = std::result::Result<T, RobotFileError>;

/// A module of a robot file.
pub struct ModuleEntry {
    pub(crate) line: usize,
    /// The file that has it, if that is not the robot file itself.
    pub(super) included: Option<Arc<Source>>,
    /// The name, unique in the robot.
    pub name: String,
    /// The kind of module.
    pub kind: Kind,
    /// Its settings, and who gave them.
    pub settings: BTreeMap<String, Given>,
    pub(crate) remaps: BTreeMap<String, Located<String>>,
    /// Of a module in another language: which module it is.
    pub source: ModuleSource,
    pub(crate) versions: VersionsOfModule,
    /// The line in the file with the CPUs or the priority of its thread.
    pub(crate) thread_line: usize,
    /// The options of the module, without settings and remapping rules.
    pub(crate) running: ModuleOptions,
}

/// Names of modules that the program adds to a robot.
const RESERVED_NAMES: [&str; 6] = [
    // Threads of outlets, which `top` shows like modules.
    "bridge",
    "recorder",
    downbeat_bridge::expose::CALLS_MODULE_NAME,
    downbeat_bridge::expose::SERVICES_MODULE_NAME,
    downbeat_bridge::clock::MODULE_NAME,
    downbeat_bridge::diagnostics::MODULE_NAME,
];

/// The default delay before a module that has panicked is restarted.
const USUAL_BACKOFF: Duration = Duration::from_secs(1);

impl ModuleEntry {
    /// A module that is not in the file, with the name of its kind.
    #[cfg(feature = "football")]
    pub(super) fn of_program(kind: Kind, namespace: &str) -> Self {
        let name = match namespace {
            "" => kind.name().to_owned(),
            namespace => format!("{namespace}/{}", kind.name()),
        };
        Self {
            line: 1,
            included: None,
            source: ModuleSource { module: name.clone(), ..ModuleSource::default() },
            versions: VersionsOfModule::default(),
            name,
            running: ModuleOptions { namespace: namespace.to_owned(), ..kind.options() },
            kind,
            settings: BTreeMap::new(),
            remaps: BTreeMap::new(),
            thread_line: 1,
        }
    }

    /// Its line.
    #[cfg(feature = "football")]
    pub fn place(&self) -> Place {
        self.at(self.line)
    }

    /// Returns the options with which the module joins a core.
    #[must_use]
    pub fn options(&self) -> ModuleOptions {
        let settings = self.settings.iter().map(|(name, given)| (name.clone(), given.value.clone()));
        let remaps = self.remaps.iter().map(|(from, to)| (from.clone(), to.value.clone()));
        let wildcards = self.settings.iter().filter(|(_, given)| given.is_wildcard);
        ModuleOptions {
            settings: settings.collect(),
            optional_settings: wildcards.map(|(name, _)| name.clone()).collect(),
            remaps: remaps.collect(),
            ..self.running.clone()
        }
    }

    /// Returns true for a module that simulates devices, and for one whose device is simulated in this
    /// process.
    pub(crate) fn has_simulated_device(&self) -> bool {
        let port = self.settings.get("port").map(|given| &given.value);
        let is_in_memory = matches!(port, Some(SettingValue::Text(port)) if MemoryPorts::is_memory(port));
        self.kind.is_emulated() || (self.kind.uses_device() && is_in_memory)
    }

    /// True for a module that runs in a process of its own.
    #[must_use]
    pub fn is_isolated(&self) -> bool {
        self.source.is_set("isolate", false).unwrap_or(false)
    }

    /// True for a module in another language that is loaded again when its files change.
    pub(crate) fn reloads(&self) -> bool {
        self.kind.reloads(&self.source)
    }

    /// A line of the file that has the module.
    pub(crate) fn at(&self, line: usize) -> Place {
        match &self.included {
            None => Place::Line(line),
            Some(source) => Place::Included(Arc::clone(source), line),
        }
    }
}

pub(super) fn module(value: Value<'_>, catalog: &Catalog) -> Result<ModuleEntry> {
    let mut table = value.table("[[module]]")?;
    let kind_value = table.require("kind")?;
    let kind_name = kind_value.text()?;
    let kind = catalog.kind(kind_name).cloned().ok_or_else(|| {
        let hint = match missing_kind(kind_name) {
            Some(reason) => format!(": {reason}"),
            None => {
                suggestion(kind_name, catalog.kinds().map(Kind::name)) + project_of(value.path()).as_str()
            }
        };
        kind_value.error(format!("unknown kind of module \"{kind_name}\"{hint}"))
    })?;
    let name_value = table.take("name");
    let line = name_value.map_or(kind_value.line(), |value| value.line());
    let name = name_value.map_or(Ok(kind.name().to_owned()), module_name)?;
    let settings = settings(table.take("settings"), &kind)?;
    let remaps = entries(table.take("remap"), "remap", |value| {
        Ok(Located { line: value.line(), value: value.text()?.to_owned() })
    })?;
    let keys = source_keys(&mut table, &kind, &settings)?;
    let synchrony = synchrony(&mut table, &kind)?;
    let (thread_line, thread) = thread(&mut table, synchrony, line)?;
    let running = ModuleOptions {
        synchrony,
        initial_state: table.take("initial_state").map_or(Ok(LifecycleState::default()), initial_state)?,
        restart: table.take("restart").map_or(Ok(Restart::default()), restart)?,
        deadline: table.take("deadline").map(|value| value.duration()).transpose()?,
        namespace: table.take("namespace").map_or(Ok(String::new()), namespace)?,
        thread,
        ..ModuleOptions::default()
    };
    table.finish()?;
    let folder = value.path().parent().map(Path::to_owned).unwrap_or_default();
    let source = ModuleSource {
        module: name.clone(),
        folder,
        keys,
        deadline: running.deadline,
        ..ModuleSource::default()
    };
    let versions = VersionsOfModule::default();
    Ok(ModuleEntry {
        line,
        included: None,
        name,
        kind,
        settings,
        remaps,
        source,
        versions,
        thread_line,
        running,
    })
}

/// Says where the kinds of a project come from, if a robot file is that of a cargo project and this is not
/// its program.
fn project_of(file: &Path) -> String {
    let folder = file.parent().unwrap_or(Path::new(""));
    let manifest = std::fs::read_to_string(folder.join("Cargo.toml")).unwrap_or_default();
    let manifest: toml::Table = manifest.parse().unwrap_or_default();
    let Some(name) =
        manifest.get("package").and_then(|package| package.get("name")).and_then(|name| name.as_str())
    else {
        return String::new();
    };
    let program = std::env::current_exe().unwrap_or_default();
    if program.file_stem().is_some_and(|stem| stem == name) || manifest.get("dependencies").is_none() {
        return String::new();
    }
    format!(
        "; kinds of the project {name} are in its own program: `cargo run --release -- run ROBOT.toml` in its folder"
    )
}

/// Reads the settings of a module; files are relative to the file that names them.
pub(super) fn settings(value: Option<Value<'_>>, kind: &Kind) -> Result<BTreeMap<String, Given>> {
    let folder = value.and_then(|value| value.path().parent());
    let mut settings = entries(value, "settings", |value| {
        Ok(Given { place: Place::Line(value.line()), value: value.setting()?, is_wildcard: false })
    })?;
    for name in kind.files() {
        if let Some(Given { value: SettingValue::Text(file), .. }) = settings.get_mut(name)
            && !file.is_empty()
            && !file.contains('\n')
            && let Some(folder) = folder
        {
            *file = folder.join(&*file).display().to_string();
        }
    }
    Ok(settings)
}

/// Reads what comes before names of topics: names with slashes between them.
pub(super) fn namespace(value: Value<'_>) -> Result<String> {
    let text = value.text()?.trim_matches('/');
    let is_part = |part: &str| {
        part.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
            && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    if text.split('/').all(is_part) {
        return Ok(text.to_owned());
    }
    Err(value.error(format!(
        "\"{text}\" is not a namespace; use letters, digits and _, with / between parts, such as \"blue_1\""
    )))
}

/// Reads the keys that only modules of this kind have.
fn source_keys(
    table: &mut Table<'_>,
    kind: &Kind,
    settings: &BTreeMap<String, Given>,
) -> Result<BTreeMap<String, SettingValue>> {
    let [required, optional] = kind.keys();
    let mut keys = BTreeMap::new();
    for key in required {
        if table.peek(key).is_none()
            && let Some(Given { place: Place::Line(line), .. }) = settings.get(*key)
        {
            let reason = format!("\"{key}\" of a {} is not a setting: it stands next to `kind`", kind.name());
            return Err(table.error(*line, reason));
        }
        keys.insert((*key).to_owned(), table.require(key)?.setting()?);
    }
    for key in optional {
        if let Some(value) = table.take(key) {
            keys.insert((*key).to_owned(), value.setting()?);
        }
    }
    Ok(keys)
}

fn module_name(value: Value<'_>) -> Result<String> {
    let name = identifier(value)?;
    if RESERVED_NAMES.contains(&&*name)
        || journal::MODULE_NAMES.contains(&&*name)
        || *name == *latencies::MODULE_NAME
    {
        return Err(
            value.error(format!("\"{name}\" is the name of a module that the program adds; choose another"))
        );
    }
    Ok(name)
}

fn entries<T>(
    value: Option<Value<'_>>,
    name: &str,
    read: impl Fn(Value<'_>) -> Result<T>,
) -> Result<BTreeMap<String, T>> {
    let Some(value) = value else { return Ok(BTreeMap::new()) };
    let entries = value.table(name)?.take_rest().into_iter();
    entries.map(|(key, value)| Ok((key, read(value)?))).collect()
}

fn synchrony(table: &mut Table<'_>, kind: &Kind) -> Result<Synchrony> {
    let synchrony = match table.take("synchrony") {
        None => kind.synchrony(),
        Some(value) => {
            let choices = [("when_due", 0), ("every_cycle", 1), ("detached", 2)];
            match (choice(value, &choices)?, kind.synchrony()) {
                (0, _) => Synchrony::WhenDue,
                (1, _) => Synchrony::EveryCycle,
                (_, detached @ Synchrony::Detached(_)) => detached,
                _ => Synchrony::Detached(Kind::INBOX),
            }
        }
    };
    let Some(value) = table.take("inbox") else { return Ok(synchrony) };
    if !matches!(synchrony, Synchrony::Detached(_)) {
        return Err(value.error("\"inbox\" needs synchrony = \"detached\""));
    }
    let inbox = match value.text() {
        Ok("all") => Inbox::KeepAll,
        _ => {
            let batches = value.number_in(1..=i64::from(u32::MAX), "a number of batches above 0, or \"all\"");
            batches.map(|count| Inbox::KeepLast(NonZeroUsize::new(count).unwrap_or(NonZeroUsize::MIN)))?
        }
    };
    Ok(Synchrony::Detached(inbox))
}

fn thread(table: &mut Table<'_>, synchrony: Synchrony, line: usize) -> Result<(usize, ThreadOptions)> {
    let given = table.peek("priority").or(table.peek("cpus"));
    let options = launcher::thread(table)?;
    match given {
        Some(value) if !matches!(synchrony, Synchrony::Detached(_)) => Err(value.error(
            "\"cpus\" and \"priority\" of a module need synchrony = \"detached\"; for the others give them in \
             [launcher]",
        )),
        given => Ok((given.map_or(line, |value| value.line()), options)),
    }
}

fn initial_state(value: Value<'_>) -> Result<LifecycleState> {
    let states = [LifecycleState::Unconfigured, LifecycleState::Inactive, LifecycleState::Active];
    let names = states.map(|state| state.to_string());
    let choices: Vec<_> = names.iter().map(String::as_str).zip(states).collect();
    choice(value, &choices)
}

/// Reads "never", "always" or a number of times, or a table with one of these and the back-off.
fn restart(value: Value<'_>) -> Result<Restart> {
    let Some(mut table) = value.as_table("restart") else { return policy(value, USUAL_BACKOFF) };
    let times = table.require("times")?;
    let backoff = table.take("backoff").map_or(Ok(USUAL_BACKOFF), |value| value.duration())?;
    table.finish()?;
    policy(times, backoff)
}

fn policy(times: Value<'_>, backoff: Duration) -> Result<Restart> {
    match times.text() {
        Ok("never") => Ok(Restart::Never),
        Ok("always") => Ok(Restart::Always { backoff }),
        Ok(other) => {
            let hint = suggestion(other, ["never", "always"]);
            Err(times.error(format!("unknown choice \"{other}\"{hint}")))
        }
        Err(_) => {
            let what = "\"never\", \"always\", or how many times";
            Ok(Restart::Times { limit: times.number_in(1..=i64::from(u32::MAX), what)?, backoff })
        }
    }
}
