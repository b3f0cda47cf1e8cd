//! The kinds of modules that this package offers to robot files.

use downbeat_kind::Kind;

use crate::Vision;

/// The kinds.
#[must_use]
pub fn kinds() -> Vec<Kind> {
    vec![
        Kind::new(
            "vision",
            "lines, ball, goal posts and robots in the pictures of a football player's camera",
            Vision::default,
        )
        .with_files(&["colours"])
        .detached(),
    ]
}
