//! Statistics of features, by which a policy's inputs and outputs are scaled.

use serde_json::{Value, json};

/// The quantiles that a data set has, and their names in it.
pub(super) const QUANTILES: [(f64, &str); 5] =
    [(0.01, "q01"), (0.1, "q10"), (0.5, "q50"), (0.9, "q90"), (0.99, "q99")];

/// Statistics of a feature: one value for each of its elements, or for each of three colours.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Statistics {
    /// In the order of [`NAMES`].
    values: [Vec<f64>; 9],
    count: u64,
}

/// The names in a data set, without that of the count.
const NAMES: [&str; 9] = [
    "min",
    "max",
    "mean",
    "std",
    QUANTILES[0].1,
    QUANTILES[1].1,
    QUANTILES[2].1,
    QUANTILES[3].1,
    QUANTILES[4].1,
];
const MIN: usize = 0;
const MAX: usize = 1;
const MEAN: usize = 2;
const STD: usize = 3;

impl Statistics {
    /// Of rows with a value for each element.
    pub(super) fn of_rows<'a>(rows: impl Iterator<Item = &'a [f32]>) -> Self {
        let mut columns: Vec<Vec<f64>> = Vec::new();
        let mut count = 0;
        for row in rows {
            columns.resize(row.len().max(columns.len()), Vec::new());
            columns.iter_mut().zip(row).for_each(|(column, value)| column.push(f64::from(*value)));
            count += 1;
        }
        let mut statistics = Self { count, ..Self::default() };
        for mut column in columns {
            column.sort_by(f64::total_cmp);
            let mean = column.iter().sum::<f64>() / column.len() as f64;
            let variance =
                column.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / column.len() as f64;
            let ends = [column.first(), column.last()].map(|end| end.copied().unwrap_or_default());
            let quantiles = QUANTILES.map(|(share, _)| between(&column, share));
            let values = ends.into_iter().chain([mean, variance.sqrt()]).chain(quantiles);
            statistics.values.iter_mut().zip(values).for_each(|(all, value)| all.push(value));
        }
        statistics
    }

    /// Of all of these together, as LeRobot joins those of episodes: quantiles are means, weighted by how
    /// many frames they are of.
    pub(super) fn together(parts: &[&Self]) -> Self {
        let count: u64 = parts.iter().map(|part| part.count).sum();
        let elements = parts.first().map_or(0, |part| part.values[MEAN].len());
        let mut joined = Self { count, ..Self::default() };
        for element in 0..elements {
            let of = |name: usize| {
                parts.iter().map(move |part| (part.values[name][element], part.count as f64 / count as f64))
            };
            let weighted = |name: usize| of(name).map(|(value, weight)| value * weight).sum::<f64>();
            let mean = weighted(MEAN);
            // The squares about the mean of all.
            let squares = of(STD).zip(of(MEAN));
            let variance: f64 = squares
                .map(|((deviation, weight), (of_part, _))| {
                    weight * (deviation.powi(2) + (of_part - mean).powi(2))
                })
                .sum();
            for (name, all) in joined.values.iter_mut().enumerate() {
                all.push(match name {
                    MIN => of(name).map(|(value, _)| value).fold(f64::INFINITY, f64::min),
                    MAX => of(name).map(|(value, _)| value).fold(f64::NEG_INFINITY, f64::max),
                    STD => variance.sqrt(),
                    _ => weighted(name),
                });
            }
        }
        joined
    }

    /// Each with its name.
    pub(super) fn named(&self) -> impl Iterator<Item = (&'static str, &[f64])> {
        NAMES.into_iter().zip(self.values.iter().map(Vec::as_slice))
    }

    pub(super) fn count(&self) -> u64 {
        self.count
    }

    /// As in `stats.json`.
    pub(super) fn to_json(&self, is_picture: bool) -> Value {
        let shaped = |values: &[f64]| match is_picture {
            true => values.iter().map(|value| json!([[value]])).collect(),
            false => json!(values),
        };
        let named = self.named().map(|(name, values)| (name.to_owned(), shaped(values)));
        named.chain([("count".to_owned(), json!([self.count]))]).collect::<serde_json::Map<_, _>>().into()
    }
}

/// The value below which this share of sorted values lies, between two of them by their distance, as
/// `numpy.quantile` has it.
fn between(sorted: &[f64], share: f64) -> f64 {
    let place = share * sorted.len().saturating_sub(1) as f64;
    let at = |index: usize| sorted.get(index).or(sorted.last()).copied().unwrap_or_default();
    let (low, high) = (at(place.floor() as usize), at(place.ceil() as usize));
    low + (high - low) * place.fract()
}

/// How often each level of each colour occurs in pictures.
pub(super) struct Levels {
    counts: [[u64; 256]; 3],
    pictures: u64,
}

