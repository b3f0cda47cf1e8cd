//! The kinds of modules that this package offers to robot files.

use downbeat_executor::Synchrony;
use downbeat_kind::Kind;
use downbeat_servos::servo_bus::bus::RecordedBus;

use crate::emulator::{DarwinOpEmulator, MemoryPorts};
use crate::falls::Falls;
use crate::gait::Gait;
use crate::hardware::DarwinOp;
use crate::motions::{MotionPlayer, PANEL};
use crate::stand_nod_wave::StandNodWave;

/// The kinds, whose hardware and emulators meet at these ports.
#[must_use]
pub fn kinds(ports: &MemoryPorts) -> Vec<Kind> {
    let (of_hardware, of_emulator) = (ports.clone(), ports.clone());
    vec![
        Kind::new(
            "darwin_op",
            "the hardware of a Darwin OP: CM-730 and 20 MX-28 servos on a serial port",
            move || DarwinOp::new(Box::new(of_hardware.bus())),
        )
        .drives_device()
        .detached()
        .replayed_on("bus/exchanges", |messages| {
            Ok(DarwinOp::new(Box::new(RecordedBus::of_messages(messages)?)))
        }),
        Kind::new(
            "darwin_op_emulator",
            "an emulated Darwin OP behind a pseudo terminal, with faults on request",
            move || DarwinOpEmulator::new(of_emulator.clone()),
        )
        .drives_device()
        .emulated()
        .with_synchrony(Synchrony::WhenDue),
        Kind::new("gait", "walks with the velocity on cmd_vel, and publishes odometry", Gait::default)
            .with_files(&["humanoid"]),
        Kind::new("motions", "key-frame motions by name: get up, kick, wave", MotionPlayer::default)
            .with_files(&["file", "humanoid", "description"])
            .with_panel("Motions", PANEL, &["motions/play", "motions/playing", "joint_states"]),
        Kind::new("falls", "detects falls, goes limp, and gets up", Falls::default).with_files(&["humanoid"]),
        Kind::new("stand_nod_wave", "a small motion: stand up, then nod and wave", StandNodWave::default),
    ]
}
