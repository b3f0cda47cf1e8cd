//! The state of a reader for one matched writer: received, waiting and missing samples.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use bytes::Bytes;

use crate::wire::{
    AckNack, DataFragment, EntityId, FragmentSet, Gap, Guid, Heartbeat, HeartbeatFragment, MessageBuilder,
    NackFragment, SequenceNumber, SequenceNumberSet, Timestamp, VendorId,
};

use super::Now;

use super::assembly::Assembly;
use super::belief::Belief;
use super::count::LastCount;
use super::intervals::Intervals;
use super::links::LinkId;
use super::received::{Received, Sample};

/// Delay before a writer is asked for a first heartbeat. It doubles each time.
const FIRST_QUESTION: Duration = Duration::from_millis(10);
const QUESTION_MAX: Duration = Duration::from_secs(3);
/// Samples are not requested again within this time.
const NACK_PAUSE: Duration = Duration::from_millis(10);
/// How far ahead of the next sample to be delivered other samples are stored.
const MAX_AHEAD: i64 = 1024;
/// The most holes in the received samples.
const MAX_RUNS: usize = 600;
/// The most incomplete samples of a reliable and of a best-effort writer.
const MAX_OPEN_RELIABLE: usize = 64;
const MAX_OPEN_BEST_EFFORT: usize = 4;
/// The most samples for which fragments are requested at once.
const MAX_FRAGMENT_NACKS: usize = 8;

/// A writer that is matched with the reader.
#[derive(Debug, Clone, Copy)]
pub struct MatchedWriter {
    pub guid: Guid,
    /// Whether both are reliable.
    pub is_reliable: bool,
    /// How long its samples are valid.
    pub lifespan: Option<Duration>,
    /// How long it is considered alive without an assertion.
    pub liveliness_lease: Option<Duration>,
    /// The link for acknowledgements.
    pub link: LinkId,
    pub numbers: Numbers,
    /// The vendor of the writer. Writers of this engine also receive acknowledgements of fragments.
    pub vendor: VendorId,
}

/// What the numbers in messages of a writer prove.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Numbers {
    /// Nothing: anybody can send messages in its name. Those that it insists on are believed.
    Doubtful,
    /// Its messages are protected, but may be old ones that somebody sends again: numbers only rise.
    Proven,
    /// Samples are taken whatever their numbers are: what they contain proves itself.
    Irrelevant,
}

/// The state of one matched writer.
#[derive(Debug)]
pub(super) struct Incoming {
    pub matched: MatchedWriter,
    /// The next sample to be delivered. All samples before it have been delivered or given up.
    next: SequenceNumber,
    /// The number after the last delivered sample. The numbers from here to `next` were given up on the word
    /// of a HEARTBEAT or GAP, which may be forged.
    floor: SequenceNumber,
    /// `floor` before the writer claimed to be far ahead.
    before_jump: Option<SequenceNumber>,
    belief: Belief,
    /// Whether the writer has sent a sample or knows this reader. Before that no samples count as lost.
    is_known: bool,
    /// Numbers above `next` that were received or will not arrive.
    settled: Intervals,
    /// Received samples above `next`.
    waiting: BTreeMap<SequenceNumber, Sample>,
    assemblies: BTreeMap<SequenceNumber, Assembly>,
    /// Bytes in `waiting` and `assemblies`.
    pub size: usize,
    /// The newest sample that the writer has announced.
    last: SequenceNumber,
    last_heartbeat: LastCount,
    last_heartbeat_fragment: LastCount,
    /// Counts of the messages to the writer.
    ack_nacks: u32,
    nack_fragments: u32,
    /// When the writer will be asked for a heartbeat, and the delay before the next request.
    question: Option<(Instant, Duration)>,
    /// The kind of the next answer to the writer.
    answer: Answer,
    /// What was requested last, and when.
    asked: Option<(Progress, Instant)>,
    /// When missing samples will be requested again.
    ask_at: Option<Instant>,
    /// The sample whose fragments are to be acknowledged, and the last fragment that the writer has sent.
    fragments_sent: Option<(SequenceNumber, u32)>,
    /// Whether the writer was asserted within its lease. False until the first assertion; no event is
    /// reported before that.
    is_alive: bool,
    /// When the writer was last known to be alive.
    asserted: Instant,
}

