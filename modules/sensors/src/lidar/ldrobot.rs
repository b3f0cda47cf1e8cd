//! Packets of the LDROBOT LD06 and LD19.
//!
//! The lidar sends without being asked, at 230400 bit/s, once its rotation is stable. A packet has 12
//! measurements:
//!
//! | bytes | |
//! | --- | --- |
//! | 0 | `0x54` |
//! | 1 | `0x2C`: type 1 in the upper three bits, 12 measurements in the lower five |
//! | 2, 3 | speed, °/s |
//! | 4, 5 | direction of the first measurement, 0.01°, clockwise |
//! | 6..42 | 12 times: distance, mm (2 bytes), and intensity (1 byte) |
//! | 42, 43 | direction of the last measurement |
//! | 44, 45 | the lidar's time, ms, from 0 to 29999 |
//! | 46 | CRC-8 of the bytes before, polynomial 0x4D |
//!
//! Numbers are little endian. Measurements lie at equal angles between the first and the last direction.
//!
//! # References
//! LDROBOT, "LD19 Development Manual" V2.3 and V2.5; `ldrobotSensorTeam/ldlidar_stl_ros2`.

use std::time::Duration;

use downbeat_executor::Time;

use super::{Counts, Protocol, Sample};

/// The speed of the port, in bit/s.
pub const BAUD: u32 = 230_400;
/// The length of a packet.
pub const LENGTH: usize = 47;
/// The measurements in a packet.
pub const MEASUREMENTS: usize = 12;
/// The bytes with which a packet begins.
pub const HEADER: [u8; 2] = [0x54, 0x2C];

/// The time from one measurement to the next: 4500 per second.
const SAMPLE: Duration = Duration::from_nanos(222_222);
/// A byte on the line: 10 bits.
const BYTE: Duration = Duration::from_nanos(10 * 1_000_000_000 / BAUD as u64);
/// A packet that spans more than this, in 0.01°, is nonsense: twelve measurements at 13 revolutions per
/// second span 12.5°.
const WIDEST: u32 = 4500;

/// A packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet {
    /// How fast the lidar turns, in °/s.
    pub speed_dps: u16,
    /// The direction of the first measurement, clockwise, in 0.01°.
    pub start_cdeg: u16,
    /// Distance in mm, 0 without echo, and intensity.
    pub measurements: [(u16, u8); MEASUREMENTS],
    /// The direction of the last measurement.
    pub end_cdeg: u16,
    /// The lidar's time, in ms, which starts again at 30000.
    pub timestamp_ms: u16,
}

impl Packet {
    /// Reads a packet. `None` if header or checksum are wrong.
    #[must_use]
    pub fn parse(bytes: &[u8; LENGTH]) -> Option<Self> {
        let (body, check) = (bytes.get(..LENGTH - 1)?, *bytes.last()?);
        if !bytes.starts_with(&HEADER) || crc8(body) != check {
            return None;
        }
        let number = |at: usize| Some(u16::from_le_bytes([*bytes.get(at)?, *bytes.get(at + 1)?]));
        let mut measurements = [(0, 0); MEASUREMENTS];
        for (index, measurement) in measurements.iter_mut().enumerate() {
            let at = 6 + 3 * index;
            *measurement = (number(at)?, *bytes.get(at + 2)?);
        }
        Some(Self {
            speed_dps: number(2)?,
            start_cdeg: number(4)?,
            measurements,
            end_cdeg: number(42)?,
            timestamp_ms: number(44)?,
        })
    }

    /// The bytes of the packet.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = HEADER.to_vec();
        bytes.extend(self.speed_dps.to_le_bytes());
        bytes.extend(self.start_cdeg.to_le_bytes());
        for (distance, intensity) in self.measurements {
            bytes.extend(distance.to_le_bytes());
            bytes.push(intensity);
        }
        bytes.extend(self.end_cdeg.to_le_bytes());
        bytes.extend(self.timestamp_ms.to_le_bytes());
        bytes.push(crc8(&bytes));
        bytes
    }

    /// The direction of each measurement in degrees from 0 to 360; `None` if the packet's directions are
    /// nonsense.
    #[must_use]
    pub fn directions_deg(&self) -> Option<[f64; MEASUREMENTS]> {
        if self.start_cdeg >= 36_000 || self.end_cdeg >= 36_000 {
            return None;
        }
        let span = (u32::from(self.end_cdeg) + 36_000 - u32::from(self.start_cdeg)) % 36_000;
        if span > WIDEST {
            return None;
        }
        let step = f64::from(span) / (MEASUREMENTS - 1) as f64;
        let start = f64::from(self.start_cdeg);
        Some(std::array::from_fn(|index| (start + step * index as f64) % 36_000.0 / 100.0))
    }
}

