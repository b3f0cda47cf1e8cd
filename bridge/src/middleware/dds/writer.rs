//! The writing side of the DDS engine.

use super::first_fragment::{Addresses, FirstFragments, LargeSample};
use super::matches::{MatchedCount, gid};
use super::payload::{OutgoingBody, SendLittleEndian};
use super::reader_thread::Link;
use super::{DdsParticipant, SharedMatches, lock};
use crate::middleware::{
    Direction, Endpoint, EventHandler, Gid, MatchHandler, WriteError, WriteOptions, Writer,
};
use bytes::Bytes;
use rustdds::dds::WriteError as DdsWriteError;
use rustdds::{DomainParticipant, GUID, RTPSEntity, Timestamp, WriteOptionsBuilder};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// The vendor id of rustdds, which takes what a sample is from its last fragment.
const RUSTDDS: [u8; 2] = [0x01, 0x12];

type DdsDataWriter = rustdds::no_key::DataWriter<OutgoingBody, SendLittleEndian>;

pub(super) struct DdsWriter {
    writer: DdsDataWriter,
    gid: Gid,
    matched: MatchedCount,
    matches: SharedMatches,
    link: Link,
    first_fragments: Arc<FirstFragments>,
    participant: DomainParticipant,
    /// The number of the last sample; held while a sample is written, since that of a large reply must be known before.
    last: Mutex<i64>,
}

impl DdsWriter {
    pub(super) fn new(writer: DdsDataWriter, of: &DdsParticipant, endpoint: &Endpoint) -> Self {
        let gid = gid(writer.guid());
        Self {
            writer,
            gid,
            matched: of.watch(gid, Direction::Out, endpoint),
            matches: Arc::clone(&of.matches),
            link: of.reader_thread.link(),
            first_fragments: Arc::clone(&of.first_fragments),
            participant: of.participant.clone(),
            last: Mutex::new(0),
        }
    }

    /// Has the reader know to which sample a sample belongs that rustdds will fragment; makes sure that it will.
    fn announce(
        &self,
        body: &mut OutgoingBody,
        number: i64,
        related: crate::middleware::SampleIdentity,
        reader: Option<Gid>,
    ) -> Result<Announced, WriteError> {
        let too_large = |limit| WriteError::TooLargeToNameAnother { length: body.payload_length(), limit };
        let limit = self.first_fragments.sizes().whole;
        if body.payload_length() <= limit {
            return Ok(Announced::Inline);
        }
        let reader = reader.filter(|reader| reader.vendor() != RUSTDDS).ok_or_else(|| too_large(limit))?;
        let addresses = Addresses::of(&self.participant, reader);
        let sizes = self.first_fragments.sizes_to(&addresses);
        if body.payload_length() <= sizes.whole {
            return Ok(Announced::Inline);
        }
        let too_large = too_large(sizes.whole);
        body.pad_to(sizes.fragmented);
        let sample = LargeSample { writer: self.gid, reader, number, related, body: body.as_slice() };
        if self.first_fragments.send(&addresses, &sample) { Ok(Announced::Before) } else { Err(too_large) }
    }
}

/// How a reader learns to which sample a sample belongs.
enum Announced {
    /// By the sample itself.
    Inline,
    /// By its first fragment, which was sent already.
    Before,
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

    fn on_event(&self, handler: EventHandler) {
        self.link.listen(self.gid, handler);
    }

    fn write_with(&self, cdr: Bytes, options: WriteOptions) -> Result<i64, WriteError> {
        let mut body = OutgoingBody::from_cdr(cdr)?;
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        let mut related = options.related;
        if let Some(identity) = related
            && matches!(self.announce(&mut body, *last + 1, identity, options.only_to)?, Announced::Before)
        {
            related = None;
        }
        let mut builder = WriteOptionsBuilder::new()
            .source_timestamp(Timestamp::now())
            .related_sample_identity_opt(related.map(|related| rustdds::SampleIdentity {
                writer_guid: GUID::from_bytes(related.endpoint.0),
                sequence_number: related.number.into(),
            }));
        if let Some(reader) = options.only_to {
            builder = builder.to_single_reader(GUID::from_bytes(reader.0));
        }
        let write = || self.writer.write_with_options(body, builder.build());
        match catch_unwind(AssertUnwindSafe(write)) {
            Ok(Ok(identity)) => {
                *last = identity.sequence_number.into();
                Ok(*last)
            }
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
