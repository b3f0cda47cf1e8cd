//! Answers requests to the controller manager, one after the other.

use super::switch::{self, Known, Switch};
use super::{Controller, Hardware, Request};
use crate::ros::{Publisher, Reply};
use crate::worker::WorkerLink;
use downbeat_executor::{CoreHandle, LifecycleState, Transition};
use downbeat_msgs::cdr;
use downbeat_msgs::controller_manager_msgs::msg::{
    ChainConnection, ControllerManagerActivity, ControllerState, HardwareComponentState, HardwareInterface,
    NamedLifecycleState,
};
use downbeat_msgs::controller_manager_msgs::srv::{
    CleanupControllerResponse, ConfigureControllerResponse, ListControllersResponse,
    ListHardwareComponentsResponse, ListHardwareInterfacesResponse, LoadControllerResponse,
    ReloadControllerLibrariesResponse, SetHardwareComponentStateRequest, SetHardwareComponentStateResponse,
    SwitchControllerRequest, SwitchControllerResponse, UnloadControllerResponse,
};
use downbeat_msgs::lifecycle_msgs::msg::State;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// How long modules may take for what is asked of them.
const PATIENCE: Duration = Duration::from_secs(60);

pub(super) struct Manager {
    core: CoreHandle,
    worker: WorkerLink,
    controllers: Vec<Controller>,
    hardware: Vec<Hardware>,
    /// The names of controllers that were unloaded.
    unloaded: BTreeSet<String>,
    activity: Publisher,
    /// What was published last.
    published: Option<ControllerManagerActivity>,
}

/// The states of modules.
type States = BTreeMap<String, LifecycleState>;

impl Manager {
    pub(super) fn new(
        core: CoreHandle,
        worker: WorkerLink,
        controllers: Vec<Controller>,
        hardware: Vec<Hardware>,
        activity: Publisher,
    ) -> Self {
        Self { core, worker, controllers, hardware, unloaded: BTreeSet::new(), activity, published: None }
    }

    pub(super) async fn answer(&mut self, request: Request) {
        match request {
            Request::ListControllers(_, reply) => {
                let controller = self.controllers(&self.states().await);
                send(reply, &ListControllersResponse { controller });
            }
            Request::ListHardware(_, reply) => {
                let component = self.hardware(&self.states().await);
                send(reply, &ListHardwareComponentsResponse { component });
            }
            Request::ListInterfaces(_, reply) => {
                let hardware = self.hardware(&self.states().await);
                let (mut commands, mut states) = (Vec::new(), Vec::new());
                for component in hardware {
                    commands.extend(component.command_interfaces);
                    states.extend(component.state_interfaces);
                }
                send(
                    reply,
                    &ListHardwareInterfacesResponse {
                        command_interfaces: commands,
                        state_interfaces: states,
                    },
                );
            }
            Request::Load(asked, reply) => {
                let ok = self.load(&asked.name);
                send(reply, &LoadControllerResponse { ok });
            }
            Request::Unload(asked, reply) => {
                let ok = self.unload(&asked.name).await;
                send(reply, &UnloadControllerResponse { ok });
            }
            Request::Configure(asked, reply) => {
                let ok = self.change(&asked.name, Transition::Configure).await;
                send(reply, &ConfigureControllerResponse { ok });
            }
            Request::Cleanup(asked, reply) => {
                let ok = self.change(&asked.name, Transition::Cleanup).await;
                send(reply, &CleanupControllerResponse { ok });
            }
            Request::Switch(asked, reply) => {
                let (ok, message) = match self.switch(&asked).await {
                    Ok(message) => (true, message),
                    Err(problem) => {
                        tracing::error!("controllers are not switched: {problem}");
                        (false, problem)
                    }
                };
                send(reply, &SwitchControllerResponse { ok, message });
            }
            Request::SetHardware(asked, reply) => {
                let response = self.set_hardware(&asked).await;
                send(reply, &response);
            }
            Request::Reload(asked, reply) => {
                // They are compiled in: with none loaded, there is nothing that could be reloaded.
                let ok = !asked.force_kill && self.loaded().next().is_none();
                if !ok {
                    tracing::error!("controllers are parts of this program, which cannot be reloaded");
                }
                send(reply, &ReloadControllerLibrariesResponse { ok });
            }
            Request::Publish => {}
        }
        self.publish().await;
    }

