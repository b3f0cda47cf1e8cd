//! What the bridge costs: round trips and throughput beside pairs of rclpy and of Cyclone DDS in the same run, the delay
//! that it adds itself, and its memory after a long time.
//!
//! A contestant is a process: downbeat (a core, a bridge and DDS), or a Python program on rclpy or `cyclonedds`, which need
//! `DOWNBEAT_PYTHON`, an interpreter that has them. All stay on this machine.

mod added_delay;
mod contest;
mod contestant;
mod hold;
mod hostile;
mod images;
mod meeting;
mod payload;
mod peer;
mod wire;

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(about = "What the bridge costs, beside rclpy and Cyclone DDS in the same run")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Round trips and throughput of pairs of processes, and the processor time they take.
    Pairs(contest::Options),
    /// From the publish of a module until the bridge hands the bytes to the middleware.
    AddedDelay(added_delay::Options),
    /// How many large messages reach an rclpy node.
    Images(images::Options),
    /// 1000 messages a second to another process and back, and the memory of both each minute.
    Hold(hold::Options),
    /// How fast a process that joins is matched and has a latched sample.
    Meeting(meeting::Options),
    /// A loop of 8 ms while hostile datagrams come in.
    Hostile(hostile::Options),
    /// Sends hostile datagrams.
    #[command(hide = true)]
    Attacker(hostile::AttackerOptions),
    /// Round trips and streams of the engine alone, beside bare UDP, rustdds (with that feature) and Cyclone DDS in C.
    Wire(wire::Options),
    /// One end of a pair of `wire`.
    #[command(hide = true)]
    WirePeer(wire::PeerOptions),
    /// One end of a pair; its results are lines of JSON.
    #[command(hide = true)]
    Peer(peer::Options),
}

fn main() -> anyhow::Result<()> {
    match Cli::parse().command {
        Command::Pairs(options) => contest::run(&options),
        Command::AddedDelay(options) => added_delay::run(&options),
        Command::Images(options) => images::run(&options),
        Command::Hold(options) => hold::run(&options),
        Command::Meeting(options) => meeting::run(&options),
        Command::Hostile(options) => hostile::run(&options),
        Command::Attacker(options) => hostile::attack(&options),
        Command::Wire(options) => wire::run(&options),
        Command::WirePeer(options) => wire::peer(&options),
        Command::Peer(options) => peer::run(&options),
    }
}
