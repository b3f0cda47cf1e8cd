//! How long it takes from a hand on the leader to the servo of the follower, in cycles of their buses:
//! emulated, in simulated time, so that it is the same on every machine.
#![allow(clippy::unwrap_used)]

use super::leader_arm::LeaderArm;
use crate::servo_bus::protocol::{Instruction, Packet, Protocol};
use crate::servo_bus::{Description, ServoBus};
use crate::servo_emulator::{Emulator, EmulatorOptions, Timing};
use crate::testing::{Collector, core_at_zero};
use downbeat_executor::{ModuleOptions, SettingValue};
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::sensor_msgs::msg::JointState;
use std::collections::BTreeMap;
use std::time::Duration;

const ARM: &str = "name = \"arm\"\n[[bus]]\nname = \"bus\"\nport = \"p\"\nbaud = 1000000\nprotocol = \"feetech_sts\"\n\
                   cycle_ms = 10\n[[joint]]\nname = \"pan\"\nid = 1\nmodel = \"STS3215\"\nlimits = [-1.5, 1.5]\n";

/// The bus of the follower begins its cycles this long after that of the leader, in ms.
const PHASES_MS: std::ops::Range<u64> = 0..10;

/// The times at which the servo of the follower was given goals, with these.
fn goals(exchanges: &[BusExchange]) -> Vec<(i64, i64)> {
    let goal = Description::load(ARM).unwrap().bus("").unwrap().joints[0].registers.goal.clone();
    let protocol = Protocol::FeetechSts;
    let written = |exchange: &BusExchange| {
        let packet = Packet::new_checked(protocol, &exchange.instruction).ok()?;
        let Ok(Instruction::SyncWrite { address, entries, .. }) = Instruction::parse(&packet) else {
            return None;
        };
        let (_, data) = entries.first()?;
        Some((exchange.stamp.as_nanos(), goal.raw_in(protocol, data, address)?))
    };
    exchanges.iter().filter_map(written).collect()
}

/// The most cycles of the follower from a measurement of the leader to the one that writes it, that one
/// included, if a message takes `hop_ms` from one module to the next: from the leader, and to the follower.
fn most_cycles(phase_ms: u64, hop_ms: u64) -> usize {
    let plan = Description::load(ARM).unwrap().bus("").unwrap().clone();
    let (mut core, clock) = core_at_zero();
    let emulated = |seed| {
        let options = EmulatorOptions { timing: Timing::Stepped, seed, ..Default::default() };
        Emulator::servos_in_memory(&plan, &options)
    };
    let (leader, follower) = (emulated(1), emulated(2));
    let settings = |values: Vec<(&str, SettingValue)>| -> BTreeMap<String, SettingValue> {
        values.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
    };
    let bus = settings(vec![("description", ARM.to_owned().into())]);
    let remaps = ["joint_states", "joint_commands", "joint_torque", "torque", "bus/exchanges"];
    let of_leader = ModuleOptions {
        settings: bus.clone(),
        remaps: remaps.map(|name| (name.to_owned(), format!("leader/{name}"))).into(),
        ..ModuleOptions::default()
    };
    core.add_with("leader", ServoBus::new(Box::new(leader.bus())), of_leader).unwrap();
    let follows = settings(vec![("following", true.into()), ("handover_speed", 10.0.into())]);
    core.add_with(
        "leader_arm",
        LeaderArm::default(),
        ModuleOptions { settings: follows, ..Default::default() },
    )
    .unwrap();
    // The leader has begun its cycles.
    core.cycle().unwrap();
    clock.advance(Duration::from_millis(phase_ms));
    core.add_with(
        "follower",
        ServoBus::new(Box::new(follower.bus())),
        ModuleOptions { settings: bus, ..ModuleOptions::default() },
    )
    .unwrap();
    let states = Collector::<JointState>::add(&mut core, "leader/joint_states");
    let exchanges = Collector::<BusExchange>::add(&mut core, "bus/exchanges");
    let mut elapsed = 0;
    let mut run = |milliseconds: usize| {
        for _ in 0..milliseconds {
            clock.advance(Duration::from_millis(1));
            elapsed += 1;
            // Modules receive in a cycle of the core what was published in the one before.
            let cycles = match hop_ms {
                0 => 4,
                hop => usize::from(elapsed % hop == 0),
            };
            (0..cycles).for_each(|_| core.cycle().unwrap());
        }
        (states.take(), goals(&exchanges.take()))
    };
    // It comes into service, and approaches where the leader is.
    run(2000);
    assert!(leader.turn_by_hand("pan", 1.2));
    let (measured, written) = run(500);

    let joint = &plan.joints[0];
    let moving =
        measured.iter().zip(&measured[1..]).filter(|(before, after)| before.position != after.position);
    let raws: Vec<(i64, i64)> = moving
        .map(|(_, state)| (state.header.stamp.as_nanos(), joint.goal(state.position[0]).unwrap()))
        .collect();
    assert!(raws.len() > 40, "the hand moves the leader: {raws:?}");
    // The last ones may be written after the end.
    let cycles = raws[..raws.len() - 5].iter().map(|(at, raw)| {
        let later = written.iter().filter(|(sent, _)| sent > at);
        let place = later.map(|(_, goal)| goal).position(|goal| goal == raw);
        place.unwrap_or_else(|| panic!("{raw} of the leader is not written: {written:?}")) + 1
    });
    cycles.max().unwrap()
}

#[test]
fn the_follower_is_at_most_two_cycles_behind_whenever_its_cycles_begin() {
    let most = |hop_ms| PHASES_MS.map(move |phase| most_cycles(phase, hop_ms)).collect::<Vec<usize>>();
    assert_eq!(most(0), [1; 10], "the next cycle writes it");
    // Messages that take 1 ms miss the cycles that begin just then; those that take a whole cycle miss one.
    for hop_ms in [1, 5] {
        let cycles = most(hop_ms);
        assert_eq!(cycles.iter().max(), Some(&2), "by phase, with messages of {hop_ms} ms: {cycles:?}");
    }
}
