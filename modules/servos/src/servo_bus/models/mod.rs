//! Models of servos and other devices: their control tables, as data.
//!
//! The built-in models are the TOML files beside this one; a robot can bring further ones in the same form:
//!
//! ```toml
//! name = "MX-28"
//! number = 29                      # the value of model_number; not checked if left out
//! protocols = ["dynamixel1"]
//! source = "manual, or repository and path"
//! reads = "bulk"                   # how several are read at once: "bulk", "sync" or "one_by_one"
//! at_start = { return_delay = 0 }  # written when a servo comes into service: raw values
//! modes = { velocity = 1 }         # values of operating_mode for goals other than positions: velocity, effort
//! baud_rates = [[1, 1_000_000]]    # value of the register baud_rate, bit/s
//!
//! [registers]
//! goal_position = { at = 30, size = 2, max = 4095, unit = "turn", per = 4096 }
//! ```
//!
//! A register has an address `at`, a `size` of 1, 2 or 4 bytes (1), an `access` (`"ram"`; `"eeprom"` if it
//! outlives the power, `"read"` if only the device writes it), `signed = true` (two's complement) or a
//! `sign_bit`, the raw values `min`, `max` and `initial`, and a unit: raw × `scale` / `per` in `"turn"`,
//! `"rpm"`, `"dps"`, `"g"`, `"V"`, `"A"`, `"N"`, `"degC"`, `"s"` or `"1"`. Values are published in SI units:
//! rad for turns, rad/s for rpm and degrees per second, m/s^2 for g.
//!
//! The modules find registers by name. A servo needs `model_number`, `id`, `torque_enable`, `goal_position`
//! and `present_position`; it may have `firmware_version`, `baud_rate`, `return_delay`,
//! `status_return_level`, `p_gain`, `i_gain`, `d_gain`, `torque_limit`, `current_limit`,
//! `min_position_limit`, `max_position_limit`, `present_velocity`, `operating_mode`, `goal_velocity`,
//! `velocity_limit`, `goal_current`, `bus_watchdog`, `present_load` or `present_current`, `present_voltage`,
//! `present_temperature`, `lock`.

use super::protocol::Protocol;
use downbeat_files::lines::line_of;
/// Why a text is not a model.
pub use downbeat_files::toml::Problem as ModelError;
use downbeat_files::toml::{self, Spanned};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use std::sync::{Arc, LazyLock};

/// Standard gravity, in m/s^2.
pub const STANDARD_GRAVITY: f64 = 9.806_65;

/// A kind of device.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// The name in descriptions.
    pub name: String,
    /// The value of its register `model_number`; `None` if it is not checked.
    pub number: Option<u16>,
    /// The protocols that it speaks.
    pub protocols: Vec<Protocol>,
    /// Where the table comes from.
    pub source: String,
    /// The oldest firmware with this table.
    pub oldest_firmware: Option<i64>,
    /// How several of them are read at once.
    pub reads: Reads,
    /// Whether EEPROM can be written only while the torque is disabled.
    pub eeprom_needs_torque_off: bool,
    /// The registers that are set when a servo comes into service, with raw values, in the order of their
    /// addresses.
    pub at_start: Vec<(Register, i64)>,
    /// How it is driven by goals other than positions.
    pub modes: Modes,
    /// Values of the register `baud_rate`, and what they mean in bit/s.
    pub baud_rates: Vec<(i64, u32)>,
    /// Its registers, in the order of their addresses.
    pub registers: Vec<Register>,
}

/// The values of the register `operating_mode` for goals other than positions; `None` if the model has no
/// such mode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Modes {
    /// The goal is `goal_velocity`, in rad/s.
    pub velocity: Option<i64>,
    /// The goal is `goal_current`, in A.
    pub effort: Option<i64>,
}

/// How several devices of a model are read at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reads {
    /// By a bulk read: different ranges of each device.
    Bulk,
    /// By a sync read, and in Dynamixel 2.0 a bulk read together with other models.
    Sync,
    /// Not at all: the model answers only reads of one device.
    OneByOne,
}

/// Whether a register can be changed, and whether it is persistent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Access {
    /// Only by the device itself.
    Read,
    /// By anyone; lost without power.
    #[default]
    Ram,
    /// By anyone; kept without power.
    Eeprom,
}

/// How a register represents negative numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sign {
    /// There are none.
    Unsigned,
    /// As two's complement.
    TwosComplement,
    /// By a magnitude below this bit, and this bit set.
    Bit(u32),
}

