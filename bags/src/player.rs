//! Plays bags with all runtime controls of `ros2 bag play`.
//!
//! Nothing here reads a clock or waits; see [`Playback`].

use std::collections::VecDeque;
use std::path::PathBuf;
use std::time::Duration;

use crate::edit::MergedBags;
use crate::playback::{Gap, Playback, PlayerError, Rate, Step};
use crate::read_ahead::{AheadOf, ReadAhead};
use crate::reader::{BagMessage, Reader, ReaderError, RecordedTopic, Selection};
use crate::topic::TopicDescription;
use crate::writer::FileSplit;

/// What to play and how.
#[derive(Clone, Debug, PartialEq)]
pub struct PlayerOptions {
    /// How fast.
    pub rate: Rate,
    /// The offset into the bags at which to start.
    pub start_offset: Duration,
    /// The last time to play, in nanoseconds since the epoch.
    pub until: Option<i64>,
    /// How long to play from the start, in bag time. With `until`, the later of both ends playback, as in
    /// rosbag2.
    pub duration: Option<Duration>,
    /// Whether to start again at the end.
    pub repeats: bool,
    /// Whether to wait for [`Player::resume`] first.
    pub starts_paused: bool,
    /// Whether to first play the last messages of latched (transient local) topics before the start, which a
    /// subscriber joining then would have received.
    pub plays_latched: bool,
    /// Whether to continue at once after a [`Gap`] between messages.
    pub skips_gaps: bool,
    /// How many messages are read before they are due.
    pub read_ahead: usize,
}

impl PlayerOptions {
    /// The default of `ros2 bag play`.
    pub const DEFAULT_READ_AHEAD: usize = 1000;
}

impl Default for PlayerOptions {
    fn default() -> Self {
        Self {
            rate: Rate::ORIGINAL,
            start_offset: Duration::ZERO,
            until: None,
            duration: None,
            repeats: false,
            starts_paused: false,
            plays_latched: true,
            skips_gaps: false,
            read_ahead: Self::DEFAULT_READ_AHEAD,
        }
    }
}

/// Plays one bag, or several merged by time.
pub struct Player<'a> {
    bags: MergedBags<'a>,
    /// The times of the first and the last message of the bags, the start of playback, and the last time to
    /// play.
    start: i64,
    last: i64,
    begin: i64,
    end: i64,
    repeats: bool,
    plays_latched: bool,
    latched: VecDeque<BagMessage>,
    /// All messages of latched topics, sorted by time, once they were read.
    all_latched: Option<Vec<BagMessage>>,
    playback: Playback<AheadOf>,
    read_ahead: ReadAhead,
    /// The number of messages returned since the last start: bags without messages do not repeat forever.
    given: u64,
    /// The files of each bag.
    files: Vec<Files>,
}

/// The files of a bag, and how many of them playback has reached.
struct Files {
    starts: Vec<(PathBuf, i64)>,
    reached: usize,
}

impl Files {
    fn of(bag: &Reader) -> Self {
        let mut starts: Vec<_> =
            bag.starts_of_files().map(|(path, start)| (path.to_owned(), start)).collect();
        starts.sort_by_key(|(_, start)| *start);
        Self { starts, reached: 0 }
    }

    fn go_to(&mut self, time: i64) {
        self.reached = self.starts.partition_point(|(_, start)| *start <= time).max(1);
    }

    /// The next file, if its first message is not after `time`.
    fn pass(&mut self, time: i64) -> Option<FileSplit> {
        let (opened, _) = self.starts.get(self.reached).filter(|(_, start)| *start <= time)?;
        let (closed, _) = self.starts.get(self.reached.checked_sub(1)?)?;
        let split = FileSplit { closed: closed.clone(), opened: Some(opened.clone()) };
        self.reached += 1;
        Some(split)
    }
}

