//! The sources of modules in other languages: a bag holds their hashes, so that a replay can report a change.

use std::collections::BTreeMap;
use std::path::Path;

use downbeat_bags::metadata::Metadata;
use sha2::{Digest, Sha256};

use super::RobotFile;

/// The hash of the source of each module in another language, by the name of the module.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Sources(BTreeMap<String, String>);

impl Sources {
    /// The key of a bag's custom data that holds them, as JSON.
    const KEY: &'static str = "module_sources";

    /// Reads the sources of a robot as they are now. A file that cannot be read counts as empty: loading the module reports it.
    pub(crate) fn of(file: &RobotFile) -> Self {
        let hashed = file.modules.iter().filter_map(|module| {
            let files = module.kind.source_files(&module.source);
            (!files.is_empty()).then(|| (module.name.clone(), hash(&files)))
        });
        Self(hashed.collect())
    }

    /// The entry of a bag's custom data; `None` without such modules.
    pub(crate) fn entry(&self) -> Option<(&'static str, String)> {
        (!self.0.is_empty()).then(|| (Self::KEY, serde_json::json!(self.0).to_string()))
    }

    /// The modules whose sources are not as they were when the bag was recorded.
    pub(crate) fn changed_since(&self, recorded: &Metadata) -> Vec<String> {
        let recorded = recorded.custom_data.get(Self::KEY);
        let recorded: BTreeMap<String, String> =
            recorded.and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default();
        let changed =
            self.0.iter().filter(|(module, hash)| recorded.get(*module).is_some_and(|old| old != *hash));
        changed.map(|(module, _)| module.clone()).collect()
    }
}

fn hash(files: &[impl AsRef<Path>]) -> String {
    let mut hash = Sha256::new();
    for file in files {
        let content = crate::msgs::user_file::read(file).unwrap_or_default();
        hash.update((content.len() as u64).to_le_bytes());
        hash.update(content);
    }
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}
