//! Sends 1000 messages per second to another process and back for a long time.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use downbeat_bridge::ros::{NodeName, Participant};
use downbeat_executor::{Context, Core, Module, Received, Setup, SetupError};
use downbeat_msgs::std_msgs::msg::UInt8MultiArray;

use crate::contestant::{Contestant, Kind, Task, resident_bytes};
use crate::payload;
use crate::peer::{Running, on_this_machine};
use crate::role::Role;

#[derive(clap::Args)]
pub struct Options {
    /// How many minutes to send.
    #[arg(long, default_value_t = 60.0)]
    minutes: f64,
    /// The software that sends the messages back.
    #[arg(long, value_enum, default_value_t = Kind::Downbeat)]
    peer: Kind,
    /// The ROS domain.
    #[arg(long, default_value_t = 100)]
    domain: u16,
}

const SIZE: usize = 100;

pub fn run(options: &Options) -> anyhow::Result<()> {
    let task = Task { size: SIZE, window: 1, seconds: 0.0, domain_id: options.domain };
    let echo = Contestant::start(options.peer, Role::Echo, &task)?;
    let participant = Participant::join(&on_this_machine(options.domain)?)?;
    let node = participant.create_node(NodeName::new("/", "downbeat_hold")?)?;
    let counts = Arc::<Counts>::default();
    let mut core = Core::new();
    core.add("steady", Steady { next: 1, counts: Arc::clone(&counts) })?;
    let running = Running::start(core, &node, "pong", "ping")?;
    running.wait_for_peer(Duration::from_secs(20))?;
    println!("| minute | resident | of the peer | sent | came back |");
    println!("| --- | --- | --- | --- | --- |");
    let (start, minutes) = (Instant::now(), options.minutes);
    let mut minute = 0.0;
    loop {
        let [ours, peers] =
            [resident_bytes(std::process::id())?, echo.resident_bytes()?].map(|bytes| bytes as f64 / 1e6);
        let [sent, back] = [&counts.sent, &counts.back].map(|count| count.load(Ordering::Relaxed));
        println!("| {minute:.0} | {ours:.1} MB | {peers:.1} MB | {sent} | {back} |");
        if minute >= minutes {
            break;
        }
        minute = (minute + 1.0).min(minutes);
        std::thread::sleep(
            (start + Duration::from_secs_f64(minute * 60.0)).saturating_duration_since(Instant::now()),
        );
    }
    running.stop()?;
    echo.end()
}

#[derive(Default)]
struct Counts {
    sent: AtomicU64,
    back: AtomicU64,
}

struct Steady {
    next: u64,
    counts: Arc<Counts>,
}

impl Module for Steady {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let ping = setup.publish::<UInt8MultiArray>("ping")?;
        setup.subscribe(
            "pong",
            |steady: &mut Self, _: Received<'_, UInt8MultiArray>, _: &mut Context<'_>| {
                steady.counts.back.fetch_add(1, Ordering::Relaxed);
            },
        )?;
        setup.every(Duration::from_millis(1), move |steady: &mut Self, ctx| {
            ctx.publish(ping, payload::message(steady.next, SIZE));
            steady.counts.sent.store(steady.next, Ordering::Relaxed);
            steady.next += 1;
        })
    }
}
