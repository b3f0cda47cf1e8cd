//! Servos whose position cannot be their goal stay limp, whatever they answer.

use super::protocol::{Id, Instruction, Packet, Receiver, Status, StatusError};
use super::table_bus::{TableBus, Tables, has_position_alarm, honest, scs};
use super::*;
use crate::servo_bus::driver::Driver;
use downbeat_executor::Transition;
use downbeat_msgs::std_srvs::srv::{SetBoolRequest, SetBoolResponse};
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Devices as on the bus of the Darwin OP.
const BOARD_AND_FOOT: &str = r#"
[[device]]
name = "CM-730"
id = 200
model = "CM-730"
read = ["dynamixel_power", "present_voltage"]
power = { register = "dynamixel_power", wait_ms = 300 }
battery = { register = "present_voltage", low_v = 10.5 }
[[device]]
name = "right foot"
id = 111
model = "FSR"
read = ["fsr_1", "fsr_2", "fsr_3", "fsr_4", "fsr_x", "fsr_y"]
"#;

/// Descriptions of four servos in each protocol: files and their plans.
fn descriptions(folder: &std::path::Path) -> Vec<(String, BusPlan)> {
    let plan = |text: &str| Description::load(text).unwrap().bus("").unwrap().clone();
    let mut all: Vec<_> = KINDS
        .iter()
        .map(|(protocol, model, rest)| {
            let text = arm(protocol, model, rest);
            (text.clone(), plan(&text))
        })
        .collect();
    let scs = scs(folder);
    all.push((folder.join("arm.toml").to_str().unwrap().to_owned(), scs.bus("").unwrap().clone()));
    all
}

/// A running module in front of these servos.
fn run(description: &str, tables: &Arc<Mutex<Tables>>) -> Run {
    let bus = Box::new(TableBus::new(tables, honest));
    Run::on_bus(description, bus)
}

/// A position beyond the goals of the first joint.
fn beyond(plan: &BusPlan) -> i64 {
    plan.joints[0].registers.goal.max + 5
}

#[track_caller]
fn assert_limp(run: &mut Run, tables: &Arc<Mutex<Tables>>, what: &str) {
    tables.lock().writes.clear();
    run.command(&[("pan", 0.5), ("lift", 0.5)]);
    run.cycles(150);
    let mut tables = tables.lock();
    assert_eq!(tables.written(0, "goal_position"), [0; 0], "{what}: no goal is written");
    assert!(tables.written(0, "torque_enable").iter().all(|on| *on == 0), "{what}: the torque stays off");
    assert_eq!(tables.get(0, "torque_enable"), 0, "{what}");
    let (level, words) = run.health_of("servo 1 pan");
    let joint = &tables.plan.joints[0];
    let reading = tables.get(0, "present_position");
    assert_eq!(level, DiagnosticStatus::ERROR, "{what}: {words}");
    for part in ["servo 1 (pan) stays limp", &reading.to_string(), "count of turns", "calibrate"] {
        assert!(words.contains(part), "{what}: {words}");
    }
    assert!((joint.goal_range()[0]..=joint.goal_range()[1]).contains(&tables.get(1, "goal_position")));
    assert_ne!(tables.get(1, "torque_enable"), 0, "{what}: others have torque");
}

fn torque_service(run: &mut Run, data: bool) -> SetBoolResponse {
    let caller = run.core.caller::<SetBoolRequest, SetBoolResponse>("torque").unwrap();
    let (sender, receiver) = mpsc::channel();
    caller
        .call(SetBoolRequest { data }, Duration::from_secs(1), move |reply| drop(sender.send(reply)))
        .unwrap();
    run.cycles(5);
    receiver.try_recv().unwrap().unwrap()
}

