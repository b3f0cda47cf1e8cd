//! Football matches of simulated robots.
//!
//! - [`FootballMatch`] is the module: a field with a ball, robots behind their simulated buses, and the
//!   referee;
//! - [`Referee`] decides the state of the game: a deterministic state machine over the true state of the
//!   field;
//! - [`Statistics`] counts what the players do, and [`Summary`] shows it as text and as a picture;
//! - [`Drill`] lets one robot shoot at an empty goal;
//! - [`player`] adds the modules of a player that can walk, kick and get up to a core.
//!
//! `docs/football.md` explains matches and players.

mod drawing;
mod drill;
mod field_world;
mod game;
mod kinds;
mod module;
mod official;
pub mod player;
mod referee;
mod statistics;
mod summary;
mod svg;
mod team_radio;

/// The panel of a match for the robot's page.
pub const PANEL: &str = include_str!("football.panel.js");

pub use drawing::draw;
pub use drill::{Drill, Placement};
pub use field_world::world_of;
pub use game::{Event, Order, Penalty, Phase, Seat, SetPlay, Team, Truth};
pub use kinds::kinds;
pub use module::{FootballMatch, seats};
pub use official::Official;
pub use referee::{Referee, Rules};
pub use statistics::Statistics;
pub use summary::Summary;