/// The next sample to be delivered and the number of its received fragments. Unchanged as long as a request
/// is unanswered.
type Progress = (SequenceNumber, u32);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Answer {
    None,
    /// A request for a heartbeat.
    Question,
    /// An acknowledgement of received samples and a request for missing ones.
    Acknowledgement,
}

impl Incoming {
    pub fn new(matched: MatchedWriter, now: Instant) -> Self {
        Self {
            matched,
            next: SequenceNumber::FIRST,
            floor: SequenceNumber::FIRST,
            before_jump: None,
            belief: Belief::default(),
            is_known: false,
            settled: Intervals::default(),
            waiting: BTreeMap::new(),
            assemblies: BTreeMap::new(),
            size: 0,
            last: SequenceNumber::ZERO,
            last_heartbeat: LastCount::default(),
            last_heartbeat_fragment: LastCount::default(),
            ack_nacks: 0,
            nack_fragments: 0,
            question: matched.is_reliable.then_some((now + FIRST_QUESTION, FIRST_QUESTION)),
            answer: Answer::None,
            asked: None,
            ask_at: None,
            fragments_sent: None,
            is_alive: false,
            asserted: now,
        }
    }

    /// Returns whether the sample `number` is neither delivered nor received nor given up. Asks a reliable
    /// writer for a heartbeat if it was given up. Updates what is believed about the numbers of a best-effort
    /// writer, which sends no heartbeats.
    pub fn wants(&mut self, number: SequenceNumber, written: Option<Timestamp>, now: Instant) -> bool {
        if self.matched.is_reliable {
            if (self.floor..self.next).contains(&number) && self.question.is_none() {
                self.question = Some((now + FIRST_QUESTION, FIRST_QUESTION));
            }
            let is_wanted = self.is_wanted(number);
            if is_wanted {
                self.belief.trust();
            }
            return is_wanted;
        }
        if self.matched.numbers == Numbers::Irrelevant {
            return true;
        }
        if number >= self.floor {
            self.belief.trust();
            return self.belief.believes(number.0, now) && !self.settled.contains(number.0);
        }
        let is_wrong =
            self.matched.numbers == Numbers::Doubtful && self.belief.doubt_order(number.0, written, now);
        if is_wrong {
            self.go_back(number, number, now);
        }
        is_wrong
    }

    fn is_wanted(&self, number: SequenceNumber) -> bool {
        number >= self.next && number.0 - self.next.0 < MAX_AHEAD && !self.settled.contains(number.0)
    }

    /// Takes a wanted sample. If it has to wait and is larger than `room`, it is dropped and will be
    /// requested again.
    pub fn take_sample(&mut self, now: Now, sample: Sample, room: usize, out: &mut Vec<Received>) {
        let number = sample.number;
        if !self.matched.is_reliable && number < self.next {
            // Given up on the word of a GAP.
            self.deliver(now, sample, out);
        } else if !self.matched.is_reliable {
            self.lose_before(number, out);
            self.deliver(now, sample, out);
            self.advance(now, number.next(), out);
        } else if number == self.next {
            self.deliver(now, sample, out);
            self.advance(now, number.next(), out);
        } else if sample.payload.len() <= room && self.settled.runs() < MAX_RUNS {
            self.size += sample.payload.len();
            self.settled.insert(number.0..number.0 + 1);
            self.waiting.insert(number, sample);
        }
    }