#[test]
fn a_servo_that_is_outside_its_goals_stays_limp_at_every_start() {
    let folder = tempfile::tempdir().unwrap();
    for (description, plan) in descriptions(folder.path()) {
        let (model, out) = (plan.joints[0].model.name.clone(), beyond(&plan));
        let tables = Tables::of(&plan);
        tables.lock().set(0, "present_position", out);
        let mut it = run(&description, &tables);
        it.cycles(60);
        assert_limp(&mut it, &tables, &format!("{model} at the start"));

        let words = it.health_of("servo 1 pan").1.to_owned();
        let reply = torque_service(&mut it, true);
        assert_eq!(
            (reply.success, reply.message),
            (false, format!("{words}; the torque of 3 joints is switched on"))
        );
        it.torque(&[("pan", 1.0)]);
        it.cycles(5);
        assert_limp(&mut it, &tables, &format!("{model} after its torque was commanded"));
        assert_eq!(it.value_of("arm: bus", "commands refused"), "1", "{model}");

        drop(it.core.handle().transition("servos", Transition::Deactivate));
        it.cycles(3);
        // One that was within its goals is turned out of them while nobody drives it.
        tables.lock().set(2, "present_position", out);
        tables.lock().set(2, "torque_enable", 0);
        drop(it.core.handle().transition("servos", Transition::Activate));
        it.cycles(3);
        assert_limp(&mut it, &tables, &format!("{model} after a reactivation"));
        assert_eq!(tables.lock().get(2, "torque_enable"), 0, "{model}");
        assert_eq!(it.health_of("servo 3 elbow").0, DiagnosticStatus::ERROR, "{model}");
        tables.lock().set(2, "present_position", plan.joints[2].zero);
        it.cycles(150);

        tables.lock().is_plugged = false;
        it.cycles(20);
        tables.lock().is_plugged = true;
        it.cycles(300);
        assert_limp(&mut it, &tables, &format!("{model} after a reconnection"));

        tables.lock().set(0, "present_position", plan.joints[0].zero + 3);
        tables.lock().writes.clear();
        it.cycles(150);
        let goals = tables.lock().written(0, "goal_position");
        assert_eq!(
            (goals[0], tables.lock().get(0, "torque_enable")),
            (plan.joints[0].zero + 3, 1),
            "{model}"
        );
        assert_eq!(it.health_of("servo 1 pan"), (DiagnosticStatus::OK, "OK"), "{model}");

        // The module starts while the servo has the torque of an earlier run.
        tables.lock().set(0, "present_position", out);
        let mut again = run(&description, &tables);
        again.cycles(60);
        assert_limp(&mut again, &tables, &format!("{model} after a restart"));
    }
}

#[test]
fn a_servo_that_was_turned_out_of_its_goals_by_hand_gets_no_torque() {
    let folder = tempfile::tempdir().unwrap();
    for (description, plan) in descriptions(folder.path()) {
        let model = plan.joints[0].model.name.clone();
        let tables = Tables::of(&plan);
        let mut it = run(&description, &tables);
        it.cycles(60);
        assert!(torque_service(&mut it, false).success);
        tables.lock().set(0, "present_position", beyond(&plan));
        it.cycles(120);
        assert_eq!(it.health_of("servo 1 pan"), (DiagnosticStatus::OK, "OK, torque is off"), "{model}");
        let reply = torque_service(&mut it, true);
        assert!(!reply.success && reply.message.contains("servo 1 (pan) stays limp"), "{model}: {reply:?}");
        tables.lock().writes.clear();
        it.cycles(300);
        assert_eq!(tables.lock().written(0, "goal_position"), [0; 0], "{model}");
        assert_eq!(tables.lock().get(0, "torque_enable"), 0, "{model}");
        tables.lock().set(0, "present_position", plan.joints[0].zero);
        it.cycles(10);
        assert!(torque_service(&mut it, true).success, "{model}");
        it.cycles(150);
        assert_eq!(tables.lock().written(0, "goal_position")[0], plan.joints[0].zero, "{model}");
        assert_eq!(tables.lock().get(0, "torque_enable"), 1, "{model}");
    }
}

