//! A joint and its servo: conversions, limits, and thresholds of its guard.

use super::models::{Access, Model, Register};
use super::protocol::{Id, Protocol};
use serde::Deserialize;
use std::f64::consts::TAU;
use std::sync::Arc;
use std::time::Duration;

/// One joint and the servo that turns it.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Its name in ROS.
    pub name: String,
    /// The file and line that declare it; `None` if it is built in.
    pub declared_at: Option<String>,
    /// The address of its servo.
    pub id: Id,
    /// The model of its servo.
    pub model: Arc<Model>,
    /// The registers of the model that the driver uses.
    pub registers: Registers,
    /// How it is driven by velocities or efforts; `None` if its goals are positions.
    pub drive: Option<Drive>,
    /// The raw position at 0 rad.
    pub zero: i64,
    /// 1, or -1 if the servo counts against the joint.
    pub sign: f64,
    /// Turns of the servo for one turn of the joint.
    pub gear: f64,
    /// The smallest angle, in rad.
    pub min_rad: f64,
    /// The largest angle, in rad.
    pub max_rad: f64,
    /// D, I, P; `None` leaves the gain as it is in the servo.
    pub gains: [Option<i64>; 3],
    /// The largest torque, as a share of what the servo can do; `None` leaves it as it is in the servo.
    pub max_torque: Option<f64>,
    /// The largest current, in A; `None` leaves it as it is in the servo.
    pub max_current_a: Option<f64>,
    /// Further registers that are set when the servo comes into service, with raw values.
    pub further: Vec<(Register, i64)>,
    /// How far the goal moves in one cycle while the joint approaches its first command, in raw steps.
    pub approach_steps: i64,
    /// By how much the stamp of a command may lie in the past or the future.
    pub command_timeout: Duration,
    /// When the joint is protected.
    pub guard: Guard,
}

/// How a joint is driven by goals other than positions.
#[derive(Clone, Debug, PartialEq)]
pub struct Drive {
    /// What its goals are.
    pub quantity: Quantity,
    /// The register of the goal.
    pub goal: Register,
    /// The largest goal of the joint, in either direction: in rad/s or A.
    pub largest: f64,
    /// How long a command is valid. After that the goal is 0.
    pub timeout: Duration,
}

/// What the goals of a [`Drive`] are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Velocities of the joint, in rad/s.
    Velocity,
    /// Currents of its servo, in A, positive towards larger angles.
    Effort,
}

/// The registers of a servo that the driver uses.
#[derive(Clone, Debug, PartialEq)]
pub struct Registers {
    /// `present_position`.
    pub position: Register,
    /// `goal_position`.
    pub goal: Register,
    /// `torque_enable`.
    pub torque: Register,
    /// `present_velocity`.
    pub velocity: Option<Register>,
    /// `present_load` (share of the drive), or `present_current` (A).
    pub effort: Option<Register>,
    /// `present_voltage`.
    pub voltage: Option<Register>,
    /// `present_temperature`.
    pub temperature: Option<Register>,
    /// `d_gain`, `i_gain`, `p_gain`.
    pub gains: [Option<Register>; 3],
    /// `torque_limit`.
    pub torque_limit: Option<Register>,
    /// `current_limit`.
    pub current_limit: Option<Register>,
}

impl Registers {
    /// Finds the registers of a model.
    ///
    /// # Errors
    /// Returns an error if the model has no goal or no position, or the two have different units.
    pub fn of(model: &Model) -> Result<Self, String> {
        let optional = |name: &str| model.register(name).cloned();
        let needed = |name: &str| optional(name).ok_or_else(|| format!("it has no register \"{name}\""));
        let near_position = |names: [&str; 2]| names.into_iter().find_map(optional);
        let registers = Self {
            position: needed("present_position")?,
            goal: needed("goal_position")?,
            torque: needed("torque_enable")?,
            velocity: optional("present_velocity"),
            effort: near_position(["present_load", "present_current"]),
            voltage: optional("present_voltage"),
            temperature: optional("present_temperature"),
            gains: ["d_gain", "i_gain", "p_gain"].map(optional),
            torque_limit: optional("torque_limit").filter(|register| register.access == Access::Ram),
            current_limit: optional("current_limit"),
        };
        let same = registers.goal.to_si(1).to_bits() == registers.position.to_si(1).to_bits();
        if registers.goal.unit != "rad" || !same {
            return Err("goal_position and present_position need the same unit, a part of a turn".to_owned());
        }
        Ok(registers)
    }

