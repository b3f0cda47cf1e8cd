//! `downbeat bag play`

mod controls;
mod into;
mod ros;
mod target;

use std::path::PathBuf;
use std::time::Duration;

use anyhow::bail;
use clap::Args;

use super::open;
use super::select::{TopicArguments, carried_over};
use crate::logging::Log;
use crate::network::NetworkArguments;
use crate::new_output::Force;
use crate::screen::Screen;
use downbeat_bags::{PlayerOptions, Reader};
use downbeat_bridge::ros::RemapRule;
use downbeat_files::duration::parse_or_seconds;
use downbeat_msgs::encoding::Encoding;
use downbeat_robot::{Catalog, RosArgs};
use target::RequestsSource;

#[derive(Args)]
pub(crate) struct PlayArguments {
    /// Bags to play, merged by time: rosbag2 directories or single files.
    #[arg(required = true)]
    pub(crate) bags: Vec<PathBuf>,
    #[command(flatten)]
    pub(crate) topics: TopicArguments,
    /// Playback rate: 2 is twice as fast as recorded.
    #[arg(long, short, default_value_t = 1.0)]
    pub(crate) rate: f64,
    /// Start this far into the bag: seconds, or with a unit 500ms, 10s, 5min.
    #[arg(long, value_parser = seconds, value_name = "TIME")]
    pub(crate) start_offset: Option<Duration>,
    /// Play this much of the bag: seconds, or with a unit.
    ///
    /// Together with an end time, the later of both ends playback; negative values are ignored.
    #[arg(long, allow_negative_numbers = true, value_parser = seconds_or_endless, value_name = "TIME")]
    pub(crate) playback_duration: Option<Limit>,
    /// Play until this time, in seconds since the epoch.
    #[arg(
        long,
        allow_negative_numbers = true,
        value_name = "SECONDS",
        conflicts_with = "playback_until_nsec"
    )]
    pub(crate) playback_until_sec: Option<f64>,
    /// Play until this time, in nanoseconds since the epoch.
    #[arg(long, allow_negative_numbers = true, value_name = "NANOSECONDS")]
    pub(crate) playback_until_nsec: Option<i64>,
    /// Start again at the end.
    #[arg(long = "loop", short = 'l')]
    pub(crate) repeats: bool,
    /// Wait this long before each start: seconds, or with a unit.
    #[arg(long, short, value_parser = seconds, value_name = "TIME")]
    pub(crate) delay: Option<Duration>,
    /// Publish topics under other names: /old:=/new.
    #[arg(long, short = 'm', num_args = 1.., value_name = "OLD:=NEW", value_parser = remap_rule)]
    pub(crate) remap: Vec<RemapRule>,
    /// Publish the time of the bag on /clock this many times per second (default 40); /clock of the bag is
    /// not played.
    #[arg(long, num_args = 0..=1, default_missing_value = "40", value_name = "HZ", conflicts_with_all = ["clock_topics", "clock_topics_all"])]
    pub(crate) clock: Option<f64>,
    /// Publish the time on /clock before each message of these topics.
    #[arg(long, num_args = 1.., value_name = "TOPIC", conflicts_with = "clock_topics_all")]
    pub(crate) clock_topics: Vec<String>,
    /// Publish the time on /clock before each message.
    #[arg(long)]
    pub(crate) clock_topics_all: bool,
    /// Start paused, and wait for a key, ~/resume or ~/play_next.
    #[arg(long, short = 'p')]
    pub(crate) start_paused: bool,
    /// Leave out the last messages of latched (transient local) topics before the start, as `ros2 bag play`
    /// does.
    #[arg(long)]
    pub(crate) no_latched: bool,
    /// Continue at once where a bag has no messages for more than a minute, instead of waiting.
    #[arg(long)]
    pub(crate) skip_gaps: bool,
    /// Send recorded service requests again, instead of publishing the service events.
    #[arg(long)]
    pub(crate) publish_service_requests: bool,
    /// Which recorded requests to use: those of the server, or those of the clients.
    #[arg(long, value_enum, default_value_t, requires = "publish_service_requests", value_name = "SOURCE")]
    pub(crate) service_requests_source: RequestsSource,
    /// How many messages are read before they are due.
    #[arg(long, default_value_t = PlayerOptions::DEFAULT_READ_AHEAD as u32, value_name = "MESSAGES",
          value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub(crate) read_ahead_queue_size: u32,
    /// A YAML file of QoS profiles for publishing topics, instead of the recorded ones.
    #[arg(long, value_name = "FILE.yaml")]
    pub(crate) qos_profile_overrides_path: Option<PathBuf>,
    /// At the end, wait up to this many milliseconds until reliable subscribers have received everything; 0
    /// waits without limit, a negative number waits up to two seconds.
    #[arg(long, default_value_t = -1, allow_negative_numbers = true, value_name = "MS")]
    pub(crate) wait_for_all_acked: i64,
    /// Disable the keys: space pauses and resumes, right plays the next message while paused, up and down
    /// change the rate.
    #[arg(long)]
    pub(crate) disable_keyboard_controls: bool,
    /// Run the modules of this robot on the bag instead of playing to ROS 2: deterministically, with the time
    /// of the bag, as fast as possible.
    #[arg(long, value_name = "ROBOT.toml", conflicts_with_all = ["rate", "start_offset", "domain", "engine", "connect", "playback_duration",
          "playback_until_sec", "playback_until_nsec", "repeats", "delay", "remap", "clock", "clock_topics",
          "clock_topics_all", "start_paused", "no_latched", "skip_gaps", "publish_service_requests", "disable_keyboard_controls", "read_ahead_queue_size", "qos_profile_overrides_path", "wait_for_all_acked", "topic_types", "services", "regex", "exclude_regex", "exclude_topics",
          "exclude_topic_types", "exclude_services"])]
    pub(crate) into: Option<PathBuf>,
    /// With --into: record what the modules publish into this new rosbag2 directory.
    #[arg(long, value_name = "DIR", requires = "into")]
    pub(crate) record: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) force: Force,
    /// Write messages as: cdr, json, cbor, protobuf, foxglove-protobuf, flatbuffers or foxglove-flatbuffers;
    /// default cdr.
    #[arg(long, value_name = "ENCODING", requires = "record")]
    pub(crate) encoding: Option<Encoding>,
    #[command(flatten)]
    pub(crate) network: NetworkArguments,
}

