//! The services and the action of simulation_interfaces, which tools of any simulator use.
//!
//! What a request changes takes effect with the next step of the hardware module, at most 8 ms later. While
//! the simulation is paused or stopped the world stands still, but the modules of the robot and their time do
//! not.
//!
//! # References
//! `ros-simulation/simulation_interfaces` 1.5.0, which Jazzy and Kilted have; on request 2.1.0, three of
//! whose services differ ([`version_2`]).

mod version_2;

use super::{HumanoidSimulator, Ports, WORLD, header, isometry, pose_message, twist_message};
use crate::simulation::{Request, RunState, Snapshot};
use crate::spawned::{MOST_SPAWNED, SPAWNABLES, Spawned};
use crate::world::{Engine, Motion};
use downbeat_actions::{ActionServer, CancelResponse, GoalId, GoalResponse};
use downbeat_executor::{Context, Responder, Setup, SetupError, Time};
use downbeat_msgs::simulation_interfaces::action::{
    SimulateSteps, SimulateStepsFeedback, SimulateStepsResult,
};
use downbeat_msgs::simulation_interfaces::msg::{
    EntityCategory, EntityFilters, EntityInfo, EntityState, Result as Outcome, SimulationState,
    SimulatorFeatures, Spawnable,
};
use downbeat_msgs::simulation_interfaces::srv::{
    DeleteEntityRequest, DeleteEntityResponse, GetEntitiesRequest, GetEntitiesResponse,
    GetEntitiesStatesRequest, GetEntitiesStatesResponse, GetEntityInfoRequest, GetEntityInfoResponse,
    GetEntityStateRequest, GetEntityStateResponse, GetSimulationStateRequest, GetSimulationStateResponse,
    GetSimulatorFeaturesRequest, GetSimulatorFeaturesResponse, GetSpawnablesRequest, GetSpawnablesResponse,
    ResetSimulationRequest, ResetSimulationResponse, SetEntityStateRequest, SetEntityStateResponse,
    SetSimulationStateRequest, SetSimulationStateResponse, SpawnEntityRequest, SpawnEntityResponse,
    StepSimulationRequest, StepSimulationResponse,
};
use regex_lite::Regex;
use std::time::Duration;

/// Requests that are not answered at once.
#[derive(Default)]
pub(super) struct Services {
    /// What was asked for last.
    run: Option<RunState>,
    steps: Vec<(Responder<StepSimulationRequest, StepSimulationResponse>, Time)>,
    goal: Option<(GoalId, Time, u64)>,
    action: ActionServer<SimulateSteps>,
}

/// Versions of simulation_interfaces, as the setting names them; the first one is that of Jazzy.
pub(super) const VERSIONS: [&str; 2] = ["1.5", "2.1"];

/// The most steps of one request: more than an hour of simulated time.
const MOST_STEPS: u64 = 1_000_000;
/// The longest name of an entity, in bytes.
const LONGEST_NAME: usize = 255;
/// The longest regular expression.
const LONGEST_FILTER: usize = 1000;
/// How often it is checked whether steps are done.
const CHECK: Duration = Duration::from_millis(20);

