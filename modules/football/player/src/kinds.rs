//! The kinds of modules that this package offers to robot files.

use downbeat_kind::Kind;

use crate::head::Head;
use crate::team::Team;
use crate::truth::TruthBeliefs;
use crate::walk_to::WalkTo;

/// The kinds.
#[must_use]
pub fn kinds() -> Vec<Kind> {
    vec![
        Kind::new(
            "head",
            "turns the head of a football player: searches, looks at the ball, looks ahead",
            Head::default,
        ),
        Kind::new(
            "team",
            "tells the team what a football player knows, and joins what mates say with what it sees",
            Team::default,
        ),
        Kind::new(
            "truth_beliefs",
            "what a simulated player believes without eyes: the truth with noise",
            TruthBeliefs::default,
        ),
        Kind::new(
            "walk_to",
            "walks to a place on the field, or lines up behind the ball for a kick",
            WalkTo::default,
        ),
    ]
}
