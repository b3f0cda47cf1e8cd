//! An emulated CAN bus: a log of `candump` that is played, and what is sent to it.

use std::collections::VecDeque;
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::time::Duration;

use downbeat_executor::Time;

use super::frame::{LENGTH, passes};
use super::source::{MOST_FRAMES, Sent, Source, Wanted};
use crate::kernel::{put, put_u32};

/// The largest log, in bytes.
const MOST_BYTES: u64 = 256 << 20;
/// The flags of identifiers, of `linux/can.h`.
const EXTENDED: u32 = 0x8000_0000;
const REMOTE: u32 = 0x4000_0000;
/// The most sent frames that wait to be received.
const MOST_WAITING: usize = 4_096;

/// An emulated bus. Frames of a log come at the times of their stamps; without a log none comes by itself.
/// Frames that are sent come back if the module receives its own.
#[derive(Default)]
pub struct CandumpLog {
    open: Option<Open>,
}

struct Open {
    wanted: Wanted,
    log: Vec<(Duration, [u8; LENGTH])>,
    next: usize,
    start: Option<Time>,
    own: VecDeque<[u8; LENGTH]>,
}

impl Source for CandumpLog {
    fn open(&mut self, wanted: &Wanted) -> Result<(), String> {
        let path = &wanted.interface;
        let mut log = Vec::new();
        if !path.is_empty() {
            let failed = |error: std::io::Error| format!("reading the log {path}: {error}");
            let mut text = String::new();
            File::open(path).map_err(failed)?.take(MOST_BYTES).read_to_string(&mut text).map_err(failed)?;
            log = parse(path, &text)?;
        }
        let own = VecDeque::new();
        self.open = Some(Open { wanted: wanted.clone(), log, next: 0, start: None, own });
        Ok(())
    }

    fn receive(&mut self, now: Time) -> Result<Vec<u8>, String> {
        let open = self.open.as_mut().ok_or("the bus is not open")?;
        let path = &open.wanted.interface;
        if !path.is_empty() && !Path::new(path).exists() {
            return Err(format!("the log {path} is gone"));
        }
        let since = now.saturating_since(*open.start.get_or_insert(now));
        let mut frames = Vec::new();
        while frames.len() < MOST_FRAMES * LENGTH {
            let due = open.log.get(open.next).filter(|(at, _)| *at <= since);
            let frame = match (open.own.pop_front(), due) {
                (Some(frame), _) => frame,
                (None, Some((_, frame))) => {
                    open.next += 1;
                    *frame
                }
                (None, None) => break,
            };
            if passes(&open.wanted.filters, &frame) {
                frames.extend(frame);
            }
        }
        Ok(frames)
    }

    fn send(&mut self, frame: &[u8; LENGTH]) -> Result<Sent, String> {
        let open = self.open.as_mut().ok_or("the bus is not open")?;
        if open.wanted.receives_own {
            if open.own.len() == MOST_WAITING {
                return Ok(Sent::Full);
            }
            open.own.push_back(*frame);
        }
        Ok(Sent::Yes)
    }

    fn close(&mut self) {
        self.open = None;
    }
}

/// Reads a log as `candump -l` writes it: `(1436509052.249713) can0 044#2A366C2BBA`. Times are since the
/// first line.
fn parse(path: &str, text: &str) -> Result<Vec<(Duration, [u8; LENGTH])>, String> {
    let mut log: Vec<(Duration, [u8; LENGTH])> = Vec::new();
    let mut first = None;
    for (number, line) in (1..).zip(text.lines()) {
        if line.trim().is_empty() {
            continue;
        }
        let (time, frame) = frame_of(line).ok_or_else(|| {
            format!("{path}:{number}: \"{}\" is no line of candump -l, such as (1436509052.249713) can0 044#2A366C2BBA", cut(line))
        })?;
        let first = *first.get_or_insert(time);
        log.push((time.saturating_sub(first), frame));
    }
    Ok(log)
}

fn cut(line: &str) -> String {
    line.chars().take(80).collect()
}

fn frame_of(line: &str) -> Option<(Duration, [u8; LENGTH])> {
    let mut words = line.split_whitespace();
    let time = words.next()?.strip_prefix('(')?.strip_suffix(')')?;
    let (seconds, fraction) = time.split_once('.')?;
    let microseconds = (fraction.len() == 6).then(|| fraction.parse().ok()).flatten()?;
    let time = Duration::from_secs(seconds.parse().ok()?).checked_add(Duration::from_micros(microseconds))?;
    let (id, content) = words.nth(1)?.split_once('#')?;
    let number = u32::from_str_radix(id, 16).ok()?;
    let mut frame = [0; LENGTH];
    let extended = match id.len() {
        3 => 0,
        // Errors are written with their own flag.
        8 if number & 0x2000_0000 == 0 => EXTENDED,
        8 => 0,
        _ => return None,
    };
    let mut length = 0;
    let remote = match content.strip_prefix('R') {
        Some(count) => {
            length = if count.is_empty() { 0 } else { count.parse().ok()? };
            REMOTE
        }
        None => 0,
    };
    if remote == 0 {
        if content.len() % 2 != 0 || !content.is_ascii() {
            return None;
        }
        for pair in content.as_bytes().chunks_exact(2) {
            let byte = u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok()?;
            put(&mut frame, 8 + usize::from(length), &[byte]);
            length += 1;
            if length > 8 {
                return None;
            }
        }
    }
    put_u32(&mut frame, 0, number | extended | remote);
    frame[4] = length;
    (length <= 8).then_some((time, frame))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::frame::Frame;
    use super::*;
    use downbeat_msgs::std_msgs::msg::Header;
    use proptest::prelude::*;

    /// The first line is that of the manual page of `candump`.
    #[test]
    fn a_log_of_candump_is_read_and_other_lines_are_told() {
        let text = "(1436509052.249713) vcan0 044#2A366C2BBA\n\n(1436509053.249713) vcan0 18FEF100#R\n(1436509053.5) x\n";
        let whole = text.rsplit_once('(').unwrap().0;
        let log = parse("a.log", whole).unwrap();
        let frames: Vec<Frame> =
            log.iter().map(|(_, frame)| Frame::parse(frame, Header::default())).collect();
        assert_eq!((frames[0].id, frames[0].dlc, frames[0].data[4]), (0x44, 5, 0xba));
        assert!(frames[1].is_extended && frames[1].is_rtr && frames[1].id == 0x18fe_f100);
        assert_eq!(log[1].0, Duration::from_secs(1));
        assert!(
            parse("a.log", text)
                .unwrap_err()
                .starts_with("a.log:4: \"(1436509053.5) x\" is no line of candump")
        );
        for damaged in
            ["(1.000000) can0 044#2", "(1.000000) can0 4#22", "(1.000000) can0 044#112233445566778899"]
        {
            assert!(frame_of(damaged).is_none(), "{damaged}");
        }
        let error = frame_of("(1.000000) can0 20000040#0000000000000000").unwrap();
        assert!(Frame::parse(&error.1, Header::default()).is_error);
    }

    proptest! {
        #[test]
        fn any_line_is_a_frame_or_none(line in "\\([0-9]{0,12}\\.[0-9]{0,8}\\) \\PC{0,5} [0-9A-F]{0,9}#[R0-9A-F]{0,20}") {
            let _ = frame_of(&line);
        }
    }
}
