//! The hardware module.

use super::bus::{Bus, Exchange, SerialBus};
use super::counted::Counted;
use super::diagnostics::{Levels, levels, report};
use super::driver::Driver;
use super::messages::{battery_state, buttons, imu, joint_state};
use super::reading::Reading;
use super::settings::{SettingKeys, Settings};
use super::tables::joints::{JOINTS, index_of};
use downbeat_executor::{Context, Module, Publication, Received, Setup, SetupError, Time, TransitionError};
use downbeat_msgs::diagnostic_msgs::msg::DiagnosticArray;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::sensor_msgs::msg::{BatteryState, Imu, JointState, Joy};
use std::time::Duration;

/// The cycle of the hardware.
pub const CYCLE: Duration = Duration::from_millis(8);
/// The period of slowly changing data.
const SLOW: Duration = Duration::from_secs(1);

/// The hardware of a Darwin OP as a module: goals out, joints, IMU, battery and buttons in, every 8 ms.
///
/// It waits for the bus, so run it detached.
///
/// | topic | type | |
/// | --- | --- | --- |
/// | `joint_commands` (in) | `sensor_msgs/JointState` | positions by name, rad; unknown names and NaN are ignored, other values are clamped to the limits |
/// | `joint_states` | `sensor_msgs/JointState` | 20 joints in the order of the ids: rad, rad/s, load as a fraction of the drive; stale joints have velocity and effort NaN |
/// | `imu/data_raw` | `sensor_msgs/Imu` | forward, left, up: rad/s, m/s^2 |
/// | `battery_state` | `sensor_msgs/BatteryState` | V, once a second |
/// | `buttons` | `sensor_msgs/Joy` | mode, start; once a second and when they change |
/// | `diagnostics` | `diagnostic_msgs/DiagnosticArray` | once a second and when a level changes |
/// | `bus/exchanges` | `downbeat_interfaces/BusExchange` | all traffic on the bus |
///
/// A joint does not move before it is commanded. It then approaches the command slowly (about 2 rad/s), as
/// after each time it was out of service. On shutdown the servos keep their torque.
pub struct DarwinOp {
    bus: Box<dyn Bus>,
    driver: Driver,
    /// `None` before the first activation.
    settings: Option<Settings>,
    exchanges: Vec<Exchange>,
    unknown_names: Counted,
    last: LastPublished,
}

/// The keys of [`DarwinOp`].
pub struct Ports {
    settings: SettingKeys,
    joint_states: Publication<JointState>,
    imu: Publication<Imu>,
    battery_state: Publication<BatteryState>,
    buttons: Publication<Joy>,
    diagnostics: Publication<DiagnosticArray>,
    exchanges: Publication<BusExchange>,
}

/// When topics that are not published in every cycle were last published.
#[derive(Default)]
struct LastPublished {
    battery_at: Option<Time>,
    buttons: Option<(Time, u16)>,
    diagnostics: Option<(Time, Levels)>,
}

impl DarwinOp {
    /// The robot on the serial port in the setting `port`.
    #[must_use]
    pub fn serial() -> Self {
        Self::new(Box::new(SerialBus::new()))
    }

    /// The robot on any bus, such as a recorded one.
    #[must_use]
    pub fn new(bus: Box<dyn Bus>) -> Self {
        Self {
            bus,
            driver: Driver::new(),
            settings: None,
            exchanges: Vec::new(),
            unknown_names: Counted::default(),
            last: LastPublished::default(),
        }
    }

    fn read_settings(&mut self, ctx: &mut Context<'_, Ports>) {
        match ctx.ports.settings.values(ctx) {
            Ok(settings) => self.settings = Some(settings),
            Err(refusal) => tracing::warn!("{refusal}; the settings are unchanged"),
        }
    }

    fn on_command(&mut self, command: Received<'_, JointState>, _ctx: &mut Context<'_, Ports>) {
        let Some(settings) = &self.settings else { return };
        for (name, position) in command.name.iter().zip(&command.position) {
            let Some(index) = index_of(name) else {
                if self.unknown_names.is_worth_a_line() {
                    let count = self.unknown_names.count();
                    tracing::warn!(
                        "joint_commands contains \"{name}\", which is not a joint ({count} times so far)"
                    );
                }
                continue;
            };
            if let Some(ticks) = JOINTS[index].goal_ticks(*position, settings.offset_ticks[index]) {
                self.driver.servos[index].want(ticks);
            }
        }
    }

    fn tick(&mut self, ctx: &mut Context<'_, Ports>) {
        let Some(settings) = &self.settings else { return };
        let now = ctx.now();
        let reading = self.driver.step(now, settings, &mut *self.bus, &mut self.exchanges);
        for exchange in self.exchanges.drain(..) {
            ctx.publish(ctx.ports.exchanges, BusExchange::from(&exchange));
        }
        if let Some(reading) = &reading {
            publish(reading, &self.driver, settings, &mut self.last, ctx);
        }
        let levels = levels(now, &self.driver);
        let is_news = self.last.diagnostics.is_none_or(|(at, last)| at + SLOW <= now || last != levels);
        if is_news {
            self.last.diagnostics = Some((now, levels));
            ctx.publish(
                ctx.ports.diagnostics,
                report(now, &self.driver, self.unknown_names.count(), settings),
            );
        }
    }
}

impl Module for DarwinOp {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let settings = SettingKeys::declare(setup)?;
        settings.on_change(setup, Self::read_settings);
        let ports = Ports {
            settings,
            joint_states: setup.publish("joint_states")?,
            imu: setup.publish("imu/data_raw")?,
            battery_state: setup.publish("battery_state")?,
            buttons: setup.publish("buttons")?,
            diagnostics: setup.publish("diagnostics")?,
            exchanges: setup.publish("bus/exchanges")?,
        };
        setup.subscribe("joint_commands", Self::on_command)?;
        setup.every(CYCLE, Self::tick)?;
        Ok(ports)
    }

    fn activate(&mut self, ctx: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        self.read_settings(ctx);
        Ok(())
    }

    fn shutdown(&mut self, ctx: &mut Context<'_, Ports>) {
        self.driver.stop(ctx.now(), &mut *self.bus, &mut self.exchanges);
        for exchange in self.exchanges.drain(..) {
            ctx.publish(ctx.ports.exchanges, BusExchange::from(&exchange));
        }
    }
}

fn publish(
    reading: &Reading,
    driver: &Driver,
    settings: &Settings,
    last: &mut LastPublished,
    ctx: &mut Context<'_, Ports>,
) {
    let (now, sent) = (ctx.now(), reading.sent);
    if reading.servos.iter().any(Option::is_some) {
        ctx.publish(ctx.ports.joint_states, joint_state(reading, &driver.servos, settings));
    }
    let Some(board) = &reading.board else { return };
    ctx.publish(ctx.ports.imu, imu(sent, board, settings));
    if last.buttons.is_none_or(|(at, pressed)| at + SLOW <= now || pressed != board.buttons) {
        last.buttons = Some((now, board.buttons));
        ctx.publish(ctx.ports.buttons, buttons(sent, board));
    }
    if last.battery_at.is_none_or(|at| at + SLOW <= now) {
        last.battery_at = Some(now);
        ctx.publish(ctx.ports.battery_state, battery_state(sent, board));
    }
}
