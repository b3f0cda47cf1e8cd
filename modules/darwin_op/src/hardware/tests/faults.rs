//! The module with faults.

use super::*;
use crate::emulator::{self, Fault, Rate};
use crate::hardware::bus::{Bus, Exchange, ExpectedStatus, LATE, LineSettings, Outcome};
use downbeat_executor::Time;

/// A bus on which one answer is late: it arrives when the next instruction is sent.
struct Late<B> {
    bus: B,
    /// Counts down with the exchanges.
    until: u32,
}

impl<B: Bus> Bus for Late<B> {
    fn begin_step(&mut self, now: Time) {
        self.bus.begin_step(now);
    }

    fn set_line(&mut self, line: LineSettings) {
        self.bus.set_line(line);
    }

    fn open(&mut self, port: &str) -> Exchange {
        self.bus.open(port)
    }

    fn exchange(&mut self, instruction: &[u8], expected: &[ExpectedStatus]) -> Exchange {
        let exchange = self.bus.exchange(instruction, expected);
        self.until = self.until.saturating_sub(u32::from(!expected.is_empty()));
        match self.until {
            2 => Exchange {
                outcome: Outcome::Timeout,
                reply: Vec::new(),
                error: "no answer".into(),
                ..exchange
            },
            1 => Exchange { error: LATE.into(), ..exchange },
            _ => exchange,
        }
    }

    fn close(&mut self) -> Exchange {
        self.bus.close()
    }
}

#[test]
fn a_busy_machine_is_distinguished_from_a_bus_that_loses_answers() {
    let emulator = emulator();
    // Some of the exchanges of a cycle.
    let bus = Late { bus: emulator.bus(), until: 600 };
    let mut run = Run::new(DarwinOp::new(Box::new(bus)), &[]);
    run.until_running();
    let busy = "running, but this machine is too busy: answers come after they were given up";
    run.until("the machine is called busy", |run, _| run.health_of("bus").1 == busy);
    assert_eq!(run.health_of("bus").0, DiagnosticStatus::WARN);
    run.until("all is well again", |run, _| run.is_healthy());
}

#[test]
fn a_dead_servo_is_stale_while_the_others_continue_and_recovers() {
    let emulator = emulator();
    let mut run = Run::on(&emulator);
    run.until_running();
    emulator.inject(Fault::lasting(servo("r_knee"), Duration::from_secs(2)));
    run.until("the knee is missed", |run, _| run.health_of("r_knee").0 == DiagnosticStatus::ERROR);
    let states = run.cycles(50);
    assert_eq!(states.len(), 50, "no cycle is lost on it");
    let (knee, other) = (index_of("r_knee").unwrap(), index_of("head_pan").unwrap());
    for state in &states {
        assert!(state.velocity[knee].is_nan() && state.effort[knee].is_nan());
        assert!(state.position[knee].is_finite(), "the last position is kept");
        assert!(state.velocity[other].is_finite());
    }
    assert_eq!(run.health_of("head_pan").0, DiagnosticStatus::OK);
    run.until("the knee is back", |run, _| run.is_healthy());
    assert!(run.cycles(2)[1].velocity[knee].is_finite());
}

#[test]
fn lost_and_corrupt_answers_cost_a_sample_but_no_servo() {
    let emulator = emulator();
    let mut run = Run::on(&emulator);
    run.until_running();
    emulator.inject(Fault::always(FaultKind::Flip(Rate::Next(3))));
    emulator.inject(Fault::always(FaultKind::Drop(Rate::Next(1))));
    let states = run.cycles(60);
    assert!(states.len() >= 58, "{}", states.len());
    assert!(states[states.len() - 1].velocity.iter().all(|velocity| velocity.is_finite()));
    assert!(run.health.status[1..].iter().all(|part| part.level == DiagnosticStatus::OK), "no servo is out");
    assert_eq!(
        run.health_of("bus"),
        (DiagnosticStatus::WARN, "running, but answers are missing or corrupt".into())
    );
    let outcomes =
        run.exchanges.take().into_iter().filter(|exchange| exchange.outcome == BusExchange::TIMEOUT);
    assert!(outcomes.count() >= 2);
    run.until("the bus is well again", |run, _| run.is_healthy());
}

#[test]
fn an_unplugged_port_is_opened_again() {
    let folder = tempfile::tempdir().unwrap();
    let link = Some(folder.path().join("port"));
    let options = EmulatorOptions { timing: Timing::Immediate, link, ..Default::default() };
    let emulator = emulator::start(options).unwrap();
    let mut run = Run::on_port_of(&emulator);
    run.until_running();
    run.command(&[("head_pan", 0.5)]);
    emulator.inject(Fault::lasting(FaultKind::ClosePort, Duration::from_millis(200)));
    run.until("the port is missed", |run, _| run.health_of("bus").0 == DiagnosticStatus::ERROR);
    run.until("the port is back", |run, _| run.is_healthy());
    run.until("the head goes where it was wanted", |_, states| {
        states.last().is_some_and(|state| (position(state, "head_pan") - 0.5).abs() < 0.02)
    });
}

#[test]
fn opening_a_missing_port_is_retried_less_and_less_often() {
    let mut run = Run::new(DarwinOp::serial(), &[("port", "/dev/no-such-port".to_owned().into())]);
    run.cycles(1250);
    let opened = run.exchanges.take().len();
    // 10 s: after 0.1, 0.3, 0.7, 1.5 and 3.1 s, then every 2 s.
    assert_eq!(opened, 9);
    assert_eq!(run.health_of("bus").1, "the serial port is closed");
}
