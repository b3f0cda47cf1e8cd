//! What a user writes: modules.

use crate::{Context, Setup, SetupError};

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

    /// Runs once, before every other callback.
    fn start(&mut self, _ctx: &mut Context<'_>) {}

    /// Runs once, after every other callback, unless one of them has panicked. What it publishes still
    /// reaches observers.
    fn stop(&mut self, _ctx: &mut Context<'_>) {}
}
