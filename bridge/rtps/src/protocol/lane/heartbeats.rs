//! The heartbeats of a lane.
//!
//! Heartbeats accompany samples, so that a reader requests a lost sample as soon as the next one arrives.
//! Most of them are final: a reader answers only if it lacks something, because an answer to each sample
//! costs the subscriber more than the sample does. An acknowledgement is requested
//!
//! - from readers that have not answered yet, and from all with a sample that follows a pause;
//! - every [`ASK_PERIOD`] while samples are sent, and then with each heartbeat until it is answered: Fast DDS
//!   answers after 5 ms, unless a final heartbeat has come meanwhile;
//! - [`HEARTBEAT_PERIOD`] after the last sample, which is when a lost last sample is noticed;
//! - when the window of the link or of the writer is half full, or much data was sent.

use std::time::{Duration, Instant};

use crate::wire::{EntityId, Heartbeat, HeartbeatFragment, MessageBuilder};

use super::Lane;
use crate::protocol::history::History;
use crate::protocol::links::{Emitted, Links};
use crate::protocol::outgoing::Sending;

/// Minimum time between heartbeats that accompany samples.
const HEARTBEAT_PAUSE: Duration = Duration::from_millis(5);
/// Delay of the first separate heartbeat for unacknowledged samples. It doubles each time. A sample that
/// comes later than this after the previous one requests an acknowledgement itself.
pub(super) const HEARTBEAT_PERIOD: Duration = Duration::from_millis(20);
const HEARTBEAT_PERIOD_MAX: Duration = Duration::from_secs(3);
/// How often an acknowledgement is requested while samples are sent.
const ASK_PERIOD: Duration = Duration::from_millis(100);
/// Without a window, an acknowledgement is requested after this many bytes.
const HEARTBEAT_DATA: u64 = 64 * 1024;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum HeartbeatWish {
    None,
    /// Only readers that lack something answer.
    Final,
    /// Requests an acknowledgement.
    Ask,
}

impl Lane {
    pub fn wish_liveliness(&mut self) {
        self.heartbeat = self.heartbeat.max(HeartbeatWish::Final);
        self.is_liveliness = true;
    }

    /// Requests an acknowledgement with the next datagram if a reader lacks samples.
    pub fn ask_all(&mut self, sending: &Sending<'_>, links: &mut Links) {
        if self.is_behind(sending.history) {
            self.heartbeat = HeartbeatWish::Ask;
            links.request(self.link, sending.writer);
        }
    }

    /// Sends a heartbeat soon if a reader lacks samples.
    pub fn resume(&mut self, now: Instant, history: &History) {
        if self.is_behind(history) {
            self.heartbeat = HeartbeatWish::Ask;
            self.heartbeat_period = HEARTBEAT_PERIOD;
            self.heartbeat_at = Some(now + HEARTBEAT_PERIOD);
        }
    }

    /// Sends a heartbeat to the reader at `index`, which it answers.
    pub fn ask(&mut self, index: usize, sending: &Sending<'_>, links: &mut Links) {
        self.readers[index].heartbeat = true;
        links.request(self.link, sending.writer);
    }

    /// Sends a heartbeat if one is due and a reader has not acknowledged all samples.
    pub fn handle_timeout(&mut self, sending: &Sending<'_>, links: &mut Links) {
        if self.heartbeat_at.is_none_or(|at| at > sending.now) {
            return;
        }
        self.heartbeat_at = self.waits_for_pause(sending);
        if self.heartbeat_at.is_some() {
            return;
        }
        if self.is_behind(sending.history) {
            self.heartbeat = HeartbeatWish::Ask;
            self.heartbeat_at = Some(sending.now + self.heartbeat_period);
            self.heartbeat_period = (2 * self.heartbeat_period).min(HEARTBEAT_PERIOD_MAX);
            links.request(self.link, sending.writer);
        }
    }

    /// Until when a heartbeat can wait because samples are being sent, which have heartbeats of their own.
    fn waits_for_pause(&self, sending: &Sending<'_>) -> Option<Instant> {
        let is_stream = self.sent > self.asked_sent && !sending.writer.is_builtin();
        let pause = self.last_data.filter(|_| is_stream)? + HEARTBEAT_PERIOD;
        let until = self.last_asked.map_or(pause, |asked| pause.min(asked + ASK_PERIOD));
        (sending.now < until).then_some(until)
    }

    /// Called after a sample was written. Schedules a heartbeat in case it is not acknowledged.
    pub fn note_written(&mut self, now: Instant) {
        if self.heartbeat_at.is_none() && self.has_reliable() {
            self.heartbeat_period = HEARTBEAT_PERIOD;
            self.heartbeat_at = Some(now + HEARTBEAT_PERIOD);
        }
    }

