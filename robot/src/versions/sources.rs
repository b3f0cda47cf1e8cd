//! What the modules of a robot in other languages were made from.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use downbeat_bags::metadata::Metadata;

use super::state::LiveState;
use super::version::{Source, Version};
use crate::RobotFile;

/// What the modules of a robot in other languages were made from, by the names of the modules.
#[derive(Debug, Default)]
pub(crate) struct Sources(BTreeMap<String, (Source, Keeping)>);

/// Whether the files of a module that are no text are copied into a bag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Keeping {
    Copies,
    Hashes,
}

/// The modules of a robot in other languages, which know what they were made from.
#[derive(Debug, Default)]
pub(crate) struct SourcedModules(Vec<SourcedModule>);

#[derive(Debug)]
struct SourcedModule {
    name: String,
    files: Vec<PathBuf>,
    live: Arc<LiveState>,
    keeping: Keeping,
}

impl SourcedModules {
    pub(crate) fn of(file: &RobotFile) -> Self {
        let modules = file.modules.iter().map(|module| SourcedModule {
            name: module.name.clone(),
            files: module.kind.source_files(&module.source),
            live: Arc::clone(&module.versions.live),
            keeping: if module.reloads() { Keeping::Copies } else { Keeping::Hashes },
        });
        Self(modules.filter(|module| !module.files.is_empty()).collect())
    }

    /// What the modules were last made from: what runs. Of a module that was never made, what its files hold
    /// now.
    pub(crate) fn sources(&self) -> Sources {
        let source = |module: &SourcedModule| {
            let made = module.live.made().unwrap_or_else(|| Source::read(&module.files));
            (module.name.clone(), (made, module.keeping))
        };
        Sources(self.0.iter().map(source).collect())
    }
}

impl Sources {
    /// The key of a bag's custom data that holds one hash for each module, as JSON.
    const HASHES: &'static str = "module_sources";
    /// The key of the versions.
    const VERSIONS: &'static str = "module_versions";

    /// The sources of a robot, see [`SourcedModules::sources`].
    pub(crate) fn of(file: &RobotFile) -> Self {
        SourcedModules::of(file).sources()
    }

    /// The entries of a bag's custom data.
    pub(crate) fn entries(&self) -> Vec<(&'static str, String)> {
        if self.0.is_empty() {
            return Vec::new();
        }
        let hashes: BTreeMap<&String, &String> =
            self.0.iter().map(|(module, (source, _))| (module, &source.joint_hash)).collect();
        let versions: BTreeMap<&String, &Version> =
            self.0.iter().map(|(module, (source, _))| (module, &source.version)).collect();
        vec![
            (Self::HASHES, serde_json::json!(hashes).to_string()),
            (Self::VERSIONS, serde_json::json!(versions).to_string()),
        ]
    }

    /// True without modules in other languages.
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Copies the libraries of modules that are reloaded into a bag.
    pub(crate) fn keep_in(&self, bag: &Path) {
        let copied = self.0.values().filter(|(_, keeping)| *keeping == Keeping::Copies);
        let files = copied.flat_map(|(source, _)| &source.version.files);
        files.filter(|file| file.text.is_none()).for_each(|file| file.keep_in(bag));
    }

    /// The versions with which the modules started when a bag was recorded.
    pub(crate) fn in_bag(recorded: &Metadata) -> BTreeMap<String, Version> {
        let text = recorded.custom_data.get(Self::VERSIONS);
        text.and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default()
    }

    /// The modules whose sources are not as they were when the bag was recorded. `last` holds the last
    /// versions in the bag, where it has versions.
    pub(crate) fn changed_since(&self, recorded: &Metadata, last: &BTreeMap<String, Version>) -> Vec<String> {
        let hashes = recorded.custom_data.get(Self::HASHES);
        let hashes: BTreeMap<String, String> =
            hashes.and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default();
        let has_changed = |module: &String, source: &Source| match last.get(module) {
            Some(last) => !last.has_same_files(&source.version),
            None => hashes.get(module).is_some_and(|old| *old != source.joint_hash),
        };
        let changed = self.0.iter().filter(|(module, (source, _))| has_changed(module, source));
        changed.map(|(module, _)| module.clone()).collect()
    }
}
