//! InvenSense MPU-6050, MPU-6500 and MPU-9250: which one it is, the register `WHO_AM_I` says.
//!
//! The MPU-9250 has a second chip in its case, the magnetometer AK8963, which is reached on the same bus at
//! address 0x0C. Its x axis is the y axis of the other chip, its y axis the x axis, and its z axis points the
//! other way; readings have the axes of the other chip.
//!
//! # References
//! InvenSense, "MPU-6000 and MPU-6050 Register Map and Descriptions" RM-MPU-6000A-00 4.2 and "Product
//! Specification" PS-MPU-6000A-00 3.4; "MPU-9250 Register Map and Descriptions" RM-MPU-9250A-00 1.6 and
//! "Product Specification" PS-MPU-9250A-01 1.1; AKM, "AK8963" MS1356-E-02.

use std::time::Duration;

use super::{Chip, Reading, Registers, Step, write};
use downbeat_servos::servo_bus::models::STANDARD_GRAVITY;

/// The address with AD0 low; with AD0 high it is 0x69.
pub const ADDRESS: u8 = 0x68;
/// The address of the magnetometer.
pub const MAGNETOMETER: u8 = 0x0C;

const SMPLRT_DIV: u8 = 0x19;
const CONFIG: u8 = 0x1A;
const GYRO_CONFIG: u8 = 0x1B;
const ACCEL_CONFIG: u8 = 0x1C;
const ACCEL_CONFIG_2: u8 = 0x1D;
const INT_PIN_CFG: u8 = 0x37;
const ACCEL_XOUT_H: u8 = 0x3B;
const PWR_MGMT_1: u8 = 0x6B;
const WHO_AM_I: u8 = 0x75;
/// Accelerometer, temperature and gyroscope.
const MEASUREMENT: u8 = 14;

/// Of the magnetometer.
const WIA: u8 = 0x00;
const ST1: u8 = 0x02;
const CNTL1: u8 = 0x0A;
const ASAX: u8 = 0x10;
/// From `ST1` to `ST2`.
const FIELD: u8 = 8;
/// A step at 16 bits, in T.
const FIELD_STEP: f64 = 0.15e-6;

/// The ranges of the gyroscope in °/s, with the steps of 1 °/s.
pub const GYRO_RANGES: [(i64, f64); 4] = [(250, 131.0), (500, 65.5), (1000, 32.8), (2000, 16.4)];
/// The ranges of the accelerometer in g, with the steps of 1 g.
pub const ACCELERATION_RANGES: [(i64, f64); 4] = [(2, 16384.0), (4, 8192.0), (8, 4096.0), (16, 2048.0)];
/// The bandwidths of the low-pass filter in Hz (of the MPU-6050's accelerometer), and their numbers.
const BANDWIDTHS: [(f64, u8); 6] = [(184.0, 1), (94.0, 2), (44.0, 3), (21.0, 4), (10.0, 5), (5.0, 6)];

/// The chips.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variant {
    /// MPU-6050, which also the MPU-6000 and copies of both say they are.
    Mpu6050,
    /// MPU-6500.
    Mpu6500,
    /// MPU-9250 or MPU-9255, with magnetometer.
    Mpu9250,
}

impl Variant {
    /// The variant with this `WHO_AM_I`.
    #[must_use]
    pub fn of(who_am_i: u8) -> Option<Self> {
        match who_am_i {
            0x68 => Some(Self::Mpu6050),
            0x70 => Some(Self::Mpu6500),
            0x71 | 0x73 => Some(Self::Mpu9250),
            _ => None,
        }
    }

    fn title(self) -> &'static str {
        match self {
            Self::Mpu6050 => "MPU-6050",
            Self::Mpu6500 => "MPU-6500",
            Self::Mpu9250 => "MPU-9250",
        }
    }

    fn temperature(self, steps: i16) -> f64 {
        match self {
            Self::Mpu6050 => f64::from(steps) / 340.0 + 36.53,
            Self::Mpu6500 | Self::Mpu9250 => f64::from(steps) / 333.87 + 21.0,
        }
    }
}

/// How it is set up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MpuSettings {
    /// Seven bits.
    pub address: u8,
    /// The variant that is expected; what is found is used.
    pub expected: Variant,
    /// The position in [`GYRO_RANGES`].
    pub gyro_range: usize,
    /// The position in [`ACCELERATION_RANGES`].
    pub acceleration_range: usize,
    /// How often it measures, in Hz.
    pub rate: f64,
}

