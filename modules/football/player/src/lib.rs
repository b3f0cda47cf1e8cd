//! Skills of a football player, for a state machine, a program or a person at a keyboard.
//!
//! - [`head::Head`] looks for the ball and follows it;
//! - [`walk_to::WalkTo`] walks to places on the field and lines up for kicks;
//! - [`team::Team`] sends the player's knowledge to its mates, and merges their messages with its own
//!   perception;
//! - [`truth::TruthBeliefs`] replaces vision and localisation in simulation: it publishes the truth with
//!   noise.
//!
//! Kicks are motions of `motions`, and `falls` gets the robot up; both are in `downbeat-darwin-op`. No skill
//! decides which action comes next.
//!
//! All positions on the field are in the frame `map` of the player's team: x points to the opponents' goal, y
//! to the left, and the origin is the centre.

mod beliefs;
mod fusion;
pub mod head;
mod kinds;
mod mates;
pub mod team;
pub mod truth;
pub mod walk_to;

pub use kinds::kinds;
