//! The server side of an action: goals that a module has accepted.

use super::goal::GoalEvent;
use super::{
    GetResultRequest, GetResultResponse, GoalError, GoalId, GoalStatus, SendGoalRequest, SendGoalResponse,
    part, stamp,
};
use downbeat_executor::{Context, Module, Publication, Responder, Setup, SetupError, Task, Time};
use downbeat_msgs::action_msgs::msg::{GoalInfo, GoalStatus as StatusMessage, GoalStatusArray};
use downbeat_msgs::action_msgs::srv::{CancelGoalRequest, CancelGoalResponse};
use downbeat_msgs::unique_identifier_msgs::msg::UUID;
use downbeat_msgs::{Action, cdr};
use std::time::Duration;

/// The goals of one action that a module serves; see the [module page](super).
pub struct ActionServer<A: Action> {
    action: String,
    /// `None` until it is declared.
    keys: Option<Keys<A>>,
    /// In the order in which they were accepted.
    goals: Vec<Goal<A>>,
    result_timeout: Duration,
}

/// An accepted goal.
pub struct Goal<A: Action> {
    id: GoalId,
    goal: A::Goal,
    accepted_at: Time,
    status: GoalStatus,
    /// When it ended, and how.
    end: Option<(Time, A::Result)>,
    /// Pending requests for its result.
    waiting: Vec<ResultResponder<A>>,
    /// The size of its messages in CDR.
    bytes: usize,
}

impl<A: Action> std::fmt::Debug for ActionServer<A> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let goals = self.goals.iter().map(|goal| (goal.id, goal.status));
        f.debug_struct("ActionServer")
            .field("action", &self.action)
            .field("goals", &goals.collect::<Vec<_>>())
            .finish_non_exhaustive()
    }
}

struct Keys<A: Action> {
    feedback: Publication<A::FeedbackMessage>,
    status: Publication<GoalStatusArray>,
    expiry: Task,
}

impl<A: Action> Default for ActionServer<A> {
    /// Creates a server that serves nothing until it is declared.
    fn default() -> Self {
        Self { action: String::new(), keys: None, goals: Vec::new(), result_timeout: Self::RESULT_TIMEOUT }
    }
}

impl<A: Action> ActionServer<A> {
    /// How long the result of a finished goal is kept by default, as in `rcl_action`
    /// (`rcl_action_server_get_default_options`, branch jazzy).
    pub const RESULT_TIMEOUT: Duration = Duration::from_secs(10);

    /// The maximum number of goals. Beyond it, the result of the goal that finished first is dropped, and
    /// goals are rejected while none has finished.
    pub const MAX_GOALS: usize = 1024;

    /// The maximum size of all goals and results in CDR; beyond it, the same happens. A single goal may be
    /// larger.
    pub const MAX_BYTES: usize = 64 << 20;

    /// The maximum number of pending requests for the result of a goal.
    pub const MAX_WAITING: usize = 64;

    /// Starts a declaration; `access` returns the server in the module.
    pub fn builder<M: Module>(access: fn(&mut M) -> &mut Self) -> ServerBuilder<A, M> {
        ServerBuilder::new(access)
    }

    fn declared(action: &str, keys: Keys<A>, result_timeout: Duration) -> Self {
        Self { action: action.to_owned(), keys: Some(keys), goals: Vec::new(), result_timeout }
    }

    /// All goals whose result has not expired, in the order in which they were accepted.
    pub fn goals(&self) -> impl Iterator<Item = &Goal<A>> {
        self.goals.iter()
    }

    /// The goal of that id.
    #[must_use]
    pub fn goal(&self, id: GoalId) -> Option<&Goal<A>> {
        self.goals.iter().find(|goal| goal.id == id)
    }

    /// Starts a goal that was accepted with deferred execution.
    ///
    /// # Errors
    /// Returns an error if there is no such goal, or it is not waiting.
    pub fn execute<P>(&mut self, ctx: &mut Context<'_, P>, id: GoalId) -> Result<(), GoalError> {
        self.change(id, GoalEvent::Execute)?;
        self.publish_status(ctx);
        Ok(())
    }

