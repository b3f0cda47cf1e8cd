//! A recording that replaces the bus.

use super::{Bus, Exchange, ExchangeKind, ExpectedStatus, LineSettings, Outcome};
use downbeat_executor::Time;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use parking_lot::Mutex;
use std::sync::Arc;

/// Plays back the recorded answers of a bus, and checks that the requests are the same.
///
/// The answers, their times and their errors come from the recording, whatever the request.
pub struct RecordedBus {
    recording: Box<dyn Iterator<Item = Exchange> + Send>,
    now: Time,
    report: Arc<Mutex<BusReport>>,
}

/// The result of a replay so far.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BusReport {
    /// The number of replayed exchanges.
    pub replayed: u64,
    /// Where the module's behaviour differs from the recording.
    pub differences: Vec<BusDifference>,
}

/// A difference between the module's behaviour and the recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BusDifference {
    /// The sequence number of the exchange; after the end of the recording, the number it would have.
    pub sequence: u64,
    /// The recorded request; `None` after the end.
    pub recorded: Option<(ExchangeKind, Vec<u8>)>,
    /// The module's request.
    pub done: (ExchangeKind, Vec<u8>),
}

impl RecordedBus {
    /// Creates a bus that plays back these exchanges, and the report that it updates.
    pub fn new<I>(recording: I) -> (Self, Arc<Mutex<BusReport>>)
    where
        I: IntoIterator<Item = Exchange>,
        I::IntoIter: Send + 'static,
    {
        let report = Arc::default();
        let recording = Box::new(recording.into_iter());
        (Self { recording, now: Time::ZERO, report: Arc::clone(&report) }, report)
    }

    /// Creates a bus that plays back these messages of a bag.
    ///
    /// # Errors
    /// If a message is no exchange.
    pub fn of_messages(messages: Vec<BusExchange>) -> Result<Self, String> {
        let exchange = |message: BusExchange| Exchange::try_from(message).map_err(|error| error.to_string());
        let exchanges = messages.into_iter().map(exchange).collect::<Result<Vec<_>, String>>()?;
        Ok(Self::new(exchanges).0)
    }

    fn replay(&mut self, kind: ExchangeKind, instruction: &[u8]) -> Exchange {
        let recorded = self.recording.next();
        let mut report = self.report.lock();
        let done = || (kind, instruction.to_vec());
        match recorded {
            Some(recorded) => {
                report.replayed += 1;
                if recorded.kind == kind && recorded.instruction == instruction {
                    return recorded;
                }
                report.differences.push(BusDifference {
                    sequence: recorded.sequence,
                    recorded: Some((recorded.kind, recorded.instruction)),
                    done: done(),
                });
                let error = format!("exchange {} differs from the recording", recorded.sequence);
                failed(recorded.sequence, recorded.sent, kind, instruction, error)
            }
            None => {
                let sequence = report.replayed;
                report.differences.push(BusDifference { sequence, recorded: None, done: done() });
                let error = "the recording has ended".to_owned();
                failed(sequence, self.now, kind, instruction, error)
            }
        }
    }
}

impl Bus for RecordedBus {
    fn begin_step(&mut self, now: Time) {
        self.now = now;
    }

    fn set_line(&mut self, _line: LineSettings) {}

    fn open(&mut self, _port: &str) -> Exchange {
        self.replay(ExchangeKind::Open, &[])
    }

    fn exchange(&mut self, instruction: &[u8], _expected: &[ExpectedStatus]) -> Exchange {
        self.replay(ExchangeKind::Transfer, instruction)
    }

    fn close(&mut self) -> Exchange {
        self.replay(ExchangeKind::Close, &[])
    }

    fn is_recorded(&self) -> bool {
        true
    }
}

fn failed(sequence: u64, sent: Time, kind: ExchangeKind, instruction: &[u8], error: String) -> Exchange {
    Exchange {
        sequence,
        kind,
        sent,
        duration_us: 0,
        instruction: instruction.to_vec(),
        reply: Vec::new(),
        outcome: Outcome::Failed,
        error,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn recorded(sequence: u64, kind: ExchangeKind, instruction: &[u8], reply: &[u8]) -> Exchange {
        Exchange {
            outcome: Outcome::Ok,
            reply: reply.to_vec(),
            error: String::new(),
            duration_us: 321,
            ..failed(sequence, Time::from_nanos(77), kind, instruction, String::new())
        }
    }

    fn recording() -> Vec<Exchange> {
        vec![
            recorded(4, ExchangeKind::Open, &[], &[]),
            recorded(5, ExchangeKind::Transfer, &[1, 2], &[9]),
            recorded(6, ExchangeKind::Transfer, &[3], &[8]),
        ]
    }

    #[test]
    fn the_same_instructions_get_the_recorded_answers() {
        let (mut bus, report) = RecordedBus::new(recording());
        let played = vec![bus.open("anywhere"), bus.exchange(&[1, 2], &[]), bus.exchange(&[3], &[])];
        assert_eq!(played, recording());
        assert_eq!(*report.lock(), BusReport { replayed: 3, differences: Vec::new() });
    }

    #[test]
    fn another_instruction_fails_and_is_reported_byte_for_byte() {
        let (mut bus, report) = RecordedBus::new(recording());
        bus.open("anywhere");
        let changed = bus.exchange(&[1, 7], &[]);
        assert_eq!(changed.outcome, Outcome::Failed);
        assert_eq!(bus.exchange(&[3], &[]).reply, [8], "the replay continues after a difference");
        let difference = BusDifference {
            sequence: 5,
            recorded: Some((ExchangeKind::Transfer, vec![1, 2])),
            done: (ExchangeKind::Transfer, vec![1, 7]),
        };
        assert_eq!(report.lock().differences, [difference]);
    }

    #[test]
    fn requests_after_the_end_of_the_recording_fail_and_are_reported() {
        let (mut bus, report) = RecordedBus::new(Vec::new());
        assert_eq!(bus.close().outcome, Outcome::Failed);
        assert_eq!(report.lock().differences[0].recorded, None);
    }
}
