//! The robot's faults in the form of `diagnostics` (REP-107).

use super::description::{BusPlan, DevicePlan};
use super::driver::{DeviceUnit, Driver, Phase};
use super::fault_text::{alarm, closed_port, place, silent, unusable};
use super::joint::{Joint, Protection};
use super::line::ECHO;
use super::protocol::StatusError;
use super::reading::Unit;
use super::servo::{Link, Service, Servo, reading};
use crate::stamps::header;
use downbeat_device::counted::Counted;
use downbeat_executor::Time;
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus, KeyValue};
use std::time::Duration;

/// How long the bus is reported as bad after a missing or corrupt answer, or a late cycle.
const BAD_BUS: Duration = Duration::from_secs(2);

/// The level of each part: bus, devices, servos. Diagnostics are published when one of them changes.
pub(crate) type Levels = Vec<u8>;

/// What diagnostics say besides the state of the driver.
pub(crate) struct Labels<'a> {
    /// The robot, for example "darwin_op (emulated)".
    pub(crate) hardware_id: &'a str,
    /// How often a command named an unknown joint.
    pub(crate) unknown_names: u64,
    /// Commands that were refused.
    pub(crate) refused: &'a Refused,
    /// The topics of its joints: what they are for, and their names.
    pub(crate) joint_topics: &'a [(&'static str, String)],
    /// Whether late cycles are reported.
    pub(crate) is_detailed: bool,
}

/// The current level of each part.
pub(crate) fn levels(now: Time, plan: &BusPlan, driver: &Driver, labels: &Labels<'_>) -> Levels {
    let devices = driver
        .devices
        .iter()
        .zip(&plan.devices)
        .map(|(unit, device)| device_level(plan, driver, unit, device));
    let servos =
        driver.servos.iter().zip(&plan.joints).map(|(servo, joint)| servo_level(driver, servo, joint));
    std::iter::once(bus_level(now, driver, labels)).chain(devices).chain(servos).collect()
}

/// The complete report.
pub(crate) fn report(now: Time, plan: &BusPlan, driver: &Driver, labels: &Labels<'_>) -> DiagnosticArray {
    let mut status = vec![bus(now, plan, driver, labels)];
    status.extend((0..plan.devices.len()).map(|index| device(plan, driver, index, labels)));
    status.extend((0..plan.joints.len()).map(|index| servo(plan, driver, index, labels)));
    for one in &mut status {
        labels.hardware_id.clone_into(&mut one.hardware_id);
        one.name = format!("{}: {}", plan.title, one.name);
    }
    DiagnosticArray { header: header(now, ""), status }
}

/// Counts refused commands.
#[derive(Default)]
pub(crate) struct Refused {
    pub(crate) count: Counted,
    /// How many messages were dropped for their stamps.
    pub(crate) stale: u64,
    /// The last one: when, and why.
    pub(crate) last: Option<(Time, String)>,
}

impl Refused {
    fn recently(&self, now: Time) -> Option<&str> {
        self.last.as_ref().filter(|(at, _)| is_recent(now, Some(*at))).map(|(_, reason)| &**reason)
    }
}

fn bus_level(now: Time, driver: &Driver, labels: &Labels<'_>) -> u8 {
    match driver.phase {
        Phase::Running if driver.is_held() => DiagnosticStatus::ERROR,
        _ if is_recent(now, driver.last_echo_at) => DiagnosticStatus::ERROR,
        Phase::Running if is_lossy(now, driver) || (labels.is_detailed && is_slow(now, driver)) => {
            DiagnosticStatus::WARN
        }
        Phase::Running if labels.refused.recently(now).is_some() => DiagnosticStatus::WARN,
        Phase::Running => DiagnosticStatus::OK,
        Phase::PowerOn { .. } | Phase::Preparing { .. } => DiagnosticStatus::WARN,
        Phase::Closed { .. } | Phase::Open { .. } => DiagnosticStatus::ERROR,
    }
}

fn is_recent(now: Time, at: Option<Time>) -> bool {
    at.is_some_and(|at| now < at + BAD_BUS)
}

fn is_lossy(now: Time, driver: &Driver) -> bool {
    is_recent(now, driver.last_timeout_at)
}

fn is_slow(now: Time, driver: &Driver) -> bool {
    is_recent(now, driver.last_late_cycle_at)
}

