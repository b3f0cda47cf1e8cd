//! The time of a node as of rclcpp: its own, or that of `/clock` while the parameter `use_sim_time` is true.

use super::{FollowedClock, FollowedTime, TOPIC};
use crate::ros::{Node, NodeError};
use downbeat_executor::{Clock, CoreHandle, SystemClock, Time};
use parking_lot::Mutex;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use thiserror::Error;

/// The machine's clock, or that of `/clock`: switched while it runs. Clones show the same.
///
/// ```
/// use downbeat_bridge::clock::NodeClock;
/// use downbeat_bridge::middleware::in_process::Hub;
/// use downbeat_bridge::ros::{NodeName, Participant};
/// use downbeat_executor::{Clock, Core, Time};
///
/// let participant = Participant::on(std::sync::Arc::new(Hub::new().join()))?;
/// let node = participant.create_node(NodeName::new("/", "downbeat")?)?;
/// let clock = NodeClock::default();
/// let core = Core::new().with_clock(clock.clone()); // Modules are added after this.
/// let sim_time = clock.sim_time(&node, &core.handle());
/// assert!(clock.now() > Time::ZERO);
/// sim_time.set(true)?;
/// assert_eq!(clock.now(), Time::ZERO); // No time was received yet.
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Default)]
pub struct NodeClock {
    own: Arc<SystemClock>,
    followed: FollowedClock,
    is_following: Arc<AtomicBool>,
}

/// Switches a [`NodeClock`]. Clones switch the same. It keeps its node.
#[derive(Clone)]
pub struct SimTime {
    clock: NodeClock,
    node: Node,
    core: CoreHandle,
    following: Arc<Mutex<Option<FollowedTime>>>,
}

/// The time is not that of `/clock`.
#[derive(Debug, Error)]
#[error("following {TOPIC}: {0}")]
pub struct SimTimeError(#[from] NodeError);

impl NodeClock {
    /// A switch of the clock of a core; `node` subscribes to `/clock`.
    #[must_use]
    pub fn sim_time(&self, node: &Node, core: &CoreHandle) -> SimTime {
        SimTime { clock: self.clone(), node: node.clone(), core: core.clone(), following: Arc::default() }
    }
}

impl Clock for NodeClock {
    fn now(&self) -> Time {
        if self.is_following.load(Ordering::SeqCst) { self.followed.now() } else { self.own.now() }
    }

    /// True: it goes on by itself, or is moved by others.
    fn runs_by_itself(&self) -> bool {
        true
    }
}

impl SimTime {
    /// Whether the time is that of `/clock`.
    #[must_use]
    pub fn is_on(&self) -> bool {
        self.clock.is_following.load(Ordering::SeqCst)
    }

    /// Starts or stops following `/clock`. As in rclcpp time is then 0 until one was received. The time of
    /// the core jumps: see [`Clock::now`] for what timers do.
    ///
    /// # Errors
    /// [`SimTimeError`] when the subscription cannot be created.
    pub fn set(&self, is_on: bool) -> Result<(), SimTimeError> {
        let mut following = self.following.lock();
        if is_on && following.is_none() {
            *following = Some(self.clock.followed.follow(&self.node, &self.core)?);
        }
        if self.clock.is_following.swap(is_on, Ordering::SeqCst) != is_on {
            self.core.clock_moved();
        }
        let ended = if is_on { None } else { following.take() };
        drop(following);
        // Not under the lock, since its going waits for a message that is being taken.
        drop(ended);
        Ok(())
    }

    /// The number of publishers of the time that is followed; there should be one.
    #[must_use]
    pub fn matched_publishers(&self) -> usize {
        self.following.lock().as_ref().map_or(0, FollowedTime::matched_publishers)
    }
}