    /// Publishes feedback on a goal.
    ///
    /// # Errors
    /// Returns an error if there is no such goal, or it has ended.
    pub fn publish_feedback<P>(
        &self,
        ctx: &mut Context<'_, P>,
        id: GoalId,
        feedback: A::Feedback,
    ) -> Result<(), GoalError> {
        let goal = self.goal(id).ok_or_else(|| self.unknown(id))?;
        if !goal.status.is_active() {
            return Err(self.not_in(goal, "given feedback"));
        }
        ctx.publish(self.keys().feedback, A::feedback_message(id.into(), feedback));
        Ok(())
    }

    /// Finishes a goal that was reached.
    ///
    /// # Errors
    /// Returns an error if there is no such goal, or it is neither executing nor canceling.
    pub fn succeed<P>(
        &mut self,
        ctx: &mut Context<'_, P>,
        id: GoalId,
        result: A::Result,
    ) -> Result<(), GoalError> {
        self.end(ctx, id, GoalEvent::Succeed, result)
    }

    /// Finishes a goal that cannot be reached.
    ///
    /// # Errors
    /// Returns an error if there is no such goal, or it is neither executing nor canceling.
    pub fn abort<P>(
        &mut self,
        ctx: &mut Context<'_, P>,
        id: GoalId,
        result: A::Result,
    ) -> Result<(), GoalError> {
        self.end(ctx, id, GoalEvent::Abort, result)
    }

    /// Finishes a goal that is being canceled.
    ///
    /// # Errors
    /// Returns an error if there is no such goal, or it is not being canceled.
    pub fn canceled<P>(
        &mut self,
        ctx: &mut Context<'_, P>,
        id: GoalId,
        result: A::Result,
    ) -> Result<(), GoalError> {
        self.end(ctx, id, GoalEvent::Canceled, result)
    }

    fn end<P>(
        &mut self,
        ctx: &mut Context<'_, P>,
        id: GoalId,
        event: GoalEvent,
        result: A::Result,
    ) -> Result<(), GoalError> {
        let goal = self.change(id, event)?;
        goal.bytes += cdr::encoded_size(&result);
        for responder in goal.waiting.drain(..) {
            ctx.reply(responder, Ok(A::get_result_response(goal.status.to_message(), result.clone())));
        }
        goal.end = Some((ctx.now(), result));
        self.make_room(0, 0);
        ctx.schedule_after(self.keys().expiry, self.result_timeout);
        self.publish_status(ctx);
        Ok(())
    }

    fn change(&mut self, id: GoalId, event: GoalEvent) -> Result<&mut Goal<A>, GoalError> {
        let Some(position) = self.goals.iter().position(|goal| goal.id == id) else {
            return Err(self.unknown(id));
        };
        match self.goals[position].status.after(event) {
            Some(status) => self.goals[position].status = status,
            None => return Err(self.not_in(&self.goals[position], &event.to_string())),
        }
        Ok(&mut self.goals[position])
    }

    /// The keys of a declared server; only declared servers have goals.
    fn keys(&self) -> &Keys<A> {
        match &self.keys {
            Some(keys) => keys,
            None => {
                panic!("a server of {} is used that was not declared in the module's setup", A::TYPE_NAME)
            }
        }
    }

    fn unknown(&self, goal: GoalId) -> GoalError {
        GoalError::Unknown { action: self.action.clone(), goal }
    }

    fn not_in(&self, goal: &Goal<A>, asked: &str) -> GoalError {
        let (action, asked) = (self.action.clone(), asked.to_owned());
        GoalError::Status { action, goal: goal.id, asked, status: goal.status }
    }
}

/// Handling of requests.
impl<A: Action> ActionServer<A> {
    /// Why a goal must be rejected without asking the module.
    fn refusal(&self, id: GoalId, goal: &A::Goal) -> Option<String> {
        if self.goal(id).is_some() {
            return Some("there already is a goal with that id".to_owned());
        }
        let active = || self.goals.iter().filter(|goal| goal.is_active());
        if active().count() >= Self::MAX_GOALS {
            return Some(format!("there already are {} goals", Self::MAX_GOALS));
        }
        let bytes: usize = active().map(|goal| goal.bytes).sum();
        (bytes > 0 && bytes + cdr::encoded_size(goal) > Self::MAX_BYTES)
            .then(|| format!("the goals there already are have {bytes} bytes"))
    }

