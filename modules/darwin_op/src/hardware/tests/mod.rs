//! The module with the emulated robot, and with a recording of it.
#![allow(clippy::unwrap_used)]

mod cycle;
mod faults;
mod replay;

use crate::emulator::{self, Emulator, EmulatorOptions, FaultKind, Timing};
use crate::hardware::bus::SerialBus;
use crate::hardware::tables::joints::{JOINTS, index_of};
use crate::hardware::{CYCLE, DarwinOp};
use crate::testing::{Collector, core_at_zero};
use downbeat_executor::{Core, Inlet, ManualClock, ModuleOptions, SettingValue};
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::sensor_msgs::msg::{BatteryState, Imu, JointState, Joy};
use std::time::{Duration, Instant};

/// A hardware module in a core with a manual clock, and everything it publishes.
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

    /// Uses the emulated robot, whose answers take no time.
    fn on(emulator: &Emulator) -> Self {
        Self::on_with(emulator, &[])
    }

    fn on_with(emulator: &Emulator, settings: &[(&str, SettingValue)]) -> Self {
        Self::new(DarwinOp::new(Box::new(emulator.bus())), settings)
    }

    /// Uses the emulated robot through its port. On a busy machine, delayed answers count as lost.
    fn on_port_of(emulator: &Emulator) -> Self {
        let port = emulator.port_path().to_string_lossy().into_owned();
        let bus = SerialBus::with_slack(Duration::from_millis(100));
        Self::new(DarwinOp::new(Box::new(bus)), &[("port", port.into())])
    }

    /// Runs some cycles; returns the messages on `joint_states`.
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

    /// Runs until the condition holds.
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

    /// The level and the message of the part whose name ends with `part`.
    fn health_of(&self, part: &str) -> (u8, String) {
        let status = self.health.status.iter().find(|status| status.name.ends_with(part));
        status.map(|status| (status.level, status.message.clone())).unwrap_or_default()
    }

    fn is_healthy(&self) -> bool {
        self.health.status.len() == 22 && self.health.status.iter().all(|s| s.level == DiagnosticStatus::OK)
    }
}

fn emulator() -> Emulator {
    emulator::start(EmulatorOptions { timing: Timing::Immediate, seed: 3, ..Default::default() }).unwrap()
}

fn servo(name: &str) -> FaultKind {
    FaultKind::DeadServo(JOINTS[index_of(name).unwrap()].id)
}

fn position(state: &JointState, name: &str) -> f64 {
    state.position[index_of(name).unwrap()]
}