pub(super) fn declare(
    setup: &mut Setup<'_, HumanoidSimulator>,
    services: &mut Services,
    version: &str,
) -> Result<(), SetupError> {
    setup.serve(
        "simulator/get_simulator_features",
        |module: &mut HumanoidSimulator, _: &GetSimulatorFeaturesRequest, _| {
            let engine = module.parts.as_ref().map(|parts| parts.simulation.options().engine);
            Ok(features(engine.unwrap_or_default()))
        },
    )?;
    setup.serve("simulator/get_simulation_state", HumanoidSimulator::get_state)?;
    setup.serve("simulator/set_simulation_state", HumanoidSimulator::set_state)?;
    setup.serve("simulator/reset_simulation", HumanoidSimulator::reset)?;
    setup.serve_later("simulator/step_simulation", HumanoidSimulator::step)?;
    setup.serve("simulator/get_entities", HumanoidSimulator::get_entities)?;
    setup.serve("simulator/get_entities_states", HumanoidSimulator::get_entities_states)?;
    setup.serve("simulator/get_entity_info", HumanoidSimulator::get_entity_info)?;
    setup.serve("simulator/get_entity_state", HumanoidSimulator::get_entity_state)?;
    if version == VERSIONS[0] {
        setup.serve("simulator/set_entity_state", HumanoidSimulator::set_entity_state)?;
        setup.serve("simulator/get_spawnables", |_, _: &GetSpawnablesRequest, _| Ok(spawnables()))?;
        setup.serve("simulator/spawn_entity", HumanoidSimulator::spawn_entity)?;
    } else {
        version_2::declare(setup)?;
    }
    setup.serve("simulator/delete_entity", HumanoidSimulator::delete_entity)?;
    ActionServer::builder(|module: &mut HumanoidSimulator| &mut module.services.action)
        .on_goal(|module, _, goal, _| match module.run_state() {
            RunState::Paused if goal.steps <= MOST_STEPS && module.services.goal.is_none() => {
                GoalResponse::AcceptAndExecute
            }
            _ => GoalResponse::Reject,
        })
        .on_accepted(HumanoidSimulator::begin_goal)
        .on_cancel(|_, _, _| CancelResponse::Reject)
        .declare(setup, "simulator/simulate_steps", &mut services.action)?;
    setup.every(CHECK, HumanoidSimulator::finish_steps)
}

fn features(engine: Engine) -> GetSimulatorFeaturesResponse {
    let mut features = vec![
        SimulatorFeatures::ENTITY_CATEGORIES,
        SimulatorFeatures::ENTITY_STATE_GETTING,
        SimulatorFeatures::ENTITY_STATE_SETTING,
        SimulatorFeatures::ENTITY_INFO_GETTING,
        SimulatorFeatures::SIMULATION_RESET,
        SimulatorFeatures::SIMULATION_RESET_STATE,
        SimulatorFeatures::SIMULATION_STATE_GETTING,
        SimulatorFeatures::SIMULATION_STATE_SETTING,
        SimulatorFeatures::SIMULATION_STATE_PAUSE,
        SimulatorFeatures::STEP_SIMULATION_SINGLE,
        SimulatorFeatures::STEP_SIMULATION_MULTIPLE,
        SimulatorFeatures::STEP_SIMULATION_ACTION,
    ];
    if engine.can_spawn() {
        features.extend([
            SimulatorFeatures::SPAWNING,
            SimulatorFeatures::DELETING,
            SimulatorFeatures::SPAWNING_RESOURCE_STRING,
            SimulatorFeatures::SPAWNABLES,
            SimulatorFeatures::SIMULATION_RESET_SPAWNED,
        ]);
    }
    let features = SimulatorFeatures {
        features: features.into_iter().map(u16::from).collect(),
        spawn_formats: if engine.can_spawn() { vec!["toml".to_owned()] } else { Vec::new() },
        custom_info: format!("downbeat-physics, {engine}"),
    };
    GetSimulatorFeaturesResponse { features }
}

fn spawnables() -> GetSpawnablesResponse {
    let spawnables = SPAWNABLES.map(|(name, about)| Spawnable {
        uri: name.to_owned(),
        description: about.to_owned(),
        ..Spawnable::default()
    });
    GetSpawnablesResponse { result: ok(), spawnables: spawnables.into() }
}

const BUSY: &str = "too many requests wait; try again";
const INVALID_POSE: &str = "the quaternion has not norm 1, or the position is beyond 1000 m";

/// What is set of the state of an entity.
#[derive(Clone, Copy)]
struct StateParts {
    pose: bool,
    twist: bool,
}

/// Why the state of an entity is not set.
enum StateRefusal {
    /// The pose is invalid.
    Pose(&'static str),
    Other(Outcome),
}

fn ok() -> Outcome {
    Outcome { result: Outcome::RESULT_OK, error_message: String::new() }
}

fn failed(result: u8, error_message: impl Into<String>) -> Outcome {
    Outcome { result, error_message: error_message.into() }
}

impl HumanoidSimulator {
    /// What time does after all that was asked for.
    fn run_state(&self) -> RunState {
        self.services.run.unwrap_or(RunState::Playing)
    }

