//! The kinds of modules that a robot file can name.

use std::num::NonZeroUsize;

use bytes::Bytes;
use downbeat_executor::{Core, Inbox, Module, ModuleOptions, SetupError, Synchrony};
use downbeat_modules::darwin_op::DarwinOp;
use downbeat_modules::darwin_op::bus::{Exchange, RecordedBus, SerialBus};
use downbeat_modules::darwin_op_emulator::DarwinOpEmulator;
use downbeat_modules::joint_command_mux::JointCommandMux;
use downbeat_modules::stand_nod_wave::StandNodWave;
use downbeat_modules::transform_server::TransformServer;
use downbeat_msgs::cdr;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;

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
    /// How it is replayed, if it drives a device and records what that answers.
    pub(crate) replayed: Option<ReplayedDevice>,
    pub(super) add: fn(&mut Core, &str, ModuleOptions) -> Result<(), SetupError>,
}

/// How a module that drives a device runs without it.
pub(crate) struct ReplayedDevice {
    /// The module's own name of the topic on which it publishes what the device answered.
    topic: &'static str,
    /// Adds the module with these answers, the messages of the topic as CDR. The outer error says what is wrong with them.
    pub(crate) add: AddReplayed,
}

type AddReplayed = fn(&mut Core, &str, ModuleOptions, &[Bytes]) -> Result<Result<(), SetupError>, String>;

impl ReplayedDevice {
    /// The topic in a bag.
    pub(crate) fn topic_of(&self, options: &ModuleOptions) -> String {
        let name = options.remaps.get(self.topic).map_or(self.topic, String::as_str);
        format!("/{}", name.trim_start_matches('/'))
    }
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
        replayed: Some(ReplayedDevice { topic: "bus/exchanges", add: add_darwin_op }),
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
        replayed: None,
        add: add::<DarwinOpEmulator>,
    },
    Kind {
        name: "joint_command_mux",
        about: "commands from outside before those of the built-in motion, joint by joint",
        is_emulated: false,
        uses_device: false,
        synchrony: Synchrony::WhenDue,
        replayed: None,
        add: add::<JointCommandMux>,
    },
    Kind {
        name: "stand_nod_wave",
        about: "a small motion: stand up, then nod and wave",
        is_emulated: false,
        uses_device: false,
        synchrony: Synchrony::WhenDue,
        replayed: None,
        add: add::<StandNodWave>,
    },
    Kind {
        name: "transform_server",
        about: "the action tf2_buffer_server: where frames are in each other, for who has no transform buffer",
        is_emulated: false,
        uses_device: false,
        synchrony: Synchrony::WhenDue,
        replayed: None,
        add: add::<TransformServer>,
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

fn add_darwin_op(
    core: &mut Core,
    name: &str,
    options: ModuleOptions,
    answers: &[Bytes],
) -> Result<Result<(), SetupError>, String> {
    let exchange = |bytes: &Bytes| {
        let message: BusExchange = cdr::from_slice(bytes).map_err(|error| error.to_string())?;
        Exchange::try_from(message).map_err(|error| error.to_string())
    };
    let exchanges = answers.iter().map(exchange).collect::<Result<Vec<_>, String>>()?;
    let (bus, _) = RecordedBus::new(exchanges);
    Ok(core.add_with(name, DarwinOp::new(Box::new(bus)), options))
}
