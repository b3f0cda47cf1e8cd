//! What arrives: numbered texts, none of them twice, with their ages.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

fn since_epoch() -> Duration {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap()
}

/// Text `number` of an incarnation of a robot, with the time.
pub fn said(incarnation: &str, number: u64) -> String {
    format!("{incarnation} {number} {}", since_epoch().as_micros())
}

/// What one incarnation of a robot was heard saying.
#[derive(Default)]
pub struct OfIncarnation {
    numbers: BTreeSet<u64>,
    repeated: u64,
}

impl OfIncarnation {
    pub fn first(&self) -> u64 {
        self.numbers.first().copied().unwrap_or(0)
    }

    pub fn last(&self) -> u64 {
        self.numbers.last().copied().unwrap_or(0)
    }

    /// The texts that are missing between the first and the last.
    pub fn missing(&self) -> u64 {
        let all = if self.numbers.is_empty() { 0 } else { self.last() - self.first() + 1 };
        all - self.numbers.len() as u64
    }
}

/// What all robots were heard saying on one of their topics.
#[derive(Default)]
pub struct Heard {
    incarnations: BTreeMap<String, OfIncarnation>,
    ages: Vec<(String, Duration)>,
}

impl Heard {
    pub fn hear(&mut self, text: &str) {
        let mut words = text.split(' ');
        let [incarnation, number, micros] = [(); 3].map(|()| words.next().unwrap());
        let age = since_epoch().saturating_sub(Duration::from_micros(micros.parse().unwrap()));
        self.ages.push((incarnation.to_owned(), age));
        let heard = self.incarnations.entry(incarnation.to_owned()).or_default();
        heard.repeated += u64::from(!heard.numbers.insert(number.parse().unwrap()));
    }

    pub fn incarnations(&self) -> impl Iterator<Item = (&str, &OfIncarnation)> {
        self.incarnations.iter().map(|(incarnation, heard)| (&**incarnation, heard))
    }

    /// How many are missing of all robots.
    pub fn missing(&self) -> u64 {
        self.incarnations.values().map(OfIncarnation::missing).sum()
    }

    pub fn repeated(&self) -> u64 {
        self.incarnations.values().map(|heard| heard.repeated).sum()
    }

    /// The ages of what came since the last call, from robots that `is_meant`, in order.
    pub fn ages(&mut self, is_meant: impl Fn(usize) -> bool) -> Ages {
        let number = |incarnation: &str| incarnation.split('.').next().unwrap().parse().unwrap();
        let ages = std::mem::take(&mut self.ages).into_iter();
        let mut ages: Vec<_> =
            ages.filter(|(incarnation, _)| is_meant(number(incarnation))).map(|(_, age)| age).collect();
        ages.sort_unstable();
        Ages(ages)
    }
}

pub struct Ages(Vec<Duration>);

impl Ages {
    pub fn count(&self) -> usize {
        self.0.len()
    }

    fn share(&self, share: f64) -> f64 {
        let index = ((self.0.len().max(1) - 1) as f64 * share).round() as usize;
        self.0.get(index).map_or(f64::NAN, Duration::as_secs_f64)
    }
}

impl std::fmt::Display for Ages {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [half, most, all] = [0.5, 0.99, 1.0].map(|share| self.share(share) * 1000.0);
        write!(formatter, "{half:.1} ms half of them, {most:.0} ms 99 %, {all:.0} ms the oldest")
    }
}