    /// The range that is read in every cycle: first address and length.
    #[must_use]
    pub fn span(&self) -> (u16, u16) {
        let rest = [&self.velocity, &self.effort, &self.voltage, &self.temperature];
        let read = || std::iter::once(&self.position).chain(rest.into_iter().flatten());
        let first = read().map(|register| register.address).min().unwrap_or(0);
        let end = read().map(Register::end).max().unwrap_or(0);
        (first, end - first)
    }
}

/// The data of a servo in one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measurement {
    /// The raw position.
    pub position: i64,
    /// Of the joint, in rad/s.
    pub velocity: f64,
    /// Of the joint, as a share of the drive or in A.
    pub effort: f64,
    /// In V.
    pub voltage: Option<f64>,
    /// In degrees Celsius.
    pub celsius: Option<f64>,
}

impl Joint {
    /// The angle of a raw position, in rad.
    #[must_use]
    pub fn angle(&self, raw: i64) -> f64 {
        self.sign * self.registers.position.to_si(raw - self.zero) / self.gear
    }

    /// The raw goal for an angle, which is clamped to the limits. `None` if the angle is not finite, or more
    /// than a turn beyond the limits: that is a mistake of the sender, for example an angle in degrees.
    #[must_use]
    pub fn goal(&self, angle_rad: f64) -> Option<i64> {
        if !(self.min_rad - TAU..=self.max_rad + TAU).contains(&angle_rad) {
            return None;
        }
        let goal = &self.registers.goal;
        Some(self.steps(angle_rad.clamp(self.min_rad, self.max_rad)).clamp(goal.min, goal.max))
    }

    /// The raw goal for a velocity or effort, which is clamped to the largest one. `None` if it is not
    /// finite, or more than ten times the largest: that is a mistake of the sender.
    #[must_use]
    pub fn driven_goal(&self, drive: &Drive, value: f64) -> Option<i64> {
        if !(-10.0 * drive.largest..=10.0 * drive.largest).contains(&value) {
            return None;
        }
        let gear = if drive.quantity == Quantity::Velocity { self.gear } else { 1.0 };
        let steps = drive.goal.steps(value.clamp(-drive.largest, drive.largest) * self.sign * gear);
        // Towards 0, so that no goal exceeds the largest one.
        Some((steps.trunc() as i64).clamp(drive.goal.min, drive.goal.max))
    }

    /// The register that goals are written to.
    #[must_use]
    pub fn goal_register(&self) -> &Register {
        self.drive.as_ref().map_or(&self.registers.goal, |drive| &drive.goal)
    }

    /// Returns whether this goal of a drive leads out of the limits, where the joint is already.
    pub(crate) fn leads_out(&self, goal: i64, raw_position: i64) -> bool {
        let (angle, direction) = (self.angle(raw_position), goal as f64 * self.sign);
        (direction > 0.0 && angle >= self.max_rad) || (direction < 0.0 && angle <= self.min_rad)
    }

    /// The nearest raw position to an angle, in or out of reach.
    pub(crate) fn steps(&self, angle_rad: f64) -> i64 {
        self.registers.goal.steps(angle_rad * self.sign * self.gear).round() as i64 + self.zero
    }

    /// The raw range of the goals.
    #[must_use]
    pub fn goal_range(&self) -> [i64; 2] {
        let goal = &self.registers.goal;
        let ends = [self.min_rad, self.max_rad].map(|limit| self.steps(limit).clamp(goal.min, goal.max));
        [ends[0].min(ends[1]), ends[0].max(ends[1])]
    }

