//! Runs a control loop at 125 Hz in a robot that is on DDS and, through a second network, in a fleet on
//! Zenoh, while a camera sends the fleet more than its link takes.
//!
//! The link is slow because its subscriber is: TCP then takes no more.

use std::collections::BTreeMap;
use std::process::Command;
use std::time::{Duration, Instant};

use downbeat_bridge::edge::Interfaces;
use downbeat_bridge::expose::{Bridge, Exposure, NetworkNodes};
use downbeat_bridge::middleware::{Direction, Engine, ParticipantOptions, Sample};
use downbeat_bridge::ros::{MessageType, NodeName, Participant};
use downbeat_executor::{Core, Module, Setup, SetupError};
use downbeat_msgs::cdr;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::std_msgs::msg::UInt8MultiArray;

use crate::contestant::Contestant;
use crate::control_loop::{ControlLoop, PERIOD, Times, cells};
use crate::payload;
use crate::peer::{Running, on_this_machine, quantile_us};
use crate::role::GO;
use crate::router::{LocalRouter, sessions_of};

#[derive(clap::Args)]
pub struct Options {
    /// How long each part of a round lasts.
    #[arg(long, default_value_t = 5.0)]
    seconds: f64,
    /// Number of rounds; the times of all rounds are counted together.
    #[arg(long, default_value_t = 5)]
    rounds: usize,
    /// Megabytes per second that the slow link takes; the camera sends 125.
    #[arg(long, default_value_t = 10.0)]
    link: f64,
    /// The ROS domain.
    #[arg(long, default_value_t = 102)]
    domain: u16,
}

#[derive(clap::Args)]
pub struct SubscriberOptions {
    #[arg(long)]
    router: String,
    #[arg(long)]
    domain: u16,
    /// Megabytes per second that it takes; all if it is not given.
    #[arg(long)]
    link: Option<f64>,
}

const TYPE: &str = "std_msgs/msg/UInt8MultiArray";
const FLEET: &str = "fleet";
const PICTURE: usize = 1_000_000;

/// A part of a round, and what was measured in all rounds.
struct Part {
    name: &'static str,
    is_subscribed: bool,
    link: Option<f64>,
    lateness: Vec<Duration>,
    ages: Vec<Duration>,
    pictures: u64,
}

pub fn run(options: &Options) -> anyhow::Result<()> {
    anyhow::ensure!(options.rounds > 0, "--rounds must be at least 1");
    let router = LocalRouter::start()?;
    let robot = Participant::join(&on_this_machine(options.domain)?)?;
    let fleet = Participant::join(&in_the_fleet(options.domain, &router.endpoint)?)?;
    let name = || NodeName::new("/", "downbeat_loop");
    let (node, fleet_node) = (robot.create_node(name()?)?, fleet.create_node(name()?)?);

    let (lateness, ages) = (Times::default(), Times::default());
    let mut core = Core::new();
    let control_loop = ControlLoop::new(&lateness);
    let on_sample = {
        let (start, ages) = (control_loop.start(), ages.clone());
        move |sample: Sample| {
            let number = cdr::from_slice(&sample.cdr).ok().and_then(|message| payload::number(&message));
            if let Some(sent) = number.map(Duration::from_nanos) {
                ages.push(start.elapsed().saturating_sub(sent));
            }
        }
    };
    core.add("loop", control_loop)?;
    core.add("camera", Camera)?;
    let of = Interfaces::carried().message(TYPE)?;
    let exposures = [
        Exposure::new("ping", of, Direction::Out),
        Exposure { network: Some(FLEET.to_owned()), ..Exposure::new("camera", of, Direction::Out) },
    ];
    let networks = BTreeMap::from([(FLEET.to_owned(), fleet_node)]);
    let status = Bridge::start(&mut core, NetworkNodes::new(node.clone(), networks), &exposures)?.status();
    let running = Running::run(core, status)?;
    let listener = Participant::join(&on_this_machine(options.domain)?)?;
    let listener = listener.create_node(NodeName::new("/", "listener")?)?;
    let _subscription =
        listener.subscribe("ping", &MessageType::new(TYPE)?, QosProfile::DEFAULT, Box::new(on_sample))?;

    let part = |name, is_subscribed, link| Part {
        name,
        is_subscribed,
        link,
        lateness: Vec::new(),
        ages: Vec::new(),
        pictures: 0,
    };
    let mut parts = [
        part("nobody", false, None),
        part("at full speed", true, None),
        part("over a slow link", true, Some(options.link)),
    ];
    for _ in 0..options.rounds {
        for part in &mut parts {
            let start = || subscriber(options.domain, &router.endpoint, part.link);
            let mut subscriber = part.is_subscribed.then(start).transpose()?;
            // The link fills up.
            std::thread::sleep(Duration::from_secs(1));
            ages.clear();
            part.lateness.extend(lateness.of(Duration::from_secs_f64(options.seconds)));
            part.ages.extend(ages.take());
            if let Some(subscriber) = &mut subscriber {
                part.pictures += subscriber.count()?;
            }
            subscriber.map_or(Ok(()), Contestant::end)?;
        }
    }
    running.stop()?;
    print(&mut parts);
    Ok(())
}

