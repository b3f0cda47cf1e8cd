//! The kinds of modules that this package offers to robot files.

use downbeat_executor::{Module, Synchrony};
use downbeat_kind::Kind;

use crate::gps::{Gps, GpsEmulator};
use crate::imu::bus::{EmulatedBuses, I2cDevice};
use crate::imu::{Imu, ImuEmulator};
use crate::lidar::{Lidar, LidarEmulator};
use crate::serial::{EmulatedPorts, SerialDevice};

/// The kinds.
#[must_use]
pub fn kinds() -> Vec<Kind> {
    [of_protocols(), of_the_kernel()].concat()
}

/// Sensors whose protocols are spoken here, on a serial port or a bus.
fn of_protocols() -> Vec<Kind> {
    // Emulators and sensors of one catalog meet here.
    let ports = EmulatedPorts::default();
    let [of_lidar, of_lidar_emulator, of_gps, of_gps_emulator] = std::array::from_fn(|_| ports.clone());
    let buses = EmulatedBuses::default();
    let of_imu_emulator = buses.clone();
    vec![
        Kind::device(
            "imu",
            "an inertial sensor on I²C: MPU-6050, MPU-6500, MPU-9250 or BNO055 (docs/sensors.md)",
            move || I2cDevice::new(buses.clone()),
            Imu::new,
        ),
        emulator("imu_emulator", "an emulated inertial sensor, with faults on request", move || {
            ImuEmulator::new(of_imu_emulator.clone())
        }),
        Kind::device(
            "lidar",
            "a laser scanner on a serial port: LDROBOT LD06, LD19 or Slamtec RPLIDAR A1 (docs/sensors.md)",
            move || SerialDevice::new(of_lidar.clone()),
            Lidar::new,
        ),
        emulator(
            "lidar_emulator",
            "an emulated laser scanner in a room, with faults on request",
            move || LidarEmulator::new(of_lidar_emulator.clone()),
        ),
        Kind::device(
            "gps",
            "a GPS receiver that speaks NMEA 0183 on a serial port (docs/sensors.md)",
            move || SerialDevice::new(of_gps.clone()),
            Gps::new,
        ),
        emulator("gps_emulator", "an emulated GPS receiver, with faults on request", move || {
            GpsEmulator::new(of_gps_emulator.clone())
        }),
    ]
}

fn emulator<M: Module>(name: &str, about: &str, make: impl Fn() -> M + Send + Sync + 'static) -> Kind {
    Kind::new(name, about, make).drives_device().emulated().with_synchrony(Synchrony::WhenDue)
}

/// Sensors and buses that Linux serves as devices of a class, and driving with one of them.
fn of_the_kernel() -> Vec<Kind> {
    use crate::camera::{Camera, Pictures, V4l2, VideoDevice};
    use crate::can::{CanBus, CanDevice, CandumpLog, SocketCan};
    use crate::gpio::{Chip, Gpio, GpioDevice, Pins};
    use crate::joystick::teleop::JoyTeleop;
    use crate::joystick::{Evdev, InputDevice, Joystick, RecordedEvents};
    vec![
        Kind::device(
            "camera",
            "a USB camera, or another that Linux has as a video device",
            || VideoDevice::new(V4l2::default()),
            Camera::new,
        )
        .with_files(&["calibration"]),
        Kind::device(
            "camera_emulator",
            "an emulated camera: pictures of files, or a pattern",
            || VideoDevice::new(Pictures::default()),
            Camera::emulated,
        )
        .with_files(&["calibration", "device"])
        .emulated(),
        Kind::device(
            "joystick",
            "a joystick or gamepad",
            || InputDevice::new(Evdev::default()),
            Joystick::new,
        ),
        Kind::device(
            "joystick_emulator",
            "an emulated gamepad that a file of events moves",
            || InputDevice::new(RecordedEvents::default()),
            Joystick::new,
        )
        .with_files(&["device"])
        .emulated(),
        Kind::new("joy_teleop", "drives with a joystick, as teleop_twist_joy does", JoyTeleop::default),
        Kind::device("can", "a CAN bus, as topics", || CanDevice::new(SocketCan::default()), CanBus::new),
        Kind::device(
            "can_emulator",
            "an emulated CAN bus, on which a log of candump is played",
            || CanDevice::new(CandumpLog::default()),
            CanBus::emulated,
        )
        .with_files(&["interface"])
        .emulated(),
        Kind::device(
            "gpio",
            "lines of a GPIO chip, as topics",
            || GpioDevice::new(Chip::default()),
            Gpio::new,
        ),
        Kind::device(
            "gpio_emulator",
            "an emulated GPIO chip: a folder with a file for each line",
            || GpioDevice::new(Pins::default()),
            Gpio::emulated,
        )
        .with_files(&["chip"])
        .emulated(),
    ]
}
