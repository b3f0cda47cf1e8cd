//! The emulator as a module of the robot whose hardware it emulates.

use super::{Emulator, EmulatorOptions, Fault, MemoryPorts, Timing, has_servo};
use downbeat_executor::{Context, Module, Setup, SetupError, TransitionError};
use std::path::PathBuf;

/// Runs an [`Emulator`] as long as the robot runs, so that the hardware module finds a port.
///
/// Settings: `link`, the path of the port, or `memory:NAME` for a port in memory, which exists from the setup on; `seed`;
/// `faults`, each in the textual form of [`Fault`]. It has no topics: everything goes through the port. Leave it out of replays.
#[derive(Default)]
pub struct DarwinOpEmulator {
    ports: MemoryPorts,
    options: EmulatorOptions,
    emulator: Option<Emulator>,
}

impl DarwinOpEmulator {
    /// An emulator that can be among these ports in memory.
    #[must_use]
    pub fn new(ports: MemoryPorts) -> Self {
        Self { ports, ..Self::default() }
    }
}

impl Module for DarwinOpEmulator {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let link = setup.setting(
            "link",
            "/tmp/downbeat_darwin_op_emulated".to_owned(),
            "path of the port, or memory:NAME; the hardware module's setting \"port\" is the same",
        )?;
        let seed = setup.setting("seed", 1_i64, "same seed, same starting pose, noise and faults")?;
        let faults = setup.setting(
            "faults",
            Vec::<String>::new(),
            "what goes wrong, such as dead-servo:5@3s..6s, drop:0.01, flip:0.001, close-port@8s..9s",
        )?;
        let texts = setup.value(faults).map_or(&[][..], Vec::as_slice);
        let parsed: Result<Vec<Fault>, _> =
            texts.iter().map(|text| text.parse::<Fault>()?.check(has_servo)).collect();
        let port = setup.value(link).cloned().unwrap_or_default();
        let is_memory = MemoryPorts::is_memory(&port);
        self.options = EmulatorOptions {
            link: Some(PathBuf::from(&port)),
            // Negative seeds are valid.
            seed: setup.value(seed).map_or(0, |seed| seed.cast_unsigned()),
            timing: if is_memory { Timing::Stepped } else { Timing::Measured },
            faults: parsed.map_err(|error| setup.refuse_value(faults, error.to_string()))?,
        };
        if is_memory {
            let emulator = Emulator::in_memory(&self.options, None);
            let offered = self.ports.offer(&port, &emulator);
            offered.map_err(|error| setup.refuse_value(link, error.to_string()))?;
            self.emulator = Some(emulator);
        }
        Ok(())
    }

    fn activate(&mut self, _ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        if self.options.timing == Timing::Measured {
            self.emulator = Some(Emulator::start(self.options.clone())?);
        }
        Ok(())
    }

    fn deactivate(&mut self, _ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        self.close();
        Ok(())
    }

    fn shutdown(&mut self, _ctx: &mut Context<'_>) {
        self.close();
    }
}

impl DarwinOpEmulator {
    /// A port in memory stays: it is no more than the robot itself.
    fn close(&mut self) {
        if self.options.timing == Timing::Measured {
            self.emulator = None;
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::testing::core_at_zero;
    use downbeat_executor::{ModuleOptions, SettingValue};

    fn with(settings: &[(&str, SettingValue)]) -> ModuleOptions {
        let settings = settings.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
        ModuleOptions { settings, ..ModuleOptions::default() }
    }

    #[test]
    fn the_port_exists_while_the_robot_runs() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("port");
        let (mut core, _clock) = core_at_zero();
        let options = with(&[("link", link.to_str().unwrap().to_owned().into())]);
        core.add_with("emulator", DarwinOpEmulator::default(), options).unwrap();
        assert!(!link.exists());
        core.cycle().unwrap();
        assert!(link.exists());
        core.stop();
        assert!(!link.exists());
    }

    #[test]
    fn an_invalid_fault_is_refused_at_once() {
        let (mut core, _clock) = core_at_zero();
        let options = with(&[("faults", vec!["drop:2".to_owned()].into())]);
        let error = core.add_with("emulator", DarwinOpEmulator::default(), options).err().unwrap();
        assert!(error.to_string().contains("\"2\" is not a rate"), "{error}");
    }
}
