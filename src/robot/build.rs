//! From a robot file to a core with its modules, and with the journal of their runs.

use downbeat_executor::{Core, Linear, ModuleOptions, Pool, SetupError};

use super::file::{ExposeEntry, ModuleEntry, RobotFile, RobotFileError, suggestion};
use super::{Direction, LauncherChoice};
use crate::step_journal::StepJournal;

type Result<T> = std::result::Result<T, RobotFileError>;

/// A core with the modules of a robot file, not yet started. The bridge and the recorder join it later.
pub struct Robot {
    /// What the file says.
    pub file: RobotFile,
    /// The modules.
    pub core: Core,
}

impl RobotFile {
    /// Adds the file's modules to a core that is made by `core`, and gives it the file's launcher.
    ///
    /// # Errors
    /// If a module cannot be set up as the file says, or the file names topics that no module has; with path
    /// and line.
    pub fn build(self, core: Core) -> Result<Robot> {
        let mut core = match self.launcher {
            LauncherChoice::Linear => core.with_launcher(Linear),
            LauncherChoice::Pool(threads) => {
                let pool = Pool::new(threads).map_err(|error| self.source.error(1, error.to_string()))?;
                core.with_launcher(pool)
            }
        };
        for module in &self.modules {
            self.add(module, &mut core)?;
        }
        StepJournal::add(&mut core).map_err(|error| self.source.error(1, error.to_string()))?;
        let robot = Robot { file: self, core };
        robot.check_topics()?;
        Ok(robot)
    }

    fn add(&self, module: &ModuleEntry, core: &mut Core) -> Result<()> {
        let added = module.kind.add_to(core, &module.name, module.options());
        added.map_err(|error| self.located(module, &error))
    }

    /// The error of a module's setup at the line that caused it.
    fn located(&self, module: &ModuleEntry, error: &SetupError) -> RobotFileError {
        let of_setting = |name: &String| module.settings.get(name).map(|setting| setting.line);
        let of_remap = |name: &String| module.remaps.get(name).map(|remap| remap.line);
        let (line, hint) = match error {
            SetupError::UnknownSetting { setting, known, .. } => {
                (of_setting(setting), suggestion(setting, known.iter().map(String::as_str)))
            }
            SetupError::SettingValue { setting, .. } => (of_setting(setting), String::new()),
            SetupError::UnknownTopic { topic, known, .. } => {
                (of_remap(topic), suggestion(topic, known.iter().map(String::as_str)))
            }
            _ => (None, String::new()),
        };
        self.source.error(line.unwrap_or(module.line), format!("{error}{hint}"))
    }
}

impl ModuleEntry {
    /// The settings and remaps that the file gives the module.
    #[must_use]
    pub fn options(&self) -> ModuleOptions {
        let settings = self.settings.iter().map(|(name, value)| (name.clone(), value.value.clone()));
        let remaps = self.remaps.iter().map(|(from, to)| (from.clone(), to.value.clone()));
        ModuleOptions { settings: settings.collect(), remaps: remaps.collect(), ..ModuleOptions::default() }
    }
}

impl Robot {
    /// An error at the line of an exposed topic.
    #[must_use]
    pub fn expose_error(&self, entry: &ExposeEntry, problem: &str) -> RobotFileError {
        self.file.source.error(entry.line, problem)
    }

    /// Checks that what is exposed and recorded is there.
    fn check_topics(&self) -> Result<()> {
        for entry in &self.file.expose {
            self.check_topic(&entry.topic, entry.line, "expose")?;
            let is_published = self.topic(&entry.topic).is_some_and(|topic| topic.is_published);
            if entry.direction == Direction::Out && !is_published {
                let problem = format!(
                    "no module publishes \"{}\", so there is nothing to send out; does it belong under \"in\"?",
                    entry.topic
                );
                return Err(self.expose_error(entry, &problem));
            }
        }
        let recorded = self.file.record.topics.iter().flatten();
        recorded.into_iter().try_for_each(|topic| self.check_topic(topic, self.file.record.line, "record"))
    }

    fn check_topic(&self, name: &str, line: usize, what: &str) -> Result<()> {
        if self.topic(name).is_some() {
            return Ok(());
        }
        let hint = suggestion(name, self.core.topics().iter().map(|topic| &*topic.name));
        Err(self.file.source.error(line, format!("no module has a topic \"{name}\" to {what}{hint}")))
    }

    fn topic(&self, name: &str) -> Option<&downbeat_executor::TopicInfo> {
        let name = name.strip_prefix('/').unwrap_or(name);
        self.core.topics().iter().find(|topic| *topic.name == *name)
    }
}
