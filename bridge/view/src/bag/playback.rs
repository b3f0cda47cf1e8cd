//! The thread that plays bags to viewers.

use super::{BagSource, Request};
use crate::outbox::Frame;
use crate::protocol::{
    Level, PlaybackCommand, PlaybackControl, PlaybackStatus, playback_state, status, time,
};
use crate::shared::Shared;
use downbeat_bags::{
    BagMessage, MergedBags, Playback, PlayerError, Rate, ReaderError, Selection, Step, TopicId,
};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, Instant};

/// Messages that are sent before requests are served.
const BATCH: usize = 256;

/// How often viewers are sent the time of the bags while they are played.
const TIME: Duration = Duration::from_millis(50);

/// A paused thread looks for nothing.
const IDLE: Duration = Duration::from_secs(3600);

/// The rates that viewers may choose, as in the examples of Foxglove's SDK.
const SLOWEST: f32 = 0.01;
const FASTEST: f32 = 100.0;

/// Different faults of which viewers are told.
const MOST_FAULTS: usize = 100;

type Reading = Box<dyn Iterator<Item = Result<BagMessage, ReaderError>>>;

/// Plays until it is stopped.
pub(crate) fn play(shared: &Shared, bag: &BagSource) -> Result<(), PlayerError> {
    let Some(requests) = bag.received.lock().take() else { return Ok(()) };
    let begin =
        bag.start.saturating_add(i64::try_from(bag.playback.start_offset.as_nanos()).unwrap_or(i64::MAX));
    let mut player = Player {
        shared,
        bag,
        bags: bag.merged()?,
        read: BTreeSet::new(),
        playback: Playback::new(Box::new(std::iter::empty()), begin, bag.playback.rate),
        position: Position { time: begin, sent: Sent::All },
        status: PlaybackStatus::Paused,
        waits_for_viewer: !bag.playback.starts_paused,
        is_late: false,
        owes_last: false,
        origin: Instant::now(),
        faults: BTreeSet::new(),
    };
    player.playback.pause(Duration::ZERO);
    let mut last_time = Instant::now();
    loop {
        let wait = player.send_due();
        if player.status == PlaybackStatus::Playing && last_time.elapsed() >= TIME {
            last_time = Instant::now();
            player.send_time();
        }
        let first = match requests.recv_timeout(wait) {
            Ok(request) => request,
            Err(RecvTimeoutError::Timeout) => continue,
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
        };
        let mut new = Vec::new();
        let mut is_changed = false;
        for request in std::iter::once(first).chain(requests.try_iter()) {
            match request {
                Request::Control(control) => player.control(&control),
                Request::Subscribed { position, client, subscription } => {
                    new.push((position, client, subscription))
                }
                Request::Unsubscribed => is_changed = true,
                Request::Joined(client) => player.greet(client),
                Request::Stop => return Ok(()),
            }
        }
        if is_changed || !new.is_empty() {
            player.read_subscribed();
        }
        player.send_last(&new);
    }
}

struct Player<'a> {
    shared: &'a Shared,
    bag: &'a BagSource,
    bags: MergedBags<'a>,
    /// The topics that are read: those with subscribers.
    read: BTreeSet<TopicId>,
    playback: Playback<Reading>,
    position: Position,
    status: PlaybackStatus,
    waits_for_viewer: bool,
    /// True if messages are due that were not sent yet.
    is_late: bool,
    /// True if the last messages before the position must be sent to all subscribers.
    owes_last: bool,
    origin: Instant,
    /// Of which viewers were told.
    faults: BTreeSet<String>,
}

/// Where playback is: all messages before `time` were sent.
struct Position {
    time: i64,
    sent: Sent,
}

/// Which messages at the time of the position were sent.
enum Sent {
    All,
    /// So many of each topic.
    Some(BTreeMap<TopicId, usize>),
}

