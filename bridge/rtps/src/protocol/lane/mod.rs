//! The state of a writer for one link, that is for all matched readers of one participant.
//!
//! A sample is sent over a link once, for all readers there. Missing samples of a reader are sent again only
//! to that reader.

mod heartbeats;

use std::time::{Duration, Instant};

use crate::wire::{AckNack, EntityId, FragmentSet, Guid, MessageBuilder, NackFragment, SequenceNumber};

use super::count::LastCount;
use super::history::{Entry, History};
use super::intervals::Intervals;
use super::links::{Emitted, LinkId, Links};
use super::outgoing::{MatchedReader, Outgoing, Sending};
use super::pacer::Load;
use super::part::{Part, fragment_count};
use heartbeats::{HEARTBEAT_PERIOD, HeartbeatWish};

/// The longest delay of a separate heartbeat while a reader requests samples.
const REPAIR_PERIOD_MAX: Duration = Duration::from_millis(100);
/// A link whose window is full is considered stalled if a request for an acknowledgement is not answered for
/// this time.
const STALL: Duration = Duration::from_millis(100);
/// Bytes of a heartbeat.
const HEARTBEAT_LEN: usize = 32;
/// The most samples of a reader with pending requests for fragments.
const MAX_FRAGMENTED: usize = 8;

/// The state of one link of a writer.
#[derive(Debug)]
pub(super) struct Lane {
    link: LinkId,
    pub readers: Vec<Outgoing>,
    /// The first sample that is not completely sent.
    next: SequenceNumber,
    /// Number of sent fragments of `next`.
    next_fragment: u32,
    /// The position in the stream up to which samples are sent, and the position up to which all reliable
    /// readers have acknowledged.
    sent: u64,
    acknowledged: u64,
    /// When the acknowledged position last advanced, or when the first sample was sent after everything had
    /// been acknowledged.
    progress: Instant,
    /// When the next heartbeat is due.
    pub heartbeat_at: Option<Instant>,
    heartbeat_period: Duration,
    /// The heartbeat to send with the next datagram.
    heartbeat: HeartbeatWish,
    /// The next heartbeat also asserts that the writer is alive.
    is_liveliness: bool,
    last_heartbeat: Option<Instant>,
    /// The sent position in the stream at the last heartbeat.
    heartbeat_sent: u64,
    /// When an acknowledgement of all readers was last requested, and the sent position at that time.
    last_asked: Option<Instant>,
    asked_sent: u64,
    /// When an acknowledgement was first requested since the acknowledged position last advanced.
    unanswered_since: Option<Instant>,
    /// When samples were last sent for the first time.
    last_data: Option<Instant>,
    /// A sample was sent after a pause, and no heartbeat since then.
    follows_pause: bool,
}

/// The readers of a lane that receive a sample.
enum Audience {
    Nobody,
    Some(Guid),
    All,
}

impl Lane {
    /// Creates a lane that sends samples written from now on.
    pub fn new(link: LinkId, history: &History, now: Instant) -> Self {
        let sent = history.position(history.next());
        Self {
            link,
            readers: Vec::new(),
            next: history.next(),
            next_fragment: 0,
            sent,
            acknowledged: sent,
            progress: now,
            heartbeat_at: None,
            heartbeat_period: HEARTBEAT_PERIOD,
            heartbeat: HeartbeatWish::None,
            is_liveliness: false,
            last_heartbeat: None,
            heartbeat_sent: sent,
            last_asked: None,
            asked_sent: sent,
            unanswered_since: None,
            last_data: None,
            follows_pause: false,
        }
    }

    /// The first sample that was not sent on this lane.
    pub fn next(&self) -> SequenceNumber {
        self.next
    }

    /// Returns whether the peer has stopped acknowledging, so that samples need not be kept for it.
    pub fn is_stalled(&self, now: Instant, links: &Links) -> bool {
        let is_held = links.window_size(self.link).is_some() && self.acknowledged < self.sent;
        is_held && self.unanswered_since.is_some_and(|since| now.saturating_duration_since(since) >= STALL)
    }

