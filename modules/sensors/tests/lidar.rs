//! Lidars from the bytes of emulated devices to scans: in memory, on a pseudo terminal, with faults, and from
//! a recording.
#![allow(clippy::unwrap_used)]

mod common;

use std::time::{Duration, Instant};

use common::{Run, settings, text};
use downbeat_device::DeviceLink;
use downbeat_executor::{Probe, SettingValue};
use downbeat_msgs::diagnostic_msgs::msg::DiagnosticStatus;
use downbeat_msgs::sensor_msgs::msg::LaserScan;
use downbeat_sensors::lidar::{Lidar, LidarEmulator, Model, emulated};
use downbeat_sensors::serial::{EmulatedPorts, Emulator, SerialDevice};

/// Runs an emulated lidar in memory.
fn run(model: &str, faults: &[&str], duration: Duration) -> Run<LaserScan> {
    let ports = EmulatedPorts::default();
    let lidar = Lidar::new(DeviceLink::new(SerialDevice::new(ports.clone())));
    let emulator = LidarEmulator::new(ports);
    let of_lidar = settings(&[("model", text(model)), ("port", text("memory:lidar"))]);
    let faults: Vec<String> = faults.iter().map(|&fault| fault.to_owned()).collect();
    let of_emulator = settings(&[("model", text(model)), ("faults", faults.into())]);
    Run::emulated((emulator, of_emulator), (lidar, of_lidar), ["lidar/exchanges", "scan"], duration)
}

#[test]
fn scans_show_the_room_counter_clockwise() {
    for (model, beams, period) in [("ld06", 450, 0.1), ("ld19", 450, 0.1), ("rplidar_a1", 360, 0.182)] {
        let run = run(model, &[], Duration::from_secs(3));
        let scan = &run.messages[2];
        assert_eq!((scan.header.frame_id.as_str(), scan.ranges.len()), ("laser", beams), "{model}");
        let at = |degrees: f32| {
            let index = (degrees.to_radians() - scan.angle_min) / scan.angle_increment;
            scan.ranges[index.round() as usize]
        };
        for (degrees, wall) in
            [(0.0, 3.0), (90.0, 1.5), (-90.0, 1.5), (176.0, 1.0), (-176.0, 1.0), (28.0, 1.5)]
        {
            // A beam without echo is infinite: its neighbour has one.
            let nearest =
                [-2.0, 0.0, 2.0].map(|aside| at(degrees + aside)).into_iter().fold(f32::INFINITY, f32::min);
            assert!((nearest - wall).abs() < 0.1, "{model} at {degrees}°: {nearest}");
        }
        assert!((scan.scan_time - period).abs() < 0.002, "{model}: {}", scan.scan_time);
        let increment = -scan.scan_time / beams as f32;
        assert!((scan.time_increment - increment).abs() < 1e-9);
        assert!(scan.ranges.iter().all(|range| !range.is_nan()), "{model}: {:?}", scan.ranges);
        let stamps: Vec<_> = run.messages.iter().map(|scan| scan.header.stamp.as_nanos()).collect();
        for pair in stamps.windows(2) {
            let step = (pair[1] - pair[0]) as f32 * 1e-9;
            assert!((step - period).abs() < 0.01, "{model}: {step} s from scan to scan");
        }
        assert_eq!(run.last_status().level, DiagnosticStatus::OK, "{model}: {}", run.last_status().message);
    }
}

#[test]
fn a_recording_replays_bit_for_bit() {
    for model in ["ld19", "rplidar_a1"] {
        let faults = ["drop:0.02", "flip:0.0005", "close-port@1s..1500ms"];
        let recorded = run(model, &faults, Duration::from_secs(4));
        let lidar = Lidar::new(DeviceLink::recorded(recorded.exchanges.clone()));
        // The port is not opened in a replay, whatever it is.
        let of_lidar = settings(&[("model", text(model)), ("port", text("/dev/null"))]);
        let replayed = Run::<LaserScan>::replayed(
            (lidar, of_lidar),
            ["lidar/exchanges", "scan"],
            Duration::from_secs(4),
        );
        assert_eq!(replayed.bytes(), recorded.bytes(), "{model}");
        assert_eq!(replayed.exchanges, recorded.exchanges, "{model}");
        assert!(recorded.messages.len() > 10, "{model}: {}", recorded.messages.len());
    }
}

