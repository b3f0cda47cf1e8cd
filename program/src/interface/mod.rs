//! `downbeat interface`

mod decode;
mod description;
mod generate;
mod interfaces;
mod list;
mod packages;
mod show;

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

use downbeat_bridge::edge::Interfaces as Registered;
use downbeat_robot::Catalog;
pub(super) use interfaces::Interfaces;

pub(crate) fn interface(command: &InterfaceCommand, catalog: &Catalog) -> anyhow::Result<()> {
    let registered = &catalog.interfaces;
    match command {
        InterfaceCommand::List(arguments) => list::list(arguments, registered),
        InterfaceCommand::Show(arguments) => show::show(arguments, registered),
        InterfaceCommand::Hash(arguments) => description::hash(arguments, registered),
        InterfaceCommand::Description(arguments) => description::description(arguments, registered),
        InterfaceCommand::Decode(arguments) => decode::decode(arguments, registered),
        InterfaceCommand::Generate(arguments) => generate::generate(arguments, registered),
    }
}

#[derive(Subcommand)]
pub(crate) enum InterfaceCommand {
    /// List interfaces, like `ros2 interface list`.
    List(ListArguments),
    /// Print the definition of a type with nested types, like `ros2 interface show`.
    Show(ShowArguments),
    /// Print the RIHS01 hash of a type, which both ends of a connection compare.
    Hash(HashArguments),
    /// Print the type description of a type in JSON, as in the `.json` files of ROS 2 packages.
    Description(DescriptionArguments),
    /// Decode a message and print it in YAML, like `ros2 topic echo`.
    ///
    /// The input is a message as in a bag or on the wire: CDR with its four-byte header. Errors name the byte
    /// and the field.
    Decode(DecodeArguments),
    /// Write C or C++ headers of interfaces for modules in libraries, and of all that these refer to.
    Generate(GenerateArguments),
}

/// The source of definitions.
#[derive(Args)]
pub(crate) struct SourceArguments {
    /// Search definitions here first: an ament prefix, a folder with packages at any depth, or a package. May
    /// be given more than once: earlier ones take precedence.
    #[arg(long, value_name = "PATH")]
    pub(crate) from: Vec<PathBuf>,
}

#[derive(Args)]
pub(crate) struct ListArguments {
    /// Only these packages.
    #[arg(value_name = "PACKAGE")]
    pub(crate) packages: Vec<String>,
    /// Only messages; may be combined with --only-srvs and --only-actions.
    #[arg(short = 'm', long)]
    pub(crate) only_msgs: bool,
    /// Only services.
    #[arg(short = 's', long)]
    pub(crate) only_srvs: bool,
    /// Only actions.
    #[arg(short = 'a', long)]
    pub(crate) only_actions: bool,
    /// Include the parts of services and actions: requests, responses, events, goals, results, feedback.
    #[arg(long)]
    pub(crate) all: bool,
    /// Print JSON: for each type its name, and the file of its definition.
    #[arg(long)]
    pub(crate) json: bool,
    #[command(flatten)]
    pub(crate) source: SourceArguments,
}

/// One type or all.
#[derive(Args)]
pub(crate) struct TypeArguments {
    /// The type, for example sensor_msgs/msg/JointState; `-` reads its name from standard input.
    #[arg(value_name = "TYPE", required_unless_present = "all", conflicts_with = "all")]
    pub(crate) name: Option<String>,
    /// All types, including the parts of services and actions.
    #[arg(long)]
    pub(crate) all: bool,
    #[command(flatten)]
    pub(crate) source: SourceArguments,
}

#[derive(Args)]
pub(crate) struct ShowArguments {
    #[command(flatten)]
    pub(crate) types: TypeArguments,
    /// Also show the comments of nested types.
    #[arg(long, conflicts_with = "no_comments")]
    pub(crate) all_comments: bool,
    /// Show no comments and no empty lines.
    #[arg(long)]
    pub(crate) no_comments: bool,
    /// Print JSON: the fields and constants of the type and each nested type.
    #[arg(long, conflicts_with_all = ["all_comments", "no_comments"])]
    pub(crate) json: bool,
}

#[derive(Args)]
pub(crate) struct HashArguments {
    #[command(flatten)]
    pub(crate) types: TypeArguments,
    /// Print JSON, as in the `.json` files of ROS 2 packages.
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args)]
pub(crate) struct DescriptionArguments {
    #[command(flatten)]
    pub(crate) types: TypeArguments,
    /// Has no effect: a description is always printed in JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args)]
pub(crate) struct DecodeArguments {
    /// The type, for example sensor_msgs/msg/JointState; for a service or an action one of its messages, for
    /// example std_srvs/srv/SetBool_Request.
    #[arg(value_name = "TYPE")]
    pub(crate) name: String,
    /// Read the bytes from this file instead of standard input.
    #[arg(long, value_name = "FILE")]
    pub(crate) file: Option<PathBuf>,
    /// Print JSON on one line instead of YAML.
    #[arg(long)]
    pub(crate) json: bool,
    #[command(flatten)]
    pub(crate) source: SourceArguments,
}

#[derive(Args)]
pub(crate) struct GenerateArguments {
    /// The interfaces, for example sensor_msgs/msg/JointState; for a whole package its name.
    #[arg(value_name = "TYPE", required = true)]
    pub(crate) names: Vec<String>,
    /// The language of the headers.
    #[arg(long, value_enum)]
    pub(crate) lang: HeaderLanguage,
    /// Write to this folder, which compilers then search for headers.
    #[arg(long, value_name = "DIR", default_value = "include")]
    pub(crate) out: PathBuf,
    #[command(flatten)]
    pub(crate) source: SourceArguments,
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum HeaderLanguage {
    /// C11.
    C,
    /// C++17.
    Cpp,
}