    /// Adds a reader. A reader that `moved` from another link keeps its acknowledged position.
    pub fn add_reader(
        &mut self,
        matched: &MatchedReader,
        moved: Option<Outgoing>,
        sending: &Sending<'_>,
        depth: usize,
        links: &mut Links,
    ) {
        let mut reader = Outgoing {
            guid: matched.guid,
            is_reliable: matched.is_reliable,
            wants_history: matched.wants_history,
            start: self.next,
            acknowledged: self.next,
            position: self.sent,
            matched_position: self.sent,
            matched_next: self.next,
            repair: Intervals::default(),
            repaired_fragments: None,
            fragments: Vec::new(),
            gap_from: None,
            heartbeat: matched.is_reliable,
            has_answered: false,
            has_acknowledged: false,
            last_ack_nack: LastCount::default(),
            last_nack_fragment: LastCount::default(),
        };
        match moved {
            Some(moved) => {
                reader.start = moved.start;
                reader.acknowledged = moved.acknowledged.min(self.next);
                reader.has_answered = moved.has_answered;
                reader.has_acknowledged = moved.has_acknowledged;
                reader.repair = moved.repair;
            }
            None => {
                reader.begin(self.next, sending.history, depth);
                // A new participant has no discovery data yet. Other reliable readers request what they miss
                // once they know the writer.
                if !matched.is_reliable || sending.writer.is_builtin() {
                    reader.repair.insert(reader.start.0..self.next.0);
                }
            }
        }
        self.readers.push(reader);
        self.update_acknowledged(sending.now, links);
        self.arm(sending.now, sending.history);
        links.request(self.link, sending.writer);
    }

    /// Closes the lane and releases its share of the window of the link.
    pub fn close(&mut self, links: &mut Links) {
        self.readers.clear();
        self.set_acknowledged(self.sent, links);
    }

    pub fn remove_reader(&mut self, guid: Guid, now: Instant, links: &mut Links) -> Option<Outgoing> {
        let index = self.readers.iter().position(|reader| reader.guid == guid)?;
        let reader = self.readers.remove(index);
        self.update_acknowledged(now, links);
        Some(reader)
    }

    /// Skips a sample that is for no reader of this lane, if nothing before it waits.
    pub fn pass_over(&mut self, number: SequenceNumber, history: &History, links: &mut Links) -> bool {
        let is_idle = self.next == number && self.next_fragment == 0;
        if is_idle {
            self.skip(number.next(), |_| true, history, links);
        }
        is_idle
    }

    /// Handles an acknowledgement of the reader at `index`. Returns whether the reader has begun anew, as one
    /// does whose participant had given this one up.
    pub fn handle_ack_nack(
        &mut self,
        index: usize,
        ack_nack: &AckNack,
        sending: &Sending<'_>,
        depth: usize,
        links: &mut Links,
    ) -> bool {
        let (now, history, next) = (sending.now, sending.history, self.next);
        let reader = &mut self.readers[index];
        let base = ack_nack.missing.base();
        if !reader.is_reliable || base > history.next() || !reader.last_ack_nack.accept(ack_nack.count, now) {
            return false;
        }
        reader.has_answered = true;
        let asks = !ack_nack.missing.is_empty();
        let has_acknowledged = std::mem::replace(&mut reader.has_acknowledged, base > SequenceNumber::FIRST);
        if !asks && base <= SequenceNumber::FIRST {
            // The first acknowledgement of a reader, or the reader has lost its state.
            if reader.acknowledged > SequenceNumber::FIRST {
                (reader.matched_next, reader.matched_position) = (next, self.sent);
                reader.begin(next, history, depth);
            }
            reader.heartbeat |= !ack_nack.is_final;
        } else {
            reader.acknowledge(base.min(next), history);
            let lost = reader.request(&ack_nack.missing, next);
            if lost {
                links.lose(self.link, now);
            }
            reader.heartbeat |= !asks && !ack_nack.is_final;
        }
        if reader.has_something() {
            links.request(self.link, sending.writer);
        }
        self.update_acknowledged(now, links);
        self.arm(now, history);
        if asks {
            // The reader is alive and waits: if the repair is lost as well, it should learn that soon.
            self.heartbeat_period = self.heartbeat_period.min(REPAIR_PERIOD_MAX);
            let soon = now + self.heartbeat_period;
            self.heartbeat_at = self.heartbeat_at.map(|at| at.min(soon));
        }
        has_acknowledged && !asks && base <= SequenceNumber::FIRST
    }

