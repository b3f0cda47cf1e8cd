//! Requests and responses of the Slamtec RPLIDAR A1, and the conversation with it.
//!
//! A request is `A5` and a command. The response begins with a descriptor of seven bytes: `A5 5A`, the length
//! of its data (30 bits) and whether they are repeated (2 bits), little endian, and the type of the data. The
//! conversation is:
//!
//! 1. `STOP`, and a pause in which a scan that another program began runs out;
//! 2. `GET_HEALTH`; a lidar in protection stop is reset once, and else reported;
//! 3. `GET_INFO` and `GET_SAMPLERATE`;
//! 4. `SCAN`: from then on the lidar sends nodes of five bytes, one per measurement.
//!
//! A lidar that does not answer, or stops to send nodes, is addressed from the beginning again. Only the
//! standard scan is used (2000 measurements per second), not the express scan.
//!
//! # References
//! Slamtec, "RPLIDAR Interface Protocol and Application Notes" v2.2 (LR001); `Slamtec/rplidar_sdk`,
//! `rplidar_cmd.h`.

use std::time::Duration;

use downbeat_executor::Time;

use super::{Counts, Protocol, Sample};

/// The speed of the port, in bit/s.
pub const BAUD: u32 = 115_200;

/// A byte on the line: 10 bits.
const BYTE: Duration = Duration::from_nanos(10 * 1_000_000_000 / BAUD as u64);
/// The time from one measurement to the next if the lidar does not tell it: 2000 per second.
const SAMPLE: Duration = Duration::from_micros(500);
/// How long the lidar may take to answer.
const PATIENCE: Duration = Duration::from_millis(500);
/// How long the lidar may take to send the first node: its motor has to reach its speed.
const SPIN_UP: Duration = Duration::from_secs(3);
/// The pause after `STOP`: the manual wants 1 ms, and the driver's buffer has to run out.
const AFTER_STOP: Duration = Duration::from_millis(100);
/// The pause after `RESET`: the manual wants 2 ms, and the lidar then sends its greeting.
const AFTER_RESET: Duration = Duration::from_secs(1);
/// A stream of nodes whose alignment was lost is taken up again where this many in a row are valid.
const IN_A_ROW: usize = 4;
/// The length of a node.
const NODE: usize = 5;
/// By how much the direction of a measurement is ahead of the one before at most, in 1/64°.
const WIDEST_STEP: u16 = 15 * 64;
/// By how much it may be behind: directions are measured too.
const STEP_BACK: u16 = 2 * 64;
/// A revolution, in 1/64°.
const REVOLUTION: u16 = 360 * 64;

/// A request without payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// Ends a scan.
    Stop,
    /// Restarts the lidar.
    Reset,
    /// Begins a scan.
    Scan,
    /// Asks for model, versions and serial number.
    GetInfo,
    /// Asks for faults.
    GetHealth,
    /// Asks for the time of a measurement.
    GetSampleRate,
}

impl Command {
    /// Every command.
    pub const ALL: [Self; 6] =
        [Self::Stop, Self::Reset, Self::Scan, Self::GetInfo, Self::GetHealth, Self::GetSampleRate];

    /// The bytes of the request.
    #[must_use]
    pub fn to_bytes(self) -> [u8; 2] {
        let command = match self {
            Self::Stop => 0x25,
            Self::Reset => 0x40,
            Self::Scan => 0x20,
            Self::GetInfo => 0x50,
            Self::GetHealth => 0x52,
            Self::GetSampleRate => 0x59,
        };
        [0xA5, command]
    }

    /// The descriptor of the response. `Stop` and `Reset` have none.
    #[must_use]
    pub fn descriptor(self) -> Option<[u8; 7]> {
        let [length, mode, kind] = match self {
            Self::Stop | Self::Reset => return None,
            Self::Scan => [NODE as u8, 0x40, 0x81],
            Self::GetInfo => [20, 0, 0x04],
            Self::GetHealth => [3, 0, 0x06],
            Self::GetSampleRate => [4, 0, 0x15],
        };
        Some([0xA5, 0x5A, length, 0, 0, mode, kind])
    }
}

