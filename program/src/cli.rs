//! The command line.

use std::ffi::OsString;
use std::path::PathBuf;
use std::time::Duration;

use clap::error::{ContextKind, ContextValue};
use clap::{Args, CommandFactory, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;
use downbeat_files::duration::parse as duration;
use downbeat_robot::RosArgs;
use downbeat_robot::features::built_without;
use downbeat_robot::inspect::Request;

use super::bag::bisect::BisectArguments;
use super::bag::check::CheckBagArguments;
use super::bag::convert::ConvertArguments;
use super::bag::cut::CutArguments;
#[cfg(unix)]
use super::bag::debug::DebugArguments;
use super::bag::diff::DiffArguments;
use super::bag::export::ExportArguments;
#[cfg(feature = "tables")]
use super::bag::import::ImportArguments;
use super::bag::info::InfoArguments;
use super::bag::latency::LatencyArguments;
use super::bag::play::PlayArguments;
#[cfg(feature = "plots")]
use super::bag::plot::PlotArguments;
use super::bag::record::arguments::RecordArguments;
use super::bag::reindex::ReindexArguments;
use super::bag::repair::RepairArguments;
use super::bag::replay::ReplayArguments;
#[cfg(feature = "view")]
use super::bag::view::ViewBagArguments;
use super::bag::why::WhyArguments;
use super::doctor::DoctorArguments;
use super::interface::InterfaceCommand;
use super::look::{ActionCommand, LifecycleCommand, NodeCommand, ParamCommand, ServiceCommand, TopicCommand};
use super::network::NetworkArguments;
use super::new::NewArguments;
use super::new_output::Force;
use super::parameters::ParameterArguments;
use super::robots::RobotsCommand;
use super::run::RunArguments;
#[cfg(feature = "security")]
use super::security::SecurityCommand;
use super::servo::ServoCommand;

/// Robot software as small modules in one process, exposed to ROS 2 Jazzy, recorded and replayed.
///
/// Environment: RMW_IMPLEMENTATION, ROS_DOMAIN_ID, ROS_AUTOMATIC_DISCOVERY_RANGE and ROS_SECURITY_* as ROS 2
/// reads them, and ZENOH_SESSION_CONFIG_URI and ZENOH_CONFIG_OVERRIDE as rmw_zenoh_cpp does; DOWNBEAT_LOG
/// sets what is logged, for example "debug" or "info,rustdds=warn". --ros-args is followed by the arguments
/// of every ROS 2 program: -r, -p, --params-file, --log-level and so on.
#[derive(Parser)]
#[command(name = "downbeat", version, arg_required_else_help = true)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
    /// The arguments after `--ros-args`, and ROS_NAMESPACE.
    #[arg(skip)]
    pub(crate) ros: RosArgs,
}

impl Cli {
    /// Parses the command line; exits with a message if it is invalid.
    pub(crate) fn parse_with_ros_args(line: impl IntoIterator<Item = OsString>) -> Self {
        let refuse = |problem: String| -> ! {
            Self::command().error(clap::error::ErrorKind::ValueValidation, problem).exit()
        };
        let (others, ros) = match RosArgs::split(line) {
            Ok((others, ros)) => (others, ros.with_variables(|name| std::env::var(name).ok())),
            Err(error) => refuse(error.to_string()),
        };
        let line: Vec<OsString> = others.into_iter().collect();
        let parsed = Self::try_parse_from(&line);
        let parsed = parsed.unwrap_or_else(|error| match missing_feature(&line, &error) {
            Some((option, feature)) => {
                refuse(format!("{option} is not in this program, {}", built_without(feature)))
            }
            None => error.exit(),
        });
        let mut cli = Self { ros, ..parsed };
        if let Command::Bag(BagCommand::Record(arguments)) = &cli.command
            && let Some(level) = arguments.log_level
        {
            cli.ros.log.level = Some(level.into());
        }
        let makes_node = match &cli.command {
            Command::Run(_) | Command::Check(_) | Command::Doctor(_) => true,
            Command::Topic(_) | Command::Node(_) | Command::Service(_) | Command::Param(_) => true,
            Command::Action(_) | Command::Lifecycle(_) => true,
            Command::Graph(arguments) => arguments.robot.is_none(),
            #[cfg(feature = "security")]
            Command::Security(command) => command.reads_robot(),
            Command::Bag(command) => command.makes_node(),
            _ => false,
        };
        if !makes_node && !cli.ros.is_empty() {
            refuse(
                "--ros-args is only for commands that create a ROS 2 node: run, check, doctor, graph of the network, topic, node, service, param, action, lifecycle, security check, security generate-policy, bag record, bag play, bag replay, bag debug"
                    .into(),
            );
        }
        cli
    }
}

