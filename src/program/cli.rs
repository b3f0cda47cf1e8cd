//! The command line.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::bridge::middleware::Engine;
use crate::duration::parse as duration;
use crate::inspect::Request;
use crate::msgs::encoding::Encoding;
use crate::robot::{Catalog, RobotFile, RobotFileError, RosArgs};
use clap::{Args, CommandFactory, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;

use super::bag::check::CheckBagArguments;
use super::bag::convert::ConvertArguments;
use super::bag::cut::CutArguments;
use super::bag::diff::DiffArguments;
use super::bag::export::ExportArguments;
use super::bag::info::InfoArguments;
use super::bag::play::PlayArguments;
#[cfg(feature = "plots")]
use super::bag::plot::PlotArguments;
use super::bag::record::arguments::RecordArguments;
use super::bag::reindex::ReindexArguments;
use super::bag::repair::RepairArguments;
use super::bag::replay::ReplayArguments;
use super::interface::InterfaceCommand;
use super::look::{ActionCommand, LifecycleCommand, NodeCommand, ParamCommand, ServiceCommand, TopicCommand};
use super::new::NewArguments;
use super::new_output::Force;

/// Robot software as small modules in one process, seen and driven from ROS 2 Jazzy, recorded and replayed.
///
/// Environment: ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE as ROS 2 reads them; DOWNBEAT_LOG sets what is
/// logged, for example "debug" or "info,rustdds=warn". Behind --ros-args stands what every ROS 2 program takes: -r, -p,
/// --params-file, --log-level and so on.
#[derive(Parser)]
#[command(name = "downbeat", version, arg_required_else_help = true)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
    /// What stands behind `--ros-args`, and ROS_NAMESPACE.
    #[arg(skip)]
    pub(crate) ros: RosArgs,
}

impl Cli {
    /// Reads the command line; where it is wrong the process ends with a message.
    pub(crate) fn parse_with_ros_args(line: impl IntoIterator<Item = OsString>) -> Self {
        let refuse = |problem: String| -> ! {
            Self::command().error(clap::error::ErrorKind::ValueValidation, problem).exit()
        };
        let (others, ros) = match RosArgs::split(line) {
            Ok((others, ros)) => (others, ros.with_variables(|name| std::env::var(name).ok())),
            Err(error) => refuse(error.to_string()),
        };
        let mut cli = Self { ros, ..Self::parse_from(others) };
        if let Command::Bag(BagCommand::Record(arguments)) = &cli.command
            && let Some(level) = arguments.log_level
        {
            cli.ros.log.level = Some(level.into());
        }
        let makes_node = match &cli.command {
            Command::Run(_) | Command::Check(_) => true,
            Command::Topic(_) | Command::Node(_) | Command::Service(_) | Command::Param(_) => true,
            Command::Action(_) | Command::Lifecycle(_) => true,
            Command::Graph(arguments) => arguments.robot.is_none(),
            Command::Bag(command) => {
                matches!(command, BagCommand::Record(_) | BagCommand::Play(_) | BagCommand::Replay(_))
            }
            _ => false,
        };
        if !makes_node && !cli.ros.is_empty() {
            refuse(
                "--ros-args goes with commands that make a ROS 2 node: run, check, graph of the network, topic, node, service, param, action, lifecycle, bag record, bag play, bag replay"
                    .into(),
            );
        }
        cli
    }
}

