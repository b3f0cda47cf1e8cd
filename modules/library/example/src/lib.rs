//! A module in Rust as a shared library.

use downbeat_library::actions::{ActionClient, ActionServer, CancelResponse, GoalId, GoalResponse};
use downbeat_library::executor::{
    Client, Context, Module, Publication, Responder, Setting, Setup, SetupError, Task, log,
};
use downbeat_library::msgs::std_msgs::msg::Float64;
use downbeat_library::msgs::std_srvs::srv::{
    SetBoolRequest, SetBoolResponse, TriggerRequest, TriggerResponse,
};
use std::fmt;
use std::time::Duration;
use user_msgs::my_msgs::action::{Lean, LeanFeedback, LeanGoal, LeanResult};
use user_msgs::my_msgs::srv::{Level, LevelRequest, LevelResponse};

/// Publishes on `out` what it receives on `in`, times its setting `gain`; counts on `ticks`; serves `enable`
/// and, of types of its own, the service `level` and the action `lean`; calls `other`, and leans elsewhere
/// with the action `lean_on`. To requests of `refuse`, `fail`, `hold` and `leave` it has no answer.
#[derive(Debug, Default)]
pub struct Amplifier {
    ticks: f64,
    lean: ActionServer<Lean>,
    lean_on: ActionClient<Lean>,
    held: Vec<Responder<TriggerRequest, TriggerResponse>>,
}

/// The ports of an [`Amplifier`].
pub struct Ports {
    out: Publication<Float64>,
    ticks: Publication<Float64>,
    answers: Publication<Float64>,
    gain: Setting<f64>,
    client: Client<SetBoolRequest, SetBoolResponse>,
    later: Task,
}

impl Module for Amplifier {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        setup.subscribe::<Float64, _>("in", |_, message, ctx| {
            let Ports { out, gain, .. } = *ctx.ports;
            let (gain, number) = (*ctx.get(gain), message.data);
            assert!(number >= 0.0, "a negative number");
            ctx.publish(out, Float64 { data: gain * number });
        })?;
        setup.every(Duration::from_millis(10), |amplifier, ctx| {
            amplifier.ticks += 1.0;
            let ticks = ctx.ports.ticks;
            ctx.publish(ticks, Float64 { data: amplifier.ticks });
            amplifier.go_on(ctx);
        })?;
        setup.serve::<SetBoolRequest, SetBoolResponse, _>("enable", |_, request, _| match request.data {
            true => Ok(SetBoolResponse { success: true, message: "on".to_owned() }),
            false => Err("it stays on".to_owned()),
        })?;
        setup.serve::<LevelRequest, LevelResponse, _>("level", |_, request, _| {
            let is_level = request.speed < 1.0;
            Ok(LevelResponse { is_level, ..LevelResponse::default() })
        })?;
        setup.subscribe::<Float64, _>("ask", |_, _, ctx| {
            let later = ctx.ports.later;
            ctx.schedule_after(later, Duration::from_millis(10));
        })?;
        setup.subscribe::<Float64, _>("lean_by", |amplifier, angle, ctx| {
            let mut wanted = LeanGoal::default();
            wanted.goal.angle = angle.data;
            amplifier.lean_on.send(ctx, wanted);
        })?;
        self.declare_actions(setup)?;
        Self::declare_refusals(setup)?;
        let later = setup.task(|_, ctx| {
            let client = ctx.ports.client;
            ctx.call(client, SetBoolRequest { data: true });
            ctx.call(client, SetBoolRequest { data: false });
        });
        let gain = setup.setting_in("gain", 2.0, 0.0..=10.0, "of the output")?;
        setup.accept_if(gain, |_, gain| if *gain == 7.0 { Err("not seven".to_owned()) } else { Ok(()) });
        Ok(Ports {
            out: setup.publish("out")?,
            ticks: setup.publish("ticks")?,
            answers: setup.publish("answers")?,
            gain,
            client: setup.client::<SetBoolRequest, SetBoolResponse, _>(
                "other",
                Duration::from_secs(1),
                |_, reply, ctx| {
                    let answers = ctx.ports.answers;
                    ctx.publish(answers, Float64 { data: if reply.result.is_ok() { 1.0 } else { -1.0 } });
                },
            )?,
            later,
        })
    }

    fn debug(&self) -> Option<&dyn fmt::Debug> {
        Some(self)
    }
}

impl Amplifier {
    fn declare_refusals(setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.serve::<TriggerRequest, TriggerResponse, _>("refuse", |_, _, _| {
            Err("the lamp is broken".into())
        })?;
        setup.serve::<TriggerRequest, TriggerResponse, _>("fail", |_, _, _| panic!("the vial is empty"))?;
        setup.serve_later::<TriggerRequest, TriggerResponse, _>("hold", |amplifier, _, responder, _| {
            log::info!("holds a request");
            amplifier.held.push(responder);
        })?;
        setup.serve_later::<TriggerRequest, TriggerResponse, _>("leave", |amplifier, _, responder, ctx| {
            amplifier.held.push(responder);
            ctx.remove_self();
        })
    }

    fn declare_actions(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        ActionServer::builder(|amplifier: &mut Self| &mut amplifier.lean)
            .on_goal(|_, _, wanted, _| match wanted.goal.angle {
                ..=1.0 => GoalResponse::AcceptAndExecute,
                100.0.. => panic!("too far"),
                _ => GoalResponse::Reject,
            })
            .on_cancel(|amplifier, id, _| match amplifier.lean.goal(id).map(|goal| goal.goal().goal.angle) {
                Some(..-20.0) => panic!("it cannot lean back"),
                Some(..-10.0) => CancelResponse::Reject,
                _ => CancelResponse::Accept,
            })
            .declare(setup, "lean", &mut self.lean)?;
        ActionClient::builder(|amplifier: &mut Self| &mut amplifier.lean_on)
            .on_response(|_, _, accepted, ctx| {
                let answers = ctx.ports.answers;
                if accepted.is_err() {
                    ctx.publish(answers, Float64 { data: -2.0 });
                }
            })
            .on_result(|_, _, end, ctx| {
                let answers = ctx.ports.answers;
                let data = end.map_or(-3.0, |end| end.result.reached.angle);
                ctx.publish(answers, Float64 { data });
            })
            .declare(setup, "lean_on", &mut self.lean_on)
    }

    /// Reaches goals at once, except those that wait to be canceled, of a negative angle. One below -10
    /// cannot be.
    fn go_on(&mut self, ctx: &mut Context<'_, Ports>) {
        let active: Vec<(GoalId, LeanGoal, bool)> = self
            .lean
            .goals()
            .filter(|goal| goal.is_active())
            .map(|goal| (goal.id(), goal.goal().clone(), goal.is_canceling()))
            .collect();
        for (id, wanted, is_canceling) in active {
            let result = LeanResult { reached: wanted.goal.clone() };
            let feedback = LeanFeedback { remaining: wanted.goal.angle };
            let ended = match (is_canceling, wanted.goal.angle < 0.0) {
                (true, _) => self.lean.canceled(ctx, id, result),
                (false, true) => self.lean.publish_feedback(ctx, id, feedback),
                (false, false) => self.lean.succeed(ctx, id, result),
            };
            assert!(ended.is_ok(), "{ended:?}");
        }
    }
}

downbeat_library::msgs::interfaces! {
    /// What the library carries.
    pub OWN: Level, Lean
}

downbeat_library::export_module!(Amplifier, OWN);