/// A measurement as it is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Node {
    /// The first one of a revolution.
    pub is_first: bool,
    /// The strength of the echo, up to 63.
    pub quality: u8,
    /// Clockwise, in 1/64°.
    pub angle_q6: u16,
    /// In 1/4 mm; 0 without echo.
    pub distance_q2: u16,
}

impl Node {
    /// Reads a node. `None` if its check bits or its angle are wrong.
    #[must_use]
    pub fn parse(bytes: [u8; NODE]) -> Option<Self> {
        let [first, low, high, near, far] = bytes;
        let angle_q6 = u16::from_le_bytes([low, high]) >> 1;
        let is_valid = (first & 1 != first >> 1 & 1) && low & 1 == 1 && angle_q6 <= REVOLUTION;
        is_valid.then_some(Self {
            is_first: first & 1 == 1,
            quality: first >> 2,
            angle_q6,
            distance_q2: u16::from_le_bytes([near, far]),
        })
    }

    /// The bytes of the node.
    #[must_use]
    pub fn to_bytes(self) -> [u8; NODE] {
        let start = if self.is_first { 0b01 } else { 0b10 };
        let [low, high] = (self.angle_q6 << 1 | 1).to_le_bytes();
        let [near, far] = self.distance_q2.to_le_bytes();
        [self.quality << 2 | start, low, high, near, far]
    }

    /// Whether this can be the measurement after `before`.
    fn follows(self, before: Self) -> bool {
        (self.angle_q6 + REVOLUTION + STEP_BACK - before.angle_q6) % REVOLUTION <= STEP_BACK + WIDEST_STEP
    }
}

/// What the driver waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Says this command at this time.
    Say(Command, Time),
    /// Waits until this time for the response to this command.
    Await(Command, Time),
    /// Nodes come; the last one at this time.
    Scanning { last: Time },
}

/// The conversation with an RPLIDAR.
#[derive(Debug)]
pub struct Driver {
    phase: Phase,
    buffer: Vec<u8>,
    /// Whether nodes begin where the buffer begins.
    is_aligned: bool,
    /// The node before, if its successor has to follow it.
    last: Option<Node>,
    sample: Duration,
    was_reset: bool,
    /// What the lidar reports.
    health: Option<String>,
    /// What is wrong with the conversation.
    trouble: Option<&'static str>,
    counts: Counts,
}

impl Default for Driver {
    fn default() -> Self {
        Self {
            phase: Phase::Say(Command::Stop, Time::ZERO),
            buffer: Vec::new(),
            is_aligned: true,
            last: None,
            sample: SAMPLE,
            was_reset: false,
            health: None,
            trouble: None,
            counts: Counts::default(),
        }
    }
}

impl Driver {
    fn skip(&mut self, count: usize) {
        self.counts.skipped += count as u64;
        self.buffer.drain(..count);
    }

    /// Looks for the response to a command, and goes on if it has come.
    fn take_response(&mut self, command: Command, arrived: Time) {
        let Some(descriptor) = command.descriptor() else { return };
        let Some(start) = self.buffer.windows(descriptor.len()).position(|window| window == descriptor)
        else {
            // What is left may be the beginning of it.
            self.skip(self.buffer.len().saturating_sub(descriptor.len() - 1));
            return;
        };
        self.skip(start);
        let length = if command == Command::Scan { 0 } else { usize::from(descriptor[2]) };
        let end = descriptor.len() + length;
        let Some(data) = self.buffer.get(descriptor.len()..end).map(<[u8]>::to_vec) else { return };
        self.buffer.drain(..end);
        self.counts.packets += 1;
        self.phase = self.after(command, &data, arrived);
    }

