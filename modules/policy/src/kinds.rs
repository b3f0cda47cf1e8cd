//! The kinds of modules that this package offers to robot files.

use std::path::PathBuf;

use downbeat_executor::{SettingValue, Synchrony};
use downbeat_kind::{Kind, ModuleSource};

use crate::module::{Files, Policy};

/// The kinds.
#[must_use]
pub fn kinds() -> Vec<Kind> {
    vec![
        Kind::foreign(
            "policy",
            "a neural network in an ONNX file that moves a robot (docs/policies.md)",
            [&["file"], &[]],
            |source| Ok(Box::new(Policy::load(&files(source)?)?)),
            // A file that cannot be read is refused when the module is loaded.
            |source| {
                let Ok(Files { description, .. }) = files(source) else { return Vec::new() };
                let network = Policy::network_of(&description);
                [Some(description), network].into_iter().flatten().collect()
            },
        )
        .with_synchrony(Synchrony::WhenDue),
    ]
}

fn files(source: &ModuleSource) -> Result<Files, String> {
    let Some(SettingValue::Text(file)) = source.keys.get("file") else {
        return Err("`file` is the policy file, such as \"balance.toml\"".to_owned());
    };
    let description = source.folder.join(file);
    let replaced = source.replaced.clone();
    let to_read = move |file: PathBuf| replaced.get(&file).cloned().unwrap_or(file);
    Ok(Files { description, to_read: Box::new(to_read) })
}
