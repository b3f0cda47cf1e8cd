//! The side of the participant in DDS Security: channels between guards, and what a guard demands.

use super::{
    Admission, Channel, Demand, Event, MatchedReader, MatchedWriter, Now, Numbers, Participant, Sample,
    WriteOptions,
    participant::{SHORTEST_TIMEOUT, Timer},
};
use crate::wire::{BuiltinEndpoints, EndpointData, EntityId, Guid, GuidPrefix, SecurityAttributes};

impl Channel {
    /// The writer and the reader of each participant.
    pub(super) fn ends(self) -> (EntityId, EntityId) {
        match self {
            Self::Stateless => (EntityId::STATELESS_WRITER, EntityId::STATELESS_READER),
            Self::Volatile => (EntityId::VOLATILE_WRITER, EntityId::VOLATILE_READER),
        }
    }

    /// The channel that ends at a reader.
    pub(super) fn of_reader(reader: EntityId) -> Option<Self> {
        [Self::Stateless, Self::Volatile].into_iter().find(|channel| channel.ends().1 == reader)
    }
}

impl Participant {
    /// Does what the guard demands. To be called after each call of it that takes the time.
    pub(super) fn heed_guard(&mut self, now: Now) {
        if self.guard.is_none() {
            return;
        }
        while let Some(demand) = self.guard.as_deref_mut().and_then(|guard| guard.poll()) {
            match demand {
                Demand::Send { channel, to, message } => {
                    let (writer, reader) = channel.ends();
                    let only_to = Some(Guid::new(to, reader));
                    let options = WriteOptions { only_to, ..WriteOptions::default() };
                    self.with_writer(now, writer, |writer, links| {
                        // Its window is unlimited.
                        let _ = writer.write(now, message, options, links);
                    });
                }
                Demand::Reconsider(prefix) => self.admit(now, prefix),
                Demand::Report(report) => self.events.push_back(Event::Security(report)),
            }
        }
        let timeout = self.guard.as_deref().and_then(|guard| guard.next_timeout());
        self.timers.set(Timer::Guard, timeout.map(|at| at.max(now.steady + SHORTEST_TIMEOUT)));
    }

    /// Whether a participant has proven its identity to the guard.
    pub(super) fn is_authenticated(&self, prefix: GuidPrefix) -> bool {
        self.guard.as_deref().is_some_and(|guard| guard.is_authenticated(prefix))
    }

    /// Whether nothing that a participant announces in clear is believed.
    pub(super) fn hears_only_protected(&self, prefix: GuidPrefix) -> bool {
        let admitted = self.peers.get(prefix).is_some_and(|peer| peer.admission == Admission::Admit);
        admitted && self.is_authenticated(prefix)
    }

    /// What numbers prove in the messages of a participant to a local endpoint, builtin if `None`.
    pub(super) fn numbers_of(&self, prefix: GuidPrefix, local: Option<&EndpointData>) -> Numbers {
        let protected = |attributes: &SecurityAttributes, bit| attributes.mask & bit != 0;
        let peer = self.peers.get(prefix).and_then(|peer| peer.data.security.as_ref());
        let is_message = peer.is_some_and(|it| protected(&it.attributes, SecurityAttributes::RTPS_PROTECTED));
        let own = local.and_then(|local| local.security.as_ref());
        let is_submessage = own.is_some_and(|it| protected(it, SecurityAttributes::SUBMESSAGE_PROTECTED));
        match self.is_authenticated(prefix) && (is_message || is_submessage) {
            true => Numbers::Proven,
            false => Numbers::Doubtful,
        }
    }

    /// Opens a channel to the guard of another participant, if that has one.
    pub(super) fn open_channel(&mut self, now: Now, channel: Channel, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get(prefix) else { return };
        let (bits, is_reliable, numbers) = match channel {
            Channel::Stateless => (
                BuiltinEndpoints::STATELESS_WRITER | BuiltinEndpoints::STATELESS_READER,
                false,
                Numbers::Irrelevant,
            ),
            Channel::Volatile => {
                (BuiltinEndpoints::VOLATILE_WRITER | BuiltinEndpoints::VOLATILE_READER, true, Numbers::Proven)
            }
        };
        if self.guard.is_none() || !peer.data.builtin_endpoints.has(bits) {
            return;
        }
        let (link, vendor) = (peer.metatraffic, peer.data.vendor);
        let (writer, reader) = channel.ends();
        let theirs = Guid::new(prefix, writer);
        self.locals.note_source(reader, theirs);
        self.with_reader(now, reader, |reader, _, _| {
            let matched = MatchedWriter {
                guid: theirs,
                is_reliable,
                lifespan: None,
                liveliness_lease: None,
                link,
                numbers,
                vendor,
            };
            reader.match_writer(now, matched);
        });
        self.with_writer(now, writer, |writer, links| {
            let guid = Guid::new(prefix, reader);
            writer.match_reader(now, MatchedReader { guid, is_reliable, wants_history: false, link }, links);
        });
    }

    /// Closes both channels.
    pub(super) fn close_channels(&mut self, now: Now, prefix: GuidPrefix) {
        for channel in [Channel::Stateless, Channel::Volatile] {
            let (writer, reader) = channel.ends();
            let theirs = Guid::new(prefix, writer);
            self.locals.forget_source(reader, theirs);
            self.with_reader(now, reader, |reader, _, _| reader.unmatch_writer(theirs));
            self.with_writer(now, writer, |writer, links| {
                writer.unmatch_reader(now, Guid::new(prefix, reader), links);
            });
        }
    }

    /// Handles what a guard of another participant sent. The caller heeds the guard.
    pub(super) fn hear_guard(&mut self, now: Now, channel: Channel, sample: &Sample) {
        if let Some(guard) = self.guard.as_deref_mut() {
            guard.handle_message(now, channel, sample.writer.prefix, &sample.payload);
        }
    }
}