    /// Takes fragments of a wanted sample, as far as they fit into `room`.
    pub fn take_fragment(
        &mut self,
        now: Now,
        timestamp: Option<Timestamp>,
        fragment: &DataFragment<'_>,
        room: usize,
        out: &mut Vec<Received>,
    ) {
        let number = fragment.number;
        if self.assemblies.get(&number).is_some_and(|assembly| !assembly.fits(fragment)) {
            self.drop_assembly(number);
        }
        if !self.assemblies.contains_key(&number) && !self.open_assembly(number, fragment, timestamp, room) {
            return;
        }
        let Some(assembly) = self.assemblies.get_mut(&number) else { return };
        let size = assembly.size();
        // The next sample is always accepted; otherwise nothing could be delivered.
        if number == self.next || assembly.size_with(fragment) - size <= room {
            assembly.add(fragment);
        }
        self.size += assembly.size() - size;
        if assembly.is_complete()
            && let Some(assembly) = self.drop_assembly(number)
        {
            let sample = Sample {
                writer: self.matched.guid,
                number,
                source_timestamp: assembly.timestamp,
                inline_qos: assembly.inline_qos,
                is_key: assembly.is_key,
                payload: Bytes::from(assembly.into_bytes()),
            };
            self.take_sample(now, sample, room, out);
        }
    }

    /// Gives up a wanted sample that exceeds the limit of the reader.
    pub fn refuse(&mut self, now: Now, number: SequenceNumber, out: &mut Vec<Received>) {
        self.drop_assembly(number);
        out.push(Received::Lost { writer: self.matched.guid, count: 1 });
        self.settle(number.0..number.0 + 1);
        self.advance(now, self.next, out);
        if number < self.next {
            // It did arrive.
            self.floor = self.floor.max(number.next());
        }
    }

    /// Handles samples that will not arrive because they are not for this reader. A GAP beyond what the
    /// writer can have written is ignored; the writer repeats a true one, because what it covers stays
    /// missing.
    pub fn take_gap(&mut self, now: Now, gap: &Gap, out: &mut Vec<Received>) {
        let end = gap.list.iter().last().map_or(gap.list.base(), SequenceNumber::next);
        if self.belief.is_far(end.0, now.steady) {
            return;
        }
        self.settle(gap.start.0..gap.list.base().0);
        for number in gap.list.iter() {
            self.settle(number.0..number.0 + 1);
        }
        self.advance(now, self.next, out);
    }

    /// Handles a heartbeat. Returns whether there is something to send.
    pub fn take_heartbeat(&mut self, now: Now, heartbeat: &Heartbeat, out: &mut Vec<Received>) -> bool {
        if !self.matched.is_reliable || !self.last_heartbeat.accept(heartbeat.count, now.steady) {
            return false;
        }
        let is_far = self.belief.is_far(heartbeat.last.0, now.steady);
        if !self.belief.believes(heartbeat.last.0, now.steady) {
            self.ask_now(now.steady);
            return true;
        }
        if is_far {
            self.before_jump.get_or_insert(self.floor);
        }
        if heartbeat.last.next() >= self.next {
            self.belief.trust();
        } else if self.matched.numbers == Numbers::Doubtful && self.belief.doubt(now.steady) {
            let floor = self.before_jump.take().unwrap_or(self.floor);
            self.go_back(floor.min(heartbeat.last.next()), heartbeat.last, now.steady);
        } else {
            self.ask_now(now.steady);
            return true;
        }
        self.question = None;
        self.last = heartbeat.last;
        if heartbeat.first > self.next {
            self.lose_before(heartbeat.first, out);
            self.advance(now, heartbeat.first, out);
        }
        // A heartbeat to all readers may have been sent before the writer knew this reader.
        self.is_known |= heartbeat.reader != EntityId::UNKNOWN;
        let is_due = !heartbeat.is_final || self.next <= self.last;
        if is_due {
            self.answer = Answer::Acknowledgement;
        }
        is_due
    }

    /// Asks the writer for a heartbeat, and again until it has answered.
    fn ask_now(&mut self, now: Instant) {
        if self.answer == Answer::None {
            self.answer = Answer::Question;
        }
        if self.question.is_none() {
            self.question = Some((now + FIRST_QUESTION, FIRST_QUESTION));
        }
    }

    /// Requests all samples of the writer again, as a new reader does. The counts of messages continue,
    /// because Fast DDS ignores lower ones.
    pub fn start_over(&mut self, now: Instant) {
        self.go_back(SequenceNumber::FIRST, self.last, now);
        self.answer = Answer::Question;
        self.question = Some((now + FIRST_QUESTION, FIRST_QUESTION));
    }