    fn ask(&self, request: Request) -> Outcome {
        let is_taken = self.parts.as_ref().is_some_and(|parts| parts.simulation.request(request));
        if is_taken { ok() } else { failed(Outcome::RESULT_OPERATION_FAILED, BUSY) }
    }

    fn snapshot(&self, now: Time) -> Option<Snapshot> {
        self.begin(now).map(|parts| parts.simulation.snapshot())
    }

    fn get_state(
        &mut self,
        _: &GetSimulationStateRequest,
        _: &mut Context<'_, Ports>,
    ) -> Result<GetSimulationStateResponse, String> {
        let state = match self.run_state() {
            RunState::Playing => SimulationState::STATE_PLAYING,
            RunState::Paused => SimulationState::STATE_PAUSED,
            RunState::Stopped => SimulationState::STATE_STOPPED,
        };
        Ok(GetSimulationStateResponse { state: SimulationState { state }, result: ok() })
    }

    fn set_state(
        &mut self,
        request: &SetSimulationStateRequest,
        ctx: &mut Context<'_, Ports>,
    ) -> Result<SetSimulationStateResponse, String> {
        self.begin(ctx.now());
        let run = match request.state.state {
            SimulationState::STATE_PLAYING => RunState::Playing,
            SimulationState::STATE_PAUSED => RunState::Paused,
            SimulationState::STATE_STOPPED => RunState::Stopped,
            other => {
                let found = format!("state {other} cannot be set; there are 0 stopped, 1 playing, 2 paused");
                return Ok(SetSimulationStateResponse {
                    result: failed(Outcome::RESULT_FEATURE_UNSUPPORTED, found),
                });
            }
        };
        if run == self.run_state() {
            let result = failed(SetSimulationStateResponse::ALREADY_IN_TARGET_STATE, "it is in this state");
            return Ok(SetSimulationStateResponse { result });
        }
        let result = self.ask(Request::Run(run));
        if result.result == Outcome::RESULT_OK {
            self.services.run = Some(run);
        }
        Ok(SetSimulationStateResponse { result })
    }

    fn reset(
        &mut self,
        request: &ResetSimulationRequest,
        ctx: &mut Context<'_, Ports>,
    ) -> Result<ResetSimulationResponse, String> {
        self.begin(ctx.now());
        let scope = if request.scope == ResetSimulationRequest::SCOPE_DEFAULT {
            ResetSimulationRequest::SCOPE_ALL
        } else {
            request.scope
        };
        if scope & ResetSimulationRequest::SCOPE_SPAWNED != 0 {
            let spawned = self.parts.as_mut().map(|parts| std::mem::take(&mut parts.spawned));
            for Spawned { name, .. } in spawned.into_iter().flatten() {
                let result = self.ask(Request::Delete { thing: name });
                if result.result != Outcome::RESULT_OK {
                    return Ok(ResetSimulationResponse { result });
                }
            }
        }
        let result = if scope & ResetSimulationRequest::SCOPE_STATE != 0 {
            if let Some(parts) = &mut self.parts {
                parts.world = parts.simulation.options().world;
            }
            self.ask(Request::Reset { time: scope & ResetSimulationRequest::SCOPE_TIME != 0 })
        } else if scope & ResetSimulationRequest::SCOPE_TIME != 0 {
            failed(
                Outcome::RESULT_FEATURE_UNSUPPORTED,
                "time is reset only together with the state; set the scope to 255",
            )
        } else {
            ok()
        };
        Ok(ResetSimulationResponse { result })
    }

