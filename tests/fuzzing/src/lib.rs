//! What seeded fuzz tests share. A program that links this package has an allocator that counts.

mod memory;
mod random;

pub use memory::most_in;
pub use random::{Random, rounds};
