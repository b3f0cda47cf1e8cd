//! The kinds of modules that this package offers to robot files.

use downbeat_darwin_op::emulator::MemoryPorts;
use downbeat_kind::Kind;

use crate::{FootballMatch, PANEL};

/// The kinds, whose simulated robots meet their hardware modules at these ports.
#[must_use]
pub fn kinds(ports: &MemoryPorts) -> Vec<Kind> {
    let ports = ports.clone();
    vec![
        Kind::new(
            "football_match",
            "a football field with a ball, simulated robots and a referee (docs/football.md)",
            move || FootballMatch::new(ports.clone()),
        )
        .drives_device()
        .emulated()
        .with_panel(
            "Football",
            PANEL,
            &["match/state", "match/field", "match/event", "match/kick", "match/statistics"],
        ),
    ]
}