/// The option in an error of the command line that a feature would add.
fn missing_feature(line: &[OsString], error: &clap::Error) -> Option<(String, &'static str)> {
    let Some(ContextValue::String(option)) = error.get(ContextKind::InvalidArg) else { return None };
    let name = option.split('=').next().unwrap_or_default();
    let feature = line.iter().find_map(|word| missing_option(word.to_str()?, name))?;
    Some((name.to_owned(), feature))
}

/// The options that features add to commands: the feature, whether this program has it, its options, and the
/// commands that have them.
const OPTIONS: [(&str, bool, &[&str], &[&str]); 2] = [
    ("top", cfg!(feature = "top"), &["--plot"], &["top"]),
    ("view", cfg!(feature = "view"), &["--view", "--foxglove", "--view-read-only"], &["run", "match"]),
];

/// The feature that has an option of a command, if this program lacks it.
fn missing_option(command: &str, option: &str) -> Option<&'static str> {
    missing_option_if(command, option, |is_built_in| is_built_in)
}

fn missing_option_if(
    command: &str,
    option: &str,
    is_built_in: impl Fn(bool) -> bool,
) -> Option<&'static str> {
    let missing = OPTIONS.iter().find(|(_, is_in_program, options, commands)| {
        !is_built_in(*is_in_program) && options.contains(&option) && commands.contains(&command)
    });
    missing.map(|(feature, ..)| *feature)
}

/// The arguments of a command that a feature would add, or another system has.
#[cfg(not(all(
    unix,
    feature = "football",
    feature = "plots",
    feature = "security",
    feature = "tables",
    feature = "view",
    feature = "zenoh"
)))]
#[derive(Args)]
#[command(disable_help_flag = true)]
pub(crate) struct NotBuiltIn {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    _arguments: Vec<OsString>,
}

