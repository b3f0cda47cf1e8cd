//! Answers transform lookups of nodes without a transform buffer, like the `buffer_server` of tf2_ros.
//!
//! | name | type | |
//! | --- | --- | --- |
//! | `tf2_buffer_server` | action tf2_msgs/LookupTransform | a goal waits until its transform is known, or for its `timeout` |
//! | `tf`, `tf_static` (in) | tf2_msgs/TFMessage | the known transforms |
//!
//! A lookup that fails is reported in the result's `error`. As in tf2_ros, a goal without a `timeout`
//! succeeds even then, and one that has waited for its transform is aborted; tf2_ros leaves `error` empty in
//! that case, so that its clients take an empty transform for the answer. A canceled goal ends at once.
//!
//! # References
//! `tf2_ros/src/buffer_server.cpp` of `ros2/geometry2`, branch jazzy.

use crate::{FoundTransform, LookupError, TransformBuffer, listen};
use downbeat_actions::{ActionServer, CancelResponse, GoalId};
use downbeat_executor::{Context, Module, Setup, SetupError, Task, Time};
use downbeat_msgs::tf2_msgs::action::{LookupTransform, LookupTransformGoal, LookupTransformResult};
use downbeat_msgs::tf2_msgs::msg::TF2Error;
use std::time::Duration;

/// Serves lookups of transforms; see the [module page](self).
#[derive(Default)]
pub struct TransformServer {
    transforms: TransformBuffer,
    server: ActionServer<LookupTransform>,
}

/// The keys of [`TransformServer`].
pub struct Ports {
    /// Due when the time-out of a goal expires.
    give_up: Task,
}

impl TransformServer {
    fn begin(&mut self, id: GoalId, ctx: &mut Context<'_, Ports>) {
        if let Some(goal) = self.server.goal(id) {
            ctx.schedule(ctx.ports.give_up, goal.accepted_at() + timeout(goal.goal()));
        }
    }

    /// Finishes goals whose transform is known or whose time-out has expired.
    fn answer(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        let ends: Vec<_> = self
            .server
            .goals()
            .filter(|goal| goal.is_active())
            .filter_map(|goal| {
                let found = look_up(&self.transforms, goal.goal());
                let is_late = is_late(goal.accepted_at(), goal.goal(), now);
                let is_aborted = found.is_err() && !timeout(goal.goal()).is_zero();
                (found.is_ok() || is_late).then(|| (goal.id(), is_aborted, result(found)))
            })
            .collect();
        for (id, is_aborted, result) in ends {
            let answered = match is_aborted {
                true => self.server.abort(ctx, id, result),
                false => self.server.succeed(ctx, id, result),
            };
            if let Err(error) = answered {
                tracing::error!("a lookup was not answered: {error}");
            }
        }
    }

    fn stop(&mut self, id: GoalId, ctx: &mut Context<'_, Ports>) {
        if let Err(error) = self.server.canceled(ctx, id, LookupTransformResult::default()) {
            tracing::error!("a lookup was not canceled: {error}");
        }
    }
}

impl Module for TransformServer {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        listen(setup, |module| &mut module.transforms)?;
        ActionServer::builder(|module: &mut Self| &mut module.server)
            .on_accepted(Self::begin)
            .on_cancel(|_, _, _| CancelResponse::Accept)
            .on_canceling(Self::stop)
            .declare(setup, "tf2_buffer_server", &mut self.server)?;
        // The task only makes the module run; goals are answered at the end of each run.
        let give_up = setup.task(|_, _| ());
        setup.each_run(Self::answer);
        Ok(Ports { give_up })
    }
}

fn timeout(goal: &LookupTransformGoal) -> Duration {
    Duration::from_nanos(u64::try_from(goal.timeout.as_nanos()).unwrap_or(0))
}

fn is_late(accepted_at: Time, goal: &LookupTransformGoal, now: Time) -> bool {
    accepted_at + timeout(goal) <= now
}

fn look_up(transforms: &TransformBuffer, goal: &LookupTransformGoal) -> Result<FoundTransform, LookupError> {
    let LookupTransformGoal { target_frame, source_frame, source_time, target_time, fixed_frame, .. } = goal;
    if goal.advanced {
        transforms.lookup_through(target_frame, *target_time, source_frame, *source_time, fixed_frame)
    } else {
        transforms.lookup(target_frame, source_frame, *source_time)
    }
}

