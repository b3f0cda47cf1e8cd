//! One module as a managed node.

use super::LifecycleError;
use super::machine::{RosState, RosTransition, STATES, TRANSITIONS, Track};
use super::teller::Events;
use crate::limiter::Limiter;
use crate::ros::{MessageType, Node, NodeError, Publisher, Reply, Service};
use crossbeam::channel::{Receiver, Sender, TrySendError, bounded};
use downbeat_executor::{CoreHandle, LifeStep, LifecycleState};
use downbeat_msgs::lifecycle_msgs::msg::{Transition as TransitionMessage, TransitionEvent};
use downbeat_msgs::lifecycle_msgs::srv::{
    ChangeState, ChangeStateResponse, GetAvailableStates, GetAvailableStatesResponse,
    GetAvailableTransitions, GetAvailableTransitionsResponse, GetState, GetStateResponse,
};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::{Message, cdr};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// How long a module may take for a transition until the answer is that it failed; it may be made all the same.
const PATIENCE: Duration = Duration::from_secs(60);

/// Requests for transitions that wait; what is above it is answered with a failure.
const QUEUE: usize = 64;

/// A managed node.
pub(super) struct LifecycleNode {
    // Fields drop in this order: nothing is asked any more when the thread ends.
    _services: [Service; 5],
    _changes: Changes,
    followed: Arc<Followed>,
    node: Node,
}

/// Where a module is, and who is told.
pub(super) struct Followed {
    module: String,
    track: Mutex<Track>,
    events: Publisher,
    /// Of requests that are refused or not answered, which others may repeat without end.
    lines: Limiter,
}

impl LifecycleNode {
    pub(super) fn new(
        node: Node,
        module: &str,
        state: LifecycleState,
        core: CoreHandle,
        events: Events,
    ) -> Result<Self, LifecycleError> {
        let failed = |error| LifecycleError::Node { module: module.to_owned(), error };
        let followed = Arc::new(Followed::new(&node, module, state).map_err(failed)?);
        let changes = Changes::start(Changer { followed: Arc::clone(&followed), core, events })?;
        let services = serve(&node, &followed, &changes).map_err(failed)?;
        Ok(Self { _services: services, _changes: changes, followed, node })
    }

    pub(super) fn module(&self) -> &str {
        &self.followed.module
    }

    pub(super) fn node(&self) -> &Node {
        &self.node
    }

    pub(super) fn followed(&self) -> Arc<Followed> {
        Arc::clone(&self.followed)
    }
}

/// The services of `rcl_lifecycle/src/com_interface.c`.
fn serve(node: &Node, followed: &Arc<Followed>, changes: &Changes) -> Result<[Service; 5], NodeError> {
    let [of_changes, of_state, of_transitions] = std::array::from_fn(|_| Arc::clone(followed));
    let qos = QosProfile::SERVICES;
    let transitions = |transitions: &mut dyn Iterator<Item = RosTransition>| {
        let available_transitions = transitions.map(RosTransition::to_message).collect();
        GetAvailableTransitionsResponse { available_transitions }
    };
    let jobs = changes.jobs.clone();
    Ok([
        node.serve_later::<ChangeState>("~/change_state", qos, move |request, reply| {
            if let Err(TrySendError::Full(Some((_, reply))) | TrySendError::Disconnected(Some((_, reply)))) =
                jobs.try_send(Some((request.transition, reply)))
            {
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
        let track = Mutex::new(Track::new(state));
        Ok(Self { module: module.to_owned(), track, events, lines: Limiter::default() })
    }

    fn now(&self) -> RosState {
        self.track.lock().unwrap_or_else(PoisonError::into_inner).now()
    }

    /// Goes on by a step, and tells it as rcl does: the states from and to, and nothing else.
    pub(super) fn follow(&self, step: LifeStep) {
        let taken = self.track.lock().unwrap_or_else(PoisonError::into_inner).follow(step);
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

type Job = (TransitionMessage, Reply<ChangeState>);

/// A thread of the node for requests: a transition takes as long as the module takes, and others do not wait for it.
struct Changes {
    jobs: Sender<Option<Job>>,
    thread: Option<JoinHandle<()>>,
}

struct Changer {
    followed: Arc<Followed>,
    core: CoreHandle,
    events: Events,
}

impl Changes {
    fn start(changer: Changer) -> Result<Self, std::io::Error> {
        let (jobs, received) = bounded(QUEUE);
        let thread = std::thread::Builder::new()
            .name("downbeat-change".into())
            .spawn(move || changer.run(&received))?;
        Ok(Self { jobs, thread: Some(thread) })
    }
}

impl Drop for Changes {
    fn drop(&mut self) {
        // Fails only when the thread has ended.
        let _ = self.jobs.send(None);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread that changes the state of a module panicked");
        }
    }
}

impl Changer {
    fn run(&self, jobs: &Receiver<Option<Job>>) {
        while let Ok(Some((request, reply))) = jobs.recv() {
            self.followed.answer(reply, self.change(&request));
        }
    }

    /// True if the transition was made.
    fn change(&self, request: &TransitionMessage) -> bool {
        let (module, now) = (&*self.followed.module, self.followed.now());
        let requested = RosTransition::requested(request, now).and_then(RosTransition::of_module);
        let Some(transition) = requested else {
            let (id, label) = (request.id, &request.label);
            if let Some(left_out) = self.followed.lines.allow() {
                tracing::error!(
                    module,
                    "Unable to start transition {id} {label:?} from current state {}: Transition is not registered.{left_out}",
                    now.label()
                );
            }
            return false;
        };
        let outcome = self.core.transition(module, transition).wait(PATIENCE);
        // So that who is answered and asks for the state is told the new one.
        self.events.wait();
        match outcome {
            Some(Ok(_)) => true,
            // The executor has told why.
            Some(Err(_)) => false,
            None => {
                tracing::error!(module, "{transition} was not made within {PATIENCE:?}; it may be yet");
                false
            }
        }
    }
}