impl<'a> Player<'a> {
    /// Prepares to play the selected topics.
    ///
    /// # Errors
    /// Returns an error if the bags contain a topic with different types, end before the start, or cannot be
    /// read.
    pub fn open(
        bags: &'a [Reader],
        options: &PlayerOptions,
        is_wanted: impl Fn(&TopicDescription) -> bool,
    ) -> Result<Self, PlayerError> {
        let merged = MergedBags::new(bags, is_wanted)?;
        let start = bags.iter().filter_map(Reader::start_time).min().unwrap_or(0);
        let last = bags.iter().filter_map(Reader::end_time).max().unwrap_or(0);
        let begin = after(start, options.start_offset);
        if last < begin {
            let length = Duration::from_nanos(last.abs_diff(start));
            return Err(PlayerError::StartOffset { offset: options.start_offset, length });
        }
        let end = later_end(begin, options.duration, options.until);
        let read_ahead = ReadAhead::start(options.read_ahead).map_err(PlayerError::Thread)?;
        let messages = merged.messages(&Selection::all().from(begin).until(end), |_| true)?;
        let mut player = Self {
            playback: Playback::new(read_ahead.read(messages), begin, options.rate)
                .skipping_gaps(options.skips_gaps),
            bags: merged,
            start,
            last,
            begin,
            end,
            repeats: options.repeats,
            plays_latched: options.plays_latched,
            latched: VecDeque::new(),
            all_latched: None,
            read_ahead,
            given: 0,
            files: bags.iter().map(Files::of).collect(),
        };
        player.files.iter_mut().for_each(|files| files.go_to(begin));
        if options.starts_paused {
            player.playback.pause(Duration::ZERO);
        }
        player.latched = player.latched_before(begin)?;
        Ok(player)
    }

    /// The topics of all played bags; messages refer to them by position.
    #[must_use]
    pub fn topics(&self) -> &[RecordedTopic] {
        self.bags.topics()
    }

    /// The receive time of the first message of the bags, in nanoseconds since the epoch.
    #[must_use]
    pub fn start_time(&self) -> i64 {
        self.start
    }

    /// The receive time of the last message to play.
    #[must_use]
    pub fn end_time(&self) -> i64 {
        self.last.min(self.end)
    }

    /// The files that playback leaves for the next one of their bag with this message, since the last call or
    /// seek.
    pub fn take_splits(&mut self, message: &BagMessage) -> impl Iterator<Item = FileSplit> {
        let time = message.log_time;
        self.files.iter_mut().flat_map(move |files| std::iter::from_fn(move || files.pass(time)))
    }

    /// Returns the action at `now`, a reading of any steady clock.
    pub fn step(&mut self, now: Duration) -> Step {
        if !self.playback.is_paused()
            && let Some(message) = self.latched.pop_front()
        {
            return Step::Due(message);
        }
        match self.playback.step(now) {
            Step::Finished if self.repeats && self.given > 0 => match self.seek(now, self.begin) {
                Ok(()) => {
                    self.given = 0;
                    Step::Repeats
                }
                Err(error) => Step::Failed(error),
            },
            Step::Due(message) => {
                self.given += 1;
                Step::Due(message)
            }
            other => other,
        }
    }

    /// Returns the next message, due or not, and sets the bag time to it. For stepping while paused.
    pub fn play_next(&mut self, now: Duration) -> Option<Result<BagMessage, ReaderError>> {
        if let Some(message) = self.latched.pop_front() {
            return Some(Ok(message));
        }
        let next = self.playback.take_next()?;
        if let Ok(message) = &next {
            self.given += 1;
            self.playback.jump(now, message.log_time);
        }
        Some(next)
    }

    /// Continues from that bag time, in nanoseconds since the epoch; a time before the start means the start.
    ///
    /// # Errors
    /// Returns an error if a bag can no longer be opened.
    pub fn seek(&mut self, now: Duration, time: i64) -> Result<(), ReaderError> {
        let time = time.max(self.begin);
        self.go_to(time)?;
        self.playback.jump(now, time);
        // After the end there is nothing to return, but playback repeats anyway.
        self.given = 1;
        Ok(())
    }

    /// Like [`Player::seek`], but with a new end, given by [`PlayerOptions::duration`] from that time and
    /// [`PlayerOptions::until`].
    ///
    /// # Errors
    /// Returns an error if a bag can no longer be opened.
    pub fn play_part(
        &mut self,
        now: Duration,
        time: i64,
        duration: Option<Duration>,
        until: Option<i64>,
    ) -> Result<(), ReaderError> {
        self.end = later_end(time.max(self.begin), duration, until);
        self.seek(now, time)
    }

    /// Changes the rate from now on.
    pub fn set_rate(&mut self, now: Duration, rate: Rate) {
        self.playback.set_rate(now, rate);
    }

    /// The playback rate.
    #[must_use]
    pub fn rate(&self) -> Rate {
        self.playback.rate()
    }

    /// The gap before the next message, while it is waited for.
    #[must_use]
    pub fn gap(&self) -> Option<Gap> {
        self.playback.gap()
    }

    /// Stops the time of the bags.
    pub fn pause(&mut self, now: Duration) {
        self.playback.pause(now);
    }

    /// Resumes the time where it was stopped.
    pub fn resume(&mut self, now: Duration) {
        self.playback.resume(now);
    }

