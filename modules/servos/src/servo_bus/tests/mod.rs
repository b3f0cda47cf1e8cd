//! The module with emulated servos, in all protocols.
#![allow(clippy::unwrap_used)]

mod calibration;
mod drives;
mod faults;
mod limp;
mod scan;
mod table_bus;
mod trajectories;
mod tuning;

use super::module::ImuReading;
use super::protocol::Protocol;
use super::*;
use crate::servo_emulator::{Emulator, EmulatorOptions, Fault, FaultKind, Timing};
use crate::stamps::header;
use crate::testing::{Collector, core_at_zero};
use downbeat_executor::{Clock, Core, Inlet, ManualClock, ModuleOptions, SettingValue, Time};
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::sensor_msgs::msg::{BatteryState, JointState};
use downbeat_msgs::std_msgs::msg::Float64MultiArray;
use std::sync::mpsc;
use std::time::Duration;

/// Four joints, one of them reversed and geared, on a bus of this protocol.
fn arm(protocol: &str, model: &str, rest: &str) -> String {
    let mut text = format!(
        "name = \"arm\"\n[[bus]]\nname = \"bus\"\nport = \"p\"\nbaud = 1000000\nprotocol = \"{protocol}\"\ncycle_ms = 10\n{rest}\n[defaults]\nmodel = \"{model}\"\n"
    );
    for (id, (name, rest)) in
        [("pan", ""), ("lift", "sign = -1"), ("elbow", "gear = 2.0"), ("wrist", "offset = 40")]
            .iter()
            .enumerate()
    {
        text += &format!("[[joint]]\nname = \"{name}\"\nid = {}\nlimits = [-1.0, 1.0]\n{rest}\n", id + 1);
    }
    text
}

/// A hardware module in a core with a manual clock, the servos that it drives, and everything it publishes.
struct Run {
    core: Core,
    clock: ManualClock,
    cycle: Duration,
    emulator: Option<Emulator>,
    commands: Inlet<JointState>,
    torques: Inlet<JointState>,
    exchanges: Collector<BusExchange>,
    joint_states: Collector<JointState>,
    diagnostics: Collector<DiagnosticArray>,
    health: DiagnosticArray,
}

impl Run {
    fn of(description: &str) -> Self {
        Self::with(description, description, &[])
    }

    /// The module has one description, the emulator another one.
    fn with(description: &str, emulated: &str, faults: &[&str]) -> Self {
        let faults = faults.iter().map(|fault| fault.parse().unwrap()).collect();
        let options = EmulatorOptions { timing: Timing::Stepped, seed: 4, faults, ..Default::default() };
        let parsed = Description::load(emulated).unwrap();
        let emulator = Emulator::servos_in_memory(parsed.bus("").unwrap(), &options);
        let bus = Box::new(emulator.bus());
        Self { emulator: Some(emulator), ..Self::on_bus(description, bus) }
    }

    /// The module on any bus.
    fn on_bus(description: &str, bus: Box<dyn bus::Bus>) -> Self {
        let cycle = Description::load(description).unwrap().bus("").unwrap().cycle;
        let (mut core, clock) = core_at_zero();
        let settings = [("description".to_owned(), SettingValue::Text(description.to_owned()))].into();
        let options = ModuleOptions { settings, ..ModuleOptions::default() };
        core.add_with("servos", ServoBus::new(bus), options).unwrap();
        let exchanges = Collector::add(&mut core, "bus/exchanges");
        let joint_states = Collector::add(&mut core, "joint_states");
        let diagnostics = Collector::add(&mut core, "diagnostics");
        let commands = core.inlet("joint_commands").unwrap();
        let torques = core.inlet("joint_torque").unwrap();
        let health = DiagnosticArray::default();
        let emulator = None;
        Self { core, clock, cycle, emulator, commands, torques, exchanges, joint_states, diagnostics, health }
    }

    fn inject(&self, fault: Fault) {
        self.emulator.as_ref().unwrap().inject(fault);
    }