    /// Expects `next` again, after it turned out that the writer has only reached `last`.
    fn go_back(&mut self, next: SequenceNumber, last: SequenceNumber, now: Instant) {
        self.belief.go_back(last.0, now);
        (self.next, self.floor) = (next, next);
        self.settled.clear();
        self.waiting.clear();
        self.assemblies.clear();
        self.size = 0;
        self.asked = None;
    }

    /// Handles a heartbeat of fragments. Returns whether there is something to send.
    pub fn take_heartbeat_fragment(&mut self, now: Now, heartbeat: &HeartbeatFragment) -> bool {
        let is_news = self.last_heartbeat_fragment.accept(heartbeat.count, now.steady);
        if !self.matched.is_reliable || !is_news {
            return false;
        }
        // Other engines expect only requests, not acknowledgements.
        let is_complete = || match self.assemblies.get(&heartbeat.number) {
            Some(assembly) => assembly.missing(heartbeat.last).is_empty(),
            None => !self.is_wanted(heartbeat.number),
        };
        if self.matched.vendor != VendorId::OURS && is_complete() {
            return false;
        }
        self.fragments_sent = Some((heartbeat.number, heartbeat.last));
        true
    }

    /// Runs the timers that are due. Returns whether there is something to send.
    pub fn handle_timeout(&mut self, now: Instant) -> bool {
        if let Some((at, period)) = self.question.filter(|(at, _)| *at <= now) {
            let period = (2 * period).min(QUESTION_MAX);
            self.question = Some((at.max(now) + period, period));
            if self.answer == Answer::None {
                self.answer = Answer::Question;
            }
        }
        if self.ask_at.is_some_and(|at| at <= now) {
            self.ask_at = None;
            self.answer = Answer::Acknowledgement;
        }
        self.answer != Answer::None
    }

    /// Records that the writer is alive. Returns whether that is a change.
    pub fn assert_liveliness(&mut self, now: Instant) -> bool {
        self.asserted = now;
        let was_alive = std::mem::replace(&mut self.is_alive, true);
        !was_alive && self.matched.liveliness_lease.is_some()
    }

    /// When the writer will be considered not alive without an assertion; `None` if it is not alive or has no
    /// lease.
    pub fn lease_ends(&self) -> Option<Instant> {
        self.matched.liveliness_lease.filter(|_| self.is_alive).map(|lease| self.asserted + lease)
    }

    /// Considers the writer not alive if its lease has ended. Returns whether that is a change.
    pub fn run_out_lease(&mut self, now: Instant) -> bool {
        let is_over = self.lease_ends().is_some_and(|ends| ends <= now);
        self.is_alive &= !is_over;
        is_over
    }

    pub fn next_timeout(&self) -> Option<Instant> {
        [self.question.map(|(at, _)| at), self.ask_at].into_iter().flatten().min()
    }

    /// Writes the due answers. Returns `false` if they do not fit.
    pub fn emit(&mut self, now: Instant, reader: EntityId, builder: &mut MessageBuilder<'_>) -> bool {
        builder.info_destination(self.matched.guid.prefix);
        self.emit_fragments_sent(now, reader, builder) && self.emit_answer(now, reader, builder)
    }