    /// Handles a request for fragments, or an acknowledgement of fragments, of the reader at `index`.
    pub fn handle_nack_fragment(
        &mut self,
        index: usize,
        nack: &NackFragment,
        sending: &Sending<'_>,
        links: &mut Links,
    ) {
        let (now, number) = (sending.now, nack.number);
        let fragment_size = links.fragment_size(self.link);
        let (next, next_fragment) = (self.next, self.next_fragment);
        let reader = &mut self.readers[index];
        if !reader.is_reliable || number > next || !reader.last_nack_fragment.accept(nack.count, now) {
            return;
        }
        let Some(entry) = sending.history.get(number) else {
            reader.heartbeat = true;
            links.request(self.link, sending.writer);
            return;
        };
        let count = fragment_count(entry, fragment_size);
        // Fragments below the limit were already sent; the others will be sent anyway.
        let limit = match reader.repaired_fragments {
            _ if number == next => next_fragment,
            Some((repaired, fragments)) if repaired == number => fragments,
            _ => count,
        };
        let received = nack.missing.base().saturating_sub(1).min(limit);
        if number == reader.acknowledged {
            let bytes = (u64::from(received) * u64::from(fragment_size)).min(entry.payload.len() as u64);
            reader.position = reader.position.max(entry.position + bytes);
        }
        let mut missing = FragmentSet::new(nack.missing.base());
        nack.missing
            .iter()
            .take_while(|fragment| *fragment <= limit)
            .all(|fragment| missing.insert(fragment));
        if !missing.is_empty() {
            reader.fragments.retain(|(of, _)| *of != number);
            if reader.fragments.len() < MAX_FRAGMENTED {
                reader.fragments.push((number, missing));
            }
            links.lose(self.link, now);
            links.request(self.link, sending.writer);
        }
        self.update_acknowledged(now, links);
        self.arm(now, sending.history);
    }

    /// Fills a datagram.
    ///
    /// `is_pressed` requests an acknowledgement because samples that are not acknowledged take up much of the
    /// window of the writer.
    pub fn emit(
        &mut self,
        sending: &mut Sending<'_>,
        is_pressed: bool,
        links: &mut Links,
        builder: &mut MessageBuilder<'_>,
    ) -> Emitted {
        builder.info_destination(links.peer(self.link));
        // A handshake proves the address as well.
        if links.is_restricted(self.link) && sending.writer != EntityId::STATELESS_WRITER {
            let wishes =
                self.heartbeat > HeartbeatWish::None || self.readers.iter().any(|reader| reader.heartbeat);
            let is_due = wishes && sending.writer.is_builtin();
            return match is_due && !self.emit_heartbeats(sending, links, builder) {
                true => Emitted::More,
                false => Emitted::Done,
            };
        }
        if self.heartbeat > HeartbeatWish::None
            && self.is_much_unasked(links)
            && !self.emit_heartbeats(sending, links, builder)
        {
            return Emitted::More;
        }
        let mut emitted = Emitted::Done;
        for reader in &mut self.readers {
            match reader.emit_repairs(sending, self.link, self.next, links, builder) {
                Emitted::More => return Emitted::More,
                Emitted::Blocked => emitted = Emitted::Blocked,
                Emitted::Done => {}
            }
        }
        match self.emit_new(sending, links, builder) {
            Emitted::More => {
                if self.is_much_unasked(links) {
                    // If it does not fit, it is sent with the next datagram.
                    let _ = self.emit_heartbeats(sending, links, builder);
                }
                return Emitted::More;
            }
            Emitted::Blocked => emitted = Emitted::Blocked,
            Emitted::Done => {}
        }
        if !self.wish_heartbeat(sending, is_pressed, emitted, links)
            || self.emit_heartbeats(sending, links, builder)
        {
            emitted
        } else {
            Emitted::More
        }
    }

