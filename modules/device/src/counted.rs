//! Faults that are counted, and logged less and less often.

/// Counts a fault, and decides when to log it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counted(u64);

impl Counted {
    /// Counts one occurrence. Returns true the 1st, 10th, 100th, … time.
    pub fn is_worth_a_line(&mut self) -> bool {
        self.0 += 1;
        10_u64.pow(self.0.ilog10()) == self.0
    }

    /// The number of occurrences.
    #[must_use]
    pub fn count(self) -> u64 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_of_ten_are_logged() {
        let mut counted = Counted::default();
        let lines: Vec<u64> = (1..=250).filter(|_| counted.is_worth_a_line()).collect();
        assert_eq!(lines, [1, 10, 100]);
        assert_eq!(counted.count(), 250);
    }
}
