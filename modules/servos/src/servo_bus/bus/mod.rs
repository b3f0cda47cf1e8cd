//! Access to the devices: a serial port, or a recording of one.
//!
//! All external input of the hardware module goes through [`Bus`], including time and errors. So a
//! [`RecordedBus`] that plays back the exchanges of a [`SerialBus`] reproduces the module's behaviour bit for
//! bit.

mod recorded;
mod serial;

use super::protocol::{Id, Protocol};
use downbeat_executor::Time;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
pub use recorded::{BusDifference, BusReport, RecordedBus};
pub(crate) use serial::Awaited;
pub use serial::{BAUD_RATE, SerialBus};
pub use serial::{STATUS_SLACK, status_timeout};

/// Access to the devices.
///
/// All errors are reported in the [`Exchange`], so that they can be recorded.
pub trait Bus: Send {
    /// Sets the time. Exchanges until the next call are stamped with this time plus the time elapsed since.
    fn begin_step(&mut self, now: Time);

    /// Sets the speed of the bus and its protocol, before the port is opened. Initially 1 Mbit/s and
    /// Dynamixel 1.0.
    fn set_line(&mut self, line: LineSettings);

    /// Opens the port, after closing it if it was open.
    fn open(&mut self, port: &str) -> Exchange;

    /// Sends one instruction packet and waits for the answers.
    ///
    /// It returns as soon as the last expected answer has arrived, or after a time-out.
    fn exchange(&mut self, instruction: &[u8], expected: &[ExpectedStatus]) -> Exchange;

    /// Closes the port. Does not affect the devices.
    fn close(&mut self) -> Exchange;

    /// Returns true if the exchanges were recorded earlier. Their lateness then says nothing about this
    /// machine, and is not logged.
    fn is_recorded(&self) -> bool {
        false
    }
}

/// How the devices of a bus speak.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LineSettings {
    /// The speed, in bit/s.
    pub baud: u32,
    /// The protocol.
    pub protocol: Protocol,
}

impl Default for LineSettings {
    fn default() -> Self {
        Self { baud: BAUD_RATE, protocol: Protocol::Dynamixel1 }
    }
}

/// The kind of an exchange.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExchangeKind {
    /// The port was opened.
    Open,
    /// An instruction was sent, and its answers were received.
    Transfer,
    /// The port was closed.
    Close,
}

/// The outcome of an exchange.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All expected answers arrived and are valid.
    Ok,
    /// The port works, but at least one answer is missing or corrupt.
    Timeout,
    /// The port does not work: it cannot be opened, was unplugged or closed.
    Failed,
}

/// An expected status packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExpectedStatus {
    /// The device that sends it; the broadcast address if several devices answer in one packet.
    pub id: Id,
    /// The number of parameter bytes.
    pub parameters: u16,
}

/// In [`Exchange::error`]: an answer arrived after its time-out. The devices work, but the machine was too
/// slow.
pub const LATE: &str = "an earlier answer came after it was given up";

/// One exchange on the bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Exchange {
    /// Counts all exchanges of this bus, from 0.
    pub sequence: u64,
    /// The kind of the exchange.
    pub kind: ExchangeKind,
    /// When the instruction was sent.
    pub sent: Time,
    /// From sending to the last byte or the time-out, in microseconds.
    pub duration_us: u32,
    /// The instruction packet; empty unless it is a transfer.
    pub instruction: Vec<u8>,
    /// All received bytes, unprocessed.
    pub reply: Vec<u8>,
    /// The outcome.
    pub outcome: Outcome,
    /// A description of the error; empty on success.
    pub error: String,
}

/// Why a recorded message is not a valid exchange.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ExchangeMessageError {
    /// The kind is undefined.
    #[error("exchange {sequence} of the recording is of kind {found}, which does not exist")]
    Kind {
        /// The sequence number of the exchange.
        sequence: u64,
        /// The kind in the message.
        found: u8,
    },
    /// The outcome is undefined.
    #[error("exchange {sequence} of the recording ended in outcome {found}, which does not exist")]
    Outcome {
        /// The sequence number of the exchange.
        sequence: u64,
        /// The outcome in the message.
        found: u8,
    },
}

impl From<&Exchange> for BusExchange {
    fn from(exchange: &Exchange) -> Self {
        Self {
            stamp: downbeat_msgs::builtin_interfaces::msg::Time::from_nanos(exchange.sent.as_nanos()),
            kind: match exchange.kind {
                ExchangeKind::Open => Self::OPEN,
                ExchangeKind::Transfer => Self::TRANSFER,
                ExchangeKind::Close => Self::CLOSE,
            },
            instruction: exchange.instruction.clone(),
            reply: exchange.reply.clone(),
            outcome: match exchange.outcome {
                Outcome::Ok => Self::OK,
                Outcome::Timeout => Self::TIMEOUT,
                Outcome::Failed => Self::FAILED,
            },
            error: exchange.error.clone(),
            duration_us: exchange.duration_us,
            sequence: exchange.sequence,
        }
    }
}

impl TryFrom<BusExchange> for Exchange {
    type Error = ExchangeMessageError;

    fn try_from(message: BusExchange) -> Result<Self, ExchangeMessageError> {
        let sequence = message.sequence;
        let kind = match message.kind {
            BusExchange::OPEN => ExchangeKind::Open,
            BusExchange::TRANSFER => ExchangeKind::Transfer,
            BusExchange::CLOSE => ExchangeKind::Close,
            found => return Err(ExchangeMessageError::Kind { sequence, found }),
        };
        let outcome = match message.outcome {
            BusExchange::OK => Outcome::Ok,
            BusExchange::TIMEOUT => Outcome::Timeout,
            BusExchange::FAILED => Outcome::Failed,
            found => return Err(ExchangeMessageError::Outcome { sequence, found }),
        };
        Ok(Self {
            sequence,
            kind,
            sent: Time::from_nanos(message.stamp.as_nanos()),
            duration_us: message.duration_us,
            instruction: message.instruction,
            reply: message.reply,
            outcome,
            error: message.error,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exchange_survives_being_recorded() {
        let exchange = Exchange {
            sequence: 7,
            kind: ExchangeKind::Transfer,
            sent: Time::from_nanos(1_700_000_000_123_456_789),
            duration_us: 4_830,
            instruction: vec![1, 2],
            reply: vec![3],
            outcome: Outcome::Timeout,
            error: "1 of 2 answers are missing".to_owned(),
        };
        assert_eq!(Exchange::try_from(BusExchange::from(&exchange)), Ok(exchange));
    }

    #[test]
    fn a_message_of_a_kind_that_does_not_exist_is_refused() {
        let message = BusExchange { kind: 9, sequence: 3, ..BusExchange::default() };
        assert_eq!(Exchange::try_from(message), Err(ExchangeMessageError::Kind { sequence: 3, found: 9 }));
    }
}
