//! Dispatch of received messages.

use std::net::{Ipv4Addr, SocketAddrV4};

use super::{
    Channel, Event, Fault, LivelinessChange, Now, Participant, Received, Sample, WriterEvent, peers::Peer,
};
use crate::wire::{
    EntityId, Guid, GuidPrefix, Header, Malformed, StatusInfo, Submessage, Submessages, Timestamp, parse,
};

/// The origin of a datagram.
#[derive(Debug, Clone, Copy)]
struct Origin {
    address: SocketAddrV4,
    length: usize,
    /// Whether it comes from local endpoints.
    is_own: bool,
}

/// What submessages define for the following ones (section 8.3.4).
struct Context {
    source: GuidPrefix,
    destination: GuidPrefix,
    timestamp: Option<Timestamp>,
}

impl Participant {
    /// Handles a datagram from the network.
    pub fn handle_datagram(&mut self, now: Now, from: SocketAddrV4, bytes: &[u8]) {
        self.note_time(now);
        self.counters.datagrams_received += 1;
        self.counters.bytes_received += bytes.len() as u64;
        let origin = Origin { address: from, length: bytes.len(), is_own: false };
        let (header, submessages) = match parse(bytes) {
            Ok(message) => message,
            Err(Malformed::NotRtps | Malformed::Version(_)) => return self.fault(now, Fault::Foreign, from),
            Err(_) => return self.fault(now, Fault::Malformed, from),
        };
        // Multicast groups loop back the participant's own datagrams.
        if header.prefix == self.config.prefix {
            return;
        }
        let Some(guard) = self.guard.as_deref_mut() else {
            return self.dispatch(now, origin, header, submessages);
        };
        let mut plain = std::mem::take(&mut self.plain);
        plain.clear();
        if guard.decode(now, header.prefix, bytes, &mut plain) {
            match parse(&plain) {
                Ok((_, submessages)) => self.dispatch(now, origin, header, submessages),
                Err(_) => self.fault(now, Fault::Malformed, from),
            }
        } else {
            self.fault(now, Fault::Rejected, from);
        }
        self.plain = plain;
        self.heed_guard(now);
    }

    /// Handles a datagram from local endpoints to local endpoints.
    pub(super) fn loop_back(&mut self, now: Now, bytes: &[u8]) {
        let address = SocketAddrV4::new(Ipv4Addr::LOCALHOST, 0);
        let origin = Origin { address, length: bytes.len(), is_own: true };
        if let Ok((header, submessages)) = parse(bytes) {
            self.dispatch(now, origin, header, submessages);
        }
    }

    fn dispatch(&mut self, now: Now, origin: Origin, header: Header, submessages: Submessages<'_>) {
        if let Some(peer) = self.peers.get_mut(header.prefix) {
            peer.account.received(origin.length);
            if peer.is_closed {
                self.reopen(header.prefix);
            } else if !peer.withheld.is_empty() {
                self.release_withheld(header.prefix);
            }
        }
        let mut context =
            Context { source: header.prefix, destination: GuidPrefix::UNKNOWN, timestamp: None };
        for submessage in submessages {
            match submessage {
                Ok(Submessage::InfoTimestamp(timestamp)) => context.timestamp = timestamp,
                Ok(Submessage::InfoDestination(prefix)) => context.destination = prefix,
                Ok(Submessage::InfoSource(source)) => context.source = source.prefix,
                Ok(submessage) => self.deliver(now, origin, &context, &submessage),
                Err(_) => {
                    self.fault(now, Fault::Malformed, origin.address);
                    break;
                }
            }
        }
        // After parsing, so that malformed messages do not renew the lease.
        if let Some(peer) = self.peers.get_mut(context.source) {
            peer.heard = now.steady;
        }
    }

    fn deliver(&mut self, now: Now, origin: Origin, context: &Context, submessage: &Submessage<'_>) {
        let is_addressed = context.destination == self.config.prefix;
        let is_for_us = is_addressed || context.destination == GuidPrefix::UNKNOWN;
        let is_own = context.source == self.config.prefix;
        // Only own datagrams can have this participant as their source.
        if !is_for_us || is_own != origin.is_own {
            return;
        }
        if let Submessage::Data(data) = submessage
            && data.writer == EntityId::SPDP_WRITER
        {
            return self.hear_of_participant(now, context.source, origin.address, origin.length, data);
        }
        if is_addressed {
            self.note_answer(now, context.source, *origin.address.ip());
        }
        let from = |entity| Guid::new(context.source, entity);
        match submessage {
            Submessage::Data(data) => {
                let timestamp = context.timestamp;
                self.for_readers(data.reader, from(data.writer), |participant, reader, writer| {
                    participant.with_reader(now, reader, |reader, received, _| {
                        reader.handle_data(now, writer, timestamp, data, received);
                    });
                });
            }
            Submessage::DataFragment(fragment) => {
                let timestamp = context.timestamp;
                self.for_readers(fragment.reader, from(fragment.writer), |participant, reader, writer| {
                    participant.with_reader(now, reader, |reader, received, _| {
                        reader.handle_fragment(now, writer, timestamp, fragment, received);
                    });
                });
            }
            Submessage::Heartbeat(heartbeat) => {
                self.for_readers(heartbeat.reader, from(heartbeat.writer), |participant, reader, writer| {
                    participant.with_reader(now, reader, |reader, received, links| {
                        reader.handle_heartbeat(now, writer, heartbeat, received, links);
                    });
                });
            }
            Submessage::Gap(gap) => {
                self.for_readers(gap.reader, from(gap.writer), |participant, reader, writer| {
                    participant.with_reader(now, reader, |reader, received, _| {
                        reader.handle_gap(now, writer, gap, received);
                    });
                });
            }
            Submessage::HeartbeatFragment(heartbeat) => {
                self.for_readers(heartbeat.reader, from(heartbeat.writer), |participant, reader, writer| {
                    participant.with_reader(now, reader, |reader, _, links| {
                        reader.handle_heartbeat_fragment(now, writer, heartbeat, links);
                    });
                });
            }
            Submessage::AckNack(ack_nack) => {
                if !self.may_acknowledge(origin, context.source, ack_nack.writer) {
                    return self.fault(now, Fault::Elsewhere, origin.address);
                }
                let reader = from(ack_nack.reader);
                let translated;
                let mut ack_nack = ack_nack;
                if ack_nack.writer.is_builtin() {
                    translated = self.translate_ack_nack(now, context.source, ack_nack);
                    ack_nack = &translated;
                }
                self.with_writer(now, ack_nack.writer, |writer, links| {
                    writer.handle_ack_nack(now, reader, ack_nack, links);
                });
                self.note_acquaintance(ack_nack.writer, reader);
            }
            Submessage::NackFragment(nack) => {
                if !self.may_acknowledge(origin, context.source, nack.writer) {
                    return self.fault(now, Fault::Elsewhere, origin.address);
                }
                let reader = from(nack.reader);
                let nack = self.translate_nack_fragment(context.source, nack);
                self.with_writer(now, nack.writer, |writer, links| {
                    writer.handle_nack_fragment(now, reader, &nack, links);
                });
            }
            Submessage::InfoTimestamp(_)
            | Submessage::InfoDestination(_)
            | Submessage::InfoSource(_)
            | Submessage::InfoReply
            | Submessage::Pad
            | Submessage::Security { .. }
            | Submessage::Unknown { .. } => {}
        }
    }

