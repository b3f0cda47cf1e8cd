//! The state of a writer for one matched reader: acknowledged samples, and samples to be sent again.

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
    /// The link to the reader.
    pub link: LinkId,
}

/// State that all lanes of a writer share while they send.
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
    /// The acknowledged position in the stream, including parts of a sample. At least the sent position at
    /// the time of the match, so that sending the history does not use the window.
    pub position: u64,
    /// The sent position in the stream at the time of the match.
    pub matched_position: u64,
    /// The next sample to be sent at the time of the match.
    pub matched_next: SequenceNumber,
    /// Samples to be sent again, and the number of fragments of the first one that were already sent again.
    pub repair: Intervals,
    pub repaired_fragments: Option<(SequenceNumber, u32)>,
    /// Fragments to be sent again.
    pub fragments: Vec<(SequenceNumber, FragmentSet)>,
    /// The first of consecutive samples that were not for this reader and for which it has not received a GAP
    /// yet.
    pub gap_from: Option<SequenceNumber>,
    /// A heartbeat to this reader is due.
    pub heartbeat: bool,
    /// Whether the reader has acknowledged anything, so that it knows the writer. Until then heartbeats are
    /// repeated.
    pub has_answered: bool,
    /// Whether the reader has acknowledged a sample since it last began anew.
    pub has_acknowledged: bool,
    pub last_ack_nack: LastCount,
    pub last_nack_fragment: LastCount,
}

impl Outgoing {
    /// Returns whether the reader has yet to acknowledge something, at least its match.
    pub fn is_behind(&self, history: &History) -> bool {
        self.is_reliable && (!self.has_answered || self.acknowledged < history.next())
    }

    /// Returns whether the reader has yet to acknowledge the sample `number`.
    pub fn lacks(&self, number: SequenceNumber) -> bool {
        self.is_reliable && self.acknowledged <= number
    }

    /// Sets the first sample for the reader: the newest samples if it wants the history, otherwise those that
    /// it has not acknowledged.
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
            return self.retract(base, history);
        }
        self.acknowledged = base;
        self.position = self.position.max(history.position(base));
        self.repair.remove(0..base.0);
        self.fragments.retain(|(number, _)| *number >= base);
    }

    /// Handles an acknowledgement that lacks samples which an earlier one included: that one was forged. What
    /// is left of them is offered again.
    fn retract(&mut self, base: SequenceNumber, history: &History) {
        let mut number = history.at_or_after(base);
        while number < self.acknowledged {
            if history.get(number).is_some_and(|entry| self.is_due(entry)) {
                self.acknowledged = number;
                return;
            }
            number = history.at_or_after(number.next());
        }
    }

    /// Records samples to be sent again. Returns whether some were lost in the network.
    pub fn request(&mut self, missing: &SequenceNumberSet, next: SequenceNumber) -> bool {
        self.repair.clear();
        // A sample that is being sent again stays in the list, even if the reader now requests its fragments.
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

    /// Writes samples that were requested again.
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

    /// Returns whether the sample is for this reader.
    pub fn is_due(&self, entry: &Entry) -> bool {
        entry.number >= self.start && entry.only_to.is_none_or(|only| only == self.guid)
    }

    /// Answers requests from `first` on for samples that are not available. Returns `false` if the answer
    /// does not fit.
    pub fn emit_repair_gap(
        &mut self,
        first: SequenceNumber,
        next: SequenceNumber,
        sending: &Sending<'_>,
        builder: &mut MessageBuilder<'_>,
    ) -> bool {
        let history = sending.history;
        if first >= self.start && first < history.first() {
            // Replaced by newer samples. The reader counts them as lost with the next heartbeat, which it
            // would not do for a GAP.
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

    /// Writes a GAP for samples before `number` that are not for this reader. Returns `false` if it does not
    /// fit.
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
