//! Sentences of NMEA 0183: `$GPGGA,…*47`, each on a line.
//!
//! A sentence without a checksum, or with a wrong one, is not used. The first two letters name the talker (GP
//! for GPS, GL GLONASS, GA Galileo, GB and BD BeiDou, GN several systems), the next three what it says.
//! Proprietary sentences (`$P…`) are not read.
//!
//! # References
//! NMEA 0183 as described in u-blox, "u-blox 8 / u-blox M8 Receiver Description" (UBX-13003221), chapter 31;
//! D. DePriest, "NMEA data".

use std::str;

/// The longest line that is taken for a sentence. The standard allows 82, receivers exceed it.
pub const LONGEST: usize = 256;

/// What a receiver says.
#[derive(Clone, Debug, PartialEq)]
pub struct Sentence {
    /// The letters before what it says, such as GP.
    pub talker: [u8; 2],
    /// What it says.
    pub content: Content,
}

/// The contents that are read.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
    /// The position.
    Gga(Gga),
    /// Position, velocity and date: the recommended minimum.
    Rmc(Rmc),
    /// Which satellites are used, and how well they are distributed.
    Gsa(Gsa),
    /// Deviations of the position.
    Gst(Gst),
    /// The velocity.
    Vtg(Vtg),
    /// Anything else.
    Other,
}

/// A time of a day in UTC, in ns.
pub type TimeOfDay = u64;

/// The position.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gga {
    /// When it was measured.
    pub time: Option<TimeOfDay>,
    /// North and east, in degrees.
    pub position: Option<[f64; 2]>,
    /// 0 no fix, 1 fix, 2 differential, 3 PPS, 4 RTK, 5 RTK float, 6 dead reckoning, 7 given by hand, 8
    /// simulated, 9 satellite-based.
    pub quality: u8,
    /// The number of satellites used.
    pub satellites: Option<u32>,
    /// Horizontal dilution of precision.
    pub hdop: Option<f64>,
    /// Above the mean sea level, in m.
    pub altitude: Option<f64>,
    /// From the ellipsoid of WGS 84 up to the mean sea level, in m.
    pub geoid_separation: Option<f64>,
}

/// Position, velocity and date.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rmc {
    /// When it was measured.
    pub time: Option<TimeOfDay>,
    /// Whether the receiver holds it for valid.
    pub is_valid: bool,
    /// North and east, in degrees.
    pub position: Option<[f64; 2]>,
    /// In m/s over ground.
    pub speed: Option<f64>,
    /// From true north, clockwise, in degrees.
    pub course: Option<f64>,
    /// Days since the Unix epoch.
    pub date: Option<i64>,
}

/// Which satellites are used.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gsa {
    /// The number of satellites in this sentence.
    pub satellites: u32,
    /// Vertical dilution of precision.
    pub vdop: Option<f64>,
    /// The system, since NMEA 4.10: 1 GPS, 2 GLONASS, 3 Galileo, 4 BeiDou.
    pub system: Option<u32>,
}

/// Deviations of the position, in m.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gst {
    /// Of the latitude.
    pub north: Option<f64>,
    /// Of the longitude.
    pub east: Option<f64>,
    /// Of the altitude.
    pub up: Option<f64>,
}

/// The velocity.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Vtg {
    /// From true north, clockwise, in degrees.
    pub course: Option<f64>,
    /// In m/s over ground.
    pub speed: Option<f64>,
}

/// A knot, in m/s.
const KNOT: f64 = 1852.0 / 3600.0;