    fn step(
        &mut self,
        request: StepSimulationRequest,
        responder: Responder<StepSimulationRequest, StepSimulationResponse>,
        ctx: &mut Context<'_, Ports>,
    ) {
        self.begin(ctx.now());
        let result = if self.run_state() != RunState::Paused {
            failed(Outcome::RESULT_OPERATION_FAILED, "steps are possible only while the simulation is paused")
        } else if request.steps > MOST_STEPS {
            failed(
                Outcome::RESULT_OPERATION_FAILED,
                format!("at most {MOST_STEPS} steps at once are possible"),
            )
        } else {
            self.ask(Request::Steps(request.steps))
        };
        if result.result == Outcome::RESULT_OK {
            self.services.steps.push((responder, ctx.now()));
        } else {
            ctx.reply(responder, Ok(StepSimulationResponse { result }));
        }
    }

    fn begin_goal(&mut self, id: GoalId, ctx: &mut Context<'_, Ports>) {
        self.begin(ctx.now());
        let steps = self.services.action.goal(id).map_or(0, |goal| goal.goal().steps);
        self.ask(Request::Steps(steps));
        self.services.goal = Some((id, ctx.now(), steps));
    }

    /// Answers requests whose steps are done.
    fn finish_steps(&mut self, ctx: &mut Context<'_, Ports>) {
        if self.services.steps.is_empty() && self.services.goal.is_none() {
            return;
        }
        let now = ctx.now();
        let Some(snapshot) = self.snapshot(now) else { return };
        // Requests take effect in a later step than that in which they came.
        let left = if snapshot.run_state == RunState::Paused { snapshot.steps_left } else { 0 };
        let (done, waiting) = std::mem::take(&mut self.services.steps)
            .into_iter()
            .partition(|(_, asked_at)| left == 0 && now > *asked_at);
        self.services.steps = waiting;
        for (responder, _) in done {
            ctx.reply(responder, Ok(StepSimulationResponse { result: ok() }));
        }
        let Some((id, asked_at, steps)) = self.services.goal.filter(|(_, asked_at, _)| now > *asked_at)
        else {
            return;
        };
        let remaining_steps = left.min(steps);
        let feedback = SimulateStepsFeedback { completed_steps: steps - remaining_steps, remaining_steps };
        let mut told = self.services.action.publish_feedback(ctx, id, feedback);
        if left == 0 && now > asked_at {
            self.services.goal = None;
            told = told.and(self.services.action.succeed(ctx, id, SimulateStepsResult { result: ok() }));
        }
        if let Err(error) = told {
            tracing::error!("steps were not reported: {error}");
        }
    }

    /// Everything in the world: name, category, motion.
    fn entities(&self, now: Time) -> Vec<(String, u8, Motion)> {
        let Some((parts, snapshot)) = self.parts.as_ref().zip(self.snapshot(now)) else { return Vec::new() };
        let robot = (parts.simulation.options().model.name, EntityCategory::CATEGORY_ROBOT, snapshot.robot);
        let things = snapshot.things.into_iter().map(|(name, can_move, motion)| {
            let category = match can_move {
                true => EntityCategory::CATEGORY_DYNAMIC_OBJECT,
                false => EntityCategory::CATEGORY_STATIC_OBJECT,
            };
            (name, category, motion)
        });
        std::iter::once(robot).chain(things).collect()
    }

    fn selected(&self, filters: &EntityFilters, now: Time) -> Result<Vec<(String, u8, Motion)>, Outcome> {
        if !filters.tags.tags.is_empty() || !filters.bounds.points.is_empty() {
            return Err(failed(
                Outcome::RESULT_FEATURE_UNSUPPORTED,
                "there are no tags and no bounds; filter by name or category",
            ));
        }
        if filters.filter.len() > LONGEST_FILTER {
            return Err(failed(Outcome::RESULT_OPERATION_FAILED, "the filter is too long"));
        }
        let pattern = Regex::new(&filters.filter);
        let pattern = pattern.map_err(|error| failed(Outcome::RESULT_OPERATION_FAILED, error.to_string()))?;
        let categories: Vec<u8> = filters.categories.iter().map(|category| category.category).collect();
        let mut entities = self.entities(now);
        entities.retain(|(name, category, _)| {
            pattern.is_match(name) && (categories.is_empty() || categories.contains(category))
        });
        Ok(entities)
    }