    fn cycles(&mut self, count: usize) -> Vec<JointState> {
        for _ in 0..count {
            self.clock.advance(self.cycle);
            self.core.cycle().unwrap();
        }
        if let Some(last) = self.diagnostics.take().pop() {
            self.health = last;
        }
        self.joint_states.take()
    }

    fn command(&self, joints: &[(&str, f64)]) {
        self.commands.publish(message(joints, |message, positions| message.position = positions)).unwrap();
    }

    fn torque(&self, joints: &[(&str, f64)]) {
        self.torques.publish(message(joints, |message, shares| message.effort = shares)).unwrap();
    }

    fn health_of(&self, part: &str) -> (u8, &str) {
        let status = self.health.status.iter().find(|status| status.name.ends_with(part)).unwrap();
        (status.level, &status.message)
    }

    fn value_of(&self, part: &str, key: &str) -> &str {
        let status = self.health.status.iter().find(|status| status.name.ends_with(part)).unwrap();
        &status.values.iter().find(|value| value.key == key).unwrap().value
    }
}

#[test]
fn a_command_that_cannot_be_meant_is_refused_and_reported() {
    let mut run = Run::of(&arm("feetech_sts", "STS3215", ""));
    let start = run.cycles(50).pop().unwrap();
    for (count, (angle, shown)) in
        [(f64::NAN, "NaN"), (f64::NEG_INFINITY, "-inf"), (90.0, "90"), (-1e9, "-1000000000")]
            .iter()
            .enumerate()
    {
        run.command(&[("pan", *angle)]);
        let state = run.cycles(100).pop().unwrap();
        assert!((position(&state, "pan") - position(&start, "pan")).abs() < 0.01, "{shown}: it moves");
        let expected = format!(
            "running, but a command was refused: joint_commands has {shown} rad for pan, whose limits are -1 to 1 rad; check unit \
             and sender"
        );
        assert_eq!(run.health_of("arm: bus"), (DiagnosticStatus::WARN, &*expected));
        assert_eq!(run.value_of("arm: bus", "commands refused"), (count + 1).to_string());
    }
    run.torque(&[("pan", f64::NAN)]);
    run.cycles(100);
    assert!(run.health_of("arm: bus").1.contains("joint_torque has NaN for pan; give a share from 0 to 1"));
    run.command(&[("pan", 0.5)]);
    let state = run.cycles(300).pop().unwrap();
    assert!((position(&state, "pan") - 0.5).abs() < 0.02, "and the next one is followed");
    assert_eq!(run.health_of("arm: bus"), (DiagnosticStatus::OK, "running"));
}

fn message(joints: &[(&str, f64)], set: impl Fn(&mut JointState, Vec<f64>)) -> JointState {
    let mut message = JointState {
        name: joints.iter().map(|(name, _)| (*name).to_owned()).collect(),
        ..Default::default()
    };
    set(&mut message, joints.iter().map(|(_, value)| *value).collect());
    message
}

fn position(state: &JointState, name: &str) -> f64 {
    state.position[state.name.iter().position(|known| known == name).unwrap()]
}

const KINDS: [(&str, &str, &str); 6] = [
    ("dynamixel1", "MX-28", ""),
    ("dynamixel1", "AX-12A", ""),
    ("dynamixel2", "XM430-W350", ""),
    ("dynamixel2", "XL330-M288", "fast_reads = true"),
    ("feetech_sts", "STS3215", ""),
    ("dynamixel2", "XM430-W350", "fast_reads = true"),
];