    fn accept(&mut self, id: GoalId, goal: A::Goal, status: GoalStatus, accepted_at: Time) {
        let bytes = cdr::encoded_size(&goal);
        self.expire(accepted_at);
        self.make_room(1, bytes);
        self.goals.push(Goal { id, goal, accepted_at, status, end: None, waiting: Vec::new(), bytes });
    }

    /// Drops the results of the goals that finished first until so much more fits: nobody may ever ask for
    /// them. The last goal that finished stays.
    fn make_room(&mut self, goals: usize, bytes: usize) {
        let mut held = bytes + self.goals.iter().map(|goal| goal.bytes).sum::<usize>();
        while self.goals.len() + goals > Self::MAX_GOALS || held > Self::MAX_BYTES {
            let ends = self.goals.iter().enumerate();
            let ends = ends.filter_map(|(index, goal)| Some((goal.end.as_ref()?.0, index)));
            let Some((_, index)) = ends.clone().min().filter(|_| ends.count() > 1) else { return };
            held -= self.goals.remove(index).bytes;
        }
    }

    /// The goals that a cancel request selects, and the return code if there are none, as in
    /// `rcl_action_process_cancel_request`: by id, all accepted at or before a time, or all.
    fn meant_by(&self, request: &CancelGoalRequest) -> (i8, Vec<GoalId>) {
        let GoalInfo { goal_id, stamp: time } = request.goal_info;
        let is_cancelable = |goal: &&Goal<A>| goal.status.after(GoalEvent::Cancel).is_some();
        let (id, has_time) = (GoalId::from(goal_id), time != stamp(Time::ZERO));
        if goal_id != UUID::default() && !has_time {
            return match self.goal(id) {
                None => (CancelGoalResponse::ERROR_UNKNOWN_GOAL_ID, Vec::new()),
                Some(goal) if is_cancelable(&goal) => (CancelGoalResponse::ERROR_NONE, vec![id]),
                Some(_) => (CancelGoalResponse::ERROR_GOAL_TERMINATED, Vec::new()),
            };
        }
        let is_meant =
            |goal: &&Goal<A>| !has_time || goal.accepted_at.as_nanos() <= time.as_nanos() || goal.id == id;
        let goals = self.goals.iter().filter(is_cancelable).filter(is_meant).map(|goal| goal.id);
        (CancelGoalResponse::ERROR_NONE, goals.collect())
    }

    /// Marks a goal as canceling; returns `None` if it has already ended.
    fn cancel(&mut self, id: GoalId) -> Option<GoalInfo> {
        self.change(id, GoalEvent::Cancel).ok().map(|goal| goal.info())
    }

    /// Answers a request for a result, now or when it is available.
    fn tell_result<P>(&mut self, ctx: &mut Context<'_, P>, id: GoalId, responder: ResultResponder<A>) {
        let answer: GetResultResponse<A> = match self.goals.iter_mut().find(|goal| goal.id == id) {
            None => A::get_result_response(GoalStatus::Unknown.to_message(), A::Result::default()),
            Some(Goal { status, end: Some((_, result)), .. }) => {
                A::get_result_response(status.to_message(), result.clone())
            }
            Some(goal) if goal.waiting.len() < Self::MAX_WAITING => return goal.waiting.push(responder),
            Some(_) => {
                let reason =
                    format!("{} requests for the result of goal {id} are pending", Self::MAX_WAITING);
                return ctx.reply(responder, Err(reason));
            }
        };
        ctx.reply(responder, Ok(answer));
    }

    /// Removes finished goals whose result has expired.
    fn expire(&mut self, now: Time) {
        let timeout = self.result_timeout;
        let is_over = |goal: &Goal<A>| goal.end.as_ref().is_some_and(|(end, _)| *end + timeout <= now);
        self.goals.retain(|goal| !is_over(goal));
    }

    fn publish_status<P>(&self, ctx: &mut Context<'_, P>) {
        let status =
            |goal: &Goal<A>| StatusMessage { goal_info: goal.info(), status: goal.status.to_message() };
        ctx.publish(
            self.keys().status,
            GoalStatusArray { status_list: self.goals.iter().map(status).collect() },
        );
    }
}

impl<A: Action> Goal<A> {
    /// Its id.
    #[must_use]
    pub fn id(&self) -> GoalId {
        self.id
    }

    /// The goal message.
    #[must_use]
    pub fn goal(&self) -> &A::Goal {
        &self.goal
    }