    /// Returns whether a heartbeat is due, after everything was sent that can be sent.
    pub(super) fn wish_heartbeat(
        &mut self,
        sending: &Sending<'_>,
        is_pressed: bool,
        emitted: Emitted,
        links: &Links,
    ) -> bool {
        let now = sending.now;
        if self.heartbeat > HeartbeatWish::None || self.readers.iter().any(|reader| reader.heartbeat) {
            return true;
        }
        let is_blocked = emitted == Emitted::Blocked;
        let is_held_up = is_blocked && self.sent > self.asked_sent && links.is_half_full(self.link);
        if !self.has_reliable() || self.data_since_heartbeat() == 0 && !is_held_up {
            return false;
        }
        let is_early = self.last_heartbeat.is_some_and(|last| now < last + HEARTBEAT_PAUSE);
        let is_much = self.is_much_unasked(links);
        if is_much || is_held_up || !is_blocked && !is_early {
            let asks = is_much || is_pressed || self.should_ask(sending, links);
            self.heartbeat = if asks { HeartbeatWish::Ask } else { HeartbeatWish::Final };
            return true;
        }
        // Announcements are few, and others wait for them.
        if let (true, true, Some(last)) = (is_early, sending.writer.is_builtin(), self.last_heartbeat) {
            let soon = last + HEARTBEAT_PAUSE;
            self.heartbeat_at = Some(self.heartbeat_at.map_or(soon, |at| at.min(soon)));
        }
        false
    }

    /// Returns whether a heartbeat that accompanies samples requests an acknowledgement.
    fn should_ask(&self, sending: &Sending<'_>, links: &Links) -> bool {
        sending.writer.is_builtin()
            || self.follows_pause
            || self.unanswered_since.is_some()
            || self.last_asked.is_none_or(|last| sending.now >= last + ASK_PERIOD)
            || links.is_half_full(self.link)
            || self.readers.iter().any(|reader| reader.is_reliable && !reader.has_answered)
    }

    /// Writes the heartbeats that are due. Returns `false` if one does not fit.
    pub(super) fn emit_heartbeats(
        &mut self,
        sending: &mut Sending<'_>,
        links: &Links,
        builder: &mut MessageBuilder<'_>,
    ) -> bool {
        let (now, history) = (sending.now, sending.history);
        let first = history.first();
        let single = match self.readers.as_slice() {
            [reader] => Some(reader.guid.entity),
            _ => None,
        };
        let has_reliable = self.has_reliable();
        let mut asks_all = false;
        let mut heartbeat = Heartbeat {
            reader: single.unwrap_or(EntityId::UNKNOWN),
            writer: sending.writer,
            first,
            last: self.next.previous().max(first.previous()),
            count: sending.heartbeats.wrapping_add(1),
            is_final: !has_reliable,
            is_liveliness: self.is_liveliness,
        };
        for reader in self.readers.iter_mut().filter(|reader| reader.heartbeat) {
            let first = first.max(reader.start);
            let last = heartbeat.last.max(first.previous());
            if !builder.heartbeat(&Heartbeat { reader: reader.guid.entity, first, last, ..heartbeat }) {
                return false;
            }
            *sending.heartbeats = heartbeat.count;
            heartbeat.count = heartbeat.count.wrapping_add(1);
            reader.heartbeat = false;
            if single.is_some() {
                (self.heartbeat, asks_all) = (HeartbeatWish::None, true);
            }
        }
        if self.heartbeat > HeartbeatWish::None {
            heartbeat.is_final |= self.heartbeat == HeartbeatWish::Final;
            if !builder.heartbeat(&heartbeat) {
                return false;
            }
            *sending.heartbeats = heartbeat.count;
            self.heartbeat = HeartbeatWish::None;
            asks_all |= !heartbeat.is_final;
        }
        self.is_liveliness = false;
        // Between participants of this engine, fragments of an incomplete sample are acknowledged as well.
        if self.next_fragment > 0 && self.has_reliable() && links.window_size(self.link).is_some() {
            let fragments = HeartbeatFragment {
                reader: heartbeat.reader,
                writer: sending.writer,
                number: self.next,
                last: self.next_fragment,
                count: sending.heartbeats.wrapping_add(1),
            };
            if !builder.heartbeat_fragment(&fragments) {
                self.heartbeat = HeartbeatWish::Ask;
                return false;
            }
            *sending.heartbeats = fragments.count;
        }
        self.last_heartbeat = Some(now);
        self.heartbeat_sent = self.sent;
        self.follows_pause = false;
        if asks_all {
            self.last_asked = Some(now);
            self.asked_sent = self.sent;
            self.unanswered_since.get_or_insert(now);
        }
        self.heartbeat_at = self.is_behind(history).then(|| {
            let is_asked = self.asked_sent == self.sent;
            now + if is_asked { self.heartbeat_period } else { HEARTBEAT_PERIOD }
        });
        true
    }

    fn data_since_heartbeat(&self) -> u64 {
        self.sent.saturating_sub(self.heartbeat_sent)
    }

    /// Returns whether so much was sent since the last request for an acknowledgement that the next one is
    /// due.
    pub(super) fn is_much_unasked(&self, links: &Links) -> bool {
        self.sent.saturating_sub(self.asked_sent) >= self.heartbeat_data(links)
    }

    /// Number of bytes after which an acknowledgement is requested even if more data wait.
    fn heartbeat_data(&self, links: &Links) -> u64 {
        match links.window_size(self.link) {
            Some(window) => window / 4,
            // Readers of other engines do not acknowledge fragments.
            None if self.next_fragment > 0 => u64::MAX,
            None => HEARTBEAT_DATA,
        }
    }

    /// Reschedules the heartbeat after an acknowledgement: after the shortest period again, or not at all.
    pub(super) fn arm(&mut self, now: Instant, history: &History) {
        if !self.is_behind(history) {
            self.heartbeat_at = None;
        } else if self.progress == now || self.heartbeat_at.is_none() {
            self.heartbeat_period = HEARTBEAT_PERIOD;
            self.heartbeat_at = Some(now + HEARTBEAT_PERIOD);
        }
    }
}