    /// True between [`Player::pause`] and [`Player::resume`].
    #[must_use]
    pub fn is_paused(&self) -> bool {
        self.playback.is_paused()
    }

    /// The time of the bags at `now`, in nanoseconds since the epoch: what to publish on `/clock`.
    #[must_use]
    pub fn bag_time(&self, now: Duration) -> i64 {
        self.playback.bag_time(now)
    }

    fn go_to(&mut self, time: i64) -> Result<(), ReaderError> {
        let messages = self.bags.messages(&Selection::all().from(time).until(self.end), |_| true)?;
        let messages = self.read_ahead.read(messages);
        self.playback.replace(messages);
        self.files.iter_mut().for_each(|files| files.go_to(time));
        self.latched = self.latched_before(time)?;
        Ok(())
    }

    /// The last messages of latched topics before that time, if they are played.
    fn latched_before(&mut self, time: i64) -> Result<VecDeque<BagMessage>, ReaderError> {
        let is_latched = |topic: &RecordedTopic| topic.info.latched_depth() > 0;
        if !self.plays_latched || time <= self.start || !self.topics().iter().any(is_latched) {
            return Ok(VecDeque::new());
        }
        let all = match self.all_latched.take() {
            Some(all) => all,
            // Unreadable parts are reported when the messages are played.
            None => self.bags.messages(&Selection::all(), is_latched)?.flatten().collect(),
        };
        let before = all.iter().take_while(|message| message.log_time < time).cloned();
        let last = self.bags.last_latched(before);
        self.all_latched = Some(all);
        Ok(last.into())
    }
}

fn after(time: i64, distance: Duration) -> i64 {
    time.saturating_add(i64::try_from(distance.as_nanos()).unwrap_or(i64::MAX))
}