    /// Parses the range that is read in every cycle.
    #[must_use]
    pub fn measurement(&self, protocol: Protocol, piece: &[u8]) -> Option<Measurement> {
        let (first, length) = self.registers.span();
        if piece.len() != usize::from(length) {
            return None;
        }
        let raw = |register: &Register| register.raw_in(protocol, piece, first);
        let si = |register: &Option<Register>| {
            let register = register.as_ref()?;
            Some(register.to_si(raw(register)?))
        };
        Some(Measurement {
            position: raw(&self.registers.position)?,
            velocity: si(&self.registers.velocity)
                .map_or(f64::NAN, |velocity| self.sign * velocity / self.gear),
            effort: si(&self.registers.effort).map_or(f64::NAN, |effort| self.sign * effort),
            voltage: si(&self.registers.voltage),
            celsius: si(&self.registers.temperature),
        })
    }
}

/// Thresholds of temperature and voltage, and what follows a shutdown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Guard {
    /// In degrees Celsius: protection above these.
    pub temperature_c: Option<Thresholds>,
    /// In V: protection below these.
    pub voltage_v: Option<Thresholds>,
    /// For how long a servo rests that has switched itself off for overload or heat, in s from when it is
    /// cool, until it gets its torque again; without, it stays off until its torque is commanded.
    pub shutdown_rest_s: Option<f64>,
}

/// Where protection begins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Thresholds {
    /// Reported.
    pub warn: Option<f64>,
    /// The joint gets half its torque.
    pub soften: Option<f64>,
    /// The joint loses its torque, until it is switched on again.
    pub off: Option<f64>,
}

/// What a guard demands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Protection {
    /// Nothing.
    #[default]
    None,
    /// A report.
    Warn,
    /// Half the torque.
    Soften,
    /// No torque.
    Off,
}

impl Guard {
    /// What these measurements demand.
    #[must_use]
    pub fn demand(&self, measurement: &Measurement) -> Protection {
        let demand = |thresholds: Option<Thresholds>, value: Option<f64>, sign: f64| {
            let (Some(thresholds), Some(value)) = (thresholds, value) else { return Protection::None };
            let beyond =
                |threshold: Option<f64>| threshold.is_some_and(|threshold| sign * value >= sign * threshold);
            match thresholds {
                Thresholds { off, .. } if beyond(off) => Protection::Off,
                Thresholds { soften, .. } if beyond(soften) => Protection::Soften,
                Thresholds { warn, .. } if beyond(warn) => Protection::Warn,
                _ => Protection::None,
            }
        };
        let hot = demand(self.temperature_c, measurement.celsius, 1.0);
        hot.max(demand(self.voltage_v, measurement.voltage, -1.0))
    }

    /// Returns whether the torque may have to be lowered.
    #[must_use]
    pub fn softens(&self) -> bool {
        [self.temperature_c, self.voltage_v]
            .into_iter()
            .flatten()
            .any(|thresholds| thresholds.soften.is_some())
    }

    /// Checks that the thresholds are in order.
    pub(super) fn check(&self) -> Result<(), String> {
        for (what, thresholds, sign) in
            [("temperature_c", self.temperature_c, 1.0), ("voltage_v", self.voltage_v, -1.0)]
        {
            let Some(Thresholds { warn, soften, off }) = thresholds else { continue };
            let given: Vec<f64> = [warn, soften, off].into_iter().flatten().collect();
            let ordered = given.windows(2).all(|pair| sign * pair[0] < sign * pair[1]);
            if !ordered || !given.iter().all(|threshold| threshold.is_finite()) {
                return Err(format!(
                    "has a guard whose {what} are not in order: warn comes before soften, and soften before off"
                ));
            }
        }
        match self.shutdown_rest_s {
            Some(rest) if !(0.1..=3600.0).contains(&rest) => {
                Err(format!("has a guard with the shutdown_rest_s {rest}: from 0.1 to 3600"))
            }
            _ => Ok(()),
        }
    }
}
