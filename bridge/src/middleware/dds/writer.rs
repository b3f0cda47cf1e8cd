//! The writing side of the DDS engine.

use super::matches::MatchedCount;
use super::payload::{OutgoingBody, SendLittleEndian};
use super::{SharedMatches, lock};
use crate::middleware::{Gid, MatchHandler, WriteError, WriteOptions, Writer};
use bytes::Bytes;
use rustdds::dds::WriteError as DdsWriteError;
use rustdds::{GUID, SampleIdentity, Timestamp, WriteOptionsBuilder};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::Ordering;
use std::time::Duration;

/// The longest payload with a related sample identity. rustdds 0.15.1 spoils the inline quality of service of a sample
/// that it fragments (`messages/submessages/data_frag.rs` writes the tag of an `Option` before the parameter list; with
/// debug assertions its event loop panics), and it fragments what does not fit into one packet of the network, 1500
/// bytes on Ethernet. This is what is left of them beside a heartbeat and the headers.
const MAX_RELATED_PAYLOAD: usize = 1396;

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

    fn matched_readers(&self) -> Vec<Gid> {
        lock(&self.matches).peers(self.gid)
    }

    fn on_match(&self, handler: MatchHandler) {
        lock(&self.matches).on_change(self.gid, handler);
    }

    fn write_with(&self, cdr: Bytes, options: WriteOptions) -> Result<i64, WriteError> {
        let length = cdr.len();
        let body = OutgoingBody::from_cdr(cdr)?;
        if options.related.is_some() && length > MAX_RELATED_PAYLOAD {
            return Err(WriteError::TooLargeToNameAnother { length, limit: MAX_RELATED_PAYLOAD });
        }
        let related = options.related.map(|related| SampleIdentity {
            writer_guid: GUID::from_bytes(related.endpoint.0),
            sequence_number: related.number.into(),
        });
        let mut builder = WriteOptionsBuilder::new()
            .source_timestamp(Timestamp::now())
            .related_sample_identity_opt(related);
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
        lock(&self.matches).forget(self.gid);
    }
}