/// One entry of a control table.
#[derive(Clone, Debug, PartialEq)]
pub struct Register {
    /// Its name.
    pub name: String,
    /// Its address.
    pub address: u16,
    /// Its size in bytes: 1, 2 or 4.
    pub size: u16,
    /// Whether it can be changed.
    pub access: Access,
    /// How it represents negative numbers.
    pub sign: Sign,
    /// The smallest raw value that may be written.
    pub min: i64,
    /// The largest raw value that may be written.
    pub max: i64,
    /// The raw value of a new device, or after switching on.
    pub initial: i64,
    /// The unit of [`to_si`](Self::to_si): "rad", "rad/s", "m/s^2", "V", "A", "N", "degC", "s", "1", or empty
    /// for raw values.
    pub unit: &'static str,
    /// A raw value times `factor` divided by `per` is in SI units.
    factor: f64,
    per: f64,
}

/// The built-in models.
pub fn built_in() -> &'static [Arc<Model>] {
    &BUILT_IN
}

static BUILT_IN: LazyLock<Vec<Arc<Model>>> = LazyLock::new(|| {
    let texts = [
        include_str!("mx_28.toml"),
        include_str!("ax_12a.toml"),
        include_str!("xm430_w350.toml"),
        include_str!("xl330_m288.toml"),
        include_str!("sts3215.toml"),
        include_str!("cm_730.toml"),
        include_str!("fsr.toml"),
        include_str!("open_cr.toml"),
    ];
    // A test parses all of them.
    texts.iter().filter_map(|text| Model::parse(text).ok().map(Arc::new)).collect()
});

/// The built-in model with this name, without regard to case.
#[must_use]
pub fn find(name: &str) -> Option<&'static Arc<Model>> {
    BUILT_IN.iter().find(|model| model.name.eq_ignore_ascii_case(name))
}

impl Model {
    /// Parses a model file.
    ///
    /// # Errors
    /// Returns an error with the line if the text is not TOML of the form in [the module](self), or registers
    /// overlap.
    pub fn parse(text: &str) -> Result<Self, ModelError> {
        let file: ModelFile = toml::parse(text)?;
        let mut registers = Vec::new();
        for (name, entry) in file.registers {
            let line = line_of(text, entry.span().start);
            let register =
                entry.into_inner().register(name).map_err(|problem| ModelError { line, problem })?;
            registers.push((line, register));
        }
        registers.sort_by_key(|(_, register)| register.address);
        for pair in registers.windows(2) {
            let [(_, before), (line, after)] = pair else { continue };
            if before.end() > after.address {
                let problem = format!("\"{}\" overlaps \"{}\"", after.name, before.name);
                return Err(ModelError { line: *line, problem });
            }
        }
        let registers: Vec<Register> = registers.into_iter().map(|(_, register)| register).collect();
        let mut at_start = Vec::new();
        for (name, value) in file.at_start {
            let line = line_of(text, value.span().start);
            let register = registers.iter().find(|register| register.name == name);
            let register = register.ok_or_else(|| ModelError {
                line,
                problem: format!("at_start: there is no register \"{name}\""),
            })?;
            if ["torque_enable", "goal_position"].contains(&&*name) {
                let problem =
                    format!("at_start: \"{name}\" is set by the driver, when the position is known");
                return Err(ModelError { line, problem });
            }
            at_start.push((register.clone(), value.into_inner()));
        }
        at_start.sort_by_key(|(register, _)| register.address);
        Ok(Self {
            name: file.name,
            number: file.number,
            protocols: file.protocols.into_iter().map(|protocol| protocol.0).collect(),
            source: file.source,
            oldest_firmware: file.oldest_firmware,
            reads: file.reads,
            eeprom_needs_torque_off: file.eeprom_needs_torque_off,
            at_start,
            modes: file.modes,
            baud_rates: file.baud_rates,
            registers,
        })
    }

    /// The register with this name.
    #[must_use]
    pub fn register(&self, name: &str) -> Option<&Register> {
        self.registers.iter().find(|register| register.name == name)
    }

    /// The size of the table in bytes.
    #[must_use]
    pub fn length(&self) -> u16 {
        self.registers.last().map_or(0, Register::end)
    }
}

impl Register {
    /// The address after it.
    #[must_use]
    pub fn end(&self) -> u16 {
        self.address + self.size
    }