/// The battery's voltage, and whether it is low.
fn battery(plan: &BusPlan, unit: &DeviceUnit, device: &DevicePlan) -> Option<(f64, bool)> {
    let (register, low) = device.battery.as_ref()?;
    let volts = device.value(plan.line.protocol, register, unit.last.as_ref()?)?;
    Some((volts, volts < *low))
}

fn device_level(plan: &BusPlan, driver: &Driver, unit: &DeviceUnit, device: &DevicePlan) -> u8 {
    let is_board = device.power.is_some();
    match (driver.phase, &unit.last) {
        _ if !is_board && unit.link.retry_at().is_some() => DiagnosticStatus::ERROR,
        (Phase::Running, Some(_)) => match battery(plan, unit, device) {
            Some((_, true)) => DiagnosticStatus::WARN,
            _ => DiagnosticStatus::OK,
        },
        _ => DiagnosticStatus::STALE,
    }
}

fn servo_level(driver: &Driver, servo: &Servo, joint: &Joint) -> u8 {
    match servo.link.service {
        Service::Silent { .. } | Service::Unsuitable { .. } => DiagnosticStatus::ERROR,
        Service::Unknown => DiagnosticStatus::STALE,
        Service::Active if servo.wants_torque() && servo.limp(joint).is_some() => DiagnosticStatus::ERROR,
        Service::Active if driver.phase != Phase::Running => DiagnosticStatus::STALE,
        Service::Active if servo.protection == Protection::Off => DiagnosticStatus::ERROR,
        Service::Active
            if servo.link.error.is_none() && servo.protection == Protection::None && !servo.rests() =>
        {
            DiagnosticStatus::OK
        }
        Service::Active => DiagnosticStatus::WARN,
    }
}

fn bus(now: Time, plan: &BusPlan, driver: &Driver, labels: &Labels<'_>) -> DiagnosticStatus {
    let board = plan.devices.first().filter(|device| device.power.is_some());
    let message = match driver.phase {
        Phase::Running if driver.is_held() => driver.misfit(plan).unwrap_or_default(),
        _ if is_recent(now, driver.last_echo_at) => ECHO.to_owned(),
        Phase::Running if is_lossy(now, driver) && is_recent(now, driver.last_late_at) => {
            "running, but this machine is too busy: answers come after they were given up".to_owned()
        }
        Phase::Running if is_lossy(now, driver) => {
            let short = "running, but answers are missing or corrupt";
            let place = place(plan);
            match labels.is_detailed {
                true => format!(
                    "{short} on {place}: the servos below that have missed answers show where; check plugs and cables there"
                ),
                false => short.to_owned(),
            }
        }
        Phase::Running if labels.is_detailed && is_slow(now, driver) => {
            format!("running, but cycles of {} ms begin late", plan.cycle.as_secs_f64() * 1000.0)
        }
        Phase::Running => match labels.refused.recently(now) {
            Some(reason) => format!("running, but a command was refused: {reason}"),
            None => "running".to_owned(),
        },
        Phase::PowerOn { .. } => "switching the servos on".to_owned(),
        Phase::Preparing { .. } => "preparing the servos".to_owned(),
        Phase::Open { .. } => format!("the {} does not answer", board.map_or("", |board| &board.name)),
        Phase::Closed { .. } if labels.is_detailed => closed_port(plan),
        Phase::Closed { .. } => "the serial port is closed".to_owned(),
    };
    let troubles = &driver.troubles;
    let mut values = vec![
        value("port", &plan.port),
        value("exchanges", driver.exchanges),
        value("missing or corrupt answers", troubles.timeouts.count()),
        value("ports lost", troubles.lost_ports.count()),
        value("ports that could not be opened", troubles.refused_ports.count()),
    ];
    values.extend(board.map(|board| value(&format!("{} silent", board.name), troubles.silent_board.count())));
    values.push(value("joint names unknown in commands", labels.unknown_names));
    values.extend(labels.joint_topics.iter().map(|(what, topic)| value(what, topic)));
    if labels.refused.last.is_some() {
        values.push(value("commands refused", labels.refused.count.count()));
    }
    if labels.refused.stale > 0 {
        values.push(value("commands dropped for their stamps", labels.refused.stale));
    }
    if labels.is_detailed {
        values.push(value("late cycles", troubles.late_cycles.count()));
    }
    let name = if plan.name.is_empty() { "bus".to_owned() } else { format!("bus {}", plan.name) };
    status(bus_level(now, driver, labels), &name, &message, values)
}