    /// Writes samples that were not sent yet.
    fn emit_new(
        &mut self,
        sending: &Sending<'_>,
        links: &mut Links,
        builder: &mut MessageBuilder<'_>,
    ) -> Emitted {
        let history = sending.history;
        while self.next < history.next() {
            let Some(entry) = history.get(self.next) else {
                let next = history.at_or_after(self.next);
                // Discarded samples are for no reader. Samples that were replaced before they were sent are
                // lost, which the next heartbeat reports.
                let is_discarded = self.next > history.first();
                self.skip(next, |_| is_discarded, history, links);
                continue;
            };
            let audience = self.audience(entry);
            if matches!(audience, Audience::Nobody) {
                self.skip(entry.number.next(), |_| true, history, links);
                continue;
            }
            let is_for = |reader: &Outgoing| match audience {
                Audience::Nobody => false,
                Audience::Some(guid) => reader.guid == guid,
                Audience::All => true,
            };
            for reader in self.readers.iter_mut().filter(|reader| is_for(reader)) {
                if !reader.emit_gap_before(entry.number, sending.writer, builder) {
                    return Emitted::More;
                }
            }
            let entity = match audience {
                Audience::Some(guid) => guid.entity,
                Audience::All if self.readers.len() == 1 => self.readers[0].guid.entity,
                Audience::All | Audience::Nobody => EntityId::UNKNOWN,
            };
            let fragment_size = links.fragment_size(self.link);
            let part = Part::of(entry, fragment_size, self.next_fragment + 1);
            if !part.fits(entry, builder) {
                return Emitted::More;
            }
            let (load, bytes) = (Load::of(entry), part.len(entry));
            let may_send = match self.has_reliable() {
                true => links.may_send_reliable(self.link, sending.now, load, bytes),
                false => links.may_send(self.link, sending.now, load, bytes),
            };
            if !may_send {
                return Emitted::Blocked;
            }
            part.emit(entry, entity, sending.writer, builder);
            if self.acknowledged == self.sent {
                self.progress = sending.now;
            }
            self.follows_pause |= self.last_data.is_none_or(|last| sending.now >= last + HEARTBEAT_PERIOD);
            self.last_data = Some(sending.now);
            if part.is_last(entry) {
                self.skip(entry.number.next(), |reader| !is_for(reader), history, links);
            } else {
                self.next_fragment += 1;
                self.set_sent(entry.position + part.end(), links);
            }
            // Within a large sample or a long series of small ones, acknowledgements must be requested.
            if self.is_much_unasked(links) && self.has_reliable() {
                self.heartbeat = HeartbeatWish::Ask;
                if builder.remaining() < 2 * HEARTBEAT_LEN || self.next_fragment > 0 {
                    return Emitted::More;
                }
            }
        }
        Emitted::Done
    }

    /// Advances to `next`. Readers for which everything before it `is_nothing` need not acknowledge it.
    fn skip(
        &mut self,
        next: SequenceNumber,
        is_nothing: impl Fn(&Outgoing) -> bool,
        history: &History,
        links: &mut Links,
    ) {
        let before = std::mem::replace(&mut self.next, next);
        self.next_fragment = 0;
        for reader in self.readers.iter_mut().filter(|reader| is_nothing(reader)) {
            reader.gap_from.get_or_insert(before);
            if reader.acknowledged == before {
                reader.acknowledge(next, history);
            }
        }
        self.set_sent(history.position(next), links);
    }

    fn audience(&self, entry: &Entry) -> Audience {
        match entry.only_to {
            None => Audience::All,
            Some(guid) if self.readers.iter().any(|reader| reader.guid == guid) => Audience::Some(guid),
            Some(_) => Audience::Nobody,
        }
    }

    fn has_reliable(&self) -> bool {
        self.readers.iter().any(|reader| reader.is_reliable)
    }

    fn is_behind(&self, history: &History) -> bool {
        self.readers.iter().any(|reader| reader.is_behind(history))
    }

    fn update_acknowledged(&mut self, now: Instant, links: &mut Links) {
        let acknowledged = self.lowest_position();
        if acknowledged > self.acknowledged {
            self.progress = now;
        }
        self.set_acknowledged(acknowledged, links);
    }

    fn set_acknowledged(&mut self, acknowledged: u64, links: &mut Links) {
        let before = self.in_flight();
        if acknowledged > self.acknowledged {
            self.unanswered_since = None;
        }
        self.acknowledged = acknowledged;
        links.change_in_flight(self.link, before, self.in_flight());
    }

    fn set_sent(&mut self, sent: u64, links: &mut Links) {
        let before = self.in_flight();
        self.sent = sent;
        self.acknowledged = self.lowest_position();
        links.change_in_flight(self.link, before, self.in_flight());
    }

    /// The position in the stream up to which all reliable readers have acknowledged.
    fn lowest_position(&self) -> u64 {
        let reliable = self.readers.iter().filter(|reader| reader.is_reliable);
        reliable.map(|reader| reader.position).min().map_or(self.sent, |lowest| lowest.min(self.sent))
    }

    fn in_flight(&self) -> u64 {
        self.sent - self.acknowledged
    }
}
