//! The reader: delivers the samples of its writers once and in order, and requests missing samples.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use bytes::Bytes;

use crate::qos::Qos;
use crate::wire::{
    Data, DataFragment, Gap, Guid, Heartbeat, HeartbeatFragment, MessageBuilder, Payload, SequenceNumber,
    Timestamp,
};

use super::Now;
use super::incoming::{Incoming, MatchedWriter};
use super::links::{Emitted, LinkId, Links};
use super::received::{Received, Sample};
use super::writer::missed_periods;

/// Configuration of a reader.
#[derive(Debug, Clone)]
pub struct ReaderConfig {
    pub guid: Guid,
    pub qos: Qos,
    /// The largest sample in bytes; larger samples are lost.
    pub max_sample_size: u32,
    /// The most bytes of samples of all writers that are incomplete or wait for earlier ones. The next sample
    /// of each writer may exceed it.
    pub max_open_bytes: usize,
}

/// The state of a reader, builtin or of the user.
#[derive(Debug)]
pub struct Reader {
    config: ReaderConfig,
    writers: BTreeMap<Guid, Incoming>,
    /// Writers that need an answer, by link.
    due: BTreeSet<(LinkId, Guid)>,
    /// Bytes of samples that are incomplete or wait for earlier ones.
    open_bytes: usize,
    deadline_at: Option<Instant>,
    /// At or before the next timeout.
    timeout: Option<Instant>,
}

impl Reader {
    pub fn new(config: ReaderConfig) -> Self {
        let (writers, due) = (BTreeMap::new(), BTreeSet::new());
        Self { config, writers, due, open_bytes: 0, deadline_at: None, timeout: None }
    }

    pub fn guid(&self) -> Guid {
        self.config.guid
    }

    pub fn qos(&self) -> &Qos {
        &self.config.qos
    }

    /// Matches a writer. If it is already matched, its link and QoS are updated.
    pub fn match_writer(&mut self, now: Now, matched: MatchedWriter) {
        let incoming = self.writers.entry(matched.guid).or_insert_with(|| Incoming::new(matched, now.steady));
        self.due.remove(&(incoming.matched.link, matched.guid));
        incoming.matched = matched;
        let lease_ends = incoming.lease_ends();
        let timeout = incoming.next_timeout();
        self.set_timeout(timeout);
        self.set_timeout(lease_ends);
    }

    /// Removes a matched writer.
    pub fn unmatch_writer(&mut self, writer: Guid) {
        if let Some(incoming) = self.writers.remove(&writer) {
            self.open_bytes -= incoming.size;
            self.due.remove(&(incoming.matched.link, writer));
        }
    }

    /// The matched writers.
    pub fn matched(&self) -> impl Iterator<Item = Guid> {
        self.writers.keys().copied()
    }

    pub fn is_matched(&self, writer: Guid) -> bool {
        self.writers.contains_key(&writer)
    }

    /// Handles a sample. Writers that are not matched are ignored, here and below.
    pub fn handle_data(
        &mut self,
        now: Now,
        writer: Guid,
        timestamp: Option<Timestamp>,
        data: &Data<'_>,
        out: &mut Vec<Received>,
    ) {
        let (payload, is_key) = match data.payload {
            Payload::None => (&[][..], false),
            Payload::Data(payload) => (payload, false),
            Payload::Key(payload) => (payload, true),
        };
        let max = self.config.max_sample_size as usize;
        self.take(now, writer, (data.number, timestamp), out, |incoming, room, out| {
            if payload.len() > max {
                return incoming.refuse(now, data.number, out);
            }
            let sample = Sample {
                writer,
                number: data.number,
                source_timestamp: timestamp,
                inline_qos: data.inline_qos,
                is_key,
                payload: as_written(payload),
            };
            incoming.take_sample(now, sample, room, out);
        });
    }

    /// Handles fragments of a sample.
    pub fn handle_fragment(
        &mut self,
        now: Now,
        writer: Guid,
        timestamp: Option<Timestamp>,
        fragment: &DataFragment<'_>,
        out: &mut Vec<Received>,
    ) {
        let max = self.config.max_sample_size;
        self.take(now, writer, (fragment.number, timestamp), out, |incoming, room, out| {
            if fragment.sample_size > max {
                return incoming.refuse(now, fragment.number, out);
            }
            incoming.take_fragment(now, timestamp, fragment, room, out);
        });
    }

    /// Handles a heartbeat.
    pub fn handle_heartbeat(
        &mut self,
        now: Now,
        writer: Guid,
        heartbeat: &Heartbeat,
        out: &mut Vec<Received>,
        links: &mut Links,
    ) {
        let Some(incoming) = self.writers.get_mut(&writer) else { return };
        let (link, size) = (incoming.matched.link, incoming.size);
        let is_due = incoming.take_heartbeat(now, heartbeat, out);
        self.open_bytes = self.open_bytes + incoming.size - size;
        if is_due {
            self.answer(link, writer, links);
        }
        if heartbeat.is_liveliness {
            self.assert_liveliness(now, writer, out);
        }
    }

    /// Handles a GAP.
    pub fn handle_gap(&mut self, now: Now, writer: Guid, gap: &Gap, out: &mut Vec<Received>) {
        let Some(incoming) = self.writers.get_mut(&writer) else { return };
        let size = incoming.size;
        incoming.take_gap(now, gap, out);
        self.open_bytes = self.open_bytes + incoming.size - size;
    }

