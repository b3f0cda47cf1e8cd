//! The kinds of modules that this package offers to robot files.

use downbeat_darwin_op::emulator::MemoryPorts;
use downbeat_kind::Kind;

use crate::simulator::HumanoidSimulator;

/// Humanoid robots in a simulated world, whose hardware modules meet them at these ports. The Darwin OP has a
/// name of its own; what both names stand for is the same.
#[must_use]
pub fn kinds(ports: &MemoryPorts) -> Vec<Kind> {
    let kinds = [
        (
            "darwin_op_simulator",
            "a Darwin OP in a simulated world: rigid bodies with contacts behind the bytes of its bus",
        ),
        (
            "humanoid_simulator",
            "a humanoid robot in a simulated world, from its URDF and the description of its servos",
        ),
    ];
    let kind = |(name, about)| {
        let ports = ports.clone();
        let make = move || HumanoidSimulator::new(ports.clone());
        Kind::new(name, about, make).drives_device().emulated().with_files(&[
            "urdf",
            "world",
            "humanoid",
            "description",
        ])
    };
    kinds.map(kind).into()
}