#[test]
fn servos_of_every_protocol_go_where_they_are_commanded_and_not_before() {
    for (protocol, model, rest) in KINDS {
        let mut run = Run::of(&arm(protocol, model, rest));
        let states = run.cycles(100);
        assert!(states.len() > 90, "{model}: {}", states.len());
        for name in ["pan", "lift", "elbow", "wrist"] {
            let (first, last) = (position(&states[0], name), position(&states[states.len() - 1], name));
            assert!((first - last).abs() < 0.01, "{model}: {name} moved from {first} to {last}");
        }
        run.command(&[("pan", 0.5), ("lift", -0.4), ("elbow", 0.7), ("wrist", 5.0), ("tail", 1.0)]);
        let states = run.cycles(300);
        let state = &states[states.len() - 1];
        for (name, wanted) in [("pan", 0.5), ("lift", -0.4), ("elbow", 0.7), ("wrist", 1.0)] {
            assert!(
                (position(state, name) - wanted).abs() < 0.02,
                "{model}: {name} is at {}",
                position(state, name)
            );
        }
        assert!(state.velocity.iter().chain(&state.effort).all(|value| value.is_finite()), "{model}");
        assert!(
            run.health.status.iter().all(|part| part.level == DiagnosticStatus::OK),
            "{model}: {:?}",
            run.health
        );
    }
}

#[test]
fn goals_and_positions_take_one_exchange_each() {
    for (protocol, model, rest) in KINDS {
        let mut run = Run::of(&arm(protocol, model, rest));
        run.cycles(50);
        run.exchanges.take();
        run.cycles(1);
        let each = if model == "AX-12A" { 5 } else { 2 };
        assert_eq!(run.exchanges.take().len(), each, "{model}");
    }
}

#[test]
fn a_first_command_is_approached_slowly() {
    let mut run = Run::of(&arm("dynamixel2", "XM430-W350", ""));
    run.cycles(50);
    run.command(&[("pan", 0.9)]);
    let fastest = run.cycles(60).iter().map(|state| state.velocity[0]).fold(0.0, f64::max);
    assert!((0.7..1.3).contains(&fastest), "{fastest} rad/s");
}

#[test]
fn torque_is_switched_for_one_joint_or_for_all() {
    let mut run = Run::of(&arm("feetech_sts", "STS3215", ""));
    run.cycles(50);
    run.command(&[("pan", 0.2)]);
    run.cycles(150);
    run.torque(&[("pan", 0.0), ("lift", f64::NAN)]);
    run.cycles(10);
    let is_goal = |exchange: &BusExchange| exchange.instruction.get(4..6) == Some(&[0x83, 42][..]);
    run.exchanges.take();
    run.cycles(1);
    let goals = run.exchanges.take().into_iter().find(is_goal).unwrap();
    assert_eq!(goals.instruction[7..].chunks(3).map(|entry| entry[0]).collect::<Vec<_>>()[..3], [2, 3, 4]);
    run.command(&[("pan", 0.9)]);
    let states = run.cycles(100);
    assert!((position(&states[99], "pan") - 0.2).abs() < 0.02, "without torque it has no goal");
    run.torque(&[("pan", 1.0)]);
    let states = run.cycles(150);
    assert!((position(&states[149], "pan") - 0.9).abs() < 0.02, "and with torque the last one");

    let caller = run
        .core
        .caller::<downbeat_msgs::std_srvs::srv::SetBoolRequest, downbeat_msgs::std_srvs::srv::SetBoolResponse>("torque")
        .unwrap();
    let (sender, receiver) = mpsc::channel();
    let request = downbeat_msgs::std_srvs::srv::SetBoolRequest { data: false };
    caller.call(request, Duration::from_secs(1), move |reply| drop(sender.send(reply))).unwrap();
    run.cycles(120);
    assert_eq!(receiver.try_recv().unwrap().unwrap().message, "the torque of 4 joints is switched off");
    run.exchanges.take();
    run.cycles(1);
    assert!(!run.exchanges.take().iter().any(is_goal));
    assert_eq!(run.health_of("servo 1 pan"), (DiagnosticStatus::OK, "OK, torque is off"));
}

