//! Answers from the devices.

use super::packet::{HEADER_2, crc16, emit_packet};
use super::{EmitError, Id, Packet, Protocol};
use std::fmt;
use std::ops::{BitOr, BitOrAssign};

/// The code of every answer in Dynamixel 2.0.
const STATUS: u8 = 0x55;
/// In the error byte of Dynamixel 2.0.
const ALERT_BIT: u8 = 0x80;

/// The errors in an answer, as flags that are common to all protocols.
#[derive(Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct StatusError(u16);

impl StatusError {
    /// No error.
    pub const NONE: Self = Self(0);
    /// The supply voltage is outside its limits.
    pub const INPUT_VOLTAGE: Self = Self(1);
    /// The goal position is outside the angle limits.
    pub const ANGLE_LIMIT: Self = Self(1 << 1);
    /// The temperature is above its limit.
    pub const OVERHEATING: Self = Self(1 << 2);
    /// A value or an address is out of range.
    pub const RANGE: Self = Self(1 << 3);
    /// The instruction had a wrong checksum.
    pub const CHECKSUM: Self = Self(1 << 4);
    /// The permitted torque cannot hold the load.
    pub const OVERLOAD: Self = Self(1 << 5);
    /// The instruction does not exist, or ACTION without REG_WRITE.
    pub const INSTRUCTION: Self = Self(1 << 6);
    /// The device has stopped itself; its register `hardware_error_status` has the cause (Dynamixel 2.0).
    pub const ALERT: Self = Self(1 << 8);
    /// The instruction could not be executed (Dynamixel 2.0).
    pub const FAILED: Self = Self(1 << 9);
    /// A register is read-only, write-only, or locked while the torque is enabled (Dynamixel 2.0).
    pub const ACCESS: Self = Self(1 << 10);
    /// The current is above its limit (Feetech).
    pub const OVERCURRENT: Self = Self(1 << 11);
    /// The position sensor is faulty (Feetech).
    pub const POSITION_SENSOR: Self = Self(1 << 12);

    const NAMES: [(Self, &str); 12] = [
        (Self::INPUT_VOLTAGE, "input voltage"),
        (Self::ANGLE_LIMIT, "angle limit"),
        (Self::OVERHEATING, "overheating"),
        (Self::RANGE, "range"),
        (Self::CHECKSUM, "checksum"),
        (Self::OVERLOAD, "overload"),
        (Self::INSTRUCTION, "instruction"),
        (Self::ALERT, "hardware alert"),
        (Self::FAILED, "failed"),
        (Self::ACCESS, "access"),
        (Self::OVERCURRENT, "overcurrent"),
        (Self::POSITION_SENSOR, "position sensor"),
    ];

    /// The flags that mean an instruction was not executed. The others concern the device's state.
    pub const REFUSALS: Self = Self(
        Self::ANGLE_LIMIT.0
            | Self::RANGE.0
            | Self::CHECKSUM.0
            | Self::INSTRUCTION.0
            | Self::FAILED.0
            | Self::ACCESS.0,
    );

    /// Feetech's bits and their meanings.
    const FEETECH: [(u8, Self); 5] = [
        (1, Self::INPUT_VOLTAGE),
        (1 << 1, Self::POSITION_SENSOR),
        (1 << 2, Self::OVERHEATING),
        (1 << 3, Self::OVERCURRENT),
        (1 << 5, Self::OVERLOAD),
    ];

    /// Parses the error byte of an answer.
    #[must_use]
    pub fn from_byte(protocol: Protocol, byte: u8) -> Self {
        match protocol {
            Protocol::Dynamixel1 => Self(u16::from(byte)),
            Protocol::Dynamixel2 => {
                let alert = if byte & ALERT_BIT == 0 { Self::NONE } else { Self::ALERT };
                alert
                    | match byte & !ALERT_BIT {
                        0 => Self::NONE,
                        2 => Self::INSTRUCTION,
                        3 => Self::CHECKSUM,
                        4 | 5 => Self::RANGE,
                        6 => Self::ANGLE_LIMIT,
                        7 => Self::ACCESS,
                        _ => Self::FAILED,
                    }
            }
            Protocol::FeetechSts | Protocol::FeetechScs => {
                let set = Self::FEETECH.iter().filter(|(bit, _)| byte & bit != 0);
                set.fold(Self::NONE, |error, (_, flag)| error | *flag)
            }
        }
    }

