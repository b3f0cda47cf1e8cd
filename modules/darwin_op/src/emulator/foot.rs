//! A foot with force sensors.

use crate::hardware::bus::LineSettings;
use crate::hardware::protocol::Id;
use downbeat_servos::servo_bus::models;
use downbeat_servos::servo_emulator::Unit;

/// Below this a sensor measures nothing, in N.
const LEAST_N: f64 = 0.493;
/// The raw centre of pressure in the middle of the foot, and without load.
const MIDDLE: f64 = 127.0;
const NO_LOAD: i64 = 255;

pub(super) struct Foot {
    pub(super) unit: Unit,
    pub(super) id: Id,
    pub(super) is_dead: bool,
}

impl Foot {
    pub(super) fn new(id: Id) -> Self {
        // It is built in.
        let Some(model) = models::find("FSR") else { unreachable!() };
        Self { unit: Unit::new(model, id, LineSettings::default(), None), id, is_dead: false }
    }

    /// Measures the forces on its corners, in N: front left, front right, rear left, rear right. The manual
    /// does not say which sensor is where; this order is assumed.
    pub(super) fn feel(&mut self, corners: [f64; 4]) {
        let forces = corners.map(|force| if force < LEAST_N { 0.0 } else { force });
        for (name, force) in ["fsr_1", "fsr_2", "fsr_3", "fsr_4"].iter().zip(forces) {
            self.unit.set_named(name, (force * 1000.0).round() as i64);
        }
        let [front_left, front_right, rear_left, rear_right] = forces;
        let total: f64 = forces.iter().sum();
        let centre = |one: f64, other: f64| match total {
            0.0 => NO_LOAD,
            _ => (MIDDLE + MIDDLE * (one - other) / total).round() as i64,
        };
        self.unit.set_named("fsr_x", centre(front_left + front_right, rear_left + rear_right));
        self.unit.set_named("fsr_y", centre(front_left + rear_left, front_right + rear_right));
    }
}