#[derive(Subcommand)]
pub(crate) enum Command {
    /// Run a robot until Ctrl-C or for a time.
    Run(RunArguments),
    /// Let simulated robots play football, drawn in the terminal; ends with the match. All data is simulated.
    #[cfg(feature = "football")]
    Match(super::football::MatchArguments),
    /// (Not in this program, built without "football".) Let simulated robots play football.
    #[cfg(not(feature = "football"))]
    Match(NotBuiltIn),
    /// Run a robot of a match with --processes. The match starts it.
    #[cfg(feature = "football")]
    #[command(hide = true)]
    MatchRobot(super::football::robot::RobotArguments),
    /// Check a robot file and print its contents, without running it.
    Check(CheckArguments),
    /// Look at this machine and say what a robot needs of it: devices, real-time limits, network, clock and
    /// disk. Each line says what to do; exit code 1 if there is a problem.
    Doctor(DoctorArguments),
    /// List the robots that this program carries, or copy one: `run`, `check` and other commands for robot
    /// files take their names; `compose` edits a copy.
    #[command(subcommand)]
    Robots(RobotsCommand),
    /// Describe kinds of modules: what they are for, their settings, topics, services and actions.
    Describe(DescribeArguments),
    /// Compose a robot in a browser: its modules as a graph, checked while you edit. Prints the address of
    /// the page.
    #[cfg(feature = "view")]
    Compose(ComposeArguments),
    /// (Not in this program, built without "view".) Compose a robot in a browser.
    #[cfg(not(feature = "view"))]
    Compose(NotBuiltIn),
    /// Watch a running robot: its cycles, modules and topics, live.
    Top(TopArguments),
    /// Record a trace of the next cycles of a running robot, for Perfetto or chrome://tracing.
    Trace(TraceArguments),
    /// Open the page of a running robot and print its URL for a browser.
    #[cfg(feature = "view")]
    View(super::view::ViewRobot),
    /// (Not in this program, built without "view".) Open the page of a running robot.
    #[cfg(not(feature = "view"))]
    View(NotBuiltIn),
    /// Show what a running robot exposes to ROS 2, expose more, or remove topics.
    Expose(ExposeArguments),
    /// Show the nodes, topics and services of the ROS 2 network, or draw the modules of a robot file without
    /// running it.
    Graph(GraphArguments),
    /// Check the chart of a state machine and draw it: for Graphviz, or for Mermaid.
    #[cfg(feature = "state_machine")]
    Chart(ChartArguments),
    /// (Not in this program, built without "state_machine".) Check the chart of a state machine and draw it.
    #[cfg(not(feature = "state_machine"))]
    Chart(NotBuiltIn),
    /// Run a Zenoh router until Ctrl-C: nodes with RMW_IMPLEMENTATION=rmw_zenoh_cpp find each other through
    /// it.
    ///
    /// Environment: ZENOH_ROUTER_CONFIG_URI and ZENOH_CONFIG_OVERRIDE as rmw_zenohd reads them.
    #[cfg(feature = "zenoh")]
    Router,
    /// (Not in this program, built without "zenoh".) Run a Zenoh router.
    #[cfg(not(feature = "zenoh"))]
    Router(NotBuiltIn),
    /// Make keystores, enclaves and policies for protected networks (SROS2), and check a robot against them.
    #[cfg(feature = "security")]
    #[command(subcommand)]
    Security(SecurityCommand),
    /// (Not in this program, built without "security".) Make keystores for protected networks (SROS2).
    #[cfg(not(feature = "security"))]
    Security(NotBuiltIn),
    /// Inspect, record, play and process bags.
    #[command(subcommand)]
    Bag(BagCommand),
    /// Inspect ROS 2 interfaces: list them, show one, its hash, its description; decode a message; write C
    /// and C++ structs.
    ///
    /// Definitions come from --from, then from AMENT_PREFIX_PATH, then from this program: a package is taken
    /// completely from the first source that has it.
    #[command(subcommand)]
    Interface(InterfaceCommand),
    /// Inspect topics of the ROS 2 network, subscribe to them, publish on them.
    #[command(subcommand)]
    Topic(TopicCommand),
    /// Inspect nodes of the ROS 2 network.
    #[command(subcommand)]
    Node(NodeCommand),
    /// Inspect and call services of the ROS 2 network.
    #[command(subcommand)]
    Service(ServiceCommand),
    /// Inspect and set parameters of nodes of the ROS 2 network.
    #[command(subcommand)]
    Param(ParamCommand),
    /// Inspect actions of the ROS 2 network, and send goals.
    #[command(subcommand)]
    Action(ActionCommand),
    /// Inspect managed nodes of the ROS 2 network, and trigger transitions.
    #[command(subcommand)]
    Lifecycle(LifecycleCommand),
    /// Find serial servos, read and write their registers, change ids.
    #[command(subcommand)]
    Servo(ServoCommand),
    /// Calibrate the vision of football players.
    #[cfg(feature = "football")]
    #[command(subcommand)]
    Vision(super::vision::VisionCommand),
    /// (Not in this program, built without "football".) Calibrate the vision of football players.
    #[cfg(not(feature = "football"))]
    Vision(NotBuiltIn),
    /// Create your own project: a robot, or with --template a rover, an arm, a camera, a robot in Python or
    /// C++, or messages.
    New(NewArguments),
    /// Convert robot descriptions.
    #[command(subcommand)]
    Description(DescriptionCommand),
    /// Run only an emulated device.
    #[command(subcommand)]
    Emulate(EmulateCommand),
    /// Print a shell completion script for the commands and options of this program.
    ///
    /// For bash: downbeat completions bash > ~/.local/share/bash-completion/completions/downbeat
    Completions {
        /// The shell.
        #[arg(value_enum)]
        shell: Shell,
    },
    /// Write a man page for each command into a folder.
    ///
    /// For a user: downbeat man ~/.local/share/man/man1
    Man {
        /// The folder; it is created if it does not exist. Pages of the same names are replaced.
        #[arg(value_name = "DIR")]
        folder: PathBuf,
    },
    /// Run the library of a module with `isolate`. Robots start it.
    #[command(hide = true)]
    LibraryChild,
}

