//! Lines of a GPIO chip as a device whose exchanges are recorded.

use std::time::Instant;

use downbeat_device::Device;
use downbeat_executor::Time;
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;

use super::lines::Line;
use crate::exchange;
use crate::kernel::name_of;

/// The length of an edge in a recording.
pub(super) const EDGE: usize = 16;

/// A change of an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// How long ago it was, in nanoseconds.
    pub age_ns: u64,
    /// Which of the lines.
    pub line: u16,
    /// Whether it became true.
    pub is_true: bool,
    /// How many changes of the line were lost before it.
    pub lost: u32,
}

impl Edge {
    fn emit(&self) -> [u8; EDGE] {
        let mut bytes = [0; EDGE];
        let [a, b] = self.line.to_le_bytes();
        bytes[..8].copy_from_slice(&self.age_ns.to_le_bytes());
        bytes[8..12].copy_from_slice(&[a, b, self.is_true.into(), 0]);
        bytes[12..].copy_from_slice(&self.lost.to_le_bytes());
        bytes
    }

    /// Reads an edge of a recording.
    pub(super) fn parse(bytes: &[u8; EDGE]) -> Self {
        let [t0, t1, t2, t3, t4, t5, t6, t7, a, b, is_true, _, l0, l1, l2, l3] = *bytes;
        Self {
            age_ns: u64::from_le_bytes([t0, t1, t2, t3, t4, t5, t6, t7]),
            line: u16::from_le_bytes([a, b]),
            is_true: is_true != 0,
            lost: u32::from_le_bytes([l0, l1, l2, l3]),
        }
    }
}

/// Who has the lines. Failures are sentences with what to do.
pub trait Source: Send {
    /// Requests lines of a chip. Outputs get their safe value. Returns the values of all lines.
    ///
    /// # Errors
    /// If there is no such chip or line, or it cannot be used.
    fn open(&mut self, chip: &str, lines: &[Line]) -> Result<Vec<bool>, String>;

    /// The changes of inputs since the last call, in the order in which they happened. Waits for a bounded
    /// time if there is none.
    ///
    /// # Errors
    /// If the chip is lost. It has to be opened again.
    fn edges(&mut self) -> Result<Vec<Edge>, String>;

    /// Sets an output.
    ///
    /// # Errors
    /// If the chip is lost.
    fn set(&mut self, line: usize, is_true: bool) -> Result<(), String>;

    /// Gives the lines back.
    fn close(&mut self);
}

/// A request of the module.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// Request these lines of a chip.
    Open(String, Vec<Line>),
    /// Give the changes of inputs.
    Edges,
    /// Set an output, by its place among the lines.
    Set(usize, bool),
    /// Give the lines back.
    Close,
}

/// Lines of a chip: a [`Source`] of which everything is recorded.
pub struct GpioDevice {
    source: Box<dyn Source>,
}

impl GpioDevice {
    /// Lines that are reached like this.
    #[must_use]
    pub fn new(source: impl Source + 'static) -> Self {
        Self { source: Box::new(source) }
    }
}

impl Device for GpioDevice {
    type Request = Request;
    type Exchange = BusExchange;
    const TOPIC: &'static str = "gpio/exchanges";

    fn exchange(&mut self, request: &Request, now: Time) -> BusExchange {
        let started = Instant::now();
        let mut exchange = exchange_of(request, now);
        let outcome = match request {
            Request::Open(chip, lines) => {
                let values = self.source.open(chip, lines);
                values.map(|values| Some(values.into_iter().map(u8::from).collect()))
            }
            Request::Edges => {
                let edges = self.source.edges();
                if edges.as_ref().is_ok_and(|edges| !edges.is_empty()) {
                    // Ages are those at this moment.
                    let since = i64::try_from(started.elapsed().as_nanos()).unwrap_or_default();
                    exchange.stamp = Stamp::from_nanos(now.as_nanos().saturating_add(since));
                }
                let bytes = edges.map(|edges| edges.iter().flat_map(Edge::emit).collect::<Vec<u8>>());
                bytes.map(|bytes| Some(bytes).filter(|bytes| !bytes.is_empty()))
            }
            Request::Set(line, is_true) => self.source.set(*line, *is_true).map(|()| Some(Vec::new())),
            Request::Close => {
                self.source.close();
                Ok(Some(Vec::new()))
            }
        };
        exchange::end(exchange, outcome, started)
    }

    fn answers(exchange: &BusExchange, request: &Request) -> bool {
        exchange::has_same_request(exchange, &exchange_of(request, Time::ZERO))
    }

    fn failed(request: &Request, now: Time, reason: &str) -> BusExchange {
        exchange::fail(exchange_of(request, now), reason)
    }
}

fn exchange_of(request: &Request, now: Time) -> BusExchange {
    let (kind, instruction) = match request {
        Request::Open(chip, lines) => {
            let lines = lines.iter().map(|line| format!(" {line:?}"));
            let chip = name_of(chip);
            (BusExchange::OPEN, format!("{chip}{}", lines.collect::<String>()).into_bytes())
        }
        Request::Edges => (BusExchange::TRANSFER, Vec::new()),
        Request::Set(line, is_true) => {
            (BusExchange::TRANSFER, format!("{line}={}", u8::from(*is_true)).into_bytes())
        }
        Request::Close => (BusExchange::CLOSE, Vec::new()),
    };
    exchange::begin(kind, instruction, now)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn an_edge_survives_being_recorded(age_ns: u64, line: u16, is_true: bool, lost: u32) {
            let edge = Edge { age_ns, line, is_true, lost };
            prop_assert_eq!(Edge::parse(&edge.emit()), edge);
        }
    }
}