    /// What follows a response.
    fn after(&mut self, command: Command, data: &[u8], now: Time) -> Phase {
        match (command, data) {
            (Command::GetHealth, [2, low, high, ..]) => {
                let code = u16::from_le_bytes([*low, *high]);
                self.health = Some(format!(
                    "the lidar has stopped to protect itself (error code {code}): switch its power off and on"
                ));
                let command = if self.was_reset { Command::GetHealth } else { Command::Reset };
                self.was_reset = true;
                Phase::Say(command, now + AFTER_RESET)
            }
            (Command::GetHealth, [status, ..]) => {
                self.was_reset = false;
                self.health = (*status == 1).then(|| "the lidar reports that it may fail soon".to_owned());
                Phase::Say(Command::GetInfo, now)
            }
            (Command::GetInfo, [model, minor, major, hardware, ..]) => {
                tracing::info!(
                    "the RPLIDAR has model number {model:#04x}, firmware {major}.{minor:02}, hardware {hardware}"
                );
                Phase::Say(Command::GetSampleRate, now)
            }
            (Command::GetSampleRate, [low, high, ..]) => {
                let sample = Duration::from_micros(u16::from_le_bytes([*low, *high]).into());
                // Other values are no times of this lidar.
                let is_plausible = (100..=2000).contains(&sample.as_micros());
                self.sample = if is_plausible { sample } else { SAMPLE };
                Phase::Say(Command::Scan, now)
            }
            _ => {
                self.is_aligned = true;
                self.last = None;
                Phase::Scanning { last: now + SPIN_UP }
            }
        }
    }

    /// Takes the nodes at the start of the buffer.
    fn take_nodes(&mut self, arrived: Time, samples: &mut Vec<Sample>) {
        // A byte that is lost inside of a node shows in the next one only.
        while let [Some(bytes), Some(next)] = [self.node_at(0), self.node_at(NODE)] {
            if !self.is_aligned {
                if self.buffer.len() < NODE * IN_A_ROW {
                    return;
                }
                if !self.begins_nodes() {
                    self.skip(1);
                    continue;
                }
                self.is_aligned = true;
            }
            let node = Node::parse(bytes).filter(|node| self.last.is_none_or(|last| node.follows(last)));
            let is_followed = |node: &Node| Node::parse(next).is_some_and(|next| next.follows(*node));
            let Some(node) = node.filter(is_followed) else {
                self.counts.corrupt += 1;
                self.is_aligned = false;
                self.last = None;
                // What follows this one may be whole.
                self.skip(1);
                continue;
            };
            self.buffer.drain(..NODE);
            self.counts.packets += 1;
            self.last = Some(node);
            self.trouble = None;
            self.phase = Phase::Scanning { last: arrived };
            // Nodes that waited together came one after the other.
            let following = self.buffer.len();
            let waited = self.sample * count(following / NODE) + BYTE * count(following % NODE);
            samples.push(Sample {
                clockwise_deg: f64::from(node.angle_q6) / 64.0,
                range: f64::from(node.distance_q2) / 4000.0,
                intensity: node.quality.into(),
                time: arrived - waited,
            });
        }
    }

    fn node_at(&self, at: usize) -> Option<[u8; NODE]> {
        self.buffer.get(at..at + NODE)?.first_chunk().copied()
    }

    /// Whether valid nodes that can follow each other begin at the start of the buffer.
    fn begins_nodes(&self) -> bool {
        let nodes = self.buffer.chunks_exact(NODE).take(IN_A_ROW);
        let mut last: Option<Node> = None;
        nodes.filter_map(|bytes| Node::parse(*bytes.first_chunk()?)).fold(0, |count, node| {
            let follows = last.is_none_or(|before| node.follows(before));
            last = Some(node);
            count + usize::from(follows)
        }) == IN_A_ROW
    }
}

fn count(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}

impl Protocol for Driver {
    fn opened(&mut self, now: Time) {
        let counts = Counts { skipped: self.counts.skipped + self.buffer.len() as u64, ..self.counts };
        *self = Self { phase: Phase::Say(Command::Stop, now), counts, ..Self::default() };
    }

