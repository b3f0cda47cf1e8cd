//! Bosch BNO055: a sensor that computes its orientation itself.
//!
//! # References
//! Bosch Sensortec, "BNO055 Intelligent 9-axis absolute orientation sensor", data sheet BST-BNO055-DS000 1.8.

use std::time::Duration;

use super::{Chip, Reading, Registers, Step, write};

/// The address with COM3 low; with COM3 high it is 0x29.
pub const ADDRESS: u8 = 0x28;

const CHIP_ID: u8 = 0x00;
const PAGE_ID: u8 = 0x07;
const ACC_DATA: u8 = 0x08;
const MAG_DATA: u8 = 0x0E;
const GYR_DATA: u8 = 0x14;
const QUA_DATA: u8 = 0x20;
const TEMP: u8 = 0x34;
const CALIB_STAT: u8 = 0x35;
const SYS_STATUS: u8 = 0x39;
const SYS_ERR: u8 = 0x3A;
const UNIT_SEL: u8 = 0x3B;
const OPR_MODE: u8 = 0x3D;
const PWR_MODE: u8 = 0x3E;
const SYS_TRIGGER: u8 = 0x3F;
const ACC_OFFSET: u8 = 0x55;

/// The fusion runs.
const FUSION_RUNS: u8 = 5;
/// How often it is waited for, 0.1 s each time.
const LONGEST_START: u32 = 10;
/// m/s², rad/s, °C.
const UNITS: u8 = 0x02;

/// The steps of 1 m/s², 1 rad/s, 1 T and 1.
const ACCELERATION_STEPS: f64 = 100.0;
const ANGULAR_STEPS: f64 = 900.0;
const FIELD_STEPS: f64 = 16.0e6;
const QUATERNION_STEPS: f64 = 16384.0;

/// What the fusion uses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// All sensors: the heading is that of a compass.
    #[default]
    Ndof,
    /// Without the magnetometer: the heading begins at 0 and drifts.
    Imu,
}

/// The number of calibration values: the offsets of accelerometer, magnetometer and gyroscope, and the radii
/// of the first two.
pub const CALIBRATION: usize = 11;

/// How it is set up.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BnoSettings {
    /// Seven bits.
    pub address: u8,
    /// What the fusion uses.
    pub mode: Mode,
    /// Whether the board has a crystal of 32768 Hz.
    pub has_crystal: bool,
    /// The registers from `ACC_OFFSET_X` on, if they are known from an earlier calibration.
    pub calibration: Option<[i16; CALIBRATION]>,
}

/// The chip.
#[derive(Debug)]
pub struct Bno055 {
    settings: BnoSettings,
    /// The last `CALIB_STAT`.
    calibration: Option<u8>,
    /// How often it was waited for.
    waited: u32,
}

impl Bno055 {
    /// A chip that was not seen yet.
    #[must_use]
    pub fn new(settings: BnoSettings) -> Self {
        Self { settings, calibration: None, waited: 0 }
    }

    fn set_up(&self) -> Vec<Step> {
        let address = self.settings.address;
        let pause = |ms| Step::Pause(Duration::from_millis(ms));
        let mut steps = vec![
            write(address, PAGE_ID, 0),
            // To the mode CONFIG, in which settings can be written.
            write(address, OPR_MODE, 0x00),
            pause(30),
            write(address, PWR_MODE, 0x00),
            pause(10),
            write(address, UNIT_SEL, UNITS),
            write(address, SYS_TRIGGER, if self.settings.has_crystal { 0x80 } else { 0x00 }),
            pause(20),
        ];
        if let Some(calibration) = self.settings.calibration {
            let values = calibration.iter().flat_map(|value| value.to_le_bytes()).collect();
            steps.push(Step::Write { address, register: ACC_OFFSET, values });
        }
        let mode = match self.settings.mode {
            Mode::Ndof => 0x0C,
            Mode::Imu => 0x08,
        };
        // The fusion needs a while until it runs.
        steps.extend([write(address, OPR_MODE, mode), pause(100)]);
        steps
    }
}

