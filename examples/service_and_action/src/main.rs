//! A gripper that serves a service and an action, and a module that uses both.

use std::process::ExitCode;
use std::time::Duration;

use downbeat::App;
use downbeat::executor::{Client, Context, Module, Reply, Setup, SetupError, TransitionError};
use downbeat::modules::actions::{
    ActionClient, ActionServer, CancelResponse, GoalId, GoalResponse, GoalStatus,
};
use downbeat_msgs::std_srvs::srv::{SetBoolRequest, SetBoolResponse};

// `gripper_msgs::action::Grip` from `gripper_msgs/action/Grip.action`, and `INTERFACES`.
downbeat_msgs::include_interfaces!();

use gripper_msgs::action::{Grip, GripFeedback, GripGoal, GripResult};

/// Distance between the open fingers, m.
const OPEN: f64 = 0.1;

/// Width of the object between the fingers, m.
const HELD: f64 = 0.06;

/// A simulated gripper: its fingers close by 1 cm every 50 ms until they hold an object.
#[derive(Default)]
struct Gripper {
    is_enabled: bool,
    width: f64,
    grip: ActionServer<Grip>,
}

impl Module for Gripper {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.serve("gripper/enable", Self::enable)?;
        ActionServer::builder(|gripper: &mut Self| &mut gripper.grip)
            .on_goal(|gripper, _, _, _| match gripper.is_enabled {
                true => GoalResponse::AcceptAndExecute,
                false => GoalResponse::Reject,
            })
            .on_accepted(|gripper, _, _| gripper.width = OPEN)
            .on_cancel(|_, _, _| CancelResponse::Accept)
            .on_canceling(|gripper, id, ctx| {
                let result = GripResult { width: gripper.width };
                gripper.grip.canceled(ctx, id, result).unwrap_or_else(|error| tracing::error!("{error}"));
            })
            .declare(setup, "gripper/grip", &mut self.grip)?;
        setup.every(Duration::from_millis(50), Self::tick)
    }
}

impl Gripper {
    fn enable(&mut self, request: &SetBoolRequest, _: &mut Context<'_>) -> Result<SetBoolResponse, String> {
        self.is_enabled = request.data;
        let message = if request.data { "enabled" } else { "disabled" }.to_owned();
        Ok(SetBoolResponse { success: true, message })
    }

    fn tick(&mut self, ctx: &mut Context<'_>) {
        let active: Vec<GoalId> =
            self.grip.goals().filter(|goal| goal.is_active()).map(|goal| goal.id()).collect();
        for id in active {
            let done = if self.width - HELD > 0.005 {
                self.width -= 0.01;
                self.grip.publish_feedback(ctx, id, GripFeedback { width: self.width })
            } else {
                self.grip.succeed(ctx, id, GripResult { width: self.width })
            };
            done.unwrap_or_else(|error| tracing::error!("{error}"));
        }
    }
}

/// Lets the gripper grip once: enables it, sends the goal and logs the result.
#[derive(Default)]
struct Planner {
    grip: ActionClient<Grip>,
}

struct PlannerPorts {
    enable: Client<SetBoolRequest, SetBoolResponse>,
}

impl Module for Planner {
    type Ports = PlannerPorts;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<PlannerPorts, SetupError> {
        ActionClient::builder(|planner: &mut Self| &mut planner.grip)
            .on_response(|_, _, response, _| match response {
                Ok(_) => tracing::info!("the goal is accepted"),
                Err(refused) => tracing::error!("{refused}"),
            })
            .on_feedback(|_, _, feedback, _| tracing::info!("closing: {:.2} m", feedback.width))
            .on_result(|_, _, end, _| match end {
                Ok(end) if end.status == GoalStatus::Succeeded => {
                    tracing::info!("holding something of {:.2} m", end.result.width);
                }
                Ok(end) => tracing::warn!("the goal ended as {:?}", end.status),
                Err(error) => tracing::error!("{error}"),
            })
            .declare(setup, "gripper/grip", &mut self.grip)?;
        let enable = setup.client("gripper/enable", Duration::from_secs(10), Self::enabled)?;
        Ok(PlannerPorts { enable })
    }

    fn activate(&mut self, ctx: &mut Context<'_, PlannerPorts>) -> Result<(), TransitionError> {
        ctx.call(ctx.ports.enable, SetBoolRequest { data: true });
        Ok(())
    }
}

impl Planner {
    fn enabled(&mut self, reply: Reply<SetBoolResponse>, ctx: &mut Context<'_, PlannerPorts>) {
        match reply.result {
            Ok(response) => {
                tracing::info!("the gripper is {}", response.message);
                self.grip.send(ctx, GripGoal { effort: 5.0 });
            }
            Err(error) => tracing::error!("{error}"),
        }
    }
}

fn app() -> App {
    App::new().interfaces(INTERFACES).kind("gripper", "a gripper (made up)", Gripper::default).kind(
        "planner",
        "has the gripper grip once",
        Planner::default,
    )
}

fn main() -> ExitCode {
    app().main()
}