    fn emit_answer(&mut self, now: Instant, reader: EntityId, builder: &mut MessageBuilder<'_>) -> bool {
        // Fast DDS answers a request for a heartbeat immediately only if its base is 0, and otherwise within
        // its heartbeat period of 3 s (`StatefulWriter::process_acknack`); other engines reject that base.
        let asks_from_zero = self.answer == Answer::Question && self.matched.vendor == VendorId::FAST_DDS;
        let base = match self.answer {
            _ if asks_from_zero => SequenceNumber::ZERO,
            Answer::Question => self.floor,
            _ => self.next,
        };
        let mut missing = SequenceNumberSet::new(base);
        let mut partial = Vec::new();
        if self.answer == Answer::None {
            return true;
        }
        if self.answer == Answer::Acknowledgement {
            let end = self.last.0.min(self.next.0 + i64::from(SequenceNumberSet::CAPACITY) - 1) + 1;
            for number in self.settled.absent(self.next.0..end).map(SequenceNumber) {
                match self.assemblies.get(&number) {
                    Some(assembly) if partial.len() < MAX_FRAGMENT_NACKS => {
                        partial.push((number, assembly.all_missing()));
                    }
                    Some(_) => {}
                    None => _ = missing.insert(number),
                }
            }
            if !missing.is_empty() || !partial.is_empty() {
                let progress = self.progress();
                if let Some((_, at)) =
                    self.asked.filter(|(asked, at)| *asked == progress && now < *at + NACK_PAUSE)
                {
                    self.ask_at = Some(at + NACK_PAUSE);
                    self.answer = Answer::None;
                    return true;
                }
                self.asked = Some((progress, now));
            }
        }
        let writer = self.matched.guid.entity;
        self.ack_nacks = self.ack_nacks.wrapping_add(1);
        let is_final = self.answer == Answer::Acknowledgement && missing.is_empty();
        if !builder.ack_nack(&AckNack { reader, writer, missing, count: self.ack_nacks, is_final }) {
            return false;
        }
        for (number, missing) in partial {
            self.nack_fragments = self.nack_fragments.wrapping_add(1);
            let nack = NackFragment { reader, writer, number, missing, count: self.nack_fragments };
            if !builder.nack_fragment(&nack) {
                // The rest is requested when the next request is due.
                self.ask_at = Some(now + NACK_PAUSE);
                break;
            }
        }
        self.answer = Answer::None;
        true
    }

    /// Acknowledges fragments of an incomplete sample and requests lost ones.
    fn emit_fragments_sent(
        &mut self,
        now: Instant,
        reader: EntityId,
        builder: &mut MessageBuilder<'_>,
    ) -> bool {
        let Some((number, last)) = self.fragments_sent else { return true };
        let mut missing = match self.assemblies.get(&number) {
            Some(assembly) => assembly.missing(last),
            None if self.is_wanted(number) => {
                let mut missing = FragmentSet::new(1);
                (1..=last).all(|fragment| missing.insert(fragment));
                missing
            }
            None => FragmentSet::new(last.saturating_add(1)),
        };
        if !missing.is_empty() {
            let progress = self.progress();
            match self.asked {
                Some((asked, at)) if asked == progress && now < at + NACK_PAUSE => {
                    missing = FragmentSet::new(missing.base());
                }
                _ => self.asked = Some((progress, now)),
            }
        }
        self.nack_fragments = self.nack_fragments.wrapping_add(1);
        let writer = self.matched.guid.entity;
        let nack = NackFragment { reader, writer, number, missing, count: self.nack_fragments };
        let is_written = builder.nack_fragment(&nack);
        if is_written {
            self.fragments_sent = None;
        }
        is_written
    }

    fn progress(&self) -> Progress {
        (self.next, self.assemblies.get(&self.next).map_or(0, |assembly| assembly.missing(u32::MAX).base()))
    }

    /// Counts samples before `number` as lost that are neither received nor irrelevant. For a writer without
    /// earlier messages, this begins with the first received sample.
    fn lose_before(&mut self, number: SequenceNumber, out: &mut Vec<Received>) {
        let first_waiting = || self.waiting.keys().next().copied().unwrap_or(number).min(number);
        let range = if self.is_known { self.next } else { first_waiting() }.0..number.0;
        let lost = range.end.abs_diff(range.start) - self.settled.count_in(range);
        if lost > 0 {
            out.push(Received::Lost { writer: self.matched.guid, count: lost });
        }
    }

    /// Marks numbers that will not arrive.
    fn settle(&mut self, range: std::ops::Range<i64>) {
        if range.start <= self.next.0 {
            self.next.0 = self.next.0.max(range.end);
        } else if range.start - self.next.0 < MAX_AHEAD && self.settled.runs() < MAX_RUNS {
            self.settled.insert(range);
        }
    }

    /// Advances to `next` or further and delivers samples that waited for it.
    fn advance(&mut self, now: Now, next: SequenceNumber, out: &mut Vec<Received>) {
        self.next = next;
        if !self.settled.is_empty() {
            self.next = SequenceNumber(self.settled.first_absent(next.0));
            self.settled.remove(0..self.next.0);
        }
        while let Some(entry) = self.waiting.first_entry().filter(|entry| *entry.key() < self.next) {
            let sample = entry.remove();
            self.size -= sample.payload.len();
            self.deliver(now, sample, out);
        }
        while let Some(number) = self.assemblies.keys().next().copied().filter(|number| *number < self.next) {
            self.drop_assembly(number);
        }
    }