impl Player<'_> {
    fn now(&self) -> Duration {
        self.origin.elapsed()
    }

    /// Sends messages that are due. Returns how long none is.
    fn send_due(&mut self) -> Duration {
        for _ in 0..BATCH {
            match self.playback.step(self.now()) {
                Step::Due(message) => self.send(&message),
                Step::Failed(error) => self.tell(&error.to_string()),
                Step::Wait(wait) => {
                    self.is_late = false;
                    return wait.min(TIME);
                }
                Step::Skipped(_) => {}
                Step::Paused => return IDLE,
                Step::Finished | Step::Repeats => {
                    self.is_late = false;
                    return self.wait_for_end();
                }
            }
        }
        self.is_late = true;
        Duration::ZERO
    }

    fn send(&mut self, message: &BagMessage) {
        let BagMessage { topic, log_time, ref data, .. } = *message;
        if log_time > self.position.time {
            self.position = Position { time: log_time, sent: Sent::Some(BTreeMap::new()) };
        }
        if let Sent::Some(sent) = &mut self.position.sent {
            *sent.entry(topic).or_default() += 1;
        }
        if let Some(channel) = self.bag.channels.get(topic.index()) {
            channel.feed.send(unsigned(log_time), data);
        }
    }

    /// After the last message of the subscribed topics: the time goes on to the last message of all.
    fn wait_for_end(&mut self) -> Duration {
        let now = self.now();
        let left = self.bag.end.saturating_sub(self.playback.bag_time(now));
        if left > 0 {
            let left =
                Duration::from_nanos(left.unsigned_abs()).as_secs_f64() / self.playback.rate().as_f64();
            return Duration::try_from_secs_f64(left).unwrap_or(TIME).min(TIME);
        }
        let begin = self.begin();
        if self.bag.playback.repeats && begin < self.bag.end {
            self.seek(begin);
            self.send_state(true, "");
            self.send_last(&[]);
            return Duration::ZERO;
        }
        self.playback.pause(now);
        self.position = Position { time: self.bag.end, sent: Sent::All };
        self.status = PlaybackStatus::Ended;
        self.send_state(false, "");
        self.send_time();
        IDLE
    }

    fn begin(&self) -> i64 {
        let offset = i64::try_from(self.bag.playback.start_offset.as_nanos()).unwrap_or(i64::MAX);
        self.bag.start.saturating_add(offset)
    }

    /// The time of the bags that viewers show.
    fn time(&self) -> i64 {
        let time = if self.is_late { self.position.time } else { self.playback.bag_time(self.now()) };
        time.clamp(self.bag.start, self.bag.end)
    }

    fn control(&mut self, control: &PlaybackControl) {
        self.waits_for_viewer = false;
        let now = self.now();
        let rate = if control.rate.is_nan() { 1.0 } else { control.rate.clamp(SLOWEST, FASTEST) };
        if let Ok(rate) = Rate::new(f64::from(rate))
            && rate != self.playback.rate()
        {
            self.playback.set_rate(now, rate);
        }
        if let Some(time) = control.seek_ns {
            self.seek(i64::try_from(time).unwrap_or(i64::MAX));
        }
        match control.command {
            // At the end, a viewer has to seek first.
            _ if self.status == PlaybackStatus::Ended => {}
            PlaybackCommand::Play => {
                self.playback.resume(now);
                self.status = PlaybackStatus::Playing;
            }
            PlaybackCommand::Pause => {
                self.playback.pause(now);
                self.status = PlaybackStatus::Paused;
            }
        }
        self.send_state(control.seek_ns.is_some(), &control.request_id);
        self.send_time();
    }

    /// Goes to that time. The last messages before it are owed to all subscribers.
    fn seek(&mut self, time: i64) {
        let time = time.clamp(self.bag.start, self.bag.end);
        // What waits belongs to the time before.
        self.shared.for_each_client(|client| {
            client.outbox.clear_messages();
            None
        });
        if self.status == PlaybackStatus::Ended {
            self.status = PlaybackStatus::Paused;
        }
        self.position = Position { time, sent: Sent::All };
        self.is_late = false;
        self.owes_last = true;
        self.read_from(time);
    }

    /// Reads the topics that have subscribers now.
    fn read_subscribed(&mut self) {
        let channels = self.bag.channels.iter().enumerate();
        let wanted = channels.filter(|(_, channel)| channel.feed.is_wanted());
        let wanted: BTreeSet<_> = wanted.filter_map(|(position, _)| TopicId::at(position)).collect();
        if wanted == self.read {
            return;
        }
        if let Sent::Some(sent) = &mut self.position.sent {
            // Their last messages up to the position are sent separately.
            sent.extend(wanted.difference(&self.read).map(|topic| (*topic, usize::MAX)));
        }
        self.read = wanted;
        self.read_from(self.playback.bag_time(self.now()));
    }

    /// Continues with what follows the position, at that time of the bags.
    fn read_from(&mut self, time: i64) {
        let Position { time: sent_until, ref sent } = self.position;
        let (from, mut sent) = match sent {
            Sent::All => (sent_until.saturating_add(1), BTreeMap::new()),
            Sent::Some(sent) => (sent_until, sent.clone()),
        };
        let is_new = move |message: &Result<BagMessage, ReaderError>| match message {
            Ok(message) if message.log_time == sent_until => match sent.get_mut(&message.topic) {
                Some(count) if *count > 0 => {
                    *count -= 1;
                    false
                }
                _ => true,
            },
            _ => true,
        };
        let (names, topics) = (self.bags.topics(), &self.read);
        let is_read = |topic: &downbeat_bags::RecordedTopic| {
            topics
                .iter()
                .any(|id| names.get(id.index()).is_some_and(|read| read.info.name == topic.info.name))
        };
        let reading: Reading = match self.bags.messages(&Selection::all().from(from), is_read) {
            Ok(messages) => Box::new(messages.filter({
                let mut is_new = is_new;
                move |message| is_new(message)
            })),
            Err(error) => {
                self.tell(&error.to_string());
                Box::new(std::iter::empty())
            }
        };
        self.playback = Playback::new(reading, time, self.playback.rate());
        if self.status != PlaybackStatus::Playing {
            self.playback.pause(self.now());
        }
    }

    /// Sends the last messages before the position to new subscribers, given by position of the channel,
    /// viewer and subscription, or to all if they are owed.
    fn send_last(&mut self, new: &[(usize, u64, u32)]) {
        let owes_all = std::mem::take(&mut self.owes_last);
        let of_new = new.iter().filter_map(|(position, ..)| TopicId::at(*position));
        let topics: BTreeSet<_> = if owes_all { self.read.clone() } else { of_new.collect() };
        if topics.is_empty() {
            return;
        }
        let kept = |topic: &TopicId| self.bag.channels.get(topic.index()).map_or(1, |channel| channel.kept);
        let wanted = topics.iter().map(|topic| (*topic, kept(topic))).collect();
        let (last, unreadable) = match self.bags.last_messages(self.position.time, &wanted) {
            Ok(found) => found,
            Err(error) => return self.tell(&error.to_string()),
        };
        for message in last {
            let Some(channel) = self.bag.channels.get(message.topic.index()) else { continue };
            let time_ns = unsigned(message.log_time);
            if owes_all {
                channel.feed.send(time_ns, &message.data);
                continue;
            }
            for (_, client, subscription) in
                new.iter().filter(|(position, ..)| *position == message.topic.index())
            {
                channel.feed.send_to(*client, *subscription, time_ns, &message.data);
            }
        }
        unreadable.iter().for_each(|error| self.tell(&error.to_string()));
    }

    fn greet(&mut self, client: u64) {
        if std::mem::take(&mut self.waits_for_viewer) {
            self.playback.resume(self.now());
            self.status = PlaybackStatus::Playing;
        }
        let time_ns = unsigned(self.time());
        let state = playback_state(self.status, time_ns, self.rate(), false, "");
        let faults: Vec<_> = self.bag.losses.iter().chain(&self.faults).cloned().collect();
        self.shared.for_each_client(|other| {
            if other.id != client {
                return None;
            }
            // If there is no room the viewer is disconnected with the next announcement.
            for text in &faults {
                let _ = other.outbox.announce(Frame::Text(status(Level::Warning, text)));
            }
            if other.knows_playback {
                let _ = other.outbox.announce(Frame::Binary(state.clone()));
            }
            Some(Frame::Binary(time(time_ns)))
        });
    }

    fn rate(&self) -> f32 {
        self.playback.rate().as_f64() as f32
    }

    fn send_state(&self, did_seek: bool, request_id: &str) {
        let frame = playback_state(self.status, unsigned(self.time()), self.rate(), did_seek, request_id);
        self.shared.for_each_client(|client| client.knows_playback.then(|| Frame::Binary(frame.clone())));
    }

    fn send_time(&self) {
        let frame = time(unsigned(self.time()));
        self.shared.for_each_client(|_| Some(Frame::Binary(frame.clone())));
    }

    /// Reports a fault once.
    fn tell(&mut self, fault: &str) {
        if self.faults.len() < MOST_FAULTS && self.faults.insert(fault.to_owned()) {
            tracing::warn!("{fault}");
            let text = status(Level::Warning, fault);
            self.shared.for_each_client(|_| Some(Frame::Text(text.clone())));
        }
    }
}

/// Times before 1970 occur only in damaged files.
fn unsigned(time: i64) -> u64 {
    u64::try_from(time).unwrap_or(0)
}