    fn get_entities(
        &mut self,
        request: &GetEntitiesRequest,
        ctx: &mut Context<'_, Ports>,
    ) -> Result<GetEntitiesResponse, String> {
        Ok(match self.selected(&request.filters, ctx.now()) {
            Ok(entities) => {
                let entities = entities.into_iter().map(|(name, ..)| name).collect();
                GetEntitiesResponse { result: ok(), entities }
            }
            Err(result) => GetEntitiesResponse { result, entities: Vec::new() },
        })
    }

    fn get_entities_states(
        &mut self,
        request: &GetEntitiesStatesRequest,
        ctx: &mut Context<'_, Ports>,
    ) -> Result<GetEntitiesStatesResponse, String> {
        let now = ctx.now();
        Ok(match self.selected(&request.filters, now) {
            Ok(found) => {
                let (entities, states) =
                    found.into_iter().map(|(name, _, motion)| (name, state(now, &motion))).unzip();
                GetEntitiesStatesResponse { result: ok(), entities, states }
            }
            Err(result) => GetEntitiesStatesResponse { result, ..GetEntitiesStatesResponse::default() },
        })
    }

    /// An entity, or why there is none.
    fn entity(&self, name: &str, now: Time) -> Result<(u8, Motion), Outcome> {
        let entities = self.entities(now);
        let found = entities.iter().find(|entity| entity.0 == name);
        found.map(|(_, category, motion)| (*category, *motion)).ok_or_else(|| {
            let names: Vec<_> = entities.iter().map(|entity| entity.0.as_str()).collect();
            failed(
                Outcome::RESULT_NOT_FOUND,
                format!("there is no \"{name}\"; there are {}", names.join(", ")),
            )
        })
    }

    fn get_entity_info(
        &mut self,
        request: &GetEntityInfoRequest,
        ctx: &mut Context<'_, Ports>,
    ) -> Result<GetEntityInfoResponse, String> {
        Ok(match self.entity(&request.entity, ctx.now()) {
            Ok((category, _)) => {
                let info = EntityInfo { category: EntityCategory { category }, ..EntityInfo::default() };
                GetEntityInfoResponse { result: ok(), info }
            }
            Err(result) => GetEntityInfoResponse { result, info: EntityInfo::default() },
        })
    }

    fn get_entity_state(
        &mut self,
        request: &GetEntityStateRequest,
        ctx: &mut Context<'_, Ports>,
    ) -> Result<GetEntityStateResponse, String> {
        Ok(match self.entity(&request.entity, ctx.now()) {
            Ok((_, motion)) => GetEntityStateResponse { result: ok(), state: state(ctx.now(), &motion) },
            Err(result) => GetEntityStateResponse { result, state: EntityState::default() },
        })
    }

    fn set_entity_state(
        &mut self,
        request: &SetEntityStateRequest,
        ctx: &mut Context<'_, Ports>,
    ) -> Result<SetEntityStateResponse, String> {
        let all = StateParts { pose: true, twist: true };
        let result = self.try_set_entity_state(&request.entity, &request.state, all, ctx.now());
        let result = result.unwrap_or_else(|refusal| match refusal {
            StateRefusal::Pose(why) => failed(Outcome::RESULT_OPERATION_FAILED, why),
            StateRefusal::Other(outcome) => outcome,
        });
        Ok(SetEntityStateResponse { result })
    }

