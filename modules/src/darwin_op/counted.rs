//! Things that go wrong again and again: logged once, then counted.

/// Counts something that goes wrong, and says when it is worth a line in the log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Counted(u64);

impl Counted {
    /// Counts once more. True the 1st, 10th, 100th, … time.
    pub(super) fn is_worth_a_line(&mut self) -> bool {
        self.0 += 1;
        10_u64.pow(self.0.ilog10()) == self.0
    }

    /// How often it went wrong so far.
    pub(super) fn count(self) -> u64 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_log_hears_of_powers_of_ten() {
        let mut counted = Counted::default();
        let lines: Vec<u64> = (1..=250).filter(|_| counted.is_worth_a_line()).collect();
        assert_eq!(lines, [1, 10, 100]);
        assert_eq!(counted.count(), 250);
    }
}
