//! The records of a segment: a chunk, or a run of messages outside of chunks.
//!
//! A damaged segment is read as far as possible: its records are parsed one by one, those that are whole are
//! returned, and the others are counted with the help of the message index behind the chunk.

use std::ops::Range;
use std::sync::Arc;

use mcap::records::{self, MessageHeader, Record, op};

use super::chunk::{Unpacked, unpack};
use super::message_index::MessageIndex;
use super::records::{RECORD_HEADER, parse};

/// The position of messages in the file, and their receive times.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Segment {
    pub(super) offset: u64,
    /// Including the headers of its records.
    pub(super) length: u64,
    /// The earliest and latest log time.
    pub(super) first: u64,
    pub(super) last: u64,
    /// The channels with messages in it, if known from the file.
    pub(super) channels: Option<Arc<[u16]>>,
    pub(super) kind: SegmentKind,
    /// The number of messages that the index of the file declares, if it has one.
    pub(super) declared: Option<u64>,
    /// Whether its damage is among the truncations of the file.
    pub(super) is_reported: bool,
}

/// The form of a segment's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SegmentKind {
    /// A chunk, whatever its opcode is.
    Chunk,
    /// Complete records, or rows of a table.
    Run,
}

/// A record of a segment.
pub(super) enum Content<'a> {
    Schema { header: records::SchemaHeader, data: &'a [u8] },
    Channel(records::Channel),
    Message { header: MessageHeader, data: &'a [u8] },
}

/// The damage of a segment.
#[derive(Debug)]
pub(super) struct Damage {
    /// The problem, as the end of a sentence about the segment.
    pub(super) found: String,
    /// The number of messages that were read nevertheless.
    pub(super) read: u64,
    /// The number of messages that it should have, if known.
    declared: Option<u64>,
    /// The messages that could not be read, if known.
    lost: Vec<LostOfChannel>,
}

#[derive(Debug)]
struct LostOfChannel {
    channel: u16,
    count: u64,
    first: u64,
    last: u64,
}

/// The number of topics that the description of damage names.
const MOST_NAMED: usize = 5;

impl Damage {
    /// A segment whose schemas or channels were left out.
    pub(super) fn undescribed(found: String) -> Self {
        Self { found, read: 0, declared: None, lost: Vec::new() }
    }

    /// Damage of the record around a chunk, whose content is intact.
    pub(super) fn of_header(found: String, declared: Option<u64>, read: u64) -> Self {
        Self { found, read, declared: declared.or(Some(read)), lost: Vec::new() }
    }

    /// Whether no message is known to be missing.
    pub(super) fn is_complete(&self) -> bool {
        self.lost.is_empty() && self.declared.is_some_and(|declared| declared <= self.read)
    }

    /// The problem, what was read, and what is missing.
    pub(super) fn describe<'a>(&self, topic_of: impl Fn(u16) -> Option<&'a str>) -> String {
        let Self { found, read, declared, lost } = self;
        match declared {
            _ if self.is_complete() => {
                format!(
                    "{found}; all its {read} messages are read, but at least one byte of them or their index is wrong"
                )
            }
            None if *read == 0 => format!("{found}; no message of it can be read"),
            None => format!("{found}; {read} messages of it are read, others may be lost"),
            Some(declared) => {
                let missing = declared.saturating_sub(*read).max(lost.iter().map(|lost| lost.count).sum());
                let mut named: Vec<String> = lost
                    .iter()
                    .take(MOST_NAMED)
                    .map(|lost| {
                        let topic = topic_of(lost.channel).unwrap_or("unknown topic");
                        let (first, last) = (seconds(lost.first), seconds(lost.last));
                        match lost.count {
                            1 => format!("1 of {topic} at {first}"),
                            count => format!("{count} of {topic} from {first} to {last}"),
                        }
                    })
                    .collect();
                if lost.len() > MOST_NAMED {
                    named.push(format!("those of {} more topics", lost.len() - MOST_NAMED));
                }
                let names = if named.is_empty() { String::new() } else { format!(": {}", named.join(", ")) };
                format!("{found}; {read} of {declared} messages are read, {missing} are lost{names}")
            }
        }
    }
}

/// In seconds since the epoch, as `downbeat bag cut` takes it.
fn seconds(time: u64) -> String {
    format!("{}.{:09}", time / 1_000_000_000, time % 1_000_000_000)
}