impl Sentence {
    /// Reads a sentence from `$` to the checksum, without the end of the line. `None` if it is damaged.
    #[must_use]
    pub fn parse(line: &[u8]) -> Option<Self> {
        let line = line.strip_prefix(b"$")?;
        let star = line.iter().rposition(|byte| *byte == b'*')?;
        let (body, check) = (line.get(..star)?, str::from_utf8(line.get(star + 1..)?).ok()?);
        if check.len() != 2 || u8::from_str_radix(check, 16).ok()? != checksum(body) {
            return None;
        }
        let body = str::from_utf8(body).ok().filter(|body| body.is_ascii())?;
        let mut fields = body.split(',');
        let address = fields.next()?.as_bytes();
        let fields = Fields(fields.collect());
        let (talker, kind) = match address {
            [b'P', ..] => (*b"P ", &b""[..]),
            [first, second, kind @ ..] => ([*first, *second], kind),
            _ => return None,
        };
        let content = match kind {
            b"GGA" => Content::Gga(Gga {
                time: fields.time(0),
                position: fields.position(1),
                quality: fields.whole(5).and_then(|quality| quality.try_into().ok()).unwrap_or_default(),
                satellites: fields.whole(6),
                hdop: fields.number(7),
                altitude: fields.number(8),
                geoid_separation: fields.number(10),
            }),
            b"RMC" => Content::Rmc(Rmc {
                time: fields.time(0),
                is_valid: fields.text(1) == "A",
                position: fields.position(2),
                speed: fields.number(6).map(|knots| knots * KNOT),
                course: fields.number(7),
                date: fields.date(8),
            }),
            b"GSA" => Content::Gsa(Gsa {
                satellites: (2..14).filter(|&index| !fields.text(index).is_empty()).count() as u32,
                vdop: fields.number(16),
                system: fields.whole(17),
            }),
            b"GST" => {
                Content::Gst(Gst { north: fields.number(5), east: fields.number(6), up: fields.number(7) })
            }
            b"VTG" => Content::Vtg(Vtg {
                course: fields.number(0),
                speed: fields.number(4).map(|knots| knots * KNOT),
            }),
            _ => Content::Other,
        };
        Some(Self { talker, content })
    }
}

/// The exclusive or of the bytes between `$` and `*`.
#[must_use]
pub fn checksum(body: &[u8]) -> u8 {
    body.iter().fold(0, |sum, byte| sum ^ byte)
}

/// The line of a sentence with this body.
#[must_use]
pub fn line(body: &str) -> Vec<u8> {
    format!("${body}*{:02X}\r\n", checksum(body.as_bytes())).into_bytes()
}

struct Fields<'a>(Vec<&'a str>);

impl Fields<'_> {
    fn text(&self, index: usize) -> &str {
        self.0.get(index).copied().unwrap_or_default()
    }

    fn number(&self, index: usize) -> Option<f64> {
        decimal(self.text(index))
    }

    fn whole(&self, index: usize) -> Option<u32> {
        self.text(index).parse().ok()
    }

    /// `hhmmss.sss`
    fn time(&self, index: usize) -> Option<TimeOfDay> {
        let text = self.text(index);
        let (hours, minutes) = (two_digits(text, 0)?, two_digits(text, 2)?);
        let seconds = decimal(text.get(4..)?).filter(|seconds| (0.0..61.0).contains(seconds))?;
        (hours < 24 && minutes < 60)
            .then(|| (hours * 3600 + minutes * 60) * 1_000_000_000 + (seconds * 1e9).round() as u64)
    }

    /// `ddmmyy`, as days since the Unix epoch.
    fn date(&self, index: usize) -> Option<i64> {
        let text = self.text(index);
        let [day, month, year] = [two_digits(text, 0)?, two_digits(text, 2)?, two_digits(text, 4)?];
        // GPS began in 1980.
        let year = if year >= 80 { 1900 + year } else { 2000 + year };
        ((1..=31).contains(&day) && (1..=12).contains(&month))
            .then(|| days_since_epoch(year as i64, month as i64, day as i64))
    }

    /// Latitude, `N` or `S`, longitude, `E` or `W`, in degrees.
    fn position(&self, index: usize) -> Option<[f64; 2]> {
        let sign = |index: usize, plus: &str, minus: &str| match self.text(index) {
            text if text == plus => Some(1.0),
            text if text == minus => Some(-1.0),
            _ => None,
        };
        let latitude = angle(self.text(index)).filter(|latitude| *latitude <= 90.0)?;
        let longitude = angle(self.text(index + 2)).filter(|longitude| *longitude <= 180.0)?;
        Some([sign(index + 1, "N", "S")? * latitude, sign(index + 3, "E", "W")? * longitude])
    }
}