    /// Whether an acknowledgement of a participant may come from there: samples that a reader has
    /// acknowledged are dropped. Acknowledgements of builtin writers are proven by their numbers.
    fn may_acknowledge(&self, origin: Origin, source: GuidPrefix, writer: EntityId) -> bool {
        let is_at = |peer: &Peer| self.is_at(peer, *origin.address.ip());
        origin.is_own || writer.is_builtin() || self.peers.get(source).is_none_or(is_at)
    }

    /// Calls the matched readers to which a submessage of `writer` is addressed. Without a match nothing is
    /// allocated.
    fn for_readers(&mut self, addressed: EntityId, writer: Guid, call: impl Fn(&mut Self, EntityId, Guid)) {
        let mut is_heard = false;
        let mut index = 0;
        while let Some(reader) = self.locals.readers_of(writer).get(index).copied() {
            index += 1;
            if addressed == EntityId::UNKNOWN || addressed == reader {
                is_heard = true;
                call(self, reader, writer);
            }
        }
        if !is_heard {
            self.counters.unmatched += 1;
        }
    }

    /// Handles what a local reader returned for a message.
    pub(super) fn take_from_reader(&mut self, now: Now, reader: EntityId, received: Received) {
        match received {
            Received::Sample(sample) => match reader {
                EntityId::SEDP_PUBLICATIONS_READER | EntityId::SEDP_SUBSCRIPTIONS_READER => {
                    self.hear_of_endpoint(now, reader, &sample);
                }
                EntityId::SEDP_PUBLICATIONS_SECURE_READER | EntityId::SEDP_SUBSCRIPTIONS_SECURE_READER => {
                    self.hear_of_endpoint(now, reader, &sample);
                }
                EntityId::WLP_READER | EntityId::WLP_SECURE_READER => {
                    self.hear_assertion(now, reader, &sample);
                }
                EntityId::SPDP_SECURE_READER => self.hear_of_change(now, &sample),
                EntityId::STATELESS_READER | EntityId::VOLATILE_READER => {
                    if let Some(channel) = Channel::of_reader(reader) {
                        self.hear_guard(now, channel, &sample);
                    }
                }
                _ => self.take_sample(reader, sample),
            },
            _ if reader.is_builtin() => {}
            Received::Lost { writer, count } => self.events.push_back(Event::Lost { reader, writer, count }),
            Received::DeadlineMissed { count } => {
                self.events.push_back(Event::DeadlineMissed { local: reader, count });
            }
            Received::LivelinessChanged { writer, is_alive } => {
                let Some(local) = self.locals.readers.get_mut(&reader) else { return };
                let change = match (local.liveliness.insert(writer, is_alive), is_alive) {
                    (None, true) => LivelinessChange::Alive,
                    (Some(false), true) => LivelinessChange::Revived,
                    (Some(true), false) => LivelinessChange::NotAlive,
                    _ => return,
                };
                self.events.push_back(Event::LivelinessChanged { reader, writer, change });
            }
        }
    }

    fn take_sample(&mut self, reader: EntityId, sample: Sample) {
        // Without keys there is nothing to dispose: such a sample only announces the end of its writer, which
        // discovery reports as well.
        if sample.is_key || sample.inline_qos.status.is_some_and(StatusInfo::is_removal) {
            return;
        }
        self.events.push_back(Event::Sample { reader, sample });
    }

    /// Handles an event of a local writer.
    pub(super) fn take_from_writer(&mut self, writer: EntityId, event: WriterEvent) {
        if writer.is_builtin() {
            if matches!(event, WriterEvent::Acknowledged) {
                self.drop_removals(writer);
            }
            return;
        }
        self.events.push_back(match event {
            WriterEvent::DeadlineMissed { count } => Event::DeadlineMissed { local: writer, count },
            WriterEvent::LivelinessLost => Event::LivelinessLost { writer },
            WriterEvent::Acknowledged => Event::Acknowledged { writer },
            WriterEvent::BegunAnew { reader } => Event::BegunAnew { writer, reader },
        });
    }
}