impl Default for Levels {
    fn default() -> Self {
        Self { counts: [[0; 256]; 3], pictures: 0 }
    }
}

/// The longer side of what is counted of a picture, about: LeRobot skips pixels in the same way.
const LOOKED_AT: usize = 150;

impl Levels {
    /// Counts the pixels of a picture, or some of them in rows and columns of equal distance, for as many
    /// pictures as it stands for.
    pub(super) fn add(&mut self, [width, height]: [usize; 2], rgb: &[u8], stands_for: u64) {
        let step = (width.max(height) / LOOKED_AT).max(1);
        for row in rgb.chunks_exact(3 * width.max(1)).step_by(step) {
            for pixel in row.chunks_exact(3).step_by(step) {
                self.counts
                    .iter_mut()
                    .zip(pixel)
                    .for_each(|(counts, level)| counts[usize::from(*level)] += stands_for);
            }
        }
        self.pictures += stands_for;
    }

    /// Of levels from 0 to 1.
    pub(super) fn statistics(&self) -> Statistics {
        let mut statistics = Statistics { count: self.pictures, ..Statistics::default() };
        for counts in &self.counts {
            let levels = || counts.iter().enumerate().map(|(level, count)| (level as f64 / 255.0, *count));
            let pixels: u64 = counts.iter().sum();
            let sum = |of: &dyn Fn(f64) -> f64| {
                levels().map(|(level, count)| of(level) * count as f64).sum::<f64>() / pixels.max(1) as f64
            };
            let mean = sum(&|level| level);
            let seen = || levels().filter(|(_, count)| *count > 0).map(|(level, _)| level);
            let quantile = |share: f64| {
                let mut below = 0;
                let wanted = share * pixels as f64;
                let mut found = levels().skip_while(|(_, count)| {
                    below += count;
                    (below as f64) < wanted
                });
                found.next().map_or(0.0, |(level, _)| level)
            };
            let ends = [seen().next(), seen().next_back()].map(Option::unwrap_or_default);
            let deviation = sum(&|level| (level - mean).powi(2)).sqrt();
            let quantiles = QUANTILES.map(|(share, _)| quantile(share));
            let values = ends.into_iter().chain([mean, deviation]).chain(quantiles);
            statistics.values.iter_mut().zip(values).for_each(|(all, value)| all.push(value));
        }
        statistics
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(statistics: &Statistics, name: &str) -> Vec<f64> {
        statistics.named().find(|(known, _)| *known == name).map_or(Vec::new(), |(_, values)| values.to_vec())
    }

    /// With the numbers that numpy gives.
    #[test]
    fn statistics_are_those_of_each_element_and_of_all_episodes_together() {
        let rows = [[1.0_f32, -1.0], [2.0, -1.0], [4.0, -1.0], [9.0, -1.0]];
        let one = Statistics::of_rows(rows.iter().map(<[f32; 2]>::as_slice));
        assert_eq!(value(&one, "min"), [1.0, -1.0]);
        assert_eq!(value(&one, "max"), [9.0, -1.0]);
        assert_eq!(value(&one, "mean"), [4.0, -1.0]);
        assert_eq!(value(&one, "std"), [9.5_f64.sqrt(), 0.0]);
        assert_eq!(value(&one, "q50"), [3.0, -1.0]);
        assert!((value(&one, "q90")[0] - 7.5).abs() < 1e-12);
        let other = Statistics::of_rows([[3.0_f32, 5.0], [3.0, 5.0]].iter().map(<[f32; 2]>::as_slice));
        let joined = Statistics::together(&[&one, &other]);
        let all = [1.0_f64, 2.0, 4.0, 9.0, 3.0, 3.0];
        let mean = all.iter().sum::<f64>() / 6.0;
        let deviation = (all.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / 6.0).sqrt();
        assert!((value(&joined, "mean")[0] - mean).abs() < 1e-12);
        assert!((value(&joined, "std")[0] - deviation).abs() < 1e-12);
        assert_eq!((value(&joined, "max"), joined.count()), (vec![9.0, 5.0], 6));
    }

    #[test]
    fn levels_of_a_picture_are_between_0_and_1() {
        let mut levels = Levels::default();
        levels.add([2, 2], &[0, 255, 51, 0, 255, 51, 255, 255, 51, 255, 255, 51], 1);
        let found = levels.statistics();
        assert_eq!(value(&found, "mean"), [0.5, 1.0, 0.2]);
        assert_eq!(value(&found, "std")[0], 0.5);
        assert_eq!(value(&found, "q10")[0], 0.0);
        assert_eq!(value(&found, "q90")[0], 1.0);
        assert_eq!(found.to_json(true)["max"], json!([[[1.0]], [[1.0]], [[0.2]]]));
    }
}
