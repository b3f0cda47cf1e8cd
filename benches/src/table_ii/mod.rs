//! The grid of the published platform's Table II: modules by messages.

mod cell;
mod goals;
mod published;
mod table;

pub use cell::{CellResult, Row, measure};
pub use goals::{Goal, goals};
pub use published::{Published, published};
pub use table::table;

use std::num::NonZeroU64;

use crate::Load;

/// The cells of the grid, small ones first, with at most `batch` messages per cycle.
pub fn grid(batch: NonZeroU64) -> impl Iterator<Item = Load> {
    let modules = [10, 100, 1000];
    let messages = [100, 1000, 10_000, 100_000];
    modules.into_iter().flat_map(move |modules| messages.map(|messages| Load { modules, messages, batch }))
}
