//! Whether all of a bag came through a command.

use anyhow::bail;

use crate::bags::Reader;

/// Fails if something of the bags did not come through: what the files lack or hold damaged, and `unreadable` parts and messages
/// that were met on the way. What could be carried over is written by then.
pub(super) fn carried_over(bags: &[Reader], unreadable: usize) -> anyhow::Result<()> {
    let is_lost = |bag: &&Reader| bag.truncation().any(|truncation| truncation.loses_messages());
    let damaged: Vec<_> = bags.iter().filter(is_lost).collect();
    let truncations = damaged.iter().flat_map(|bag| bag.truncation());
    let parts = truncations.filter(|truncation| truncation.loses_messages()).count() + unreadable;
    if parts == 0 {
        return Ok(());
    }
    let shown = damaged.first().copied().or(bags.first()).map(|bag| bag.path().display().to_string());
    bail!(
        "not all was carried over: {parts} {} cannot be read; see above, and `downbeat bag check {1}`; `downbeat bag repair \
         {1}` makes a whole bag of what can be read",
        if parts == 1 { "part" } else { "parts" },
        shown.unwrap_or_default()
    )
}