    fn request(&mut self, now: Time) -> Option<Vec<u8>> {
        match self.phase {
            Phase::Say(command, at) if at <= now => {
                self.phase = match command {
                    Command::Stop => Phase::Say(Command::GetHealth, now + AFTER_STOP),
                    Command::Reset => Phase::Say(Command::Stop, now + AFTER_RESET),
                    _ => Phase::Await(command, now + PATIENCE),
                };
                if command == Command::GetHealth {
                    // The rest of an earlier scan.
                    self.skip(self.buffer.len());
                }
                Some(command.to_bytes().to_vec())
            }
            // Firmware before 1.17 does not know it.
            Phase::Await(Command::GetSampleRate, until) if until <= now => {
                self.phase = Phase::Say(Command::Scan, now);
                None
            }
            Phase::Await(_, until) if until <= now => {
                self.trouble = Some("the lidar does not answer: is it an RPLIDAR A1, and has it power?");
                self.phase = Phase::Say(Command::Stop, now);
                None
            }
            Phase::Scanning { last } if last + PATIENCE <= now => {
                self.trouble = Some("the lidar sends no measurements: does its motor turn?");
                self.phase = Phase::Say(Command::Stop, now);
                None
            }
            _ => None,
        }
    }

    fn take(&mut self, bytes: &[u8], arrived: Time, samples: &mut Vec<Sample>) {
        self.buffer.extend(bytes);
        match self.phase {
            // Nothing is expected.
            Phase::Say(..) => self.skip(self.buffer.len()),
            Phase::Await(command, _) => self.take_response(command, arrived),
            Phase::Scanning { .. } => {}
        }
        if matches!(self.phase, Phase::Scanning { .. }) {
            self.take_nodes(arrived, samples);
        }
    }

    fn revolution(&self, measurements: usize) -> Option<Duration> {
        Some(self.sample * count(measurements))
    }

    fn fault(&self) -> Option<&str> {
        self.health.as_deref().or(self.trouble)
    }

    fn farewell(&self) -> Option<Vec<u8>> {
        Some(Command::Stop.to_bytes().to_vec())
    }

