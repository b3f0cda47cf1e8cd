//! Football matches of simulated robots.
//!
//! - [`Pitch`] is a field with a ball and robots, each in a core of its own behind the bytes of its own bus, all in lock-step on
//!   one clock: as fast as it can be computed, and with the same result in each run;
//! - [`Game`] is a match on it;
//! - [`Referee`] decides what the game is: a deterministic state machine over what is true on the field;
//! - [`player`] builds the core of a robot that can walk, kick and get up.

mod drawing;
mod field_world;
mod game;
mod pitch;
pub mod player;
mod referee;

pub use drawing::draw;
pub use field_world::world_of;
pub use game::{Game, GameOptions};
pub use pitch::{Entrant, Pitch, PitchError, START};
pub use referee::{Event, Order, Penalty, Phase, Referee, Rules, Seat, SetPlay, Team, Truth};
