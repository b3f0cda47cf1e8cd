//! Inertial sensors from the registers of emulated chips to messages: with faults, and from a recording.
#![allow(clippy::unwrap_used)]

mod common;

use std::time::Duration;

use common::{Run, settings, text};
use downbeat_device::DeviceLink;
use downbeat_executor::{ModuleOptions, Probe, SettingValue};
use downbeat_msgs::Message;
use downbeat_msgs::diagnostic_msgs::msg::DiagnosticStatus;
use downbeat_msgs::sensor_msgs::msg::{Imu as ImuMessage, MagneticField, Temperature};
use downbeat_sensors::imu::bus::{EmulatedBuses, I2cDevice};
use downbeat_sensors::imu::{Imu, ImuEmulator};

fn options(more: &[(&str, SettingValue)]) -> ModuleOptions {
    settings(&[more, &[("bus", text("memory:imu"))]].concat())
}

/// Runs an emulated chip.
fn run_with<M: Message>(
    emulated: &str,
    faults: &[&str],
    sensor: ModuleOptions,
    topic: &str,
    ms: u64,
) -> Run<M> {
    let buses = EmulatedBuses::default();
    let imu = Imu::new(DeviceLink::new(I2cDevice::new(buses.clone())));
    let faults: Vec<String> = faults.iter().map(|&fault| fault.to_owned()).collect();
    let of_emulator = settings(&[("model", text(emulated)), ("faults", faults.into())]);
    let emulator = (ImuEmulator::new(buses), of_emulator);
    Run::emulated(emulator, (imu, sensor), ["imu/exchanges", topic], Duration::from_millis(ms))
}

fn run<M: Message>(model: &str, topic: &str, ms: u64) -> Run<M> {
    run_with(model, &[], options(&[("model", text(model))]), topic, ms)
}

#[test]
fn each_chip_measures_the_motion_that_is_emulated() {
    for model in ["mpu6050", "mpu6500", "mpu9250", "bno055"] {
        let run = run::<ImuMessage>(model, "imu/data_raw", 3000);
        assert!((200..=300).contains(&run.messages.len()), "{model}: {}", run.messages.len());
        let mean = |value: fn(&ImuMessage) -> f64| {
            run.messages.iter().map(value).sum::<f64>() / run.messages.len() as f64
        };
        assert!((mean(|imu| imu.angular_velocity.z) - 0.5).abs() < 0.002, "{model}");
        assert!(mean(|imu| imu.angular_velocity.x).abs() < 0.002, "{model}");
        assert!((mean(|imu| imu.linear_acceleration.z) - 9.80665).abs() < 0.02, "{model}");
        let first = &run.messages[0];
        assert_eq!((first.header.frame_id.as_str(), first.orientation_covariance[0]), ("imu_link", -1.0));
        assert!((first.angular_velocity_covariance[4] - 1e-6).abs() < 1e-12);
        assert_eq!(run.last_status().level, DiagnosticStatus::OK, "{model}: {}", run.last_status().message);
    }
}

#[test]
fn orientation_field_and_temperature_come_where_the_chip_has_them() {
    let data = run::<ImuMessage>("bno055", "imu/data", 3000);
    let pair = [&data.messages[50], &data.messages[150]];
    let yaw = pair.map(|imu| 2.0 * libm::atan2(imu.orientation.z, imu.orientation.w));
    assert!((yaw[1] - yaw[0] - 0.5).abs() < 0.01, "a second at 0.5 rad/s: {yaw:?}");
    assert_eq!(data.value("calibration"), "system 3, gyroscope 3, accelerometer 3, magnetometer 3 of 3");
    for model in ["bno055", "mpu9250"] {
        let field = run::<MagneticField>(model, "imu/mag", 2000).messages;
        let field = &field.last().unwrap().magnetic_field;
        assert!(
            (libm::hypot(field.x, field.y) - 20e-6).abs() < 1e-6 && (field.z + 34.6e-6).abs() < 1e-6,
            "{model}: {field:?}"
        );
    }
    let temperatures = run::<Temperature>("mpu6050", "imu/temperature", 3000).messages;
    assert!((2..=3).contains(&temperatures.len()) && (temperatures[0].temperature - 25.0).abs() < 0.01);
}