#[test]
fn the_position_limits_of_the_servo_and_its_sensor_count_as_well() {
    let folder = tempfile::tempdir().unwrap();
    for (description, plan) in descriptions(folder.path()) {
        let (model, middle) = (plan.joints[0].model.name.clone(), plan.joints[0].zero);
        let tables = Tables::of(&plan);
        tables.lock().set(0, "max_position_limit", middle + 10);
        tables.lock().set(0, "present_position", middle + 11);
        let mut it = run(&description, &tables);
        it.cycles(60);
        assert_limp(&mut it, &tables, &format!("{model} beyond its limit"));
        if has_position_alarm(plan.line.protocol) {
            tables.lock().set(0, "present_position", middle);
            tables.lock().error = StatusError::POSITION_SENSOR;
            let mut it = run(&description, &tables);
            it.cycles(60);
            assert_eq!(tables.lock().get(0, "torque_enable"), 0, "{model}");
            assert!(it.health_of("servo 1 pan").1.contains("position sensor is faulty"), "{model}");
        }
    }
}

#[test]
fn a_servo_with_torque_loses_it_before_its_mode_or_limits_change() {
    let tables = Tables::of(Description::load(&arm("feetech_sts", "STS3215", "")).unwrap().bus("").unwrap());
    tables.lock().set(0, "torque_enable", 1);
    tables.lock().set(0, "operating_mode", 1);
    let mut it = run(&arm("feetech_sts", "STS3215", ""), &tables);
    it.cycles(60);
    let tables = tables.lock();
    let at = |address: u16, data: &[u8]| {
        tables
            .writes
            .iter()
            .position(|e| e.id == Id::new(1).unwrap() && e.address == address && e.data == data)
    };
    let (off, mode, on) = (at(40, &[0]).unwrap(), at(33, &[0]).unwrap(), at(40, &[1]).unwrap());
    assert!(off < mode && mode < on, "{off} {mode} {on}");
}

#[test]
fn torque_and_goals_cannot_be_set_by_a_description_or_model() {
    for register in ["torque_enable", "goal_position"] {
        let text = arm("feetech_sts", "STS3215", "")
            .replace("offset = 40", &format!("registers = {{ {register} = 1 }}"));
        let error = Description::load(&text).unwrap_err().to_string();
        assert!(error.contains(&format!("\"{register}\" cannot be set by a description")), "{error}");
        let model = include_str!("../models/ax_12a.toml")
            .replace("moving_speed = 0 }", &format!("{register} = 1 }}"));
        let error = models::Model::parse(&model).unwrap_err().to_string();
        assert!(error.contains(register) && error.contains("set by the driver"), "{error}");
    }
    for (bad, found) in [
        ("offset = 9223372036854775807", "has the offset"),
        ("zero = -9223372036854775808", "has the zero"),
        ("gear = 1e-300", "has the gear ratio"),
    ] {
        let error =
            Description::load(&arm("feetech_sts", "STS3215", "").replace("offset = 40", bad)).unwrap_err();
        assert!(error.to_string().contains(found), "{error}");
    }
    let fast = arm("feetech_sts", "STS3215", "").replace("offset = 40", "approach_rad_s = 1e300");
    let plan = Description::load(&fast).unwrap().bus("").unwrap().clone();
    assert_eq!(plan.joints[3].approach_steps, 4095);
}

