//! Scans a whole file whose summary is missing, to find its contents and its end.

use std::io;

use mcap::MAGIC;
use mcap::records::op;

use super::error::TruncationCause;
use super::file::{BagFile, SummaryState};
use super::records::{Next, Place, RECORD_HEADER, RecordFile};
use super::segment::Segment;

/// The maximum size of a run of messages outside of chunks, which bounds memory.
const LONGEST_RUN: u64 = 1024 * 1024;

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
        let place = match input.place_at(offset, length)? {
            Next::Record(place) => place,
            Next::End => {
                file.miss(offset, 0, TruncationCause::NoEnd);
                return Ok(());
            }
            Next::Torn { offset } => {
                file.miss(offset, length - offset, TruncationCause::TornRecord);
                return Ok(());
            }
        };
        match place.opcode {
            op::DATA_END | op::FOOTER => {
                if summary == SummaryState::Damaged {
                    file.miss(offset, length - offset, TruncationCause::NoSummary);
                }
                return Ok(());
            }
            op::CHUNK | op::SCHEMA | op::CHANNEL | op::MESSAGE => {
                let bytes = input.read_record(&place)?;
                match file.look_into(&bytes) {
                    Ok(None) => {}
                    Ok(Some(times)) => {
                        let is_message = place.opcode == op::MESSAGE;
                        add_segment(&mut file.segments, &place, times, is_run && is_message);
                        is_run = is_message;
                    }
                    Err(found) => {
                        file.miss(offset, bytes.len() as u64, TruncationCause::DamagedChunk(found));
                    }
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

/// Adds a segment, or extends the last one if it is a run of messages that continues here.
fn add_segment(segments: &mut Vec<Segment>, place: &Place, (first, last): (u64, u64), continues_run: bool) {
    let length = RECORD_HEADER + place.body_length;
    match segments.last_mut() {
        Some(run) if continues_run && run.offset + run.length == place.offset && run.length < LONGEST_RUN => {
            run.length += length;
            run.first = run.first.min(first);
            run.last = run.last.max(last);
        }
        _ => segments.push(Segment { offset: place.offset, length, first, last, channels: None }),
    }
}