fn device(plan: &BusPlan, driver: &Driver, index: usize, labels: &Labels<'_>) -> DiagnosticStatus {
    let (unit, device) = (&driver.devices[index], &plan.devices[index]);
    let level = device_level(plan, driver, unit, device);
    let message = match level {
        DiagnosticStatus::OK => "OK".to_owned(),
        DiagnosticStatus::WARN => "the battery is low".to_owned(),
        DiagnosticStatus::ERROR => out_of_service(plan, Unit::Device(index), &unit.link, labels),
        _ => "no news".to_owned(),
    };
    let voltage = battery(plan, unit, device).map(|(volts, _)| value("voltage (V)", volts));
    status(level, &device.name, &message, voltage.into_iter().collect())
}

/// Why a unit is out of service: with its place and the remedy, if labels are detailed.
fn out_of_service(plan: &BusPlan, unit: Unit, link: &Link, labels: &Labels<'_>) -> String {
    match (&link.service, unit) {
        (Service::Unsuitable { reason, .. }, _) if labels.is_detailed => unusable(plan, unit, reason),
        (Service::Unsuitable { reason, .. }, _) => reason.clone(),
        _ if labels.is_detailed => silent(plan, unit),
        (_, Unit::Joint(_)) => "no answer; its joint is stale".to_owned(),
        (_, Unit::Device(_)) => "no answer".to_owned(),
    }
}

fn servo(plan: &BusPlan, driver: &Driver, index: usize, labels: &Labels<'_>) -> DiagnosticStatus {
    let (servo, joint) = (&driver.servos[index], &plan.joints[index]);
    let message = match (&servo.link.service, servo.link.error) {
        (Service::Active, _) if let (true, Some(limp)) = (servo.wants_torque(), servo.limp(joint)) => {
            limp.words(joint)
        }
        (Service::Active, _) if driver.phase != Phase::Running => "waits for the bus".to_owned(),
        (Service::Active, _) if servo.protection > Protection::None => {
            let measured = servo.last.as_ref().map(reading).unwrap_or_default();
            match servo.protection {
                Protection::Off => {
                    format!(
                        "its guard has switched the torque off ({measured}); enable it again when that is better"
                    )
                }
                Protection::Soften => format!("its guard has halved the torque: {measured}"),
                _ => format!("close to its limits: {measured}"),
            }
        }
        (Service::Active, _) if !servo.wants_torque() => "OK, torque is off".to_owned(),
        (Service::Active, StatusError::NONE) if servo.rests() => {
            "after overload or heat it has probably switched its torque off; command its torque again"
                .to_owned()
        }
        (Service::Active, StatusError::NONE) => "OK".to_owned(),
        (Service::Active, alarms) if labels.is_detailed => {
            let measured = servo.last.as_ref().map(reading).unwrap_or_default();
            alarm(plan, Unit::Joint(index), alarms, &measured)
        }
        (Service::Active, alarms) => format!("the servo reports: {alarms}"),
        (Service::Silent { .. } | Service::Unsuitable { .. }, _) => {
            out_of_service(plan, Unit::Joint(index), &servo.link, labels)
        }
        (Service::Unknown, _) => "not asked yet".to_owned(),
    };
    let mut values = vec![
        value("answers missed", servo.link.missed),
        value("times out of service", servo.link.outages.count()),
    ];
    if let Some(last) = servo.last {
        values.extend(last.celsius.map(|celsius| value("temperature (degrees Celsius)", celsius)));
        values.extend(last.voltage.map(|voltage| value("voltage (V)", voltage)));
    }
    let name = format!("servo {} {}", joint.id, joint.name);
    status(servo_level(driver, servo, joint), &name, &message, values)
}

fn status(level: u8, name: &str, message: &str, values: Vec<KeyValue>) -> DiagnosticStatus {
    let (name, message) = (name.to_owned(), message.to_owned());
    DiagnosticStatus { level, name, message, hardware_id: String::new(), values }
}

fn value(key: &str, value: impl std::fmt::Display) -> KeyValue {
    KeyValue { key: key.to_owned(), value: value.to_string() }
}
