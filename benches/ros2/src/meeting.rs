//! Measures how fast a process that joins discovers one that is running, compared with a pair of rclpy
//! processes in the same run.

use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

use anyhow::Context;
use downbeat_bridge::middleware::ParticipantOptions;
use downbeat_bridge::ros::{MessageType, Node, NodeName, Participant};
use downbeat_msgs::cdr;
use downbeat_msgs::qos::QosProfile;
use serde::{Deserialize, Serialize};

use crate::contestant::{Contestant, Kind, Task};
use crate::payload;
use crate::role::Role;

/// How long two processes may take to discover each other.
const PATIENCE: Duration = Duration::from_secs(20);
const TYPE: &str = "std_msgs/msg/UInt8MultiArray";

#[derive(clap::Args)]
pub struct Options {
    /// Number of processes that join one after the other; the medians are printed.
    #[arg(long, default_value_t = 10)]
    rounds: usize,
    /// The ROS domain.
    #[arg(long, default_value_t = 100)]
    domain: u16,
}

/// The process that is running and the process that joins.
const PAIRS: [(Kind, Kind); 4] = [
    (Kind::Downbeat, Kind::Downbeat),
    (Kind::Downbeat, Kind::Rclpy),
    (Kind::Rclpy, Kind::Downbeat),
    (Kind::Rclpy, Kind::Rclpy),
];

/// Times since the process that joins began to create its node.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Meeting {
    /// Until its publisher is matched with the subscription of the other process.
    matched_ms: f64,
    /// Until its subscription has received the latched sample of the other process.
    latched_ms: f64,
}

pub fn run(options: &Options) -> anyhow::Result<()> {
    anyhow::ensure!(options.rounds > 0, "--rounds must be at least 1");
    println!(
        "| running | joins | matched, median (max) | latched sample received |\n| --- | --- | --- | --- |"
    );
    for (running, joining) in PAIRS {
        let task = Task { size: 100, window: 1, seconds: 0.0, domain_id: options.domain };
        let host = Contestant::start(running, Role::Latch, &task)?;
        let meetings = (0..options.rounds)
            .map(|_| {
                let mut late = Contestant::start(joining, Role::Late, &task)?;
                let meeting: Meeting = late.outcome()?;
                late.end()?;
                Ok(meeting)
            })
            .collect::<anyhow::Result<Vec<_>>>()?;
        host.end()?;
        let figure = |of: fn(&Meeting) -> f64| {
            let mut values: Vec<f64> = meetings.iter().map(of).collect();
            values.sort_by(f64::total_cmp);
            format!("{:.1} ms ({:.1})", values[values.len() / 2], values[values.len() - 1])
        };
        println!(
            "| {} | {} | {} | {} |",
            running.name(),
            joining.name(),
            figure(|meeting| meeting.matched_ms),
            figure(|meeting| meeting.latched_ms)
        );
    }
    Ok(())
}

/// Offers a latched sample and a subscription until the input ends.
pub fn latch() -> anyhow::Result<()> {
    let node = join("downbeat_latch")?;
    let of = MessageType::new(TYPE)?;
    let publisher = node.publish("latched", &of, QosProfile::LATCHED)?;
    publisher.publish(cdr::to_vec(&payload::message(1, 100)).into())?;
    let _subscription = node.subscribe("ping", &of, QosProfile::DEFAULT, Box::new(drop))?;
    std::io::copy(&mut std::io::stdin(), &mut std::io::sink())?;
    Ok(())
}

/// Joins and prints how long it took to discover the running process.
pub fn late() -> anyhow::Result<()> {
    let start = Instant::now();
    let node = join("downbeat_late")?;
    let of = MessageType::new(TYPE)?;
    let (sender, received) = channel();
    let take = Box::new(move |_| {
        // Only the first sample counts.
        let _ = sender.send(start.elapsed());
    });
    let publisher = node.publish("ping", &of, QosProfile::DEFAULT)?;
    let _subscription = node.subscribe("latched", &of, QosProfile::LATCHED, take)?;
    while publisher.matched_subscriptions() == 0 {
        anyhow::ensure!(start.elapsed() < PATIENCE, "no subscription within {PATIENCE:?}");
        std::thread::sleep(Duration::from_micros(200));
    }
    let matched = start.elapsed();
    let latched = received.recv_timeout(PATIENCE).context("no latched sample")?;
    let ms = |time: Duration| time.as_secs_f64() * 1e3;
    let meeting = Meeting { matched_ms: ms(matched), latched_ms: ms(latched) };
    println!("{}", serde_json::to_string(&meeting)?);
    Ok(())
}

fn join(name: &str) -> anyhow::Result<Node> {
    Ok(Participant::join(&ParticipantOptions::from_env()?)?.create_node(NodeName::new("/", name)?)?)
}