#[test]
fn an_adapter_that_echoes_is_named_and_no_servo_is_used() {
    let folder = tempfile::tempdir().unwrap();
    for (description, plan) in descriptions(folder.path()) {
        let model = plan.joints[0].model.name.clone();
        let tables = Tables::of(&plan);
        tables.lock().echoes = true;
        let mut it = run(&description, &tables);
        it.cycles(300);
        assert!(tables.lock().writes.is_empty(), "{model}: {:?}", tables.lock().writes);
        let (level, words) = it.health_of("arm: bus");
        assert!(level == DiagnosticStatus::ERROR && words.contains("the adapter echoes"), "{model}: {words}");
        assert!(it.health_of("servo 1 pan").1.contains("the adapter echoes"), "{model}");
        tables.lock().echoes = false;
        it.cycles(600);
        assert!(
            it.health.status.iter().all(|part| part.level == DiagnosticStatus::OK),
            "{model}: {:?}",
            it.health
        );
    }
}

/// Random numbers that a seed determines.
struct Dice(u64);

impl Dice {
    fn below(&mut self, end: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ self.0 >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        (mixed ^ mixed >> 31) % end
    }

    fn one_in(&mut self, count: u64) -> bool {
        self.below(count) == 0
    }

    fn byte(&mut self) -> u8 {
        self.below(256) as u8
    }
}

/// What servos of this protocol could answer instead: other data, errors, ids, lengths, bytes, nothing.
fn lie(dice: &mut Dice, tables: &mut Tables, instruction: &[u8]) -> Vec<u8> {
    let protocol = tables.plan.line.protocol;
    // Positions anywhere in what the register can hold, mostly near its ends.
    for joint in 0..tables.plan.joints.len() {
        if dice.one_in(3) {
            let register = tables.plan.joints[joint].registers.position.clone();
            let goal = &tables.plan.joints[joint].registers.goal;
            let near =
                [goal.min - 2, goal.max - 2, register.min, register.max - 4, 2048][dice.below(5) as usize];
            tables.set(joint, "present_position", near + dice.below(5) as i64);
        }
    }
    let honest = tables.answer(instruction);
    if dice.one_in(4) {
        return honest;
    }
    let mut statuses = Vec::new();
    let mut receiver = Receiver::new(protocol);
    receiver.push(&honest);
    receiver.end();
    while let Some(packet) = receiver.next_packet() {
        statuses.extend(Status::parse(&packet));
    }
    let mut reply = Vec::new();
    match dice.below(12) {
        0 => return Vec::new(),
        1 => reply.extend((0..dice.below(40)).map(|_| dice.byte())),
        2 => reply.extend_from_slice(instruction),
        _ => {}
    }
    for mut status in statuses {
        match dice.below(16) {
            0 => status.error = StatusError::from_byte(protocol, dice.byte()),
            1 => status.parameters.iter_mut().for_each(|byte| *byte = dice.byte()),
            2 => status.parameters.truncate(dice.below(8) as usize),
            3 => status.id = Id::new(dice.below(6) as u8).unwrap(),
            4 => {
                let _ = status.emit(protocol, &mut reply);
            }
            5 => continue,
            _ => {}
        }
        let _ = status.emit(protocol, &mut reply);
        if dice.one_in(16)
            && let Some(last) = reply.last_mut()
        {
            *last ^= 1 << dice.below(8);
        }
    }
    if reply.is_empty() { honest } else { reply }
}

/// What an independent reading of the bytes on the bus knows of a servo.
#[derive(Clone, Default)]
struct Known {
    /// The positions in the last answer to a read of nothing but the position.
    positions: Vec<i64>,
    /// The goal that it has, if the driver wrote one.
    goal: Option<i64>,
    commanded: Option<i64>,
}