    /// Requests all samples of a writer again.
    pub(super) fn start_over(&mut self, now: Now, writer: Guid, links: &mut Links) {
        let Some(incoming) = self.writers.get_mut(&writer) else { return };
        let (link, size) = (incoming.matched.link, incoming.size);
        incoming.start_over(now.steady);
        self.open_bytes -= size;
        let timeout = incoming.next_timeout();
        self.set_timeout(timeout);
        self.answer(link, writer, links);
    }

    /// Handles a heartbeat of fragments.
    pub fn handle_heartbeat_fragment(
        &mut self,
        now: Now,
        writer: Guid,
        heartbeat: &HeartbeatFragment,
        links: &mut Links,
    ) {
        let Some(incoming) = self.writers.get_mut(&writer) else { return };
        let link = incoming.matched.link;
        if incoming.take_heartbeat_fragment(now, heartbeat) {
            self.answer(link, writer, links);
        }
    }

    /// Handles an assertion of a writer by its participant.
    pub fn assert_liveliness(&mut self, now: Now, writer: Guid, out: &mut Vec<Received>) {
        let Some(incoming) = self.writers.get_mut(&writer) else { return };
        if incoming.assert_liveliness(now.steady) {
            out.push(Received::LivelinessChanged { writer, is_alive: true });
            let lease_ends = incoming.lease_ends();
            self.set_timeout(lease_ends);
        }
    }

    /// Runs the timers that are due.
    pub fn handle_timeout(&mut self, now: Now, out: &mut Vec<Received>, links: &mut Links) {
        if self.timeout.is_none_or(|timeout| timeout > now.steady) {
            return;
        }
        if let Some((deadline, at)) = self.config.qos.deadline.zip(self.deadline_at) {
            let (count, next) = missed_periods(at, deadline, now.steady);
            self.deadline_at = Some(next);
            if count > 0 {
                out.push(Received::DeadlineMissed { count });
            }
        }
        self.timeout = self.deadline_at;
        for (guid, incoming) in &mut self.writers {
            if incoming.handle_timeout(now.steady) {
                self.due.insert((incoming.matched.link, *guid));
                links.request(incoming.matched.link, self.config.guid.entity);
            }
            if incoming.run_out_lease(now.steady) {
                out.push(Received::LivelinessChanged { writer: *guid, is_alive: false });
            }
            let timeouts = [self.timeout, incoming.next_timeout(), incoming.lease_ends()];
            self.timeout = timeouts.into_iter().flatten().min();
        }
    }

    /// When to call [`Reader::handle_timeout`]. May be too early, but never too late.
    pub fn next_timeout(&self) -> Option<Instant> {
        self.timeout
    }

    /// Fills a datagram for `link`.
    pub fn emit(&mut self, now: Now, link: LinkId, builder: &mut MessageBuilder<'_>) -> Emitted {
        let lowest = (link, Guid::UNKNOWN);
        while let Some(due) = self.due.range(lowest..).next().copied().filter(|due| due.0 == link) {
            if let Some(incoming) = self.writers.get_mut(&due.1) {
                if !incoming.emit(now.steady, self.config.guid.entity, builder) {
                    return Emitted::More;
                }
                let timeout = incoming.next_timeout();
                self.set_timeout(timeout);
            }
            self.due.remove(&due);
        }
        Emitted::Done
    }

    /// Bytes of samples that are incomplete or wait for earlier ones.
    pub fn open_bytes(&self) -> usize {
        self.open_bytes
    }

    /// Calls `take` for a wanted sample, of this number and source timestamp, with the number of bytes that
    /// are free for it.
    fn take(
        &mut self,
        now: Now,
        writer: Guid,
        (number, written): (SequenceNumber, Option<Timestamp>),
        out: &mut Vec<Received>,
        take: impl FnOnce(&mut Incoming, usize, &mut Vec<Received>),
    ) {
        let Some(incoming) = self.writers.get_mut(&writer) else { return };
        if incoming.assert_liveliness(now.steady) {
            out.push(Received::LivelinessChanged { writer, is_alive: true });
            let lease_ends = incoming.lease_ends();
            self.timeout = [self.timeout, lease_ends].into_iter().flatten().min();
        }
        if !incoming.wants(number, written, now.steady) {
            let timeout = incoming.next_timeout();
            return self.set_timeout(timeout);
        }
        let (size, received) = (incoming.size, out.len());
        take(incoming, self.config.max_open_bytes.saturating_sub(self.open_bytes), out);
        self.open_bytes = self.open_bytes + incoming.size - size;
        if out.len() > received
            && let Some(deadline) = self.config.qos.deadline
        {
            self.deadline_at = Some(now.steady + deadline);
            self.set_timeout(self.deadline_at);
        }
    }

    fn answer(&mut self, link: LinkId, writer: Guid, links: &mut Links) {
        self.due.insert((link, writer));
        links.request(link, self.config.guid.entity);
    }

    fn set_timeout(&mut self, at: Option<Instant>) {
        self.timeout = [self.timeout, at].into_iter().flatten().min();
    }
}

/// Copies a payload and clears the padding bits of its encapsulation header, because the padding was removed.
fn as_written(payload: &[u8]) -> Bytes {
    match *payload {
        [0, format, options_high, options_low, ref content @ ..] if options_low & 3 != 0 => {
            let mut bytes = Vec::with_capacity(payload.len());
            bytes.extend_from_slice(&[0, format, options_high, options_low & !3]);
            bytes.extend_from_slice(content);
            bytes.into()
        }
        _ => Bytes::copy_from_slice(payload),
    }
}
