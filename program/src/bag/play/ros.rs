//! Playing to ROS 2.

use std::time::{Duration, Instant};

use anyhow::{Context, bail};

use super::PlayArguments;
use super::controls::{Control, Controls, answer};
use super::target::{Target, targets};
use crate::bag::select::absolute;
use crate::screen::Screen;
use crate::stop::{Key, Keyboard, Stop};
use downbeat_bags::{BagMessage, FileSplit, Gap, Player, PlayerOptions, Rate, Reader, ReaderError, Step};
use downbeat_bridge::limiter::Limiter;
use downbeat_bridge::middleware::WriteError;
use downbeat_bridge::ros::{MessageType, Node, Publisher};
use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rosbag2_interfaces::msg::ReadSplitEvent;
use downbeat_msgs::rosbag2_interfaces::srv::{
    BurstResponse, GetRateResponse, IsPausedResponse, PauseResponse, PlayNextResponse, PlayResponse,
    ResumeResponse, SeekResponse, SetRateResponse, StopResponse, TogglePausedResponse,
};
use downbeat_msgs::rosgraph_msgs::msg::Clock;
use downbeat_msgs::{Message, cdr, printable};
use downbeat_robot::ros_recorder::QosOverrides;
use downbeat_robot::{Catalog, RosArgs};

/// The maximum time to wait for discovery: earlier samples would not be received.
const DISCOVERY: Duration = Duration::from_secs(3);
/// How long delivery to reliable subscribers may go on after the last message: some have only begun to
/// listen.
const DELIVERY: Duration = Duration::from_secs(2);
/// The wait that is not logged, and the number of topics that the log names.
const PATIENCE: Duration = Duration::from_millis(200);
const MOST_NAMED: usize = 3;
/// The maximum delay until a signal or a key is handled.
const POLL: Duration = Duration::from_millis(50);
/// How often the line on the screen is updated.
const REFRESH: Duration = Duration::from_millis(100);
/// By how much a key changes the rate, as in rosbag2.
const RATE_STEP: f64 = 0.1;
/// The name of the node of `ros2 bag play`.
const NODE_NAME: &str = "rosbag2_player";

/// Returns the number of parts of the bags that could not be read.
pub(super) fn play(
    bags: &[Reader],
    arguments: &PlayArguments,
    catalog: &Catalog,
    ros: &RosArgs,
    screen: &Screen,
) -> anyhow::Result<usize> {
    let overrides = match &arguments.qos_profile_overrides_path {
        Some(path) => QosOverrides::read(path)?,
        None => QosOverrides::default(),
    };
    let filter = arguments.topics.filter()?;
    arguments.topics.check(bags.iter().flat_map(Reader::topics).map(|topic| &topic.info))?;
    let options = options(arguments)?;
    let player = Player::open(bags, &options, |topic| {
        let is_replaced = arguments.clock.is_some() && topic.name == "/clock";
        filter.is_wanted(topic) && !is_replaced
    })?;
    let stop = Stop::new()?;
    let remaps = arguments.remap.iter().chain(&ros.remaps).cloned().collect();
    let ros = RosArgs { remaps, ..ros.clone() };
    let (_participant, node) = arguments.network.node(NODE_NAME, catalog, &ros)?;
    let requests = arguments.publish_service_requests.then_some(arguments.service_requests_source);
    let targets = targets(&player, &node, &overrides, requests, &stop)?;
    let left_out = left_out(&player, &targets);
    let is_asked_for = |name: &String| arguments.topics.names().contains(name);
    if !stop.is_due()
        && (left_out.iter().any(is_asked_for) || left_out.len() == targets.len() && !targets.is_empty())
    {
        bail!("nothing of {} can be played; see above", left_out.join(", "));
    }
    let clock = PublishedClock::new(&node, arguments)?;
    let splits = PublishedSplits::new(&node)?;
    let controls = Controls::offer(&node)?;
    wait_for_peers(&player, &targets, &stop);
    let keyboard = (!arguments.disable_keyboard_controls).then(Keyboard::open).flatten();
    if keyboard.is_some() {
        tracing::info!(
            "Press SPACE for pausing/resuming, RIGHT for the next message, UP and DOWN for the rate"
        );
    }
    let mut run = Run {
        player,
        targets,
        clock,
        splits,
        started: Instant::now(),
        delay: arguments.delay.unwrap_or_default(),
        played: 0,
        refused: 0,
        refusals: Limiter::default(),
        unreadable: 0,
        told_gap: None,
        is_over: false,
    };
    stop.sleep(run.delay);
    run.started = Instant::now();
    run.run(&controls, keyboard.as_ref(), screen, &stop);
    drop(keyboard);
    screen.show(Vec::new());
    run.wait_for_answers(&stop);
    run.wait_for_all_acked(arguments.wait_for_all_acked, &stop);
    println!("played {} messages; {} were refused", run.played, run.refused);
    if !left_out.is_empty() && !stop.is_due() {
        bail!(
            "incomplete: {} cannot be played, see above; --exclude-topics leaves topics out without an error",
            left_out.join(", ")
        );
    }
    Ok(run.unreadable)
}

