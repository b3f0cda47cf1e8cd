//! GPS receivers from the bytes of an emulated one to positions: in memory, on a pseudo terminal, with
//! faults, and from a recording.
#![allow(clippy::unwrap_used)]

mod common;

use std::time::{Duration, Instant};

use common::{Run, settings, text};
use downbeat_device::DeviceLink;
use downbeat_executor::Probe;
use downbeat_msgs::diagnostic_msgs::msg::DiagnosticStatus;
use downbeat_msgs::geometry_msgs::msg::TwistStamped;
use downbeat_msgs::sensor_msgs::msg::{NavSatFix, NavSatStatus, TimeReference};
use downbeat_sensors::gps::{Gps, GpsEmulator, emulated};
use downbeat_sensors::serial::{EmulatedPorts, Emulator, SerialDevice};

fn run<M: downbeat_msgs::Message>(topic: &str, faults: &[&str], seconds: u64) -> Run<M> {
    let ports = EmulatedPorts::default();
    let gps = Gps::new(DeviceLink::new(SerialDevice::new(ports.clone())));
    let faults: Vec<String> = faults.iter().map(|&fault| fault.to_owned()).collect();
    let of_emulator = settings(&[("faults", faults.into())]);
    let emulator = (GpsEmulator::new(ports), of_emulator);
    let topics = ["gps/exchanges", topic];
    Run::emulated(
        emulator,
        (gps, settings(&[("port", text("memory:gps"))])),
        topics,
        Duration::from_secs(seconds),
    )
}

#[test]
fn positions_come_once_a_second_as_soon_as_there_is_a_fix() {
    let run = run::<NavSatFix>("fix", &[], 10);
    assert_eq!(run.messages.len(), 10);
    assert_eq!(run.messages[0].status.status, NavSatStatus::STATUS_NO_FIX);
    assert!(run.messages[0].latitude.is_nan());
    for fix in &run.messages[2..] {
        assert_eq!((fix.status.status, fix.header.frame_id.as_str()), (NavSatStatus::STATUS_FIX, "gps"));
        assert!((fix.latitude - 48.1173).abs() < 2e-4 && (fix.longitude - 11.516_67).abs() < 2e-4, "{fix:?}");
        assert!((fix.altitude - 566.9).abs() < 5.0);
    }
    let last = run.messages.last().unwrap();
    assert_eq!(last.position_covariance_type, NavSatFix::COVARIANCE_TYPE_DIAGONAL_KNOWN);
    assert!(
        (last.position_covariance[0] - 0.25).abs() < 1e-9 && (last.position_covariance[8] - 1.0).abs() < 1e-9
    );
    assert_eq!(
        (run.last_status().level, &*run.last_status().message),
        (DiagnosticStatus::OK, "fix from 9 satellites")
    );
    let steps =
        run.messages.windows(2).map(|pair| pair[1].header.stamp.as_nanos() - pair[0].header.stamp.as_nanos());
    // With a fix sentences are longer.
    assert!(steps.skip(2).all(|step| (step - 1_000_000_000).abs() < 30_000_000));
}

#[test]
fn the_velocity_and_the_time_come_too() {
    let velocities = run::<TwistStamped>("vel", &[], 10).messages;
    assert_eq!(velocities.len(), 8);
    for velocity in &velocities {
        assert!((libm::hypot(velocity.twist.linear.x, velocity.twist.linear.y) - 1.0).abs() < 0.01);
    }
    let times = run::<TimeReference>("time_reference", &[], 10).messages;
    // 2026-01-01T00:00:02Z.
    assert_eq!((times[0].time_ref.sec, times[0].source.as_str()), (1_767_225_602, "gps"));
}

#[test]
fn a_recording_replays_bit_for_bit() {
    let recorded = run::<NavSatFix>("fix", &["drop:0.05", "flip:0.001", "close-port@5s..7s"], 15);
    let gps = Gps::new(DeviceLink::recorded(recorded.exchanges.clone()));
    let options = settings(&[("port", text("/dev/null"))]);
    let replayed =
        Run::<NavSatFix>::replayed((gps, options), ["gps/exchanges", "fix"], Duration::from_secs(15));
    assert_eq!(replayed.bytes(), recorded.bytes());
    assert_eq!(replayed.exchanges, recorded.exchanges);
    assert!(recorded.messages.len() > 5, "{}", recorded.messages.len());
}

#[test]
fn a_receiver_whose_cable_was_out_is_read_again_and_damage_is_counted() {
    let run = run::<NavSatFix>("fix", &["flip:0.002", "close-port@5s..7s"], 20);
    assert!(run.statuses.iter().any(|status| status.message.contains("was closed")));
    assert_ne!(run.value("corrupt sentences"), "0");
    assert_eq!(run.value("ports lost"), "1");
    let valid = run.messages.iter().filter(|fix| fix.status.status == NavSatStatus::STATUS_FIX);
    assert!(valid.clone().count() > 8);
    assert!(
        valid.clone().all(|fix| (fix.latitude - 48.1173).abs() < 2e-4),
        "the checksum keeps wrong positions out"
    );
}

#[test]
fn a_receiver_that_is_no_receiver_is_reported_with_what_to_check() {
    let ports = EmulatedPorts::default();
    let lidar = downbeat_sensors::lidar::LidarEmulator::new(ports.clone());
    let gps = Gps::new(DeviceLink::new(SerialDevice::new(ports)));
    let options = settings(&[("port", text("memory:lidar"))]);
    let topics = ["gps/exchanges", "fix"];
    let run =
        Run::<NavSatFix>::emulated((lidar, settings(&[])), (gps, options), topics, Duration::from_secs(5));
    assert_eq!(run.last_status().message, "bytes come, but no sentence of NMEA: is \"baud\" = 9600 right?");
}

#[test]
fn a_receiver_on_a_pseudo_terminal_is_read_in_real_time() {
    let started = Instant::now();
    let emulator = Emulator::start(emulated(1), None, Vec::new(), 1).unwrap();
    let gps = Gps::new(DeviceLink::new(SerialDevice::new(EmulatedPorts::default())));
    let mut probe = Probe::new();
    probe.add_with("gps", gps, settings(&[("port", text(emulator.port().to_str().unwrap()))])).unwrap();
    let fixes = probe.listen::<NavSatFix>("fix").unwrap();
    while fixes.take().is_empty() {
        assert!(started.elapsed() < Duration::from_secs(120));
        probe.advance(Duration::from_millis(10)).unwrap();
    }
}

#[test]
fn settings_that_make_no_sense_are_refused_with_the_reason() {
    let refused = |name: &str, value: downbeat_executor::SettingValue| {
        let gps = Gps::new(DeviceLink::recorded([]));
        Probe::new().add_with("gps", gps, settings(&[(name, value)])).unwrap_err().to_string()
    };
    assert!(refused("baud", 0_i64.into()).contains("a speed in bit/s, such as 9600"));
    assert!(refused("epe_quality1", (-1.0).into()).contains("a distance in m, 0 or more"));
}
