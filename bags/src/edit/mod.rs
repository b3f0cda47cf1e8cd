//! Creates bags from bags.

mod copy;
mod merged;
mod reindex;

pub use copy::{Copied, Copy, CopyError};
pub use merged::{Merged, MergedBags, TypeConflict};
pub use reindex::reindex;
