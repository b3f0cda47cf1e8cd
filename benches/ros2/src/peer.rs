//! downbeat as one end of a pair: a core with one module, its bridge, and DDS.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::time::{Duration, Instant};

use anyhow::{Context as _, anyhow};
use downbeat_bridge::edge::Interfaces;
use downbeat_bridge::expose::{BridgeStatus, Exposure, expose};
use downbeat_bridge::middleware::{Direction, ParticipantOptions};
use downbeat_bridge::ros::{Node, NodeName, Participant};
use downbeat_executor::{Context, Core, CoreHandle, Module, Publication, Received, Setup, SetupError};
use downbeat_msgs::qos::{History, QosProfile};
use downbeat_msgs::std_msgs::msg::UInt8MultiArray;
use serde::{Deserialize, Serialize};

use crate::meeting;
use crate::payload::{self, NUMBER_BYTES};
use crate::role::{GO, Role};

/// How long a message may be in flight before it counts as lost.
const PATIENCE: Duration = Duration::from_secs(2);

#[derive(clap::Args)]
pub struct Options {
    /// What this end does.
    #[arg(long)]
    pub role: Role,
    /// Bytes of a message.
    #[arg(long, default_value_t = 100)]
    pub size: usize,
    /// Number of messages in flight.
    #[arg(long, default_value_t = 1)]
    pub window: usize,
    /// For how many seconds messages are sent.
    #[arg(long, default_value_t = 3.0)]
    pub seconds: f64,
}

/// The measurements of the end that sends.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Outcome {
    /// Messages that came back.
    pub messages: u64,
    /// Messages that did not come back.
    pub lost: u64,
    /// From the first message sent until the last one that came back.
    pub seconds: f64,
    /// Median of the round-trip times.
    pub p50_us: f64,
    /// 99th percentile of the round-trip times.
    pub p99_us: f64,
}

/// Runs one end: an echo until its input is closed, the other end until its measurement is complete.
pub fn run(options: &Options) -> anyhow::Result<()> {
    let join = || anyhow::Ok(Participant::join(&ParticipantOptions::from_env()?)?);
    match options.role {
        Role::Count | Role::Camera | Role::JointStates => {
            anyhow::bail!("only Python contestants have this role")
        }
        Role::Latch => meeting::latch()?,
        Role::Late => meeting::late()?,
        Role::Ping => {
            let participant = join()?;
            let node = participant.create_node(NodeName::new("/", "downbeat_ping")?)?;
            println!("{}", serde_json::to_string(&ping(&node, options)?)?);
        }
        Role::Echo | Role::Acknowledge => {
            let participant = join()?;
            let node = participant.create_node(NodeName::new("/", "downbeat_echo")?)?;
            let only_number = options.role == Role::Acknowledge;
            let mut core = Core::new();
            core.add("echo", Echo { only_number })?;
            let running = Running::start(core, &node, "ping", "pong")?;
            std::io::copy(&mut std::io::stdin(), &mut std::io::sink())?;
            running.stop()?;
        }
    }
    Ok(())
}

/// Options for a domain with discovery limited to this machine.
pub fn on_this_machine(domain_id: u16) -> anyhow::Result<ParticipantOptions> {
    Ok(ParticipantOptions::from_variables(|name| match name {
        "ROS_DOMAIN_ID" => Some(domain_id.to_string()),
        "ROS_AUTOMATIC_DISCOVERY_RANGE" => Some("LOCALHOST".to_owned()),
        _ => None,
    })?)
}

fn ping(node: &Node, options: &Options) -> anyhow::Result<Outcome> {
    let (done, outcome) = channel();
    let go = Arc::<AtomicBool>::default();
    let mut core = Core::new();
    core.add(
        "ping",
        Ping {
            size: options.size,
            window: options.window,
            duration: Duration::from_secs_f64(options.seconds),
            go: Arc::clone(&go),
            started: None,
            next: 1,
            under_way: BTreeMap::new(),
            times: Vec::new(),
            lost: 0,
            last_back: None,
            done,
        },
    )?;
    let running = Running::start(core, node, "pong", "ping")?;
    running.wait_for_peer(Duration::from_secs(20))?;
    println!("{GO}");
    go.store(true, Ordering::Release);
    let outcome = outcome.recv().context("the core has stopped")?;
    running.stop()?;
    Ok(outcome)
}

/// A core that runs on a thread, with its bridge.
pub struct Running {
    handle: CoreHandle,
    status: BridgeStatus,
    thread: std::thread::JoinHandle<anyhow::Result<()>>,
}

impl Running {
    /// Exposes one topic each way and runs the core.
    pub fn start(core: Core, node: &Node, heard: &str, sent: &str) -> anyhow::Result<Self> {
        let qos = QosProfile { history: History::KeepLast(100), ..QosProfile::DEFAULT };
        Self::start_with(core, node, &[(heard, Direction::In), (sent, Direction::Out)], qos)
    }

