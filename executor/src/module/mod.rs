//! Modules: the user's trait, its declarations and context, and the core's container.

mod behaviour;
mod causes;
mod cell;
mod context;
mod host;
mod id;
mod input;
mod lifecycle;
mod link;
mod log_limits;
mod options;
mod port;
mod setting_info;
mod setting_value;
mod setup;
mod uses;

pub(crate) use behaviour::{Behaviour, ModuleBehaviour};
pub(crate) use causes::{Asked, Causes, JOBS, MESSAGES, MODULES, SERVICES, SETTINGS, TIMERS};
pub(crate) use cell::{Hold, ModuleCell};
pub use context::{Context, StopRequest};
pub(crate) use host::{Host, Offer};
pub use id::ModuleId;
pub(crate) use id::Place;
pub(crate) use input::Input;
pub use lifecycle::{
    LifeEvent, LifeStep, LifecycleState, Listening, Transition, TransitionError, TransitionRefused,
};
pub(crate) use link::{Delivery, Link, Post, StepOutcome, TopicInput};
pub use options::{Inbox, ModuleOptions, Restart, Role, Synchrony};
pub use port::{ModuleChange, Port};
pub(crate) use port::{ModuleIo, Views};
pub use setting_info::SettingInfo;
pub use setting_value::{SettingType, SettingValue};
pub(crate) use setup::Given;
pub use setup::Setup;
pub(crate) use uses::{Direction, Use, UseEnds};

use std::fmt;

use crate::SetupError;

/// A unit of robot software: state, and callbacks that the executor calls with `&mut self`.
///
/// A module never runs concurrently with itself, and refers to other modules only through names of topics,
/// services and settings. Requests of its callbacks take effect in the sync phase.
///
/// ```
/// use downbeat_executor::{Context, Module, Publication, Setting, Setup, SetupError};
///
/// struct Thermostat;
///
/// struct Ports {
///     target: Setting<f64>,
///     heater: Publication<bool>,
/// }
///
/// impl Module for Thermostat {
///     type Ports = Ports;
///
///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
///         setup.subscribe::<f64, _>("temperature", |_, celsius, ctx| {
///             let is_cold = *celsius < *ctx.get(ctx.ports.target);
///             ctx.publish(ctx.ports.heater, is_cold);
///         })?;
///         Ok(Ports {
///             target: setup.setting("target", 21.0, "room temperature to keep, °C")?,
///             heater: setup.publish("heater")?,
///         })
///     }
///
///     fn shutdown(&mut self, ctx: &mut Context<'_, Ports>) {
///         ctx.publish(ctx.ports.heater, false);
///     }
/// }
/// ```
///
/// Callbacks are closures or functions that receive the module and a [`Context`], whose
/// [`ports`](Context::ports) are the value returned by `setup`. In a small module, the closures may capture
/// the keys instead, and the ports are `()`:
///
/// ```
/// # use downbeat_executor::{Module, Setup, SetupError};
/// struct Doubler;
///
/// impl Module for Doubler {
///     type Ports = ();
///
///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
///         let doubled = setup.publish("doubled")?;
///         setup.subscribe::<f64, _>("number", move |_, number, ctx| ctx.publish(doubled, 2.0 * *number))
///     }
/// }
/// ```
pub trait Module: Send + Sized + 'static {
    /// The type of [`Context::ports`], usually the keys that the declarations return.
    type Ports: Send + 'static;

    /// Declares the module's publications, subscriptions, services, timers and settings.
    ///
    /// # Errors
    /// Errors of the declarations, and [`Setup::refuse`] for other reasons.
    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Self::Ports, SetupError>;

    /// From unconfigured to inactive: acquires the resources of the module, such as a port or a map.
    ///
    /// # Errors
    /// If the transition is impossible; the module then stays unconfigured, and the error is logged.
    fn configure(&mut self, _ctx: &mut Context<'_, Self::Ports>) -> Result<(), TransitionError> {
        Ok(())
    }

    /// From inactive to active, before all other callbacks.
    ///
    /// # Errors
    /// If the transition is impossible; the module then stays inactive, and the error is logged.
    fn activate(&mut self, _ctx: &mut Context<'_, Self::Ports>) -> Result<(), TransitionError> {
        Ok(())
    }

    /// From active to inactive.
    ///
    /// # Errors
    /// If the transition is impossible; the module then stays active, and the error is logged.
    fn deactivate(&mut self, _ctx: &mut Context<'_, Self::Ports>) -> Result<(), TransitionError> {
        Ok(())
    }

    /// From inactive to unconfigured: releases the resources acquired by [`configure`](Self::configure).
    ///
    /// # Errors
    /// If the transition is impossible; the module then stays inactive, and the error is logged.
    fn cleanup(&mut self, _ctx: &mut Context<'_, Self::Ports>) -> Result<(), TransitionError> {
        Ok(())
    }

    /// To finalized, from every state: the last callback, when the module is removed or the core stops. Does
    /// not run after a panic. Messages published here still reach observers.
    fn shutdown(&mut self, _ctx: &mut Context<'_, Self::Ports>) {}

    /// What a debugger shows of the module, see [`Core::debug`](crate::Core::debug): `Some(self)` of a module
    /// that is `Debug`, or a part of it.
    fn debug(&self) -> Option<&dyn fmt::Debug> {
        None
    }
}
