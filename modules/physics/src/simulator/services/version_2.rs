//! The services that differ in version 2.1 of simulation_interfaces.

use super::{StateParts, StateRefusal, spawnables};
use crate::simulator::{HumanoidSimulator, Ports};
use crate::version_2::simulation_interfaces::msg::{
    Bounds, EntityState, Resource, Result as Outcome, Spawnable,
};
use crate::version_2::simulation_interfaces::srv::{
    GetSpawnablesRequest, GetSpawnablesResponse, SetEntityStateRequest, SetEntityStateResponse,
    SpawnEntityRequest, SpawnEntityResponse,
};
use downbeat_executor::{Context, Setup, SetupError};
use downbeat_msgs::simulation_interfaces::{msg, srv};

pub(super) fn declare(setup: &mut Setup<'_, HumanoidSimulator>) -> Result<(), SetupError> {
    setup.serve("simulator/set_entity_state", set_entity_state)?;
    setup.serve("simulator/get_spawnables", |_, _: &GetSpawnablesRequest, _| Ok(get_spawnables()))?;
    setup.serve("simulator/spawn_entity", spawn_entity)
}

fn set_entity_state(
    simulator: &mut HumanoidSimulator,
    request: &SetEntityStateRequest,
    ctx: &mut Context<'_, Ports>,
) -> Result<SetEntityStateResponse, String> {
    let EntityState { header, pose, twist, acceleration } = request.state.clone();
    let state = msg::EntityState { header, pose, twist, acceleration };
    let parts = StateParts { pose: request.set_pose, twist: request.set_twist };
    let set = simulator.try_set_entity_state(&request.entity, &state, parts, ctx.now());
    let result = set.map(outcome).unwrap_or_else(|refusal| match refusal {
        StateRefusal::Pose(why) => {
            Outcome { result: SetEntityStateResponse::INVALID_POSE, error_message: why.to_owned() }
        }
        StateRefusal::Other(refusal) => outcome(refusal),
    });
    Ok(SetEntityStateResponse { result })
}

fn get_spawnables() -> GetSpawnablesResponse {
    let srv::GetSpawnablesResponse { result, spawnables } = spawnables();
    let spawnables = spawnables.into_iter().map(|msg::Spawnable { uri, description, spawn_bounds }| {
        let msg::Bounds { r#type, points } = spawn_bounds;
        Spawnable {
            entity_resource: Resource { uri, ..Resource::default() },
            description,
            spawn_bounds: Bounds { r#type, points },
        }
    });
    GetSpawnablesResponse { result: outcome(result), spawnables: spawnables.collect() }
}

fn spawn_entity(
    simulator: &mut HumanoidSimulator,
    request: &SpawnEntityRequest,
    ctx: &mut Context<'_, Ports>,
) -> Result<SpawnEntityResponse, String> {
    let SpawnEntityRequest { name, allow_renaming, entity_resource, entity_namespace, initial_pose } =
        request.clone();
    let Resource { uri, resource_string } = entity_resource;
    let request = srv::SpawnEntityRequest {
        name,
        allow_renaming,
        uri,
        resource_string,
        entity_namespace,
        initial_pose,
    };
    let srv::SpawnEntityResponse { result, entity_name } = simulator.spawn_entity(&request, ctx)?;
    Ok(SpawnEntityResponse { result: outcome(result), entity_name })
}

fn outcome(outcome: msg::Result) -> Outcome {
    let msg::Result { result, error_message } = outcome;
    Outcome { result, error_message }
}
