//! The cost of a cycle of 8 ms of a walking Darwin OP: hardware module, orientation filter, gait with its
//! kinematics, falls, motions and command multiplexer, with bus answers from a recording of the emulated
//! robot.
#![allow(missing_docs, clippy::unwrap_used)]

use criterion::{Criterion, criterion_group, criterion_main};
use downbeat_darwin_op::emulator::{self, EmulatorOptions, Timing};
use downbeat_darwin_op::falls::Falls;
use downbeat_darwin_op::gait::Gait;
use downbeat_darwin_op::hardware::bus::{Bus, Exchange, RecordedBus};
use downbeat_darwin_op::hardware::{CYCLE, DarwinOp};
use downbeat_darwin_op::motions::MotionPlayer;
use downbeat_executor::{Core, Inbox, Inlet, ManualClock, ModuleOptions, Received, Time};
use downbeat_imu_filter::ImuFilter;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::geometry_msgs::msg::Twist;
use downbeat_servos::joint_command_mux::JointCommandMux;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// The number of cycles of a run; the first ones, in which the robot gets ready, are not measured.
const CYCLES: u32 = 1500;
const READY: u32 = 500;

struct Robot {
    core: Core,
    clock: ManualClock,
    cmd_vel: Inlet<Twist>,
}

impl Robot {
    fn new(bus: Box<dyn Bus>) -> Self {
        let clock = ManualClock::new(Time::from_nanos(1_000_000_000));
        let mut core = Core::new().with_clock(clock.clone());
        let mut hardware = ModuleOptions::default();
        hardware.remaps.insert("joint_commands".to_owned(), "joint_goals".to_owned());
        core.add_with("hardware", DarwinOp::new(bus), hardware).unwrap();
        core.add("imu_filter", ImuFilter::default()).unwrap();
        let settings = [("start".to_owned(), true.into())].into();
        core.add_with("gait", Gait::default(), ModuleOptions { settings, ..ModuleOptions::default() })
            .unwrap();
        core.add("motions", MotionPlayer::default()).unwrap();
        core.add("falls", Falls::default()).unwrap();
        core.add("mux", JointCommandMux::default()).unwrap();
        let cmd_vel = core.inlet("cmd_vel").unwrap();
        Self { core, clock, cmd_vel }
    }

    /// Runs the cycles at one time of the hardware, with a command every 80 ms.
    fn period(&mut self, number: u32) {
        if number.is_multiple_of(10) {
            let mut twist = Twist::default();
            twist.linear.x = 0.1;
            self.cmd_vel.publish(twist).unwrap();
        }
        self.clock.advance(CYCLE);
        // The longest chain: hardware, filter, falls, gait, multiplexer, hardware.
        (0..6).for_each(|_| self.core.cycle().unwrap());
    }
}

/// The recorded bus answers of the emulated robot.
fn recording() -> Vec<Exchange> {
    let options = EmulatorOptions { timing: Timing::Stepped, ..EmulatorOptions::default() };
    let emulator = emulator::in_memory(&options, None);
    let mut robot = Robot::new(Box::new(emulator.bus()));
    let exchanges = Arc::<Mutex<Vec<Exchange>>>::default();
    let kept = Arc::clone(&exchanges);
    let keep = move |exchange: Received<'_, BusExchange>| {
        kept.lock().unwrap().push(Exchange::try_from(exchange.clone()).unwrap());
    };
    robot.core.outlet("bus/exchanges", Inbox::KeepAll, keep).unwrap().keep();
    (0..CYCLES).for_each(|number| robot.period(number));
    drop(robot);
    let exchanges = exchanges.lock().unwrap();
    exchanges.clone()
}

fn walking(criterion: &mut Criterion) {
    let exchanges = recording();
    criterion.bench_function("8 ms of a walking robot, without bus", |bencher| {
        bencher.iter_custom(|iterations| {
            let mut total = Duration::ZERO;
            for _ in 0..iterations {
                let (bus, _) = RecordedBus::new(exchanges.clone());
                let mut robot = Robot::new(Box::new(bus));
                (0..READY).for_each(|number| robot.period(number));
                let start = Instant::now();
                (READY..CYCLES).for_each(|number| robot.period(number));
                total += start.elapsed() / (CYCLES - READY);
            }
            total
        });
    });
}

criterion_group! {
    name = benches;
    config = Criterion::default()
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(2))
        .sample_size(10);
    targets = walking
}
criterion_main!(benches);