impl Chip for Bno055 {
    fn title(&self) -> &'static str {
        "BNO055"
    }

    fn begin(&mut self) -> Vec<Step> {
        self.calibration = None;
        self.waited = 0;
        vec![Step::Read(Registers { address: self.settings.address, first: CHIP_ID, length: 1 })]
    }

    fn learn(&mut self, registers: Registers, bytes: &[u8]) -> Result<Vec<Step>, String> {
        match bytes {
            [0xA0] => Ok(self.set_up()),
            // It has not started yet: this takes 0.4 s.
            [0x00] if self.waited < LONGEST_START => {
                self.waited += 1;
                Ok(vec![Step::Pause(Duration::from_millis(100)), Step::Read(registers)])
            }
            other => Err(format!(
                "the chip at {:#04x} says {} (CHIP_ID), which is no BNO055: check \"model\" and \"address\"",
                registers.address,
                other.first().map_or("nothing".to_owned(), |id| format!("{id:#04x}"))
            )),
        }
    }

    fn registers(&self) -> Vec<Registers> {
        vec![Registers { address: self.settings.address, first: ACC_DATA, length: SYS_ERR - ACC_DATA + 1 }]
    }

    fn read(&mut self, _registers: Registers, bytes: &[u8], reading: &mut Reading) -> Result<(), String> {
        let byte = |register: u8| bytes.get(usize::from(register - ACC_DATA)).copied();
        if let Some(status) = byte(SYS_STATUS)
            && status != FUSION_RUNS
        {
            let error = byte(SYS_ERR).unwrap_or_default();
            return Err(format!(
                "its fusion does not run (SYS_STATUS {status}, SYS_ERR {error}), as after a loss of power"
            ));
        }
        let number =
            |register: u8| Some(f64::from(i16::from_le_bytes([byte(register)?, byte(register + 1)?])));
        let vector = |register: u8, steps: f64| {
            Some([number(register)? / steps, number(register + 2)? / steps, number(register + 4)? / steps])
        };
        reading.acceleration = vector(ACC_DATA, ACCELERATION_STEPS);
        reading.angular_velocity = vector(GYR_DATA, ANGULAR_STEPS);
        if self.settings.mode == Mode::Ndof {
            reading.magnetic_field = vector(MAG_DATA, FIELD_STEPS);
        }
        let quaternion = number(QUA_DATA).zip(vector(QUA_DATA + 2, 1.0));
        reading.orientation = quaternion.and_then(|(w, [x, y, z])| {
            let length = (w * w + x * x + y * y + z * z).sqrt();
            // Rounded numbers are not quite of length 1; others are no orientation.
            let is_unit = (length / QUATERNION_STEPS - 1.0).abs() < 0.01;
            is_unit.then(|| [x, y, z, w].map(|component| component / length))
        });
        reading.temperature = byte(TEMP).map(|celsius| f64::from(celsius.cast_signed()));
        self.calibration = byte(CALIB_STAT);
        Ok(())
    }

    fn state(&self) -> Option<String> {
        let status = self.calibration?;
        let part = |shift: u8| status >> shift & 0b11;
        Some(format!(
            "system {}, gyroscope {}, accelerometer {}, magnetometer {} of 3",
            part(6),
            part(4),
            part(2),
            part(0)
        ))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn chip(mode: Mode) -> Bno055 {
        Bno055::new(BnoSettings { address: ADDRESS, mode, has_crystal: true, calibration: None })
    }

    /// Registers from `ACC_DATA` to `SYS_ERR`, with the units of tables 3-17 to 3-33 of the data sheet.
    fn registers(status: u8) -> Vec<u8> {
        let mut bytes = vec![0; 51];
        let mut put = |register: u8, numbers: &[i16]| {
            let at = usize::from(register - ACC_DATA);
            let values: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
            bytes[at..at + values.len()].copy_from_slice(&values);
        };
        put(ACC_DATA, &[100, -200, 981]);
        put(MAG_DATA, &[320, -160, 16]);
        put(GYR_DATA, &[900, -450, 9]);
        put(QUA_DATA, &[11585, 0, 0, 11585]);
        bytes[usize::from(TEMP - ACC_DATA)] = 0xFB;
        bytes[usize::from(CALIB_STAT - ACC_DATA)] = 0b11_10_01_00;
        bytes[usize::from(SYS_STATUS - ACC_DATA)] = status;
        bytes
    }

    #[test]
    fn measurements_have_the_units_of_the_data_sheet() {
        let (mut chip, mut reading) = (chip(Mode::Ndof), Reading::default());
        chip.read(chip.registers()[0], &registers(FUSION_RUNS), &mut reading).unwrap();
        assert_eq!(reading.acceleration, Some([1.0, -2.0, 9.81]));
        assert_eq!(reading.angular_velocity, Some([1.0, -0.5, 0.01]));
        let [x, y, z] = reading.magnetic_field.unwrap();
        assert!((x - 20e-6).abs() < 1e-12 && (y + 10e-6).abs() < 1e-12 && (z - 1e-6).abs() < 1e-12);
        let [qx, qy, qz, qw] = reading.orientation.unwrap();
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!(qx == 0.0 && qy == 0.0 && (qz - half).abs() < 1e-9 && (qw - half).abs() < 1e-9);
        assert_eq!(reading.temperature, Some(-5.0));
        assert_eq!(chip.state().unwrap(), "system 3, gyroscope 2, accelerometer 1, magnetometer 0 of 3");
        let mut without = Reading::default();
        let mut imu = super::tests::chip(Mode::Imu);
        imu.read(imu.registers()[0], &registers(FUSION_RUNS), &mut without).unwrap();
        assert_eq!(without.magnetic_field, None);
    }

    #[test]
    fn the_set_up_ends_in_the_mode_of_the_fusion_with_the_calibration_before_it() {
        let id = Registers { address: ADDRESS, first: CHIP_ID, length: 1 };
        let calibration = Some([1, -2, 3, 4, 5, 6, 7, 8, 9, 1000, 480]);
        let mut chip = Bno055::new(BnoSettings { calibration, ..chip(Mode::Ndof).settings });
        assert_eq!(chip.begin(), [Step::Read(id)]);
        let steps = chip.learn(id, &[0xA0]).unwrap();
        let mode = steps.iter().position(|step| *step == write(ADDRESS, OPR_MODE, 0x0C)).unwrap();
        let Step::Write { register: ACC_OFFSET, values, .. } = &steps[mode - 1] else { panic!("{steps:?}") };
        assert_eq!(
            (values.len(), &values[..4], &values[20..]),
            (22, &[1, 0, 0xFE, 0xFF][..], &[0xE0, 0x01][..])
        );
        assert!(
            steps.contains(&write(ADDRESS, SYS_TRIGGER, 0x80))
                && steps.contains(&write(ADDRESS, UNIT_SEL, 0x02))
        );
    }

    #[test]
    fn a_chip_that_starts_is_waited_for_and_another_one_is_refused() {
        let id = Registers { address: ADDRESS, first: CHIP_ID, length: 1 };
        assert_eq!(chip(Mode::Ndof).learn(id, &[0]).unwrap().last(), Some(&Step::Read(id)));
        assert!(
            chip(Mode::Ndof)
                .learn(id, &[0x68])
                .unwrap_err()
                .contains("says 0x68 (CHIP_ID), which is no BNO055")
        );
        assert!(chip(Mode::Ndof).learn(id, &[]).is_err());
    }

    #[test]
    fn a_fusion_that_stopped_is_noticed_and_nonsense_is_no_orientation() {
        let mut chip = chip(Mode::Ndof);
        let error = chip.read(chip.registers()[0], &registers(0), &mut Reading::default()).unwrap_err();
        assert!(error.contains("SYS_STATUS 0"), "{error}");
        let mut bytes = registers(FUSION_RUNS);
        bytes[usize::from(QUA_DATA - ACC_DATA)..][..8].fill(0);
        let mut reading = Reading::default();
        chip.read(chip.registers()[0], &bytes, &mut reading).unwrap();
        assert_eq!(reading.orientation, None);
        for length in 0..51 {
            let _ = chip.read(chip.registers()[0], &bytes[..length], &mut Reading::default());
        }
    }
}
