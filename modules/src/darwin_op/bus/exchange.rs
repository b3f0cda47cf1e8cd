//! One exchange on the bus, as a value that can be recorded.

use super::super::protocol::Id;
use downbeat_executor::Time;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;

/// What was done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExchangeKind {
    /// The port was opened.
    Open,
    /// An instruction was sent, and its answers were awaited.
    Transfer,
    /// The port was closed.
    Close,
}

/// How it ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All that was expected came, whole and sound.
    Ok,
    /// The port works, but at least one answer did not come, or came corrupt.
    Timeout,
    /// The port does not work: it cannot be opened, was unplugged or closed.
    Failed,
}

/// A status packet that is to come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExpectedStatus {
    /// From whom.
    pub id: Id,
    /// With how many bytes of parameters.
    pub parameters: u8,
}

impl ExpectedStatus {
    /// How long the packet is, header and checksum included.
    #[must_use]
    pub const fn packet_length(&self) -> usize {
        self.parameters as usize + 6
    }
}

/// In [`Exchange::error`]: an answer came that had been given up. The devices are well, the machine was too slow for them.
pub const LATE: &str = "an earlier answer came after it was given up";

/// One exchange on the bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Exchange {
    /// Counts all exchanges of this bus, from 0.
    pub sequence: u64,
    /// What was done.
    pub kind: ExchangeKind,
    /// When the instruction was sent.
    pub sent: Time,
    /// From sending to the last byte, or to giving up, in microseconds.
    pub duration_us: u32,
    /// The instruction packet; empty unless it is a transfer.
    pub instruction: Vec<u8>,
    /// All bytes that came, as they came.
    pub reply: Vec<u8>,
    /// How it ended.
    pub outcome: Outcome,
    /// What went wrong, for people; empty if all went well.
    pub error: String,
}

/// Why a recorded message is no exchange.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ExchangeMessageError {
    /// The kind is none of those defined.
    #[error("exchange {sequence} of the recording is of kind {found}, which does not exist")]
    Kind {
        /// Which exchange.
        sequence: u64,
        /// The kind it has.
        found: u8,
    },
    /// The outcome is none of those defined.
    #[error("exchange {sequence} of the recording ended in outcome {found}, which does not exist")]
    Outcome {
        /// Which exchange.
        sequence: u64,
        /// The outcome it has.
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
            error: "1 of 2 answers did not come".to_owned(),
        };
        assert_eq!(Exchange::try_from(BusExchange::from(&exchange)), Ok(exchange));
    }

    #[test]
    fn a_message_of_a_kind_that_does_not_exist_is_refused() {
        let message = BusExchange { kind: 9, sequence: 3, ..BusExchange::default() };
        assert_eq!(Exchange::try_from(message), Err(ExchangeMessageError::Kind { sequence: 3, found: 9 }));
    }
}
