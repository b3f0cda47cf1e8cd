//! Actions: goals that take time, with feedback, a result, and cancellation.
//!
//! A module serves an action with an [`ActionServer`] and uses one with an [`ActionClient`], both of them
//! fields of the module. As in ROS 2, an action consists of the services `<action>/_action/send_goal`,
//! `cancel_goal` and `get_result`, and the topics `feedback` and `status`. Modules can use each other's
//! actions, and the bridge exposes them to ROS 2 and gives modules access to those of ROS 2 without further
//! code.
//!
//! ```
//! use downbeat_executor::{Context, Core, ManualClock, Module, Setup, SetupError, Time};
//! use downbeat_actions::{ActionClient, ActionServer, CancelResponse, GoalResponse, GoalStatus};
//! use downbeat_msgs::tf2_msgs::action::{LookupTransform, LookupTransformGoal, LookupTransformResult};
//! use std::sync::mpsc::{Sender, channel};
//! use std::time::Duration;
//!
//! /// Answers each goal after a second.
//! #[derive(Default)]
//! struct Lookups {
//!     server: ActionServer<LookupTransform>,
//! }
//!
//! impl Module for Lookups {
//!     type Ports = ();
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
//!         ActionServer::builder(|lookups: &mut Self| &mut lookups.server)
//!             .on_goal(|_, _, goal, _| match goal.target_frame.is_empty() {
//!                 true => GoalResponse::Reject,
//!                 false => GoalResponse::AcceptAndExecute,
//!             })
//!             .on_cancel(|_, _, _| CancelResponse::Accept)
//!             .declare(setup, "lookup", &mut self.server)?;
//!         setup.every(Duration::from_secs(1), |lookups, ctx| {
//!             let active: Vec<_> =
//!                 lookups.server.goals().filter(|goal| goal.is_active()).map(|goal| goal.id()).collect();
//!             for id in active {
//!                 let result = LookupTransformResult::default();
//!                 lookups.server.succeed(ctx, id, result).unwrap_or_else(|error| tracing::error!("{error}"));
//!             }
//!         })
//!     }
//! }
//!
//! struct Asker {
//!     client: ActionClient<LookupTransform>,
//!     ends: Sender<GoalStatus>,
//! }
//!
//! impl Module for Asker {
//!     type Ports = ();
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
//!         ActionClient::builder(|asker: &mut Self| &mut asker.client)
//!             .on_result(|asker, _, end, _| drop(end.map(|end| asker.ends.send(end.status))))
//!             .declare(setup, "lookup", &mut self.client)?;
//!         setup.subscribe::<String, _>("ask", |asker, frame, ctx| {
//!             let goal = LookupTransformGoal { target_frame: frame.clone(), ..LookupTransformGoal::default() };
//!             asker.client.send(ctx, goal);
//!         })
//!     }
//! }
//!
//! let clock = ManualClock::new(Time::ZERO);
//! let mut core = Core::new().with_clock(clock.clone());
//! core.add("lookups", Lookups::default())?;
//! let (ends, ended) = channel();
//! core.add("asker", Asker { client: ActionClient::default(), ends })?;
//! core.inlet("ask")?.publish("map".to_owned())?;
//! (0..5).try_for_each(|_| core.cycle())?; // It is asked, accepted, and asked for its result.
//! clock.advance(Duration::from_secs(1));
//! (0..2).try_for_each(|_| core.cycle())?;
//! assert_eq!(ended.try_recv()?, GoalStatus::Succeeded);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Time and order
//! Like all calls between modules, goals, answers and results take one cycle each, and the same input gives
//! the same result under every launcher. Ids of goals are derived from the names of module and action, the
//! time, and a counter.
//!
//! # References
//! - `rcl_action` and `rclcpp_action` (branch jazzy) for states, requests to cancel, status messages and
//!   expiry. Unlike in `rcl_action` 9.2.0, the time for which a result is kept starts at the goal's end, not
//!   at its acceptance.

mod client;
mod goal;
mod server;

pub use client::{ActionClient, ClientBuilder, GoalRefused, GoalResult};
pub use goal::{GoalError, GoalId, GoalStatus};
pub use server::{ActionServer, CancelResponse, Goal, GoalResponse, ServerBuilder};

use downbeat_executor::Time;
use downbeat_msgs::{Action, Service, builtin_interfaces};

type SendGoalRequest<A> = <<A as Action>::SendGoal as Service>::Request;
type SendGoalResponse<A> = <<A as Action>::SendGoal as Service>::Response;
type GetResultRequest<A> = <<A as Action>::GetResult as Service>::Request;
type GetResultResponse<A> = <<A as Action>::GetResult as Service>::Response;

/// The name of one of the five parts of an action (`rcl_action/src/rcl_action/names.c`).
fn part(action: &str, part: &str) -> String {
    format!("{action}/_action/{part}")
}

fn stamp(time: Time) -> builtin_interfaces::msg::Time {
    builtin_interfaces::msg::Time::from_nanos(time.as_nanos())
}
