//! Reads a file record by record, because it has no usable summary.
//!
//! A record whose length or kind is damaged does not end the file: the walk continues at the next bytes that
//! are a record, and a chunk is recognised by its own header, which repeats its length.

use std::io;

use mcap::MAGIC;
use mcap::records::op;

use super::chunk;
use super::error::TruncationCause;
use super::file::{BagFile, Looked};
use super::message_index::{MessageIndex, declared_behind};
use super::records::{Next, Place, RECORD_HEADER, RecordFile};
use super::segment::{Damage, Segment, SegmentKind};
use super::summary::SummaryState;

/// The maximum size of a run of messages outside of chunks, which bounds memory.
const LONGEST_RUN: u64 = 1024 * 1024;

/// The bytes that are searched at a time.
const WINDOW: u64 = 1024 * 1024;

/// A problem of a chunk.
const BAD_HEADER: &str = "the kind or the length of its record is damaged";

/// Adds the readable contents to `file`, and notes unreadable parts.
pub(super) fn walk(file: &mut BagFile, input: &mut RecordFile, summary: SummaryState) -> io::Result<()> {
    let length = input.length();
    let mut offset = MAGIC.len() as u64;
    if length < offset {
        file.miss(0, length, TruncationCause::TornRecord);
        return Ok(());
    }
    // Whether the last segment is a run of messages outside of chunks.
    let mut is_run = false;
    loop {
        let place = match next_place(input, offset, length)? {
            Found::Whole(place) => place,
            Found::End => {
                file.miss(offset, 0, TruncationCause::NoEnd);
                return Ok(());
            }
            Found::Chunk(place, found) => {
                let bytes = input.read_record(&place)?;
                add_chunk(file, input, &place, &bytes, Some(found))?;
                (offset, is_run) = (place.end(), false);
                continue;
            }
            Found::Torn => {
                input.seek(offset)?;
                let is_chunk = input.read(1)? == [op::CHUNK];
                let is_chunked = is_chunk || file.segments.iter().any(|one| one.kind == SegmentKind::Chunk);
                let Some(next) = resume_after(input, offset, length, is_chunked)? else {
                    add_torn(file, input, offset, length, is_chunk)?;
                    return Ok(());
                };
                if is_chunk && next - offset > RECORD_HEADER {
                    let place =
                        Place { opcode: op::CHUNK, offset, body_length: next - offset - RECORD_HEADER };
                    let bytes = input.read_record(&place)?;
                    add_chunk(file, input, &place, &bytes, Some(BAD_HEADER.to_owned()))?;
                } else {
                    file.miss(offset, next - offset, TruncationCause::DamagedRecord);
                }
                (offset, is_run) = (next, false);
                continue;
            }
        };
        match place.opcode {
            op::DATA_END | op::FOOTER => {
                if summary == SummaryState::Damaged {
                    file.miss(offset, length - offset, TruncationCause::NoSummary);
                }
                return Ok(());
            }
            op::CHUNK => {
                let bytes = input.read_record(&place)?;
                add_chunk(file, input, &place, &bytes, None)?;
                is_run = false;
            }
            op::SCHEMA | op::CHANNEL | op::MESSAGE => {
                let bytes = input.read_record(&place)?;
                let looked = file.look_into(&bytes, (SegmentKind::Run, None), MessageIndex::default);
                if let Some(times) = looked.times {
                    add_run(&mut file.segments, &place, times, is_run);
                    is_run = true;
                }
                if let Err(damage) = looked.read {
                    let found = TruncationCause::DamagedChunk(damage.found);
                    file.miss(offset, bytes.len() as u64, found);
                }
            }
            op::METADATA => {
                let record = input.read_record(&place)?;
                file.add_metadata(&record);
            }
            _ => {}
        }
        offset = place.end();
    }
}

/// What starts at an offset.
enum Found {
    Whole(Place),
    /// A chunk whose record header is damaged, and the problem.
    Chunk(Place, String),
    /// No record.
    Torn,
    End,
}