#[test]
fn a_recording_replays_bit_for_bit() {
    for model in ["mpu9250", "bno055"] {
        let faults = ["drop:0.01", "close-port@1s..1500ms"];
        let of = |bus: &str| settings(&[("model", text(model)), ("bus", text(bus))]);
        let recorded = run_with::<ImuMessage>(model, &faults, of("memory:imu"), "imu/data_raw", 4000);
        let imu = Imu::new(DeviceLink::recorded(recorded.exchanges.clone()));
        let topics = ["imu/exchanges", "imu/data_raw"];
        let replayed = Run::<ImuMessage>::replayed((imu, of("/dev/null")), topics, Duration::from_secs(4));
        assert_eq!(replayed.bytes(), recorded.bytes(), "{model}");
        assert_eq!(replayed.exchanges, recorded.exchanges, "{model}");
        assert!(recorded.messages.len() > 100, "{model}: {}", recorded.messages.len());
    }
}

#[test]
fn a_chip_whose_wires_were_out_is_set_up_again() {
    for model in ["mpu6050", "bno055"] {
        let faults = ["close-port@1s..3s"];
        let run =
            run_with::<ImuMessage>(model, &faults, options(&[("model", text(model))]), "imu/data_raw", 6000);
        let out = run.statuses.iter().find(|status| status.message.contains("no answer from address"));
        assert_eq!(out.unwrap().level, DiagnosticStatus::ERROR, "{model}");
        assert_eq!(run.last_status().level, DiagnosticStatus::OK, "{model}: {}", run.last_status().message);
        let last = run.messages.last().unwrap().header.stamp.as_nanos();
        assert!(last > Probe::START.as_nanos() + 5_900_000_000, "{model}");
    }
}

#[test]
fn a_measurement_that_fails_is_counted_and_costs_no_other() {
    let run = run_with::<ImuMessage>("mpu6050", &["drop:0.05@1s.."], options(&[]), "imu/data_raw", 5000);
    let failed: usize = run.value("failed measurements").parse().unwrap();
    assert!((5..60).contains(&failed), "{failed}");
    assert_eq!(run.last_status().message, "measuring, but some measurements fail");
    assert!(run.messages.len() > 380, "{}", run.messages.len());
}

#[test]
fn another_chip_than_expected_is_used_or_reported() {
    let run =
        run_with::<ImuMessage>("mpu6500", &[], options(&[("model", text("mpu9250"))]), "imu/data_raw", 2000);
    assert!(!run.messages.is_empty());
    assert_eq!(run.value("chip"), "MPU-6500");
    let at = options(&[("model", text("bno055")), ("address", 0x68_i64.into())]);
    let run = run_with::<ImuMessage>("mpu6050", &[], at, "imu/data_raw", 3000);
    // Its register 0 is 0, as that of a BNO055 that starts; it is waited for first.
    assert!(run.messages.is_empty());
    let refused =
        run.statuses.iter().any(|status| status.message.contains("says 0x00 (CHIP_ID), which is no BNO055"));
    assert!(refused, "{:?}", run.statuses);
    let absent = run_with::<ImuMessage>(
        "mpu6050",
        &[],
        options(&[("address", 0x69_i64.into())]),
        "imu/data_raw",
        2000,
    );
    assert!(
        absent.last_status().message.contains("no answer from address 0x69 on memory:imu: check the wires")
    );
}

#[test]
fn axes_and_offsets_turn_and_shift_what_is_measured() {
    let offset: Vec<f64> = vec![0.0, -0.5, 0.0];
    let more = options(&[("axes", text("x -z y")), ("gyro_offset", offset.into())]);
    let run = run_with::<ImuMessage>("mpu6050", &[], more, "imu/data_raw", 2000);
    let imu = run.messages.last().unwrap();
    assert!((imu.linear_acceleration.y + 9.8).abs() < 0.3, "the chip's z axis points to the right: {imu:?}");
    assert!(imu.angular_velocity.y.abs() < 0.01, "-0.5 rad/s less its offset: {imu:?}");
}

#[test]
fn settings_that_make_no_sense_are_refused_with_the_reason() {
    let refused = |name: &str, value: SettingValue| {
        let imu = Imu::new(DeviceLink::recorded([]));
        Probe::new().add_with("imu", imu, settings(&[(name, value)])).unwrap_err().to_string()
    };
    assert!(refused("axes", text("x x z")).contains("three of x, y, z"));
    assert!(refused("axes", text("y x z")).contains("left-handed"));
    assert!(refused("address", 0x80_i64.into()).contains("seven bits"));
    assert!(refused("rate", 0.0.into()).contains("between 1 and 500 Hz"));
    assert!(refused("gyro_range", 300_i64.into()).contains("250, 500, 1000 or 2000"));
    assert!(refused("acceleration_range", 3_i64.into()).contains("2, 4, 8 or 16 g"));
    assert!(refused("gyro_offset", vec![0.0].into()).contains("three numbers"));
    assert!(refused("calibration", vec![1_i64].into()).contains("11 numbers"));
}