/// Checks an instruction and notes its answer.
fn check(plan: &BusPlan, known: &mut BTreeMap<Id, Known>, instruction: &[u8], reply: &[u8]) {
    let protocol = plan.line.protocol;
    let parsed = Instruction::parse(&Packet::new_checked(protocol, instruction).unwrap()).unwrap();
    let is_broadcast = parsed.id().is_broadcast();
    let writes = match parsed {
        Instruction::Read { id, address, length } => {
            let Some(joint) = plan.joints.iter().find(|joint| joint.id == id) else { return };
            let position = &joint.registers.position;
            if (address, length) == (position.address, position.size) {
                let mut receiver = Receiver::new(protocol);
                receiver.push(reply);
                receiver.end();
                let known = known.entry(id).or_default();
                known.positions.clear();
                while let Some(packet) = receiver.next_packet() {
                    if let Ok(status) = Status::parse(&packet)
                        && status.id == id
                    {
                        known.positions.extend(position.raw_in(protocol, &status.parameters, address));
                    }
                }
            }
            return;
        }
        Instruction::Write { id, address, data } => vec![(id, address, data)],
        Instruction::SyncWrite { address, entries, .. } => {
            entries.into_iter().map(|(id, data)| (id, address, data)).collect()
        }
        Instruction::BulkWrite { entries } => {
            entries.into_iter().map(|entry| (entry.id, entry.address, entry.data)).collect()
        }
        _ => return,
    };
    for (id, address, data) in writes {
        let Some(joint) = plan.joints.iter().find(|joint| joint.id == id) else { continue };
        let value = |register: &models::Register| register.raw_in(protocol, &data, address);
        let known = known.entry(id).or_default();
        let name = format!("{} {}", joint.model.name, joint.name);
        if let Some(drive) = &joint.drive {
            if let Some(goal) = value(&drive.goal) {
                assert!(goal == 0 || Some(goal) == known.commanded, "{name}: a goal of {goal}");
                known.goal = Some(goal);
            }
            assert_eq!(value(&joint.registers.goal), None, "{name}");
        } else if let Some(goal) = value(&joint.registers.goal) {
            let register = &joint.registers.goal;
            assert!((register.min..=register.max).contains(&goal), "{name}: {goal} is no goal");
            if is_broadcast {
                let last = known.goal.unwrap();
                let wanted = known.commanded.unwrap_or(last);
                assert!(
                    (last.min(wanted)..=last.max(wanted)).contains(&goal),
                    "{name}: {goal} is not between {last} and {wanted}"
                );
            } else {
                assert!(
                    known.positions.contains(&goal),
                    "{name}: {goal} was not read just now: {:?}",
                    known.positions
                );
            }
            known.goal = Some(goal);
        }
        if value(&joint.registers.torque) == Some(1) {
            let goal = known.goal.unwrap();
            let is_held = if joint.drive.is_some() { goal == 0 } else { known.positions.contains(&goal) };
            assert!(!is_broadcast && is_held, "{name}: torque with the goal {goal} at {:?}", known.positions);
        }
    }
}

/// Drives servos that answer anything, with commands of goals and torque or without.
fn drive(plan: &BusPlan, seed: u64, is_commanded: bool) -> usize {
    let tables = Tables::of(plan);
    let known: Arc<Mutex<BTreeMap<Id, Known>>> = Arc::default();
    let (mut liar, checked, checked_plan) = (Dice(seed), Arc::clone(&known), plan.clone());
    // Some servos begin honestly, so that they come into service.
    let honest_until = liar.below(80);
    let mut count = 0;
    let answer = move |tables: &mut Tables, instruction: &[u8]| {
        count += 1;
        let reply = if count < honest_until || liar.one_in(3) {
            tables.answer(instruction)
        } else {
            lie(&mut liar, tables, instruction)
        };
        check(&checked_plan, &mut checked.lock(), instruction, &reply);
        reply
    };
    let mut bus = TableBus::new(&tables, answer);
    let mut driver = Driver::new(plan.joints.len(), plan.devices.len());
    let (mut dice, mut now, mut exchanges) = (Dice(!seed), Time::ZERO, Vec::new());
    for _ in 0..250 {
        now = now + [10, 10, 10, 300, 2000][dice.below(5) as usize] * Duration::from_millis(1);
        if dice.one_in(50) {
            tables.lock().is_plugged = dice.one_in(2);
        }
        let index = dice.below(plan.joints.len() as u64) as usize;
        let joint = &plan.joints[index];
        if is_commanded && dice.one_in(4) {
            let goal = match &joint.drive {
                None => joint.goal(dice.below(300) as f64 / 100.0 - 1.5).unwrap(),
                Some(drive) => joint.driven_goal(drive, dice.below(300) as f64 / 100.0 - 1.5).unwrap(),
            };
            driver.servos[index].want(goal, now);
            known.lock().entry(joint.id).or_default().commanded = Some(goal);
        }
        if dice.one_in(6) {
            let share = [0.0, 0.5, 1.0][dice.below(3) as usize];
            driver.servos[index].command_torque(share);
        }
        let _ = driver.step(now, plan, &mut bus, &mut exchanges);
    }
    exchanges.len()
}