    fn try_set_entity_state(
        &self,
        entity: &str,
        state: &EntityState,
        parts: StateParts,
        now: Time,
    ) -> Result<Outcome, StateRefusal> {
        let refused = |why: &str| StateRefusal::Other(failed(Outcome::RESULT_OPERATION_FAILED, why));
        let (category, mut motion) = self.entity(entity, now).map_err(StateRefusal::Other)?;
        let EntityState { header, pose, twist, .. } = state;
        if !["", WORLD].contains(&header.frame_id.as_str()) {
            return Err(refused("only poses in the frame \"world\" are possible"));
        }
        if category == EntityCategory::CATEGORY_STATIC_OBJECT {
            return Err(refused("it is fixed; give it a mass in the world file"));
        }
        if parts.pose {
            motion.world_from_body = isometry(pose).ok_or(StateRefusal::Pose(INVALID_POSE))?;
        }
        if parts.twist {
            motion.linear = [twist.linear.x, twist.linear.y, twist.linear.z].into();
            motion.angular = [twist.angular.x, twist.angular.y, twist.angular.z].into();
            let is_possible = |of: glam::DVec3| of.length() <= 1000.0;
            if !is_possible(motion.linear) || !is_possible(motion.angular) {
                return Err(refused("the twist is not finite, or more than 1000"));
            }
        }
        let is_robot = category == EntityCategory::CATEGORY_ROBOT;
        if is_robot && parts.twist && (motion.linear.length() > 0.0 || motion.angular.length() > 0.0) {
            return Err(refused("the velocity of the robot cannot be set; push it"));
        }
        if !parts.pose && !parts.twist {
            return Ok(ok());
        }
        let thing = (!is_robot).then(|| entity.to_owned());
        Ok(self.ask(Request::SetMotion { thing, motion }))
    }
}

impl HumanoidSimulator {
    fn spawn_entity(
        &mut self,
        request: &SpawnEntityRequest,
        ctx: &mut Context<'_, Ports>,
    ) -> Result<SpawnEntityResponse, String> {
        Ok(match self.try_spawn(request, ctx.now()) {
            Ok(entity_name) => SpawnEntityResponse { result: ok(), entity_name },
            Err(result) => SpawnEntityResponse { result, entity_name: String::new() },
        })
    }

    fn check_that_bodies_can_change(&self) -> Result<(), Outcome> {
        let engine = self.parts.as_ref().map(|parts| parts.simulation.options().engine);
        match engine.filter(|engine| !engine.can_spawn()) {
            None => Ok(()),
            Some(engine) => Err(failed(
                Outcome::RESULT_FEATURE_UNSUPPORTED,
                format!("nothing can be spawned or deleted with {engine}; set physics to \"rapier\""),
            )),
        }
    }

    /// Returns the name.
    fn try_spawn(&mut self, request: &SpawnEntityRequest, now: Time) -> Result<String, Outcome> {
        self.check_that_bodies_can_change()?;
        let SpawnEntityRequest { name, allow_renaming, uri, resource_string, initial_pose, .. } = request;
        let mut spawned = match (uri.as_str(), resource_string.as_str()) {
            ("", "") => {
                let why = "neither uri nor resource_string is given";
                return Err(failed(SpawnEntityResponse::NO_RESOURCE, why));
            }
            ("", text) => Spawned::parse(text)
                .map_err(|problem| failed(SpawnEntityResponse::RESOURCE_PARSE_ERROR, problem))?,
            (uri, _) if SPAWNABLES.iter().any(|(known, _)| *known == uri) => {
                Spawned::parse(&format!("kind = \"{uri}\""))
                    .map_err(|problem| failed(SpawnEntityResponse::RESOURCE_PARSE_ERROR, problem))?
            }
            (uri, _) => {
                let known = SPAWNABLES.map(|(known, _)| known).join(", ");
                let why = format!("there is no \"{uri}\"; the uri is one of {known}");
                return Err(failed(SpawnEntityResponse::NO_RESOURCE, why));
            }
        };
        if !["", WORLD].contains(&initial_pose.header.frame_id.as_str()) {
            let why = "only poses in the frame \"world\" are possible";
            return Err(failed(SpawnEntityResponse::INVALID_POSE, why));
        }
        spawned.world_from_body = isometry(&initial_pose.pose)
            .ok_or_else(|| failed(SpawnEntityResponse::INVALID_POSE, INVALID_POSE))?;
        spawned.name = self.free_name(name, *allow_renaming, uri, now)?;
        let Some(parts) = &mut self.parts else {
            return Err(failed(Outcome::RESULT_OPERATION_FAILED, "the simulator is not set up"));
        };
        if parts.spawned.len() >= MOST_SPAWNED {
            let why = format!("{MOST_SPAWNED} things are spawned, no more are possible; delete some");
            return Err(failed(Outcome::RESULT_OPERATION_FAILED, why));
        }
        if let Some((other, depth)) = parts.simulation.overlap_of(&spawned) {
            let why =
                format!("it would be {depth:.3} m inside \"{other}\", and be thrown out of it; move it");
            return Err(failed(SpawnEntityResponse::INVALID_POSE, why));
        }
        if !parts.simulation.request(Request::Spawn(Box::new(spawned.clone()))) {
            return Err(failed(Outcome::RESULT_OPERATION_FAILED, BUSY));
        }
        let name = spawned.name.clone();
        parts.spawned.push(spawned);
        Ok(name)
    }