    fn deliver(&mut self, now: Now, sample: Sample, out: &mut Vec<Received>) {
        self.is_known = true;
        self.floor = sample.number.next();
        let is_expired = self.matched.lifespan.zip(sample.source_timestamp).is_some_and(|(span, stamp)| {
            let age = now.wall_ns.saturating_sub(stamp.to_nanos());
            u128::try_from(age).is_ok_and(|age| age > span.as_nanos())
        });
        if !is_expired {
            out.push(Received::Sample(sample));
        }
    }

    /// Begins to assemble a sample. Returns `false` if there is no room for it.
    fn open_assembly(
        &mut self,
        number: SequenceNumber,
        fragment: &DataFragment<'_>,
        timestamp: Option<Timestamp>,
        room: usize,
    ) -> bool {
        let max_open = if self.matched.is_reliable { MAX_OPEN_RELIABLE } else { MAX_OPEN_BEST_EFFORT };
        let is_crowded = self.assemblies.len() >= max_open || fragment.payload.len() > room;
        if is_crowded && self.matched.is_reliable && number != self.next {
            return false;
        }
        if self.assemblies.len() >= max_open {
            // The next sample of a reliable writer has priority; for a best-effort writer, the newest.
            let other = match self.matched.is_reliable {
                true => self.assemblies.keys().next_back().copied(),
                false => self.assemblies.keys().next().copied().filter(|other| *other < number),
            };
            if other.and_then(|other| self.drop_assembly(other)).is_none() {
                return false;
            }
        }
        self.assemblies.insert(number, Assembly::new(fragment, timestamp));
        true
    }

    fn drop_assembly(&mut self, number: SequenceNumber) -> Option<Assembly> {
        let assembly = self.assemblies.remove(&number)?;
        self.size -= assembly.size();
        Some(assembly)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::protocol::Destination;
    use crate::protocol::links::{LinkOptions, Links};
    use crate::wire::{GuidPrefix, Header, Submessage, parse};

    /// The base of a request for the first heartbeat of a writer of this vendor.
    fn base_of_first_question(vendor: VendorId) -> SequenceNumber {
        let link = Links::new().open(LinkOptions {
            destination: Destination::Own,
            peer: GuidPrefix([1; 12]),
            max_datagram: 65_000,
            fragment_size: 64_000,
            receive_buffer: None,
        });
        let matched = MatchedWriter {
            guid: Guid::new(GuidPrefix([1; 12]), EntityId::user_writer(1)),
            is_reliable: true,
            lifespan: None,
            liveliness_lease: None,
            link,
            numbers: Numbers::Doubtful,
            vendor,
        };
        let start = Instant::now();
        let mut incoming = Incoming::new(matched, start);
        assert!(!incoming.handle_timeout(start));
        assert!(incoming.handle_timeout(start + FIRST_QUESTION));
        let mut datagram = Vec::new();
        let mut builder = MessageBuilder::new(&mut datagram, 1000, Header::ours(GuidPrefix([2; 12])));
        assert!(incoming.emit(start + FIRST_QUESTION, EntityId::user_reader(1), &mut builder));
        let (_, mut submessages) = parse(&datagram).unwrap();
        let found = submessages.find_map(|submessage| match submessage.unwrap() {
            Submessage::AckNack(ack_nack) => Some(ack_nack),
            _ => None,
        });
        let ack_nack = found.unwrap();
        assert!(ack_nack.missing.is_empty() && !ack_nack.is_final);
        ack_nack.missing.base()
    }

    #[test]
    fn fast_dds_gets_the_heartbeat_request_that_it_expects() {
        assert_eq!(base_of_first_question(VendorId::FAST_DDS), SequenceNumber::ZERO);
        for other in [VendorId::CYCLONE, VendorId::RUSTDDS, VendorId::OURS] {
            assert_eq!(base_of_first_question(other), SequenceNumber::FIRST);
        }
    }
}
