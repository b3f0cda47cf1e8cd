//! The kinds of modules that this package offers to robot files.

use downbeat_kind::Kind;

use crate::Localisation;

/// The kinds.
#[must_use]
pub fn kinds() -> Vec<Kind> {
    vec![Kind::new(
        "localisation",
        "where a football player and the ball are on the field, from what vision sees and odometry",
        Localisation::default,
    )]
}