    /// Publishes the states of controllers and hardware, if they have changed.
    pub(super) async fn publish(&mut self) {
        let states = self.states().await;
        let named = |name: &str, state| NamedLifecycleState { name: name.to_owned(), state: message(state) };
        let controllers = self.loaded().filter_map(|one| Some(named(&one.name, *states.get(&one.module)?)));
        let hardware =
            self.hardware.iter().filter_map(|one| Some(named(&one.module, *states.get(&one.module)?)));
        let (controllers, hardware_components) = (controllers.collect(), hardware.collect());
        let mut activity = ControllerManagerActivity {
            controllers,
            hardware_components,
            ..ControllerManagerActivity::default()
        };
        if self.published.as_ref() == Some(&activity) {
            return;
        }
        self.published = Some(activity.clone());
        activity.header.stamp = crate::lifecycle::wall_time();
        if let Err(error) = self.activity.publish(cdr::to_vec(&activity).into()) {
            tracing::warn!(%error, "the activity of the controller manager was not published");
        }
    }

    async fn states(&self) -> States {
        let modules = self.worker.within(PATIENCE, self.core.modules()).await.flatten().unwrap_or_default();
        modules.into_iter().map(|module| (module.name.to_string(), module.state)).collect()
    }

    fn loaded(&self) -> impl Iterator<Item = &Controller> {
        self.controllers.iter().filter(|controller| !self.unloaded.contains(&controller.name))
    }

