//! The processor time of a cycle of `ServoBus` with 20 Dynamixel servos of protocol 2.0 that are all
//! commanded: goals written, positions read, decoded and published. The answers are a recording of the
//! emulated robot, so that the time is that of the module and its core alone.
#![allow(missing_docs, clippy::unwrap_used)]

use criterion::{Criterion, criterion_group, criterion_main};
use downbeat_executor::{Core, Inbox, Inlet, ManualClock, ModuleOptions, Received, Time};
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::sensor_msgs::msg::JointState;
use downbeat_servos::servo_bus::bus::{Bus, RecordedBus};
use downbeat_servos::servo_bus::{Description, ServoBus};
use downbeat_servos::servo_emulator::{Emulator, EmulatorOptions, Timing};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// The number of cycles of a run; the first ones, in which the servos get ready, are not measured.
const CYCLES: u32 = 1500;
const READY: u32 = 500;
const CYCLE: Duration = Duration::from_millis(8);
const DESCRIPTION: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/servos/op3.toml");

struct Robot {
    core: Core,
    clock: ManualClock,
    commands: Inlet<JointState>,
    names: Vec<String>,
}

impl Robot {
    fn new(bus: Box<dyn Bus>) -> Self {
        let clock = ManualClock::new(Time::from_nanos(1_000_000_000));
        let mut core = Core::new().with_clock(clock.clone());
        let settings = [("description".to_owned(), DESCRIPTION.to_owned().into())].into();
        let options = ModuleOptions { settings, ..ModuleOptions::default() };
        core.add_with("hardware", ServoBus::new(bus), options).unwrap();
        let commands = core.inlet("joint_commands").unwrap();
        let description = Description::load(DESCRIPTION).unwrap();
        let names = description.bus("").unwrap().joints.iter().map(|joint| joint.name.clone()).collect();
        Self { core, clock, commands, names }
    }

    /// Commands all joints, and runs the core until they are written.
    fn cycle(&mut self, number: u32) {
        let position = vec![0.05 * f64::from(number % 100) / 100.0; self.names.len()];
        let name = self.names.clone();
        self.commands.publish(JointState { name, position, ..JointState::default() }).unwrap();
        self.clock.advance(CYCLE);
        (0..2).for_each(|_| self.core.cycle().unwrap());
    }
}

fn recording() -> Vec<BusExchange> {
    let description = Description::load(DESCRIPTION).unwrap();
    let options = EmulatorOptions { timing: Timing::Stepped, ..EmulatorOptions::default() };
    let emulator = Emulator::servos_in_memory(description.bus("").unwrap(), &options);
    let mut robot = Robot::new(Box::new(emulator.bus()));
    let exchanges = Arc::<Mutex<Vec<BusExchange>>>::default();
    let kept = Arc::clone(&exchanges);
    let keep = move |exchange: Received<'_, BusExchange>| kept.lock().unwrap().push(exchange.clone());
    robot.core.outlet("bus/exchanges", Inbox::KeepAll, keep).unwrap().keep();
    (0..CYCLES).for_each(|number| robot.cycle(number));
    drop(robot);
    let exchanges = exchanges.lock().unwrap();
    exchanges.clone()
}

fn servo_bus(criterion: &mut Criterion) {
    let exchanges = recording();
    criterion.bench_function("a cycle of 20 servos", |bencher| {
        bencher.iter_custom(|iterations| {
            let mut took = Duration::ZERO;
            let mut measured = 0;
            while measured < iterations {
                let mut robot = Robot::new(Box::new(RecordedBus::of_messages(exchanges.clone()).unwrap()));
                (0..READY).for_each(|number| robot.cycle(number));
                let part = iterations.saturating_sub(measured).min(u64::from(CYCLES - READY));
                let started = Instant::now();
                (READY..READY + part as u32).for_each(|number| robot.cycle(number));
                took += started.elapsed();
                measured += part;
            }
            took
        });
    });
}

criterion_group!(benches, servo_bus);
criterion_main!(benches);