/// The topics with messages that could not be prepared for playing.
fn left_out(player: &Player<'_>, targets: &[Option<Target>]) -> Vec<String> {
    let topics = player.topics().iter().zip(targets);
    let without = topics.filter(|(topic, target)| target.is_none() && topic.message_count > 0);
    without.map(|(topic, _)| printable(&topic.info.name).into_owned()).collect()
}

fn options(arguments: &PlayArguments) -> anyhow::Result<PlayerOptions> {
    let until_sec = arguments.playback_until_sec.filter(|seconds| *seconds >= 0.0);
    let until_nsec = arguments.playback_until_nsec.filter(|nanoseconds| *nanoseconds >= 0);
    Ok(PlayerOptions {
        rate: Rate::new(arguments.rate)?,
        start_offset: arguments.start_offset.unwrap_or_default(),
        until: until_nsec.or(until_sec.map(|seconds| (seconds * 1e9) as i64)),
        duration: arguments.playback_duration.and_then(|limit| limit.0),
        repeats: arguments.repeats,
        starts_paused: arguments.start_paused,
        plays_latched: !arguments.no_latched,
        skips_gaps: arguments.skip_gaps,
        read_ahead: arguments.read_ahead_queue_size as usize,
    })
}

/// Waits for subscribers, and logs that: three seconds of silence look like a fault.
fn wait_for_peers(player: &Player<'_>, targets: &[Option<Target>], stop: &Stop) {
    let started = Instant::now();
    let mut is_told = false;
    while started.elapsed() < DISCOVERY && !stop.is_due() {
        let topics = player.topics().iter().zip(targets);
        let is_unmatched =
            |target: &Option<Target>| target.as_ref().is_some_and(|target| !target.is_matched());
        let unmatched = topics.filter(|(_, target)| is_unmatched(target)).map(|(topic, _)| &*topic.info.name);
        let unmatched: Vec<_> = unmatched.collect();
        if unmatched.is_empty() {
            return;
        }
        if !is_told && started.elapsed() >= PATIENCE {
            is_told = true;
            let more = unmatched.len().saturating_sub(MOST_NAMED);
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            let named = unmatched[..unmatched.len().min(MOST_NAMED)].join(", ");
            tracing::info!("waiting up to {} s for subscribers of {named}{more}", DISCOVERY.as_secs());
        }
        stop.sleep(POLL);
    }
}

/// `/clock`, if requested.
struct PublishedClock {
    publisher: Option<Publisher>,
    period: Option<Duration>,
    next: Instant,
    /// Before messages of these topics; all of them if `before_all`.
    topics: Vec<String>,
    before_all: bool,
}

impl PublishedClock {
    fn new(node: &Node, arguments: &PlayArguments) -> anyhow::Result<Self> {
        let PlayArguments { clock, clock_topics, clock_topics_all, .. } = arguments;
        let period = match *clock {
            Some(hz) if (0.001..=10_000.0).contains(&hz) => Some(Duration::from_secs_f64(1.0 / hz)),
            Some(hz) => bail!("--clock {hz}: a frequency is 0.001 to 10000 Hz"),
            None => None,
        };
        let is_wanted = period.is_some() || !clock_topics.is_empty() || *clock_topics_all;
        let open = || -> anyhow::Result<_> {
            let message_type = MessageType::new(Clock::TYPE_NAME)?;
            node.publish("/clock", &message_type, QosProfile::CLOCK).context("cannot publish /clock")
        };
        Ok(Self {
            publisher: is_wanted.then(open).transpose()?,
            period,
            next: Instant::now(),
            topics: clock_topics.iter().map(|topic| absolute(topic)).collect(),
            before_all: *clock_topics_all,
        })
    }