    fn counts(&self) -> Counts {
        self.counts
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    const fn at_ms(ms: i64) -> Time {
        Time::from_nanos(ms * 1_000_000)
    }

    fn nodes(count: u16) -> Vec<Node> {
        let node = |number: u16| Node {
            is_first: number.is_multiple_of(360),
            quality: 15,
            angle_q6: number % 360 * 64,
            distance_q2: 4000 + number,
        };
        (0..count).map(node).collect()
    }

    fn bytes(nodes: &[Node]) -> Vec<u8> {
        nodes.iter().flat_map(|node| node.to_bytes()).collect()
    }

    /// A driver that has begun to scan.
    fn scanning() -> Driver {
        let mut driver = Driver { phase: Phase::Await(Command::Scan, Time::MAX), ..Driver::default() };
        driver.take(&Command::Scan.descriptor().unwrap(), Time::ZERO, &mut Vec::new());
        assert!(matches!(driver.phase, Phase::Scanning { .. }));
        driver
    }

    /// The examples of the protocol's manual: requests of STOP, RESET, SCAN, GET_HEALTH and their responses'
    /// descriptors.
    #[test]
    fn requests_and_descriptors_are_those_of_the_manual() {
        let requests = Command::ALL.map(Command::to_bytes);
        assert_eq!(
            requests,
            [[0xA5, 0x25], [0xA5, 0x40], [0xA5, 0x20], [0xA5, 0x50], [0xA5, 0x52], [0xA5, 0x59]]
        );
        let descriptor = |command: Command| command.descriptor().unwrap();
        assert_eq!(descriptor(Command::Scan), [0xA5, 0x5A, 0x05, 0, 0, 0x40, 0x81]);
        assert_eq!(descriptor(Command::GetInfo), [0xA5, 0x5A, 0x14, 0, 0, 0, 0x04]);
        assert_eq!(descriptor(Command::GetHealth), [0xA5, 0x5A, 0x03, 0, 0, 0, 0x06]);
        assert_eq!(descriptor(Command::GetSampleRate), [0xA5, 0x5A, 0x04, 0, 0, 0, 0x15]);
    }

    /// Bits as in figure 4-4 of the manual: quality, !S, S; angle, C; distance.
    #[test]
    fn a_node_has_its_bits_where_the_manual_has_them() {
        let node = Node::parse([0b0011_1101, 0b1000_0001, 0b0010_1100, 0xA0, 0x0F]).unwrap();
        assert_eq!(node, Node { is_first: true, quality: 15, angle_q6: 0x1640, distance_q2: 4000 });
        assert_eq!(node.to_bytes(), [0x3D, 0x81, 0x2C, 0xA0, 0x0F]);
        assert_eq!(f64::from(node.angle_q6) / 64.0, 89.0);
        assert_eq!(Node::parse([0b0011_1111, 0x81, 0x2C, 0, 0]), None, "S and !S are equal");
        assert_eq!(Node::parse([0b0011_1101, 0x80, 0x2C, 0, 0]), None, "C is 0");
        assert_eq!(Node::parse([0b0011_1101, 0xFF, 0xFF, 0, 0]), None, "an angle above 360°");
    }

    #[test]
    fn the_conversation_begins_with_stop_and_ends_in_a_scan() {
        let (mut driver, mut samples) = (Driver::default(), Vec::new());
        driver.opened(at_ms(0));
        assert_eq!(driver.request(at_ms(0)), Some(vec![0xA5, 0x25]));
        driver.take(&bytes(&nodes(9)), at_ms(5), &mut samples);
        assert_eq!(driver.request(at_ms(50)), None);
        assert_eq!(driver.request(at_ms(100)), Some(vec![0xA5, 0x52]));
        // The rest of an earlier scan, and the answer in two pieces.
        let health = [&bytes(&nodes(3))[..7], &Command::GetHealth.descriptor().unwrap(), &[0, 0, 0]].concat();
        driver.take(&health[..12], at_ms(110), &mut samples);
        assert_eq!(driver.request(at_ms(110)), None);
        driver.take(&health[12..], at_ms(111), &mut samples);
        assert_eq!(driver.request(at_ms(111)), Some(vec![0xA5, 0x50]));
        let info = [&Command::GetInfo.descriptor().unwrap()[..], &[0x18, 29, 1, 7], &[0; 16]].concat();
        driver.take(&info, at_ms(120), &mut samples);
        assert_eq!(driver.request(at_ms(120)), Some(vec![0xA5, 0x59]));
        let rate = [&Command::GetSampleRate.descriptor().unwrap()[..], &[0xF8, 0x01, 0xF0, 0]].concat();
        driver.take(&rate, at_ms(125), &mut samples);
        assert_eq!(driver.request(at_ms(125)), Some(vec![0xA5, 0x20]));
        let scan = [Command::Scan.descriptor().unwrap().to_vec(), bytes(&nodes(5))].concat();
        driver.take(&scan, at_ms(2000), &mut samples);
        let sample = Duration::from_micros(504);
        let last = Sample { clockwise_deg: 3.0, range: 1.00075, intensity: 15.0, time: at_ms(2000) - sample };
        assert_eq!((samples.len(), samples[3]), (4, last), "the last one waits for its successor");
        assert_eq!(samples[0].time, at_ms(2000) - sample * 4);
        assert_eq!(driver.fault(), None);
        assert_eq!(driver.request(at_ms(2001)), None);
        assert_eq!(driver.revolution(360).unwrap(), Duration::from_micros(360 * 504));
    }

    #[test]
    fn a_lidar_in_protection_stop_is_reset_once_and_then_reported() {
        let mut driver = Driver { phase: Phase::Await(Command::GetHealth, Time::MAX), ..Driver::default() };
        let stopped = [&Command::GetHealth.descriptor().unwrap()[..], &[2, 0x34, 0x12]].concat();
        driver.take(&stopped, at_ms(0), &mut Vec::new());
        assert_eq!(driver.request(at_ms(1000)), Some(vec![0xA5, 0x40]));
        assert!(driver.fault().unwrap().contains("error code 4660"));
        assert_eq!(driver.request(at_ms(2000)), Some(vec![0xA5, 0x25]));
        assert_eq!(driver.request(at_ms(2100)), Some(vec![0xA5, 0x52]));
        driver.take(&stopped, at_ms(2110), &mut Vec::new());
        assert_eq!(driver.request(at_ms(3200)), Some(vec![0xA5, 0x52]), "it is asked again, not reset again");
    }

    #[test]
    fn a_silent_lidar_is_addressed_again_and_old_firmware_needs_no_sample_rate() {
        let mut driver = Driver::default();
        driver.opened(at_ms(0));
        assert!(driver.request(at_ms(0)).is_some() && driver.request(at_ms(100)).is_some());
        assert_eq!(driver.request(at_ms(600)), None);
        assert!(driver.fault().unwrap().contains("does not answer"));
        assert_eq!(driver.request(at_ms(600)), Some(vec![0xA5, 0x25]));
        let mut old = Driver { phase: Phase::Await(Command::GetSampleRate, at_ms(10)), ..Driver::default() };
        assert_eq!((old.request(at_ms(10)), old.request(at_ms(10))), (None, Some(vec![0xA5, 0x20])));
        let mut still = scanning();
        assert_eq!(still.request(at_ms(3400)), None, "the motor may take its time");
        assert_eq!(still.fault(), None);
        assert_eq!(still.request(at_ms(3500)), None);
        assert!(still.fault().unwrap().contains("does its motor turn"));
        assert_eq!(still.request(at_ms(3500)), Some(vec![0xA5, 0x25]));
    }

    #[test]
    fn a_lost_byte_costs_no_wrong_measurement() {
        let nodes = nodes(600);
        for lost in 500..520 {
            let mut stream = bytes(&nodes);
            stream.remove(lost);
            let (mut driver, mut samples) = (scanning(), Vec::new());
            for piece in stream.chunks(33) {
                driver.take(piece, Time::ZERO, &mut samples);
            }
            let distances: Vec<_> =
                samples.iter().map(|sample| (sample.range * 4000.0).round() as u16).collect();
            let right =
                distances.iter().filter(|&distance| nodes.iter().any(|node| node.distance_q2 == *distance));
            assert_eq!(right.count(), distances.len(), "{lost}");
            assert!(samples.len() >= 590, "{lost}: {} of 600", samples.len());
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_survived_within_bounded_memory(bytes in prop::collection::vec(any::<u8>(), 0..3000)) {
            let (mut driver, mut samples) = (scanning(), Vec::new());
            for piece in bytes.chunks(100) {
                driver.take(piece, Time::ZERO, &mut samples);
                prop_assert!(driver.buffer.len() < NODE * IN_A_ROW);
            }
            let before = samples.len();
            let valid: Vec<u8> = nodes(40).iter().flat_map(|node| node.to_bytes()).collect();
            driver.take(&valid, Time::ZERO, &mut samples);
            prop_assert!(samples.len() >= before + 30, "{} of 40", samples.len() - before);
        }

        #[test]
        fn any_answer_is_survived_in_each_phase(bytes in prop::collection::vec(any::<u8>(), 0..300), index in 0_usize..6) {
            let command = Command::ALL[index];
            let mut driver = Driver { phase: Phase::Await(command, Time::MAX), ..Driver::default() };
            driver.take(&bytes, Time::ZERO, &mut Vec::new());
            if let Some(descriptor) = command.descriptor() {
                driver.take(&[&descriptor[..], &[0; 20]].concat(), Time::ZERO, &mut Vec::new());
                let is_over = !matches!(driver.phase, Phase::Await(..));
                prop_assert!(is_over || driver.buffer.len() < 64);
            }
        }
    }
}