    /// When it was accepted.
    #[must_use]
    pub fn accepted_at(&self) -> Time {
        self.accepted_at
    }

    /// Its status.
    #[must_use]
    pub fn status(&self) -> GoalStatus {
        self.status
    }

    /// True until it has ended.
    #[must_use]
    pub fn is_active(&self) -> bool {
        self.status.is_active()
    }

    /// True while it is being canceled.
    #[must_use]
    pub fn is_canceling(&self) -> bool {
        self.status == GoalStatus::Canceling
    }

    fn info(&self) -> GoalInfo {
        GoalInfo { goal_id: self.id.into(), stamp: stamp(self.accepted_at) }
    }
}

/// A module's decision about a goal; named as in rclcpp.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GoalResponse {
    /// The goal is rejected.
    Reject,
    /// The goal is accepted, and execution starts.
    AcceptAndExecute,
    /// The goal is accepted, and waits until [`ActionServer::execute`].
    AcceptAndDefer,
}

/// A module's decision about canceling a goal; named as in rclcpp.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CancelResponse {
    /// The goal continues.
    Reject,
    /// The module will finish it, usually with [`ActionServer::canceled`].
    Accept,
}

type ResultResponder<A> = Responder<GetResultRequest<A>, GetResultResponse<A>>;

type OnGoal<A, M> = dyn FnMut(&mut M, GoalId, &<A as Action>::Goal, &mut Context<'_, <M as Module>::Ports>) -> GoalResponse
    + Send;
type OnCancel<M> = dyn FnMut(&mut M, GoalId, &mut Context<'_, <M as Module>::Ports>) -> CancelResponse + Send;
type OnEvent<M> = dyn FnMut(&mut M, GoalId, &mut Context<'_, <M as Module>::Ports>) + Send;

/// The declaration that a module serves an action; created by [`ActionServer::builder`].
#[must_use = "an action is served when this is declared"]
pub struct ServerBuilder<A: Action, M: Module> {
    access: fn(&mut M) -> &mut ActionServer<A>,
    on_goal: Box<OnGoal<A, M>>,
    on_accepted: Box<OnEvent<M>>,
    on_cancel: Box<OnCancel<M>>,
    on_canceling: Box<OnEvent<M>>,
    result_timeout: Duration,
}

impl<A: Action, M: Module> ServerBuilder<A, M> {
    fn new(access: fn(&mut M) -> &mut ActionServer<A>) -> Self {
        Self {
            access,
            on_goal: Box::new(|_, _, _, _| GoalResponse::AcceptAndExecute),
            on_accepted: Box::new(|_, _, _| ()),
            on_cancel: Box::new(|_, _, _| CancelResponse::Reject),
            on_canceling: Box::new(|_, _, _| ()),
            result_timeout: ActionServer::<A>::RESULT_TIMEOUT,
        }
    }

    /// Sets the callback that decides about goals; by default all are accepted and executed.
    pub fn on_goal(
        mut self,
        decide: impl FnMut(&mut M, GoalId, &A::Goal, &mut Context<'_, M::Ports>) -> GoalResponse + Send + 'static,
    ) -> Self {
        self.on_goal = Box::new(decide);
        self
    }

    /// Sets the callback that is called after a goal was accepted and added to the server.
    pub fn on_accepted(
        mut self,
        begin: impl FnMut(&mut M, GoalId, &mut Context<'_, M::Ports>) + Send + 'static,
    ) -> Self {
        self.on_accepted = Box::new(begin);
        self
    }

    /// Sets the callback that decides whether an active goal may be canceled; by default none may.
    pub fn on_cancel(
        mut self,
        decide: impl FnMut(&mut M, GoalId, &mut Context<'_, M::Ports>) -> CancelResponse + Send + 'static,
    ) -> Self {
        self.on_cancel = Box::new(decide);
        self
    }

    /// Sets the callback that is called when a goal starts [canceling](super::Goal::is_canceling) after
    /// [`on_cancel`](Self::on_cancel) accepted it.
    pub fn on_canceling(
        mut self,
        begin: impl FnMut(&mut M, GoalId, &mut Context<'_, M::Ports>) + Send + 'static,
    ) -> Self {
        self.on_canceling = Box::new(begin);
        self
    }

    /// How long the result of a finished goal is kept; by default [`ActionServer::RESULT_TIMEOUT`].
    /// [`Duration::MAX`] means forever, up to [`ActionServer::MAX_GOALS`] goals.
    pub fn result_timeout(mut self, timeout: Duration) -> Self {
        self.result_timeout = timeout;
        self
    }

    /// Declares the three services and two topics of the action, in a module's setup; `server` must be the
    /// one returned by `access`.
    ///
    /// Remapping the action applies to all of them.
    ///
    /// # Errors
    /// Returns an error if the name is invalid, the action has another type, or it is already served.
    pub fn declare(
        self,
        setup: &mut Setup<'_, M>,
        action: &str,
        server: &mut ActionServer<A>,
    ) -> Result<(), SetupError> {
        let Self { access, on_goal, on_accepted, on_cancel, on_canceling, result_timeout } = self;
        let action = setup.remapped(action);
        serve_goals(setup, &action, access, on_goal, on_accepted)?;
        serve_cancels(setup, &action, access, on_cancel, on_canceling)?;
        setup.serve_later::<GetResultRequest<A>, GetResultResponse<A>, _>(
            &part(&action, "get_result"),
            move |module, request, responder, ctx| {
                access(module).tell_result(ctx, A::goal_id_of(request).into(), responder);
            },
        )?;
        let keys = Keys {
            feedback: setup.publish(&part(&action, "feedback"))?,
            status: setup.publish(&part(&action, "status"))?,
            expiry: setup.task(move |module, ctx| access(module).expire(ctx.now())),
        };
        *server = ActionServer::declared(&action, keys, result_timeout);
        Ok(())
    }
}

fn serve_goals<A: Action, M: Module>(
    setup: &mut Setup<'_, M>,
    action: &str,
    access: fn(&mut M) -> &mut ActionServer<A>,
    mut on_goal: Box<OnGoal<A, M>>,
    mut on_accepted: Box<OnEvent<M>>,
) -> Result<(), SetupError> {
    let name = action.to_owned();
    setup.serve_later::<SendGoalRequest<A>, SendGoalResponse<A>, _>(
        &part(action, "send_goal"),
        move |module, request, responder, ctx| {
            let (id, goal) = A::goal_of(request);
            let id = GoalId::from(id);
            let now = ctx.now();
            let response = match access(module).refusal(id, &goal) {
                Some(reason) => {
                    tracing::warn!("action \"{name}\": goal {id} is rejected: {reason}");
                    GoalResponse::Reject
                }
                None => on_goal(module, id, &goal, ctx),
            };
            let status = match response {
                GoalResponse::Reject => None,
                GoalResponse::AcceptAndExecute => Some(GoalStatus::Executing),
                GoalResponse::AcceptAndDefer => Some(GoalStatus::Accepted),
            };
            ctx.reply(responder, Ok(A::send_goal_response(status.is_some(), stamp(now))));
            if let Some(status) = status {
                let server = access(module);
                server.accept(id, goal, status, now);
                server.publish_status(ctx);
                on_accepted(module, id, ctx);
            }
        },
    )
}

fn serve_cancels<A: Action, M: Module>(
    setup: &mut Setup<'_, M>,
    action: &str,
    access: fn(&mut M) -> &mut ActionServer<A>,
    mut on_cancel: Box<OnCancel<M>>,
    mut on_canceling: Box<OnEvent<M>>,
) -> Result<(), SetupError> {
    setup.serve::<CancelGoalRequest, CancelGoalResponse, _>(
        &part(action, "cancel_goal"),
        move |module, request, ctx| {
            let (mut return_code, meant) = access(module).meant_by(request);
            let mut goals_canceling = Vec::new();
            for id in &meant {
                if on_cancel(module, *id, ctx) == CancelResponse::Accept {
                    // The module may have just finished it.
                    goals_canceling.extend(access(module).cancel(*id));
                }
            }
            // As in rclcpp_action: if all are refused, the request as a whole is rejected.
            if !meant.is_empty() && goals_canceling.is_empty() {
                return_code = CancelGoalResponse::ERROR_REJECTED;
            }
            if !goals_canceling.is_empty() {
                access(module).publish_status(ctx);
            }
            for goal in &goals_canceling {
                on_canceling(module, goal.goal_id.into(), ctx);
            }
            Ok(CancelGoalResponse { return_code, goals_canceling })
        },
    )
}
