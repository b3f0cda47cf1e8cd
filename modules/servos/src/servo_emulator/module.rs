//! The emulator as a module of the robot whose hardware it emulates.

use super::{Emulator, EmulatorError, EmulatorOptions, Fault, MemoryPorts, NameInUse, Timing};
use crate::servo_bus::{BusPlan, Description};
use downbeat_executor::{Context, Module, Received, Setup, SetupError, TransitionError};
use downbeat_msgs::sensor_msgs::msg::JointState;
use std::path::PathBuf;

/// Runs an [`Emulator`] of described servos as long as the robot runs, so that the hardware module finds a
/// port.
///
/// Settings: `description` and `bus`, as those of the hardware module; `link`, the path of the port, or
/// `memory:NAME` for a port in memory, which exists from the setup on; `seed`; `faults`, each in the textual
/// form of [`Fault`]. On `hand` (`sensor_msgs/JointState`) it takes angles to which a hand turns joints that
/// have no torque; everything else goes through the port. Leave it out of replays.
#[derive(Default)]
pub struct ServoEmulator {
    served: Served,
    plan: Option<BusPlan>,
}

impl ServoEmulator {
    /// An emulator that can be among these ports in memory.
    #[must_use]
    pub fn new(ports: MemoryPorts) -> Self {
        Self { served: Served::new(ports), plan: None }
    }
}

/// The emulator of a module: behind a pseudo terminal while the module is active, or among the ports in
/// memory from the setup on.
#[derive(Default)]
pub struct Served {
    ports: MemoryPorts,
    options: EmulatorOptions,
    emulator: Option<Emulator>,
}

impl Served {
    /// An emulator that can be among these ports in memory.
    #[must_use]
    pub fn new(ports: MemoryPorts) -> Self {
        Self { ports, ..Self::default() }
    }

    /// Prepares the port with this name. One in memory is served at once by what `make` returns.
    ///
    /// # Errors
    /// If the name is in use.
    pub fn prepare(
        &mut self,
        port: &str,
        seed: i64,
        faults: Vec<Fault>,
        make: impl FnOnce(&EmulatorOptions) -> Emulator,
    ) -> Result<(), NameInUse> {
        let is_memory = MemoryPorts::is_memory(port);
        self.options = EmulatorOptions {
            link: Some(PathBuf::from(port)),
            // Negative seeds are valid.
            seed: seed.cast_unsigned(),
            timing: if is_memory { Timing::Stepped } else { Timing::Measured },
            faults,
        };
        if is_memory {
            let emulator = make(&self.options);
            self.ports.offer(port, &emulator)?;
            self.emulator = Some(emulator);
        }
        Ok(())
    }

    /// Opens a pseudo terminal, if that is the port.
    ///
    /// # Errors
    /// That of `start`.
    pub fn open(
        &mut self,
        start: impl FnOnce(EmulatorOptions) -> Result<Emulator, EmulatorError>,
    ) -> Result<(), EmulatorError> {
        if self.options.timing == Timing::Measured {
            self.emulator = Some(start(self.options.clone())?);
        }
        Ok(())
    }

    /// The emulator, while there is one.
    #[must_use]
    pub fn emulator(&self) -> Option<&Emulator> {
        self.emulator.as_ref()
    }

    /// Closes the pseudo terminal. A port in memory stays: it is no more than the robot itself.
    pub fn close(&mut self) {
        if self.options.timing == Timing::Measured {
            self.emulator = None;
        }
    }
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
            "memory:servos".to_owned(),
            "path of the port, or memory:NAME; the hardware module's setting \"port\" is the same",
        )?;
        let seed = setup.read_only_setting("seed", 1_i64, "same seed, same starting pose and faults")?;
        let faults = setup.read_only_setting(
            "faults",
            Vec::<String>::new(),
            "what goes wrong, such as dead-servo:5@3s..6s, twin:5, supply:12.1, drop:0.01, flip:0.001, close-port@8s..9s",
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
        let faults = parsed.map_err(|error| setup.refuse_value(faults, error.to_string()))?;
        let port = setup.value(link).cloned().unwrap_or_default();
        let seed = setup.value(seed).copied().unwrap_or_default();
        setup.subscribe("hand", |module: &mut Self, turned: Received<'_, JointState>, _| {
            let Some(emulator) = module.served.emulator() else { return };
            for (joint, angle) in
                turned.name.iter().zip(&turned.position).filter(|(_, angle)| angle.is_finite())
            {
                emulator.turn_by_hand(joint, *angle);
            }
        })?;
        let Some(plan) = &self.plan else { return Ok(()) };
        let make = |options: &EmulatorOptions| Emulator::servos_in_memory(plan, options);
        self.served
            .prepare(&port, seed, faults, make)
            .map_err(|error| setup.refuse_value(link, error.to_string()))
    }

    fn activate(&mut self, _ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        let plan = self.plan.as_ref().ok_or(NoDescription)?;
        Ok(self.served.open(|options| Emulator::start_servos(plan, options))?)
    }

    fn deactivate(&mut self, _ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        self.served.close();
        Ok(())
    }

    fn shutdown(&mut self, _ctx: &mut Context<'_>) {
        self.served.close();
    }
}

#[derive(Debug, thiserror::Error)]
#[error(
    "the setting \"description\" is missing: name the file that describes the servos to emulate, as in docs/servos.md"
)]
struct NoDescription;
