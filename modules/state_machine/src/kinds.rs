//! The kinds of modules that this package offers to robot files.

use downbeat_executor::{SettingValue, Synchrony};
use downbeat_kind::{Kind, ModuleSource};

use crate::{PANEL, StateMachineOptions, load};

/// The kinds.
#[must_use]
pub fn kinds() -> Vec<Kind> {
    let options = |source: &ModuleSource| {
        let Some(SettingValue::Text(file)) = source.keys.get("file") else {
            return Err("`file` is the chart, such as \"player.scxml\"".to_owned());
        };
        let path = source.file_to_read(&source.folder.join(file));
        Ok(StateMachineOptions { path, is_reloaded: source.is_set("reload", true)? })
    };
    vec![
        Kind::foreign(
            "state_machine",
            "decisions as a statechart in a file, a subset of SCXML (docs/state_machine.md)",
            [&["file"], &["reload"]],
            move |source| load(&options(source)?),
            move |source| options(source).map(|options| vec![options.path]).unwrap_or_default(),
        )
        .reloaded()
        .with_panel("Chart", PANEL, &["~/mermaid", "~/state"])
        .with_synchrony(Synchrony::WhenDue),
    ]
}