#[derive(Args)]
pub(crate) struct CheckArguments {
    /// The robot file.
    #[arg(value_name = "ROBOT.toml", required_unless_present = "kinds")]
    pub(crate) robot: Option<PathBuf>,
    /// Print the contents of the robot and what is exposed to ROS 2 as JSON.
    #[arg(long, requires = "robot", conflicts_with_all = ["kinds", "dump_params"])]
    pub(crate) json: bool,
    /// Print only a ROS 2 parameter file of all settings with their values.
    #[arg(long, requires = "robot", conflicts_with = "kinds")]
    pub(crate) dump_params: bool,
    #[command(flatten)]
    pub(crate) parameters: ParameterArguments,
    /// List the kinds of modules with their topics and settings.
    #[arg(long)]
    pub(crate) kinds: bool,
}

#[derive(Args)]
pub(crate) struct DescribeArguments {
    /// The kinds; all without one. With --robot, modules by name or kind.
    #[arg(value_name = "KIND")]
    pub(crate) kinds: Vec<String>,
    /// Describe the modules of this robot file, with its settings: also those in Python and in shared
    /// libraries.
    #[arg(long, short = 'a', value_name = "ROBOT.toml", conflicts_with = "set")]
    pub(crate) robot: Option<PathBuf>,
    /// Describe the kind with this setting, or key of its [[module]], in YAML: ports may depend on it. May be
    /// given more than once.
    #[arg(short = 'p', long = "param", value_name = "NAME:=VALUE")]
    pub(crate) set: Vec<String>,
    /// Print JSON; docs/compose.md describes its form.
    #[arg(long)]
    pub(crate) json: bool,
}

#[cfg(feature = "view")]
#[derive(Args)]
pub(crate) struct ComposeArguments {
    /// The robot file; it may not exist yet.
    #[arg(value_name = "ROBOT.toml")]
    pub(crate) robot: PathBuf,
    /// The port of the page; 7373, or a free one where that is in use.
    #[arg(long, value_name = "PORT")]
    pub(crate) port: Option<u16>,
    /// Answer questions on standard input, one JSON object per line, instead of a page: for other editors.
    #[arg(long, conflicts_with = "port")]
    pub(crate) stdio: bool,
}

#[derive(Args)]
pub(crate) struct TopArguments {
    /// The robot's name or process id; not needed if only one robot is running.
    #[arg(value_name = "ROBOT|PID")]
    pub(crate) robot: Option<String>,
    /// Print one snapshot as text and exit; rates are averages since the robot's start.
    #[arg(long)]
    pub(crate) once: bool,
    /// Print one snapshot as JSON and exit, with or without --once.
    #[arg(long)]
    pub(crate) json: bool,
    /// Plot a field over time, up to six: "joint_states:position[3]", or by element name
    /// "joint_states:position[head_tilt]".
    #[cfg(feature = "top")]
    #[arg(long, value_name = "TOPIC:FIELD", conflicts_with_all = ["once", "json"])]
    pub(crate) plot: Vec<super::topic_field::TopicField>,
}

#[derive(Args)]
pub(crate) struct TraceArguments {
    /// The robot's name or process id; not needed if only one robot is running.
    #[arg(value_name = "ROBOT|PID")]
    pub(crate) robot: Option<String>,
    /// The number of cycles.
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
    /// The robot's name or process id.
    #[arg(value_name = "ROBOT|PID")]
    pub(crate) robot: String,
    #[command(subcommand)]
    pub(crate) change: ExposeCommand,
}

