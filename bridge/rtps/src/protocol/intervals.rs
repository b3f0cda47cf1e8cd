//! Sets of numbers whose cost depends on the number of runs, not on their lengths.

use std::ops::Range;

/// A set of numbers as disjoint, non-adjacent runs in ascending order.
///
/// A range of 2^60 numbers is one run, like a range of two. Code that lets a remote peer fill a set must
/// check [`Intervals::runs`] first.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Intervals {
    runs: Vec<Range<i64>>,
}

impl Intervals {
    pub fn is_empty(&self) -> bool {
        self.runs.is_empty()
    }

    pub fn clear(&mut self) {
        self.runs.clear();
    }

    /// The number of runs, which determines the cost.
    pub fn runs(&self) -> usize {
        self.runs.len()
    }

    /// The lowest number.
    pub fn first(&self) -> Option<i64> {
        self.runs.first().map(|run| run.start)
    }

    pub fn contains(&self, number: i64) -> bool {
        self.runs.get(self.first_ending_after(number)).is_some_and(|run| run.start <= number)
    }

    pub fn insert(&mut self, range: Range<i64>) {
        if range.is_empty() {
            return;
        }
        // All runs that overlap or touch the range become one with it.
        let begin = self.runs.partition_point(|run| run.end < range.start);
        let end = begin + self.runs[begin..].partition_point(|run| run.start <= range.end);
        if begin == end {
            self.runs.insert(begin, range);
            return;
        }
        let merged = range.start.min(self.runs[begin].start)..range.end.max(self.runs[end - 1].end);
        self.runs[begin] = merged;
        self.runs.drain(begin + 1..end);
    }

    pub fn remove(&mut self, range: Range<i64>) {
        if range.is_empty() {
            return;
        }
        let begin = self.first_ending_after(range.start);
        let end = begin + self.runs[begin..].partition_point(|run| run.start < range.end);
        if begin == end {
            return;
        }
        let below = self.runs[begin].start..range.start;
        let above = range.end..self.runs[end - 1].end;
        let rest = [below, above].into_iter().filter(|run| !run.is_empty());
        self.runs.splice(begin..end, rest);
    }

    /// Returns how many numbers of `range` are in the set.
    pub fn count_in(&self, range: Range<i64>) -> u64 {
        self.runs[self.first_ending_after(range.start)..]
            .iter()
            .take_while(|run| run.start < range.end)
            .map(|run| run.end.min(range.end).abs_diff(run.start.max(range.start)))
            .sum()
    }

    /// The lowest number that is at least `from` and not in the set.
    pub fn first_absent(&self, from: i64) -> i64 {
        match self.runs.get(self.first_ending_after(from)) {
            Some(run) if run.start <= from => run.end,
            _ => from,
        }
    }

    /// Returns the numbers of `range` that are not in the set, in ascending order.
    pub fn absent(&self, range: Range<i64>) -> impl Iterator<Item = i64> {
        let mut next = range.start;
        std::iter::from_fn(move || {
            next = self.first_absent(next);
            let number = next;
            next = next.saturating_add(1);
            (number < range.end).then_some(number)
        })
    }

    fn first_ending_after(&self, number: i64) -> usize {
        self.runs.partition_point(|run| run.end <= number)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn it_behaves_as_a_set_of_numbers() {
        let (mut intervals, mut set) = (Intervals::default(), BTreeSet::new());
        let mut state = 7_u64;
        let mut random = |below: u64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) % below) as i64
        };
        for _ in 0..20_000 {
            let start = random(60);
            let range = start..start + random(9);
            if random(2) == 0 {
                intervals.insert(range.clone());
                set.extend(range);
            } else {
                intervals.remove(range.clone());
                set.retain(|number| !range.contains(number));
            }
            let probe = random(60);
            assert_eq!(intervals.contains(probe), set.contains(&probe));
            assert_eq!(intervals.first(), set.first().copied());
            assert_eq!(intervals.count_in(10..30), set.range(10..30).count() as u64);
            assert_eq!(
                intervals.absent(5..50).collect::<Vec<_>>(),
                (5..50).filter(|number| !set.contains(number)).collect::<Vec<_>>()
            );
            assert!(intervals.runs.windows(2).all(|pair| pair[0].end < pair[1].start));
        }
    }

    #[test]
    fn a_huge_range_is_one_run() {
        let mut intervals = Intervals::default();
        intervals.insert(5..1 << 60);
        assert_eq!((intervals.runs(), intervals.count_in(0..i64::MAX)), (1, (1 << 60) - 5));
        intervals.remove(1 << 40..(1 << 40) + 1);
        assert_eq!((intervals.runs(), intervals.first_absent(5)), (2, 1 << 40));
    }
}
