//! Tracks which answers have arrived.

use super::super::protocol::Receiver;
use super::{ExpectedStatus, Outcome};

/// How an exchange ended.
pub(crate) struct End {
    pub(crate) outcome: Outcome,
    pub(crate) reply: Vec<u8>,
    pub(crate) error: String,
}

impl End {
    pub(crate) fn ok() -> Self {
        Self { outcome: Outcome::Ok, reply: Vec::new(), error: String::new() }
    }

    pub(crate) fn failed(reply: Vec<u8>, error: String) -> Self {
        Self { outcome: Outcome::Failed, reply, error }
    }
}

/// Tracks which of the expected answers have arrived.
pub(crate) struct Awaited<'a> {
    expected: &'a [ExpectedStatus],
    receiver: Receiver,
    /// Devices answer in order: those before this index have answered or will not answer.
    passed: usize,
    came: usize,
}

impl<'a> Awaited<'a> {
    pub(crate) fn new(expected: &'a [ExpectedStatus]) -> Self {
        let longest = expected.iter().map(ExpectedStatus::packet_length).max().unwrap_or(0);
        Self { expected, receiver: Receiver::with_longest(longest), passed: 0, came: 0 }
    }

    pub(crate) fn take(&mut self, bytes: &[u8]) {
        self.receiver.push(bytes);
        while let Some(packet) = self.receiver.next_packet() {
            let to_come = &self.expected[self.passed..];
            if let Some(index) = to_come.iter().position(|expected| expected.id == packet.id()) {
                self.passed += index + 1;
                self.came += 1;
            }
        }
    }

    pub(crate) fn is_over(&self) -> bool {
        self.passed == self.expected.len()
    }

    pub(crate) fn end(self, reply: Vec<u8>) -> End {
        let missing = self.expected.len() - self.came;
        if missing == 0 {
            return End { reply, ..End::ok() };
        }
        let error = format!("{missing} of {} answers are missing or corrupt", self.expected.len());
        End { outcome: Outcome::Timeout, reply, error }
    }
}
