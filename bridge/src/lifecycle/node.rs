//! One module as a managed node.

use super::bond::Bond;
use super::machine::{RosState, RosTransition, STATES, TRANSITIONS, Track};
use crate::limiter::Limiter;
use crate::ros::{MessageType, Node, NodeError, Publisher, Reply, Service};
use crate::worker::{Mailbox, WorkerLink};
use downbeat_executor::{CoreHandle, LifeStep, LifecycleState, Transition};
use downbeat_msgs::lifecycle_msgs::msg::{Transition as TransitionMessage, TransitionEvent};
use downbeat_msgs::lifecycle_msgs::srv::{
    ChangeState, ChangeStateResponse, GetAvailableStates, GetAvailableStatesResponse,
    GetAvailableTransitions, GetAvailableTransitionsResponse, GetState, GetStateResponse,
};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::{Message, cdr};
use parking_lot::Mutex;
use std::sync::{Arc, Weak};
use std::time::Duration;

/// How long a module may take for a transition before the answer is that it failed; it may still be made
/// later.
const PATIENCE: Duration = Duration::from_secs(60);

/// How many requests for transitions wait; more are answered with a failure.
const QUEUE: usize = 64;

/// A managed node.
pub(super) struct LifecycleNode {
    _services: [Service; 5],
    changes: Mailbox<Change>,
    followed: Arc<Followed>,
    node: Node,
}

/// A request for a transition.
type Change = (TransitionMessage, Reply<ChangeState>);

/// The state of a module, and where its changes are published.
pub(super) struct Followed {
    module: String,
    track: Mutex<Track>,
    events: Publisher,
    bond: Bond,
    /// Of requests that are refused or not answered, which others may repeat without end.
    lines: Limiter,
}

impl LifecycleNode {
    pub(super) fn new(
        node: Node,
        module: &str,
        state: LifecycleState,
        core: CoreHandle,
    ) -> Result<Self, NodeError> {
        let followed = Arc::new(Followed::new(&node, module, state)?);
        let changes = Mailbox::new(QUEUE);
        let services = serve(&node, &followed, &changes)?;
        let (worker, requests, weak) = (node.worker(), changes.clone(), Arc::downgrade(&followed));
        // One transition of a module after the other; those of other modules do not wait for it.
        worker.clone().spawn(async move {
            while let Some((request, reply)) = requests.next().await {
                let is_changed = change(&weak, &request, &core, &worker).await;
                let Some(followed) = weak.upgrade() else { return };
                followed.answer(reply, is_changed);
            }
        });
        Ok(Self { _services: services, changes, followed, node })
    }

    pub(super) fn module(&self) -> &str {
        &self.followed.module
    }

    pub(super) fn node(&self) -> &Node {
        &self.node
    }

    pub(super) fn followed(&self) -> Weak<Followed> {
        Arc::downgrade(&self.followed)
    }
}

impl Drop for LifecycleNode {
    fn drop(&mut self) {
        self.changes.close();
    }
}

/// The services of `rcl_lifecycle/src/com_interface.c`.
fn serve(
    node: &Node,
    followed: &Arc<Followed>,
    changes: &Mailbox<Change>,
) -> Result<[Service; 5], NodeError> {
    let [of_changes, of_state, of_transitions] = std::array::from_fn(|_| Arc::clone(followed));
    let qos = QosProfile::SERVICES;
    let transitions = |transitions: &mut dyn Iterator<Item = RosTransition>| {
        let available_transitions = transitions.map(RosTransition::to_message).collect();
        GetAvailableTransitionsResponse { available_transitions }
    };
    let changes = changes.clone();
    Ok([
        node.serve_later::<ChangeState>("~/change_state", qos, move |request, reply| {
            if let Err((_, reply)) = changes.push((request.transition, reply)) {
                of_changes.answer(reply, false);
            }
        })?,
        node.serve::<GetState>("~/get_state", qos, move |_| GetStateResponse {
            current_state: of_state.now().to_message(),
        })?,
        node.serve::<GetAvailableStates>("~/get_available_states", qos, |_| GetAvailableStatesResponse {
            available_states: STATES.map(RosState::to_message).into(),
        })?,
        node.serve::<GetAvailableTransitions>("~/get_available_transitions", qos, move |_| {
            transitions(&mut of_transitions.now().transitions())
        })?,
        node.serve::<GetAvailableTransitions>("~/get_transition_graph", qos, move |_| {
            transitions(&mut TRANSITIONS.into_iter())
        })?,
    ])
}

impl Followed {
    fn new(node: &Node, module: &str, state: LifecycleState) -> Result<Self, NodeError> {
        let kind = MessageType::new(TransitionEvent::TYPE_NAME)?;
        let events = node.publish("~/transition_event", &kind, QosProfile::DEFAULT)?;
        let track = Track::new(state);
        let bond = Bond::new(node, track.now().is_active())?;
        let (module, track) = (module.to_owned(), Mutex::new(track));
        Ok(Self { module, track, events, bond, lines: Limiter::default() })
    }

    fn now(&self) -> RosState {
        self.track.lock().now()
    }

    /// Follows the module by a step, and publishes it as rcl does: the states from and to, and nothing else.
    pub(super) fn follow(&self, step: LifeStep) {
        let taken = self.track.lock().follow(step);
        for (start, goal) in taken {
            let event = TransitionEvent {
                start_state: start.to_message(),
                goal_state: goal.to_message(),
                ..TransitionEvent::default()
            };
            if let Err(error) = self.events.publish(cdr::to_vec(&event).into()) {
                tracing::warn!(module = self.module, %error, "a transition event was not published");
            }
        }
        self.bond.set_active(self.now().is_active());
    }

    fn answer(&self, reply: Reply<ChangeState>, success: bool) {
        if let Err(error) = reply.send(&ChangeStateResponse { success })
            && let Some(left_out) = self.lines.allow()
        {
            let module = &*self.module;
            tracing::warn!(module, "a request to change the state is not answered: {error}{left_out}");
        }
    }
}

/// Returns true if the transition was made.
async fn change(
    followed: &Weak<Followed>,
    request: &TransitionMessage,
    core: &CoreHandle,
    worker: &WorkerLink,
) -> bool {
    let Some((module, requested)) = requested(followed, request) else { return false };
    let outcome = worker.within(PATIENCE, core.transition(&module, requested)).await.flatten();
    // The steps of the transition are published before its answer.
    worker.catch_up().await;
    match outcome {
        Some(Ok(_)) => true,
        // The executor has logged why.
        Some(Err(_)) => false,
        None => {
            tracing::error!(module, "{requested} was not made within {PATIENCE:?}; it may be made later");
            false
        }
    }
}

/// The module, and the transition that a request means in its state.
fn requested(followed: &Weak<Followed>, request: &TransitionMessage) -> Option<(String, Transition)> {
    let followed = followed.upgrade()?;
    let (module, now) = (followed.module.clone(), followed.now());
    let requested = RosTransition::requested(request, now).and_then(RosTransition::of_module);
    if requested.is_none()
        && let Some(left_out) = followed.lines.allow()
    {
        let (id, label) = (request.id, &request.label);
        tracing::error!(
            module,
            "Unable to start transition {id} {label:?} from current state {}: Transition is not registered.{left_out}",
            now.label()
        );
    }
    requested.map(|transition| (module, transition))
}