#[test]
fn no_answer_makes_the_driver_write_a_goal_that_was_neither_commanded_nor_just_read() {
    let folder = tempfile::tempdir().unwrap();
    let mut plans: Vec<BusPlan> = descriptions(folder.path()).into_iter().map(|(_, plan)| plan).collect();
    for (model, mode) in [
        ("XM430-W350", "mode = \"velocity\"\nmax_velocity_rad_s = 2.0"),
        ("XL330-M288", "mode = \"effort\"\nmax_current_a = 0.5"),
        ("XM430-W350", "guard = { temperature_c = { soften = 50.0, off = 60.0 } }"),
    ] {
        let text = arm("dynamixel2", model, "").replacen("id = 1\n", &format!("id = 1\n{mode}\n"), 1);
        plans.push(Description::load(&text).unwrap().bus("").unwrap().clone());
    }
    let resting = arm("dynamixel1", "MX-28", "")
        .replace("offset = 40", "offset = 40\nguard = { shutdown_rest_s = 0.1 }");
    plans.push(Description::load(&resting).unwrap().bus("").unwrap().clone());
    let with_board = arm("dynamixel1", "MX-28", "") + BOARD_AND_FOOT;
    plans.push(Description::load(&with_board).unwrap().bus("").unwrap().clone());
    for plan in &plans {
        let exchanges: usize = (0..16).map(|seed| drive(plan, seed, seed % 2 == 0)).sum();
        assert!(exchanges > 2000, "{}: the driver does nothing", plan.joints[0].model.name);
    }
}

#[test]
fn a_servo_that_has_counted_backwards_over_zero_is_shown_where_it_is_and_stays_limp() {
    // What a servo reads 100 steps below 0: a complement of two in Dynamixel 2.0, a bit for the sign of
    // Feetech.
    for (kind, bytes) in [(2, &[0x9C, 0xFF, 0xFF, 0xFF][..]), (4, &[0x64, 0x80])] {
        let (protocol, model, rest) = KINDS[kind];
        let description = arm(protocol, model, rest);
        let plan = Description::load(&description).unwrap().bus("").unwrap().clone();
        let joint = &plan.joints[0];
        let register = &joint.registers.position;
        assert_eq!(register.raw_in(plan.line.protocol, bytes, register.address), Some(-100), "{model}");
        assert_eq!(register.bytes(plan.line.protocol, -100), bytes, "{model}");
        let angle = (-100.0 - 2048.0) * std::f64::consts::TAU / 4096.0;
        assert!((joint.angle(-100) - angle).abs() < 1e-9, "{model}: {}", joint.angle(-100));

        let tables = Tables::of(&plan);
        tables.lock().set(0, "present_position", -100);
        let mut it = run(&description, &tables);
        let states = it.cycles(60);
        let last = &states[states.len() - 1];
        assert!((position(last, "pan") - angle).abs() < 1e-9, "{model}: {last:?}");
        assert_limp(&mut it, &tables, model);
        assert!(it.health_of("servo 1 pan").1.contains("reads -100 (-3.295 rad)"), "{:?}", it.health);
    }
}
