//! The CM-730: power switch, buttons, IMU, battery.

use super::control_table::ControlTable;
use crate::hardware::protocol::StatusError;
use crate::hardware::tables::units::{ACCELERATION_PER_LSB, IMU_CENTRE, ImuScale};
use crate::hardware::tables::{Field, cm730};
use downbeat_servos::servo_emulator::ImuMotion;
use downbeat_servos::servo_emulator::Random;

/// The range of the CM-730's gyroscope.
const GYRO_FULL_SCALE_DPS: f64 = 1600.0;
/// Standard deviations, in steps.
const GYRO_NOISE_LSB: f64 = 0.7;
const ACCELERATION_NOISE_LSB: f64 = 0.7;
/// The voltage of a charged battery without load, and its drop per Ah and per A.
const CHARGED_V: f64 = 12.4;
const VOLTS_PER_AMPERE_HOUR: f64 = 1.2;
const RESISTANCE_OHM: f64 = 0.12;
/// Computer, board and idle servos.
const IDLE_CURRENT_A: f64 = 0.8;

/// The buttons on the robot's back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Button {
    /// The left one.
    Mode,
    /// The middle one.
    Start,
}

pub(super) struct Board {
    pub(super) table: ControlTable,
    pub(super) registered: Option<(u16, Vec<u8>)>,
    /// The remaining time for which each button is held down.
    held_s: [f64; 2],
    bias: [f64; 6],
    used_ah: f64,
    volts: f64,
}

impl Board {
    pub(super) fn new(random: &mut Random) -> Self {
        Self {
            table: ControlTable::new(&cm730::TABLE, cm730::LENGTH),
            registered: None,
            held_s: [0.0; 2],
            bias: std::array::from_fn(|_| random.within(0.8)),
            used_ah: random.unit() * 0.1,
            volts: CHARGED_V,
        }
    }

    pub(super) fn volts(&self) -> f64 {
        self.volts
    }

    pub(super) fn gives_power(&self) -> bool {
        self.table.get(&cm730::DXL_POWER) == 1
    }

    pub(super) fn write(&mut self, address: u8, data: &[u8]) -> Result<(), StatusError> {
        self.table.write(address, data, false)
    }

    pub(super) fn press(&mut self, number: usize, seconds: f64) {
        if let Some(held_s) = self.held_s.get_mut(number) {
            *held_s = seconds;
        }
    }

    /// Advances by `dt` seconds while the servos draw this current.
    pub(super) fn advance(&mut self, dt: f64, servo_current_a: f64, imu: &ImuMotion, random: &mut Random) {
        let current_a = IDLE_CURRENT_A + servo_current_a;
        self.used_ah += current_a * dt / 3600.0;
        self.volts = CHARGED_V - VOLTS_PER_AMPERE_HOUR * self.used_ah - RESISTANCE_OHM * current_a;
        self.table.set(&cm730::VOLTAGE, (self.volts * 10.0).round() as u16);

        let pressed = self.held_s.map(|held_s| u16::from(held_s > 0.0));
        self.table.set(&cm730::BUTTON, pressed[0] | pressed[1] << 1);
        self.held_s = self.held_s.map(|held_s| (held_s - dt).max(0.0));

        self.feel(imu, random);
    }

    /// The inverse of the hardware module's conversion of axes.
    fn feel(&mut self, imu: &ImuMotion, random: &mut Random) {
        let gyro_step = ImuScale::new(GYRO_FULL_SCALE_DPS).radians_per_lsb();
        let [roll, pitch, yaw] = imu.angular_velocity.map(|rate| rate / gyro_step);
        let [forward, left, up] = imu.specific_force.map(|force| force / ACCELERATION_PER_LSB);
        let felt: [(&Field, f64, f64); 6] = [
            (&cm730::GYRO_X, -roll, GYRO_NOISE_LSB),
            (&cm730::GYRO_Y, -pitch, GYRO_NOISE_LSB),
            (&cm730::GYRO_Z, yaw, GYRO_NOISE_LSB),
            (&cm730::ACC_X, -left, ACCELERATION_NOISE_LSB),
            (&cm730::ACC_Y, forward, ACCELERATION_NOISE_LSB),
            (&cm730::ACC_Z, up, ACCELERATION_NOISE_LSB),
        ];
        for ((field, steps, noise), bias) in felt.into_iter().zip(self.bias) {
            let raw = f64::from(IMU_CENTRE) + steps + bias + random.normal(noise);
            self.table.set(field, raw.round().clamp(0.0, 1023.0) as u16);
        }
    }
}
