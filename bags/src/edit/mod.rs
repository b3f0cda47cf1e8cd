//! Bags made of bags.

mod copy;
mod merged;
mod reindex;

pub use copy::{Copied, Copy, CopyError};
pub use merged::{Merged, TopicMap, TypeConflict, merge_topics};
pub use reindex::reindex;