/// `dddmm.mmmm` in degrees.
fn angle(text: &str) -> Option<f64> {
    let whole = text.find('.').unwrap_or(text.len());
    let (degrees, minutes) = text.split_at_checked(whole.checked_sub(2)?)?;
    let minutes = decimal(minutes).filter(|minutes| (0.0..60.0).contains(minutes))?;
    let degrees: u16 = degrees.parse().ok()?;
    Some(f64::from(degrees) + minutes / 60.0)
}

/// A decimal number: other texts that Rust reads as numbers, such as `inf` and `1e9`, are none.
fn decimal(text: &str) -> Option<f64> {
    let is_decimal = text.bytes().all(|byte| byte.is_ascii_digit() || matches!(byte, b'.' | b'-' | b'+'));
    if is_decimal { text.parse().ok() } else { None }
}

fn two_digits(text: &str, at: usize) -> Option<u64> {
    let digits = text.get(at..at + 2)?;
    digits.bytes().all(|byte| byte.is_ascii_digit()).then(|| digits.parse().ok())?
}

/// Days from 1970-01-01 to a day of the Gregorian calendar.
///
/// # References
/// H. Hinnant, "chrono-Compatible Low-Level Date Algorithms", `days_from_civil`.
fn days_since_epoch(year: i64, month: i64, day: i64) -> i64 {
    // The year begins in March, so that a leap day is its last.
    let year = if month <= 2 { year - 1 } else { year };
    let of_era = year.rem_euclid(400);
    let of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    year.div_euclid(400) * 146_097 + of_era * 365 + of_era / 4 - of_era / 100 + of_year - 719_468
}

/// Counts of a [`Receiver`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Valid sentences.
    pub sentences: u64,
    /// Sentences with a wrong checksum, or damaged otherwise.
    pub corrupt: u64,
    /// Bytes that belong to no sentence.
    pub skipped: u64,
}

/// Finds sentences in a stream of bytes.
#[derive(Debug, Default)]
pub struct Receiver {
    buffer: Vec<u8>,
    counts: Counts,
}