#[derive(Subcommand)]
pub(crate) enum Command {
    /// Run a robot until Ctrl-C or for a time.
    Run(RunArguments),
    /// Say what a robot file holds, or what is wrong with it, without running it.
    Check(CheckArguments),
    /// Watch a running robot: its cycles, modules and topics, live.
    Top(TopArguments),
    /// Write down what runs in the next cycles of a running robot, for Perfetto or chrome://tracing.
    Trace(TraceArguments),
    /// Show what a running robot exposes to ROS 2, expose more, or take it back.
    Expose(ExposeArguments),
    /// Show the nodes, topics and services of the ROS 2 network, or draw the modules of a robot file without running it.
    Graph(GraphArguments),
    /// Look at a bag, record one, play one.
    #[command(subcommand)]
    Bag(BagCommand),
    /// Look at ROS 2 interfaces: list them, show one, its hash, its description; read a message of one.
    ///
    /// Definitions come from --from, then from AMENT_PREFIX_PATH, then from this program: the first place that has a package
    /// gives all of it.
    #[command(subcommand)]
    Interface(InterfaceCommand),
    /// Look at topics of the ROS 2 network, listen to them, publish on them.
    #[command(subcommand)]
    Topic(TopicCommand),
    /// Look at nodes of the ROS 2 network.
    #[command(subcommand)]
    Node(NodeCommand),
    /// Look at services of the ROS 2 network, and call them.
    #[command(subcommand)]
    Service(ServiceCommand),
    /// Look at parameters of nodes of the ROS 2 network, and set them.
    #[command(subcommand)]
    Param(ParamCommand),
    /// Look at actions of the ROS 2 network, and send goals.
    #[command(subcommand)]
    Action(ActionCommand),
    /// Look at managed nodes of the ROS 2 network, and have them make transitions.
    #[command(subcommand)]
    Lifecycle(LifecycleCommand),
    /// Make a project of your own: a robot, or with --template messages for it or a module for several.
    New(NewArguments),
    /// Run an emulated device alone.
    #[command(subcommand)]
    Emulate(EmulateCommand),
    /// Print a script that completes the commands and options of this program in a shell.
    ///
    /// For bash: downbeat completions bash > ~/.local/share/bash-completion/completions/downbeat
    Completions {
        /// The shell.
        #[arg(value_enum)]
        shell: Shell,
    },
}

#[derive(Args)]
pub(crate) struct RunArguments {
    /// The robot file, for example robots/darwin_op.toml.
    #[arg(value_name = "ROBOT.toml")]
    pub(crate) robot: PathBuf,
    /// Stop after this time: 500ms, 10s, 5m, 1h.
    #[arg(long, value_parser = duration, value_name = "TIME")]
    pub(crate) duration: Option<Duration>,
    /// Record into this new rosbag2 directory what the robot file's [record] names.
    #[arg(long, value_name = "DIR")]
    pub(crate) record: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) force: Force,
    /// Write messages as: cdr, json, cbor, protobuf, foxglove-protobuf, flatbuffers or foxglove-flatbuffers, instead of
    /// what the robot file's [record] says.
    #[arg(long, value_name = "ENCODING", requires = "record")]
    pub(crate) encoding: Option<Encoding>,
    /// The ROS domain, instead of ROS_DOMAIN_ID.
    #[arg(long, value_name = "N")]
    pub(crate) domain: Option<u16>,
    /// Speak RTPS by this engine instead of the robot file's: rtps, or rustdds where that feature is built in.
    #[arg(long, value_name = "ENGINE")]
    pub(crate) engine: Option<Engine>,
    #[command(flatten)]
    pub(crate) parameters: ParameterArguments,
}

/// Values of settings in place of the robot file's.
#[derive(Args)]
pub(crate) struct ParameterArguments {
    /// Take settings from this ROS 2 parameter file; they win over the robot file. May be given more than once:
    /// later ones win.
    #[arg(long = "params-file", value_name = "FILE.yaml")]
    files: Vec<PathBuf>,
    /// Give a module's setting this value, in YAML; it wins over all files. May be given more than once.
    #[arg(short = 'p', long = "param", value_name = "MODULE.SETTING:=VALUE")]
    values: Vec<String>,
}

impl ParameterArguments {
    pub(crate) fn read_robot(
        &self,
        path: &Path,
        catalog: &Catalog,
        ros: &RosArgs,
    ) -> Result<RobotFile, RobotFileError> {
        ros.warn_about_what_is_ignored();
        let mut file = RobotFile::read_with(path, catalog, ros)?;
        self.files.iter().try_for_each(|path| file.set_from_parameter_file(path))?;
        self.values.iter().try_for_each(|value| file.set_from_argument(value))?;
        Ok(file)
    }
}

