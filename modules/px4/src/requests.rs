//! Commands to the autopilot on behalf of callers of services, until it has answered.

use std::time::Duration;

use downbeat_executor::{Context, Responder, Time};
use downbeat_msgs::std_srvs::srv::{SetBoolRequest, SetBoolResponse, TriggerRequest, TriggerResponse};

use crate::wire::result;

/// Where a response goes.
#[derive(Debug)]
pub(crate) enum Caller {
    SetBool(Responder<SetBoolRequest, SetBoolResponse>),
    Trigger(Responder<TriggerRequest, TriggerResponse>),
}

impl Caller {
    /// Answers with what was done, or why it was not.
    pub(crate) fn answer<P>(self, outcome: Result<String, String>, ctx: &mut Context<'_, P>) {
        match self {
            Self::SetBool(responder) => {
                ctx.reply(responder, outcome.map(|message| SetBoolResponse { success: true, message }));
            }
            Self::Trigger(responder) => {
                ctx.reply(responder, outcome.map(|message| TriggerResponse { success: true, message }));
            }
        }
    }
}

/// A command that is to be sent, or was sent and is not answered.
#[derive(Debug)]
pub(crate) struct Request {
    pub(crate) caller: Caller,
    /// In words, such as "to arm".
    pub(crate) what: &'static str,
    pub(crate) command: u32,
    pub(crate) params: [f32; 3],
    pub(crate) stage: Stage,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Stage {
    /// Sent when set-points have been streamed for long enough.
    WaitsForStream,
    /// Refused if no answer comes before this time.
    Sent(Time),
}

/// The requests of all callers: one for each command, because an answer names the command alone.
#[derive(Debug, Default)]
pub(crate) struct Requests(Vec<Request>);

impl Requests {
    /// Whether one with this command waits.
    pub(crate) fn is_waiting(&self, command: u32) -> bool {
        self.0.iter().any(|request| request.command == command)
    }

    pub(crate) fn push(&mut self, request: Request) {
        self.0.push(request);
    }

    /// Takes the one that waits for set-points.
    pub(crate) fn take_waiting_for_stream(&mut self) -> Option<Request> {
        let position = self.0.iter().position(|request| request.stage == Stage::WaitsForStream)?;
        Some(self.0.swap_remove(position))
    }

    /// Takes an answer of the autopilot.
    pub(crate) fn on_answer<P>(
        &mut self,
        command: u32,
        answer: u8,
        patience: Duration,
        ctx: &mut Context<'_, P>,
    ) {
        let is_meant =
            |request: &Request| request.command == command && matches!(request.stage, Stage::Sent(_));
        let Some(position) = self.0.iter().position(is_meant) else { return };
        if answer == result::IN_PROGRESS {
            self.0[position].stage = Stage::Sent(ctx.now() + patience);
            return;
        }
        let Request { caller, what, .. } = self.0.swap_remove(position);
        let outcome = match answer {
            result::ACCEPTED => Ok(format!("PX4 has accepted the command {what}")),
            refused => Err(format!("PX4 answers the command {what}: {}", result::name(refused))),
        };
        caller.answer(outcome, ctx);
    }

    /// Refuses those to which no answer came in time.
    pub(crate) fn refuse_late<P>(&mut self, topic: &str, patience: Duration, ctx: &mut Context<'_, P>) {
        let now = ctx.now();
        while let Some(position) =
            self.0.iter().position(|request| matches!(request.stage, Stage::Sent(until) if now >= until))
        {
            let Request { caller, what, .. } = self.0.swap_remove(position);
            let reason = format!(
                "no answer on {topic} within {} s to the command {what}: is the agent running, are the topics fmu/in/* and \
                 fmu/out/* in [expose], and is `release` that of the autopilot?",
                patience.as_secs_f64()
            );
            caller.answer(Err(reason), ctx);
        }
    }
}
