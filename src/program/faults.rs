//! What modules report on `diagnostics`, for the status block.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use downbeat::executor::{Core, Module, ModuleOptions, Received, Role, Setup, SetupError};
use downbeat::msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};

/// The topic of REP-107.
const TOPIC: &str = "diagnostics";

/// The components that are not well, by name.
#[derive(Clone, Default)]
pub(crate) struct Faults {
    by_component: Arc<Mutex<BTreeMap<String, String>>>,
}

impl Faults {
    /// Adds an observer of `diagnostics`.
    pub(crate) fn watch(core: &mut Core) -> Result<Self, SetupError> {
        let faults = Self::default();
        let options = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
        core.add_with("fault_watch", Watch(faults.clone()), options)?;
        Ok(faults)
    }

    /// A line for each component that is not well.
    pub(crate) fn lines(&self) -> Vec<String> {
        self.lock().values().cloned().collect()
    }

    fn update(&self, status: &DiagnosticStatus) {
        let level = match status.level {
            DiagnosticStatus::OK => {
                self.lock().remove(&status.name);
                return;
            }
            DiagnosticStatus::WARN => "warning",
            DiagnosticStatus::ERROR => "error",
            _ => "stale",
        };
        self.lock().insert(status.name.clone(), format!("{level}: {}: {}", status.name, status.message));
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, BTreeMap<String, String>> {
        self.by_component.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

struct Watch(Faults);

impl Module for Watch {
    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe(TOPIC, |watch: &mut Self, array: Received<'_, DiagnosticArray>, _| {
            array.status.iter().for_each(|status| watch.0.update(status));
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_is_shown_until_its_component_is_well() {
        let faults = Faults::default();
        let status = |level, message: &str| DiagnosticStatus {
            level,
            name: "bus: servo 5".into(),
            message: message.into(),
            ..DiagnosticStatus::default()
        };
        faults.update(&status(DiagnosticStatus::ERROR, "silent"));
        assert_eq!(faults.lines(), ["error: bus: servo 5: silent"]);
        faults.update(&status(DiagnosticStatus::OK, "well"));
        assert!(faults.lines().is_empty());
    }
}
