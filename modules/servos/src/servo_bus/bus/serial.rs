//! The serial port.

use super::super::protocol::{Instruction, Packet, Protocol, Receiver};
use super::{Bus, Exchange, ExchangeKind, ExpectedStatus, LATE, LineSettings, Outcome};
use downbeat_device::serial_port::{check_port, port_refusal};
use downbeat_executor::Time;
use serialport::{ClearBuffer, DataBits, FlowControl, Parity, SerialPort, StopBits};
use std::io;
use std::time::{Duration, Instant};

/// The usual speed of a bus, in bit/s.
pub const BAUD_RATE: u32 = 1_000_000;

/// How long the operating system may take to accept an instruction.
const WRITE_TIMEOUT: Duration = Duration::from_millis(20);

/// The devices on a serial port: 8 data bits, no parity, one stop bit, no flow control.
///
/// The port of a real robot is an FTDI chip: set its `latency_timer` to 1 ms, else each answer costs up to 16
/// ms.
pub struct SerialBus {
    port: Option<Box<dyn SerialPort>>,
    line: LineSettings,
    slack: Duration,
    sequence: u64,
    /// The time of the step, and the instant at which it was set.
    step: (Time, Instant),
    /// The number of further exchanges during which a late answer may still arrive.
    late_answers_for: u8,
}

/// The number of exchanges to check for a late answer: one that arrives during the next exchange may be
/// mistaken for its answer, whose own answer is then late.
const LATE_FOR: u8 = 4;

impl Default for SerialBus {
    fn default() -> Self {
        Self::new()
    }
}

impl SerialBus {
    /// A closed bus.
    #[must_use]
    pub fn new() -> Self {
        Self::with_slack(STATUS_SLACK)
    }

    /// A closed bus that gives devices and operating system this much time to answer, see [`status_timeout`].
    ///
    /// More than the usual [`STATUS_SLACK`] helps on an overloaded machine, at the cost of a longer wait for
    /// silent devices.
    #[must_use]
    pub fn with_slack(slack: Duration) -> Self {
        let (line, step) = (LineSettings::default(), (Time::ZERO, Instant::now()));
        Self { port: None, line, slack, sequence: 0, step, late_answers_for: 0 }
    }

    fn finish(&mut self, started: Instant, kind: ExchangeKind, instruction: &[u8], end: End) -> Exchange {
        let sequence = self.sequence;
        self.sequence += 1;
        let (now, said) = self.step;
        Exchange {
            sequence,
            kind,
            sent: now + started.saturating_duration_since(said),
            duration_us: u32::try_from(started.elapsed().as_micros()).unwrap_or(u32::MAX),
            instruction: instruction.to_vec(),
            reply: end.reply,
            outcome: end.outcome,
            error: end.error,
        }
    }

    /// Returns whether the answer to an earlier instruction arrived after its time-out: devices only send on
    /// request.
    fn has_late_answer(&mut self) -> bool {
        let Some(port) = self.port.as_deref().filter(|_| self.late_answers_for > 0) else { return false };
        self.late_answers_for -= 1;
        port.bytes_to_read().is_ok_and(|waiting| waiting > 0)
    }

    fn transfer(&mut self, started: Instant, instruction: &[u8], expected: &[ExpectedStatus]) -> End {
        let mut reply = Vec::new();
        let deadline = started + status_timeout(self.line, instruction, expected, self.slack);
        let Some(port) = self.port.as_deref_mut() else {
            return End::failed(reply, "the serial port is not open".to_owned());
        };
        let failed = |reply, doing: &str, error: &dyn std::fmt::Display| {
            End::failed(reply, format!("{doing} the serial port: {error}; is it plugged in?"))
        };
        if let Err(error) = send(port, instruction) {
            return failed(reply, "sending to", &error);
        }
        let mut awaited = Awaited::new(self.line.protocol, expected);
        let mut buffer = [0; 1024];
        while !awaited.is_over() {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                break;
            }
            match port.set_timeout(left).map_err(io::Error::from).and_then(|()| port.read(&mut buffer)) {
                Ok(0) => return failed(reply, "reading from", &"it was closed at the other end"),
                Ok(count) => {
                    reply.extend_from_slice(&buffer[..count]);
                    awaited.take(&buffer[..count]);
                }
                Err(error) if error.kind() == io::ErrorKind::TimedOut => break,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return failed(reply, "reading from", &error),
            }
        }
        awaited.end(reply)
    }
}