/// The checksum: CRC-8 with polynomial 0x4D, from 0, neither reflected nor inverted.
#[must_use]
pub fn crc8(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |crc, byte| TABLE[usize::from(crc ^ byte)])
}

const TABLE: [u8; 256] = {
    let mut table = [0; 256];
    let mut index = 0;
    while index < 256 {
        let mut crc = index as u8;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 0x80 == 0 { crc << 1 } else { crc << 1 ^ 0x4D };
            bit += 1;
        }
        table[index] = crc;
        index += 1;
    }
    table
};

/// Finds packets in a stream of bytes.
#[derive(Debug, Default)]
pub struct Receiver {
    buffer: Vec<u8>,
    counts: Counts,
    speed_dps: u16,
}

impl Receiver {
    /// Appends received bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.extend(bytes);
    }

    /// The next packet with the number of bytes that follow it so far. Bytes that belong to none are skipped
    /// and counted.
    pub fn next_packet(&mut self) -> Option<(Packet, usize)> {
        loop {
            let is_start = |window: &[u8]| HEADER.starts_with(window) || window.starts_with(&HEADER);
            // The last byte may be the first one of a header.
            let start = (0..self.buffer.len()).find(|&at| {
                let end = self.buffer.len().min(at + HEADER.len());
                self.buffer.get(at..end).is_some_and(is_start)
            });
            let garbage = start.unwrap_or(self.buffer.len());
            self.counts.skipped += garbage as u64;
            self.buffer.drain(..garbage);
            let packet = self.buffer.first_chunk::<LENGTH>()?;
            if let Some(packet) = Packet::parse(packet) {
                self.counts.packets += 1;
                self.buffer.drain(..LENGTH);
                return Some((packet, self.buffer.len()));
            }
            // A packet may begin inside of what looked like one.
            self.counts.corrupt += 1;
            self.counts.skipped += 1;
            self.buffer.drain(..1);
        }
    }
}

fn count(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}

impl Protocol for Receiver {
    fn opened(&mut self, _now: Time) {
        self.counts.skipped += self.buffer.len() as u64;
        self.buffer.clear();
        self.speed_dps = 0;
    }

    fn take(&mut self, bytes: &[u8], arrived: Time, samples: &mut Vec<Sample>) {
        self.push(bytes);
        while let Some((packet, following)) = self.next_packet() {
            let Some(directions) = packet.directions_deg() else {
                self.counts.corrupt += 1;
                continue;
            };
            self.speed_dps = packet.speed_dps;
            // Packets that waited together came one after the other.
            let [packets, bytes] = [following / LENGTH, following % LENGTH];
            let waited = SAMPLE * count(packets * MEASUREMENTS) + BYTE * count(bytes);
            let sent = arrived - waited;
            for (index, (direction, (distance, intensity))) in
                directions.into_iter().zip(packet.measurements).enumerate()
            {
                let earlier = count(MEASUREMENTS - 1 - index);
                samples.push(Sample {
                    clockwise_deg: direction,
                    range: f64::from(distance) / 1000.0,
                    intensity: intensity.into(),
                    time: sent - SAMPLE * earlier,
                });
            }
        }
    }

