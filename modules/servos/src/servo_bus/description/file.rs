//! The form of a description, as TOML has it.

use super::super::joint::Guard;
use super::super::models;
use downbeat_files::toml::Spanned;
use serde::Deserialize;
use std::collections::BTreeMap;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    pub(super) name: String,
    #[serde(default)]
    pub(super) models: Vec<Spanned<String>>,
    #[serde(default)]
    pub(super) bus: Vec<Spanned<BusEntry>>,
    #[serde(default)]
    pub(super) defaults: Defaults,
    #[serde(default)]
    pub(super) joint: Vec<Spanned<JointEntry>>,
    #[serde(default)]
    pub(super) device: Vec<Spanned<DeviceEntry>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BusEntry {
    pub(super) name: String,
    pub(super) port: String,
    pub(super) baud: u32,
    pub(super) protocol: models::ProtocolName,
    pub(super) cycle_ms: f64,
    #[serde(default)]
    pub(super) fast_reads: bool,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Defaults {
    pub(super) bus: Option<Spanned<String>>,
    pub(super) model: Option<Spanned<String>>,
    pub(super) gains: Option<Gains>,
    pub(super) max_torque: Option<f64>,
    pub(super) max_current_a: Option<f64>,
    pub(super) mode: Option<Mode>,
    pub(super) max_velocity_rad_s: Option<f64>,
    pub(super) command_timeout_s: Option<f64>,
    pub(super) approach_rad_s: Option<f64>,
    pub(super) guard: Option<Guard>,
    #[serde(default)]
    pub(super) registers: BTreeMap<String, Spanned<i64>>,
}

/// What the goals of a joint are.
#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Mode {
    #[default]
    Position,
    Velocity,
    Effort,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct JointEntry {
    pub(super) name: String,
    pub(super) id: u8,
    pub(super) bus: Option<Spanned<String>>,
    pub(super) model: Option<Spanned<String>>,
    pub(super) limits: Option<[f64; 2]>,
    pub(super) sign: Option<i64>,
    pub(super) zero: Option<i64>,
    pub(super) offset: Option<i64>,
    pub(super) gear: Option<f64>,
    pub(super) gains: Option<Gains>,
    pub(super) max_torque: Option<f64>,
    pub(super) max_current_a: Option<f64>,
    pub(super) mode: Option<Mode>,
    pub(super) max_velocity_rad_s: Option<f64>,
    pub(super) command_timeout_s: Option<f64>,
    pub(super) approach_rad_s: Option<f64>,
    pub(super) guard: Option<Guard>,
    #[serde(default)]
    pub(super) registers: BTreeMap<String, Spanned<i64>>,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Gains {
    pub(super) p: Option<i64>,
    pub(super) i: Option<i64>,
    pub(super) d: Option<i64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DeviceEntry {
    pub(super) name: String,
    pub(super) id: u8,
    pub(super) bus: Option<Spanned<String>>,
    pub(super) model: Spanned<String>,
    #[serde(default)]
    pub(super) read: Vec<Spanned<String>>,
    pub(super) power: Option<PowerEntry>,
    pub(super) battery: Option<BatteryEntry>,
    pub(super) imu: Option<ImuEntry>,
}

/// Registers of the axes forward, left and up; with a minus in front of those that count against them.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ImuEntry {
    pub(super) angular_velocity: [Spanned<String>; 3],
    pub(super) linear_acceleration: [Spanned<String>; 3],
    pub(super) frame: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PowerEntry {
    pub(super) register: Spanned<String>,
    pub(super) wait_ms: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BatteryEntry {
    pub(super) register: Spanned<String>,
    pub(super) low_v: f64,
}