impl Bus for SerialBus {
    fn begin_step(&mut self, now: Time) {
        self.step = (now, Instant::now());
    }

    fn set_line(&mut self, line: LineSettings) {
        self.line = line;
    }

    fn open(&mut self, port: &str) -> Exchange {
        let started = Instant::now();
        self.port = None;
        let opened = check_port(port).and_then(|()| {
            serialport::new(port, self.line.baud)
                .data_bits(DataBits::Eight)
                .parity(Parity::None)
                .stop_bits(StopBits::One)
                .flow_control(FlowControl::None)
                .timeout(WRITE_TIMEOUT)
                .open()
                .map_err(|error| port_refusal(port, &error.into()))
        });
        let end = match opened {
            Ok(opened) => {
                self.port = Some(opened);
                End::ok()
            }
            Err(why) => End::failed(Vec::new(), why),
        };
        self.finish(started, ExchangeKind::Open, &[], end)
    }

    fn exchange(&mut self, instruction: &[u8], expected: &[ExpectedStatus]) -> Exchange {
        let started = Instant::now();
        let is_late = self.has_late_answer();
        let mut end = self.transfer(started, instruction, expected);
        if is_late {
            end.error = if end.error.is_empty() { LATE.to_owned() } else { format!("{}; {LATE}", end.error) };
        }
        if end.outcome == Outcome::Timeout {
            self.late_answers_for = LATE_FOR;
        }
        self.finish(started, ExchangeKind::Transfer, instruction, end)
    }

    fn close(&mut self) -> Exchange {
        let started = Instant::now();
        self.port = None;
        self.finish(started, ExchangeKind::Close, &[], End::ok())
    }
}