/// Calls `each` with every schema, channel and message in the bytes of a segment, in file order.
///
/// `index` is only called if the segment is damaged.
///
/// # Errors
/// Returns the damage; `each` was called with everything that is whole.
pub(super) fn decode(
    bytes: &[u8],
    segment: (SegmentKind, Option<u64>),
    index: impl FnOnce() -> MessageIndex,
    mut each: impl FnMut(Content<'_>),
) -> Result<(), Damage> {
    let (kind, declared) = segment;
    let unpacked = match kind {
        SegmentKind::Chunk => unpack(bytes),
        SegmentKind::Run => Unpacked::of_run(bytes),
    };
    let mut scan = Scan::new(&unpacked, kind, index);
    while let Some(content) = scan.next_content() {
        each(content);
    }
    scan.finish(declared)
}

/// Reads the records of a segment one by one.
struct Scan<'a, F> {
    content: &'a [u8],
    /// Ranges of the content that are missing: no record of which a part is there is whole.
    holes: &'a [Range<usize>],
    kind: SegmentKind,
    /// The log times that the chunk declares.
    times: Option<(u64, u64)>,
    offset: usize,
    messages: u64,
    /// The first problem.
    problem: Option<String>,
    /// Whether the checksum proves that the content is damaged, rather than the index.
    is_content_wrong: bool,
    /// Taken when damage is found.
    load_index: Option<F>,
    index: MessageIndex,
    is_index_used_up: bool,
    /// Where the damage starts, and the offsets of the messages read from there.
    damaged_from: usize,
    read: Vec<u64>,
}

impl<'a, F: FnOnce() -> MessageIndex> Scan<'a, F> {
    fn new(unpacked: &'a Unpacked<'_>, kind: SegmentKind, load_index: F) -> Self {
        let mut scan = Self {
            content: &unpacked.content,
            holes: &unpacked.holes,
            kind,
            times: unpacked.times,
            offset: 0,
            messages: 0,
            problem: None,
            is_content_wrong: unpacked.is_checksum_wrong,
            load_index: Some(load_index),
            index: MessageIndex::default(),
            is_index_used_up: false,
            damaged_from: 0,
            read: Vec::new(),
        };
        if let Some(found) = &unpacked.problem {
            scan.note(found.clone());
        }
        scan
    }

    fn next_content(&mut self) -> Option<Content<'a>> {
        while self.offset < self.content.len() {
            let at = self.offset;
            let mut record = self.record_at(at);
            if record.is_none() {
                self.note(match self.kind {
                    SegmentKind::Chunk => format!("it has an invalid record at byte {at} of its content"),
                    SegmentKind::Run => format!("it has an invalid record at byte {at}"),
                });
                // The record behind it may be the damaged one.
                record = self.record_before_damage(at);
            }
            let Some((opcode, body)) = record else {
                self.offset = self.resume_after(at);
                continue;
            };
            self.offset = at + RECORD_HEADER as usize + body.len();
            match content(opcode, body) {
                Ok(Some(Content::Message { mut header, data })) => {
                    self.messages += 1;
                    if self.problem.is_some() {
                        self.read.push(at as u64);
                        if self.is_content_wrong
                            && let Some((channel, log_time)) = self.index.at(at as u64)
                        {
                            // One of both is damaged, and the checksum proves that it is not the index.
                            (header.channel_id, header.log_time) = (channel, log_time);
                        }
                    }
                    return Some(Content::Message { header, data });
                }
                Ok(Some(content)) => return Some(content),
                Ok(None) if self.kind == SegmentKind::Run || opcode >= 0x80 => {}
                Ok(None) => self.note(match opcode {
                    op::CHUNK => "it has a chunk within, which is not read".to_owned(),
                    _ => format!("it has a record with opcode {opcode}, which chunks must not have"),
                }),
                Err(found) => self.note(found),
            }
        }
        None
    }

    fn finish(mut self, declared: Option<u64>) -> Result<(), Damage> {
        if self.problem.is_none()
            && let Some(declared) = declared.filter(|declared| *declared > self.messages)
        {
            let messages = self.messages;
            self.note(format!("its index declares {declared} messages, it has {messages}"));
        }
        let Some(found) = self.problem else { return Ok(()) };
        let declared = declared.or_else(|| self.index.count()).map(|count| count.max(self.messages));
        let lost = self.index.without(self.damaged_from as u64, &self.read);
        let lost = lost.map(|(channel, count, first, last)| LostOfChannel { channel, count, first, last });
        Err(Damage { found, read: self.messages, declared, lost: lost.collect() })
    }

    fn note(&mut self, found: String) {
        if self.problem.is_none() {
            self.problem = Some(found);
            self.damaged_from = self.offset;
            self.index = self.load_index.take().map(|load| load()).unwrap_or_default();
        }
    }

    /// The offset of the next record that is whole: as the index says, or else the next bytes that look like
    /// one.
    fn resume_after(&mut self, at: usize) -> usize {
        let is_message = |offset: usize| {
            let record = self.record_at(offset).or_else(|| self.record_before_damage(offset));
            matches!(record, Some((op::MESSAGE, body)) if message(body).is_some())
        };
        if !self.is_index_used_up {
            let indexed = self.index.offsets_after(at as u64);
            let mut indexed = indexed.filter_map(|offset| usize::try_from(offset).ok());
            if let Some(offset) = indexed.find(|offset| is_message(*offset)) {
                return offset;
            }
            // Searched only once, so that reading takes linear time.
            self.is_index_used_up = true;
        }
        let end = self.content.len();
        let hole = self.holes.get(self.holes.partition_point(|hole| hole.end <= at + 1));
        let after = hole.filter(|hole| hole.contains(&(at + 1))).map_or(at + 1, |hole| hole.end);
        (after..end).find(|offset| self.looks_like_a_record(*offset)).unwrap_or(end)
    }

    fn record_at(&self, offset: usize) -> Option<(u8, &'a [u8])> {
        let end = |body: &[u8]| offset + RECORD_HEADER as usize + body.len();
        record_at(self.content, offset).filter(|(_, body)| !self.is_missing(offset..end(body)))
    }

    fn is_missing(&self, range: Range<usize>) -> bool {
        let first = self.holes.partition_point(|hole| hole.end <= range.start);
        self.holes.get(first).is_some_and(|hole| hole.start < range.end)
    }

    /// The record at `offset`, if it ends where the index or a time of the chunk shows a message.
    fn record_before_damage(&self, offset: usize) -> Option<(u8, &'a [u8])> {
        let (opcode, body, end) =
            frame_at(self.content, offset).filter(|(opcode, ..)| is_of_segment(*opcode))?;
        if self.is_missing(offset..end) {
            return None;
        }
        let is_timed = || {
            let (first, last) = self.times?;
            let time = self.content.get(end + RECORD_HEADER as usize + LOG_TIME..)?.first_chunk::<8>()?;
            (first..=last).contains(&u64::from_le_bytes(*time)).then_some(())
        };
        (self.index.at(end as u64).is_some() || is_timed().is_some()).then_some((opcode, body))
    }

    fn looks_like_a_record(&self, offset: usize) -> bool {
        if !is_of_segment(self.content[offset]) {
            return false;
        }
        let Some((opcode, body)) = self.record_at(offset) else { return false };
        match (content(opcode, body), self.times) {
            (Ok(Some(Content::Message { header, .. })), Some((first, last))) => {
                (first..=last).contains(&header.log_time)
            }
            // Without times, any 22 bytes are a message.
            (Ok(Some(Content::Message { .. })), None) => false,
            (Ok(Some(_)), _) => true,
            _ => false,
        }
    }
}

