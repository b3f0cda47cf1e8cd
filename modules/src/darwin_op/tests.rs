//! The module against the emulated robot, through its port; and against a recording of that.
#![allow(clippy::unwrap_used)]

use super::bus::{Exchange, Outcome, RecordedBus, SerialBus};
use super::tables::joints::{JOINTS, index_of};
use super::tables::{cm730, mx28};
use super::{CYCLE, DarwinOp};
use crate::darwin_op_emulator::{Button, Emulator, EmulatorOptions, Fault, FaultKind, Rate, Timing};
use crate::testing::{Collector, core_at_zero};
use downbeat_executor::{Core, Inbox, Inlet, ManualClock, ModuleOptions, SettingValue, Synchrony};
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::sensor_msgs::msg::{BatteryState, Imu, JointState, Joy};
use downbeat_msgs::{Message, cdr};
use std::time::{Duration, Instant};

/// A hardware module in a core whose time this test moves, and all it publishes.
struct Run {
    core: Core,
    clock: ManualClock,
    commands: Inlet<JointState>,
    exchanges: Collector<BusExchange>,
    joint_states: Collector<JointState>,
    imu: Collector<Imu>,
    battery: Collector<BatteryState>,
    buttons: Collector<Joy>,
    diagnostics: Collector<DiagnosticArray>,
    /// The last message of `diagnostics`.
    health: DiagnosticArray,
}

impl Run {
    fn new(module: DarwinOp, settings: &[(&str, SettingValue)]) -> Self {
        let (mut core, clock) = core_at_zero();
        let settings = settings.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
        let options = ModuleOptions { settings, ..ModuleOptions::default() };
        core.add_with("darwin_op", module, options).unwrap();
        let exchanges = Collector::add(&mut core, "bus/exchanges");
        let joint_states = Collector::add(&mut core, "joint_states");
        let imu = Collector::add(&mut core, "imu/data_raw");
        let battery = Collector::add(&mut core, "battery_state");
        let buttons = Collector::add(&mut core, "buttons");
        let diagnostics = Collector::add(&mut core, "diagnostics");
        let commands = core.inlet("joint_commands").unwrap();
        let health = DiagnosticArray::default();
        Self { core, clock, commands, exchanges, joint_states, imu, battery, buttons, diagnostics, health }
    }

    /// On the emulated robot.
    fn on(emulator: &Emulator) -> Self {
        Self::on_with(emulator, &[])
    }

    fn on_with(emulator: &Emulator, settings: &[(&str, SettingValue)]) -> Self {
        let port = emulator.port_path().to_string_lossy().into_owned();
        // Enough for a machine that runs many tests at once.
        let bus = SerialBus::with_slack(Duration::from_millis(100));
        Self::new(DarwinOp::new(Box::new(bus)), &[&[("port", port.into())], settings].concat())
    }

    /// Runs some cycles; what `joint_states` said.
    fn cycles(&mut self, count: usize) -> Vec<JointState> {
        for _ in 0..count {
            self.clock.advance(CYCLE);
            self.core.cycle().unwrap();
        }
        if let Some(last) = self.diagnostics.take().pop() {
            self.health = last;
        }
        self.joint_states.take()
    }

    /// Runs until it is so.
    fn until(&mut self, what: &str, mut is_so: impl FnMut(&mut Self, &[JointState]) -> bool) {
        let watchdog = Instant::now() + Duration::from_secs(60);
        loop {
            let states = self.cycles(5);
            if is_so(self, &states) {
                return;
            }
            assert!(Instant::now() < watchdog, "never: {what}");
        }
    }

    fn until_running(&mut self) {
        self.until("the robot runs", |_, states| !states.is_empty());
    }

    fn command(&self, joints: &[(&str, f64)]) {
        let name = joints.iter().map(|(name, _)| (*name).to_owned()).collect();
        let position = joints.iter().map(|(_, position)| *position).collect();
        self.commands.publish(JointState { name, position, ..JointState::default() }).unwrap();
    }

