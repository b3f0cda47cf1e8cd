//! The world of a chart, beside its variables.

use std::collections::BTreeMap;
use std::time::Duration;

/// What expressions can ask for beside their variables.
#[derive(Debug, Default)]
pub(crate) struct World {
    /// Since any epoch.
    pub(crate) now: Duration,
    /// When each active state was entered, by its id.
    pub(crate) entered: BTreeMap<String, Duration>,
    /// When each variable that holds messages last received one.
    pub(crate) received: BTreeMap<String, Option<Duration>>,
}