#[derive(Args)]
pub(crate) struct CheckArguments {
    /// The robot file.
    #[arg(value_name = "ROBOT.toml", required_unless_present = "kinds")]
    pub(crate) robot: Option<PathBuf>,
    /// Print what the robot holds and what ROS 2 will see of it as JSON.
    #[arg(long, requires = "robot", conflicts_with_all = ["kinds", "dump_params"])]
    pub(crate) json: bool,
    /// Print nothing but a ROS 2 parameter file of all settings with their values.
    #[arg(long, requires = "robot", conflicts_with = "kinds")]
    pub(crate) dump_params: bool,
    #[command(flatten)]
    pub(crate) parameters: ParameterArguments,
    /// List the kinds of modules with their topics and settings.
    #[arg(long)]
    pub(crate) kinds: bool,
}

#[derive(Args)]
pub(crate) struct TopArguments {
    /// The robot's name, or the number of its process; not needed where one robot runs.
    #[arg(value_name = "ROBOT|PID")]
    pub(crate) robot: Option<String>,
    /// Print one look as text and end; rates are those since the robot's start.
    #[arg(long)]
    pub(crate) once: bool,
    /// Print one look as JSON and end, with or without --once.
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args)]
pub(crate) struct TraceArguments {
    /// The robot's name, or the number of its process; not needed where one robot runs.
    #[arg(value_name = "ROBOT|PID")]
    pub(crate) robot: Option<String>,
    /// How many cycles.
    #[arg(long, value_name = "N", default_value_t = 100,
          value_parser = clap::value_parser!(u32).range(1..=i64::from(Request::MOST_CYCLES)))]
    pub(crate) cycles: u32,
    /// The file to write.
    #[arg(long, short, value_name = "FILE.json")]
    pub(crate) output: PathBuf,
    #[command(flatten)]
    pub(crate) force: Force,
}

#[derive(Args)]
pub(crate) struct ExposeArguments {
    /// The robot's name, or the number of its process.
    #[arg(value_name = "ROBOT|PID")]
    pub(crate) robot: String,
    #[command(subcommand)]
    pub(crate) change: ExposeCommand,
}

#[derive(Subcommand)]
pub(crate) enum ExposeCommand {
    /// Print what is exposed.
    List {
        /// As JSON.
        #[arg(long)]
        json: bool,
    },
    /// Expose more, until the robot stops.
    Add(ExposeAddArguments),
    /// Take back what is exposed: its endpoints disappear from ROS 2 at once.
    Remove {
        /// Names of topics in ROS 2 or in the robot, or patterns: * within a part of a name, ** across parts.
        #[arg(required = true, value_name = "TOPIC")]
        topics: Vec<String>,
    },
}