    /// Its raw value in a part of the control table that starts at `first`; `None` if it is not in that part.
    #[must_use]
    pub fn raw_in(&self, protocol: Protocol, piece: &[u8], first: u16) -> Option<i64> {
        let start = usize::from(self.address.checked_sub(first)?);
        let bytes = piece.get(start..start + usize::from(self.size))?;
        let append = |value: u32, byte: &u8| value << 8 | u32::from(*byte);
        let unsigned = if protocol.is_big_endian() {
            bytes.iter().fold(0, append)
        } else {
            bytes.iter().rev().fold(0, append)
        };
        Some(match self.sign {
            Sign::Unsigned => i64::from(unsigned),
            Sign::TwosComplement => {
                let unused = 32 - 8 * u32::from(self.size);
                i64::from((unsigned << unused).cast_signed() >> unused)
            }
            Sign::Bit(bit) => {
                let magnitude = i64::from(unsigned & ((1 << bit) - 1));
                if unsigned >> bit & 1 == 0 { magnitude } else { -magnitude }
            }
        })
    }

    /// The bytes of a raw value, which is clamped to what the register can represent.
    #[must_use]
    pub fn bytes(&self, protocol: Protocol, raw: i64) -> Vec<u8> {
        let bits = 8 * u32::from(self.size);
        let unsigned = match self.sign {
            Sign::Unsigned => raw.clamp(0, (1 << bits) - 1),
            Sign::TwosComplement => raw.clamp(-(1 << (bits - 1)), (1 << (bits - 1)) - 1),
            Sign::Bit(bit) => {
                let magnitude = raw.abs().min((1 << bit) - 1);
                if raw < 0 { magnitude | 1 << bit } else { magnitude }
            }
        };
        let mut bytes = unsigned.to_le_bytes()[..usize::from(self.size)].to_vec();
        if protocol.is_big_endian() {
            bytes.reverse();
        }
        bytes
    }

    /// A raw value in the unit of the register.
    #[must_use]
    pub fn to_si(&self, raw: i64) -> f64 {
        raw as f64 * self.factor / self.per
    }

    /// The nearest raw value to a value in the unit of the register, within `min` and `max`.
    #[must_use]
    pub fn from_si(&self, value: f64) -> i64 {
        ((value * self.per / self.factor).round() as i64).clamp(self.min, self.max)
    }

