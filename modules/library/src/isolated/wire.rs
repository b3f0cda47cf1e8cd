//! Frames between a robot and a child process: a length, and tagged fields. Both ends are the same program,
//! so numbers have the byte order of the machine.

use downbeat_executor::SettingValue;
use downbeat_library_abi::EventV1;
use std::io::{self, PipeReader, PipeWriter, Read, Write};
use thiserror::Error;

/// What the robot calls, and what a library asks during a call.
pub(super) mod ask {
    pub const START: u8 = 1;
    pub const SETUP: u8 = 2;
    pub const HANDLE: u8 = 3;
    pub const TRANSITION: u8 = 4;
    pub const ACCEPT: u8 = 5;
    pub const SAVE: u8 = 6;
    pub const RESTORE: u8 = 7;
    pub const VARIABLES: u8 = 8;
    /// From here on, the library asks.
    pub const FIRST: u8 = 64;
    pub const CALL: u8 = 64;
    pub const GET: u8 = 65;
    pub const PUBLISHER: u8 = 66;
    pub const SUBSCRIPTION: u8 = 67;
    pub const SERVER: u8 = 68;
    pub const CLIENT: u8 = 69;
    pub const TIMER: u8 = 70;
    pub const TASK: u8 = 71;
    pub const EACH_RUN: u8 = 72;
    pub const SETTING: u8 = 73;
    pub const DEFINE: u8 = 74;
}

/// What a library requests without an answer.
pub(super) mod say {
    pub const PUBLISH: u8 = 16;
    pub const REPLY: u8 = 17;
    pub const SET: u8 = 18;
    pub const SCHEDULE: u8 = 19;
    pub const CANCEL: u8 = 20;
    pub const TRANSITION: u8 = 21;
    pub const REMOVE: u8 = 22;
    pub const LOG: u8 = 23;
}

/// The end of a call.
pub(super) mod end {
    pub const OK: u8 = 32;
    pub const FAILED: u8 = 33;
}

/// The answer to a question.
pub(super) mod answer {
    pub const OK: u8 = 40;
    pub const REFUSED: u8 = 41;
}

/// A frame is not as this program writes it.
#[derive(Debug, Error)]
#[error(
    "the child process of the library sent what this program does not understand; did the library close or write to files that it did not open?"
)]
pub(super) struct Garbled;

/// A frame to be sent.
#[derive(Debug)]
pub(super) struct Frame(Vec<u8>);

/// Of the length.
const HEAD: usize = 4;

impl Default for Frame {
    fn default() -> Self {
        Self(vec![0; HEAD])
    }
}

impl Frame {
    pub fn is_empty(&self) -> bool {
        self.0.len() == HEAD
    }

    pub fn clear(&mut self) {
        self.0.truncate(HEAD);
    }

    pub fn tag(&mut self, tag: u8) {
        self.0.push(tag);
    }

    pub fn flag(&mut self, flag: bool) {
        self.0.push(flag.into());
    }

    pub fn number(&mut self, number: u64) {
        self.0.extend(number.to_ne_bytes());
    }

    pub fn bytes(&mut self, bytes: &[u8]) {
        self.number(bytes.len() as u64);
        self.0.extend_from_slice(bytes);
    }

    pub fn text(&mut self, text: &str) {
        self.bytes(text.as_bytes());
    }

    /// A topic or service, its type, and the hash of that.
    pub fn named(&mut self, name: &str, of: &str, hash: Option<&str>) {
        self.text(name);
        self.text(of);
        self.optional_text(hash);
    }

    fn optional_text(&mut self, text: Option<&str>) {
        self.flag(text.is_some());
        if let Some(text) = text {
            self.text(text);
        }
    }

    pub fn event(&mut self, event: &EventV1, data: &[u8]) {
        self.number(event.kind.into());
        self.number(event.port.into());
        self.number(event.id);
        self.number(event.time_ns as u64);
        self.number(event.missed.into());
        self.flag(event.is_last != 0);
        self.flag(event.is_error != 0);
        self.bytes(data);
    }

    pub fn value(&mut self, value: &SettingValue) {
        fn all<T>(frame: &mut Frame, values: &[T], mut put: impl FnMut(&mut Frame, &T)) {
            frame.number(values.len() as u64);
            values.iter().for_each(|value| put(frame, value));
        }
        match value {
            SettingValue::Bool(value) => {
                self.tag(1);
                self.flag(*value);
            }
            SettingValue::Integer(value) => {
                self.tag(2);
                self.number(*value as u64);
            }
            SettingValue::Double(value) => {
                self.tag(3);
                self.number(value.to_bits());
            }
            SettingValue::Text(value) => {
                self.tag(4);
                self.text(value);
            }
            SettingValue::Bytes(value) => {
                self.tag(5);
                self.bytes(value);
            }
            SettingValue::Bools(values) => {
                self.tag(6);
                all(self, values, |frame, value| frame.flag(*value));
            }
            SettingValue::Integers(values) => {
                self.tag(7);
                all(self, values, |frame, value| frame.number(*value as u64));
            }
            SettingValue::Doubles(values) => {
                self.tag(8);
                all(self, values, |frame, value| frame.number(value.to_bits()));
            }
            SettingValue::Texts(values) => {
                self.tag(9);
                all(self, values, |frame, value| frame.text(value));
            }
        }
    }
}