/// The offset of the log time in the body of a message: channel and sequence number precede it.
const LOG_TIME: usize = 2 + 4;

/// Whether segments consist of records with that opcode.
fn is_of_segment(opcode: u8) -> bool {
    matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE)
}

/// The record at `offset`, if it and the start of the following one are plausible: with a wrong length, what
/// follows is not a record.
fn record_at(content: &[u8], offset: usize) -> Option<(u8, &[u8])> {
    let (opcode, body, end) = frame_at(content, offset)?;
    let follows = |offset: usize| offset == content.len() || is_of_segment(content[offset]);
    let is_followed = follows(end) && (end == content.len() || frame_at(content, end).is_some());
    // The next record may be damaged or of another kind, and the one behind it intact.
    (is_followed
        || frame_at(content, end).is_some_and(|(_, _, end)| follows(end))
        || is_last_torn(content, end))
    .then_some((opcode, body))
}

/// Whether a message that starts at `offset` is cut by the end of the content.
fn is_last_torn(content: &[u8], offset: usize) -> bool {
    content
        .get(offset)
        .is_some_and(|opcode| *opcode == op::MESSAGE || content.len() - offset < RECORD_HEADER as usize)
        && frame_at(content, offset).is_none()
        && length_at(content, offset).is_none_or(|length| length <= LONGEST_TORN)
}

/// A longer length is taken for a damaged one.
const LONGEST_TORN: u64 = 1 << 32;

fn length_at(content: &[u8], offset: usize) -> Option<u64> {
    let length = content.get(offset + 1..)?.first_chunk::<8>()?;
    Some(u64::from_le_bytes(*length))
}

/// Opcode, body and end of the record at `offset`.
fn frame_at(content: &[u8], offset: usize) -> Option<(u8, &[u8], usize)> {
    let opcode = *content.get(offset)?;
    let length = usize::try_from(length_at(content, offset)?).ok()?;
    let start = offset + RECORD_HEADER as usize;
    let end = start.checked_add(length)?;
    Some((opcode, content.get(start..end)?, end))
}

fn content(opcode: u8, body: &[u8]) -> Result<Option<Content<'_>>, String> {
    if !is_of_segment(opcode) {
        return Ok(None);
    }
    if let (op::MESSAGE, Some(message)) = (opcode, message(body)) {
        return Ok(Some(message));
    }
    match parse(opcode, body)? {
        Record::Schema { header, data: std::borrow::Cow::Borrowed(data) } => {
            Ok(Some(Content::Schema { header, data }))
        }
        Record::Channel(channel) => Ok(Some(Content::Channel(channel))),
        _ => Ok(None),
    }
}

/// Parses a message without the general parser, since most records are messages.
fn message(body: &[u8]) -> Option<Content<'_>> {
    let (channel_id, rest) = body.split_first_chunk()?;
    let (sequence, rest) = rest.split_first_chunk()?;
    let (log_time, rest) = rest.split_first_chunk()?;
    let (publish_time, data) = rest.split_first_chunk()?;
    let header = MessageHeader {
        channel_id: u16::from_le_bytes(*channel_id),
        sequence: u32::from_le_bytes(*sequence),
        log_time: u64::from_le_bytes(*log_time),
        publish_time: u64::from_le_bytes(*publish_time),
    };
    Some(Content::Message { header, data })
}
