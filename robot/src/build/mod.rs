//! Builds a core with modules and journals from a robot file.

use downbeat_bridge::expose::Exposure;
use downbeat_executor::{
    Core, Idle, Linear, Pool, Scheduled, SetupError, ThreadError, ThreadOptions, Threads, TopicInfo,
};
use downbeat_servos::controllers::claims::Claims;

use super::LauncherChoice;
use super::commanders::rival_commanders;
use super::expose::canonical;
use super::file::{LauncherEntry, Located, ModuleEntry, RobotFile, RobotFileError, suggestion};
use super::latencies::Latencies;
use super::survey::Survey;
use crate::journal;
use crate::journal::events::{UnrecordedService, unrecorded_services};

type Result<T> = std::result::Result<T, RobotFileError>;

/// A core with the modules of a robot file, not yet started. The bridge and the recorder join it later.
pub struct Robot {
    /// The robot file.
    pub file: RobotFile,
    /// The core with the modules.
    pub core: Core,
    /// The measured chains.
    pub latencies: Latencies,
}

impl RobotFile {
    /// Adds the modules of the file to `core` and sets the launcher of the file.
    ///
    /// # Errors
    /// Returns an error with path and line if a module cannot be set up, the file names topics that no module
    /// has, or the system does not allow the CPUs or priorities of a thread.
    pub fn build(self, core: Core) -> Result<Robot> {
        let mut core = self.build_modules(self.launch(core)?, |_, _| None)?;
        for UnrecordedService { service, types, modules } in
            unrecorded_services(&core, &self.catalog.interfaces)
        {
            let modules = modules.into_iter().collect::<Vec<_>>().join(", ");
            tracing::warn!(
                "calls of service \"{service}\" between {modules} cannot be recorded for a replay of only one of them: \
                 {types} are plain Rust types"
            );
        }
        journal::add(&mut core, &self.catalog.interfaces, self.launcher.idle)
            .map_err(|error| self.source.error(1, error.to_string()))?;
        let latencies = Latencies::add(&mut core, &self.latencies)
            .map_err(|error| self.source.error(1, error.to_string()))?;
        let robot = Robot { file: self, core, latencies };
        robot.check()?;
        Ok(robot)
    }

    /// Adds the mechanisms of the catalog and the modules of the file to a core. Each module is added by its
    /// kind, unless `instead` replaces that.
    pub fn build_modules(
        &self,
        core: Core,
        mut instead: impl FnMut(&ModuleEntry, &mut Core) -> Option<std::result::Result<(), SetupError>>,
    ) -> Result<Core> {
        let mut core = self.catalog.engage(core);
        if self.modules.iter().any(|module| module.kind.claims_joints()) {
            core = core.with_mechanism(Claims::default());
        }
        for module in &self.modules {
            self.check_thread(module)?;
            let added = instead(module, &mut core)
                .unwrap_or_else(|| module.add_to(&mut core, &self.catalog.interfaces));
            added.map_err(|error| self.located(module, &error))?;
        }
        Ok(core)
    }

    /// Sets the launcher of the file for a core.
    pub(crate) fn launch(&self, core: Core) -> Result<Core> {
        let LauncherEntry { line, choice, threads, idle, deadline } = &self.launcher;
        let refuse = |problem: String| self.source.error(*line, problem);
        let mut core = core.with_idle(*idle);
        if let Some(deadline) = deadline {
            core = core.with_cycle_deadline(*deadline).map_err(|error| refuse(error.to_string()))?;
        }
        check("core", threads).map_err(|error| refuse(error.to_string()))?;
        Ok(match choice {
            LauncherChoice::Linear => core.with_launcher(Scheduled::new(Linear, threads.clone())),
            LauncherChoice::Pool(count) => {
                let pool = Pool::with_options(count.get(), threads.clone());
                core.with_launcher(pool.map_err(|error| refuse(error.to_string()))?)
            }
            LauncherChoice::Threads => {
                let launcher = Threads::with_options(threads.clone());
                let launcher = launcher.map_err(|error| refuse(error.to_string()))?;
                core.with_launcher(Scheduled::new(launcher, threads.clone()))
            }
            LauncherChoice::Other(name) => {
                let launcher = self.catalog.make_launcher(name, threads).ok_or_else(|| {
                    refuse(format!(
                        "unknown launcher \"{name}\"{}",
                        suggestion(name, self.catalog.launchers())
                    ))
                })?;
                let launcher =
                    launcher.map_err(|problem| refuse(format!("launcher \"{name}\": {problem}")))?;
                core.with_launcher(Scheduled::new(launcher, threads.clone()))
            }
        })
    }