/// Drops late answers to earlier instructions, then sends.
fn send(port: &mut dyn SerialPort, instruction: &[u8]) -> io::Result<()> {
    port.clear(ClearBuffer::Input)?;
    port.set_timeout(WRITE_TIMEOUT)?;
    port.write_all(instruction)
}

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
    pub(crate) fn new(protocol: Protocol, expected: &'a [ExpectedStatus]) -> Self {
        let longest = expected.iter().map(|expected| longest_packet(protocol, expected)).max().unwrap_or(0);
        Self { expected, receiver: Receiver::with_longest(protocol, longest), passed: 0, came: 0 }
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

    fn is_over(&self) -> bool {
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

/// The bit times that a byte takes at most: ten bits and some slack.
const BIT_TIMES_PER_BYTE: u64 = 12;

/// Time for processing in the devices and in the operating system, as in the DARwIn-OP framework.
pub const STATUS_SLACK: Duration = Duration::from_millis(5);

/// The length of the packet with which a device answers, including all bytes that Dynamixel 2.0 may insert.
fn longest_packet(protocol: Protocol, expected: &ExpectedStatus) -> usize {
    let inserted =
        if protocol == Protocol::Dynamixel2 { usize::from(expected.parameters) / 3 + 1 } else { 0 };
    protocol.status_length(expected.parameters) + inserted
}

/// The time-out for the answers after sending `instruction`.
///
/// `slack`, plus 12 bit times for each byte sent and expected; if several devices answer, one and a half
/// times as much for the expected ones. The DARwIn-OP framework gives as much to a bulk read, and less to an
/// instruction to one device, which would be too little at a low speed.
#[must_use]
pub fn status_timeout(
    line: LineSettings,
    instruction: &[u8],
    expected: &[ExpectedStatus],
    slack: Duration,
) -> Duration {
    let packet = Packet::new_checked(line.protocol, instruction);
    let is_read_of_several = packet
        .ok()
        .and_then(|packet| Instruction::parse(&packet).ok())
        .is_some_and(|instruction| instruction.is_read_of_several());
    let expected: usize = expected.iter().map(|one| line.protocol.status_length(one.parameters)).sum();
    let bytes = if is_read_of_several { expected * 3 / 2 } else { instruction.len() + expected };
    let bit_times = bytes as u64 * BIT_TIMES_PER_BYTE;
    slack + Duration::from_nanos(bit_times * 1_000_000_000 / u64::from(line.baud.max(1)))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::super::super::protocol::{Id, ReadEntry};
    use super::*;
    use serialport::TTYPort;

    /// The time-out is too short for any answer.
    #[test]
    fn an_answer_after_its_time_out_is_late_and_one_that_never_arrives_is_not() {
        let (mut device, port) = TTYPort::pair().unwrap();
        let mut bus = SerialBus::with_slack(Duration::ZERO);
        assert_eq!(bus.open(&port.name().unwrap()).outcome, Outcome::Ok);
        let ping = Instruction::Ping { id: Id::CM730 }.to_bytes(Protocol::Dynamixel1).unwrap();
        let mut exchange = || bus.exchange(&ping, &[ExpectedStatus { id: Id::CM730, parameters: 0 }]);
        let given_up = exchange();
        assert_eq!(given_up.outcome, Outcome::Timeout);
        assert!(!exchange().error.contains(LATE));
        io::Write::write_all(&mut device, &[0xFF, 0xFF, 0xC8, 0x02, 0x00, 0x35]).unwrap();
        let watchdog = Instant::now() + Duration::from_secs(60);
        while port.bytes_to_read().unwrap() < 6 {
            assert!(Instant::now() < watchdog, "the answer does not arrive through the terminal");
            std::thread::yield_now();
        }
        let late = exchange();
        assert!(late.outcome == Outcome::Timeout && late.error.contains(LATE), "{late:?}");
    }

    #[test]
    fn a_port_that_does_not_exist_is_named_in_the_error() {
        let opened = SerialBus::new().open("/dev/no-such-port");
        assert_eq!((opened.kind, opened.outcome), (ExchangeKind::Open, Outcome::Failed));
        assert!(opened.error.contains("/dev/no-such-port"), "{}", opened.error);
    }

    #[test]
    fn an_exchange_on_a_closed_port_fails_and_is_counted() {
        let mut bus = SerialBus::new();
        bus.begin_step(Time::from_nanos(5_000_000_000));
        let first = bus.exchange(&[1, 2, 3], &[]);
        assert_eq!((first.sequence, first.outcome), (0, Outcome::Failed));
        assert!(first.sent >= Time::from_nanos(5_000_000_000));
        assert_eq!(bus.close().sequence, 1);
    }

    #[test]
    fn a_ping_has_five_milliseconds_and_the_time_of_its_bytes() {
        let line = LineSettings::default();
        let ping = Instruction::Ping { id: Id::CM730 }.to_bytes(line.protocol).unwrap();
        let expected = [ExpectedStatus { id: Id::CM730, parameters: 0 }];
        assert_eq!(status_timeout(line, &ping, &expected, STATUS_SLACK), Duration::from_micros(5_144));
        let slow = LineSettings { baud: 9600, ..line };
        assert_eq!(status_timeout(slow, &ping, &expected, STATUS_SLACK), Duration::from_millis(20));
    }

    #[test]
    fn a_bulk_read_has_one_and_a_half_times_the_time_of_its_answers() {
        let line = LineSettings::default();
        let one = Id::new(1).unwrap();
        let entries = vec![
            ReadEntry { id: Id::CM730, address: 24, length: 30 },
            ReadEntry { id: one, address: 36, length: 8 },
        ];
        let expected =
            [ExpectedStatus { id: Id::CM730, parameters: 30 }, ExpectedStatus { id: one, parameters: 8 }];
        let read = Instruction::BulkRead { entries }.to_bytes(line.protocol).unwrap();
        assert_eq!(status_timeout(line, &read, &expected, STATUS_SLACK), Duration::from_micros(5_900));
    }
}
