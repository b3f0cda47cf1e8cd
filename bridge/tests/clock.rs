//! `/clock` both ways.
#![allow(clippy::unwrap_used)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{on_loopback, wait_until};
use downbeat_bridge::clock::{self, FollowedClock};
use downbeat_bridge::middleware::Sample;
use downbeat_bridge::middleware::in_process::Hub;
use downbeat_bridge::ros::{MessageType, Node, NodeName, Participant, Publisher};
use downbeat_executor::{
    Clock, Core, CoreHandle, Inbox, LifecycleState, ManualClock, Module, ModuleOptions, Setup, SetupError,
    Synchrony, Time,
};
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::cdr;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rosgraph_msgs::msg::Clock as ClockMessage;
use serde_json::json;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;
use test_machine::free_domain;

const SECOND: i64 = 1_000_000_000;

fn clock_type() -> MessageType {
    MessageType::new("rosgraph_msgs/msg/Clock").unwrap()
}

fn node(hub: &Hub, name: &str) -> Node {
    let participant = Participant::on(Arc::new(hub.join())).unwrap();
    participant.create_node(NodeName::new("/", name).unwrap()).unwrap()
}

/// Tells the time of each of its ticks, every 100 ms.
struct Ticker(Sender<i64>);

impl Module for Ticker {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.every(Duration::from_millis(100), |ticker: &mut Self, ctx| {
            // The test may have stopped listening.
            let _ = ticker.0.send(ctx.now().as_nanos());
        })
    }
}

/// A running core that follows a clock, and when its two modules tick: one in the cycle, one detached.
struct Following {
    handle: CoreHandle,
    running: JoinHandle<()>,
    ticks: Receiver<i64>,
    detached_ticks: Receiver<i64>,
}

impl Following {
    fn start(clock: &FollowedClock, node: &Node) -> (Self, clock::FollowedTime) {
        let mut core = Core::new().with_clock(clock.clone());
        let ((sender, ticks), (detached, detached_ticks)) = (channel(), channel());
        core.add("ticker", Ticker(sender)).unwrap();
        let options =
            ModuleOptions { synchrony: Synchrony::Detached(Inbox::KeepAll), ..ModuleOptions::default() };
        core.add_with("detached", Ticker(detached), options).unwrap();
        let handle = core.handle();
        let following = clock.follow(node, &handle).unwrap();
        let running = std::thread::spawn(move || core.run().unwrap());
        // Timers count from the time at which their module became active.
        wait_until("the modules are active", || {
            let modules = handle.modules().wait(common::WATCHDOG).unwrap();
            modules.iter().all(|module| module.state == LifecycleState::Active)
        });
        (Self { handle, running, ticks, detached_ticks }, following)
    }

    /// Sets the time with `publish_time` until both modules have ticked at it.
    fn tick_at(&self, time: i64, mut publish_time: impl FnMut()) {
        for ticks in [&self.ticks, &self.detached_ticks] {
            wait_until("the module ticks at the time", || {
                publish_time();
                ticks.try_iter().any(|tick| tick == time)
            });
        }
    }

    fn stop(self) {
        self.handle.stop();
        self.running.join().unwrap();
    }
}

fn publish_time(publisher: &Publisher, time: i64) {
    let clock = ClockMessage { clock: Stamp::from_nanos(time) };
    publisher.publish(cdr::to_vec(&clock).into()).unwrap();
}

#[test]
fn timers_fire_by_the_time_of_another_and_again_when_it_has_gone_back() {
    let hub = Hub::new();
    let (clock, simulator) = (FollowedClock::new(), node(&hub, "simulator"));
    let publisher = simulator.publish("/clock", &clock_type(), QosProfile::CLOCK).unwrap();
    let (core, following) = Following::start(&clock, &node(&hub, "downbeat"));
    assert_eq!((clock.now(), clock.is_set()), (Time::ZERO, false));
    // A year in the steps of a fast simulator: nobody waits as long as that takes.
    for seconds in [1, 3600, 24 * 3600, 365 * 24 * 3600] {
        core.tick_at(seconds * SECOND, || publish_time(&publisher, seconds * SECOND));
    }
    // Back to the start: the timers tick as soon as their period has passed from there.
    let mut tenths = 0;
    core.tick_at(10 * SECOND + 100_000_000, || {
        publish_time(&publisher, 10 * SECOND + tenths * 100_000_000);
        tenths = 1 - tenths;
    });
    publisher.publish(bytes::Bytes::from_static(&[0, 1, 0, 0, 1])).unwrap();
    assert_eq!((following.errors(), following.matched_publishers()), (1, 1));
    core.stop();
}

