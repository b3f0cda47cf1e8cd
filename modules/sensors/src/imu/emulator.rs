//! Emulated inertial sensors, in memory only. No value was measured.
//!
//! The chip turns about its z axis, which points up, by 0.5 rad/s; its registers measure that with noise. The
//! BNO055 also knows its orientation, and its magnetometer feels a field of 40 µT that points down and to its
//! first heading.
//!
//! Not emulated: ranges, filters and rates other than by their registers, calibration, self-tests,
//! interrupts.

use std::sync::Arc;
use std::time::Duration;

use downbeat_executor::{Module, Setup, SetupError};
use downbeat_servos::servo_bus::models::STANDARD_GRAVITY;
use downbeat_servos::servo_emulator::{Fault, Random};
use parking_lot::Mutex;

use super::bus::{Emulated, EmulatedBuses, EmulatedChip};
use super::{bno055, mpu};
use crate::memory::is_memory;

/// How fast the chip turns, in rad/s.
const RATE: f64 = 0.5;
/// The standard deviations of angular velocity in rad/s and of acceleration in m/s².
const NOISE: [f64; 2] = [0.001, 0.03];
/// The field forward and up at the start, in T.
const FIELD: [f64; 2] = [20e-6, -34.6e-6];

/// The models.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Model {
    /// InvenSense MPU-6050.
    #[default]
    Mpu6050,
    /// InvenSense MPU-6500.
    Mpu6500,
    /// InvenSense MPU-9250.
    Mpu9250,
    /// Bosch BNO055.
    Bno055,
}

impl Model {
    /// The names in robot files.
    pub const NAMES: [&str; 4] = ["mpu6050", "mpu6500", "mpu9250", "bno055"];

    /// The model of this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        let position = Self::NAMES.iter().position(|known| *known == name)?;
        [Self::Mpu6050, Self::Mpu6500, Self::Mpu9250, Self::Bno055].get(position).copied()
    }
}

/// An emulated chip of this model.
#[must_use]
pub fn emulated(model: Model, seed: u64) -> Box<dyn EmulatedChip> {
    let motion = Motion { random: Random::new(seed, 9) };
    let mpu = |who_am_i| {
        Box::new(EmulatedMpu {
            motion: motion.clone(),
            who_am_i,
            registers: [0; 256],
            field: [0; 256],
            latched: [0; 14],
        })
    };
    match model {
        Model::Mpu6050 => mpu(0x68),
        Model::Mpu6500 => mpu(0x70),
        Model::Mpu9250 => mpu(0x71),
        Model::Bno055 => Box::new(EmulatedBno { motion, registers: [0; 256], is_running: false }),
    }
}

#[derive(Clone)]
struct Motion {
    random: Random,
}

impl Motion {
    fn angular_velocity(&mut self) -> [f64; 3] {
        [0.0, 0.0, RATE].map(|rate| rate + self.random.normal(NOISE[0]))
    }

    fn acceleration(&mut self) -> [f64; 3] {
        [0.0, 0.0, STANDARD_GRAVITY].map(|acceleration| acceleration + self.random.normal(NOISE[1]))
    }

    fn field(now: Duration) -> [f64; 3] {
        let (sine, cosine) = libm::sincos(RATE * now.as_secs_f64());
        let [forward, up] = FIELD;
        [forward * cosine, -forward * sine, up]
    }
}

fn steps(value: f64) -> i16 {
    // Saturates.
    value.round() as i16
}

struct EmulatedMpu {
    motion: Motion,
    who_am_i: u8,
    registers: [u8; 256],
    /// Those of the magnetometer.
    field: [u8; 256],
    /// The measurement that is being read.
    latched: [u8; 14],
}

impl EmulatedMpu {
    const PWR_MGMT_1: u8 = 0x6B;

    fn is_awake(&self) -> bool {
        self.registers[usize::from(Self::PWR_MGMT_1)] & 0x40 == 0
    }

    fn measure(&mut self) {
        let range = |register: u8| usize::from(self.registers[usize::from(register)] >> 3 & 0b11);
        let per_g = mpu::ACCELERATION_RANGES[range(0x1C)].1;
        let per_degree = mpu::GYRO_RANGES[range(0x1B)].1;
        let acceleration = self.motion.acceleration().map(|value| steps(value / STANDARD_GRAVITY * per_g));
        let rate = self.motion.angular_velocity().map(|value| steps(value.to_degrees() * per_degree));
        // 25 °C of the MPU-6050.
        let all = [&acceleration[..], &[steps((25.0 - 36.53) * 340.0)], &rate].concat();
        for (latched, byte) in self.latched.iter_mut().zip(all.iter().flat_map(|number| number.to_be_bytes()))
        {
            *latched = byte;
        }
    }
}

impl EmulatedChip for EmulatedMpu {
    fn write(&mut self, address: u8, register: u8, value: u8, _now: Duration) -> bool {
        match address {
            mpu::ADDRESS if register == Self::PWR_MGMT_1 && value & 0x80 != 0 => {
                self.registers = [0; 256];
                self.registers[usize::from(Self::PWR_MGMT_1)] = 0x40;
            }
            mpu::ADDRESS => self.registers[usize::from(register)] = value,
            // Behind the other chip until that lets it on the bus.
            mpu::MAGNETOMETER if self.who_am_i == 0x71 && self.registers[0x37] & 0x02 != 0 => {
                self.field[usize::from(register)] = value;
            }
            _ => return false,
        }
        true
    }

