//! Faults that modules report on `diagnostics`, for the status block.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use crate::executor::{Core, Inbox, OutletInbox, Received, SetupError};
use crate::msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};

/// The topic of REP-107.
const TOPIC: &str = "diagnostics";

/// Components with faults, by name.
#[derive(Clone, Default)]
pub(crate) struct Faults {
    by_component: Arc<Mutex<BTreeMap<String, Fault>>>,
}

struct Fault {
    level: u8,
    message: String,
}

impl Faults {
    /// Tracks the messages on `diagnostics` until the core stops.
    pub(crate) fn watch(core: &mut Core) -> Result<Self, SetupError> {
        let faults = Self::default();
        let (inbox, told) = (OutletInbox::new("faults", Inbox::KeepAll), faults.clone());
        let outlet = core.outlet(TOPIC, &inbox, move |array: Received<'_, DiagnosticArray>| {
            array.status.iter().for_each(|status| told.update(status));
        })?;
        outlet.keep();
        Ok(faults)
    }

    /// A line for each component with a fault: errors, warnings, then stale ones.
    pub(crate) fn worst_first(&self) -> Vec<String> {
        let faults = self.lock();
        let lines = |wanted: u8, name: &'static str| {
            let of_level = faults.iter().filter(move |(_, fault)| fault.level == wanted);
            of_level.map(move |(component, fault)| format!("{name}: {component}: {}", fault.message))
        };
        lines(DiagnosticStatus::ERROR, "error")
            .chain(lines(DiagnosticStatus::WARN, "warning"))
            .chain(lines(DiagnosticStatus::STALE, "stale"))
            .collect()
    }

    fn update(&self, status: &DiagnosticStatus) {
        let mut faults = self.lock();
        if status.level == DiagnosticStatus::OK {
            faults.remove(&status.name);
        } else {
            let (level, message) = (status.level, status.message.clone());
            faults.insert(status.name.clone(), Fault { level, message });
        }
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, BTreeMap<String, Fault>> {
        self.by_component.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_shown_worst_first_until_their_component_recovers() {
        let faults = Faults::default();
        let status = |name: &str, level, message: &str| DiagnosticStatus {
            level,
            name: name.into(),
            message: message.into(),
            ..DiagnosticStatus::default()
        };
        faults.update(&status("board", DiagnosticStatus::STALE, "no news"));
        faults.update(&status("servo 5", DiagnosticStatus::ERROR, "silent"));
        assert_eq!(faults.worst_first(), ["error: servo 5: silent", "stale: board: no news"]);
        faults.update(&status("servo 5", DiagnosticStatus::OK, "well"));
        assert_eq!(faults.worst_first(), ["stale: board: no news"]);
    }
}
