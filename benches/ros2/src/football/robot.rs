//! The robot: the graph of `benches/src/football.rs` with messages of ROS 2, eight modules and 14 topics.
//!
//! `hardware` publishes joint states each period. `walk` answers them at once with commands for the legs, and
//! the chain ends when `hardware` receives these.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::{Context as _, anyhow};
use downbeat_bridge::edge::Interfaces;
use downbeat_bridge::expose::{BridgeStatus, Exposure, expose};
use downbeat_bridge::middleware::Direction;
use downbeat_bridge::middleware::rtps::RtpsParticipant;
use downbeat_bridge::ros::{NodeName, Participant};
use downbeat_executor::{Context, Core, Module, Publication, Received, Setup, SetupError};
use downbeat_msgs::sensor_msgs::msg::JointState;
use downbeat_msgs::std_msgs::msg::Float32MultiArray;
use serde::{Deserialize, Serialize};

use super::own_processor_time;
use crate::peer::{on_this_machine, quantile_us};
use crate::role::GO;

#[derive(clap::Args)]
pub struct RobotOptions {
    #[arg(long)]
    period_us: u64,
    #[arg(long)]
    seconds: f64,
    /// Exposes all topics in this domain.
    #[arg(long)]
    domain: Option<u16>,
    /// Waits for a subscriber before it measures.
    #[arg(long)]
    is_subscribed: bool,
    #[arg(long)]
    timer_slack_ns: Option<u64>,
}

/// The measurements of a robot.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Outcome {
    pub chain_p50_us: f64,
    pub chain_p99_us: f64,
    /// By how much the time between two runs of the timer of `hardware` differs from its period.
    pub timer_p99_us: f64,
    pub processor_ms_per_s: f64,
    /// Received from all peers.
    pub datagrams_per_s: f64,
    /// Joint states during the measurement.
    pub sent: u64,
}

const JOINT_STATES: &str = "joint_states";

