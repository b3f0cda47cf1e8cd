//! Robots that are shown what to do: an arm that follows another one, and episodes of it to learn from.

#[cfg(test)]
mod delay;
pub mod episodes;
pub mod leader_arm;

/// The panel with the buttons of [`episodes`].
pub(crate) const EPISODES_PANEL: &str = include_str!("episodes.panel.js");