    fn check_thread(&self, module: &ModuleEntry) -> Result<()> {
        check(&module.name, &module.running.thread)
            .map_err(|error| self.error_at(&module.at(module.thread_line), error.to_string()))
    }

    /// The settings that a module also needs, where it lacks one: it refuses the first only.
    fn further_settings(&self, module: &ModuleEntry, setting: &str) -> String {
        if module.settings.contains_key(setting) {
            return String::new();
        }
        let given = module.settings.iter().map(|(name, given)| (name.clone(), given.value.clone())).collect();
        let profile = self.catalog.profile(module.kind.name(), &given, &module.source);
        let needed = profile.into_iter().flat_map(|profile| profile.settings);
        let needed = needed.filter(|known| {
            known.is_required && known.name != setting && !module.settings.contains_key(&known.name)
        });
        let names: Vec<String> = needed.map(|known| format!("\"{}\"", known.name)).collect();
        if names.is_empty() { String::new() } else { format!("; it also needs {}", names.join(", ")) }
    }

    /// Converts the error of a module's setup to an error at the line that caused it.
    fn located(&self, module: &ModuleEntry, error: &SetupError) -> RobotFileError {
        let of_setting = |name: &String| module.settings.get(name).map(|setting| setting.place.clone());
        let of_remap = |name: &String| module.remaps.get(name).map(|remap| module.at(remap.line));
        let (place, hint) = match error {
            SetupError::UnknownSetting { setting, known, .. } => {
                (of_setting(setting), suggestion(setting, known.iter().map(String::as_str)))
            }
            SetupError::SettingValue { setting, .. } => {
                (of_setting(setting), self.further_settings(module, setting))
            }
            SetupError::UnknownTopic { topic, known, .. } => {
                (of_remap(topic), suggestion(topic, known.iter().map(String::as_str)))
            }
            SetupError::TopicType { topic: name, .. }
            | SetupError::InvalidTopicName { topic: name, .. }
            | SetupError::ServiceType { service: name, .. }
            | SetupError::InvalidServiceName { service: name, .. }
            | SetupError::DuplicateServer { service: name, .. } => {
                let is_meant = |remap: &str| remap.trim_start_matches('/') == name.trim_start_matches('/');
                let remap = module.remaps.values().find(|remap| is_meant(&remap.value));
                (remap.map(|remap| module.at(remap.line)), String::new())
            }
            _ => (None, String::new()),
        };
        self.error_at(&place.unwrap_or_else(|| module.at(module.line)), format!("{error}{hint}"))
    }
}

impl RobotFile {
    /// Removes CPUs, priorities and spinning of threads. They do not affect results, and a machine that only
    /// checks or replays the robot may not allow them.
    #[must_use]
    pub fn on_any_machine(mut self) -> Self {
        self.launcher.threads = ThreadOptions::default();
        self.launcher.idle = Idle::default();
        for module in &mut self.modules {
            module.running.thread = ThreadOptions::default();
        }
        self
    }

    /// Returns errors with path and line for the CPUs and priorities that this machine does not allow.
    #[must_use]
    pub fn thread_problems(&self) -> Vec<RobotFileError> {
        let launcher = self.launch(Core::new()).err();
        let modules = self.modules.iter().filter_map(|module| self.check_thread(module).err());
        launcher.into_iter().chain(modules).collect()
    }