    /// The error byte of an answer. Flags that the protocol cannot express are left out.
    #[must_use]
    pub fn to_byte(self, protocol: Protocol) -> u8 {
        match protocol {
            Protocol::Dynamixel1 => self.0.to_le_bytes()[0],
            Protocol::Dynamixel2 => {
                let state = Self::INPUT_VOLTAGE | Self::OVERHEATING | Self::OVERLOAD | Self::ALERT;
                let alert = if self.intersects(state) { ALERT_BIT } else { 0 };
                let numbers = [
                    (Self::FAILED, 1),
                    (Self::INSTRUCTION, 2),
                    (Self::CHECKSUM, 3),
                    (Self::RANGE, 4),
                    (Self::ANGLE_LIMIT, 6),
                    (Self::ACCESS, 7),
                ];
                alert | numbers.iter().find(|(flag, _)| self.contains(*flag)).map_or(0, |(_, number)| *number)
            }
            Protocol::FeetechSts | Protocol::FeetechScs => {
                let set = Self::FEETECH.iter().filter(|(_, flag)| self.contains(*flag));
                set.fold(0, |byte, (bit, _)| byte | bit)
            }
        }
    }

    /// What a person can do about the first of the errors.
    #[must_use]
    pub const fn remedy(self) -> &'static str {
        if self.intersects(Self::INPUT_VOLTAGE) {
            "check that the supply is the one for this model, its plugs, and the registers min_voltage_limit and max_voltage_limit"
        } else if self.intersects(Self::POSITION_SENSOR) {
            "switch its power off and on, calibrate it, or exchange it"
        } else if self.intersects(Self::OVERHEATING) {
            "let it cool down, and relieve its joint"
        } else if self.intersects(Self::OVERLOAD) || self.intersects(Self::OVERCURRENT) {
            "free its joint of what blocks or loads it; if it has switched its torque off, command that again"
        } else if self.intersects(Self::ALERT) {
            "read its register hardware_error_status with `downbeat servo read`, and switch its power off and on"
        } else if self.intersects(Self::ACCESS) {
            "registers that outlive the power can be written only while torque_enable is 0"
        } else if self.intersects(Self::ANGLE_LIMIT) || self.intersects(Self::RANGE) {
            "write a value within its range and its position limits"
        } else {
            "see whether its model is the described one, and look at its cable"
        }
    }

    /// Returns whether no flag is set.
    #[must_use]
    pub const fn is_none(self) -> bool {
        self.0 == 0
    }

    /// Returns whether all flags of `other` are set.
    #[must_use]
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Returns whether any flag of `other` is set.
    #[must_use]
    pub const fn intersects(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }
}

impl BitOr for StatusError {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl BitOrAssign for StatusError {
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

impl fmt::Display for StatusError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut separator = "";
        for (flag, name) in Self::NAMES {
            if self.contains(flag) {
                write!(formatter, "{separator}{name}")?;
                separator = ", ";
            }
        }
        if separator.is_empty() { formatter.write_str("none") } else { Ok(()) }
    }
}

impl fmt::Debug for StatusError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "StatusError({self})")
    }
}

/// An answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Status {
    /// The device that answers.
    pub id: Id,
    /// Its errors.
    pub error: StatusError,
    /// The requested data.
    pub parameters: Vec<u8>,
}

/// Why a valid packet is not an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StatusParseError {
    /// It comes from the broadcast address.
    #[error("an answer of one device cannot come from id 254, the broadcast address")]
    Broadcast,
    /// It has the code of an instruction.
    #[error(
        "an answer has the code 55, found {code:02X}: it is an instruction, as a bus without a direction switch echoes it"
    )]
    Instruction {
        /// The code on the wire.
        code: u8,
    },
}

impl Status {
    /// Parses a packet from a device.
    ///
    /// # Errors
    /// Returns an error if it is not the answer of one device.
    pub fn parse(packet: &Packet<'_>) -> Result<Self, StatusParseError> {
        let (id, code, protocol) = (packet.id(), packet.code(), packet.protocol());
        if id.is_broadcast() {
            return Err(StatusParseError::Broadcast);
        }
        let parameters = packet.parameters();
        if protocol != Protocol::Dynamixel2 {
            let error = StatusError::from_byte(protocol, code);
            return Ok(Self { id, error, parameters: parameters.into_owned() });
        }
        match (code, &*parameters) {
            (STATUS, [error, parameters @ ..]) => {
                let error = StatusError::from_byte(protocol, *error);
                Ok(Self { id, error, parameters: parameters.to_vec() })
            }
            _ => Err(StatusParseError::Instruction { code }),
        }
    }