    /// The level and the message of the part whose name ends so.
    fn health_of(&self, part: &str) -> (u8, String) {
        let status = self.health.status.iter().find(|status| status.name.ends_with(part));
        status.map(|status| (status.level, status.message.clone())).unwrap_or_default()
    }

    fn is_healthy(&self) -> bool {
        self.health.status.len() == 22 && self.health.status.iter().all(|s| s.level == DiagnosticStatus::OK)
    }
}

fn emulator() -> Emulator {
    Emulator::start(EmulatorOptions { timing: Timing::Immediate, seed: 3, ..Default::default() }).unwrap()
}

fn servo(name: &str) -> FaultKind {
    FaultKind::DeadServo(JOINTS[index_of(name).unwrap()].id)
}

fn position(state: &JointState, name: &str) -> f64 {
    state.position[index_of(name).unwrap()]
}

#[test]
fn a_robot_that_runs_publishes_all_there_is_in_every_cycle() {
    let emulator = emulator();
    let mut run = Run::on(&emulator);
    run.until_running();
    run.imu.take();
    run.battery.take();
    run.buttons.take();
    let states = run.cycles(250);
    assert_eq!((states.len(), run.imu.take().len()), (250, 250));
    assert_eq!((run.battery.take().len(), run.buttons.take().len()), (2, 2), "once a second");
    let state = &states[249];
    assert_eq!(state.name, JOINTS.map(|joint| joint.name));
    for values in [&state.position, &state.velocity, &state.effort] {
        assert!(values.len() == 20 && values.iter().all(|value| value.is_finite()), "{values:?}");
    }
    assert!(run.is_healthy(), "{:?}", run.health);
}

#[test]
fn imu_and_battery_are_in_si_units_and_the_frames_of_the_settings() {
    let emulator = emulator();
    let mut run = Run::on_with(&emulator, &[("imu_frame", "here".to_owned().into())]);
    run.until_running();
    run.cycles(10);
    let imu = run.imu.take().pop().unwrap();
    assert_eq!((imu.header.frame_id.as_str(), imu.orientation_covariance[0]), ("here", -1.0));
    assert!((imu.linear_acceleration.z - 9.81).abs() < 0.5, "{imu:?}");
    assert!(imu.angular_velocity.x.abs() < 0.4 && imu.angular_velocity_covariance[0] > 0.0, "{imu:?}");
    let battery = run.battery.take().pop().unwrap();
    assert!((11.0..12.7).contains(&battery.voltage) && battery.percentage.is_nan(), "{battery:?}");
}

#[test]
fn nothing_moves_before_it_is_commanded() {
    let emulator = emulator();
    let mut run = Run::on(&emulator);
    run.until_running();
    let (first, last) = (run.cycles(1).remove(0), run.cycles(200).remove(199));
    for joint in &JOINTS {
        let moved = (position(&last, joint.name) - position(&first, joint.name)).abs();
        assert!(moved < 0.01, "{} moved by {moved}", joint.name);
    }
}

#[test]
fn a_command_moves_the_joints_it_names_inside_their_limits() {
    let emulator = emulator();
    let mut run = Run::on(&emulator);
    run.until_running();
    let before = run.cycles(1).remove(0);
    run.command(&[("head_pan", 0.6), ("head_tilt", 100.0), ("r_el", f64::NAN), ("tail", 1.0)]);
    run.until("the head is where it is wanted", |_, states| {
        let state = &states[states.len() - 1];
        let tilt = JOINTS[index_of("head_tilt").unwrap()].max_rad();
        (position(state, "head_pan") - 0.6).abs() < 0.02 && (position(state, "head_tilt") - tilt).abs() < 0.02
    });
    let after = run.cycles(1).remove(0);
    assert!((position(&after, "r_el") - position(&before, "r_el")).abs() < 0.01);
    run.cycles(130);
    let bus = &run.health.status[0];
    let unknown = bus.values.iter().find(|value| value.key.contains("unknown")).unwrap();
    assert_eq!(unknown.value, "1");
}