#[test]
fn a_servo_of_another_model_is_refused() {
    let declared = arm("dynamixel2", "XM430-W350", "");
    let found = declared.replace("offset = 40", "model = \"XL330-M288\"");
    let mut run = Run::with(&declared, &found, &[]);
    let states = run.cycles(120);
    assert_eq!(
        run.health_of("servo 4 wrist"),
        (
            DiagnosticStatus::ERROR,
            "servo 4 (wrist) on p at 1000000 bit/s cannot be used: it is model 1200, not an XM430-W350 (1020); correct its \
             description, or exchange it"
        )
    );
    assert!(
        states[states.len() - 1].velocity[3].is_nan() && states[states.len() - 1].velocity[0].is_finite()
    );
    run.command(&[("pan", 0.5), ("lift", 0.5)]);
    let held = run.cycles(200);
    let first = position(&states[0], "pan");
    assert!(held.iter().all(|state| (position(state, "pan") - first).abs() < 0.01), "nothing moves");
    assert_eq!(
        run.health_of("arm: bus"),
        (
            DiagnosticStatus::ERROR,
            "nothing moves: description:26: servo 4 (wrist) is not the declared one, it is model 1200, not an XM430-W350 (1020); \
             correct its model or exchange it"
        )
    );
    assert_eq!(run.value_of("arm: bus", "commands refused"), "2");
}

#[test]
fn the_gains_and_limits_of_the_description_are_written() {
    let rest = "gains = { p = 600, d = 5 }\nmax_torque = 0.5\nmax_current_a = 1.0\n";
    let text = arm("dynamixel2", "XM430-W350", "")
        .replace("[[joint]]\nname = \"pan\"", &format!("{rest}[[joint]]\nname = \"pan\""));
    let mut run = Run::of(&text);
    run.cycles(30);
    let written: Vec<_> = run
        .exchanges
        .take()
        .into_iter()
        .filter(|e| e.instruction.get(4) == Some(&1) && e.instruction[7] == 3)
        .collect();
    let has = |address: u16, data: &[u8]| {
        let wanted = [&address.to_le_bytes()[..], data].concat();
        written.iter().any(|exchange| exchange.instruction[8..].starts_with(&wanted))
    };
    assert!(has(38, &372_u16.to_le_bytes()), "1 A in steps of 2.69 mA");
    assert!(has(80, &[5, 0]), "D");
    assert!(has(84, &600_u16.to_le_bytes()), "P");
    assert!(has(100, &443_u16.to_le_bytes()), "half of 885");
}

#[test]
fn a_board_switches_the_power_and_measures_the_battery() {
    let board = "[[device]]\nname = \"board\"\nid = 200\nmodel = \"OpenCR\"\nread = [\"button\"]\npower = { register = \"dynamixel_power\", wait_ms = 300 }\nbattery = { register = \"present_voltage\", low_v = 11.0 }\n";
    let mut run = Run::of(&(arm("dynamixel2", "XM430-W350", "") + board));
    let battery = Collector::<BatteryState>::add(&mut run.core, "battery_state");
    let values = Collector::<Float64MultiArray>::add(&mut run.core, "devices/board");
    let states = run.cycles(250);
    assert!((200..220).contains(&states.len()), "300 ms after power on: {}", states.len());
    assert_eq!(battery.take().iter().map(|state| state.voltage).collect::<Vec<_>>(), [12.0, 12.0, 12.0]);
    let value = values.take().pop().unwrap();
    let labels: Vec<_> = value.layout.dim.iter().map(|dim| &*dim.label).collect();
    assert_eq!(
        (labels, value.data),
        (vec!["button", "dynamixel_power", "present_voltage"], vec![0.0, 1.0, 12.0])
    );
    assert_eq!(run.health_of("board"), (DiagnosticStatus::OK, "OK"));
}