/// The chip.
#[derive(Debug)]
pub struct Mpu {
    settings: MpuSettings,
    found: Option<Variant>,
    /// The factors of the magnetometer's axes, once they were read.
    sensitivity: Option<[f64; 3]>,
}

impl Mpu {
    /// A chip that was not seen yet.
    #[must_use]
    pub fn new(settings: MpuSettings) -> Self {
        Self { settings, found: None, sensitivity: None }
    }

    fn set_up(&self, variant: Variant) -> Vec<Step> {
        let address = self.settings.address;
        let rate = self.settings.rate;
        // The widest one below half the rate.
        let filter = BANDWIDTHS
            .iter()
            .find(|(bandwidth, _)| *bandwidth <= rate / 2.0)
            .map_or(6, |(_, number)| *number);
        // It measures at 1 kHz, divided by one more than this.
        let divider = (1000.0 / rate).round().clamp(1.0, 256.0) as u16 - 1;
        let mut steps = vec![
            // Awake, and the clock of the gyroscope.
            write(address, PWR_MGMT_1, 0x80),
            Step::Pause(Duration::from_millis(100)),
            write(address, PWR_MGMT_1, 0x01),
            Step::Pause(Duration::from_millis(50)),
            write(address, SMPLRT_DIV, divider as u8),
            write(address, CONFIG, filter),
            write(address, GYRO_CONFIG, (self.settings.gyro_range as u8) << 3),
            write(address, ACCEL_CONFIG, (self.settings.acceleration_range as u8) << 3),
        ];
        if variant != Variant::Mpu6050 {
            steps.push(write(address, ACCEL_CONFIG_2, filter));
        }
        if variant == Variant::Mpu9250 {
            steps.extend([
                // The magnetometer joins the bus.
                write(address, INT_PIN_CFG, 0x02),
                Step::Pause(Duration::from_millis(10)),
                Step::Read(Registers { address: MAGNETOMETER, first: WIA, length: 1 }),
            ]);
        }
        steps
    }
}

impl Chip for Mpu {
    fn title(&self) -> &'static str {
        self.found.unwrap_or(self.settings.expected).title()
    }

    fn begin(&mut self) -> Vec<Step> {
        self.found = None;
        self.sensitivity = None;
        vec![Step::Read(Registers { address: self.settings.address, first: WHO_AM_I, length: 1 })]
    }

    fn learn(&mut self, registers: Registers, bytes: &[u8]) -> Result<Vec<Step>, String> {
        match (registers.address, registers.first, bytes) {
            (MAGNETOMETER, WIA, [0x48]) => Ok(vec![
                // Power down, then the factory's values.
                write(MAGNETOMETER, CNTL1, 0x00),
                Step::Pause(Duration::from_millis(10)),
                write(MAGNETOMETER, CNTL1, 0x0F),
                Step::Pause(Duration::from_millis(10)),
                Step::Read(Registers { address: MAGNETOMETER, first: ASAX, length: 3 }),
            ]),
            (MAGNETOMETER, WIA, _) => {
                tracing::warn!(
                    "the magnetometer of the MPU-9250 does not answer: there is no magnetic field"
                );
                Ok(Vec::new())
            }
            (MAGNETOMETER, _, [x, y, z]) => {
                let factor = |value: &u8| (f64::from(*value) - 128.0) * 0.5 / 128.0 + 1.0;
                self.sensitivity = Some([factor(x), factor(y), factor(z)]);
                Ok(vec![
                    write(MAGNETOMETER, CNTL1, 0x00),
                    Step::Pause(Duration::from_millis(10)),
                    // 16 bits, 100 Hz.
                    write(MAGNETOMETER, CNTL1, 0x16),
                ])
            }
            (address, _, [who_am_i]) => {
                let found = Variant::of(*who_am_i).ok_or_else(|| {
                    format!(
                        "the chip at {address:#04x} says {who_am_i:#04x} (WHO_AM_I), which is no MPU-6050, -6500 or -9250: check \
                         \"model\" and \"address\""
                    )
                })?;
                if found != self.settings.expected {
                    tracing::warn!(
                        "the chip at {address:#04x} is an {}, not an {}: used as what it is",
                        found.title(),
                        self.settings.expected.title()
                    );
                }
                self.found = Some(found);
                Ok(self.set_up(found))
            }
            _ => Ok(Vec::new()),
        }
    }

    fn registers(&self) -> Vec<Registers> {
        let mut all =
            vec![Registers { address: self.settings.address, first: ACCEL_XOUT_H, length: MEASUREMENT }];
        if self.sensitivity.is_some() {
            all.push(Registers { address: MAGNETOMETER, first: ST1, length: FIELD });
        }
        all
    }

    fn read(&mut self, registers: Registers, bytes: &[u8], reading: &mut Reading) -> Result<(), String> {
        if registers.address == MAGNETOMETER {
            reading.magnetic_field =
                self.sensitivity.and_then(|sensitivity| magnetic_field(bytes, sensitivity));
            return Ok(());
        }
        if bytes.iter().all(|byte| *byte == 0) {
            return Err("the chip sleeps, as after a loss of power".to_owned());
        }
        let number = |index: usize| {
            let pair = bytes.get(2 * index..2 * index + 2).and_then(|pair| pair.first_chunk());
            pair.map(|pair| i16::from_be_bytes(*pair))
        };
        let vector = |first: usize, step: f64| {
            let number = |index| Some(f64::from(number(index)?) * step);
            Some([number(first)?, number(first + 1)?, number(first + 2)?])
        };
        let steps =
            |ranges: &[(i64, f64); 4], range: usize| ranges.get(range).map_or(f64::NAN, |(_, steps)| *steps);
        let per_g = steps(&ACCELERATION_RANGES, self.settings.acceleration_range);
        let per_degree = steps(&GYRO_RANGES, self.settings.gyro_range);
        reading.acceleration = vector(0, STANDARD_GRAVITY / per_g);
        reading.angular_velocity = vector(4, 1.0_f64.to_radians() / per_degree);
        reading.temperature = self.found.zip(number(3)).map(|(variant, steps)| variant.temperature(steps));
        Ok(())
    }
}