#[derive(Args)]
pub(crate) struct ExposeAddArguments {
    /// "out" for topics that the robot publishes, "in" for topics that it receives.
    #[arg(value_enum)]
    pub(crate) direction: ExposeDirection,
    /// Topics of the robot, by name or pattern.
    #[arg(required = true, value_name = "TOPIC")]
    pub(crate) topics: Vec<String>,
    /// The name in ROS 2; the wildcards of a pattern stand for what they matched.
    #[arg(long = "as", value_name = "NAME")]
    pub(crate) ros_topic: Option<String>,
    /// The type that it has, or of a pattern the type that is meant.
    #[arg(long = "type", value_name = "TYPE")]
    pub(crate) type_name: Option<String>,
    /// What a pattern does not mean. May be given more than once.
    #[arg(long, value_name = "TOPIC")]
    pub(crate) except: Vec<String>,
    /// A QoS preset, or a table as in a robot file: '{ reliability = "best_effort", depth = 1 }'.
    #[arg(long, value_name = "QOS")]
    pub(crate) qos: Option<String>,
    /// At most so many messages per second.
    #[arg(long, value_name = "HZ")]
    pub(crate) rate_hz: Option<f64>,
    /// Only each n-th message.
    #[arg(long, value_name = "N")]
    pub(crate) every: Option<u32>,
    /// Of the messages of one cycle only the last.
    #[arg(long)]
    pub(crate) latest_only: bool,
    /// The node that has the endpoint, instead of the robot's.
    #[arg(long, value_name = "NODE")]
    pub(crate) node: Option<String>,
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum ExposeDirection {
    Out,
    In,
}

#[derive(Args)]
pub(crate) struct GraphArguments {
    /// The robot file; without one it is the network that is looked at.
    #[arg(value_name = "ROBOT.toml")]
    pub(crate) robot: Option<PathBuf>,
    /// How to show it: text for the network unless given, dot for a robot file.
    #[arg(long, value_enum)]
    pub(crate) format: Option<GraphFormat>,
    /// As JSON.
    #[arg(long, conflicts_with = "format")]
    pub(crate) json: bool,
    /// The ROS domain to look at, instead of ROS_DOMAIN_ID.
    #[arg(long, value_name = "N", conflicts_with = "robot")]
    pub(crate) domain: Option<u16>,
    /// How long to look at the most: until the nodes of all endpoints are known, which takes seconds.
    #[arg(long, value_parser = duration, value_name = "TIME", default_value = "8s", conflicts_with = "robot")]
    pub(crate) wait: Duration,
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum GraphFormat {
    /// Lines.
    Text,
    /// For programs.
    Json,
    /// For Graphviz: `downbeat graph robot.toml | dot -Tsvg > robot.svg`.
    Dot,
    /// For Mermaid, which pages of many code hosts show.
    Mermaid,
}

#[derive(Subcommand)]
pub(crate) enum BagCommand {
    /// Print what a bag holds, as `ros2 bag info` does.
    Info(InfoArguments),
    /// Record ROS 2 topics from the network, or with --robot the topics inside a robot, into a new bag.
    ///
    /// The options are those of `ros2 bag record`. Space pauses and resumes.
    Record(Box<RecordArguments>),
    /// Play a bag to ROS 2, or with --into into a robot's modules.
    ///
    /// The options, services and keys are those of `ros2 bag play`.
    Play(Box<PlayArguments>),
    /// Run a robot's modules on what a bag says they received, and compare what they publish with the bag.
    ///
    /// The modules run as fast as they can, in the recorded cycles at their recorded times; detached modules by their recorded
    /// runs. Where a message differs the first one is told, with its time, topic and field, and the exit code is 1.
    Replay(ReplayArguments),
    /// Read a whole bag, and say what of it is not as it should be.
    Check(CheckBagArguments),
    /// Make a whole bag of what can be read of one whose recording was interrupted, or whose files are damaged.
    Repair(RepairArguments),
    /// Make the metadata.yaml of a bag again from its files.
    Reindex(ReindexArguments),
    /// Write a bag anew: merge several, leave out topics, compress.
    Convert(ConvertArguments),
    /// Write a part of a bag, from one time to another, into a bag of its own.
    Cut(CutArguments),
    /// Compare two bags message by message; where they differ the first difference is told, and the exit code is 1.
    Diff(DiffArguments),
    /// Write topics as tables: CSV, JSON lines or Apache Parquet, one file for each.
    Export(ExportArguments),
    /// Draw fields of messages over time, as SVG or PNG.
    #[cfg(feature = "plots")]
    Plot(PlotArguments),
}

#[derive(Subcommand)]
pub(crate) enum EmulateCommand {
    /// A CM-730 with 20 MX-28 servos behind a pseudo terminal, until Ctrl-C.
    #[command(name = "darwin_op")]
    DarwinOp {
        /// Where to put a link to the pseudo terminal.
        #[arg(long, value_name = "PATH")]
        link: PathBuf,
        /// Repeats a run: noise, jitter and random faults come from it.
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// A fault to emulate, with the time it lasts, counted from the start; may be given more than once.
        ///
        /// dead-servo:5@3s..6s (servo 5 without power), drop:0.01 (each answer lost with a probability of 1 %),
        /// drop:3x@500ms.. (the next three answers lost), flip:0.001@10s..20s (a bit of a byte of an answer
        /// flipped), close-port@8s..9s (unplugged, and plugged in again).
        #[arg(long, value_name = "FAULT")]
        fault: Vec<String>,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
