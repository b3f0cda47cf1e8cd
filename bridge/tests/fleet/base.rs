//! The base, which hears all robots.

use super::heard::{Heard, OfIncarnation};
use super::robot::{EVENTS, PLAN, Robot, latched, of_robots};
use downbeat_bridge::middleware::{DiscoveryRange, Engine, ParticipantOptions, Sample};
use downbeat_bridge::ros::{MessageType, Node, NodeName, Participant, Publisher, Subscription};
use downbeat_msgs::cdr;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::std_msgs::msg::String as Text;
use downbeat_zenoh::Settings;
use parking_lot::{Mutex, MutexGuard};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

/// How many endpoints a robot has: five topics, its service, and the description of types that each node has.
pub const ENDPOINTS: usize = 7;

/// Joins as what looks at a robot from afar does: a client of a router.
fn join() -> Participant {
    let zenoh = Settings { connect: Some("tcp/10.77.0.1:7447".into()), ..Settings::default() };
    let discovery_range = DiscoveryRange::Subnet;
    let options =
        ParticipantOptions { engine: Engine::Zenoh, zenoh, discovery_range, ..ParticipantOptions::new(0) };
    let began = Instant::now();
    loop {
        match Participant::join(&options) {
            Ok(participant) => return participant,
            // The line may be a bad one.
            Err(error) => assert!(began.elapsed() < Duration::from_secs(30), "{error}"),
        }
    }
}

fn text() -> MessageType {
    MessageType::new("std_msgs/msg/String").unwrap()
}

fn subscribe(
    node: &Node,
    topic: &str,
    qos: QosProfile,
    mut hear: impl FnMut(String) + Send + 'static,
) -> Subscription {
    let hear = move |sample: Sample| hear(cdr::from_slice::<Text>(&sample.cdr).unwrap().data);
    node.subscribe(topic, &text(), qos, Box::new(hear)).unwrap()
}

pub struct Base {
    participant: Participant,
    odometry: Arc<Mutex<Heard>>,
    events: Arc<Mutex<Heard>>,
    told: Arc<Mutex<BTreeSet<usize>>>,
    plan: Publisher,
    _subscriptions: Vec<Subscription>,
}

impl Base {
    pub fn join(robots: usize) -> Self {
        let participant = join();
        let node = participant.create_node(NodeName::new("/", "base").unwrap()).unwrap();
        let [odometry, events] = [(); 2].map(|()| Arc::<Mutex<Heard>>::default());
        let told = Arc::<Mutex<BTreeSet<usize>>>::default();
        let mut subscriptions = Vec::new();
        for robot in 0..robots {
            for (topic, qos, heard) in
                [("odometry", QosProfile::DEFAULT, &odometry), ("events", latched(EVENTS), &events)]
            {
                let heard = Arc::clone(heard);
                let topic = format!("/robot_{robot}/{topic}");
                subscriptions.push(subscribe(&node, &topic, qos, move |text| heard.lock().hear(&text)));
            }
            let told = Arc::clone(&told);
            let topic = format!("/robot_{robot}/told");
            subscriptions.push(subscribe(&node, &topic, QosProfile::DEFAULT, move |_| {
                told.lock().insert(robot);
            }));
        }
        let plan = node.publish(PLAN, &text(), QosProfile::DEFAULT).unwrap();
        Self { participant, odometry, events, told, plan, _subscriptions: subscriptions }
    }

    /// The number of endpoints of robots.
    pub fn sees(&self) -> usize {
        of_robots(&self.participant.remote_endpoints())
    }

    pub fn odometry(&self) -> MutexGuard<'_, Heard> {
        self.odometry.lock()
    }

    pub fn events(&self) -> MutexGuard<'_, Heard> {
        self.events.lock()
    }

    /// Whether it has heard a robot from its first event on.
    pub fn hears(&self, robot: &Robot) -> bool {
        let events = self.events();
        let heard = events.incarnations().find(|(incarnation, _)| *incarnation == robot.incarnation);
        heard.is_some_and(|(_, heard)| heard.first() == 1)
    }

    pub fn what_is_missing(&self) -> String {
        let events = self.events();
        let missing = |heard: &OfIncarnation| heard.missing() > 0 || heard.first() != 1;
        let missing = events.incarnations().filter(|(_, heard)| missing(heard));
        let missing: Vec<_> = missing
            .map(|(name, heard)| {
                format!("{name}: {} of {} to {}", heard.missing(), heard.first(), heard.last())
            })
            .collect();
        missing.join(", ")
    }

    pub fn tell(&self, plan: &str) {
        let plan = cdr::to_vec(&Text { data: plan.into() });
        self.plan.publish(plan.into()).unwrap();
    }

    /// Whether a robot has said that it was told something.
    pub fn has_told(&self, robot: usize) -> bool {
        self.told.lock().contains(&robot)
    }
}

/// What a late one got.
pub struct Map {
    pub bytes: usize,
    pub after: Duration,
}

/// Joins late, for the map of a robot.
pub fn a_late_one_gets_the_map(robot: usize, timeout: Duration) -> Map {
    let participant = join();
    let node = participant.create_node(NodeName::new("/", "late").unwrap()).unwrap();
    let (sender, maps) = channel();
    let began = Instant::now();
    let take = move |map: String| {
        // The test may have ended.
        let _ = sender.send(map.len());
    };
    let _subscription = subscribe(&node, &format!("/robot_{robot}/map"), latched(1), take);
    let bytes = maps.recv_timeout(timeout).expect("the map comes");
    Map { bytes, after: began.elapsed() }
}