#[test]
fn a_lidar_whose_cable_was_out_scans_again() {
    for model in ["ld19", "rplidar_a1"] {
        let run = run(model, &["close-port@1s..2s"], Duration::from_secs(5));
        let out = run.statuses.iter().find(|status| status.message.contains("was closed"));
        assert_eq!(out.unwrap().level, DiagnosticStatus::ERROR);
        assert_eq!(run.last_status().level, DiagnosticStatus::OK, "{model}: {}", run.last_status().message);
        assert_eq!(run.value("ports lost"), "1");
        let stamps: Vec<_> = run.messages.iter().map(|scan| scan.header.stamp.as_nanos()).collect();
        assert!(stamps.windows(2).any(|pair| pair[1] - pair[0] > 900_000_000), "{model}");
        assert!(*stamps.last().unwrap() > Probe::START.as_nanos() + 4_500_000_000, "{model}");
    }
}

#[test]
fn damaged_and_lost_packets_are_counted_and_give_no_wrong_distances() {
    for model in ["ld19", "rplidar_a1"] {
        let run = run(model, &["flip:0.002", "drop:0.01"], Duration::from_secs(5));
        assert_ne!(run.value("corrupt packets"), "0", "{model}");
        assert_ne!(run.value("bytes skipped"), "0", "{model}");
        assert_eq!(run.last_status().level, DiagnosticStatus::OK, "{model}");
        if model == "ld19" {
            // Its packets have a checksum.
            let farthest = libm::hypotf(3.0, 1.5) + 0.1;
            let is_wrong = |range: &f32| range.is_finite() && !(0.9..farthest).contains(range);
            assert!(!run.messages.iter().any(|scan| scan.ranges.iter().any(is_wrong)));
        }
    }
}

#[test]
fn a_lidar_of_another_model_is_reported_with_what_to_check() {
    let ports = EmulatedPorts::default();
    let lidar = Lidar::new(DeviceLink::new(SerialDevice::new(ports.clone())));
    let of_lidar = settings(&[("model", text("rplidar_a1")), ("port", text("memory:lidar"))]);
    let of_emulator = settings(&[("model", text("ld19"))]);
    let duration = Duration::from_secs(4);
    let topics = ["lidar/exchanges", "scan"];
    let run: Run<LaserScan> =
        Run::emulated((LidarEmulator::new(ports), of_emulator), (lidar, of_lidar), topics, duration);
    assert!(run.messages.is_empty());
    assert!(
        run.last_status().message.contains("does not answer: is it an RPLIDAR A1"),
        "{}",
        run.last_status().message
    );
}

#[test]
fn a_lidar_on_a_pseudo_terminal_is_read_in_real_time() {
    let started = Instant::now();
    for (model, name) in [(Model::Ld19, "ld19"), (Model::RplidarA1, "rplidar_a1")] {
        let emulator = Emulator::start(emulated(model, 1), None, Vec::new(), 1).unwrap();
        let lidar = Lidar::new(DeviceLink::new(SerialDevice::new(EmulatedPorts::default())));
        let port = emulator.port().to_str().unwrap().to_owned();
        let options = settings(&[("model", text(name)), ("port", text(&port))]);
        let mut probe = Probe::new();
        probe.add_with("lidar", lidar, options).unwrap();
        let scans = probe.listen::<LaserScan>("scan").unwrap();
        let mut count = 0;
        while count < 3 {
            assert!(started.elapsed() < Duration::from_secs(120), "{name}: {count} scans");
            probe.advance(Duration::from_millis(5)).unwrap();
            count += scans.take().len();
        }
    }
}

#[test]
fn settings_that_make_no_sense_are_refused_with_the_reason() {
    let refused = |options: &[(&str, SettingValue)]| {
        let lidar = Lidar::new(DeviceLink::recorded([]));
        Probe::new().add_with("lidar", lidar, settings(options)).unwrap_err().to_string()
    };
    assert!(refused(&[("model", text("ld20"))]).contains("\"ld20\" is none of ld06, ld19, rplidar_a1"));
    assert!(refused(&[("beams", 2_i64.into())]).contains("a number from 4 to 7200"));
    assert!(refused(&[("baud", (-1_i64).into())]).contains("a speed in bit/s"));
    assert!(refused(&[("range_min", 13.0.into())]).contains("less than range_max, 12 m"));
    assert!(refused(&[("no_echo", text("0"))]).contains("none of inf, nan"));
}
