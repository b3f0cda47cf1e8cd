//! A limit for the memory of a value that is read.

use super::Problem;

/// Formats that omit defaults, or that share tables, can represent large values with few bytes. The memory of
/// a value is therefore counted while it is read.
#[derive(Debug)]
pub(crate) struct Budget {
    left: usize,
    all: usize,
}

/// The limit for any input: more than any message of defaults.
const FLOOR: usize = 16 << 20;
/// Bytes of memory per byte of input, above the floor: a list of numbers in text or varints takes 8, of small
/// messages 100.
const FACTOR: usize = 128;

impl Budget {
    pub(crate) fn for_input(length: usize) -> Self {
        let all = length.saturating_mul(FACTOR).saturating_add(FLOOR);
        Self { left: all, all }
    }

    /// Counts bytes that are about to be allocated.
    pub(crate) fn spend(&mut self, bytes: usize) -> Result<(), Problem> {
        match self.left.checked_sub(bytes) {
            Some(left) => {
                self.left = left;
                Ok(())
            }
            None => Err(Problem::new(format!(
                "the value would take more than {} bytes of memory, too many for an input of this size",
                self.all
            ))),
        }
    }
}
