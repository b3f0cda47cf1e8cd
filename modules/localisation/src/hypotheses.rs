//! Several filters side by side while it is not known from where a robot set out.

use crate::filter::{Believed, Filter, Landmarks, Pose};
use downbeat_football::Field;

/// Filters of which one is right. The first one is the incumbent.
#[derive(Clone, Debug)]
pub(crate) struct Hypotheses {
    field: Field,
    filters: Vec<Filter>,
    /// Pictures since the last one was added.
    pictures: u32,
    seed: u64,
}

/// After so many pictures with landmarks the best one is kept.
const TRIAL: u32 = 20;
/// By how much the fit of another one has to exceed that of the incumbent.
const MARGIN: f64 = 1.1;
/// Of starts: m, rad.
const DEVIATIONS: (f64, f64) = (0.3, 0.2);
/// The most filters.
const MOST: usize = 4;

impl Hypotheses {
    /// A filter for each start; at least one.
    pub(crate) fn new(field: Field, starts: &[Pose], seed: u64) -> Self {
        let mut hypotheses = Self { field, filters: Vec::new(), pictures: 0, seed };
        hypotheses.restart(starts);
        hypotheses
    }

    /// Forgets all that was known: the robot is at one of these poses.
    pub(crate) fn restart(&mut self, starts: &[Pose]) {
        self.filters.clear();
        self.add(starts);
    }

    /// It may have been put to one of these poses.
    pub(crate) fn add(&mut self, starts: &[Pose]) {
        self.pictures = 0;
        for start in starts.iter().take(MOST.saturating_sub(self.filters.len())) {
            // Another seed for each one, and the same ones in each run.
            self.seed = self.seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            self.filters.push(Filter::new(&self.field, &[*start], DEVIATIONS, self.seed));
        }
    }

    pub(crate) fn walk(&mut self, step: Pose) {
        self.filters.iter_mut().for_each(|filter| filter.walk(step));
    }

    pub(crate) fn see(&mut self, landmarks: &Landmarks) {
        for filter in &mut self.filters {
            filter.see(landmarks);
        }
        self.pictures += 1;
        if self.pictures >= TRIAL && self.filters.len() > 1 {
            let best = self.best();
            self.filters.swap(0, best);
            self.filters.truncate(1);
        }
    }

    pub(crate) fn believed(&self) -> Believed {
        self.filters.get(self.best()).map(Filter::believed).unwrap_or_default()
    }

    /// Whether it is decided where the robot is.
    pub(crate) fn is_decided(&self) -> bool {
        self.filters.len() == 1
    }

    fn best(&self) -> usize {
        let mut best = (0, self.filters.first().map_or(0.0, Filter::fit) * MARGIN);
        for (index, filter) in self.filters.iter().enumerate().skip(1) {
            if filter.fit() > best.1 {
                best = (index, filter.fit());
            }
        }
        best.0
    }
}
