//! What is known of the versions of a module.

use std::sync::Arc;

use super::joined::Versions;
use super::state::LiveState;

/// What is known of the versions of a module.
#[derive(Clone, Default)]
pub(crate) struct VersionsOfModule {
    /// What is known of its files while the robot runs.
    pub(super) live: Arc<LiveState>,
    /// In a replay, those that were recorded.
    pub(super) recorded: Option<Arc<Versions>>,
    /// Whether the robot starts without the module if it cannot be made and is reloaded.
    pub(crate) may_be_late: bool,
}

impl VersionsOfModule {
    /// Whether a bag has others than that of the start.
    pub(crate) fn are_several(&self) -> bool {
        self.recorded.as_ref().is_some_and(|versions| versions.are_several())
    }
}