#[test]
fn while_the_time_of_another_stands_still_no_timer_fires() {
    let hub = Hub::new();
    let (clock, simulator) = (FollowedClock::new(), node(&hub, "simulator"));
    let publisher = simulator.publish("/clock", &clock_type(), QosProfile::CLOCK).unwrap();
    let (core, following) = Following::start(&clock, &node(&hub, "downbeat"));
    core.tick_at(5 * SECOND, || publish_time(&publisher, 5 * SECOND));
    let before = following.messages();
    for _ in 0..100 {
        publish_time(&publisher, 5 * SECOND);
    }
    assert_eq!(following.messages(), before + 100);
    core.handle.snapshot().wait(common::WATCHDOG).unwrap();
    assert_eq!((core.ticks.try_iter().count(), core.detached_ticks.try_iter().count()), (0, 0));
    core.stop();
}

#[test]
fn the_time_of_the_core_is_published_while_somebody_hears_it() {
    let hub = Hub::new();
    let (node, peer) = (node(&hub, "downbeat"), node(&hub, "peer"));
    let clock = ManualClock::new(Time::from_nanos(7 * SECOND));
    let mut core = Core::new().with_clock(clock.clone());
    clock::publish(&mut core, &node, Duration::from_millis(25)).unwrap();
    let (sender, samples) = channel();
    let on_sample = Box::new(move |sample: Sample| drop(sender.send(sample)));
    let _subscription = peer.subscribe("/clock", &clock_type(), QosProfile::CLOCK, on_sample).unwrap();
    for _ in 0..5 {
        core.cycle().unwrap();
        clock.advance(Duration::from_millis(25));
    }
    let times: Vec<_> = samples
        .try_iter()
        .map(|sample| cdr::from_slice::<ClockMessage>(&sample.cdr).unwrap().clock.as_nanos() - 7 * SECOND)
        .collect();
    assert_eq!(times, [25_000_000, 50_000_000, 75_000_000, 100_000_000]);
}

#[test]
fn rclpy_hears_the_time_of_the_core() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Node services", "/clock", With::Rclpy, Way::Out);
    let participant = Participant::join(&on_loopback(domain)).unwrap();
    let node = participant.create_node(NodeName::new("/", "downbeat").unwrap()).unwrap();
    let mut core = Core::new();
    clock::publish(&mut core, &node, Duration::from_millis(10)).unwrap();
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run().unwrap());
    let qos = json!({"depth": 1, "reliability": "best_effort"});
    rclpy.ask(json!({"do": "subscribe", "topic": "/clock", "type": "rosgraph_msgs/msg/Clock", "qos": qos}));
    let times: Vec<i64> = rclpy
        .take("/clock", 50)
        .iter()
        .map(|message| &message["fields"]["clock"])
        .map(|stamp| stamp["sec"].as_i64().unwrap() * SECOND + stamp["nanosec"].as_i64().unwrap())
        .collect();
    assert!(times.windows(2).all(|pair| pair[0] < pair[1]), "{times:?}");
    let now = downbeat_executor::SystemClock::new().now().as_nanos();
    let last = times[times.len() - 1];
    assert!((now - 60 * SECOND..=now).contains(&last), "{last} is of the last minute before {now}");
    handle.stop();
    running.join().unwrap();
    rclpy.leave();
}

#[test]
fn the_core_follows_the_time_that_rclpy_publishes() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Node services", "/clock", With::Rclpy, Way::In);
    let participant = Participant::join(&on_loopback(domain)).unwrap();
    let node = participant.create_node(NodeName::new("/", "downbeat").unwrap()).unwrap();
    let clock = FollowedClock::new();
    let (core, following) = Following::start(&clock, &node);
    rclpy.ask(json!({"do": "advertise", "topic": "/clock", "type": "rosgraph_msgs/msg/Clock"}));
    wait_until("the time is heard", || following.matched_publishers() == 1);
    for seconds in [100, 200, 20] {
        core.tick_at(seconds * SECOND + 500_000_000, || {
            for nanosec in [0, 500_000_000] {
                let fields = json!({"clock": {"sec": seconds, "nanosec": nanosec}});
                rclpy.ask(json!({"do": "publish", "topic": "/clock", "fields": fields}));
            }
        });
    }
    core.stop();
    rclpy.leave();
}
