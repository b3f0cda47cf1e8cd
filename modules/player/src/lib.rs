//! Skills of a football player, for whoever decides: an automaton, a program, a person at a keyboard.
//!
//! - [`head::Head`] looks for the ball and follows it;
//! - [`walk_to::WalkTo`] walks to places on the field and lines up for kicks;
//! - [`team::Team`] tells mates what the player knows, and joins what they say with what it sees;
//! - [`truth::TruthBeliefs`] stands in for vision and localisation in simulation: the truth with noise.
//!
//! Kicks are motions of [`motions`](downbeat_modules::motions); [`falls`](downbeat_modules::falls) gets the robot up. No skill decides
//! what to do next.
//!
//! All positions on the field are in the frame `map` of the player's team: x towards the opponents' goal, y to the left, the origin
//! in the centre.

mod beliefs;
mod fusion;
pub mod head;
mod mates;
pub mod team;
pub mod truth;
pub mod walk_to;
