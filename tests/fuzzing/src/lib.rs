//! Helpers of seeded fuzz tests. A program that links this package uses a counting allocator.

mod memory;
mod random;

pub use memory::most_in;
pub use random::{Random, rounds};
