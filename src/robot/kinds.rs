//! The kinds of modules that a robot file can name.

use std::num::NonZeroUsize;

use downbeat_executor::{Core, Inbox, Module, ModuleOptions, SetupError, Synchrony};
use downbeat_modules::darwin_op::DarwinOp;
use downbeat_modules::darwin_op::bus::SerialBus;
use downbeat_modules::darwin_op_emulator::DarwinOpEmulator;
use downbeat_modules::joint_command_mux::JointCommandMux;
use downbeat_modules::stand_nod_wave::StandNodWave;

/// A kind of module.
pub struct Kind {
    /// Its name in robot files.
    pub name: &'static str,
    /// What it is for, in a line.
    pub about: &'static str,
    /// True if what it gives does not come from real hardware.
    pub is_emulated: bool,
    /// True if it drives a device, which a replay must not.
    pub uses_device: bool,
    /// How it runs, unless the robot file says otherwise.
    pub synchrony: Synchrony,
    pub(super) add: fn(&mut Core, &str, ModuleOptions) -> Result<(), SetupError>,
}

/// Batches that wait for a module whose input and output blocks: two seconds of commands at 125 Hz.
pub(super) const INBOX: Inbox = Inbox::KeepLast(NonZeroUsize::new(250).expect("not zero"));

/// All kinds.
pub const KINDS: &[Kind] = &[
    Kind {
        name: "darwin_op",
        about: "the hardware of a Darwin OP: CM-730 and 20 MX-28 servos on a serial port",
        is_emulated: false,
        uses_device: true,
        synchrony: Synchrony::Detached(INBOX),
        add: |core, name, options| {
            core.add_restartable(name, || DarwinOp::new(Box::new(SerialBus::new())), options)
        },
    },
    Kind {
        name: "darwin_op_emulator",
        about: "an emulated Darwin OP behind a pseudo terminal, with faults on request",
        is_emulated: true,
        uses_device: true,
        synchrony: Synchrony::WhenDue,
        add: add::<DarwinOpEmulator>,
    },
    Kind {
        name: "joint_command_mux",
        about: "commands from outside before those of the built-in motion, joint by joint",
        is_emulated: false,
        uses_device: false,
        synchrony: Synchrony::WhenDue,
        add: add::<JointCommandMux>,
    },
    Kind {
        name: "stand_nod_wave",
        about: "a small motion: stand up, then nod and wave",
        is_emulated: false,
        uses_device: false,
        synchrony: Synchrony::WhenDue,
        add: add::<StandNodWave>,
    },
];

impl Kind {
    /// How modules of this kind join a core, unless the robot file says otherwise.
    #[must_use]
    pub fn options(&self) -> ModuleOptions {
        ModuleOptions { synchrony: self.synchrony, ..ModuleOptions::default() }
    }

    /// Adds a module of this kind to a core; after a panic it can be made again.
    ///
    /// # Errors
    /// Those of [`Core::add_restartable`].
    pub fn add_to(&self, core: &mut Core, name: &str, options: ModuleOptions) -> Result<(), SetupError> {
        (self.add)(core, name, options)
    }
}

fn add<M: Module + Default>(core: &mut Core, name: &str, options: ModuleOptions) -> Result<(), SetupError> {
    core.add_restartable(name, M::default, options)
}
