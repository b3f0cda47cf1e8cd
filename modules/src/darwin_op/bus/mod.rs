//! Access to the devices: a serial port, or a recording of one.
//!
//! All external input of the hardware module goes through [`Bus`], including time and errors. So a
//! [`RecordedBus`] that plays back the exchanges of a [`SerialBus`] reproduces the module's behaviour bit for
//! bit.

mod awaited;
mod exchange;
mod recorded;
mod serial;
mod timeout;

#[cfg(test)]
pub(crate) use awaited::Awaited;
pub use exchange::{Exchange, ExchangeKind, ExchangeMessageError, ExpectedStatus, LATE, Outcome};
pub use recorded::{Difference, RecordedBus, ReplayReport};
pub use serial::{BAUD_RATE, SerialBus};
pub use timeout::{STATUS_SLACK, status_timeout};

use downbeat_executor::Time;

/// Access to the devices.
///
/// All errors are reported in the [`Exchange`], so that they can be recorded.
pub trait Bus: Send {
    /// Sets the time. Exchanges until the next call are stamped with this time plus the time elapsed since.
    fn begin_step(&mut self, now: Time);

    /// Opens the port, after closing it if it was open.
    fn open(&mut self, port: &str) -> Exchange;

    /// Sends one instruction packet and waits for the answers.
    ///
    /// It returns as soon as the last expected answer has arrived, or after a time-out.
    fn exchange(&mut self, instruction: &[u8], expected: &[ExpectedStatus]) -> Exchange;

    /// Closes the port. Does not affect the devices.
    fn close(&mut self) -> Exchange;
}
