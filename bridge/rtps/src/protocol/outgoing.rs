//! What a writer knows about one reader: what it has, and what is to be sent to it again.

use std::time::Instant;

use crate::wire::{EntityId, FragmentSet, Gap, Guid, MessageBuilder, SequenceNumber, SequenceNumberSet};

use super::count::LastCount;
use super::history::{Entry, History};
use super::intervals::Intervals;
use super::links::{Emitted, LinkId, Links};
use super::pacer::Load;
use super::part::Part;

/// A reader that is matched with the writer.
#[derive(Debug, Clone, Copy)]
pub struct MatchedReader {
    pub guid: Guid,
    /// Whether both are reliable.
    pub is_reliable: bool,
    /// Whether both are transient local.
    pub wants_history: bool,
    /// Where the reader is.
    pub link: LinkId,
}

/// What all lanes of a writer share while they send.
pub(super) struct Sending<'a> {
    pub now: Instant,
    pub writer: EntityId,
    pub history: &'a History,
    /// The count of the last heartbeat.
    pub heartbeats: &'a mut u32,
}

/// The state of one matched reader.
#[derive(Debug)]
pub(super) struct Outgoing {
    pub guid: Guid,
    pub is_reliable: bool,
    pub wants_history: bool,
    /// The first sample that concerns this reader.
    pub start: SequenceNumber,
    /// The first sample that this reader has not acknowledged.
    pub acknowledged: SequenceNumber,
    /// The same in the stream: parts of a sample count. Never below what was sent when the reader was matched: sending
    /// it the history is not held against the window.
    pub position: u64,
    /// How much had been sent when the reader was matched.
    pub matched_position: u64,
    /// The first sample to be sent after the reader was matched.
    pub matched_next: SequenceNumber,
    /// Samples to be sent again, and how many fragments of the first of them already are.
    pub repair: Intervals,
    pub repaired_fragments: Option<(SequenceNumber, u32)>,
    /// Fragments to be sent again.
    pub fragments: Vec<(SequenceNumber, FragmentSet)>,
    /// The first of some samples that were not for this reader, which does not know yet.
    pub gap_from: Option<SequenceNumber>,
    /// A heartbeat to this reader is due.
    pub heartbeat: bool,
    /// Whether the reader has acknowledged anything: it knows the writer then. Until it does heartbeats are repeated.
    pub has_answered: bool,
    pub last_ack_nack: LastCount,
    pub last_nack_fragment: LastCount,
}

impl Outgoing {
    /// Whether the reader has yet to acknowledge something, its match at least.
    pub fn is_behind(&self, history: &History) -> bool {
        self.is_reliable && (!self.has_answered || self.acknowledged < history.next())
    }

    /// Whether the reader has yet to acknowledge the sample `number`.
    pub fn lacks(&self, number: SequenceNumber) -> bool {
        self.is_reliable && self.acknowledged <= number
    }

    /// Begins with what the reader is due: the newest samples if it wants history, else what it has not acknowledged.
    pub fn begin(&mut self, next: SequenceNumber, history: &History, depth: usize) {
        if self.wants_history {
            self.start = history.newest(depth).min(next);
            self.acknowledged = self.start;
        } else {
            self.start = self.acknowledged;
        }
        self.position = self.matched_position;
        self.repair.clear();
        self.fragments.clear();
        self.repaired_fragments = None;
    }

    pub fn acknowledge(&mut self, base: SequenceNumber, history: &History) {
        if base <= self.acknowledged {
            return;
        }
        self.acknowledged = base;
        self.position = self.position.max(history.position(base));
        self.repair.remove(0..base.0);
        self.fragments.retain(|(number, _)| *number >= base);
    }

    /// Notes what is to be sent again; whether some of it was lost on the way.
    pub fn request(&mut self, missing: &SequenceNumberSet, next: SequenceNumber) -> bool {
        self.repair.clear();
        // A sample that is being sent again stays in the list, though the reader asks for its fragments by now.
        if let Some((number, _)) = self.repaired_fragments.filter(|(number, _)| *number >= missing.base()) {
            self.repair.insert(number.0..number.0 + 1);
        }
        let mut lost = false;
        for number in missing.iter().filter(|number| *number < next) {
            self.repair.insert(number.0..number.0 + 1);
            lost |= number >= self.matched_next;
        }
        lost
    }

