//! Two servos of one id, in a scan and on a running bus.

use super::protocol::Id;
use super::table_bus::{TableBus, Tables};
use super::tool::{Found, ServoError, ServoPort};
use super::*;
use std::sync::Arc;

fn ids() -> Vec<Id> {
    (0..8).filter_map(Id::new).collect()
}

/// One of each protocol.
const PROTOCOLS: [usize; 4] = [0, 2, 3, 4];

#[track_caller]
fn assert_named(port: &mut ServoPort, found: &[Found], id: Id, what: &str) {
    let garbled: Vec<_> = found.iter().filter(|found| found.is_garbled).collect();
    assert_eq!(garbled.iter().map(|found| found.id).collect::<Vec<_>>(), [id], "{what}");
    let problems = port.examine(garbled[0]).unwrap();
    let parts = ["1000000 bit/s is not understood", "Two servos may have this id", "`downbeat servo set-id`"];
    for problem in [problems[0].clone(), port.identify(id).unwrap_err().to_string()] {
        assert!(problem.contains(&format!("id {id}")), "{what}: {problem}");
        assert!(parts.iter().all(|part| problem.contains(part)), "{what}: {problem}");
    }
    assert!(matches!(port.known(id), Err(ServoError::Garbled { .. })), "{what}");
}

#[test]
fn a_scan_names_two_servos_of_one_id_whose_answers_to_pings_collide() {
    for kind in PROTOCOLS {
        let (protocol, model, rest) = KINDS[kind];
        let plan = Description::load(&arm(protocol, model, rest)).unwrap().bus("").unwrap().clone();
        let options = EmulatorOptions {
            timing: Timing::Immediate,
            faults: vec!["twin:3".parse().unwrap()],
            ..Default::default()
        };
        let emulator = Emulator::servos_in_memory(&plan, &options);
        let mut port = ServoPort::on(Box::new(emulator.bus()), "p", Vec::new()).unwrap();
        let found = port.scan(1_000_000, &[plan.line.protocol], &ids()).unwrap();
        let all: Vec<u8> = found.iter().map(|found| found.id.raw()).collect();
        assert_eq!(all, [1, 2, 3, 4], "{model}");
        for other in found.iter().filter(|found| found.id.raw() != 3) {
            assert_eq!(other.model.as_ref().map(|found| &*found.name), Some(model));
            assert_eq!(port.examine(other).unwrap(), [""; 0], "{model}");
        }
        let id = Id::new(3).unwrap();
        assert_named(&mut port, &found, id, model);
        let new = Id::new(1).unwrap();
        let taken = port.set_id(new, id, tool::Caution::Refuse).unwrap_err().to_string();
        assert!(taken.contains("id 3 is taken"), "{model}: {taken}");
    }
}

#[test]
fn a_scan_names_two_servos_of_one_id_that_differ_in_their_models_only() {
    for kind in [0, 4] {
        let (protocol, model, rest) = KINDS[kind];
        let plan = Description::load(&arm(protocol, model, rest)).unwrap().bus("").unwrap().clone();
        let (tables, others) = (Tables::of(&plan), Tables::of(&plan));
        others.lock().set(2, "model_number", 0x1234);
        // Both answer at the same time; on the line a 0 of either wins. Their answers to pings are the same.
        let both = {
            let others = Arc::clone(&others);
            move |tables: &mut Tables, instruction: &[u8]| {
                let mut reply = tables.answer(instruction);
                reply.iter_mut().zip(others.lock().answer(instruction)).for_each(|(a, b)| *a &= b);
                reply
            }
        };
        let mut port = ServoPort::on(Box::new(TableBus::new(&tables, both)), "p", Vec::new()).unwrap();
        let found = port.scan(1_000_000, &[plan.line.protocol], &ids()).unwrap();
        assert_eq!(found.len(), 4, "{model}: {found:?}");
        assert_named(&mut port, &found, Id::new(3).unwrap(), model);
    }
}

#[test]
fn two_servos_of_one_id_on_a_running_bus_are_stale_and_the_others_go_on() {
    for (protocol, model, rest) in KINDS {
        // A fast read has one answer of all servos, which nobody understands.
        if !rest.is_empty() {
            continue;
        }
        let mut run = Run::of(&arm(protocol, model, rest));
        run.cycles(60);
        run.inject("twin:3".parse().unwrap());
        run.command(&[("pan", 0.5), ("wrist", 0.5)]);
        run.cycles(100);
        let states = run.cycles(200);
        assert!(states.len() > 150, "{model}: {}", states.len());
        let last = &states[states.len() - 1];
        assert!(last.velocity[2].is_nan() && last.velocity[0].is_finite(), "{model}: {last:?}");
        assert!((position(last, "pan") - 0.5).abs() < 0.02, "{model}");
        assert!((position(last, "wrist") - 0.5).abs() < 0.02, "{model}");
        let (level, words) = run.health_of("servo 3 elbow");
        assert_eq!(level, DiagnosticStatus::ERROR, "{model}: {words}");
        assert!(words.contains("its plugs and its id; `downbeat servo scan`"), "{model}: {words}");
    }
}