    /// The controllers that are loaded, with their states.
    fn known<'a>(&'a self, states: &States) -> Vec<Known<'a>> {
        let known =
            |controller: &'a Controller| Some(Known { controller, state: *states.get(&controller.module)? });
        self.loaded().filter_map(known).collect()
    }

    fn controllers(&self, states: &States) -> Vec<ControllerState> {
        let known = self.known(states);
        let is_active = |known: &Known<'_>| known.state == LifecycleState::Active;
        let controllers = known.iter().map(|one| {
            let Controller { name, type_name, update_rate_hz, commands, states, references, .. } =
                one.controller;
            let below =
                |other: &&Known<'_>| other.controller.references.iter().any(|one| commands.contains(one));
            let connection = |other: &Known<'_>| {
                let references = other.controller.references.iter().filter(|one| commands.contains(one));
                ChainConnection {
                    name: other.controller.name.clone(),
                    reference_interfaces: references.cloned().collect(),
                }
            };
            let commands_this = |other: &Known<'_>| {
                is_active(other) && other.controller.commands.iter().any(|one| references.contains(one))
            };
            ControllerState {
                name: name.clone(),
                state: one.state.to_string(),
                r#type: type_name.clone(),
                is_async: false,
                update_rate: *update_rate_hz,
                claimed_interfaces: if is_active(one) { commands.clone() } else { Vec::new() },
                required_command_interfaces: commands.clone(),
                required_state_interfaces: states.clone(),
                is_chainable: !references.is_empty(),
                is_chained: known.iter().any(commands_this),
                exported_state_interfaces: Vec::new(),
                reference_interfaces: references.clone(),
                chain_connections: known.iter().filter(below).map(connection).collect(),
            }
        });
        controllers.collect()
    }

    fn hardware(&self, states: &States) -> Vec<HardwareComponentState> {
        let known = self.known(states);
        let active = || known.iter().filter(|known| known.state == LifecycleState::Active);
        let commands: BTreeSet<&String> = self.controllers.iter().flat_map(|one| &one.commands).collect();
        let hardware = self.hardware.iter().filter_map(|hardware| {
            let state = *states.get(&hardware.module)?;
            let joints = hardware.joints.get();
            let interface = |name: String, is_claimed: bool| HardwareInterface {
                is_available: state == LifecycleState::Active,
                is_claimed,
                data_type: "double".to_owned(),
                name,
            };
            // A position can be commanded of each; the others where a controller does.
            let commandable = joints.iter().flat_map(|joint| {
                let names = ["position", "velocity", "effort"].map(|one| format!("{}/{one}", joint.name));
                names.into_iter().filter(|name| name.ends_with("/position") || commands.contains(name))
            });
            let is_claimed = |name: &String| active().any(|known| known.controller.commands.contains(name));
            let measured = joints
                .iter()
                .flat_map(|joint| joint.states.iter().map(|state| format!("{}/{state}", joint.name)));
            Some(HardwareComponentState {
                name: hardware.module.clone(),
                r#type: "system".to_owned(),
                is_async: true,
                rw_rate: hardware.rate_hz,
                class_type: hardware.plugin.clone(),
                plugin_name: hardware.plugin.clone(),
                state: message(state),
                command_interfaces: commandable
                    .map(|name| {
                        let is_claimed = is_claimed(&name);
                        interface(name, is_claimed)
                    })
                    .collect(),
                state_interfaces: measured.map(|name| interface(name, false)).collect(),
            })
        });
        hardware.collect()
    }

    fn load(&mut self, name: &str) -> bool {
        if !self.controllers.iter().any(|controller| controller.name == name) {
            let names: Vec<_> = self.controllers.iter().map(|controller| &*controller.name).collect();
            tracing::error!(
                "the robot file has no controller \"{name}\" to load; it has {}",
                names.join(", ")
            );
            return false;
        }
        let is_loaded = self.unloaded.remove(name);
        if !is_loaded {
            tracing::error!("the controller \"{name}\" is loaded already");
        }
        is_loaded
    }

    async fn unload(&mut self, name: &str) -> bool {
        let states = self.states().await;
        let known = self.known(&states);
        let Some(found) = known.iter().find(|known| known.controller.name == name) else {
            tracing::error!("{}", switch::unknown(name, &known));
            return false;
        };
        let ok = match found.state {
            LifecycleState::Inactive => self.change(name, Transition::Cleanup).await,
            LifecycleState::Active => {
                tracing::error!("the controller \"{name}\" is active: deactivate it before it is unloaded");
                false
            }
            LifecycleState::Unconfigured | LifecycleState::Finalized => true,
        };
        if ok {
            self.unloaded.insert(name.to_owned());
        }
        ok
    }

    /// Makes a transition of a controller.
    async fn change(&self, name: &str, transition: Transition) -> bool {
        let Some(controller) = self.loaded().find(|controller| controller.name == name) else {
            tracing::error!("there is no controller \"{name}\" to {transition}");
            return false;
        };
        if controller.module != *name {
            tracing::error!("{}", is_part(controller));
            return false;
        }
        self.transition(name, transition).await.is_ok()
    }

    async fn transition(&self, module: &str, transition: Transition) -> Result<(), String> {
        match self.worker.within(PATIENCE, self.core.transition(module, transition)).await.flatten() {
            Some(Ok(_)) => Ok(()),
            Some(Err(refused)) => Err(refused.to_string()),
            None => Err(format!("{module} did not {transition} within {PATIENCE:?}")),
        }
    }

    async fn switch(&self, asked: &SwitchControllerRequest) -> Result<String, String> {
        let states = self.states().await;
        let known = self.known(&states);
        let named = asked.activate_controllers.iter().chain(&asked.deactivate_controllers);
        let parts = known.iter().filter(|known| known.controller.module != known.controller.name);
        let is_asked = |known: &&Known<'_>| named.clone().any(|name| *name == known.controller.name);
        if let Some(part) = parts.into_iter().find(is_asked) {
            return Err(is_part(part.controller));
        }
        let Switch { deactivate, activate, left_out } = switch::plan(&known, asked)?;
        let nothing = deactivate.is_empty() && activate.is_empty();
        if nothing && !left_out.is_empty() {
            return Err(left_out.join("; "));
        }
        let seconds = u64::try_from(asked.timeout.sec).unwrap_or(0);
        let timeout = Duration::from_secs(seconds) + Duration::from_nanos(asked.timeout.nanosec.into());
        let patience = if timeout.is_zero() { PATIENCE } else { timeout.min(PATIENCE) };
        // Joints that are given back can be taken from the next cycle on.
        for (names, transition) in [(&deactivate, Transition::Deactivate), (&activate, Transition::Activate)]
        {
            self.transitions(names, transition, patience).await?;
        }
        let mut message = vec!["Successfully switched controllers!".to_owned()];
        message.extend(left_out);
        Ok(message.join("; "))
    }

    /// Makes the transition of these modules in one cycle.
    async fn transitions(
        &self,
        names: &[String],
        transition: Transition,
        patience: Duration,
    ) -> Result<(), String> {
        let asked_for: Vec<_> =
            names.iter().map(|name| (name, self.core.transition(name, transition))).collect();
        let mut problems = Vec::new();
        for (name, receipt) in asked_for {
            match self.worker.within(patience, receipt).await.flatten() {
                Some(Ok(_)) => {}
                Some(Err(refused)) => problems.push(refused.to_string()),
                None => problems.push(format!("{name} did not {transition} within {patience:?}")),
            }
        }
        if problems.is_empty() { Ok(()) } else { Err(problems.join("; ")) }
    }

    async fn set_hardware(
        &self,
        asked: &SetHardwareComponentStateRequest,
    ) -> SetHardwareComponentStateResponse {
        let states = self.states().await;
        let current = self.hardware.iter().find(|hardware| hardware.module == asked.name);
        let Some(current) = current.and_then(|hardware| states.get(&hardware.module)) else {
            let names: Vec<_> = self.hardware.iter().map(|hardware| &*hardware.module).collect();
            tracing::error!("there is no hardware \"{}\"; there is {}", asked.name, names.join(", "));
            return SetHardwareComponentStateResponse::default();
        };
        let target = of_message(&asked.target_state);
        let Some(way) = target.and_then(|target| way(*current, target)) else {
            let State { id, label } = &asked.target_state;
            tracing::error!("\"{}\" cannot go from {current} to {label} ({id})", asked.name);
            return SetHardwareComponentStateResponse { ok: false, state: message(*current) };
        };
        let mut ok = true;
        for transition in way {
            ok &= self.transition(&asked.name, transition).await.is_ok();
        }
        let state = self.states().await.get(&asked.name).copied().unwrap_or(*current);
        SetHardwareComponentStateResponse { ok, state: message(state) }
    }
}

