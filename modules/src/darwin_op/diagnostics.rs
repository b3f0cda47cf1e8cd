//! The robot's faults in the form of `diagnostics` (REP-107).

use super::driver::{Driver, Phase};
use super::module::header;
use super::protocol::StatusError;
use super::servo::{Service, Servo};
use super::settings::Settings;
use super::tables::joints::{COUNT, JOINTS, Joint};
use super::tables::units::volts_from_raw;
use downbeat_executor::Time;
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus, KeyValue};
use std::time::Duration;

/// Below this the battery needs charging: 3.5 V for each of its three LiPo cells.
const LOW_BATTERY_TENTHS: u16 = 105;
/// How long the bus is reported as bad after a missing or corrupt answer.
const BAD_BUS: Duration = Duration::from_secs(2);

/// The level of each part: bus, board, servos. Diagnostics are published when one of them changes.
pub(super) type Levels = [u8; COUNT + 2];

/// The current level of each part.
pub(super) fn levels(now: Time, driver: &Driver) -> Levels {
    std::array::from_fn(|part| match part {
        0 => bus_level(now, driver),
        1 => board_level(driver),
        _ => servo_level(driver, &driver.servos[part - 2]),
    })
}

/// The complete report.
pub(super) fn report(now: Time, driver: &Driver, unknown_names: u64, settings: &Settings) -> DiagnosticArray {
    let mut status = vec![bus(now, driver, unknown_names, settings), board(driver)];
    status.extend(driver.servos.iter().zip(&JOINTS).map(|(one, joint)| servo(driver, one, joint)));
    for one in &mut status {
        one.hardware_id.clone_from(&settings.hardware_id);
        one.name = format!("darwin_op: {}", one.name);
    }
    DiagnosticArray { header: header(now, ""), status }
}

fn bus_level(now: Time, driver: &Driver) -> u8 {
    match driver.phase {
        Phase::Running if is_lossy(now, driver) => DiagnosticStatus::WARN,
        Phase::Running => DiagnosticStatus::OK,
        Phase::PowerOn { .. } | Phase::Preparing { .. } => DiagnosticStatus::WARN,
        Phase::Closed { .. } | Phase::Open { .. } => DiagnosticStatus::ERROR,
    }
}

fn is_lossy(now: Time, driver: &Driver) -> bool {
    driver.last_timeout_at.is_some_and(|at| now < at + BAD_BUS)
}

fn is_late(now: Time, driver: &Driver) -> bool {
    driver.last_late_at.is_some_and(|at| now < at + BAD_BUS)
}

fn board_level(driver: &Driver) -> u8 {
    match (driver.phase, driver.board) {
        (Phase::Running, Some(board)) if board.voltage < LOW_BATTERY_TENTHS => DiagnosticStatus::WARN,
        (Phase::Running, Some(_)) => DiagnosticStatus::OK,
        _ => DiagnosticStatus::STALE,
    }
}

fn servo_level(driver: &Driver, servo: &Servo) -> u8 {
    match servo.service {
        Service::Silent { .. } | Service::Unsuitable { .. } => DiagnosticStatus::ERROR,
        Service::Unknown => DiagnosticStatus::STALE,
        Service::Active if driver.phase != Phase::Running => DiagnosticStatus::STALE,
        Service::Active if servo.alarms().is_none() => DiagnosticStatus::OK,
        Service::Active => DiagnosticStatus::WARN,
    }
}

fn bus(now: Time, driver: &Driver, unknown_names: u64, settings: &Settings) -> DiagnosticStatus {
    let message = match driver.phase {
        Phase::Running if is_lossy(now, driver) && is_late(now, driver) => {
            "running, but this machine is too busy: answers come after they were given up"
        }
        Phase::Running if is_lossy(now, driver) => "running, but answers are missing or corrupt",
        Phase::Running => "running",
        Phase::PowerOn { .. } => "switching the servos on",
        Phase::Preparing { .. } => "preparing the servos",
        Phase::Open { .. } => "the CM-730 does not answer",
        Phase::Closed { .. } => "the serial port is closed",
    };
    let troubles = &driver.troubles;
    let values = vec![
        value("port", &settings.port),
        value("exchanges", driver.exchanges),
        value("missing or corrupt answers", troubles.timeouts.count()),
        value("ports lost", troubles.lost_ports.count()),
        value("ports that could not be opened", troubles.refused_ports.count()),
        value("CM-730 silent", troubles.silent_board.count()),
        value("joint names unknown in commands", unknown_names),
    ];
    status(bus_level(now, driver), "bus", message, values)
}

fn board(driver: &Driver) -> DiagnosticStatus {
    let level = board_level(driver);
    let message = match level {
        DiagnosticStatus::OK => "OK",
        DiagnosticStatus::WARN => "the battery is low",
        _ => "no news",
    };
    let values = driver.board.map(|board| value("voltage (V)", volts_from_raw(board.voltage)));
    status(level, "CM-730", message, values.into_iter().collect())
}

fn servo(driver: &Driver, servo: &Servo, joint: &Joint) -> DiagnosticStatus {
    let message = match (&servo.service, servo.alarms()) {
        (Service::Active, _) if driver.phase != Phase::Running => "waits for the bus".to_owned(),
        (Service::Active, StatusError::NONE) => "OK".to_owned(),
        (Service::Active, alarms) => format!("the servo reports: {alarms}"),
        (Service::Silent { .. }, _) => "no answer; its joint is stale".to_owned(),
        (Service::Unsuitable { reason, .. }, _) => reason.clone(),
        (Service::Unknown, _) => "not asked yet".to_owned(),
    };
    let mut values =
        vec![value("answers missed", servo.missed), value("times out of service", servo.outages.count())];
    if let Some(last) = servo.last {
        values.push(value("temperature (degrees Celsius)", last.celsius));
        values.push(value("voltage (V)", volts_from_raw(last.voltage)));
    }
    let name = format!("servo {} {}", joint.id, joint.name);
    status(servo_level(driver, servo), &name, &message, values)
}

fn status(level: u8, name: &str, message: &str, values: Vec<KeyValue>) -> DiagnosticStatus {
    let (name, message) = (name.to_owned(), message.to_owned());
    DiagnosticStatus { level, name, message, hardware_id: String::new(), values }
}

fn value(key: &str, value: impl std::fmt::Display) -> KeyValue {
    KeyValue { key: key.to_owned(), value: value.to_string() }
}
