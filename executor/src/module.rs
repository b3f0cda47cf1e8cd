//! What a user writes: modules.

use crate::{Context, Setup, SetupError, TransitionError};

/// A unit of robot software: state, and callbacks that the executor calls with `&mut self`.
///
/// A module never runs concurrently with itself and knows no other module, only names of topics and
/// settings. What its callbacks ask for takes effect when the sync phase comes.
///
/// ```
/// use std::time::Duration;
/// use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError};
///
/// struct Thermostat {
///     target: Option<Setting<f64>>,
///     heater: Option<Publication<bool>>,
/// }
///
/// impl Module for Thermostat {
///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
///         self.target = Some(setup.setting("target", 21.0, "room temperature to keep, °C")?);
///         self.heater = Some(setup.publish("heater")?);
///         setup.subscribe("temperature", Self::on_temperature)
///     }
/// }
///
/// impl Thermostat {
///     fn on_temperature(&mut self, celsius: Received<'_, f64>, ctx: &mut Context<'_>) {
///         let (Some(target), Some(heater)) = (self.target, self.heater) else { return };
///         let is_cold = *celsius < *ctx.get(target);
///         ctx.publish(heater, is_cold);
///     }
/// }
/// ```
pub trait Module: Send + Sized + 'static {
    /// Declares what the module publishes, receives, does periodically and can be set to.
    ///
    /// # Errors
    /// Those of the declarations, and [`Setup::refuse`] for reasons of the module's own.
    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError>;

    /// From unconfigured to inactive: gets what the module needs, such as a port or a map.
    ///
    /// # Errors
    /// A reason why it cannot; the module stays unconfigured, and that is logged.
    fn configure(&mut self, _ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        Ok(())
    }

    /// From inactive to active, before every other callback.
    ///
    /// # Errors
    /// A reason why it cannot; the module stays inactive, and that is logged.
    fn activate(&mut self, _ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        Ok(())
    }

    /// From active to inactive.
    ///
    /// # Errors
    /// A reason why it cannot; the module stays active, and that is logged.
    fn deactivate(&mut self, _ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        Ok(())
    }

    /// From inactive to unconfigured: gives back what [`configure`](Self::configure) got.
    ///
    /// # Errors
    /// A reason why it cannot; the module stays inactive, and that is logged.
    fn cleanup(&mut self, _ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        Ok(())
    }

    /// To finalized, from every state: the last callback, when the module is removed or the core stops. It does
    /// not run after a panic. What it publishes still reaches observers.
    fn shutdown(&mut self, _ctx: &mut Context<'_>) {}
}