#[derive(Subcommand)]
pub(crate) enum ExposeCommand {
    /// Print what is exposed.
    List {
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
    /// Expose more, until the robot stops.
    Add(ExposeAddArguments),
    /// Stop exposing topics: their endpoints disappear from ROS 2 at once.
    Remove {
        /// Names of topics in ROS 2 or in the robot, or patterns: * within a part of a name, ** across parts.
        #[arg(required = true, value_name = "TOPIC")]
        topics: Vec<String>,
    },
}

#[derive(Args)]
pub(crate) struct ExposeAddArguments {
    /// "out" for topics that the robot publishes, "in" for topics that it subscribes to.
    #[arg(value_enum)]
    pub(crate) direction: ExposeDirection,
    /// Topics of the robot, by name or pattern.
    #[arg(required = true, value_name = "TOPIC")]
    pub(crate) topics: Vec<String>,
    /// The name in ROS 2; the wildcards of a pattern stand for what they matched.
    #[arg(long = "as", value_name = "NAME")]
    pub(crate) ros_topic: Option<String>,
    /// The type of the topic; for a pattern, the type to select.
    #[arg(long = "type", value_name = "TYPE")]
    pub(crate) type_name: Option<String>,
    /// Names that a pattern does not select. May be given more than once.
    #[arg(long, value_name = "TOPIC")]
    pub(crate) except: Vec<String>,
    /// A QoS preset, or a table as in a robot file: '{ reliability = "best_effort", depth = 1 }'.
    #[arg(long, value_name = "QOS")]
    pub(crate) qos: Option<String>,
    /// At most this many messages per second.
    #[arg(long, value_name = "HZ")]
    pub(crate) rate_hz: Option<f64>,
    /// Only every n-th message.
    #[arg(long, value_name = "N")]
    pub(crate) every: Option<u32>,
    /// Only the last message of each cycle.
    #[arg(long)]
    pub(crate) latest_only: bool,
    /// On Zenoh: what waits for what on a slow link: real_time, interactive_high, interactive_low, data_high,
    /// data, data_low or background.
    #[arg(long, value_name = "PRIORITY")]
    pub(crate) priority: Option<String>,
    /// On Zenoh: each message goes at once, without waiting for others that fit into the same packet.
    #[arg(long)]
    pub(crate) express: bool,
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
    /// The robot file; without one, the ROS 2 network is shown.
    #[arg(value_name = "ROBOT.toml", conflicts_with_all = ["domain", "engine", "connect"])]
    pub(crate) robot: Option<PathBuf>,
    /// The format; default is text for the network, dot for a robot file.
    #[arg(long, value_enum)]
    pub(crate) format: Option<GraphFormat>,
    /// Print JSON.
    #[arg(long, conflicts_with = "format")]
    pub(crate) json: bool,
    #[command(flatten)]
    pub(crate) network: NetworkArguments,
    /// The maximum time to search until the nodes of all endpoints are known, which takes seconds.
    #[arg(long, value_parser = duration, value_name = "TIME", default_value = "8s", conflicts_with = "robot")]
    pub(crate) wait: Duration,
}

#[cfg(feature = "state_machine")]
#[derive(Args)]
pub(crate) struct ChartArguments {
    /// The chart.
    #[arg(value_name = "FILE.scxml")]
    pub(crate) file: PathBuf,
    /// Draw for Mermaid, which many code hosts render, instead of for Graphviz.
    #[arg(long)]
    pub(crate) mermaid: bool,
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum GraphFormat {
    /// Lines.
    Text,
    /// For programs.
    Json,
    /// For Graphviz: `downbeat graph robot.toml | dot -Tsvg > robot.svg`.
    Dot,
    /// For Mermaid, which many code hosts render.
    Mermaid,
}

impl BagCommand {
    /// Whether the arguments of a ROS 2 program concern the command.
    fn makes_node(&self) -> bool {
        #[cfg(unix)]
        if matches!(self, Self::Debug(_)) {
            return true;
        }
        matches!(self, Self::Record(_) | Self::Play(_) | Self::Replay(_))
    }
}

#[derive(Subcommand)]
pub(crate) enum BagCommand {
    /// Print the contents of a bag, like `ros2 bag info`.
    Info(InfoArguments),
    /// Record ROS 2 topics from the network, or with --robot the topics inside a robot, into a new bag.
    ///
    /// The options are those of `ros2 bag record`. Space pauses and resumes.
    Record(Box<RecordArguments>),
    /// Play a bag to ROS 2, or with --into into a robot's modules.
    ///
    /// The options, services and keys are those of `ros2 bag play`.
    Play(Box<PlayArguments>),
    /// Run a robot's modules on the messages that they received according to a bag, and compare what they
    /// publish with it.
    ///
    /// The modules run as fast as possible, in the recorded cycles at their recorded times; detached modules
    /// follow their recorded runs. If a message differs, the first difference is printed with its time, topic
    /// and field, and the exit code is 1.
    Replay(ReplayArguments),
    /// Walk through a recorded run: stand at a cycle, see which modules ran and why, what they received,
    /// published and held, and go on or back.
    ///
    /// The modules run as in `bag replay`, once to the end, which leaves checkpoints; from then on every
    /// cycle is near. Type `help` for the commands.
    #[cfg(unix)]
    Debug(Box<DebugArguments>),
    /// (Not on this system, which has no `fork`.) Walk through a recorded run.
    #[cfg(not(unix))]
    Debug(NotBuiltIn),
    /// Find the revision in git from which on a replay differs from a bag, by `git bisect`.
    Bisect(BisectArguments),
    /// Read a whole bag and report problems.
    Check(CheckBagArguments),
    /// Create a complete bag from the readable parts of an interrupted or damaged one.
    Repair(RepairArguments),
    /// Recreate the metadata.yaml of a bag from its files.
    Reindex(ReindexArguments),
    /// Convert bags: merge several, leave out topics, compress.
    Convert(ConvertArguments),
    /// Write the part of a bag between two times into a new bag.
    Cut(CutArguments),
    /// Compare two bags message by message; if they differ, print the first difference and exit with code 1.
    Diff(DiffArguments),
    /// Write topics as tables, CSV, JSON lines or Apache Parquet, one file per topic; or demonstrations as a
    /// data set of LeRobot.
    Export(ExportArguments),
    /// Write a data set of LeRobot as a bag, to be looked at and played.
    #[cfg(feature = "tables")]
    Import(ImportArguments),
    /// (Not in this program, built without "tables".) Write a data set of LeRobot as a bag.
    #[cfg(not(feature = "tables"))]
    Import(NotBuiltIn),
    /// Print why a message was published: the runs of modules that led to it, back to what came from outside.
    ///
    /// In a bag that was recorded in a robot this is exact, if it has the topic module_runs. In other bags,
    /// causes are guessed from the stamps of messages.
    Why(WhyArguments),
    /// Print how old the newest message of one topic is on which each message of another topic depends.
    Latency(LatencyArguments),
    /// Draw fields of messages over time, as SVG or PNG.
    #[cfg(feature = "plots")]
    Plot(PlotArguments),
    /// (Not in this program, built without "plots".) Draw fields of messages over time.
    #[cfg(not(feature = "plots"))]
    Plot(NotBuiltIn),
    /// Show bags to Foxglove, Lichtblick and PlotJuggler: play, pause and seek there.
    #[cfg(feature = "view")]
    View(ViewBagArguments),
    /// (Not in this program, built without "view".) Show bags to Foxglove, Lichtblick and PlotJuggler.
    #[cfg(not(feature = "view"))]
    View(NotBuiltIn),
}

#[derive(Subcommand)]
pub(crate) enum DescriptionCommand {
    /// Print a URDF as MJCF, for MuJoCo.
    Mjcf {
        /// The URDF file.
        #[arg(value_name = "FILE.urdf")]
        urdf: PathBuf,
        /// The root is fixed to the world, instead of moving freely.
        #[arg(long)]
        fixed: bool,
    },
}

#[derive(Subcommand)]
pub(crate) enum EmulateCommand {
    /// A CM-730 with 20 MX-28 servos behind a pseudo terminal, until Ctrl-C.
    #[command(name = "darwin_op")]
    DarwinOp {
        /// Path of the link to the pseudo terminal.
        #[arg(long, value_name = "PATH")]
        link: PathBuf,
        /// Seed of noise, jitter and random faults, for reproducible runs.
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// A fault to emulate, with its time span since the start; may be given more than once.
        ///
        /// dead-servo:5@3s..6s (servo 5 without power), drop:0.01 (each answer lost with a probability of 1
        /// %), drop:3x@500ms.. (the next three answers lost), flip:0.001@10s..20s (a bit of a byte of an
        /// answer flipped), close-port@8s..9s (unplugged, and plugged in again).
        #[arg(long, value_name = "FAULT")]
        fault: Vec<String>,
    },
    /// The servos of a description behind a pseudo terminal, until Ctrl-C.
    Servos {
        /// The file that describes them, as for the kind servo_bus.
        #[arg(value_name = "SERVOS.toml")]
        description: String,
        /// The bus, if there are several.
        #[arg(long, value_name = "NAME", default_value = "")]
        bus: String,
        /// Path of the link to the pseudo terminal.
        #[arg(long, value_name = "PATH")]
        link: PathBuf,
        /// Seed of the starting pose and of random faults, for reproducible runs.
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// A fault to emulate, as for darwin_op; may be given more than once. Beside those, twin:3 (a second
        /// servo with the id 3) and supply:12.1 (a supply of 12.1 V).
        #[arg(long, value_name = "FAULT")]
        fault: Vec<String>,
        /// Turn joints by hand: a line `turn JOINT RAD` on standard input turns one to that angle.
        #[arg(long)]
        by_hand: bool,
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