impl Receiver {
    /// Appends received bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.extend(bytes);
    }

    /// Forgets the sentence that has begun.
    pub fn reset(&mut self) {
        self.counts.skipped += self.buffer.len() as u64;
        self.buffer.clear();
    }

    /// What was received.
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// The next sentence with the number of bytes that follow its line so far.
    pub fn next_sentence(&mut self) -> Option<(Sentence, usize)> {
        loop {
            let start = self.buffer.iter().position(|byte| *byte == b'$').unwrap_or(self.buffer.len());
            // The ends of lines are no garbage.
            let is_garbage = |byte: &&u8| !matches!(byte, b'\r' | b'\n');
            self.counts.skipped +=
                self.buffer.drain(..start).as_slice().iter().filter(is_garbage).count() as u64;
            let is_end = |byte: &u8| matches!(byte, b'\r' | b'\n' | b'$');
            let Some(end) = self.buffer.iter().skip(1).position(is_end).map(|end| end + 1) else {
                if self.buffer.len() < LONGEST {
                    return None;
                }
                self.counts.corrupt += 1;
                self.reset();
                continue;
            };
            let sentence = Sentence::parse(self.buffer.get(..end).unwrap_or_default());
            self.buffer.drain(..end);
            let Some(sentence) = sentence else {
                self.counts.corrupt += 1;
                self.counts.skipped += end as u64;
                continue;
            };
            self.counts.sentences += 1;
            let ending = self.buffer.iter().take_while(|byte| matches!(byte, b'\r' | b'\n')).count();
            return Some((sentence, self.buffer.len() - ending));
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    fn content(line: &str) -> Content {
        Sentence::parse(line.as_bytes()).unwrap().content
    }

    const SECOND: u64 = 1_000_000_000;

    /// The examples of "NMEA data" by D. DePriest.
    #[test]
    fn the_examples_of_the_usual_reference_are_read() {
        let gga = "$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47";
        let expected = Gga {
            time: Some((12 * 3600 + 35 * 60 + 19) * SECOND),
            position: Some([48.0 + 7.038 / 60.0, 11.0 + 31.0 / 60.0]),
            quality: 1,
            satellites: Some(8),
            hdop: Some(0.9),
            altitude: Some(545.4),
            geoid_separation: Some(46.9),
        };
        assert_eq!(content(gga), Content::Gga(expected));
        assert_eq!(Sentence::parse(gga.as_bytes()).unwrap().talker, *b"GP");
        let rmc = "$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A";
        let Content::Rmc(rmc) = content(rmc) else { panic!("{rmc}") };
        assert_eq!((rmc.is_valid, rmc.course, rmc.date), (true, Some(84.4), Some(8847)));
        assert!((rmc.speed.unwrap() - 11.5235).abs() < 1e-3);
        let gsa = content("$GPGSA,A,3,04,05,,09,12,,,24,,,,,2.5,1.3,2.1*39");
        assert_eq!(gsa, Content::Gsa(Gsa { satellites: 5, vdop: Some(2.1), system: None }));
        let Content::Vtg(vtg) = content("$GPVTG,054.7,T,034.4,M,005.5,N,010.2,K*48") else { panic!() };
        assert_eq!(vtg.course, Some(54.7));
        assert!((vtg.speed.unwrap() - 10.2 / 3.6).abs() < 0.01, "km/h and knots agree");
    }

    /// The examples of the receiver description of u-blox 8.
    #[test]
    fn the_examples_of_u_blox_are_read() {
        let Content::Gga(gga) =
            content("$GPGGA,092725.00,4717.11399,N,00833.91590,E,1,08,1.01,499.6,M,48.0,M,,*5B")
        else {
            panic!()
        };
        assert_eq!((gga.hdop, gga.altitude, gga.geoid_separation), (Some(1.01), Some(499.6), Some(48.0)));
        let Content::Rmc(rmc) =
            content("$GPRMC,083559.00,A,4717.11437,N,00833.91522,E,0.004,77.52,091202,,,A*57")
        else {
            panic!()
        };
        assert_eq!((rmc.date, rmc.time), (Some(12_030), Some((8 * 3600 + 35 * 60 + 59) * SECOND)));
        let gst = content("$GPGST,082356.00,1.8,,,,1.7,1.3,2.2*7E");
        assert_eq!(gst, Content::Gst(Gst { north: Some(1.7), east: Some(1.3), up: Some(2.2) }));
        let gsa = content("$GPGSA,A,3,23,29,07,08,09,18,26,28,,,,,1.94,1.18,1.54,1*10");
        assert_eq!(gsa, Content::Gsa(Gsa { satellites: 8, vdop: Some(1.54), system: Some(1) }));
    }

    #[test]
    fn a_receiver_without_a_fix_leaves_fields_empty() {
        let Content::Gga(gga) =
            content(str::from_utf8(&line("GNGGA,,,,,,0,00,99.99,,,,,,")).unwrap().trim_end())
        else {
            panic!()
        };
        assert_eq!(gga, Gga { satellites: Some(0), hdop: Some(99.99), ..Gga::default() });
        let Content::Rmc(rmc) = content("$GPRMC,,V,,,,,,,,,,N*53") else { panic!() };
        assert_eq!(rmc, Rmc::default());
    }

    #[test]
    fn southern_and_western_positions_are_negative_and_impossible_ones_are_none() {
        let position = |text: &str| Fields(text.split(',').collect()).position(0);
        let [north, east] = position("3351.000,S,15112.600,E").unwrap();
        assert!((north + 33.85).abs() < 1e-9 && (east - 151.21).abs() < 1e-9);
        assert!((position("0030.0,N,00000.600,W").unwrap()[1] + 0.01).abs() < 1e-9);
        for wrong in [
            "9100.0,N,00000.0,E",
            "4860.0,N,0,E",
            "48,N,01131,E",
            "4807.0,X,01131.0,E",
            "inf,N,01131.0,E",
            "é07.0,N,1.0,E",
        ] {
            assert_eq!(position(wrong), None, "{wrong}");
        }
        let time = |text: &str| Fields(vec![text]).time(0);
        assert_eq!(time("235959.999"), Some(86_399_999_000_000));
        assert!([time("240000"), time("126000"), time("12"), time("+1+2+3")].iter().all(Option::is_none));
    }

    #[test]
    fn a_wrong_checksum_is_refused() {
        let right = "$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47";
        for wrong in [
            right.replace("*47", "*46"),
            right.replace("*47", ""),
            right.replace("4807", "4808"),
            right.replace("*47", "*+7"),
        ] {
            assert_eq!(Sentence::parse(wrong.as_bytes()), None, "{wrong}");
        }
    }

    #[test]
    fn other_and_proprietary_sentences_are_valid_but_not_read() {
        let parsed = |body: &str| Sentence::parse(line(body).trim_ascii_end()).unwrap().content;
        assert_eq!(parsed("GPGSV,1,1,00"), Content::Other);
        assert_eq!(parsed("PUBX,00,1"), Content::Other);
    }

    #[test]
    fn a_sentence_cut_off_by_the_next_one_costs_only_itself() {
        let mut receiver = Receiver::default();
        receiver.push(b"garbage$GPGGA,1235$GPRMC,,V,,,,,,,,,,N*53\r\n$GP");
        let (sentence, following) = receiver.next_sentence().unwrap();
        assert!(matches!(sentence.content, Content::Rmc(_)));
        assert_eq!(following, 3);
        assert_eq!(receiver.next_sentence(), None);
        assert_eq!(receiver.counts(), Counts { sentences: 1, corrupt: 1, skipped: 18 });
    }

    proptest! {
        #[test]
        fn any_bytes_are_survived_within_bounded_memory(bytes in prop::collection::vec(any::<u8>(), 0..3000), cut in 1_usize..90) {
            let mut receiver = Receiver::default();
            for piece in bytes.chunks(cut) {
                receiver.push(piece);
                while receiver.next_sentence().is_some() {}
                prop_assert!(receiver.buffer.len() < LONGEST);
            }
            receiver.push(b"\r\n$GPRMC,,V,,,,,,,,,,N*53\r\n");
            prop_assert!(std::iter::from_fn(|| receiver.next_sentence()).last().is_some());
        }

        /// Fields of any content give no panic, and no number that is not finite.
        #[test]
        fn any_fields_are_survived(kind in "(GGA|RMC|GSA|GST|VTG)", fields in prop::collection::vec("[0-9A-Za-z.+-]{0,12}", 0..20)) {
            let sentence = Sentence::parse(line(&format!("GN{kind},{}", fields.join(","))).trim_ascii_end());
            if let Content::Gga(gga) = sentence.unwrap().content {
                prop_assert!(gga.position.is_none_or(|[north, east]| north.abs() <= 90.0 && east.abs() <= 180.0));
                prop_assert!(gga.altitude.is_none_or(f64::is_finite));
            }
        }

        #[test]
        fn sentences_are_found_in_pieces(count in 1_usize..20, cut in 1_usize..100) {
            let stream = b"$GPVTG,77.52,T,,M,0.004,N,0.008,K,A*06\r\n".repeat(count);
            let (mut receiver, mut found) = (Receiver::default(), 0);
            for piece in stream.chunks(cut) {
                receiver.push(piece);
                found += std::iter::from_fn(|| receiver.next_sentence()).count();
            }
            prop_assert_eq!((found, receiver.counts().skipped), (count, 0));
        }
    }
}
