//! The bond of a managed node with a manager that watches it, as Nav2's lifecycle manager does.
//!
//! Both sides of a bond publish heartbeats on `bond`, with the name of the node as its id, and take the other
//! side for dead when it says so or is silent for its time-out. The node answers the heartbeats of a manager
//! while its module is active; without a manager it is silent.
//!
//! # References
//! bond_core, branch ros2: `bondcpp/src/bond.cpp`, `bond/BondSM.sm`. navigation2:
//! `nav2_util/src/lifecycle_node.cpp` (a bond is formed in the activation and broken in the deactivation).

use super::wall_time;
use crate::middleware::Sample;
use crate::ros::{MessageType, Node, NodeError, Publisher, Subscription};
use crate::worker::WorkerLink;
use downbeat_msgs::bond::msg::{Constants, Status};
use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::{Message, cdr};
use parking_lot::Mutex;
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

/// The period of heartbeats, as Nav2's nodes have it.
const PERIOD: Duration = Duration::from_millis(100);

/// The bounds of time-outs that others ask for.
const SHORTEST_TIMEOUT: f32 = 0.2;
const LONGEST_TIMEOUT: f32 = 3600.0;

/// One side of a bond.
pub(super) struct Bond {
    shared: Arc<Shared>,
    _subscription: Subscription,
}

struct Shared {
    /// The name of the node, without its namespace.
    id: String,
    /// Tells this side from the other one.
    instance: String,
    publisher: Publisher,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    is_active: bool,
    other: Option<Other>,
    /// Whether [`speak`] runs: it may still sleep when one bond has ended and the next one begins.
    is_speaking: bool,
}

/// The other side.
struct Other {
    instance: String,
    heard: Instant,
    timeout: Duration,
    /// Since when this side says that the bond is over.
    broken: Option<Instant>,
}

/// What is published next.
enum Beat {
    /// A heartbeat, or with `false` the end of the bond, and the time until the next one.
    Say(bool, Duration),
    /// Nothing any more.
    Over,
}

impl Bond {
    pub(super) fn new(node: &Node, is_active: bool) -> Result<Self, NodeError> {
        let kind = MessageType::new(Status::TYPE_NAME)?;
        // Depths as in bond.cpp.
        let publisher = node.publish("bond", &kind, QosProfile::DEFAULT.keep_last(5))?;
        let Time { sec, nanosec } = wall_time();
        let shared = Arc::new(Shared {
            id: node.name().name().to_owned(),
            instance: format!("{}_{}_{sec}.{nanosec}", node.name(), std::process::id()),
            publisher,
            state: Mutex::new(State { is_active, ..State::default() }),
        });
        let (weak, worker) = (Arc::downgrade(&shared), node.worker());
        let qos = QosProfile::DEFAULT.keep_last(100);
        let hear = move |sample: Sample| {
            let Ok(status) = cdr::from_slice::<Status>(&sample.cdr) else { return };
            let Some(shared) = weak.upgrade() else { return };
            if shared.state.lock().hear(&status, &shared, Instant::now()) {
                worker.spawn(speak(Weak::clone(&weak), worker.clone()));
            }
        };
        let subscription = node.subscribe("bond", &kind, qos, Box::new(hear))?;
        Ok(Self { shared, _subscription: subscription })
    }

    /// Forms bonds, or breaks the one there is.
    pub(super) fn set_active(&self, is_active: bool) {
        let mut state = self.shared.state.lock();
        let was_active = std::mem::replace(&mut state.is_active, is_active);
        if was_active
            && !is_active
            && let Some(other) = &mut state.other
        {
            other.broken = Some(Instant::now());
            drop(state);
            self.shared.say(false);
        }
    }
}

impl Drop for Bond {
    fn drop(&mut self) {
        if self.shared.state.lock().other.take().is_some() {
            self.shared.say(false);
        }
    }
}

/// Publishes heartbeats until the bond is over.
async fn speak(shared: Weak<Shared>, worker: WorkerLink) {
    loop {
        let Some(shared) = shared.upgrade() else { return };
        let beat = shared.state.lock().next(Instant::now(), &shared.id);
        let Beat::Say(is_active, wait) = beat else { return };
        shared.say(is_active);
        drop(shared);
        worker.sleep(wait).await;
    }
}

impl Shared {
    fn say(&self, active: bool) {
        let mut status = Status {
            id: self.id.clone(),
            instance_id: self.instance.clone(),
            active,
            heartbeat_timeout: Constants::DEFAULT_HEARTBEAT_TIMEOUT,
            heartbeat_period: PERIOD.as_secs_f32(),
            ..Status::default()
        };
        status.header.stamp = wall_time();
        if let Err(error) = self.publisher.publish(cdr::to_vec(&status).into()) {
            tracing::debug!(id = self.id, %error, "a heartbeat was not published");
        }
    }
}

impl State {
    /// Takes what was said on the topic. Returns true if [`speak`] has to be started.
    fn hear(&mut self, status: &Status, own: &Shared, now: Instant) -> bool {
        if status.id != own.id || status.instance_id == own.instance {
            return false;
        }
        let is_known = self.other.as_ref().is_some_and(|other| other.instance == status.instance_id);
        match (&mut self.other, status.active) {
            (Some(other), true) if is_known => {
                other.heard = now;
                false
            }
            (Some(_), false) if is_known => {
                self.other = None;
                tracing::debug!(id = own.id, "the other side of a bond has ended it");
                false
            }
            (_, false) => false,
            (_, true) if !self.is_active => false,
            (other, true) => {
                let timeout = match status.heartbeat_timeout {
                    timeout if timeout.is_finite() => timeout.clamp(SHORTEST_TIMEOUT, LONGEST_TIMEOUT),
                    _ => Constants::DEFAULT_HEARTBEAT_TIMEOUT,
                };
                *other = Some(Other {
                    instance: status.instance_id.clone(),
                    heard: now,
                    timeout: Duration::from_secs_f32(timeout),
                    broken: None,
                });
                !std::mem::replace(&mut self.is_speaking, true)
            }
        }
    }

    fn next(&mut self, now: Instant, id: &str) -> Beat {
        let Some(other) = &self.other else {
            self.is_speaking = false;
            return Beat::Over;
        };
        let is_silent = now.saturating_duration_since(other.heard) > other.timeout;
        if is_silent && other.broken.is_none() {
            tracing::warn!(id, timeout_s = other.timeout.as_secs_f32(), "the other side of a bond is silent");
        }
        let patience = Duration::from_secs_f32(Constants::DEFAULT_DISCONNECT_TIMEOUT);
        let is_given_up = other.broken.is_some_and(|since| now.saturating_duration_since(since) > patience);
        if is_silent || is_given_up {
            (self.other, self.is_speaking) = (None, false);
            return Beat::Over;
        }
        match other.broken {
            // Until the other side has heard it, which then ends the bond too.
            Some(_) => Beat::Say(false, Duration::from_secs_f32(Constants::DEAD_PUBLISH_PERIOD)),
            None => Beat::Say(true, PERIOD),
        }
    }
}
