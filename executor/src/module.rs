//! What a user writes: modules.

use crate::{Context, Setup, SetupError, TransitionError};

/// A unit of robot software: state, and callbacks that the executor calls with `&mut self`.
///
/// A module never runs concurrently with itself and knows no other module, only names of topics and
/// settings. What its callbacks ask for takes effect when the sync phase comes.
///
/// ```
/// use downbeat_executor::{Module, Setup, SetupError};
///
/// struct Thermostat;
///
/// impl Module for Thermostat {
///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
///         let target = setup.setting("target", 21.0, "room temperature to keep, °C")?;
///         let heater = setup.publish("heater")?;
///         setup.subscribe::<f64, _>("temperature", move |_, celsius, ctx| {
///             let is_cold = *celsius < *ctx.get(target);
///             ctx.publish(heater, is_cold);
///         })
///     }
/// }
/// ```
///
/// Callbacks are closures that are given the module, and capture the keys that the declarations returned. A key that
/// [`activate`](Self::activate) or another of these methods uses is kept in a field.
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
