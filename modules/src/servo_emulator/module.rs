//! The emulator as a module of the robot whose hardware it emulates.

use super::{Emulator, EmulatorOptions, Fault, Timing};
use crate::servo_bus::{BusPlan, Description};
use downbeat_executor::{Context, Module, Setup, SetupError, TransitionError};
use std::path::PathBuf;

/// Runs an [`Emulator`] of described servos as long as the robot runs, so that the hardware module finds a port.
///
/// Settings: `description` and `bus`, as those of the hardware module; `link`, the path of the port; `seed`; `faults`, each
/// in the textual form of [`Fault`]. It has no topics: everything goes through the port. Leave it out of replays.
#[derive(Default)]
pub struct ServoEmulator {
    options: EmulatorOptions,
    plan: Option<BusPlan>,
    emulator: Option<Emulator>,
}

impl Module for ServoEmulator {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let description = setup.read_only_setting(
            "description",
            String::new(),
            "the file that describes buses, joints and devices, relative to the robot file; or its text",
        )?;
        let bus =
            setup.read_only_setting("bus", String::new(), "the bus to emulate, if there are several")?;
        let link = setup.read_only_setting(
            "link",
            "/tmp/downbeat_servos_emulated".to_owned(),
            "path of the port; the hardware module's setting \"port\" is the same",
        )?;
        let seed = setup.read_only_setting("seed", 1_i64, "same seed, same starting pose and faults")?;
        let faults = setup.read_only_setting(
            "faults",
            Vec::<String>::new(),
            "what goes wrong, such as dead-servo:5@3s..6s, drop:0.01, flip:0.001, close-port@8s..9s",
        )?;
        let text = setup.value(description).cloned().unwrap_or_default();
        if !text.is_empty() {
            let loaded = Description::load(&text)
                .map_err(|error| setup.refuse_value(description, error.to_string()))?;
            let name = setup.value(bus).cloned().unwrap_or_default();
            let plan = loaded.bus(&name).map_err(|error| setup.refuse_value(bus, error.to_string()))?;
            self.plan = Some(plan.clone());
        }
        let texts = setup.value(faults).map_or(&[][..], Vec::as_slice);
        let has = |id| self.plan.as_ref().is_none_or(|plan| plan.joints.iter().any(|joint| joint.id == id));
        let parsed: Result<Vec<Fault>, _> =
            texts.iter().map(|text| text.parse::<Fault>()?.check(has)).collect();
        self.options = EmulatorOptions {
            link: setup.value(link).map(PathBuf::from),
            // Negative seeds are valid.
            seed: setup.value(seed).map_or(0, |seed| seed.cast_unsigned()),
            timing: Timing::Measured,
            faults: parsed.map_err(|error| setup.refuse_value(faults, error.to_string()))?,
        };
        Ok(())
    }

    fn activate(&mut self, _ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        let plan = self.plan.as_ref().ok_or(NoDescription)?;
        self.emulator = Some(Emulator::start_servos(plan, self.options.clone())?);
        Ok(())
    }

    fn deactivate(&mut self, _ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        self.emulator = None;
        Ok(())
    }

    fn shutdown(&mut self, _ctx: &mut Context<'_>) {
        self.emulator = None;
    }
}

#[derive(Debug, thiserror::Error)]
#[error(
    "the setting \"description\" is missing: name the file that describes the servos to emulate, as in docs/servos.md"
)]
struct NoDescription;