/// The fields of a received frame, read in the order in which they were written.
#[derive(Clone, Debug)]
pub(super) struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    pub fn of(frame: &'a [u8]) -> Self {
        Self(frame)
    }

    pub fn to_vec(&self) -> Vec<u8> {
        self.0.to_vec()
    }

    fn take(&mut self, size: usize) -> Result<&'a [u8], Garbled> {
        let (taken, left) = self.0.split_at_checked(size).ok_or(Garbled)?;
        self.0 = left;
        Ok(taken)
    }

    pub fn tag(&mut self) -> Result<u8, Garbled> {
        Ok(self.take(1)?[0])
    }

    pub fn flag(&mut self) -> Result<bool, Garbled> {
        Ok(self.tag()? != 0)
    }

    pub fn number(&mut self) -> Result<u64, Garbled> {
        self.take(8)?.try_into().map(u64::from_ne_bytes).map_err(|_| Garbled)
    }

    pub fn bytes(&mut self) -> Result<&'a [u8], Garbled> {
        let size = self.number()?;
        self.take(usize::try_from(size).map_err(|_| Garbled)?)
    }

    pub fn text(&mut self) -> Result<&'a str, Garbled> {
        std::str::from_utf8(self.bytes()?).map_err(|_| Garbled)
    }

    pub fn optional_text(&mut self) -> Result<Option<&'a str>, Garbled> {
        self.flag()?.then(|| self.text()).transpose()
    }

    /// An event without its data, and the data.
    pub fn event(&mut self) -> Result<(EventV1, &'a [u8]), Garbled> {
        let event = EventV1 {
            kind: self.number()? as u32,
            port: self.number()? as u32,
            id: self.number()?,
            time_ns: self.number()? as i64,
            missed: self.number()? as u32,
            is_last: self.tag()?,
            is_error: self.tag()?,
            ..crate::instance::no_event()
        };
        Ok((event, self.bytes()?))
    }

    pub fn value(&mut self) -> Result<SettingValue, Garbled> {
        Ok(match self.tag()? {
            1 => SettingValue::Bool(self.flag()?),
            2 => SettingValue::Integer(self.number()? as i64),
            3 => SettingValue::Double(f64::from_bits(self.number()?)),
            4 => SettingValue::Text(self.text()?.to_owned()),
            5 => SettingValue::Bytes(self.bytes()?.to_vec()),
            6 => SettingValue::Bools(self.all(Self::flag)?),
            7 => SettingValue::Integers(self.all(|fields| Ok(fields.number()? as i64))?),
            8 => SettingValue::Doubles(self.all(|fields| Ok(f64::from_bits(fields.number()?)))?),
            9 => SettingValue::Texts(self.all(|fields| Ok(fields.text()?.to_owned()))?),
            _ => return Err(Garbled),
        })
    }

    fn all<T>(&mut self, read: impl Fn(&mut Self) -> Result<T, Garbled>) -> Result<Vec<T>, Garbled> {
        let count = self.number()?;
        (0..count).map(|_| read(self)).collect()
    }
}

/// One end of the two pipes, which are as fast as an `eventfd`; a socket takes twice as long.
#[derive(Debug)]
pub(super) struct Channel {
    /// `None` once closed.
    ends: Option<(PipeReader, PipeWriter)>,
    outgoing: Frame,
    incoming: Vec<u8>,
}

impl Channel {
    pub fn new(reader: PipeReader, writer: PipeWriter) -> Self {
        Self { ends: Some((reader, writer)), outgoing: Frame::default(), incoming: vec![0; 4096] }
    }

    /// An end without pipes.
    pub fn closed() -> Self {
        Self { ends: None, outgoing: Frame::default(), incoming: Vec::new() }
    }

    /// Closes the pipe to the other side, and returns the one from it.
    pub fn close(&mut self) -> Option<PipeReader> {
        self.ends.take().map(|(reader, _)| reader)
    }

    /// The frame that is sent next, empty after each [`send`](Self::send).
    pub fn frame(&mut self) -> &mut Frame {
        &mut self.outgoing
    }

    pub fn send(&mut self) -> io::Result<()> {
        let size = u32::try_from(self.outgoing.0.len() - HEAD).map_err(io::Error::other)?;
        self.outgoing.0[..HEAD].copy_from_slice(&size.to_ne_bytes());
        let (_, writer) = self.ends.as_mut().ok_or(io::ErrorKind::BrokenPipe)?;
        let sent = writer.write_all(&self.outgoing.0);
        self.outgoing.clear();
        sent
    }

    /// Waits for the next frame. Only one is under way, since the ends take turns.
    pub fn receive(&mut self) -> io::Result<Fields<'_>> {
        let (reader, _) = self.ends.as_mut().ok_or(io::ErrorKind::BrokenPipe)?;
        let mut filled = 0;
        let mut size = None;
        while size.is_none_or(|size| filled < HEAD + size) {
            if self.incoming.len() == filled {
                let needed = size.map_or(0, |size| HEAD + size);
                self.incoming.resize(needed.max(filled * 2), 0);
            }
            match reader.read(&mut self.incoming[filled..]) {
                Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
                Ok(read) => filled += read,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
            if let (None, Some(head)) = (size, self.incoming[..filled].first_chunk::<HEAD>()) {
                size = Some(u32::from_ne_bytes(*head) as usize);
            }
        }
        Ok(Fields(&self.incoming[HEAD..filled]))
    }
}