    /// The number of raw steps, not rounded, of a value in the unit of the register.
    pub(crate) fn steps(&self, value: f64) -> f64 {
        value * self.per / self.factor
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ModelFile {
    name: String,
    number: Option<u16>,
    protocols: Vec<ProtocolName>,
    source: String,
    oldest_firmware: Option<i64>,
    reads: Reads,
    #[serde(default)]
    eeprom_needs_torque_off: bool,
    #[serde(default)]
    at_start: BTreeMap<String, Spanned<i64>>,
    #[serde(default)]
    modes: Modes,
    #[serde(default)]
    baud_rates: Vec<(i64, u32)>,
    registers: BTreeMap<String, Spanned<RegisterEntry>>,
}

/// A protocol by its key.
#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "String")]
pub(super) struct ProtocolName(pub(super) Protocol);

impl TryFrom<String> for ProtocolName {
    type Error = super::protocol::UnknownProtocol;

    fn try_from(key: String) -> Result<Self, Self::Error> {
        key.parse().map(Self)
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RegisterEntry {
    at: u16,
    #[serde(default = "one_byte")]
    size: u16,
    #[serde(default)]
    access: Access,
    #[serde(default)]
    signed: bool,
    sign_bit: Option<u32>,
    #[serde(default)]
    initial: i64,
    min: Option<i64>,
    max: Option<i64>,
    unit: Option<String>,
    scale: Option<f64>,
    per: Option<f64>,
}

fn one_byte() -> u16 {
    1
}

impl RegisterEntry {
    fn register(self, name: String) -> Result<Register, String> {
        if ![1, 2, 4].contains(&self.size) {
            return Err(format!("\"{name}\" has {} bytes, a register has 1, 2 or 4", self.size));
        }
        let bits = 8 * u32::from(self.size);
        if self.at > 4096 {
            return Err(format!("\"{name}\" is at {}, the last address is 4096", self.at));
        }
        let sign = match (self.signed, self.sign_bit) {
            (false, None) => Sign::Unsigned,
            (true, None) => Sign::TwosComplement,
            (false, Some(bit)) if bit < bits => Sign::Bit(bit),
            _ => return Err(format!("\"{name}\": give signed = true, or a sign_bit below {bits}")),
        };
        let (least, most) = match sign {
            Sign::Unsigned => (0, (1_i64 << bits) - 1),
            Sign::TwosComplement => (-(1_i64 << (bits - 1)), (1_i64 << (bits - 1)) - 1),
            Sign::Bit(bit) => (1 - (1_i64 << bit), (1_i64 << bit) - 1),
        };
        let (min, max) = (self.min.unwrap_or(least), self.max.unwrap_or(most));
        if min < least || max > most || min > max {
            return Err(format!(
                "\"{name}\": min {min} and max {max} must be in order, from {least} to {most}"
            ));
        }
        let (scale, per) = (self.scale.unwrap_or(1.0), self.per.unwrap_or(1.0));
        let (unit, factor) = match self.unit.as_deref() {
            None => ("", scale),
            Some("turn") if name.ends_with("velocity") => ("rad/s", scale * TAU),
            Some("turn") => ("rad", scale * TAU),
            Some("rpm") => ("rad/s", scale * TAU / 60.0),
            Some("dps") => ("rad/s", scale * (PI / 180.0)),
            Some("g") => ("m/s^2", scale * STANDARD_GRAVITY),
            Some("V") => ("V", scale),
            Some("A") => ("A", scale),
            Some("N") => ("N", scale),
            Some("degC") => ("degC", scale),
            Some("s") => ("s", scale),
            Some("1") => ("1", scale),
            Some(unit) => {
                return Err(format!(
                    "\"{name}\": unknown unit \"{unit}\"; there are turn, rpm, dps, g, V, A, N, degC, s and 1"
                ));
            }
        };
        if !(factor.is_finite() && per.is_finite()) || factor <= 0.0 || per <= 0.0 {
            return Err(format!("\"{name}\": scale and per must be above 0"));
        }
        let (address, size) = (self.at, self.size);
        Ok(Register {
            name,
            address,
            size,
            access: self.access,
            sign,
            min,
            max,
            initial: self.initial,
            unit,
            factor,
            per,
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    const ONE: Protocol = Protocol::Dynamixel1;

    fn register(model: &str, name: &str) -> Register {
        find(model).unwrap().register(name).unwrap().clone()
    }

    #[test]
    fn all_built_in_models_are_valid() {
        assert_eq!(built_in().len(), 8, "the file of one is invalid");
        for model in built_in() {
            for register in &model.registers {
                assert!(
                    (register.min..=register.max).contains(&register.initial),
                    "{} {}",
                    model.name,
                    register.name
                );
            }
        }
    }

    #[test]
    fn values_of_the_manuals_are_converted() {
        let near = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-3, "{found} {expected}");
        near(register("XM430-W350", "present_velocity").to_si(200), 200.0 * 0.229 * 0.104_72);
        near(register("XM430-W350", "present_current").to_si(1193), 3.209);
        near(register("AX-12A", "goal_position").to_si(1023), 300_f64.to_radians());
        near(register("STS3215", "present_velocity").to_si(4096), TAU);
        assert_eq!(
            register("XM430-W350", "present_position").raw_in(ONE, &[0xFE, 0xFF, 0xFF, 0xFF], 132),
            Some(-2)
        );
    }

    #[test]
    fn scs_servos_have_the_high_byte_first() {
        let position = register("STS3215", "present_position");
        assert_eq!(position.raw_in(Protocol::FeetechSts, &[0x34, 0x02], 56), Some(0x234));
        assert_eq!(position.raw_in(Protocol::FeetechScs, &[0x02, 0x34], 56), Some(0x234));
        assert_eq!(position.bytes(Protocol::FeetechScs, 0x234), [0x02, 0x34]);
    }

    #[test]
    fn a_broken_model_is_refused_with_its_line() {
        let model = |registers: &str| {
            let text = format!(
                "name = \"X\"\nprotocols = [\"dynamixel1\"]\nsource = \"\"\nreads = \"bulk\"\n[registers]\n{registers}"
            );
            Model::parse(&text).unwrap_err().to_string()
        };
        assert_eq!(model("a = { at = 0, size = 3 }"), "line 6: \"a\" has 3 bytes, a register has 1, 2 or 4");
        assert_eq!(model("a = { at = 0, size = 2 }\nb = { at = 1 }"), "line 7: \"b\" overlaps \"a\"");
        assert!(model("a = { at = 0, unit = \"foot\" }").contains("unknown unit \"foot\""));
        assert!(model("a = { at = 0, length = 2 }").contains("unknown field `length`"));
        assert!(model("a = { at = 0, per = 0.0 }").contains("must be above 0"));
    }

    proptest! {
        #[test]
        fn raw_values_survive_a_round_trip(raw in -70_000..70_000_i64) {
            for model in built_in() {
                for register in &model.registers {
                    for protocol in Protocol::ALL {
                        let raw = raw.clamp(register.min, register.max);
                        let bytes = register.bytes(protocol, raw);
                        prop_assert_eq!(register.raw_in(protocol, &bytes, register.address), Some(raw), "{}", register.name);
                    }
                }
            }
        }
    }
}