    /// Appends the packet to `out`.
    ///
    /// # Errors
    /// Returns an error if there are more parameters than a packet can hold.
    pub fn emit(&self, protocol: Protocol, out: &mut Vec<u8>) -> Result<(), EmitError> {
        let error = self.error.to_byte(protocol);
        if protocol == Protocol::Dynamixel2 {
            emit_packet(protocol, self.id, STATUS, &[&[error], &self.parameters[..]].concat(), out)
        } else {
            emit_packet(protocol, self.id, error, &self.parameters, out)
        }
    }
}

/// The number of parameters of the one packet in which several devices answer a fast sync read or fast bulk
/// read, with these numbers of parameters each.
#[must_use]
pub fn joined_parameters(each: impl IntoIterator<Item = u16>) -> u16 {
    // Error, id and data of each device, and a CRC between two devices. The first error is not counted as a
    // parameter.
    let all = each.into_iter().fold(0_usize, |sum, length| sum + usize::from(length) + 4);
    u16::try_from(all.saturating_sub(3)).unwrap_or(u16::MAX)
}

/// Splits the packet in which several devices answered a fast sync read or fast bulk read of these devices
/// with these numbers of parameters.
///
/// The packet may break off: each device appends a CRC over everything up to it, so that the answers before
/// the first missing or corrupt one are valid.
#[must_use]
pub fn split_joined(bytes: &[u8], requested: &[(Id, u16)]) -> Vec<Status> {
    let mut answers = Vec::new();
    let start = bytes.windows(HEADER_2.len()).position(|window| window == HEADER_2);
    let Some(packet) = start.map(|start| &bytes[start..]) else { return answers };
    // Header, id, length and code. The packet is not stuffed.
    let mut end = 8;
    if packet.get(4) != Some(&Id::BROADCAST.raw()) || packet.get(7) != Some(&STATUS) {
        return answers;
    }
    for (id, length) in requested {
        let begin = end;
        end += usize::from(*length) + 4;
        let Some([error, raw_id, parameters @ .., low, high]) = packet.get(begin..end) else { break };
        if *raw_id != id.raw() || crc16(&packet[..end - 2]) != u16::from_le_bytes([*low, *high]) {
            break;
        }
        let error = StatusError::from_byte(Protocol::Dynamixel2, *error);
        answers.push(Status { id: *id, error, parameters: parameters.to_vec() });
    }
    answers
}

