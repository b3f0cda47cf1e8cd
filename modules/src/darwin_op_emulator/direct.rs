//! Direct access to the devices without a port, for tests of bus traffic that a busy machine cannot disturb.

use super::emulator::Shared;
use crate::darwin_op::bus::{Awaited, Bus, Exchange, ExchangeKind, ExpectedStatus, Outcome};
use crate::darwin_op::protocol::Packet;
use downbeat_executor::Time;
use std::sync::Arc;
use std::time::Duration;

/// A bus with the time of the emulated wire: the same instructions result in the same exchanges, to the
/// nanosecond. Silent devices are known at once.
pub(crate) struct DirectBus {
    shared: Arc<Shared>,
    is_open: bool,
    sequence: u64,
    /// The time of the step, and the emulator's time when it was set.
    step: (Time, Duration),
}

impl DirectBus {
    pub(super) fn new(shared: Arc<Shared>) -> Self {
        Self { shared, is_open: false, sequence: 0, step: (Time::ZERO, Duration::ZERO) }
    }

    fn finish(&mut self, kind: ExchangeKind, started: Duration, instruction: &[u8]) -> Exchange {
        let (now, said) = self.step;
        let sequence = self.sequence;
        self.sequence += 1;
        let duration = self.now().saturating_sub(started);
        Exchange {
            sequence,
            kind,
            sent: now + started.saturating_sub(said),
            duration_us: u32::try_from(duration.as_micros()).unwrap_or(u32::MAX),
            instruction: instruction.to_vec(),
            reply: Vec::new(),
            outcome: Outcome::Ok,
            error: String::new(),
        }
    }

    fn now(&self) -> Duration {
        self.shared.world().now()
    }
}

impl Bus for DirectBus {
    fn begin_step(&mut self, now: Time) {
        self.step = (now, self.now());
    }

    fn open(&mut self, _port: &str) -> Exchange {
        self.is_open = true;
        self.finish(ExchangeKind::Open, self.now(), &[])
    }

    fn exchange(&mut self, instruction: &[u8], expected: &[ExpectedStatus]) -> Exchange {
        let started = self.now();
        let mut reply = Vec::new();
        if let (true, Ok(packet)) = (self.is_open, Packet::new_checked(instruction)) {
            let bundles = self.shared.world().answer(&packet);
            reply.extend(bundles.into_iter().flat_map(|bundle| bundle.bytes));
        }
        let mut awaited = Awaited::new(expected);
        awaited.take(&reply);
        let end = awaited.end(reply);
        let exchange = self.finish(ExchangeKind::Transfer, started, instruction);
        Exchange { reply: end.reply, outcome: end.outcome, error: end.error, ..exchange }
    }

    fn close(&mut self) -> Exchange {
        self.is_open = false;
        self.finish(ExchangeKind::Close, self.now(), &[])
    }
}