    fn revolution(&self, _measurements: usize) -> Option<Duration> {
        let speed = f64::from(self.speed_dps);
        (speed > 0.0).then(|| Duration::from_secs_f64(360.0 / speed))
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

    /// The example of the LD19 Development Manual.
    const EXAMPLE: [u8; LENGTH] = [
        0x54, 0x2C, 0x68, 0x08, 0xAB, 0x7E, 0xE0, 0x00, 0xE4, 0xDC, 0x00, 0xE2, 0xD9, 0x00, 0xE5, 0xD5, 0x00,
        0xE3, 0xD3, 0x00, 0xE4, 0xD0, 0x00, 0xE9, 0xCD, 0x00, 0xE4, 0xCA, 0x00, 0xE2, 0xC7, 0x00, 0xE9, 0xC5,
        0x00, 0xE5, 0xC2, 0x00, 0xE5, 0xC0, 0x00, 0xE5, 0xBE, 0x82, 0x3A, 0x1A, 0x50,
    ];

    #[test]
    fn the_example_of_the_manual_is_read_as_the_manual_reads_it() {
        let packet = Packet::parse(&EXAMPLE).unwrap();
        assert_eq!((packet.speed_dps, packet.start_cdeg, packet.end_cdeg), (2152, 32_427, 33_470));
        assert_eq!((packet.measurements[0], packet.measurements[1]), ((224, 228), (220, 226)));
        assert_eq!((packet.measurements[11], packet.timestamp_ms), ((192, 229), 6714));
        assert_eq!(packet.to_bytes(), EXAMPLE);
        let directions = packet.directions_deg().unwrap();
        assert!((directions[0] - 324.27).abs() < 1e-9 && (directions[11] - 334.70).abs() < 1e-9);
        assert!((directions[1] - directions[0] - 10.43 / 11.0).abs() < 1e-9);
    }

    #[test]
    fn the_table_of_the_checksum_begins_as_that_of_the_manual() {
        assert_eq!(TABLE[..8], [0x00, 0x4d, 0x9a, 0xd7, 0x79, 0x34, 0xe3, 0xae]);
    }

    #[test]
    fn directions_pass_the_front() {
        let packet = Packet { start_cdeg: 35_900, end_cdeg: 200, ..Packet::parse(&EXAMPLE).unwrap() };
        let directions = packet.directions_deg().unwrap();
        assert!((directions[11] - 2.0).abs() < 1e-9, "{directions:?}");
        assert!(directions.iter().all(|direction| (0.0..360.0).contains(direction)));
        let nonsense = Packet { end_cdeg: 40_000, ..packet };
        assert_eq!(nonsense.directions_deg(), None);
    }

    #[test]
    fn measurements_have_the_times_at_which_they_were_made() {
        let (mut receiver, mut samples) = (Receiver::default(), Vec::new());
        let at = Time::from_nanos(1_000_000_000);
        receiver.take(&[&EXAMPLE[..], &[0x54, 0x2C, 0x00]].concat(), at, &mut samples);
        assert_eq!(samples.len(), MEASUREMENTS);
        assert_eq!(samples[11].time, at - BYTE * 3);
        assert_eq!(samples[0].time, at - BYTE * 3 - SAMPLE * 11);
        assert!((samples[0].range - 0.224).abs() < 1e-12);
        assert_eq!(receiver.revolution(450).unwrap().as_millis(), 167);
    }

    #[test]
    fn packets_that_waited_together_were_sent_one_after_the_other() {
        let (mut receiver, mut samples) = (Receiver::default(), Vec::new());
        let at = Time::from_nanos(1_000_000_000);
        receiver.take(&EXAMPLE.repeat(3), at, &mut samples);
        let steps = samples.windows(2).map(|pair| pair[1].time.saturating_since(pair[0].time));
        assert!(steps.clone().all(|step| step == SAMPLE), "{:?}", steps.collect::<Vec<_>>());
        assert_eq!(samples[35].time, at);
    }

    #[test]
    fn a_packet_inside_of_a_damaged_one_is_found() {
        let mut receiver = Receiver::default();
        receiver.push(&EXAMPLE[..20]);
        receiver.push(&EXAMPLE);
        assert_eq!(receiver.next_packet(), Some((Packet::parse(&EXAMPLE).unwrap(), 0)));
        assert_eq!(receiver.counts, Counts { packets: 1, corrupt: 1, skipped: 20 });
    }

    proptest! {
        /// However a stream is cut into pieces and whatever stands between its packets, no packet is lost or
        /// read wrongly.
        #[test]
        fn packets_are_found_among_garbage_and_in_pieces(
            garbage in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..120), 1..5),
            cut in 1_usize..60,
        ) {
            // Garbage without the start of a packet: what looks like one may swallow its successor's
            // beginning, but no more.
            let clean = |bytes: &Vec<u8>| bytes.iter().map(|byte| if *byte == 0x54 { 0 } else { *byte }).collect::<Vec<_>>();
            let stream: Vec<u8> = garbage.iter().flat_map(|bytes| [clean(bytes), EXAMPLE.to_vec()].concat()).collect();
            let (mut receiver, mut samples) = (Receiver::default(), Vec::new());
            for piece in stream.chunks(cut) {
                receiver.take(piece, Time::ZERO, &mut samples);
            }
            prop_assert_eq!(samples.len(), garbage.len() * MEASUREMENTS);
            let skipped: usize = garbage.iter().map(Vec::len).sum();
            prop_assert_eq!(receiver.counts, Counts { packets: garbage.len() as u64, corrupt: 0, skipped: skipped as u64 });
        }

        #[test]
        fn any_bytes_are_survived_within_bounded_memory(bytes in prop::collection::vec(any::<u8>(), 0..2000)) {
            let (mut receiver, mut samples) = (Receiver::default(), Vec::new());
            for piece in bytes.chunks(100) {
                receiver.take(piece, Time::ZERO, &mut samples);
                prop_assert!(receiver.buffer.len() < LENGTH);
            }
            receiver.take(&EXAMPLE, Time::ZERO, &mut samples);
            receiver.take(&EXAMPLE, Time::ZERO, &mut samples);
            prop_assert!(samples.len() >= MEASUREMENTS, "the receiver finds the way back within one packet");
        }
    }
}