pub(crate) fn play(
    arguments: &PlayArguments,
    catalog: &Catalog,
    ros: &RosArgs,
    screen: &Screen,
    log: &Log,
) -> anyhow::Result<()> {
    let bags = arguments.bags.iter().map(|bag| open(bag)).collect::<anyhow::Result<Vec<Reader>>>()?;
    let unreadable = match (&arguments.into, &bags[..]) {
        (Some(robot), [bag]) => into::play_into(bag, robot, arguments, catalog, ros, log).map(|()| 0)?,
        (Some(_), _) => {
            bail!("only one bag can be played into a robot; merge them first: downbeat bag convert")
        }
        (None, bags) => ros::play(bags, arguments, catalog, ros, screen)?,
    };
    carried_over(&bags, unreadable)
}

fn remap_rule(text: &str) -> Result<RemapRule, String> {
    text.parse().map_err(|error| format!("{error}"))
}

/// How long to play; forever if negative.
#[derive(Clone, Copy)]
pub(crate) struct Limit(pub(crate) Option<Duration>);

fn seconds_or_endless(text: &str) -> Result<Limit, String> {
    if text.parse::<f64>().is_ok_and(|seconds| seconds < 0.0) {
        return Ok(Limit(None));
    }
    seconds(text).map(|duration| Limit(Some(duration)))
}

/// In seconds as in `ros2 bag play`, or with a unit.
pub(super) fn seconds(text: &str) -> Result<Duration, String> {
    const LONGEST: Duration = Duration::from_secs(100 * 365 * 24 * 3600);
    parse_or_seconds(text)
        .and_then(|time| if time <= LONGEST { Ok(time) } else { Err("more than a century".to_owned()) })
}