fn print(parts: &mut [Part]) {
    println!(
        "| subscriber of the camera | the loop of 8 ms begins late by p50 | p99 | max | p99 divided by the first | its message \
         arrives on DDS after p50 | p99 | max | pictures |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    for part in parts.iter_mut() {
        part.lateness.sort_unstable();
        part.ages.sort_unstable();
    }
    let first = quantile_us(&parts[0].lateness, 0.99);
    for Part { name, lateness, ages, pictures, .. } in parts {
        let ratio = quantile_us(lateness, 0.99) / first;
        println!("| {name} | {} | {ratio:.2} | {} | {pictures} |", cells(lateness), cells(ages));
    }
}

fn in_the_fleet(domain: u16, router: &str) -> anyhow::Result<ParticipantOptions> {
    let zenoh = sessions_of(Some(router));
    Ok(ParticipantOptions { engine: Engine::Zenoh, zenoh, ..on_this_machine(domain)? })
}

fn subscriber(domain: u16, router: &str, link: Option<f64>) -> anyhow::Result<Contestant> {
    let mut command = Command::new(std::env::current_exe()?);
    command.args(["fleet-subscriber", "--domain", &domain.to_string(), "--router", router]);
    if let Some(link) = link {
        command.args(["--link", &link.to_string()]);
    }
    let mut subscriber = Contestant::spawn(command, "the subscriber")?;
    subscriber.wait_for_go()?;
    Ok(subscriber)
}

/// Publishes 1 MB each period of the loop.
struct Camera;

impl Module for Camera {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let camera = setup.publish::<UInt8MultiArray>("camera")?;
        setup.every(PERIOD, move |_: &mut Self, ctx| ctx.publish(camera, payload::message(0, PICTURE)))
    }
}

/// Subscribes to the camera until its input is closed, and prints how many pictures came.
pub fn subscribe(options: &SubscriberOptions) -> anyhow::Result<()> {
    let participant = Participant::join(&in_the_fleet(options.domain, &options.router)?)?;
    let node = participant.create_node(NodeName::new("/", "viewer")?)?;
    let (count, counted) = std::sync::mpsc::channel();
    let (link, mut free) = (options.link, Instant::now());
    let on_sample = move |sample: Sample| {
        // Fails only after the count was printed.
        let _ = count.send(());
        if let Some(link) = link {
            let now = Instant::now();
            free = free.max(now) + Duration::from_secs_f64(sample.cdr.len() as f64 / (link * 1e6));
            std::thread::sleep(free - now);
        }
    };
    let subscription =
        node.subscribe("camera", &MessageType::new(TYPE)?, QosProfile::DEFAULT, Box::new(on_sample))?;
    let end = Instant::now() + Duration::from_secs(20);
    while subscription.matched_publishers() == 0 {
        anyhow::ensure!(Instant::now() < end, "no camera within 20 s");
        std::thread::sleep(Duration::from_millis(20));
    }
    println!("{GO}");
    std::io::copy(&mut std::io::stdin(), &mut std::io::sink())?;
    println!("{}", counted.try_iter().count());
    Ok(())
}
