//! The writing side of the DDS engine.

use super::matches::{MatchedCount, gid};
use super::payload::{OutgoingBody, SendLittleEndian};
use super::reader_thread::Link;
use super::{RustddsParticipant, SharedMatches};
use crate::middleware::{
    Direction, Endpoint, EventHandler, Gid, MatchHandler, ReaderCounter, WriteError, WriteOptions, Writer,
};
use bytes::Bytes;
use rustdds::dds::WriteError as DdsWriteError;
use rustdds::{GUID, RTPSEntity, Timestamp, WriteOptionsBuilder};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// The longest payload that rustdds surely sends unfragmented. It spoils the inline QoS of what it fragments,
/// and with it the identity by which a client knows its reply.
const LONGEST_WHOLE: usize = 1372;

type DdsDataWriter = rustdds::no_key::DataWriter<OutgoingBody, SendLittleEndian>;

pub(super) struct DdsWriter {
    writer: DdsDataWriter,
    gid: Gid,
    matched: MatchedCount,
    matches: SharedMatches,
    link: Link,
}

impl DdsWriter {
    pub(super) fn new(writer: DdsDataWriter, of: &RustddsParticipant, endpoint: &Endpoint) -> Self {
        let gid = gid(writer.guid());
        Self {
            writer,
            gid,
            matched: of.watch(gid, Direction::Out, endpoint),
            matches: Arc::clone(&of.matches),
            link: of.reader_thread.link(),
        }
    }
}

impl Writer for DdsWriter {
    fn gid(&self) -> Gid {
        self.gid
    }

    fn matched(&self) -> usize {
        self.matched.load(Ordering::Acquire)
    }

    fn reader_counter(&self) -> ReaderCounter {
        let matched = Arc::clone(&self.matched);
        Box::new(move || matched.load(Ordering::Acquire))
    }

    fn matched_readers(&self) -> Vec<Gid> {
        self.matches.lock().peers(self.gid)
    }

    fn on_match(&self, handler: MatchHandler) {
        self.matches.lock().on_change(self.gid, handler);
    }

    fn on_event(&self, handler: EventHandler) {
        self.link.listen(self.gid, handler);
    }

    fn write_with(&self, cdr: Bytes, options: WriteOptions) -> Result<i64, WriteError> {
        if options.related.is_some() && cdr.len() > LONGEST_WHOLE {
            let length = cdr.len();
            return Err(WriteError::Engine(format!(
                "rustdds sends replies of at most {LONGEST_WHOLE} bytes, this has {length}"
            )));
        }
        let body = OutgoingBody::from_cdr(cdr)?;
        let mut builder = WriteOptionsBuilder::new()
            .source_timestamp(Timestamp::now())
            .related_sample_identity_opt(options.related.map(|related| rustdds::SampleIdentity {
                writer_guid: GUID::from_bytes(related.endpoint.0),
                sequence_number: related.number.into(),
            }));
        if let Some(reader) = options.only_to {
            builder = builder.to_single_reader(GUID::from_bytes(reader.0));
        }
        let write = || self.writer.write_with_options(body, builder.build());
        match catch_unwind(AssertUnwindSafe(write)) {
            Ok(Ok(identity)) => Ok(identity.sequence_number.into()),
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
        self.matches.lock().forget(self.gid);
    }
}
