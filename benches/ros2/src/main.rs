//! Benchmarks of the bridge: round trips and throughput compared with pairs of rclpy and of Cyclone DDS in
//! the same run, the delay that the bridge adds, and its memory use over a long time.
//!
//! A contestant is a process: downbeat (a core, a bridge and DDS), or a Python program that uses rclpy or
//! `cyclonedds`. The Python programs need `DOWNBEAT_PYTHON`, the path of an interpreter that has these
//! packages. All traffic stays on this machine.

mod added_delay;
mod contest;
mod contestant;
mod control_loop;
#[cfg(feature = "zenoh")]
mod fleet;
mod football;
#[cfg(feature = "security")]
mod gathering;
mod hold;
mod hostile;
mod images;
#[cfg(feature = "security")]
mod keystore;
mod meeting;
mod payload;
mod peer;
mod role;
#[cfg(feature = "zenoh")]
mod router;
mod wire;

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(about = "Benchmarks of the bridge, compared with rclpy and Cyclone DDS in the same run")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Round trips, throughput and processor time of pairs of processes.
    Pairs(contest::Options),
    /// Delay from the publish of a module until the bridge passes the bytes to the middleware.
    AddedDelay(added_delay::Options),
    /// A football robot, its topics exposed or not, with subscribers on rclpy and Cyclone DDS or without.
    Football(football::Options),
    /// The robot of `football`.
    #[command(hide = true)]
    FootballRobot(football::RobotOptions),
    /// Number of large messages that reach an rclpy node.
    Images(images::Options),
    /// 1000 messages per second to another process and back, with the memory use of both once a minute.
    Hold(hold::Options),
    /// Time until a process that joins is matched and has received a latched sample.
    Meeting(meeting::Options),
    /// Time until ten participants know each other, with DDS Security and without it.
    #[cfg(feature = "security")]
    Gathering(gathering::Options),
    /// Control loop with a period of 8 ms while hostile datagrams arrive.
    Hostile(hostile::Options),
    /// Control loop with a period of 8 ms while a camera sends a fleet on Zenoh more than its link takes.
    #[cfg(feature = "zenoh")]
    Fleet(fleet::Options),
    /// A subscriber of the camera of `fleet`.
    #[cfg(feature = "zenoh")]
    #[command(hide = true)]
    FleetSubscriber(fleet::SubscriberOptions),
    /// A router of Zenoh.
    #[cfg(feature = "zenoh")]
    #[command(hide = true)]
    Router,
    /// Sends hostile datagrams.
    #[command(hide = true)]
    Attacker(hostile::AttackerOptions),
    /// Round trips and streams of the engines alone: on DDS compared with bare UDP, rustdds (with the feature
    /// `rustdds`) and Cyclone DDS in C; on Zenoh (with the feature `zenoh`) with the bare crate `zenoh`.
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
        Command::Football(options) => football::run(&options),
        Command::FootballRobot(options) => football::run_robot(&options),
        Command::Images(options) => images::run(&options),
        Command::Hold(options) => hold::run(&options),
        Command::Meeting(options) => meeting::run(&options),
        #[cfg(feature = "security")]
        Command::Gathering(options) => gathering::run(&options),
        Command::Hostile(options) => hostile::run(&options),
        #[cfg(feature = "zenoh")]
        Command::Fleet(options) => fleet::run(&options),
        #[cfg(feature = "zenoh")]
        Command::FleetSubscriber(options) => fleet::subscribe(&options),
        #[cfg(feature = "zenoh")]
        Command::Router => router::run(),
        Command::Attacker(options) => hostile::attack(&options),
        Command::Wire(options) => wire::run(&options),
        Command::WirePeer(options) => wire::peer(&options),
        Command::Peer(options) => peer::run(&options),
    }
}