    fn publish(&self, time: i64) {
        let Some(publisher) = &self.publisher else { return };
        let message = Clock { clock: Time::from_nanos(time) };
        if let Err(error) = publisher.publish(cdr::to_vec(&message).into()) {
            tracing::debug!("/clock: {error}");
        }
    }

    /// Publishes if due, and returns the time until it is due again.
    fn publish_if_due(&mut self, time: i64) -> Duration {
        let Some(period) = self.period else { return POLL };
        let now = Instant::now();
        if now >= self.next {
            self.publish(time);
            // Missed messages are not made up for.
            self.next = (self.next + period).max(now);
        }
        self.next.saturating_duration_since(now)
    }

    fn precedes(&self, topic: &str) -> bool {
        self.before_all || self.topics.iter().any(|named| named == topic)
    }
}

/// `events/read_split`, as rosbag2's player has it.
struct PublishedSplits {
    publisher: Publisher,
    node_name: String,
}

impl PublishedSplits {
    fn new(node: &Node) -> anyhow::Result<Self> {
        let message_type = MessageType::new(ReadSplitEvent::TYPE_NAME)?;
        let qos = QosProfile::DEFAULT.keep_last(1);
        let publisher = node.publish("events/read_split", &message_type, qos);
        let publisher = publisher.context("cannot publish events/read_split")?;
        Ok(Self { publisher, node_name: node.name().to_string() })
    }

    fn publish(&self, split: &FileSplit) {
        let path = |path: &std::path::Path| path.display().to_string();
        let event = ReadSplitEvent {
            closed_file: path(&split.closed),
            opened_file: split.opened.as_deref().map(path).unwrap_or_default(),
            node_name: self.node_name.clone(),
        };
        if let Err(error) = self.publisher.publish(cdr::to_vec(&event).into()) {
            tracing::debug!("{}: {error}", self.publisher.topic());
        }
    }
}

struct Run<'a> {
    player: Player<'a>,
    targets: Vec<Option<Target>>,
    clock: PublishedClock,
    splits: PublishedSplits,
    started: Instant,
    delay: Duration,
    played: u64,
    refused: u64,
    refusals: Limiter,
    unreadable: usize,
    /// The gap that was reported last.
    told_gap: Option<Gap>,
    is_over: bool,
}

/// The two largest units of a duration: `20 years 3 days`, `1 min 5 s`.
fn humanly(duration: Duration) -> String {
    const UNITS: [(&str, u64); 5] =
        [("years", 365 * 86_400), ("days", 86_400), ("h", 3600), ("min", 60), ("s", 1)];
    let mut left = duration.as_secs();
    let mut parts = Vec::new();
    for (unit, seconds) in UNITS {
        if left >= seconds {
            parts.push(format!("{} {unit}", left / seconds));
            left %= seconds;
        }
    }
    parts.truncate(2);
    if parts.is_empty() { "less than 1 s".to_owned() } else { parts.join(" ") }
}

