//! The command line of `downbeat interface`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

#[derive(Subcommand)]
pub(crate) enum InterfaceCommand {
    /// List the interfaces there are, as `ros2 interface list` does.
    List(ListArguments),
    /// Print the definition of a type with those of the types in it, as `ros2 interface show` does.
    Show(ShowArguments),
    /// Print the RIHS01 hash of a type, by which both ends of a connection know that they mean the same.
    Hash(HashArguments),
    /// Print the type description of a type in JSON, as the `.json` files of ROS 2 packages have it.
    Description(DescriptionArguments),
    /// Read a message from its bytes and print it in YAML, as `ros2 topic echo` does.
    ///
    /// The bytes are those of a message in a bag or on the wire: CDR with its header of four bytes. What is wrong with them
    /// is told with the byte and the field.
    Decode(DecodeArguments),
}

/// Where definitions come from.
#[derive(Args)]
pub(crate) struct SourceArguments {
    /// Take definitions from here before all others: an ament prefix, a folder of packages, or a package. May be
    /// given more than once: earlier ones win.
    #[arg(long, value_name = "PATH")]
    pub(crate) from: Vec<PathBuf>,
}

#[derive(Args)]
pub(crate) struct ListArguments {
    /// Only these packages.
    #[arg(value_name = "PACKAGE")]
    pub(crate) packages: Vec<String>,
    /// Messages; with --only-srvs or --only-actions those too.
    #[arg(short = 'm', long)]
    pub(crate) only_msgs: bool,
    /// Services.
    #[arg(short = 's', long)]
    pub(crate) only_srvs: bool,
    /// Actions.
    #[arg(short = 'a', long)]
    pub(crate) only_actions: bool,
    /// Also what services and actions are made of: requests, responses, events, goals, results, feedback.
    #[arg(long)]
    pub(crate) all: bool,
    /// Print JSON: for each type its name, and the file its definition is from.
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
    /// All types, and what services and actions are made of.
    #[arg(long)]
    pub(crate) all: bool,
    #[command(flatten)]
    pub(crate) source: SourceArguments,
}

#[derive(Args)]
pub(crate) struct ShowArguments {
    #[command(flatten)]
    pub(crate) types: TypeArguments,
    /// Show the comments of the types in it, too.
    #[arg(long, conflicts_with = "no_comments")]
    pub(crate) all_comments: bool,
    /// Show no comments and no empty lines.
    #[arg(long)]
    pub(crate) no_comments: bool,
    /// Print JSON: for the type and each type in it the fields and constants.
    #[arg(long, conflicts_with_all = ["all_comments", "no_comments"])]
    pub(crate) json: bool,
}

#[derive(Args)]
pub(crate) struct HashArguments {
    #[command(flatten)]
    pub(crate) types: TypeArguments,
    /// Print JSON, as the `.json` files of ROS 2 packages have the hashes.
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args)]
pub(crate) struct DescriptionArguments {
    #[command(flatten)]
    pub(crate) types: TypeArguments,
    /// Changes nothing: a description is always printed in JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args)]
pub(crate) struct DecodeArguments {
    /// The type, for example sensor_msgs/msg/JointState; of a service or an action one of its messages, for example
    /// std_srvs/srv/SetBool_Request.
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