/// The record at `offset`, which is checked as far as its kind permits.
fn next_place(input: &mut RecordFile, offset: u64, length: u64) -> io::Result<Found> {
    let place = match input.place_at(offset, length)? {
        Next::End => return Ok(Found::End),
        Next::Record(place) => Some(place),
        Next::Torn => None,
    };
    let own_length = chunk_length_at(input, offset, length)?;
    if let Some(place) = place {
        let fits = match place.opcode {
            op::CHUNK => {
                own_length.is_none_or(|own| own == place.body_length) || is_followed(input, &place, length)?
            }
            _ => has_plausible_length(&place) && own_length != Some(place.body_length),
        };
        if fits {
            return Ok(Found::Whole(place));
        }
    }
    if let Some(body_length) = own_length {
        let chunk = Place { opcode: op::CHUNK, offset, body_length };
        if is_followed(input, &chunk, length)? {
            return Ok(Found::Chunk(chunk, BAD_HEADER.to_owned()));
        }
    }
    Ok(match place {
        // With a wrong kind or a wrong length: the next record shows which.
        Some(place) if place.opcode == op::CHUNK => Found::Whole(place),
        _ => Found::Torn,
    })
}

/// The length of the body at `offset` if it is that of a chunk, whatever its record header says.
fn chunk_length_at(input: &mut RecordFile, offset: u64, length: u64) -> io::Result<Option<u64>> {
    let start = offset + RECORD_HEADER;
    let head = length.saturating_sub(start).min(chunk::LONGEST_HEAD as u64);
    if head == 0 {
        return Ok(None);
    }
    input.seek(start)?;
    let head = input.read(head)?;
    Ok(chunk::length_of(&head).filter(|body| start.checked_add(*body).is_some_and(|end| end <= length)))
}

/// Whether a record, or the end of the file, is behind `place`.
fn is_followed(input: &mut RecordFile, place: &Place, length: u64) -> io::Result<bool> {
    Ok(match input.place_at(place.end(), length)? {
        Next::End => true,
        Next::Record(next) => has_plausible_length(&next),
        Next::Torn => false,
    })
}

/// Whether a record of that kind can have that length.
fn has_plausible_length(place: &Place) -> bool {
    let length = place.body_length;
    match place.opcode {
        op::HEADER | op::METADATA => length >= 8,
        op::FOOTER => length == 20,
        op::SCHEMA => length >= 14,
        op::CHANNEL => length >= 16,
        op::MESSAGE => length >= 22,
        op::CHUNK => length >= 40,
        op::MESSAGE_INDEX => length >= 6 && (length - 6).is_multiple_of(16),
        op::CHUNK_INDEX => length >= 64,
        op::ATTACHMENT => length >= 36,
        op::ATTACHMENT_INDEX => length >= 48,
        op::STATISTICS => length >= 46 && (length - 46).is_multiple_of(10),
        op::METADATA_INDEX => length >= 20,
        op::SUMMARY_OFFSET => length == 17,
        op::DATA_END => length == 4,
        // Private records may have any.
        opcode => opcode >= 0x80,
    }
}

/// The offset of the next record behind a damaged one, if there is any. In a file with chunks, messages are
/// not searched outside of them: a damaged chunk contains some.
fn resume_after(
    input: &mut RecordFile,
    offset: u64,
    length: u64,
    is_chunked: bool,
) -> io::Result<Option<u64>> {
    let mut start = offset + 1;
    while start < length {
        input.seek(start)?;
        let bytes = input.read(WINDOW.min(length - start))?;
        for (position, header) in (0_u64..).zip(bytes.windows(RECORD_HEADER as usize)) {
            let is_candidate = match header[0] {
                op::CHUNK | op::MESSAGE_INDEX | op::DATA_END | op::METADATA | op::ATTACHMENT => true,
                op::SCHEMA | op::CHANNEL | op::MESSAGE => !is_chunked,
                _ => false,
            };
            if is_candidate && header[7..] == [0, 0] && starts_records(input, start + position, length)? {
                return Ok(Some(start + position));
            }
        }
        if bytes.len() < WINDOW as usize {
            break;
        }
        // The windows overlap by the header of a record.
        start += WINDOW - RECORD_HEADER;
    }
    Ok(None)
}