/// Name; what it subscribes to; what it publishes each period, with the count of numbers.
type Part = (&'static str, &'static [&'static str], &'static [(&'static str, usize)]);

const PARTS: [Part; 6] = [
    ("camera", &[], &[("image", 12)]),
    ("ball_finder", &["image", JOINT_STATES], &[("ball", 4)]),
    ("line_finder", &["image", JOINT_STATES], &[("lines", 32)]),
    ("localisation", &["lines", "odometry", "imu"], &[("pose", 12)]),
    (
        "behaviour",
        &["ball", "pose", "battery", "imu"],
        &[("state", 2), ("walk_command", 3), ("head_command", 2)],
    ),
    ("head", &["head_command", "ball"], &[("neck_commands", 2)]),
];
const OF_WALK: [&str; 3] = ["walk_command", "imu", "feet"];
const OF_HARDWARE: [(&str, usize); 3] = [("imu", 10), ("battery", 2), ("feet", 8)];
const TOPICS: [&str; 14] = [
    "image",
    "ball",
    "lines",
    "pose",
    "state",
    "walk_command",
    "head_command",
    "neck_commands",
    "leg_commands",
    "odometry",
    JOINT_STATES,
    "imu",
    "battery",
    "feet",
];

pub fn run(options: &RobotOptions) -> anyhow::Result<()> {
    if let Some(slack) = options.timer_slack_ns {
        // Threads inherit it.
        std::fs::write("/proc/self/timerslack_ns", slack.to_string()).context("setting the timer slack")?;
    }
    let (period, times) = (Duration::from_micros(options.period_us), Times::default());
    let mut core = Core::new();
    for (name, subscribes, publishes) in PARTS {
        core.add(name, Simple { period, subscribes, publishes, sum: 0.0 })?;
    }
    core.add("walk", Walk { sum: 0.0 })?;
    core.add("hardware", Hardware { period, times: times.clone(), published: None, last: None })?;
    let exposed = options.domain.map(|domain| expose_all(&mut core, domain)).transpose()?;
    let handle = core.handle();
    let thread = std::thread::Builder::new().name("core".into());
    let thread = thread.spawn(move || core.run())?;
    if let Some((_, _, status)) = exposed.as_ref().filter(|_| options.is_subscribed) {
        let end = Instant::now() + Duration::from_secs(20);
        while status.endpoints().iter().all(|report| report.traffic.matched == 0) {
            anyhow::ensure!(Instant::now() < end, "no subscriber within 20 s");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
    std::thread::sleep(Duration::from_secs(1));
    let datagrams = || exposed.as_ref().map_or(0, |(engine, ..)| engine.counters().datagrams_received);
    times.clear();
    let (received, processor, start) = (datagrams(), own_processor_time()?, Instant::now());
    println!("{GO}");
    std::thread::sleep(Duration::from_secs_f64(options.seconds));
    let (processor, received) = (own_processor_time()? - processor, datagrams() - received);
    let (seconds, (chain, timer)) = (start.elapsed().as_secs_f64(), times.take());
    let outcome = Outcome {
        chain_p50_us: quantile_us(&chain, 0.5),
        chain_p99_us: quantile_us(&chain, 0.99),
        timer_p99_us: quantile_us(&timer, 0.99),
        processor_ms_per_s: processor * 1e3 / seconds,
        datagrams_per_s: received as f64 / seconds,
        sent: timer.len() as u64,
    };
    println!("{}", serde_json::to_string(&outcome)?);
    std::io::copy(&mut std::io::stdin(), &mut std::io::sink())?;
    handle.stop();
    thread.join().map_err(|_| anyhow!("the core's thread panicked"))??;
    Ok(())
}

fn expose_all(
    core: &mut Core,
    domain: u16,
) -> anyhow::Result<(Arc<RtpsParticipant>, Participant, BridgeStatus)> {
    let engine = Arc::new(RtpsParticipant::new(&on_this_machine(domain)?)?);
    let participant = Participant::on(Arc::<RtpsParticipant>::clone(&engine))?;
    let node = participant.create_node(NodeName::new("/", "football")?)?;
    let interfaces = Interfaces::carried();
    let exposure = |topic: &&str| -> anyhow::Result<Exposure> {
        let name = if *topic == JOINT_STATES {
            "sensor_msgs/msg/JointState"
        } else {
            "std_msgs/msg/Float32MultiArray"
        };
        Ok(Exposure::new(*topic, interfaces.message(name)?, Direction::Out))
    };
    let exposures = TOPICS.iter().map(exposure).collect::<anyhow::Result<Vec<_>>>()?;
    let status = expose(core, &node, &exposures)?;
    Ok((engine, participant, status))
}

/// Durations of the chain, and deviations of the timer.
#[derive(Clone, Default)]
struct Times(Arc<Mutex<(Vec<Duration>, Vec<Duration>)>>);

impl Times {
    fn with<T>(&self, call: impl FnOnce(&mut (Vec<Duration>, Vec<Duration>)) -> T) -> T {
        call(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn clear(&self) {
        self.with(|(chain, timer)| {
            chain.clear();
            timer.clear();
        });
    }

    /// Sorted.
    fn take(&self) -> (Vec<Duration>, Vec<Duration>) {
        let (mut chain, mut timer) = self.with(std::mem::take);
        chain.sort_unstable();
        timer.sort_unstable();
        (chain, timer)
    }
}

/// Adds up one number of each message, and publishes the sum each period.
struct Simple {
    period: Duration,
    subscribes: &'static [&'static str],
    publishes: &'static [(&'static str, usize)],
    sum: f32,
}

impl Module for Simple {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        for &topic in self.subscribes {
            match topic {
                JOINT_STATES => setup.subscribe(
                    topic,
                    |part: &mut Self, message: Received<'_, JointState>, _: &mut Context<'_>| {
                        part.sum += message.position.first().copied().unwrap_or_default() as f32;
                    },
                )?,
                _ => setup.subscribe(
                    topic,
                    |part: &mut Self, message: Received<'_, Float32MultiArray>, _: &mut Context<'_>| {
                        part.sum += message.data.first().copied().unwrap_or_default();
                    },
                )?,
            }
        }
        let publications = publications(setup, self.publishes)?;
        setup.every(self.period, move |part: &mut Self, ctx: &mut Context<'_>| {
            publish_all(&publications, part.sum, ctx);
        })
    }
}

type Publications = Vec<(Publication<Float32MultiArray>, usize)>;

fn publications<M: Module>(
    setup: &mut Setup<'_, M>,
    topics: &[(&str, usize)],
) -> Result<Publications, SetupError> {
    topics.iter().map(|(topic, count)| Ok((setup.publish(topic)?, *count))).collect()
}

fn publish_all(publications: &Publications, number: f32, ctx: &mut Context<'_>) {
    for (publication, count) in publications {
        ctx.publish(*publication, numbers(number, *count));
    }
}

fn numbers(number: f32, count: usize) -> Float32MultiArray {
    Float32MultiArray { data: vec![number; count], ..Float32MultiArray::default() }
}

struct Walk {
    sum: f32,
}

impl Module for Walk {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let answers = publications(setup, &[("leg_commands", 12), ("odometry", 6)])?;
        for topic in OF_WALK {
            setup.subscribe(
                topic,
                |walk: &mut Self, message: Received<'_, Float32MultiArray>, _: &mut Context<'_>| {
                    walk.sum += message.data.first().copied().unwrap_or_default();
                },
            )?;
        }
        setup.subscribe(
            JOINT_STATES,
            move |walk: &mut Self, _: Received<'_, JointState>, ctx: &mut Context<'_>| {
                publish_all(&answers, walk.sum, ctx);
            },
        )
    }
}

struct Hardware {
    period: Duration,
    times: Times,
    /// When the last joint states were published.
    published: Option<Instant>,
    /// When its timer ran last.
    last: Option<Instant>,
}

impl Module for Hardware {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let joint_states = setup.publish::<JointState>(JOINT_STATES)?;
        let others = publications(setup, &OF_HARDWARE)?;
        let names: Vec<String> = (0..20).map(|joint| format!("joint_{joint}")).collect();
        setup.subscribe(
            "leg_commands",
            |hardware: &mut Self, _: Received<'_, Float32MultiArray>, _: &mut Context<'_>| {
                if let Some(published) = hardware.published.take() {
                    hardware.times.with(|(chain, _)| chain.push(published.elapsed()));
                }
            },
        )?;
        for topic in ["neck_commands", "state"] {
            setup.subscribe(
                topic,
                |_: &mut Self, _: Received<'_, Float32MultiArray>, _: &mut Context<'_>| {},
            )?;
        }
        setup.every(self.period, move |hardware: &mut Self, ctx: &mut Context<'_>| {
            let now = Instant::now();
            if let Some(last) = hardware.last.replace(now) {
                let deviation = (now - last).abs_diff(hardware.period);
                hardware.times.with(|(_, timer)| timer.push(deviation));
            }
            publish_all(&others, 1.0, ctx);
            let mut message = JointState { name: names.clone(), ..JointState::default() };
            message.position = vec![0.5; 20];
            message.velocity = vec![0.5; 20];
            message.effort = vec![0.5; 20];
            // The clock that a subscriber in another process reads as well.
            let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
            message.header.stamp.sec = i32::try_from(since_epoch.as_secs()).unwrap_or_default();
            message.header.stamp.nanosec = since_epoch.subsec_nanos();
            hardware.published = Some(Instant::now());
            ctx.publish(joint_states, message);
        })
    }
}