    /// The name, or another one if it is taken and that is allowed.
    fn free_name(&self, name: &str, may_rename: bool, kind: &str, now: Time) -> Result<String, Outcome> {
        let mut taken: Vec<String> = self.entities(now).into_iter().map(|(name, ..)| name).collect();
        taken.push("floor".to_owned());
        if let Some(parts) = &self.parts {
            // Some are not there yet.
            taken.extend(parts.spawned.iter().map(|spawned| spawned.name.clone()));
        }
        if name.len() > LONGEST_NAME || name.contains(char::is_control) {
            let why = format!("a name has at most {LONGEST_NAME} bytes, and no control characters");
            return Err(failed(SpawnEntityResponse::NAME_INVALID, why));
        }
        let is_free = |name: &String| !name.is_empty() && !taken.contains(name);
        if is_free(&name.to_owned()) {
            return Ok(name.to_owned());
        }
        if !may_rename {
            return Err(match name {
                "" => failed(SpawnEntityResponse::NAME_INVALID, "the name is empty; allow renaming"),
                _ => failed(
                    SpawnEntityResponse::NAME_NOT_UNIQUE,
                    format!("there is a \"{name}\" already; choose another name, or allow renaming"),
                ),
            });
        }
        let stem = [name, kind, "thing"].into_iter().find(|stem| !stem.is_empty()).unwrap_or_default();
        let mut names = (1..).map(|number| format!("{stem}_{number}"));
        names.find(is_free).ok_or_else(|| failed(Outcome::RESULT_OPERATION_FAILED, "no name is free"))
    }

    fn is_of_field(&self, name: &str) -> bool {
        self.parts.as_ref().is_some_and(|parts| parts.world.posts().any(|(post, _)| post == name))
    }

    fn delete_entity(
        &mut self,
        request: &DeleteEntityRequest,
        ctx: &mut Context<'_, Ports>,
    ) -> Result<DeleteEntityResponse, String> {
        let found =
            self.check_that_bodies_can_change().and_then(|()| self.entity(&request.entity, ctx.now()));
        let result = match found {
            Err(result) => result,
            Ok((EntityCategory::CATEGORY_ROBOT, _)) => {
                failed(Outcome::RESULT_OPERATION_FAILED, "the robot cannot be deleted")
            }
            Ok(_) if self.is_of_field(&request.entity) => {
                failed(Outcome::RESULT_OPERATION_FAILED, "it is a part of the field and cannot be deleted")
            }
            Ok(_) => self.ask(Request::Delete { thing: request.entity.clone() }),
        };
        if let Some(parts) = self.parts.as_mut().filter(|_| result.result == Outcome::RESULT_OK) {
            parts.spawned.retain(|spawned| spawned.name != request.entity);
            parts.world.boxes.retain(|block| block.name != request.entity);
            parts.world.ball = parts.world.ball.filter(|_| request.entity != "ball");
        }
        Ok(DeleteEntityResponse { result })
    }
}

fn state(now: Time, motion: &Motion) -> EntityState {
    EntityState {
        header: header(now, WORLD),
        pose: pose_message(&motion.world_from_body),
        twist: twist_message(motion.linear, motion.angular),
        ..EntityState::default()
    }
}
