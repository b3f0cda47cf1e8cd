//! The way to the devices: a serial port, or the recording of one.
//!
//! All that the hardware module learns from outside comes through [`Bus`], time and errors included. So a
//! [`RecordedBus`] that plays back what a [`SerialBus`] saw makes the module do the same again, bit for bit.

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

/// The way to the devices.
///
/// No operation fails otherwise than by what the [`Exchange`] says: whatever happened can be recorded.
pub trait Bus: Send {
    /// Says what time it is. Exchanges until the next call are stamped with this time and what has passed since.
    fn begin_step(&mut self, now: Time);

    /// Opens the way, after closing it if it was open.
    fn open(&mut self, port: &str) -> Exchange;

    /// Sends one instruction packet and waits for the answers.
    ///
    /// It returns as soon as the last answer that is expected has come, or when they are overdue.
    fn exchange(&mut self, instruction: &[u8], expected: &[ExpectedStatus]) -> Exchange;

    /// Closes the way. Does nothing to the devices.
    fn close(&mut self) -> Exchange;
}