/// Appends the packet in which several devices answer a fast sync read or fast bulk read.
pub(crate) fn emit_joined(statuses: &[Status], out: &mut Vec<u8>) {
    let start = out.len();
    let parameters = joined_parameters(statuses.iter().map(|status| status.parameters.len() as u16));
    out.extend_from_slice(&HEADER_2);
    out.push(Id::BROADCAST.raw());
    out.extend_from_slice(&(parameters + 4).to_le_bytes());
    out.push(STATUS);
    for status in statuses {
        out.push(status.error.to_byte(Protocol::Dynamixel2));
        out.push(status.id.raw());
        out.extend_from_slice(&status.parameters);
        let crc = crc16(&out[start..]);
        out.extend_from_slice(&crc.to_le_bytes());
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    fn parse(protocol: Protocol, bytes: &[u8]) -> Result<Status, StatusParseError> {
        Status::parse(&Packet::new_checked(protocol, bytes).unwrap())
    }

    fn id(raw: u8) -> Id {
        Id::new(raw).unwrap()
    }

    #[test]
    fn error_bits_match_the_manual() {
        let status = parse(Protocol::Dynamixel1, &[0xFF, 0xFF, 0x01, 0x02, 0x24, 0xD8]).unwrap();
        assert_eq!(status.error, StatusError::OVERLOAD | StatusError::OVERHEATING);
        assert_eq!(status.error.to_string(), "overheating, overload");
    }

    #[test]
    fn errors_of_dynamixel_2_are_a_number_and_an_alert() {
        let error = |byte| StatusError::from_byte(Protocol::Dynamixel2, byte);
        assert_eq!(error(0x87), StatusError::ALERT | StatusError::ACCESS);
        assert_eq!(error(0x00), StatusError::NONE);
        assert!(error(0x04).intersects(StatusError::REFUSALS));
        assert!(!error(0x80).intersects(StatusError::REFUSALS));
    }

    #[test]
    fn bit_three_of_feetech_is_the_current_and_refuses_nothing() {
        let error = StatusError::from_byte(Protocol::FeetechSts, 0x0A);
        assert_eq!(error.to_string(), "overcurrent, position sensor");
        assert!(!error.intersects(StatusError::REFUSALS));
    }

    #[test]
    fn an_answer_from_the_broadcast_address_is_refused() {
        let bytes = [0xFF, 0xFF, 0xFE, 0x02, 0x00, 0xFF];
        assert_eq!(parse(Protocol::Dynamixel1, &bytes), Err(StatusParseError::Broadcast));
    }

    #[test]
    fn answers_of_dynamixel_2_match_the_manual() {
        let ping = [0xFF, 0xFF, 0xFD, 0, 1, 7, 0, 0x55, 0, 6, 4, 0x26, 0x65, 0x5D];
        let position = [0xFF, 0xFF, 0xFD, 0, 2, 8, 0, 0x55, 0, 0x1F, 8, 0, 0, 0xBA, 0xBE];
        for (golden, raw, parameters) in
            [(&ping[..], 1, vec![0x06, 0x04, 0x26]), (&position[..], 2, vec![0x1F, 8, 0, 0])]
        {
            let status = parse(Protocol::Dynamixel2, golden).unwrap();
            assert_eq!(status, Status { id: id(raw), error: StatusError::NONE, parameters });
            let mut bytes = Vec::new();
            status.emit(Protocol::Dynamixel2, &mut bytes).unwrap();
            assert_eq!(bytes, golden);
        }
        let instruction = [0xFF, 0xFF, 0xFD, 0, 1, 3, 0, 1, 0x19, 0x4E];
        assert_eq!(
            parse(Protocol::Dynamixel2, &instruction),
            Err(StatusParseError::Instruction { code: 1 }),
            "an echo is no answer"
        );
    }

    /// The example of the fast sync read in the e-Manual: three XC330.
    #[test]
    fn a_joined_answer_matches_the_manual() {
        let golden = [
            &[0xFF, 0xFF, 0xFD, 0, 0xFE, 0x19, 0, 0x55, 0, 3, 0xA6, 0, 0, 0, 0x84, 0x08][..],
            &[0, 7, 0x1F, 8, 0, 0, 0x16, 0xCA],
            &[0, 4, 0xFF, 3, 0, 0, 0xD1, 0x9E],
        ]
        .concat();
        let status = |raw, parameters: [u8; 4]| Status {
            id: id(raw),
            error: StatusError::NONE,
            parameters: parameters.to_vec(),
        };
        let expected = [status(3, [0xA6, 0, 0, 0]), status(7, [0x1F, 8, 0, 0]), status(4, [0xFF, 3, 0, 0])];
        assert!(Packet::new_checked(Protocol::Dynamixel2, &golden).is_ok());
        let requested = [(id(3), 4), (id(7), 4), (id(4), 4)];
        assert_eq!(split_joined(&golden, &requested), expected);
        assert_eq!(split_joined(&golden[..24], &requested), expected[..2], "the last device is silent");
        let mut corrupt = golden.clone();
        corrupt[18] ^= 1;
        assert_eq!(split_joined(&corrupt, &requested), expected[..1]);
        assert_eq!(Protocol::Dynamixel2.status_length(joined_parameters([4, 4, 4])), golden.len());
        let mut bytes = Vec::new();
        emit_joined(&expected, &mut bytes);
        assert_eq!(bytes, golden);
    }

    proptest! {
        #[test]
        fn answers_survive_a_round_trip(
            raw in 0..=252_u8, byte: u8, parameters in proptest::collection::vec(any::<u8>(), 0..=250),
        ) {
            for protocol in Protocol::ALL {
                let error = StatusError::from_byte(protocol, byte);
                let status = Status { id: id(raw), error, parameters: parameters.clone() };
                let mut bytes = Vec::new();
                status.emit(protocol, &mut bytes).unwrap();
                prop_assert_eq!(parse(protocol, &bytes), Ok(status));
            }
        }

        #[test]
        fn splitting_any_bytes_never_panics(
            parameters in proptest::collection::vec(any::<u8>(), 0..60), length in 0..40_u16, cut: proptest::sample::Index,
        ) {
            let mut bytes = Vec::new();
            emit_packet(Protocol::Dynamixel2, Id::BROADCAST, STATUS, &parameters, &mut bytes).unwrap();
            let _ = split_joined(&bytes[..cut.index(bytes.len())], &[(id(1), length), (id(2), length)]);
        }
    }
}