    fn read(&mut self, address: u8, register: u8, now: Duration) -> Option<u8> {
        match (address, register) {
            (mpu::ADDRESS, 0x75) => Some(self.who_am_i),
            (mpu::ADDRESS, 0x3B..=0x48) if !self.is_awake() => Some(0),
            (mpu::ADDRESS, 0x3B..=0x48) => {
                if register == 0x3B {
                    self.measure();
                }
                self.latched.get(usize::from(register - 0x3B)).copied()
            }
            (mpu::ADDRESS, _) => self.registers.get(usize::from(register)).copied(),
            (mpu::MAGNETOMETER, _) if self.who_am_i != 0x71 || self.registers[0x37] & 0x02 == 0 => None,
            (mpu::MAGNETOMETER, 0x00) => Some(0x48),
            (mpu::MAGNETOMETER, 0x02) => Some(0x01),
            (mpu::MAGNETOMETER, 0x03..=0x08) => {
                let [x, y, z] = Motion::field(now).map(|tesla| steps(tesla / 0.15e-6));
                // Its axes are others.
                let numbers = [y, x, -z].map(i16::to_le_bytes).concat();
                numbers.get(usize::from(register - 0x03)).copied()
            }
            (mpu::MAGNETOMETER, 0x10..=0x12) => Some(128),
            (mpu::MAGNETOMETER, _) => self.field.get(usize::from(register)).copied(),
            _ => None,
        }
    }
}

struct EmulatedBno {
    motion: Motion,
    registers: [u8; 256],
    is_running: bool,
}

impl EmulatedBno {
    fn measure(&mut self, now: Duration) {
        let scaled = |vector: [f64; 3], scale: f64| vector.map(|value| steps(value * scale));
        let (z, w) = libm::sincos(RATE * now.as_secs_f64() / 2.0);
        let quaternion = [w, 0.0, 0.0, z].map(|value| steps(value * 16384.0));
        let acceleration = scaled(self.motion.acceleration(), 100.0);
        let rate = scaled(self.motion.angular_velocity(), 900.0);
        let field = scaled(Motion::field(now), 16e6);
        let mut put = |register: usize, numbers: &[i16]| {
            let bytes = numbers.iter().flat_map(|number| number.to_le_bytes());
            self.registers.iter_mut().skip(register).zip(bytes).for_each(|(register, byte)| *register = byte);
        };
        put(0x08, &acceleration);
        put(0x0E, &field);
        put(0x14, &rate);
        put(0x20, &quaternion);
        self.registers[0x34] = 25;
        self.registers[0x35] = 0xFF;
        self.registers[0x39] = if self.is_running { 5 } else { 0 };
    }
}

impl EmulatedChip for EmulatedBno {
    fn write(&mut self, address: u8, register: u8, value: u8, _now: Duration) -> bool {
        if address != bno055::ADDRESS {
            return false;
        }
        self.registers[usize::from(register)] = value;
        if register == 0x3D {
            self.is_running = value >= 0x08;
        }
        true
    }

    fn read(&mut self, address: u8, register: u8, now: Duration) -> Option<u8> {
        if address != bno055::ADDRESS {
            return None;
        }
        if register == 0x08 {
            self.measure(now);
        }
        if register == 0x00 { Some(0xA0) } else { self.registers.get(usize::from(register)).copied() }
    }
}

/// An emulated inertial sensor, so that [`Imu`](super::Imu) finds a bus.
///
/// Settings: `model`; `link`, a bus in memory; `seed`; `faults`. It has no topics: everything goes through
/// the bus. Leave it out of replays.
#[derive(Default)]
pub struct ImuEmulator {
    buses: EmulatedBuses,
    offered: Option<Arc<Mutex<Emulated>>>,
}

impl ImuEmulator {
    /// An emulator that can be among these buses in memory.
    #[must_use]
    pub fn new(buses: EmulatedBuses) -> Self {
        Self { buses, offered: None }
    }
}

impl Module for ImuEmulator {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let model = setup.read_only_choice("model", "mpu6050", &Model::NAMES, "which chip is emulated")?;
        let about = "memory:NAME; the sensor module's setting \"bus\" is the same";
        let link = setup.read_only_setting("link", "memory:imu".to_owned(), about)?;
        let seed = setup.read_only_setting("seed", 1_i64, "same seed, same noise and faults")?;
        let about = "what goes wrong, such as drop:0.01 (no answer), close-port@8s..9s (the wires are out)";
        let faults = setup.read_only_setting("faults", Vec::<String>::new(), about)?;
        let name = setup.value(link).cloned().unwrap_or_default();
        if !is_memory(&name) {
            return Err(setup.refuse_value(link, "an emulated I²C bus is in memory: it is memory:NAME"));
        }
        let model = setup.value(model).and_then(|name| Model::named(name)).unwrap_or_default();
        // Negative seeds are valid.
        let seed = setup.value(seed).copied().unwrap_or_default().cast_unsigned();
        let texts = setup.value(faults).map_or(&[][..], Vec::as_slice);
        let parsed: Result<Vec<Fault>, _> =
            texts.iter().map(|text| text.parse::<Fault>()?.check(|_| false)).collect();
        let faults = parsed.map_err(|error| setup.refuse_value(faults, error.to_string()))?;
        let offered = self.buses.offer(&name, Emulated::new(emulated(model, seed), faults, seed));
        self.offered = Some(offered.map_err(|error| setup.refuse_value(link, error.to_string()))?);
        Ok(())
    }
}
