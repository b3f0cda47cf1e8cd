//! The options of `downbeat bag record`: those of `ros2 bag record` of Jazzy by their names, and some of our
//! own.

use std::path::PathBuf;
use std::time::Duration;

use crate::bag::record_options::{GivenOptions, Recording};
use crate::network::NetworkArguments;
use crate::new_output::Force;
use clap::{Args, ValueEnum};
use downbeat_files::duration::parse as duration;
use downbeat_robot::LogLevel;
use regex_lite::Regex;

/// The help of each option follows that of `ros2bag/verb/record.py`.
#[derive(Args)]
pub(crate) struct RecordArguments {
    /// Topics to record, as after --topics.
    #[arg(value_name = "TOPIC", conflicts_with = "topics")]
    pub(crate) topics_positional: Vec<String>,
    /// The new bag directory; default is a timestamped one in the current directory.
    #[arg(short, long, value_name = "DIR")]
    pub(crate) output: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) force: Force,
    #[command(flatten)]
    pub(crate) selection: SelectionArguments,
    #[command(flatten)]
    pub(crate) discovery: DiscoveryArguments,
    #[command(flatten)]
    pub(crate) writing: WritingArguments,
    /// Stamp messages with the time of /clock. Nothing is recorded before the first time is received.
    #[arg(long, conflicts_with = "no_discovery")]
    pub(crate) use_sim_time: bool,
    /// The name of the recorder's node.
    #[arg(long, default_value = "rosbag2_recorder", value_name = "NAME")]
    pub(crate) node_name: String,
    /// Disable the key that pauses and resumes.
    #[arg(long)]
    pub(crate) disable_keyboard_controls: bool,
    /// The minimum severity of logged events.
    #[arg(long, value_enum, value_name = "LEVEL")]
    pub(crate) log_level: Option<Level>,
    /// Run this robot without a bridge and record its topics from the very first message.
    #[arg(long, value_name = "ROBOT.toml", conflicts_with_all = ["domain", "engine", "connect", "use_sim_time", "no_discovery", "qos_profile_overrides_path"])]
    pub(crate) robot: Option<PathBuf>,
    /// Stop after this time: 500ms, 10s, 5min, 1h.
    #[arg(long, value_parser = duration, value_name = "TIME")]
    pub(crate) duration: Option<Duration>,
    #[command(flatten)]
    pub(crate) network: NetworkArguments,
    #[command(
        flatten,
        next_help_heading = "How the bag is written; with --robot by default as [record] of the robot file says"
    )]
    pub(crate) options: GivenOptions<Recording>,
}

/// Which topics are recorded.
#[derive(Args)]
pub(crate) struct SelectionArguments {
    /// Topics to record.
    #[arg(long, num_args = 1.., value_name = "TOPIC")]
    pub(crate) topics: Vec<String>,
    /// Services whose events to record.
    #[arg(long, num_args = 1.., value_name = "SERVICE", conflicts_with = "robot")]
    pub(crate) services: Vec<String>,
    /// Types of topics to record.
    #[arg(long, num_args = 1.., value_name = "TYPE")]
    pub(crate) topic_types: Vec<String>,
    /// Record all topics and services, except hidden topics.
    #[arg(short, long)]
    pub(crate) all: bool,
    /// Record all topics, except hidden ones.
    #[arg(long)]
    pub(crate) all_topics: bool,
    /// Record the events of all services.
    #[arg(long, conflicts_with = "robot")]
    pub(crate) all_services: bool,
    /// Record topics and services whose names contain this regular expression.
    #[arg(short = 'e', long, value_name = "REGEX", value_parser = regex)]
    pub(crate) regex: Option<Regex>,
    /// Do not record topics and services whose names contain this regular expression.
    #[arg(long, value_name = "REGEX", value_parser = regex)]
    pub(crate) exclude_regex: Option<Regex>,
    /// Types of topics not to record.
    #[arg(long, num_args = 1.., value_name = "TYPE")]
    pub(crate) exclude_topic_types: Vec<String>,
    /// Topics not to record.
    #[arg(long, num_args = 1.., value_name = "TOPIC")]
    pub(crate) exclude_topics: Vec<String>,
    /// Services whose events not to record.
    #[arg(long, num_args = 1.., value_name = "SERVICE", conflicts_with = "robot")]
    pub(crate) exclude_services: Vec<String>,
    /// With --robot: record what these modules publish.
    #[arg(long, num_args = 1.., value_name = "MODULE", requires = "robot")]
    pub(crate) modules: Vec<String>,
    /// With --robot: record what is exposed to ROS 2, or what is not.
    #[arg(long, value_enum, requires = "robot", value_name = "WHICH")]
    pub(crate) exposed: Option<ExposedChoice>,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum ExposedChoice {
    Only,
    Not,
}

/// How topics are found.
#[derive(Args)]
pub(crate) struct DiscoveryArguments {
    /// Also record topics without publishers.
    #[arg(long)]
    pub(crate) include_unpublished_topics: bool,
    /// Also record hidden topics.
    #[arg(long)]
    pub(crate) include_hidden_topics: bool,
    /// Record only topics that exist at the start.
    #[arg(long)]
    pub(crate) no_discovery: bool,
    /// How many milliseconds to wait between searches for new topics.
    #[arg(short, long, default_value_t = 100, value_name = "MS", value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) polling_interval: u64,
    /// Ignore topics without a subscription.
    #[arg(long)]
    pub(crate) ignore_leaf_topics: bool,
    /// A YAML file of QoS profiles to request on topics, instead of those that their publishers offer.
    #[arg(long, value_name = "FILE.yaml")]
    pub(crate) qos_profile_overrides_path: Option<PathBuf>,
}

/// Options of `ros2 bag record` on how the bag is written that are not keys of robot files: one value is
/// accepted, or a robot file says the same by other keys.
#[derive(Args)]
pub(crate) struct WritingArguments {
    /// The serialization format: cdr, as in ROS 2; see --encoding for others.
    #[arg(short = 'f', long, value_parser = ["cdr"], value_name = "FORMAT")]
    pub(crate) serialization_format: Option<String>,
    /// A YAML file of storage options for rosbag2_storage_mcap or rosbag2_storage_sqlite3.
    #[arg(long, value_name = "FILE.yaml")]
    pub(crate) storage_config_file: Option<PathBuf>,
    /// Compress chunks with Zstandard, like --storage-preset-profile zstd_fast.
    #[arg(long, conflicts_with_all = ["preset", "compression"])]
    pub(crate) zstd: bool,
    /// Only none: the storage compresses chunks, but neither messages nor whole files.
    #[arg(long, value_parser = ["none"], default_value = "none", value_name = "MODE")]
    pub(crate) compression_mode: String,
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum Level {
    Debug,
    Info,
    Warn,
    Error,
    Fatal,
}

impl From<Level> for LogLevel {
    fn from(level: Level) -> Self {
        match level {
            Level::Debug => Self::Debug,
            Level::Info => Self::Info,
            Level::Warn => Self::Warn,
            Level::Error => Self::Error,
            Level::Fatal => Self::Fatal,
        }
    }
}

impl SelectionArguments {
    /// Returns whether anything is selected.
    pub(crate) fn is_given(&self) -> bool {
        self.all
            || self.all_topics
            || self.all_services
            || self.regex.is_some()
            || !(self.topics.is_empty() && self.services.is_empty() && self.topic_types.is_empty())
    }
}

fn regex(text: &str) -> Result<Regex, String> {
    Regex::new(text).map_err(|error| format!("regex parse error: {error}"))
}
