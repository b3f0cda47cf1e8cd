//! Checks whether a command processed a bag completely.

use anyhow::bail;

use crate::bags::Reader;

/// Fails if parts of the bags were lost: missing or damaged parts of the files, and `unreadable` parts and
/// messages found by the command. Readable parts have been written before.
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
        "incomplete: {parts} {} cannot be read; see above, and `downbeat bag check {1}`; `downbeat bag repair \
         {1}` creates a complete bag from what can be read",
        if parts == 1 { "part" } else { "parts" },
        shown.unwrap_or_default()
    )
}
