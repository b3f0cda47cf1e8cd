//! How a module declares that it serves an action.

use super::server::Keys;
use super::{
    ActionServer, GetResultRequest, GetResultResponse, GoalId, GoalStatus, SendGoalRequest, SendGoalResponse,
    part, stamp,
};
use downbeat_executor::{Context, Module, Responder, Setup, SetupError};
use downbeat_msgs::Action;
use downbeat_msgs::action_msgs::srv::{CancelGoalRequest, CancelGoalResponse};
use std::time::Duration;

/// What a module thinks of a goal; named as in rclcpp.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GoalResponse {
    /// It is not taken.
    Reject,
    /// It is taken, and work on it begins.
    AcceptAndExecute,
    /// It is taken, and waits until [`ActionServer::execute`].
    AcceptAndDefer,
}

/// What a module thinks of canceling a goal; named as in rclcpp.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CancelResponse {
    /// It goes on.
    Reject,
    /// The module will end it, with [`ActionServer::canceled`] or as it likes.
    Accept,
}

pub(super) type ResultResponder<A> = Responder<GetResultRequest<A>, GetResultResponse<A>>;

type OnGoal<A, M> = dyn FnMut(&mut M, GoalId, &<A as Action>::Goal, &mut Context<'_, <M as Module>::Ports>) -> GoalResponse
    + Send;
type OnCancel<M> = dyn FnMut(&mut M, GoalId, &mut Context<'_, <M as Module>::Ports>) -> CancelResponse + Send;
type OnEvent<M> = dyn FnMut(&mut M, GoalId, &mut Context<'_, <M as Module>::Ports>) + Send;

/// A declaration that a module serves an action; from [`ActionServer::builder`].
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
    pub(super) fn new(access: fn(&mut M) -> &mut ActionServer<A>) -> Self {
        Self {
            access,
            on_goal: Box::new(|_, _, _, _| GoalResponse::AcceptAndExecute),
            on_accepted: Box::new(|_, _, _| ()),
            on_cancel: Box::new(|_, _, _| CancelResponse::Reject),
            on_canceling: Box::new(|_, _, _| ()),
            result_timeout: ActionServer::<A>::RESULT_TIMEOUT,
        }
    }

    /// Decides about goals that are sent; unless given, all are accepted and executed.
    pub fn on_goal(
        mut self,
        decide: impl FnMut(&mut M, GoalId, &A::Goal, &mut Context<'_, M::Ports>) -> GoalResponse + Send + 'static,
    ) -> Self {
        self.on_goal = Box::new(decide);
        self
    }

    /// Is called when a goal was accepted: the server has it now.
    pub fn on_accepted(
        mut self,
        begin: impl FnMut(&mut M, GoalId, &mut Context<'_, M::Ports>) + Send + 'static,
    ) -> Self {
        self.on_accepted = Box::new(begin);
        self
    }

    /// Decides whether an active goal may be canceled; unless given, none may.
    pub fn on_cancel(
        mut self,
        decide: impl FnMut(&mut M, GoalId, &mut Context<'_, M::Ports>) -> CancelResponse + Send + 'static,
    ) -> Self {
        self.on_cancel = Box::new(decide);
        self
    }

    /// Is called when a goal is [canceling](super::Goal::is_canceling), since [`on_cancel`](Self::on_cancel) accepted that.
    pub fn on_canceling(
        mut self,
        begin: impl FnMut(&mut M, GoalId, &mut Context<'_, M::Ports>) + Send + 'static,
    ) -> Self {
        self.on_canceling = Box::new(begin);
        self
    }

    /// How long the result of a goal that has ended is kept, [`ActionServer::RESULT_TIMEOUT`] unless given;
    /// [`Duration::MAX`] for ever, up to [`ActionServer::MAX_GOALS`] of them.
    pub fn result_timeout(mut self, timeout: Duration) -> Self {
        self.result_timeout = timeout;
        self
    }

    /// Declares the three services and two topics of the action, in a module's setup; `server` is what `access` leads to.
    ///
    /// A name that the module was given for the action holds for all of them.
    ///
    /// # Errors
    /// A name that is not valid, an action of another type, or one that is served already.
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
            let response = match access(module).refusal(id) {
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
                    // The module may have ended it just now.
                    goals_canceling.extend(access(module).cancel(*id));
                }
            }
            // As in rclcpp_action: where all refuse, the request as a whole is rejected.
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
