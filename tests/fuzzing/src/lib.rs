//! Helpers of seeded fuzz tests. A program that links this package uses a counting allocator.

mod lines;
mod memory;
mod random;

pub use lines::{assert_refused, change_lines};
pub use memory::most_in;
pub use random::{Random, rounds};
