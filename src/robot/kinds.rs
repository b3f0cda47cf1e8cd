//! The kinds of modules that come with the program.

use downbeat_executor::Synchrony;
use downbeat_modules::darwin_op::DarwinOp;
use downbeat_modules::darwin_op::bus::{Exchange, RecordedBus, SerialBus};
use downbeat_modules::darwin_op_emulator::DarwinOpEmulator;
use downbeat_modules::joint_command_mux::JointCommandMux;
use downbeat_modules::stand_nod_wave::StandNodWave;
use downbeat_modules::transform_server::TransformServer;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;

use super::Kind;

pub(super) fn built_in() -> [Kind; 5] {
    [
        Kind::new(
            "darwin_op",
            "the hardware of a Darwin OP: CM-730 and 20 MX-28 servos on a serial port",
            || DarwinOp::new(Box::new(SerialBus::new())),
        )
        .drives_device()
        .detached()
        .replayed_on("bus/exchanges", on_recorded_bus),
        Kind::new(
            "darwin_op_emulator",
            "an emulated Darwin OP behind a pseudo terminal, with faults on request",
            DarwinOpEmulator::default,
        )
        .drives_device()
        .emulated()
        .with_synchrony(Synchrony::WhenDue),
        Kind::new(
            "joint_command_mux",
            "commands from outside before those of the built-in motion, joint by joint",
            JointCommandMux::default,
        ),
        Kind::new("stand_nod_wave", "a small motion: stand up, then nod and wave", StandNodWave::default),
        Kind::new(
            "transform_server",
            "the action tf2_buffer_server: where frames are in each other, for clients without a transform buffer",
            TransformServer::default,
        ),
    ]
}

fn on_recorded_bus(messages: Vec<BusExchange>) -> Result<DarwinOp, String> {
    let exchanges =
        messages.into_iter().map(|message| Exchange::try_from(message).map_err(|error| error.to_string()));
    let (bus, _) = RecordedBus::new(exchanges.collect::<Result<Vec<_>, String>>()?);
    Ok(DarwinOp::new(Box::new(bus)))
}