#[test]
fn a_first_command_is_approached_slowly() {
    let emulator = emulator();
    let mut run = Run::on(&emulator);
    run.until_running();
    run.command(&[("head_pan", 1.5)]);
    let fastest = run.cycles(80).iter().map(|state| state.velocity[18]).fold(0.0, f64::max);
    // 10 ticks in each cycle, of which this emulator lets only the 6 ms pass that the bus is busy: 2.6 rad/s. Without
    // the approach it would be twice as much.
    assert!((2.0..3.0).contains(&fastest), "{fastest} rad/s");
}

#[test]
fn an_offset_shifts_goal_and_position_alike() {
    let emulator = emulator();
    let mut offsets = vec![0_i64; 20];
    offsets[18] = 100;
    let mut run = Run::on_with(&emulator, &[("offset_ticks", offsets.into())]);
    run.until_running();
    run.command(&[("head_pan", 0.2)]);
    run.until("the head turns", |_, states| (position(&states[0], "head_pan") - 0.2).abs() < 0.01);
    run.exchanges.take();
    run.cycles(1);
    let written = run.exchanges.take().into_iter().find(|exchange| exchange.instruction[4] == 0x83).unwrap();
    let goal = u16::from_le_bytes([written.instruction[7 + 18 * 3 + 1], written.instruction[7 + 18 * 3 + 2]]);
    assert_eq!(goal, 2048 + 130 + 100);
}

#[test]
fn wrong_settings_are_refused() {
    let (mut core, _clock) = core_at_zero();
    let settings = [("offset_ticks".to_owned(), SettingValue::Integers(vec![1, 2]))].into();
    let options = ModuleOptions { settings, ..ModuleOptions::default() };
    let error = core.add_with("darwin_op", DarwinOp::serial(), options).err().unwrap();
    assert!(error.to_string().contains("has 2 numbers"), "{error}");
}

#[test]
fn a_dead_servo_is_stale_while_the_others_go_on_and_comes_back_by_itself() {
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
    assert!(run.is_healthy());
    let outcomes =
        run.exchanges.take().into_iter().filter(|exchange| exchange.outcome == BusExchange::TIMEOUT);
    assert!(outcomes.count() >= 2);
}