fn result(found: Result<FoundTransform, LookupError>) -> LookupTransformResult {
    match found {
        Ok(found) => LookupTransformResult { transform: found.to_message(), error: TF2Error::default() },
        Err(error) => {
            let code = match error {
                LookupError::UnknownFrame { .. } => TF2Error::LOOKUP_ERROR,
                LookupError::Extrapolation { .. } => TF2Error::EXTRAPOLATION_ERROR,
                LookupError::NotConnected { .. } => TF2Error::CONNECTIVITY_ERROR,
                LookupError::Loop { .. } => TF2Error::TRANSFORM_ERROR,
            };
            let error = TF2Error { error: code, error_string: error.to_string() };
            LookupTransformResult { error, ..LookupTransformResult::default() }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use downbeat_executor::{Core, ManualClock};
    use downbeat_msgs::action_msgs::srv::{CancelGoalRequest, CancelGoalResponse};
    use downbeat_msgs::builtin_interfaces::msg::Duration as DurationMessage;
    use downbeat_msgs::geometry_msgs::msg::TransformStamped;
    use downbeat_msgs::tf2_msgs::action::{
        LookupTransformGetResultRequest, LookupTransformGetResultResponse, LookupTransformSendGoalRequest,
        LookupTransformSendGoalResponse,
    };
    use downbeat_msgs::tf2_msgs::msg::TFMessage;
    use downbeat_msgs::unique_identifier_msgs::msg::UUID;
    use std::sync::mpsc::{Receiver, channel};

    /// A core whose time stands still at 1000 s until it is set.
    fn core_at_zero() -> (Core, ManualClock) {
        let clock = ManualClock::new(Time::from_nanos(1_000_000_000_000));
        (Core::new().with_clock(clock.clone()), clock)
    }

    const ID: UUID = UUID { uuid: [7; 16] };

    fn call<Q: Send + 'static, R: Send + 'static>(core: &mut Core, part: &str, request: Q) -> Receiver<R> {
        let caller = core.caller::<Q, R>(&format!("tf2_buffer_server/_action/{part}")).unwrap();
        let (sender, answer) = channel();
        caller.call(request, Duration::MAX, move |result| drop(sender.send(result.unwrap()))).unwrap();
        (0..4).try_for_each(|_| core.cycle()).unwrap();
        answer
    }

    /// Requests the transform of `camera` in `map`, and its result.
    fn ask(core: &mut Core, timeout_s: i32) -> Receiver<LookupTransformGetResultResponse> {
        let goal = LookupTransformGoal {
            target_frame: "map".into(),
            source_frame: "camera".into(),
            timeout: DurationMessage { sec: timeout_s, nanosec: 0 },
            ..LookupTransformGoal::default()
        };
        let request = LookupTransformSendGoalRequest { goal_id: ID, goal };
        let accepted: Receiver<LookupTransformSendGoalResponse> = call(core, "send_goal", request);
        assert!(accepted.try_recv().unwrap().accepted);
        call(core, "get_result", LookupTransformGetResultRequest { goal_id: ID })
    }

    fn transform() -> TFMessage {
        let mut transform =
            TransformStamped { child_frame_id: "camera".into(), ..TransformStamped::default() };
        transform.header.frame_id = "map".into();
        transform.header.stamp.sec = 1000;
        transform.transform.translation.x = 0.5;
        TFMessage { transforms: vec![transform] }
    }

    #[test]
    fn a_lookup_waits_until_the_transform_is_known() {
        let (mut core, clock) = core_at_zero();
        core.add("server", TransformServer::default()).unwrap();
        let result = ask(&mut core, 5);
        clock.advance(Duration::from_secs(4));
        core.cycle().unwrap();
        assert!(result.try_recv().is_err(), "it is not known yet");
        core.inlet("tf").unwrap().publish(transform()).unwrap();
        (0..3).try_for_each(|_| core.cycle()).unwrap();
        let response = result.try_recv().unwrap();
        assert_eq!((response.status, response.result.error.error), (4, TF2Error::NO_ERROR));
        assert_eq!(response.result.transform.transform.translation.x, 0.5);
    }

    #[test]
    fn a_lookup_that_times_out_returns_the_reason() {
        let (mut core, clock) = core_at_zero();
        core.add("server", TransformServer::default()).unwrap();
        let result = ask(&mut core, 5);
        clock.advance(Duration::from_secs(5));
        (0..3).try_for_each(|_| core.cycle()).unwrap();
        let response = result.try_recv().unwrap();
        let error = response.result.error;
        // Aborted.
        assert_eq!((response.status, error.error), (6, TF2Error::LOOKUP_ERROR));
        assert!(error.error_string.contains("there is no frame"), "{}", error.error_string);
    }

    #[test]
    fn a_lookup_that_does_not_wait_succeeds_with_the_reason() {
        let (mut core, _clock) = core_at_zero();
        core.add("server", TransformServer::default()).unwrap();
        let response = ask(&mut core, 0).try_recv().unwrap();
        assert_eq!((response.status, response.result.error.error), (4, TF2Error::LOOKUP_ERROR));
    }

    #[test]
    fn a_lookup_is_canceled() {
        let (mut core, _clock) = core_at_zero();
        core.add("server", TransformServer::default()).unwrap();
        let result = ask(&mut core, 5);
        let mut request = CancelGoalRequest::default();
        request.goal_info.goal_id = ID;
        let canceled: Receiver<CancelGoalResponse> = call(&mut core, "cancel_goal", request);
        assert_eq!(canceled.try_recv().unwrap().return_code, CancelGoalResponse::ERROR_NONE);
        assert_eq!(result.try_recv().unwrap().status, 5);
    }
}
