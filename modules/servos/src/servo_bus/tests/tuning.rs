//! Offsets by eye: which servos get torque, and how they were left by others.

use super::protocol::StatusError;
use super::table_bus::{TableBus, Tables, has_position_alarm, honest};
use super::tool::{Caution, ServoError, ServoPort};
use super::*;
use parking_lot::Mutex;
use std::sync::Arc;

fn tables(protocol: &str, model: &str) -> Arc<Mutex<Tables>> {
    let description = Description::load(&arm(protocol, model, "")).unwrap();
    let tables = Tables::of(description.bus("").unwrap());
    let mut locked = tables.lock();
    for (joint, plan) in locked.plan.clone().joints.iter().enumerate() {
        locked.set(joint, "present_position", plan.steps(0.05));
    }
    drop(locked);
    tables
}

fn begin(tables: &Arc<Mutex<Tables>>) -> Result<(Tuner, Vec<String>), ServoError> {
    let plan = tables.lock().plan.clone();
    let port = ServoPort::on(Box::new(TableBus::new(tables, honest)), "p", Vec::new()).unwrap();
    Tuner::on(port, &plan)
}

#[test]
fn a_servo_is_prepared_before_it_gets_torque() {
    for (protocol, model, _) in KINDS {
        let tables = tables(protocol, model);
        // As an earlier program left the first servo: a wheel that turns as soon as it has torque.
        let (joint, mode) = {
            let mut tables = tables.lock();
            let joint = tables.plan.joints[0].clone();
            let mode = joint.model.modes.velocity.filter(|_| joint.model.register("goal_velocity").is_some());
            if let Some(velocity) = mode {
                tables.set(0, "operating_mode", velocity);
                tables.set(0, "goal_velocity", 100);
            }
            (joint, mode)
        };
        let (_tuner, notes) = begin(&tables).unwrap();
        assert_eq!(notes, [""; 0], "{model}");
        let mut tables = tables.lock();
        assert_eq!(tables.written(0, "torque_enable").last(), Some(&1), "{model}");
        assert_eq!(tables.get(0, "goal_position"), tables.get(0, "present_position"), "{model}");
        for (register, raw) in &joint.model.at_start {
            assert_eq!(tables.get(0, &register.name), *raw, "{model}: {}", register.name);
        }
        if mode.is_some() {
            let position =
                joint.model.at_start.iter().find(|(register, _)| register.name == "operating_mode");
            assert_eq!(Some(tables.get(0, "operating_mode")), position.map(|(_, raw)| *raw), "{model}");
            let place = |name: &str| {
                let register = joint.model.register(name).unwrap();
                let has = |entry: &super::protocol::WriteEntry| {
                    let end = entry.address + entry.data.len() as u16;
                    entry.id == joint.id && (entry.address..end).contains(&register.address)
                };
                tables.writes.iter().rposition(has).unwrap()
            };
            assert!(place("operating_mode") < place("torque_enable"), "{model}: the mode comes first");
        }
    }
}

#[test]
fn a_servo_with_an_alarm_of_its_position_sensor_gets_no_torque() {
    for (protocol, model, _) in KINDS {
        let tables = tables(protocol, model);
        if !has_position_alarm(tables.lock().plan.line.protocol) {
            continue;
        }
        tables.lock().error = StatusError::POSITION_SENSOR;
        let (tuner, notes) = begin(&tables).unwrap();
        assert_eq!((tuner.offsets().count(), notes.len()), (0, 4), "{model}");
        assert!(notes[0].contains("servo 1 (pan) stays limp: it reports that its position sensor is faulty"));
        assert!((0..4).all(|joint| tables.lock().get(joint, "torque_enable") == 0), "{model}");
    }
}

#[test]
fn a_servo_that_cannot_hold_its_place_or_go_to_zero_stays_limp_and_says_so() {
    for (protocol, model, _) in KINDS {
        let tables = tables(protocol, model);
        let plan = tables.lock().plan.clone();
        let goal = plan.joints[0].registers.goal.clone();
        tables.lock().set(0, "present_position", goal.max + 5);
        if plan.joints[1].model.register("min_position_limit").is_some() {
            // Where it is, but not where it is described to be at 0 rad: the joint counts backwards.
            tables.lock().set(1, "max_position_limit", plan.joints[1].steps(0.02));
        }
        let (tuner, notes) = begin(&tables).unwrap();
        let limp: Vec<_> = notes.iter().map(|note| note.split(':').next().unwrap()).collect();
        let expected = match plan.joints[1].model.register("min_position_limit") {
            Some(_) => vec!["servo 1 (pan) stays limp", "lift stays limp"],
            None => vec!["servo 1 (pan) stays limp"],
        };
        assert_eq!(limp, expected, "{model}: {notes:?}");
        assert_eq!(tuner.offsets().count(), 4 - expected.len(), "{model}");
        for joint in 0..4 {
            let has_torque = tables.lock().get(joint, "torque_enable") == 1;
            assert_eq!(has_torque, joint >= expected.len(), "{model}: {joint}");
        }
    }
}

#[test]
fn a_servo_that_turns_without_end_is_named_with_the_remedy() {
    let tables = tables("feetech_sts", "STS3215");
    tables.lock().set(2, "max_position_limit", 0);
    let error = begin(&tables).err().unwrap().to_string();
    for part in ["p: servo 3 (elbow) at 1000000 bit/s", "turns without end", "downbeat servo write"] {
        assert!(error.contains(part), "{error}");
    }
    assert!((0..4).all(|joint| tables.lock().get(joint, "torque_enable") == 0), "all are let go");
}

#[test]
fn torque_for_a_servo_that_was_left_turning_needs_force() {
    for (protocol, model, _) in KINDS {
        let tables = tables(protocol, model);
        let plan = tables.lock().plan.clone();
        let joint = &plan.joints[0];
        let Some(velocity) = joint.model.modes.velocity else { continue };
        let at = joint.steps(0.05);
        for (register, raw) in [("operating_mode", velocity), ("goal_velocity", 100), ("goal_position", at)] {
            tables.lock().set(0, register, raw);
        }
        let mut port = ServoPort::on(Box::new(TableBus::new(&tables, honest)), "p", Vec::new()).unwrap();
        port.speak(plan.line).unwrap();
        let mut write = |caution| port.write(joint.id, &joint.model, &joint.registers.torque, 1, caution);
        let refused = write(Caution::Refuse).unwrap_err().to_string();
        assert!(refused.contains("it would turn; write 0 to goal_velocity"), "{model}: {refused}");
        tables.lock().set(0, "goal_velocity", 0);
        assert_eq!(write(Caution::Refuse), Ok(()), "{model}");
    }
}