    pub fn has_something(&self) -> bool {
        self.heartbeat || !self.repair.is_empty() || !self.fragments.is_empty()
    }

    /// Sends again what was asked for.
    pub fn emit_repairs(
        &mut self,
        sending: &Sending<'_>,
        link: LinkId,
        next: SequenceNumber,
        links: &mut Links,
        builder: &mut MessageBuilder<'_>,
    ) -> Emitted {
        let (history, entity) = (sending.history, self.guid.entity);
        let fragment_size = links.fragment_size(link);
        while let Some(first) = self.repair.first().map(SequenceNumber) {
            let Some(entry) = history.get(first).filter(|entry| self.is_due(entry)) else {
                if !self.emit_repair_gap(first, next, sending, builder) {
                    return Emitted::More;
                }
                continue;
            };
            let sent =
                self.repaired_fragments.filter(|(number, _)| *number == first).map_or(0, |(_, sent)| sent);
            let part = Part::of(entry, fragment_size, sent + 1);
            if !part.fits(entry, builder) {
                return Emitted::More;
            }
            if !links.may_send(link, sending.now, Load::of(entry), part.len(entry)) {
                return Emitted::Blocked;
            }
            part.emit(entry, entity, sending.writer, builder);
            if part.is_last(entry) {
                self.repair.remove(first.0..first.0 + 1);
                self.repaired_fragments = None;
                self.heartbeat = self.is_reliable;
            } else {
                self.repaired_fragments = Some((first, sent + 1));
            }
        }
        self.repaired_fragments = None;
        while let Some((number, missing)) = self.fragments.first().copied() {
            let entry = history.get(number).filter(|entry| self.is_due(entry));
            let Some((entry, fragment)) = entry.zip(missing.iter().next()) else {
                self.fragments.remove(0);
                self.heartbeat = true;
                continue;
            };
            let part = Part::of(entry, fragment_size, fragment);
            if !part.fits(entry, builder) {
                return Emitted::More;
            }
            if !links.may_send(link, sending.now, Load::of(entry), part.len(entry)) {
                return Emitted::Blocked;
            }
            part.emit(entry, entity, sending.writer, builder);
            let mut rest = FragmentSet::new(fragment + 1);
            missing.iter().skip(1).all(|fragment| rest.insert(fragment));
            self.fragments[0].1 = rest;
        }
        Emitted::Done
    }

    /// Whether the sample is for this reader.
    pub fn is_due(&self, entry: &Entry) -> bool {
        entry.number >= self.start && entry.only_to.is_none_or(|only| only == self.guid)
    }

    /// Says what becomes of the requests from `first` on that are for samples which will not come; `false` if that does not
    /// fit.
    pub fn emit_repair_gap(
        &mut self,
        first: SequenceNumber,
        next: SequenceNumber,
        sending: &Sending<'_>,
        builder: &mut MessageBuilder<'_>,
    ) -> bool {
        let history = sending.history;
        if first >= self.start && first < history.first() {
            // It gave way to newer ones. The heartbeat that says so counts as a loss at the reader, a gap would not.
            self.repair.remove(0..history.first().0);
            self.heartbeat = true;
            return true;
        }
        let mut end = self.start.max(first.next());
        while end < next && history.get(end).is_none_or(|entry| !self.is_due(entry)) && end > history.first()
        {
            end = history.at_or_after(end.next());
        }
        let end = end.min(next.max(first.next()));
        let gap = Gap {
            reader: self.guid.entity,
            writer: sending.writer,
            start: first,
            list: SequenceNumberSet::new(end),
        };
        if !builder.gap(&gap) {
            return false;
        }
        self.repair.remove(first.0..end.0);
        self.heartbeat = self.is_reliable;
        true
    }

    /// Tells the reader what was not for it before it gets `number`; `false` if that does not fit.
    pub fn emit_gap_before(
        &mut self,
        number: SequenceNumber,
        writer: EntityId,
        builder: &mut MessageBuilder<'_>,
    ) -> bool {
        let Some(start) = self.gap_from else { return true };
        let list = SequenceNumberSet::new(number);
        let is_said = builder.gap(&Gap { reader: self.guid.entity, writer, start, list });
        if is_said {
            self.gap_from = None;
        }
        is_said
    }
}
