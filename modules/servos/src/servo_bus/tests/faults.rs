//! The module with servos that are silent or corrupt.

use super::*;

#[test]
fn a_dead_servo_is_stale_while_the_others_continue_and_recovers() {
    for (protocol, model, rest) in KINDS {
        let mut run = Run::of(&arm(protocol, model, rest));
        run.cycles(60);
        run.command(&[("pan", 0.5), ("lift", 0.5)]);
        let dead = FaultKind::DeadServo(crate::servo_bus::protocol::Id::new(2).unwrap());
        run.inject(Fault::lasting(dead, Duration::from_secs(2)));
        run.cycles(10);
        assert_eq!(
            run.health_of("servo 2 lift"),
            (
                DiagnosticStatus::ERROR,
                "servo 2 (lift) does not answer on p at 1000000 bit/s; its joint is stale. Check its power, its plugs and its id; \
                 `downbeat servo scan` shows what answers"
            ),
            "{model}"
        );
        let states = run.cycles(150);
        assert_eq!(states.len(), 150, "{model}: no cycle is lost on it");
        for state in &states {
            assert!(state.velocity[1].is_nan() && state.position[1].is_finite(), "{model}");
            assert!(state.velocity[0].is_finite() && state.velocity[3].is_finite(), "{model}");
        }
        assert!((position(&states[149], "pan") - 0.5).abs() < 0.02, "{model}");
        run.cycles(150);
        let states = run.cycles(100);
        assert!(states[99].velocity[1].is_finite(), "{model}: {:?}", run.health);
        assert!(
            (position(&states[99], "lift") - 0.5).abs() < 0.02,
            "{model}: it goes where it was commanded"
        );
    }
}

#[test]
fn a_wrong_supply_is_named_and_the_joints_go_on() {
    // Dynamixel 2.0 has one bit for all alarms.
    for (kind, alarm) in [(0, "input voltage"), (2, "hardware alert"), (4, "input voltage")] {
        let (protocol, model, rest) = KINDS[kind];
        let mut run = Run::of(&arm(protocol, model, rest));
        run.cycles(60);
        assert_eq!(run.health_of("servo 2 lift"), (DiagnosticStatus::OK, "OK"), "{model}");
        run.inject(Fault::lasting(FaultKind::Supply(20.0), Duration::from_secs(5)));
        run.command(&[("pan", 0.5), ("lift", -0.5)]);
        let states = run.cycles(300);
        assert_eq!(states.len(), 300, "{model}: no cycle is lost");
        let last = &states[299];
        assert!(last.velocity.iter().all(|velocity| velocity.is_finite()), "{model}: {last:?}");
        assert!((position(last, "pan") - 0.5).abs() < 0.02, "{model}: {last:?}");
        assert!((position(last, "lift") + 0.5).abs() < 0.02, "{model}: {last:?}");
        let (level, words) = run.health_of("servo 2 lift");
        assert_eq!(level, DiagnosticStatus::WARN, "{model}");
        let remedy = if kind == 2 { "hardware_error_status" } else { "check that the supply is the one" };
        for part in ["servo 2 (lift) on p at 1000000 bit/s reports:", alarm, "20 V", remedy] {
            assert!(words.contains(part), "{model}: {words}");
        }
        run.cycles(400);
        assert_eq!(run.health_of("servo 2 lift"), (DiagnosticStatus::OK, "OK"), "{model}");
    }
}

#[test]
fn control_never_stops_in_ten_minutes_with_one_percent_of_faulty_answers() {
    endure(2, 600);
}

#[test]
fn control_never_stops_with_faulty_answers_in_any_protocol() {
    for kind in [0, 3, 4] {
        endure(kind, 60);
    }
}

/// Runs for this simulated time, in which 1 % of the answers are lost, and as many corrupt.
fn endure(kind: usize, seconds: usize) {
    let (protocol, model, rest) = KINDS[kind];
    let description = arm(protocol, model, rest);
    // About a percent of the answers of 14 to 32 bytes has a flipped bit.
    let mut run = Run::with(&description, &description, &["drop:0.01", "flip:0.0005"]);
    let plan = Description::load(&description).unwrap().bus("").unwrap().clone();
    run.cycles(100);
    run.exchanges.take();
    let (mut fresh, mut states, mut controlled, mut longest_gap, mut gap) = (0, 0, 0, 0, [0; 4]);
    let mut last: Option<JointState> = None;
    let mut unheard = [0_usize; 4];
    for second in 0..seconds {
        let angle = [0.8, -0.8, f64::NAN, 3.0, -1e300, 0.0][second % 6];
        run.command(&[("pan", angle), ("lift", -angle), ("elbow", angle), ("wrist", angle / 2.0)]);
        let cycles: Vec<(JointState, [usize; 4])> = (0..100)
            .flat_map(|_| {
                let (state, exchanges) = (run.cycles(1).pop(), run.exchanges.take());
                controlled += exchanges.iter().filter(|exchange| check_goals(&plan, exchange)).count();
                let heard = heard(&plan, &exchanges);
                for (unheard, is_heard) in unheard.iter_mut().zip(heard) {
                    *unheard = if is_heard { 0 } else { *unheard + 1 };
                }
                state.map(|state| (state, unheard))
            })
            .collect();
        for (state, unheard) in cycles {
            states += 1;
            for (joint, gap) in gap.iter_mut().enumerate() {
                let is_stale = state.velocity[joint].is_nan();
                assert!(is_stale || unheard[joint] < 3, "old data is shown as fresh: {unheard:?} {state:?}");
                assert!(!is_stale || unheard[joint] > 0, "fresh data is shown as old: {state:?}");
                fresh += usize::from(!is_stale);
                *gap = if is_stale { *gap + 1 } else { 0 };
                longest_gap = longest_gap.max(*gap);
                if let (true, Some(last)) = (is_stale, &last) {
                    assert_eq!(
                        state.position[joint], last.position[joint],
                        "a stale position is the last one"
                    );
                }
                assert!((-1.05..1.05).contains(&state.position[joint]), "{}", state.position[joint]);
            }
            last = Some(state);
        }
    }
    let cycles = seconds * 100;
    assert!(controlled >= cycles - 1, "{model}: goals in {controlled} of {cycles} cycles");
    assert!(states > cycles * 95 / 100, "{model}: {states} states in {cycles} cycles");
    assert!(fresh > states * 4 * 9 / 10, "{model}: {fresh} of {} samples are fresh", states * 4);
    assert!(longest_gap < 600, "{model}: a joint was stale for {longest_gap} cycles");
}