#[test]
fn an_unplugged_port_is_opened_again() {
    let folder = tempfile::tempdir().unwrap();
    let link = Some(folder.path().join("port"));
    let options = EmulatorOptions { timing: Timing::Immediate, link, ..Default::default() };
    let emulator = Emulator::start(options).unwrap();
    let mut run = Run::on(&emulator);
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
fn a_port_that_is_not_there_is_tried_less_and_less_often() {
    let mut run = Run::new(DarwinOp::serial(), &[("port", "/dev/no-such-port".to_owned().into())]);
    run.cycles(1250);
    let opened = run.exchanges.take().len();
    // 10 s: after 0.1, 0.3, 0.7, 1.5 and 3.1 s, then every 2 s.
    assert_eq!(opened, 9);
    assert_eq!(run.health_of("bus").1, "the serial port is closed");
}

#[test]
fn buttons_are_published_when_they_change() {
    let emulator = emulator();
    let mut run = Run::on(&emulator);
    run.until_running();
    emulator.press_button(Button::Mode, Duration::from_millis(50));
    run.until("mode is pressed", |run, _| run.buttons.take().iter().any(|joy| joy.buttons == [1, 0]));
    run.until("mode is let go", |run, _| run.buttons.take().iter().any(|joy| joy.buttons == [0, 0]));
}

#[test]
fn lasting_settings_are_written_only_where_they_differ() {
    let emulator = emulator();
    let writes_delay = |exchange: &BusExchange| {
        exchange.instruction.get(4..6) == Some(&[0x03, mx28::RETURN_DELAY.address][..])
    };
    let mut counts = Vec::new();
    for _ in 0..2 {
        let mut run = Run::on(&emulator);
        run.until_running();
        run.core.stop();
        counts.push(run.exchanges.take().iter().filter(|exchange| writes_delay(exchange)).count());
    }
    assert_eq!(counts, [20, 0]);
}

#[test]
fn new_gains_are_written_once() {
    let emulator = emulator();
    let mut run = Run::on(&emulator);
    run.until_running();
    run.exchanges.take();
    run.core.handle().set("darwin_op", "p_gain", 16_i64);
    run.cycles(20);
    let gains = run
        .exchanges
        .take()
        .into_iter()
        .filter(|exchange| exchange.instruction.get(4..6) == Some(&[0x83, mx28::D_GAIN.address][..]));
    let gains: Vec<Vec<u8>> = gains.map(|exchange| exchange.instruction[7..11].to_vec()).collect();
    assert_eq!(gains, [[1, 0, 0, 16]]);
}

#[test]
fn at_the_end_the_port_is_closed_and_the_torque_is_left_alone() {
    let emulator = emulator();
    let mut run = Run::on(&emulator);
    run.until_running();
    run.core.stop();
    let exchanges = run.exchanges.take();
    let [.., bulk_read, light, close] = &exchanges[..] else { panic!("{exchanges:?}") };
    assert_eq!(bulk_read.instruction[4], 0x92, "the last cycle");
    assert_eq!(light.instruction, [0xFF, 0xFF, 0xC8, 0x05, 0x03, cm730::LED_HEAD.address, 0xE0, 0x03, 0x32]);
    assert_eq!(close.kind, BusExchange::CLOSE);
}

#[test]
fn detached_on_a_bus_with_measured_timing_a_joint_arrives() {
    let emulator = Emulator::start(EmulatorOptions { seed: 5, ..Default::default() }).unwrap();
    let mut core = Core::new();
    let port = emulator.port_path().to_string_lossy().into_owned();
    let options = ModuleOptions {
        synchrony: Synchrony::Detached(Inbox::KeepAll),
        settings: [("port".to_owned(), SettingValue::Text(port))].into(),
        ..ModuleOptions::default()
    };
    core.add_with("darwin_op", DarwinOp::serial(), options).unwrap();
    let states = Collector::<JointState>::add(&mut core, "joint_states");
    let commands = core.inlet("joint_commands").unwrap();
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run());
    let watchdog = Instant::now() + Duration::from_secs(60);
    let mut has_arrived = false;
    while !has_arrived && Instant::now() < watchdog {
        let command =
            JointState { name: vec!["head_pan".into()], position: vec![0.4], ..JointState::default() };
        commands.publish(command).unwrap();
        std::thread::park_timeout(Duration::from_millis(20));
        has_arrived = states.take().iter().any(|state| (position(state, "head_pan") - 0.4).abs() < 0.02);
    }
    handle.stop();
    running.join().unwrap().unwrap();
    assert!(has_arrived);
}

/// What a run published, as bytes: bit for bit, and NaN equals NaN.
#[derive(Debug, PartialEq)]
struct Published {
    exchanges: Vec<Vec<u8>>,
    joint_states: Vec<Vec<u8>>,
    imu: Vec<Vec<u8>>,
    battery: Vec<Vec<u8>>,
    buttons: Vec<Vec<u8>>,
    diagnostics: Vec<Vec<u8>>,
}

/// Three seconds with commands in the same cycles; `before` is told of each cycle.
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
    let emulator = Emulator::start(options).unwrap();
    let mut original = Run::on(&emulator);
    let performed = perform(&mut original, |cycle| match cycle {
        100 => emulator.inject(Fault::lasting(servo("l_el"), Duration::from_millis(400))),
        180 => emulator.inject(Fault::always(FaultKind::Flip(Rate::Next(4)))),
        200 => emulator.inject(Fault::always(FaultKind::Drop(Rate::Next(2)))),
        220 => emulator.press_button(Button::Start, Duration::from_millis(60)),
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

    let report = report.lock().unwrap().clone();
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
    let report = report.lock().unwrap();
    let first = &report.differences[0];
    let (_, recorded) = first.recorded.as_ref().unwrap();
    assert_eq!(
        (recorded[8], first.done.1[8]),
        (32, 31),
        "D, I, P from address 26 of the first servo: {first:?}"
    );
}