/// The field in the axes of the MPU. `None` without a new one, or if it is too strong.
fn magnetic_field(bytes: &[u8], sensitivity: [f64; 3]) -> Option<[f64; 3]> {
    let [state, x_low, x_high, y_low, y_high, z_low, z_high, end] = *bytes.first_chunk::<8>()?;
    let is_new = state & 0x01 != 0;
    let overflows = end & 0x08 != 0;
    if !is_new || overflows {
        return None;
    }
    let [x, y, z] = [[x_low, x_high], [y_low, y_high], [z_low, z_high]].map(i16::from_le_bytes);
    let [sx, sy, sz] = sensitivity.map(|factor| factor * FIELD_STEP);
    Some([f64::from(y) * sy, f64::from(x) * sx, -f64::from(z) * sz])
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn settings() -> MpuSettings {
        let expected = Variant::Mpu6050;
        MpuSettings { address: ADDRESS, expected, gyro_range: 0, acceleration_range: 0, rate: 100.0 }
    }

    fn who_am_i() -> Registers {
        Registers { address: ADDRESS, first: WHO_AM_I, length: 1 }
    }

    fn found(who: u8) -> (Mpu, Vec<Step>) {
        let mut chip = Mpu::new(settings());
        assert_eq!(chip.begin(), [Step::Read(who_am_i())]);
        let steps = chip.learn(who_am_i(), &[who]).unwrap();
        (chip, steps)
    }

    #[test]
    fn the_variant_is_what_the_chip_says() {
        assert_eq!(found(0x68).0.title(), "MPU-6050");
        assert_eq!(found(0x70).0.title(), "MPU-6500");
        assert_eq!(found(0x71).0.title(), "MPU-9250");
        let refused = Mpu::new(settings()).learn(who_am_i(), &[0xEA]).unwrap_err();
        assert!(refused.contains("says 0xea (WHO_AM_I), which is no MPU-6050"), "{refused}");
    }

    #[test]
    fn rate_and_filter_follow_the_setting() {
        let value = |rate: f64, register: u8| {
            let mut chip = Mpu::new(MpuSettings { rate, gyro_range: 3, acceleration_range: 2, ..settings() });
            let steps = chip.learn(who_am_i(), &[0x68]).unwrap();
            steps.into_iter().find_map(|step| match step {
                Step::Write { register: found, values, .. } if found == register => Some(values[0]),
                _ => None,
            })
        };
        assert_eq!((value(100.0, SMPLRT_DIV), value(100.0, CONFIG)), (Some(9), Some(3)));
        assert_eq!((value(500.0, SMPLRT_DIV), value(500.0, CONFIG)), (Some(1), Some(1)));
        assert_eq!((value(4.0, SMPLRT_DIV), value(4.0, CONFIG)), (Some(249), Some(6)));
        assert_eq!((value(100.0, GYRO_CONFIG), value(100.0, ACCEL_CONFIG)), (Some(0x18), Some(0x10)));
        assert_eq!(value(100.0, ACCEL_CONFIG_2), None, "the MPU-6050 does not have it");
    }

    /// The scales of the product specification: 16384 steps are 1 g, 131 steps 1 °/s, temperature in °C =
    /// steps / 340 + 36.53.
    #[test]
    fn measurements_have_the_scales_of_the_specification() {
        let (mut chip, _) = found(0x68);
        let measured: [i16; 7] = [16384, -8192, 0, -3920, 131, -262, 13_100];
        let bytes: Vec<u8> = measured.iter().flat_map(|number| number.to_be_bytes()).collect();
        let mut reading = Reading::default();
        chip.read(chip.registers()[0], &bytes, &mut reading).unwrap();
        assert_eq!(reading.acceleration, Some([9.80665, -4.903325, 0.0]));
        let rates = reading.angular_velocity.unwrap().map(f64::to_degrees);
        assert!(
            rates.iter().zip([1.0, -2.0, 100.0]).all(|(is, should)| (is - should).abs() < 1e-9),
            "{rates:?}"
        );
        assert!((reading.temperature.unwrap() - 25.0).abs() < 0.01);
        assert_eq!(reading.magnetic_field, None);
    }

    #[test]
    fn the_magnetometer_is_set_up_with_the_values_of_its_factory() {
        let (mut chip, steps) = found(0x71);
        let wia = Registers { address: MAGNETOMETER, first: WIA, length: 1 };
        assert_eq!(steps.last(), Some(&Step::Read(wia)));
        let steps = chip.learn(wia, &[0x48]).unwrap();
        let asa = Registers { address: MAGNETOMETER, first: ASAX, length: 3 };
        assert_eq!(steps.last(), Some(&Step::Read(asa)));
        let steps = chip.learn(asa, &[128, 192, 0]).unwrap();
        assert_eq!(steps.last(), Some(&write(MAGNETOMETER, CNTL1, 0x16)));
        let registers = chip.registers()[1];
        let field = |state: u8, end: u8, chip: &mut Mpu| {
            let mut reading = Reading::default();
            let numbers = [100_i16, 200, -300].map(i16::to_le_bytes).concat();
            chip.read(registers, &[&[state], &numbers[..], &[end]].concat(), &mut reading).unwrap();
            reading.magnetic_field
        };
        let [x, y, z] = field(0x01, 0x10, &mut chip).unwrap();
        // Factors: 1, 1.25 and 0.5.
        assert!((x - 200.0 * 1.25 * 0.15e-6).abs() < 1e-12 && (y - 100.0 * 0.15e-6).abs() < 1e-12);
        assert!((z - 300.0 * 0.5 * 0.15e-6).abs() < 1e-12);
        assert_eq!((field(0x00, 0x10, &mut chip), field(0x01, 0x18, &mut chip)), (None, None));
    }

    #[test]
    fn a_chip_that_lost_power_is_noticed_and_short_answers_are_survived() {
        let (mut chip, _) = found(0x68);
        let registers = chip.registers()[0];
        assert!(chip.read(registers, &[0; 14], &mut Reading::default()).is_err());
        for length in 0..14 {
            let mut reading = Reading::default();
            chip.read(registers, &vec![1; length.max(1)], &mut reading).unwrap();
            assert!(length >= 14 || reading.angular_velocity.is_none());
        }
        let mut nine = found(0x71).0;
        assert_eq!(nine.learn(Registers { address: MAGNETOMETER, first: WIA, length: 1 }, &[0]).unwrap(), []);
        assert_eq!(nine.registers().len(), 1, "without magnetometer");
    }
}