/// The last time that is played.
fn later_end(begin: i64, duration: Option<Duration>, until: Option<i64>) -> i64 {
    duration.map(|duration| after(begin, duration)).into_iter().chain(until).max().unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use downbeat_msgs::qos::QosProfile;

    use super::*;
    use crate::writer::WriterOptions;

    /// Two bags: `/a` at 0, 100, 200, … ms and the latched `/map` at 50 ms; `/b` at 250 ms.
    fn bags(folder: &std::path::Path) -> Vec<Reader> {
        let info = |name: &str, qos: QosProfile| TopicDescription {
            name: name.to_owned(),
            type_name: "std_msgs/msg/String".to_owned(),
            offered_qos: vec![(&qos).into()],
            ..TopicDescription::default()
        };
        let ms = 1_000_000;
        let mut writer = WriterOptions::new().create(folder.join("one")).unwrap();
        let a = writer.add_topic(info("/a", QosProfile::DEFAULT)).unwrap();
        let map = writer.add_topic(info("/map", QosProfile::LATCHED)).unwrap();
        for n in 0..10 {
            writer.write(a, n * 100 * ms, 0, &[]).unwrap();
        }
        writer.write(map, 50 * ms, 0, &[]).unwrap();
        writer.finish().unwrap();
        let mut writer = WriterOptions::new().create(folder.join("two")).unwrap();
        let b = writer.add_topic(info("/b", QosProfile::DEFAULT)).unwrap();
        writer.write(b, 250 * ms, 0, &[]).unwrap();
        writer.finish().unwrap();
        ["one", "two"].map(|name| Reader::open(folder.join(name)).unwrap()).into()
    }

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    /// The messages due at `now`: topic and time in ms.
    fn due(player: &mut Player<'_>, now: Duration) -> Vec<(String, i64)> {
        let mut played = Vec::new();
        while let Step::Due(message) = player.step(now) {
            let name = player.topics()[message.topic.index()].info.name.clone();
            played.push((name, message.log_time / 1_000_000));
        }
        played
    }

    fn of(played: &[(&str, i64)]) -> Vec<(String, i64)> {
        played.iter().map(|(name, time)| ((*name).to_owned(), *time)).collect()
    }

    #[test]
    fn several_bags_are_played_by_time_between_two_times() {
        let folder = tempfile::tempdir().unwrap();
        let bags = bags(folder.path());
        let options =
            PlayerOptions { start_offset: ms(150), duration: Some(ms(200)), ..PlayerOptions::default() };
        let mut player = Player::open(&bags, &options, |_| true).unwrap();
        assert_eq!(due(&mut player, ms(0)), of(&[("/map", 50)]), "latched before the start");
        assert!(matches!(player.step(ms(0)), Step::Wait(wait) if wait == ms(50)));
        assert_eq!(due(&mut player, ms(1000)), of(&[("/a", 200), ("/b", 250), ("/a", 300)]));
        assert!(matches!(player.step(ms(1000)), Step::Finished));
        let without = PlayerOptions { plays_latched: false, ..options };
        let mut player = Player::open(&bags, &without, |topic| topic.name != "/b").unwrap();
        player.step(ms(0));
        assert_eq!(due(&mut player, ms(1000)), of(&[("/a", 200), ("/a", 300)]));
        let late = PlayerOptions { start_offset: ms(901), ..PlayerOptions::default() };
        assert!(matches!(Player::open(&bags, &late, |_| true), Err(PlayerError::StartOffset { .. })));
    }

    #[test]
    fn a_paused_player_steps_seeks_and_changes_its_rate() {
        let folder = tempfile::tempdir().unwrap();
        let bags = bags(folder.path());
        let options = PlayerOptions { starts_paused: true, ..PlayerOptions::default() };
        let mut player = Player::open(&bags, &options, |topic| topic.name == "/a").unwrap();
        assert!(matches!(player.step(ms(500)), Step::Paused));
        let next = |player: &mut Player<'_>| player.play_next(ms(500)).unwrap().unwrap().log_time / 1_000_000;
        assert_eq!((next(&mut player), next(&mut player)), (0, 100));
        assert_eq!(player.bag_time(ms(900)), 100_000_000);
        player.seek(ms(900), 650_000_000).unwrap();
        assert_eq!(player.bag_time(ms(900)), 650_000_000);
        player.set_rate(ms(900), Rate::new(2.0).unwrap());
        player.resume(ms(1000));
        assert!(matches!(player.step(ms(1000)), Step::Wait(wait) if wait == ms(25)));
        assert_eq!(due(&mut player, ms(1025)), of(&[("/a", 700)]));
        player.set_rate(ms(1025), Rate::new(0.5).unwrap());
        assert!(matches!(player.step(ms(1025)), Step::Wait(wait) if wait == ms(200)));
        player.seek(ms(1025), -5).unwrap();
        assert_eq!(due(&mut player, ms(1025)), of(&[("/a", 0)]), "a time before the bag is its start");
    }

    #[test]
    fn the_player_says_when_it_leaves_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let info = TopicDescription { name: "/a".to_owned(), ..TopicDescription::default() };
        let mut writer = WriterOptions::new().create(folder.path().join("bag")).unwrap();
        let a = writer.add_topic(info).unwrap();
        for n in 0..6 {
            if n == 2 || n == 4 {
                writer.split().unwrap();
            }
            writer.write(a, n * 100_000_000, 0, &[]).unwrap();
        }
        writer.finish().unwrap();
        let bags = [Reader::open(folder.path().join("bag")).unwrap()];
        let mut player = Player::open(&bags, &PlayerOptions::default(), |_| true).unwrap();
        let passed = |player: &mut Player<'_>, now| {
            let mut passed = Vec::new();
            while let Step::Due(message) = player.step(now) {
                let name = |path: &std::path::Path| path.file_name().unwrap().to_str().unwrap().to_owned();
                let splits = player.take_splits(&message);
                let splits = splits.map(|split| (name(&split.closed), name(&split.opened.unwrap())));
                passed.extend(splits.map(|names| (message.log_time / 100_000_000, names)));
            }
            passed
        };
        let split = |time, from: u32, to: u32| (time, (format!("bag_{from}.mcap"), format!("bag_{to}.mcap")));
        assert_eq!(passed(&mut player, ms(0)), []);
        assert_eq!(passed(&mut player, ms(600)), [split(2, 0, 1), split(4, 1, 2)]);
        // A seek passes nothing by itself.
        player.seek(ms(600), 350_000_000).unwrap();
        assert_eq!(passed(&mut player, ms(1000)), [split(4, 1, 2)]);
    }

    #[test]
    fn a_repeating_player_starts_again() {
        let folder = tempfile::tempdir().unwrap();
        let bags = bags(folder.path());
        let options = PlayerOptions { repeats: true, start_offset: ms(800), ..PlayerOptions::default() };
        let mut player = Player::open(&bags, &options, |topic| topic.name == "/a").unwrap();
        assert_eq!(due(&mut player, ms(0)), of(&[("/a", 800)]));
        assert_eq!(due(&mut player, ms(100)), of(&[("/a", 900)]));
        assert_eq!(due(&mut player, ms(100)), of(&[("/a", 800)]), "again");
        assert!(matches!(player.step(ms(100)), Step::Wait(wait) if wait == ms(100)));
    }
}
