//! Several filters side by side while it is not known from where a robot set out.

use crate::filter::{Believed, Filter, Landmarks, Pose};
use downbeat_football::Field;

/// Filters of which one is right. The first one is the incumbent.
#[derive(Clone, Debug)]
pub(crate) struct Hypotheses {
    field: Field,
    /// With what the evidence of each was when the last one was added.
    filters: Vec<(Filter, f64)>,
    /// Pictures since the last one was added.
    pictures: u32,
    seed: u64,
}

/// How much more likely, as a logarithm, the best one has to be to be kept alone. Landmarks of successive
/// pictures are not independent, hence more than the 5 that count as decisive.
const DECISIVE: f64 = 12.0;
/// After so many pictures with landmarks the best one is kept anyway.
const LONGEST_TRIAL: u32 = 150;
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

    /// Forgets all that was known: the robot is at this pose, with these standard deviations in m and rad.
    pub(crate) fn restart_at(&mut self, pose: Pose, deviations: (f64, f64)) {
        self.filters.clear();
        self.add_with(&[pose], deviations);
    }

    /// It may have been put to one of these poses.
    pub(crate) fn add(&mut self, starts: &[Pose]) {
        self.add_with(starts, DEVIATIONS);
    }

    fn add_with(&mut self, starts: &[Pose], deviations: (f64, f64)) {
        self.pictures = 0;
        self.filters.iter_mut().for_each(|(filter, before)| *before = filter.evidence());
        for start in starts.iter().take(MOST.saturating_sub(self.filters.len())) {
            // Another seed for each one, and the same ones in each run.
            self.seed = self.seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            self.filters.push((Filter::new(&self.field, &[*start], deviations, self.seed), 0.0));
        }
    }

    pub(crate) fn walk(&mut self, step: Pose) {
        self.filters.iter_mut().for_each(|(filter, _)| filter.walk(step));
    }

    /// The robot was moved by about so much without its odometry, in m and rad.
    pub(crate) fn scatter(&mut self, deviations: (f64, f64)) {
        self.filters.iter_mut().for_each(|(filter, _)| filter.scatter(deviations));
    }

    pub(crate) fn see(&mut self, landmarks: &Landmarks) {
        for (filter, _) in &mut self.filters {
            filter.see(landmarks);
        }
        self.pictures += 1;
        let best = self.best();
        let evidence =
            |index: usize| self.filters.get(index).map_or(0.0, |(filter, before)| filter.evidence() - before);
        let is_decisive =
            (0..self.filters.len()).all(|other| other == best || evidence(best) - evidence(other) > DECISIVE);
        if self.filters.len() > 1 && (is_decisive || self.pictures >= LONGEST_TRIAL) {
            self.filters.swap(0, best);
            self.filters.truncate(1);
        }
    }

    pub(crate) fn believed(&self) -> Believed {
        self.filters.get(self.best()).map(|(filter, _)| filter.believed()).unwrap_or_default()
    }

    /// The believed error of the camera's pitch, in rad.
    pub(crate) fn pitch(&self) -> f64 {
        self.filters.get(self.best()).map_or(0.0, |(filter, _)| filter.pitch())
    }

    /// Whether it is decided where the robot is.
    pub(crate) fn is_decided(&self) -> bool {
        self.filters.len() == 1
    }

    /// Of equal ones the first.
    fn best(&self) -> usize {
        let evidences = self.filters.iter().map(|(filter, before)| filter.evidence() - before).enumerate();
        let best = evidences.reduce(|best, other| if other.1 > best.1 { other } else { best });
        best.map_or(0, |(index, _)| index)
    }
}
