//! The writing side of the DDS engine.

use super::matches::MatchedCount;
use super::payload::{OutgoingBody, SendLittleEndian};
use super::{SharedMatches, lock};
use crate::middleware::{Gid, WriteError, Writer};
use bytes::Bytes;
use rustdds::Timestamp;
use rustdds::dds::WriteError as DdsWriteError;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::Ordering;
use std::time::Duration;

type DdsDataWriter = rustdds::no_key::DataWriter<OutgoingBody, SendLittleEndian>;

pub(super) struct DdsWriter {
    writer: DdsDataWriter,
    gid: Gid,
    matched: MatchedCount,
    matches: SharedMatches,
}

impl DdsWriter {
    pub(super) fn new(
        writer: DdsDataWriter,
        gid: Gid,
        matched: MatchedCount,
        matches: SharedMatches,
    ) -> Self {
        Self { writer, gid, matched, matches }
    }
}

impl Writer for DdsWriter {
    fn gid(&self) -> Gid {
        self.gid
    }

    fn matched(&self) -> usize {
        self.matched.load(Ordering::Acquire)
    }

    fn write(&self, cdr: Bytes) -> Result<(), WriteError> {
        let body = OutgoingBody::from_cdr(cdr)?;
        let write = || self.writer.write(body, Some(Timestamp::now()));
        match catch_unwind(AssertUnwindSafe(write)) {
            Ok(Ok(())) => Ok(()),
            Ok(Err(DdsWriteError::WouldBlock { .. })) => Err(WriteError::WindowFull),
            Ok(Err(error)) => Err(WriteError::Engine(error.forget_data().to_string())),
            Err(_) => Err(WriteError::Panicked),
        }
    }

    fn flush(&self, timeout: Duration) -> bool {
        let wait = || self.writer.wait_for_acknowledgments(timeout).unwrap_or(false);
        catch_unwind(AssertUnwindSafe(wait)).unwrap_or(false)
    }
}

impl Drop for DdsWriter {
    fn drop(&mut self) {
        lock(&self.matches).forget(self.gid);
    }
}
