//! Measures the delay that the bridge adds: from the publish of a module until the middleware has the bytes.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use downbeat_bridge::middleware::in_process::Hub;
use downbeat_bridge::ros::{MessageType, NodeName, Participant};
use downbeat_executor::{Core, Module, Setup, SetupError};
use downbeat_msgs::cdr;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::std_msgs::msg::UInt8MultiArray;

use crate::payload;
use crate::peer::{Running, quantile_us};

#[derive(clap::Args)]
pub struct Options {
    /// For how many seconds messages are sent, 1000 per second.
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// Bytes of a message.
    #[arg(long, value_delimiter = ',', default_values_t = [100, 10_000, 1_000_000])]
    sizes: Vec<usize>,
}

pub fn run(options: &Options) -> anyhow::Result<()> {
    println!("| bytes | messages | p50 | p99 |");
    println!("| --- | --- | --- | --- |");
    for &size in &options.sizes {
        let times = measure(size, Duration::from_secs_f64(options.seconds))?;
        let [p50, p99] = [0.5, 0.99].map(|part| quantile_us(&times, part));
        println!("| {size} | {} | {p50:.1} µs | {p99:.1} µs |", times.len());
    }
    Ok(())
}

/// Uses the in-memory middleware, whose reader is called at the point at which DDS would receive the bytes.
fn measure(size: usize, duration: Duration) -> anyhow::Result<Vec<Duration>> {
    let hub = Hub::new();
    let join = |name| -> anyhow::Result<_> {
        let participant = Participant::on(Arc::new(hub.join()))?;
        Ok(participant.create_node(NodeName::new("/", name)?)?)
    };
    let (ours, peer) = (join("downbeat")?, join("peer")?);
    let clock = Clock::default();
    let times = Arc::<Mutex<Vec<Duration>>>::default();
    let of = MessageType::new("std_msgs/msg/UInt8MultiArray")?;
    let on_sample = {
        let (clock, times) = (clock.clone(), Arc::clone(&times));
        Box::new(move |sample: downbeat_bridge::middleware::Sample| {
            let elapsed = clock.since_publish();
            // The clock holds only the time of the last message.
            let message = cdr::from_slice::<UInt8MultiArray>(&sample.cdr);
            if message.is_ok_and(|message| payload::number(&message) == Some(clock.number())) {
                times.lock().unwrap_or_else(PoisonError::into_inner).push(elapsed);
            }
        })
    };
    let _subscription = peer.subscribe("ping", &of, QosProfile::DEFAULT, on_sample)?;
    let _answers = peer.publish("pong", &of, QosProfile::DEFAULT)?;
    let mut core = Core::new();
    core.add("ticker", Ticker { size, number: 0, clock })?;
    let running = Running::start(core, &ours, "pong", "ping")?;
    std::thread::sleep(duration);
    running.stop()?;
    let mut times = std::mem::take(&mut *times.lock().unwrap_or_else(PoisonError::into_inner));
    times.sort_unstable();
    Ok(times)
}

/// When the last message was published.
#[derive(Clone)]
struct Clock {
    start: Instant,
    last: Arc<(AtomicU64, AtomicU64)>,
}

impl Default for Clock {
    fn default() -> Self {
        Self { start: Instant::now(), last: Arc::default() }
    }
}

impl Clock {
    fn publish(&self, number: u64) {
        let (time, last_number) = &*self.last;
        last_number.store(number, Ordering::Release);
        time.store(self.start.elapsed().as_nanos() as u64, Ordering::Release);
    }

    fn since_publish(&self) -> Duration {
        self.start.elapsed().saturating_sub(Duration::from_nanos(self.last.0.load(Ordering::Acquire)))
    }

    fn number(&self) -> u64 {
        self.last.1.load(Ordering::Acquire)
    }
}

struct Ticker {
    size: usize,
    number: u64,
    clock: Clock,
}

impl Module for Ticker {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let ping = setup.publish::<UInt8MultiArray>("ping")?;
        setup.every(Duration::from_millis(1), move |ticker: &mut Self, ctx| {
            ticker.number += 1;
            let message = payload::message(ticker.number, ticker.size);
            ticker.clock.publish(ticker.number);
            ctx.publish(ping, message);
        })
    }
}
