//! Sends messages of the size of images at the rate of a camera to an rclpy node.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use downbeat_bridge::middleware::Direction;
use downbeat_bridge::ros::{NodeName, Participant};
use downbeat_executor::{Core, Module, Setup, SetupError};
use downbeat_msgs::qos::{QosProfile, Reliability};
use downbeat_msgs::std_msgs::msg::UInt8MultiArray;

use crate::contestant::{Contestant, Kind, Task};
use crate::payload;
use crate::peer::{Running, on_this_machine};
use crate::role::Role;

#[derive(clap::Args)]
pub struct Options {
    /// Bytes of a message.
    #[arg(long, value_delimiter = ',', default_values_t = [50_000, 100_000, 300_000, 921_600, 2_764_800])]
    sizes: Vec<usize>,
    /// Messages per second.
    #[arg(long, default_value_t = 30.0)]
    hz: f64,
    /// How many messages are sent.
    #[arg(long, default_value_t = 300)]
    messages: u64,
    /// The ROS domain.
    #[arg(long, default_value_t = 100)]
    domain: u16,
}

pub fn run(options: &Options) -> anyhow::Result<()> {
    for limit in ["rmem_default", "rmem_max"] {
        let bytes = std::fs::read_to_string(format!("/proc/sys/net/core/{limit}"))?;
        println!("net.core.{limit} = {}", bytes.trim());
    }
    println!("\n| bytes | reliable | best effort | best effort, from Cyclone DDS |");
    println!("| --- | --- | --- | --- |");
    for &size in &options.sizes {
        let [reliable, best_effort] = [Reliability::Reliable, Reliability::BestEffort]
            .map(|reliability| arrived(size, reliability, options));
        println!(
            "| {size} | {} of {messages} | {} of {messages} | {} of {messages} |",
            reliable?,
            best_effort?,
            arrived_from_cyclone(size, options)?,
            messages = options.messages
        );
    }
    Ok(())
}

fn arrived_from_cyclone(size: usize, options: &Options) -> anyhow::Result<u64> {
    let task = Task { size, window: 1, seconds: 0.0, domain_id: options.domain };
    let mut counter = Contestant::start_with(Kind::Rclpy, Role::Count, &task, &["--best-effort"])?;
    let (hz, messages) = (options.hz.to_string(), options.messages.to_string());
    let more = ["--best-effort", "--hz", &hz, "--messages", &messages];
    let mut camera = Contestant::start_with(Kind::Cyclone, Role::Camera, &task, &more)?;
    camera.wait_for_go()?;
    std::thread::sleep(Duration::from_secs(1));
    let heard = counter.count()?;
    camera.end()?;
    counter.end()?;
    Ok(heard)
}

fn arrived(size: usize, reliability: Reliability, options: &Options) -> anyhow::Result<u64> {
    let task = Task { size, window: 1, seconds: 0.0, domain_id: options.domain };
    let best_effort: &[&str] = if reliability == Reliability::BestEffort { &["--best-effort"] } else { &[] };
    let mut counter = Contestant::start_with(Kind::Rclpy, Role::Count, &task, best_effort)?;
    let participant = Participant::join(&on_this_machine(options.domain)?)?;
    let node = participant.create_node(NodeName::new("/", "downbeat_camera")?)?;
    let sent = Arc::<AtomicU64>::default();
    let go = Arc::<AtomicU64>::default();
    let mut core = Core::new();
    let period = Duration::from_secs_f64(1.0 / options.hz);
    core.add("camera", Camera { size, period, left: Arc::clone(&go), sent: Arc::clone(&sent) })?;
    let qos = QosProfile { reliability, ..QosProfile::DEFAULT };
    let running = Running::start_with(core, &node, &[("ping", Direction::Out)], qos)?;
    running.wait_for_peer(Duration::from_secs(20))?;
    // The other end may not have discovered this one yet.
    std::thread::sleep(Duration::from_secs(1));
    go.store(options.messages, Ordering::Release);
    while sent.load(Ordering::Acquire) < options.messages {
        std::thread::sleep(period);
    }
    // Lost messages are requested repeatedly: allow time for it.
    std::thread::sleep(Duration::from_secs(5));
    running.stop()?;
    let heard = counter.count()?;
    counter.end()?;
    Ok(heard)
}

struct Camera {
    size: usize,
    period: Duration,
    /// Number of messages still to be sent.
    left: Arc<AtomicU64>,
    sent: Arc<AtomicU64>,
}

impl Module for Camera {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let ping = setup.publish::<UInt8MultiArray>("ping")?;
        setup.every(self.period, move |camera: &mut Self, ctx| {
            if camera.left.load(Ordering::Acquire) > camera.sent.load(Ordering::Acquire) {
                let number = camera.sent.load(Ordering::Acquire) + 1;
                ctx.publish(ping, payload::message(number, camera.size));
                camera.sent.store(number, Ordering::Release);
            }
        })
    }
}
