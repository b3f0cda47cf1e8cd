//! Runs of a sensor module in a core whose time only the test moves.
#![allow(clippy::unwrap_used, dead_code)]

use std::time::Duration;

use downbeat_executor::{Module, ModuleOptions, Probe, SettingValue, Setup, SetupError};
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::{Message, cdr};

/// What a module has published.
pub(crate) struct Run<M> {
    pub(crate) exchanges: Vec<BusExchange>,
    pub(crate) messages: Vec<M>,
    pub(crate) statuses: Vec<DiagnosticStatus>,
}

/// The settings of a module.
pub(crate) fn settings(settings: &[(&str, SettingValue)]) -> ModuleOptions {
    let settings = settings.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
    ModuleOptions { settings, ..ModuleOptions::default() }
}

/// The value of a setting.
pub(crate) fn text(text: &str) -> SettingValue {
    text.to_owned().into()
}

impl<M: Message> Run<M> {
    /// Runs a sensor with its emulator. `topics` are those of the exchanges and of the messages.
    pub(crate) fn emulated<E: Module, S: Module>(
        emulator: (E, ModuleOptions),
        sensor: (S, ModuleOptions),
        topics: [&str; 2],
        duration: Duration,
    ) -> Self {
        let mut probe = Probe::new();
        probe.add_with("emulator", emulator.0, emulator.1).unwrap();
        Self::of(probe, sensor, topics, duration)
    }

    /// Runs a sensor alone.
    pub(crate) fn replayed<S: Module>(
        sensor: (S, ModuleOptions),
        topics: [&str; 2],
        duration: Duration,
    ) -> Self {
        let mut probe = Probe::new();
        // Nothing takes part of it.
        probe.add_with("emulator", Nothing, ModuleOptions::default()).unwrap();
        Self::of(probe, sensor, topics, duration)
    }

    fn of<S: Module>(
        mut probe: Probe,
        sensor: (S, ModuleOptions),
        topics: [&str; 2],
        duration: Duration,
    ) -> Self {
        probe.add_with("sensor", sensor.0, sensor.1).unwrap();
        let exchanges = probe.listen::<BusExchange>(topics[0]).unwrap();
        let messages = probe.listen::<M>(topics[1]).unwrap();
        let diagnostics = probe.listen::<DiagnosticArray>("diagnostics").unwrap();
        probe.advance(duration).unwrap();
        let statuses = diagnostics.take().into_iter().flat_map(|array| array.status).collect();
        Self { exchanges: exchanges.take(), messages: messages.take(), statuses }
    }

    /// The messages as a bag holds them.
    pub(crate) fn bytes(&self) -> Vec<Vec<u8>> {
        self.messages.iter().map(|message| cdr::to_vec(message)).collect()
    }

    pub(crate) fn last_status(&self) -> &DiagnosticStatus {
        self.statuses.last().unwrap()
    }

    /// A value of the last status.
    pub(crate) fn value(&self, key: &str) -> String {
        let value = self.last_status().values.iter().find(|value| value.key == key);
        value.unwrap_or_else(|| panic!("no value {key:?}")).value.clone()
    }
}

struct Nothing;

impl Module for Nothing {
    type Ports = ();

    fn setup(&mut self, _: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        Ok(())
    }
}