/// Which joints' measurements are in valid answers among these exchanges, as an independent reading of the
/// bytes.
fn heard(plan: &BusPlan, exchanges: &[BusExchange]) -> [bool; 4] {
    use crate::servo_bus::protocol::{Instruction, Packet, Receiver, Status, split_joined};
    let mut heard = [false; 4];
    let mut hear = |status: Status| {
        let joint = plan.joints.iter().position(|joint| {
            joint.id == status.id && usize::from(joint.registers.span().1) == status.parameters.len()
        });
        if let Some(joint) = joint {
            heard[joint] = true;
        }
    };
    for exchange in exchanges {
        let packet = Packet::new_checked(plan.line.protocol, &exchange.instruction);
        let instruction = packet.ok().and_then(|packet| Instruction::parse(&packet).ok());
        if let Some(Instruction::FastSyncRead { length, ids, .. }) = instruction {
            let requested: Vec<_> = ids.into_iter().map(|id| (id, length)).collect();
            split_joined(&exchange.reply, &requested).into_iter().for_each(&mut hear);
            continue;
        }
        let mut receiver = Receiver::new(plan.line.protocol);
        receiver.push(&exchange.reply);
        receiver.end();
        while let Some(packet) = receiver.next_packet() {
            if let Ok(status) = Status::parse(&packet) {
                hear(status);
            }
        }
    }
    heard
}

/// Asserts that all goals in an instruction are within the limits of their joints. Returns false if it has
/// none.
fn check_goals(plan: &BusPlan, exchange: &BusExchange) -> bool {
    use crate::servo_bus::protocol::{Instruction, Packet};
    let protocol = plan.line.protocol;
    let Ok(packet) = Packet::new_checked(protocol, &exchange.instruction) else { return false };
    let Ok(Instruction::SyncWrite { address, entries, .. }) = Instruction::parse(&packet) else {
        return false;
    };
    let mut has_goals = false;
    for (id, data) in entries {
        let joint = plan.joints.iter().find(|joint| joint.id == id).unwrap();
        let goal = &joint.registers.goal;
        if address == goal.address {
            let raw = goal.raw_in(protocol, &data, address).unwrap();
            let [low, high] = joint.goal_range();
            assert!((low..=high).contains(&raw), "{}: {raw} is not from {low} to {high}", joint.name);
            has_goals = true;
        }
    }
    has_goals
}

#[test]
fn the_same_run_gives_the_same_bytes() {
    let run = || {
        let description = arm("dynamixel2", "XM430-W350", "");
        let mut run = Run::with(&description, &description, &["drop:0.02", "flip:0.001"]);
        run.cycles(60);
        run.command(&[("pan", 0.5)]);
        let states = run.cycles(400);
        (run.exchanges.take(), states.into_iter().map(|state| state.position).collect::<Vec<_>>())
    };
    assert_eq!(run(), run());
}

#[test]
fn a_recorded_run_replays_bit_for_bit() {
    let description = arm("feetech_sts", "STS3215", "");
    let mut run = Run::with(&description, &description, &["drop:0.02", "flip:0.001", "dead-servo:3@2s..4s"]);
    let perform = |run: &mut Run| {
        run.cycles(60);
        run.command(&[("pan", 0.5), ("elbow", -0.5)]);
        let mut states = run.cycles(600);
        run.core.stop();
        states.extend(run.joint_states.take());
        states.iter().map(downbeat_msgs::cdr::to_vec).collect::<Vec<_>>()
    };
    let states = perform(&mut run);
    let recording: Vec<_> =
        run.exchanges.take().into_iter().map(|exchange| bus::Exchange::try_from(exchange).unwrap()).collect();
    let (bus, report) = bus::RecordedBus::new(recording);
    let (mut core, clock) = core_at_zero();
    let settings = [("description".to_owned(), SettingValue::Text(description))].into();
    core.add_with(
        "servos",
        ServoBus::new(Box::new(bus)),
        ModuleOptions { settings, ..ModuleOptions::default() },
    )
    .unwrap();
    let joint_states = Collector::<JointState>::add(&mut core, "joint_states");
    let commands = core.inlet("joint_commands").unwrap();
    for cycle in 0..660 {
        if cycle == 60 {
            commands.publish(message(&[("pan", 0.5), ("elbow", -0.5)], |m, p| m.position = p)).unwrap();
        }
        clock.advance(Duration::from_millis(10));
        core.cycle().unwrap();
    }
    core.stop();
    let replayed: Vec<_> = joint_states.take().iter().map(downbeat_msgs::cdr::to_vec).collect();
    assert_eq!(report.lock().differences, []);
    assert!(replayed.ends_with(&states));
}
