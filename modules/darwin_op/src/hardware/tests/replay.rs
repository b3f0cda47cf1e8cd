//! The module with a recording.

use super::*;
use crate::emulator::{self, Button, Fault, Rate};
use crate::hardware::bus::{Exchange, Outcome, RecordedBus};
use downbeat_msgs::{Message, cdr};
use std::sync::{Arc, Mutex};
use tracing::field::{Field, Visit};
use tracing::subscriber::with_default;

/// The messages of a run as bytes, so that they compare bit for bit, and NaN equals NaN.
#[derive(Debug, PartialEq)]
struct Published {
    exchanges: Vec<Vec<u8>>,
    joint_states: Vec<Vec<u8>>,
    imu: Vec<Vec<u8>>,
    battery: Vec<Vec<u8>>,
    buttons: Vec<Vec<u8>>,
    diagnostics: Vec<Vec<u8>>,
}

/// Three seconds with commands in the same cycles; `before` is called before each cycle.
fn perform(run: &mut Run, mut before: impl FnMut(usize)) -> Published {
    for cycle in 0..375 {
        before(cycle);
        if cycle % 50 == 20 {
            let angle = if cycle % 100 == 20 { 0.5 } else { -0.3 };
            run.command(&[("head_pan", angle), ("r_el", angle), ("nobody", 1.0)]);
        }
        run.clock.advance(CYCLE);
        run.core.cycle().unwrap();
    }
    run.core.stop();
    fn bytes<T: Message>(collector: &Collector<T>) -> Vec<Vec<u8>> {
        collector.take().iter().map(cdr::to_vec).collect()
    }
    Published {
        exchanges: bytes(&run.exchanges),
        joint_states: bytes(&run.joint_states),
        imu: bytes(&run.imu),
        battery: bytes(&run.battery),
        buttons: bytes(&run.buttons),
        diagnostics: bytes(&run.diagnostics),
    }
}

#[test]
fn a_recorded_run_with_faults_replays_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let link = Some(folder.path().join("port"));
    let options = EmulatorOptions { timing: Timing::Immediate, seed: 9, link, ..Default::default() };
    let emulator = emulator::start(options).unwrap();
    let mut original = Run::on_port_of(&emulator);
    let performed = perform(&mut original, |cycle| match cycle {
        100 => emulator.inject(Fault::lasting(servo("l_el"), Duration::from_millis(400))),
        180 => emulator.inject(Fault::always(FaultKind::Flip(Rate::Next(4)))),
        200 => emulator.inject(Fault::always(FaultKind::Drop(Rate::Next(2)))),
        220 => emulator::press_button(&emulator, Button::Start, Duration::from_millis(60)),
        250 => emulator.inject(Fault::lasting(FaultKind::ClosePort, Duration::from_millis(30))),
        _ => {}
    });
    drop(emulator);
    assert!(performed.joint_states.len() > 150, "only {} joint states", performed.joint_states.len());

    let recording: Vec<Exchange> = performed
        .exchanges
        .iter()
        .map(|bytes| Exchange::try_from(cdr::from_slice::<BusExchange>(bytes).unwrap()).unwrap())
        .collect();
    let length = recording.len() as u64;
    for outcome in [Outcome::Timeout, Outcome::Failed] {
        assert!(
            recording.iter().any(|exchange| exchange.outcome == outcome),
            "the faults did not show: {outcome:?}"
        );
    }
    let (bus, report) = RecordedBus::new(recording);
    let port = folder.path().join("port").to_string_lossy().into_owned();
    let mut replay = Run::new(DarwinOp::new(Box::new(bus)), &[("port", port.into())]);
    let replayed = perform(&mut replay, |_| {});

    let report = report.lock().clone();
    assert_eq!((report.differences, report.replayed), (Vec::new(), length));
    assert_eq!(replayed, performed);
}

#[test]
fn a_replay_with_another_command_is_noticed() {
    let emulator = emulator();
    let performed = perform(&mut Run::on(&emulator), |_| {});
    let decode =
        |bytes: &Vec<u8>| Exchange::try_from(cdr::from_slice::<BusExchange>(bytes).unwrap()).unwrap();
    let (bus, report) = RecordedBus::new(performed.exchanges.iter().map(decode).collect::<Vec<_>>());
    let mut replay = Run::new(DarwinOp::new(Box::new(bus)), &[("p_gain", SettingValue::Integer(31))]);
    perform(&mut replay, |_| {});
    let report = report.lock();
    let first = &report.differences[0];
    let (_, recorded) = first.recorded.as_ref().unwrap();
    assert_eq!(
        (recorded[8], first.done.1[8]),
        (32, 31),
        "D, I, P from address 26 of the first servo: {first:?}"
    );
}

/// Collects the warnings.
#[derive(Clone, Default)]
struct Warnings(Arc<Mutex<Vec<String>>>);

impl tracing::Subscriber for Warnings {
    fn enabled(&self, metadata: &tracing::Metadata<'_>) -> bool {
        *metadata.level() <= tracing::Level::WARN
    }

    fn new_span(&self, _: &tracing::span::Attributes<'_>) -> tracing::span::Id {
        tracing::span::Id::from_u64(1)
    }

    fn record(&self, _: &tracing::span::Id, _: &tracing::span::Record<'_>) {}

    fn record_follows_from(&self, _: &tracing::span::Id, _: &tracing::span::Id) {}

    fn event(&self, event: &tracing::Event<'_>) {
        event.record(&mut Line(&self.0));
    }

    fn enter(&self, _: &tracing::span::Id) {}

    fn exit(&self, _: &tracing::span::Id) {}
}

struct Line<'a>(&'a Mutex<Vec<String>>);

impl Visit for Line<'_> {
    fn record_debug(&mut self, _: &Field, value: &dyn std::fmt::Debug) {
        self.0.lock().unwrap().push(format!("{value:?}"));
    }
}

#[test]
fn a_late_cycle_is_logged_once_and_not_in_the_replay() {
    let perform_late = |run: &mut Run| {
        let (warnings, clock) = (Warnings::default(), run.clock.clone());
        let late = |cycle| {
            if cycle == 300 {
                clock.advance(CYCLE)
            }
        };
        let performed = with_default(warnings.clone(), || perform(run, late));
        let lines = warnings.0.lock().unwrap().clone();
        (performed, lines.iter().filter(|line| line.contains("began late")).count())
    };
    let emulator = emulator();
    let (performed, lines) = perform_late(&mut Run::on(&emulator));
    assert_eq!(lines, 1);
    let decode =
        |bytes: &Vec<u8>| Exchange::try_from(cdr::from_slice::<BusExchange>(bytes).unwrap()).unwrap();
    let (bus, report) = RecordedBus::new(performed.exchanges.iter().map(decode).collect::<Vec<_>>());
    let (replayed, lines) = perform_late(&mut Run::new(DarwinOp::new(Box::new(bus)), &[]));
    assert_eq!((report.lock().differences.len(), lines), (0, 0));
    assert_eq!(replayed, performed, "it is counted as in the recorded run");
}