    /// Checks that no module drives a device, before a robot runs on recorded input.
    ///
    /// # Errors
    /// Returns an error with path and line if a module drives a device.
    pub fn refuse_devices(&self) -> Result<()> {
        let Some(module) = self.modules.iter().find(|module| module.kind.uses_device()) else {
            return Ok(());
        };
        let ModuleEntry { name, kind, .. } = module;
        let problem = format!(
            "\"{name}\" is of kind \"{}\", which drives a device; play the bag into a robot file without it",
            kind.name()
        );
        Err(self.error_at(&module.at(module.line), problem))
    }
}

impl Robot {
    /// What the core has. Where a module could not be made that starts when its file is saved, a name of the
    /// file may mean nothing yet.
    pub(crate) fn survey(&self) -> Survey {
        let survey = Survey::of(&self.core);
        if self.late_modules().is_empty() { survey } else { survey.lenient() }
    }

    /// The modules that could not be made, and start when their files are saved.
    pub(crate) fn late_modules(&self) -> Vec<String> {
        let late = self.core.modules().into_iter().filter(|module| module.panic.is_some());
        late.map(|module| module.name.to_string()).collect()
    }

    /// Checks what the file says about the robot as a whole.
    fn check(&self) -> Result<()> {
        let survey = self.survey();
        self.file.all_exposures(&survey)?;
        let topics: Vec<_> = self.core.topics().cloned().collect();
        self.file.passed_over(&topics).iter().for_each(|sentence| tracing::warn!("{sentence}"));
        rival_commanders(&self.file, &self.core).iter().for_each(|sentence| tracing::warn!("{sentence}"));
        self.file.parameters_of(&survey)?;
        self.lifecycle_exposures()?;
        self.file.recorded_of(&self.file.record, &survey)?;
        for Located { line, value } in self.file.latencies.iter().flat_map(|entry| [&entry.from, &entry.to]) {
            if self.late_modules().is_empty() {
                self.file.topic(&topics, value, *line, "measure")?;
            }
        }
        let problems = survey.problems();
        if !problems.is_empty() {
            // What there is instead does not matter yet.
            let problems =
                problems.iter().map(|problem| problem.split("; there is ").next().unwrap_or(problem));
            let (late, problems) = (self.late_modules().join(", "), problems.collect::<Vec<_>>().join("; "));
            tracing::warn!("until {late} can be made, this is neither exposed nor recorded: {problems}");
        }
        Ok(())
    }

    /// Returns the topics that the bridge exposes.
    ///
    /// # Errors
    /// Returns an error with path and line if a topic does not exist, no module publishes an outgoing topic,
    /// or the type differs.
    pub fn exposures(&self) -> Result<Vec<Exposure>> {
        self.file.exposures_among(&self.file.expose.topics, &self.survey(), &[])
    }
}

impl RobotFile {
    /// Returns the topic with this name.
    pub(super) fn topic<'a>(
        &self,
        topics: &'a [TopicInfo],
        name: &str,
        line: usize,
        what: &str,
    ) -> Result<&'a TopicInfo> {
        topics.iter().find(|topic| *topic.name == *canonical(name)).ok_or_else(|| {
            let hint = suggestion(canonical(name), topics.iter().map(|topic| &*topic.name));
            self.source.error(line, format!("no module has a topic \"{name}\" to {what}{hint}"))
        })
    }
}

/// Checks in a separate thread whether the system allows the options.
fn check(thread: &str, options: &ThreadOptions) -> std::result::Result<(), ThreadError> {
    if *options != ThreadOptions::default() {
        // The thread does nothing and cannot panic.
        let _ = options.spawn(thread, || {})?.join();
    }
    Ok(())
}

#[cfg(test)]
mod tests;
