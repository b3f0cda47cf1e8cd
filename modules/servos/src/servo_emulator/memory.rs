//! Direct access to the devices, without a port.

use super::shared::Shared;
use crate::servo_bus::bus::{Awaited, Bus, Exchange, ExchangeKind, ExpectedStatus, LineSettings, Outcome};
use crate::servo_bus::protocol::{Packet, Protocol};
use downbeat_executor::Time;
use std::sync::Arc;
use std::time::Duration;

/// The bus of an emulator in memory, from [`Emulator::bus`](super::Emulator::bus): the same instructions at
/// the same times result in the same exchanges, to the nanosecond, whatever the machine is busy with. Silent
/// devices are known at once.
///
/// With [`Timing::Stepped`](super::Timing::Stepped) the robot follows the time of the steps
/// ([`Bus::begin_step`]), so that a module in a core with a manual clock drives it as fast as it can be
/// computed.
pub struct MemoryBus {
    shared: Arc<Shared>,
    /// That of the devices: the bus of an emulator cannot be spoken to in another one.
    protocol: Protocol,
    is_open: bool,
    sequence: u64,
    /// The time of the step, and the emulator's time when it was set.
    step: (Time, Duration),
}

impl MemoryBus {
    pub(super) fn new(shared: Arc<Shared>) -> Self {
        let protocol = shared.world().devices.protocol();
        Self { shared, protocol, is_open: false, sequence: 0, step: (Time::ZERO, Duration::ZERO) }
    }

    /// Whether this is the bus of that emulator.
    pub(super) fn is_of(&self, shared: &Arc<Shared>) -> bool {
        Arc::ptr_eq(&self.shared, shared)
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

    /// Reports a port that a fault keeps closed.
    fn closed(&mut self, exchange: Exchange) -> Exchange {
        self.is_open = false;
        let error = "a fault keeps the port of the emulator closed".to_owned();
        Exchange { outcome: Outcome::Failed, error, ..exchange }
    }

    fn is_kept_closed(&self) -> bool {
        let world = self.shared.world();
        world.faults.is_port_closed(world.now())
    }
}

impl Bus for MemoryBus {
    fn begin_step(&mut self, now: Time) {
        self.shared.lead(now);
        let mut world = self.shared.world();
        world.begin_step(now);
        self.step = (now, world.now());
    }

    fn set_line(&mut self, line: LineSettings) {
        self.shared.world().devices.set_line_speed(line.baud);
    }

    fn open(&mut self, _port: &str) -> Exchange {
        let opened = self.finish(ExchangeKind::Open, self.now(), &[]);
        if self.is_kept_closed() {
            return self.closed(opened);
        }
        self.is_open = true;
        opened
    }

    fn exchange(&mut self, instruction: &[u8], expected: &[ExpectedStatus]) -> Exchange {
        let started = self.now();
        if self.is_kept_closed() {
            let exchange = self.finish(ExchangeKind::Transfer, started, instruction);
            return self.closed(exchange);
        }
        let mut reply = Vec::new();
        if let (true, Ok(packet)) = (self.is_open, Packet::new_checked(self.protocol, instruction)) {
            let bundles = self.shared.world().answer(&packet);
            reply.extend(bundles.into_iter().flat_map(|bundle| bundle.bytes));
        }
        let mut awaited = Awaited::new(self.protocol, expected);
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