#[test]
fn an_imu_is_published_in_si_units_along_the_axes_of_the_robot() {
    let board = "[[device]]\nname = \"board\"\nid = 200\nmodel = \"OpenCR\"\nimu = { angular_velocity = [\"-gyro_x\", \"-gyro_y\", \"gyro_z\"], linear_acceleration = [\"-acc_x\", \"-acc_y\", \"acc_z\"], frame = \"body_link\" }\n";
    let description = Description::load(&(arm("dynamixel2", "XM430-W350", "") + board)).unwrap();
    let device = &description.bus("").unwrap().devices[0];
    let (first, length) = device.span();
    assert_eq!((first, length), (32, 12));
    // 1640 steps are 100 degrees/s, 16384 steps 1 g.
    let raw = [1640_i16, -1640, 0, 0, 16_384, -16_384].map(i16::to_le_bytes).concat();
    let (reading, frame) = ImuReading::of(device, Protocol::Dynamixel2, &raw).unwrap();
    let message = reading.message(header(Time::ZERO, frame));
    let near = |found: [f64; 3], expected: [f64; 3]| {
        assert!(found.iter().zip(expected).all(|(f, e)| (f - e).abs() < 1e-9), "{found:?} {expected:?}");
    };
    let (rate, force) = (message.angular_velocity, message.linear_acceleration);
    near([rate.x, rate.y, rate.z], [-100_f64.to_radians(), 100_f64.to_radians(), 0.0]);
    near([force.x, force.y, force.z], [0.0, -9.806_65, -9.806_65]);
    assert_eq!((&*message.header.frame_id, message.orientation_covariance[0]), ("body_link", -1.0));

    let mut run = Run::of(&(arm("dynamixel2", "XM430-W350", "") + board));
    let imu = Collector::<downbeat_msgs::sensor_msgs::msg::Imu>::add(&mut run.core, "imu/data_raw");
    let states = run.cycles(100);
    let felt = imu.take();
    assert_eq!(felt.len(), states.len(), "one in every cycle");
    assert!((felt[0].linear_acceleration.z - 9.81).abs() < 0.01, "{:?}", felt[0]);
}

#[test]
fn diagnostics_name_the_topics_of_the_joints() {
    // By these a page tells two arms apart whose joints have the same names.
    let (mut core, clock) = core_at_zero();
    let settings = [("description".to_owned(), SettingValue::Text(arm("feetech_sts", "STS3215", "")))].into();
    let remaps = [("joint_states".to_owned(), "leader/joint_states".to_owned())].into();
    let options = ModuleOptions { settings, remaps, ..ModuleOptions::default() };
    core.add_with("servos", ServoBus::serial(), options).unwrap();
    let diagnostics = Collector::<DiagnosticArray>::add(&mut core, "diagnostics");
    for _ in 0..3 {
        clock.advance(Duration::from_millis(10));
        core.cycle().unwrap();
    }
    let values = diagnostics.take().remove(0).status.remove(0).values;
    let value = |key: &str| values.iter().find(|value| value.key == key).map(|value| &*value.value);
    assert_eq!(value("joint_states"), Some("leader/joint_states"));
    assert_eq!(value("joint_commands"), Some("joint_commands"));
}

#[test]
fn a_late_cycle_is_counted_and_not_made_up_for() {
    let mut run = Run::of(&arm("feetech_sts", "STS3215", ""));
    run.cycles(50);
    run.clock.advance(run.cycle * 5);
    run.core.cycle().unwrap();
    let states = run.cycles(1);
    assert_eq!(states.len(), 2);
    run.cycles(5);
    assert_eq!(
        run.health_of("arm: bus"),
        (DiagnosticStatus::WARN, "running, but cycles of 10 ms begin late")
    );
    assert_eq!(run.value_of("arm: bus", "late cycles"), "1");
}

#[test]
fn a_missing_or_wrong_description_is_refused_with_the_reason() {
    let add = |description: &str| {
        let (mut core, _clock) = core_at_zero();
        let settings = [("description".to_owned(), SettingValue::Text(description.to_owned()))].into();
        let options = ModuleOptions { settings, ..ModuleOptions::default() };
        core.add_with("servos", ServoBus::serial(), options).map_err(|error| error.to_string())
    };
    let error = add(&arm("dynamixel2", "MX-82", "")).unwrap_err();
    assert!(error.contains("description:10: unknown model \"MX-82\", did you mean \"MX-28\"?"), "{error}");
    assert!(
        add("/no/such.toml").unwrap_err().contains("cannot read the description of the servos /no/such.toml")
    );
    assert!(add("").is_ok(), "it fails when it is activated, so that its settings can be listed");
}