/// Whether several records follow each other from `offset`, or records up to the end of the file.
fn starts_records(input: &mut RecordFile, offset: u64, length: u64) -> io::Result<bool> {
    const ENOUGH: usize = 3;
    let mut at = offset;
    for number in 0..ENOUGH {
        match input.place_at(at, length)? {
            Next::End => return Ok(number > 0),
            Next::Torn => return Ok(false),
            Next::Record(place) => {
                if place.opcode >= 0x80 || !has_plausible_length(&place) {
                    return Ok(false);
                }
                if place.opcode == op::CHUNK && chunk_length_at(input, at, length)? == Some(place.body_length)
                {
                    return Ok(true);
                }
                if place.opcode == op::FOOTER {
                    return Ok(number > 0);
                }
                at = place.end();
            }
        }
    }
    Ok(true)
}

/// Adds a chunk as far as it can be read; `found` is a problem of its record.
fn add_chunk(
    file: &mut BagFile,
    input: &mut RecordFile,
    place: &Place,
    bytes: &[u8],
    found: Option<String>,
) -> io::Result<()> {
    let declared = declared_behind(input, place.end())?;
    let mut failed = None;
    let index = || {
        MessageIndex::read(input, place.end()).unwrap_or_else(|error| {
            failed = Some(error);
            MessageIndex::default()
        })
    };
    let Looked { times, messages, mut read } = file.look_into(bytes, (SegmentKind::Chunk, declared), index);
    if let Some(error) = failed {
        return Err(error);
    }
    if let (Ok(()), Some(found)) = (&read, found) {
        read = Err(Damage::of_header(found, declared, messages));
    }
    let length = RECORD_HEADER + place.body_length;
    if let Some((first, last)) = times {
        file.segments.push(Segment {
            offset: place.offset,
            length,
            first,
            last,
            channels: None,
            kind: SegmentKind::Chunk,
            declared,
            is_reported: read.is_err(),
        });
    }
    if let Err(damage) = read {
        let found = file.describe(&damage);
        file.miss(place.offset, length, TruncationCause::DamagedChunk(found));
    }
    Ok(())
}

/// Adds the messages of a chunk that the end of the file cuts.
fn add_torn(
    file: &mut BagFile,
    input: &mut RecordFile,
    offset: u64,
    length: u64,
    is_chunk: bool,
) -> io::Result<()> {
    let lost = length - offset;
    input.seek(offset)?;
    let bytes = if is_chunk { input.read(lost)? } else { Vec::new() };
    let looked = file.look_into(&bytes, (SegmentKind::Chunk, None), MessageIndex::default);
    let Looked { times: Some((first, last)), messages, .. } = looked else {
        file.miss(offset, lost, TruncationCause::TornRecord);
        return Ok(());
    };
    file.segments.push(Segment {
        offset,
        length: lost,
        first,
        last,
        channels: None,
        kind: SegmentKind::Chunk,
        declared: None,
        is_reported: true,
    });
    file.miss(offset, lost, TruncationCause::TornChunk { messages });
    Ok(())
}

/// Adds a message outside of chunks, or extends the last segment if it is a run of messages that continues
/// here.
fn add_run(segments: &mut Vec<Segment>, place: &Place, (first, last): (u64, u64), continues_run: bool) {
    let length = RECORD_HEADER + place.body_length;
    match segments.last_mut() {
        Some(run) if continues_run && run.offset + run.length == place.offset && run.length < LONGEST_RUN => {
            run.length += length;
            run.first = run.first.min(first);
            run.last = run.last.max(last);
        }
        _ => segments.push(Segment {
            offset: place.offset,
            length,
            first,
            last,
            channels: None,
            kind: SegmentKind::Run,
            declared: None,
            is_reported: false,
        }),
    }
}
