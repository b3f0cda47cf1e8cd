//! The emulator as a module of the robot whose hardware it emulates.

use super::{Fault, MemoryPorts, check_fault, in_memory, start};
use downbeat_executor::{Context, Module, Setup, SetupError, TransitionError};
use downbeat_servos::servo_emulator::Served;

/// Runs an [`Emulator`](super::Emulator) as long as the robot runs, so that the hardware module finds a port.
///
/// Settings: `link`, the path of the port, or `memory:NAME` for a port in memory, which exists from the setup
/// on; `seed`; `faults`, each in the textual form of [`Fault`]. It has no topics: everything goes through the
/// port. Leave it out of replays.
#[derive(Default)]
pub struct DarwinOpEmulator {
    served: Served,
}

impl DarwinOpEmulator {
    /// An emulator that can be among these ports in memory.
    #[must_use]
    pub fn new(ports: MemoryPorts) -> Self {
        Self { served: Served::new(ports) }
    }
}

impl Module for DarwinOpEmulator {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let link = setup.setting(
            "link",
            "memory:darwin_op".to_owned(),
            "path of the port, or memory:NAME; the hardware module's setting \"port\" is the same",
        )?;
        let seed = setup.setting("seed", 1_i64, "same seed, same starting pose, noise and faults")?;
        let faults = setup.setting(
            "faults",
            Vec::<String>::new(),
            "what goes wrong, such as dead-servo:5@3s..6s, drop:0.01, flip:0.001, close-port@8s..9s",
        )?;
        let texts = setup.value(faults).map_or(&[][..], Vec::as_slice);
        let parsed: Result<Vec<Fault>, _> = texts.iter().map(|text| check_fault(text.parse()?)).collect();
        let faults = parsed.map_err(|error| setup.refuse_value(faults, error.to_string()))?;
        let port = setup.value(link).cloned().unwrap_or_default();
        let seed = setup.value(seed).copied().unwrap_or_default();
        self.served
            .prepare(&port, seed, faults, |options| in_memory(options, None))
            .map_err(|error| setup.refuse_value(link, error.to_string()))
    }

    fn activate(&mut self, _ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        Ok(self.served.open(start)?)
    }

    fn deactivate(&mut self, _ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        self.served.close();
        Ok(())
    }

    fn shutdown(&mut self, _ctx: &mut Context<'_>) {
        self.served.close();
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