    /// Exposes these topics and runs the core.
    pub fn start_with(
        mut core: Core,
        node: &Node,
        topics: &[(&str, Direction)],
        qos: QosProfile,
    ) -> anyhow::Result<Self> {
        let of = Interfaces::carried().message("std_msgs/msg/UInt8MultiArray")?;
        let exposure =
            |&(topic, direction): &_| Exposure { qos: qos.into(), ..Exposure::new(topic, of, direction) };
        let exposures: Vec<_> = topics.iter().map(exposure).collect();
        let status = expose(&mut core, node, &exposures)?;
        Self::run(core, status)
    }

    /// Runs a core with its bridge.
    pub fn run(mut core: Core, status: BridgeStatus) -> anyhow::Result<Self> {
        let handle = core.handle();
        let thread = std::thread::Builder::new().name("core".into());
        let thread = thread.spawn(move || core.run().map_err(|error| anyhow!(error)))?;
        Ok(Self { handle, status, thread })
    }

    /// Waits until all topics have a peer.
    pub fn wait_for_peer(&self, patience: Duration) -> anyhow::Result<()> {
        let end = Instant::now() + patience;
        while self.status.endpoints().iter().any(|report| report.traffic.matched == 0) {
            anyhow::ensure!(Instant::now() < end, "no peer within {patience:?}");
            std::thread::sleep(Duration::from_millis(20));
        }
        Ok(())
    }

    pub fn stop(self) -> anyhow::Result<()> {
        self.handle.stop();
        self.thread.join().map_err(|_| anyhow!("the core's thread panicked"))?
    }
}

struct Echo {
    only_number: bool,
}

impl Module for Echo {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let pong = setup.publish::<UInt8MultiArray>("pong")?;
        setup.subscribe(
            "ping",
            move |echo: &mut Self, message: Received<'_, UInt8MultiArray>, ctx: &mut Context<'_>| {
                let mut answer = UInt8MultiArray::clone(&message);
                if echo.only_number {
                    answer.data.truncate(NUMBER_BYTES);
                }
                ctx.publish(pong, answer);
            },
        )
    }
}

struct Ping {
    size: usize,
    window: usize,
    duration: Duration,
    go: Arc<AtomicBool>,
    started: Option<Instant>,
    next: u64,
    /// The send times of the messages that have not come back yet.
    under_way: BTreeMap<u64, Instant>,
    times: Vec<Duration>,
    lost: u64,
    last_back: Option<Instant>,
    done: Sender<Outcome>,
}

impl Module for Ping {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let ping = setup.publish::<UInt8MultiArray>("ping")?;
        setup.subscribe(
            "pong",
            move |module: &mut Self, message: Received<'_, UInt8MultiArray>, ctx: &mut Context<'_>| {
                module.take(&message);
                module.send(ctx, ping);
            },
        )?;
        setup.every(Duration::from_millis(10), move |module: &mut Self, ctx| {
            module.give_up_the_late();
            module.send(ctx, ping);
        })
    }
}

impl Ping {
    fn take(&mut self, message: &UInt8MultiArray) {
        let sent = payload::number(message).and_then(|number| self.under_way.remove(&number));
        if let Some(sent) = sent {
            self.times.push(sent.elapsed());
            self.last_back = Some(Instant::now());
        }
    }

    fn give_up_the_late(&mut self) {
        let before = self.under_way.len();
        self.under_way.retain(|_, sent| sent.elapsed() < PATIENCE);
        self.lost += (before - self.under_way.len()) as u64;
    }

    fn send(&mut self, ctx: &mut Context<'_>, ping: Publication<UInt8MultiArray>) {
        if !self.go.load(Ordering::Acquire) {
            return;
        }
        let started = *self.started.get_or_insert_with(Instant::now);
        if started.elapsed() >= self.duration {
            if self.under_way.is_empty() {
                let outcome = self.outcome(started);
                // Only the first outcome is read.
                let _ = self.done.send(outcome);
            }
            return;
        }
        while self.under_way.len() < self.window {
            self.under_way.insert(self.next, Instant::now());
            ctx.publish(ping, payload::message(self.next, self.size));
            self.next += 1;
        }
    }

    fn outcome(&mut self, started: Instant) -> Outcome {
        self.times.sort_unstable();
        Outcome {
            messages: self.times.len() as u64,
            lost: self.lost,
            seconds: self.last_back.map_or(0.0, |last| (last - started).as_secs_f64()),
            p50_us: quantile_us(&self.times, 0.5),
            p99_us: quantile_us(&self.times, 0.99),
        }
    }
}

/// The quantile `part` of the sorted times in µs; 0 if there are no times.
pub fn quantile_us(sorted: &[Duration], part: f64) -> f64 {
    let index = (sorted.len() as f64 * part) as usize;
    sorted.get(index.min(sorted.len().saturating_sub(1))).map_or(0.0, |time| time.as_secs_f64() * 1e6)
}