impl Run<'_> {
    fn run(&mut self, controls: &Controls, keyboard: Option<&Keyboard>, screen: &Screen, stop: &Stop) {
        let mut next_refresh = Duration::ZERO;
        while !stop.is_due() && !self.is_over {
            while let Some(key) = keyboard.and_then(Keyboard::pressed) {
                self.act_on(key);
            }
            let now = self.started.elapsed();
            if now >= next_refresh && screen.is_terminal() {
                next_refresh = now + REFRESH;
                screen.show(vec![self.progress(now)]);
            }
            let until_clock = self.clock.publish_if_due(self.player.bag_time(now));
            let wait = match self.player.step(now) {
                Step::Due(message) => {
                    let _ = self.publish(message);
                    Duration::ZERO
                }
                Step::Wait(wait) => {
                    self.tell_gap(wait);
                    wait
                }
                Step::Skipped(gap) => {
                    tracing::info!("skipped {}", self.describe(&gap));
                    Duration::ZERO
                }
                Step::Paused => POLL,
                Step::Failed(error) => {
                    tracing::warn!("{error}");
                    self.unreadable += 1;
                    Duration::ZERO
                }
                Step::Repeats => {
                    self.player.pause(now);
                    stop.sleep(self.delay);
                    self.player.resume(self.started.elapsed());
                    Duration::ZERO
                }
                Step::Finished => return,
            };
            if let Some(control) = controls.wait(wait.min(until_clock).min(POLL)) {
                self.obey(control, stop);
            }
        }
    }

    /// Reports a gap once: waiting in silence looks like a fault.
    fn tell_gap(&mut self, wait: Duration) {
        let gap = self.player.gap();
        if let Some(gap) = gap.filter(|_| gap != self.told_gap) {
            tracing::warn!(
                "waiting {} for the end of {}; --skip-gaps continues at once",
                humanly(wait),
                self.describe(&gap)
            );
        }
        self.told_gap = gap;
    }

    fn describe(&self, gap: &Gap) -> String {
        let seconds = |time: i64| time as f64 / 1e9;
        let topic = self.player.topics().get(gap.topic.index()).map_or("", |topic| &*topic.info.name);
        format!(
            "a gap of {} from {:.3} to {:.3}, where the next message is of {}",
            humanly(gap.length()),
            seconds(gap.from),
            seconds(gap.until),
            printable(topic)
        )
    }

    /// Returns false if it could not be published.
    fn publish(&mut self, message: BagMessage) -> bool {
        self.player.take_splits(&message).for_each(|split| self.splits.publish(&split));
        let BagMessage { topic, log_time, data, .. } = message;
        let Some(target) = self.targets.get(topic.index()).and_then(Option::as_ref) else { return false };
        let name = &self.player.topics()[topic.index()].info.name;
        if self.clock.precedes(name) {
            // Messages latched before the start have the start time.
            self.clock.publish(log_time.max(self.player.bag_time(self.started.elapsed())));
        }
        match target.take(data) {
            Ok(is_taken) => {
                self.played += u64::from(is_taken);
                is_taken
            }
            Err(error) => {
                self.refused += 1;
                if error.is::<WriteError>() {
                    tracing::debug!("{name}: {error}");
                } else if let Some(left_out) = self.refusals.allow() {
                    tracing::warn!("{name}: {error}{left_out}");
                }
                false
            }
        }
    }

    fn act_on(&mut self, key: Key) {
        let now = self.started.elapsed();
        match key {
            Key::Space => self.toggle_paused(now),
            Key::Right if self.player.is_paused() => drop(self.play_next()),
            Key::Right => {}
            Key::Up => self.scale_rate(now, 1.0 + RATE_STEP),
            Key::Down => self.scale_rate(now, 1.0 - RATE_STEP),
        }
    }

    fn toggle_paused(&mut self, now: Duration) {
        if self.player.is_paused() {
            self.player.resume(now);
        } else {
            self.player.pause(now);
        }
    }

    fn scale_rate(&mut self, now: Duration, by: f64) {
        if let Ok(rate) = Rate::new(self.player.rate().as_f64() * by) {
            self.player.set_rate(now, rate);
        }
    }

    /// The position in the bags, for the screen.
    fn progress(&self, now: Duration) -> String {
        const WIDTH: usize = 30;
        let seconds = |from: i64, to: i64| to.saturating_sub(from).max(0) as f64 / 1e9;
        let length = seconds(self.player.start_time(), self.player.end_time());
        let played = seconds(self.player.start_time(), self.player.bag_time(now)).min(length);
        let done = if length > 0.0 { (played / length * WIDTH as f64) as usize } else { WIDTH };
        let bar = format!("{}{}", "#".repeat(done), "-".repeat(WIDTH - done));
        let state = if self.player.is_paused() { "paused" } else { "playing" };
        let rate = self.player.rate().as_f64();
        format!("[{bar}] {played:.1} of {length:.1} s  x {rate:.2}  {state}  {} messages", self.played)
    }

    fn wait_for_answers(&self, stop: &Stop) {
        let is_unanswered =
            |target: &Target| matches!(target, Target::Service(requests) if requests.is_unanswered());
        while self.targets.iter().flatten().any(is_unanswered) && !stop.is_due() {
            stop.sleep(Duration::from_millis(10));
        }
    }

    /// Implements `--wait-for-all-acked`, in milliseconds.
    fn wait_for_all_acked(&self, timeout: i64, stop: &Stop) {
        let limit = match u64::try_from(timeout) {
            Ok(0) => None,
            Ok(milliseconds) => Some(Duration::from_millis(milliseconds)),
            Err(_) => Some(DELIVERY),
        };
        let limit = limit.map(|limit| Instant::now() + limit);
        for target in self.targets.iter().flatten() {
            let Target::Topic(publisher, _) = target else { continue };
            while !publisher.wait_for_all_acked(POLL) {
                if stop.is_due() || limit.is_some_and(|limit| Instant::now() >= limit) {
                    tracing::warn!("{}: not all messages were acknowledged in time", publisher.topic());
                    return;
                }
            }
        }
    }

    /// Publishes the next message; returns false at the end, or if it could not be published.
    fn play_next(&mut self) -> bool {
        loop {
            match self.player.play_next(self.started.elapsed()) {
                None => return false,
                Some(Ok(message)) => return self.publish(message),
                Some(Err(error)) => {
                    tracing::warn!("{error}");
                    self.unreadable += 1;
                }
            }
        }
    }

    fn seek(&mut self, seek: impl FnOnce(&mut Player<'_>, Duration) -> Result<(), ReaderError>) -> bool {
        // Searching for latched messages may take a while, during which the bag's time must not advance.
        let is_paused = self.player.is_paused();
        self.player.pause(self.started.elapsed());
        let sought = seek(&mut self.player, self.started.elapsed());
        if !is_paused {
            self.player.resume(self.started.elapsed());
        }
        sought.inspect_err(|error| tracing::warn!("{error}")).is_ok()
    }

    fn obey(&mut self, control: Control, stop: &Stop) {
        let now = self.started.elapsed();
        let is_paused = self.player.is_paused();
        match control {
            Control::Burst(count, reply) => {
                if !is_paused {
                    tracing::warn!("bursts are only played while paused");
                }
                let mut actually_burst = 0;
                // 0 means all remaining messages.
                while is_paused
                    && !stop.is_due()
                    && (count == 0 || actually_burst < count)
                    && self.play_next()
                {
                    actually_burst += 1;
                }
                answer(reply, &BurstResponse { actually_burst });
            }
            Control::GetRate(reply) => {
                answer(reply, &GetRateResponse { rate: self.player.rate().as_f64() });
            }
            Control::IsPaused(reply) => answer(reply, &IsPausedResponse { paused: is_paused }),
            Control::Pause(reply) => {
                self.player.pause(now);
                answer(reply, &PauseResponse::default());
            }
            Control::Resume(reply) => {
                self.player.resume(now);
                answer(reply, &ResumeResponse::default());
            }
            Control::TogglePaused(reply) => {
                self.toggle_paused(now);
                answer(reply, &TogglePausedResponse::default());
            }
            Control::PlayNext(reply) => {
                let success = is_paused && self.play_next();
                answer(reply, &PlayNextResponse { success });
            }
            Control::Seek(time, reply) => {
                let success = self.seek(|player, now| player.seek(now, time));
                answer(reply, &SeekResponse { success });
            }
            Control::SetRate(rate, reply) => {
                let rate = Rate::new(rate);
                let success = rate.is_ok();
                if let Ok(rate) = rate {
                    self.player.set_rate(now, rate);
                }
                answer(reply, &SetRateResponse { success });
            }
            // rosbag2's player refuses while it plays; here it is nearly always playing, so this checks for a
            // pause.
            Control::Play(part, reply) => {
                let offset = i64::try_from(part.start_offset.as_nanos()).unwrap_or(i64::MAX);
                let time = self.player.start_time().saturating_add(offset);
                let success = is_paused
                    && self.seek(|player, now| player.play_part(now, time, part.duration, part.until));
                if success {
                    self.player.resume(self.started.elapsed());
                }
                answer(reply, &PlayResponse { success });
            }
            Control::Stop(reply) => {
                self.is_over = true;
                answer(reply, &StopResponse::default());
            }
        }
    }
}
