//! Which servers know their client.
//!
//! A match is found on either side at its own time. Of a writer that it finds late a reader of Cyclone DDS takes nothing that
//! was written before: it skips what the first heartbeat that it understands announces. So a client that has written
//! nothing yet begins with a sample for nobody, which every reader has to acknowledge as not meant for it, and who has is
//! acquainted. Fast DDS and rustdds ask for all that the first heartbeat announces: none but Cyclone DDS is waited for.

use super::mapping::CYCLONE;
use crate::middleware::{Gid, WriteError, WriteOptions, Writer};
use bytes::Bytes;
use std::collections::HashMap;
use std::time::{Duration, Instant};

/// How long a matched server that acknowledges nothing keeps a client waiting: it may have died, and its lease still runs.
const PATIENCE: Duration = Duration::from_secs(1);

/// Encapsulation header of an empty body.
const NOTHING: &[u8] = &[0x00, 0x01, 0x00, 0x00];

/// The readers that one writer is matched with, and since when those are that it is not acquainted with.
#[derive(Default)]
pub(super) struct Acquaintances(HashMap<Gid, Standing>);

#[derive(Clone, Copy, PartialEq, Eq)]
enum Standing {
    MatchedSince(Instant),
    Acquainted,
}

impl Standing {
    fn is_waited_for(self, now: Instant) -> bool {
        matches!(self, Self::MatchedSince(since) if now < since + PATIENCE)
    }
}

impl Acquaintances {
    /// Keeps of `matched` those that are acquainted, or were waited for in vain. `last` is the number of the last sample.
    pub(super) fn retain(&mut self, writer: &dyn Writer, last: &mut i64, matched: &mut Vec<Gid>) {
        let now = Instant::now();
        self.0.retain(|reader, _| matched.contains(reader));
        for reader in matched.iter() {
            let skips = reader.vendor() == CYCLONE;
            let standing = if skips { Standing::MatchedSince(now) } else { Standing::Acquainted };
            self.0.entry(*reader).or_insert(standing);
        }
        if self.0.values().any(|standing| standing.is_waited_for(now)) && acknowledged(writer, last) {
            self.0.values_mut().for_each(|standing| *standing = Standing::Acquainted);
        }
        matched.retain(|reader| self.0.get(reader).is_some_and(|standing| !standing.is_waited_for(now)));
    }
}

/// Whether all matched readers have acknowledged all samples, one at least.
fn acknowledged(writer: &dyn Writer, last: &mut i64) -> bool {
    if *last == 0 {
        match write_to_nobody(writer) {
            Ok(number) => *last = number,
            // It has left its domain; the next look tries again.
            Err(_) => return false,
        }
    }
    writer.flush(Duration::ZERO)
}

fn write_to_nobody(writer: &dyn Writer) -> Result<i64, WriteError> {
    let no_reader = writer.gid();
    let options = WriteOptions { related: None, only_to: Some(no_reader) };
    writer.write_with(Bytes::from_static(NOTHING), options)
}
