//! What the recorded exchanges of all devices have in common.

use std::time::{Duration, Instant};

use downbeat_executor::Time;
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;

use crate::memory::is_memory;

/// The exchange that begins with a request: one of the kinds of [`BusExchange`], and what it says in bytes.
pub(crate) fn begin(kind: u8, instruction: impl Into<Vec<u8>>, now: Time) -> BusExchange {
    let stamp = Stamp::from_nanos(now.as_nanos());
    BusExchange { stamp, kind, instruction: instruction.into(), ..BusExchange::default() }
}

/// Whether two exchanges begin with the same request.
pub(crate) fn has_same_request(exchange: &BusExchange, other: &BusExchange) -> bool {
    (exchange.kind, &exchange.instruction) == (other.kind, &other.instruction)
}

/// The exchange with its outcome, after a request that was made then: `None` if the device had nothing to
/// give.
pub(crate) fn end(
    exchange: BusExchange,
    outcome: Result<Option<Vec<u8>>, String>,
    started: Instant,
) -> BusExchange {
    end_after(exchange, outcome, started.elapsed())
}

/// The exchange with its outcome, which took that long.
pub(crate) fn end_after(
    exchange: BusExchange,
    outcome: Result<Option<Vec<u8>>, String>,
    duration: Duration,
) -> BusExchange {
    let exchange = match outcome {
        Ok(Some(reply)) => BusExchange { reply, ..exchange },
        Ok(None) => BusExchange { outcome: BusExchange::TIMEOUT, ..exchange },
        Err(reason) => fail(exchange, reason),
    };
    BusExchange { duration_us: microseconds(duration), ..exchange }
}

/// Counts the exchanges of a device that may be in memory, whose time is that of the core.
#[derive(Debug, Default)]
pub(crate) struct Counted {
    sequence: u64,
}

impl Counted {
    /// The next exchange with its outcome, after a request that was made then to the device at this path.
    pub(crate) fn end(
        &mut self,
        exchange: BusExchange,
        outcome: Result<Option<Vec<u8>>, String>,
        started: Instant,
        path: &str,
    ) -> BusExchange {
        let sequence = self.sequence;
        self.sequence += 1;
        let duration = if is_memory(path) { Duration::ZERO } else { started.elapsed() };
        end_after(BusExchange { sequence, ..exchange }, outcome, duration)
    }
}

/// The exchange with a failure.
pub(crate) fn fail(exchange: BusExchange, error: impl Into<String>) -> BusExchange {
    BusExchange { outcome: BusExchange::FAILED, error: error.into(), ..exchange }
}

/// For [`BusExchange::duration_us`].
pub(crate) fn microseconds_since(started: Instant) -> u32 {
    microseconds(started.elapsed())
}

fn microseconds(duration: Duration) -> u32 {
    duration.as_micros().try_into().unwrap_or(u32::MAX)
}