fn is_part(controller: &Controller) -> String {
    let Controller { name, module, .. } = controller;
    format!("\"{name}\" is a part of the hardware \"{module}\" and has its state")
}

fn send<S: downbeat_msgs::Service>(reply: Reply<S>, response: &S::Response) {
    if let Err(error) = reply.send(response) {
        tracing::debug!(%error, "a reply of the controller manager was not sent");
    }
}

fn message(state: LifecycleState) -> State {
    let id = match state {
        LifecycleState::Unconfigured => State::PRIMARY_STATE_UNCONFIGURED,
        LifecycleState::Inactive => State::PRIMARY_STATE_INACTIVE,
        LifecycleState::Active => State::PRIMARY_STATE_ACTIVE,
        LifecycleState::Finalized => State::PRIMARY_STATE_FINALIZED,
    };
    State { id, label: state.to_string() }
}

/// By its id, or without one by its label, as ros2_control reads it.
fn of_message(state: &State) -> Option<LifecycleState> {
    let all = [
        LifecycleState::Unconfigured,
        LifecycleState::Inactive,
        LifecycleState::Active,
        LifecycleState::Finalized,
    ];
    all.into_iter().find(|known| {
        let known = message(*known);
        known.id == state.id || (state.id == 0 && known.label == state.label)
    })
}

/// The transitions from one state to another; `None` if there is no way.
fn way(from: LifecycleState, to: LifecycleState) -> Option<Vec<Transition>> {
    use LifecycleState::{Active, Finalized, Inactive, Unconfigured};
    use Transition::{Activate, Cleanup, Configure, Deactivate, Shutdown};
    Some(match (from, to) {
        (from, to) if from == to => vec![],
        (Unconfigured, Inactive) => vec![Configure],
        (Unconfigured, Active) => vec![Configure, Activate],
        (Inactive, Active) => vec![Activate],
        (Inactive, Unconfigured) => vec![Cleanup],
        (Active, Inactive) => vec![Deactivate],
        (Active, Unconfigured) => vec![Deactivate, Cleanup],
        (Unconfigured | Inactive | Active, Finalized) => vec![Shutdown],
        _ => return None,
    })
}
