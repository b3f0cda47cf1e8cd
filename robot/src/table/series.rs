//! Fields of a topic over time, with few enough points to draw.

use std::collections::BTreeMap;

use downbeat_bags::{MergedBags, Reader, ReaderError, Selection, TypeConflict};
use downbeat_edge::Interfaces;
use serde::{Deserialize, Serialize};

use super::{DecodeError, Decoder, number};

/// A field over time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// Seconds since the epoch, ascending.
    #[serde(rename = "t")]
    pub times: Vec<f64>,
    /// The values; never infinite, nor NaN.
    #[serde(rename = "v")]
    pub values: Vec<f64>,
}

/// Error while reading fields of bags.
#[derive(Debug, thiserror::Error)]
pub enum SeriesError {
    /// The bags lack the topic.
    #[error("the bag has no topic {0}")]
    Topic(String),
    /// No message has the field as a number.
    #[error("{topic} has no number at {field}: {problem}")]
    Field {
        /// The topic.
        topic: String,
        /// The path of the field.
        field: String,
        /// What is there.
        problem: String,
    },
    /// The topic has different types.
    #[error(transparent)]
    Conflict(#[from] TypeConflict),
    /// The bags cannot be read.
    #[error(transparent)]
    Read(#[from] ReaderError),
    /// The messages cannot be decoded.
    #[error(transparent)]
    Decode(#[from] DecodeError),
}

/// The most points of one series.
pub const MOST_POINTS: usize = 100_000;

/// Reads fields of a topic (`position[3]`) over all of these bags, merged by time. If there are more messages
/// than `points`, the time of the bags is divided, and each part has its lowest and its highest value, so
/// that no peak disappears. Unreadable messages are skipped.
///
/// # Errors
/// Returns an error if the bags lack the topic or its definition, or no message has a number in one of the
/// fields.
pub fn series(
    bags: &[Reader],
    topic: &str,
    fields: &[&str],
    points: usize,
    interfaces: &Interfaces,
) -> Result<Vec<Series>, SeriesError> {
    let merged = MergedBags::new(bags, |known| known.name == topic)?;
    let recorded = merged.topics().first().ok_or_else(|| SeriesError::Topic(topic.to_owned()))?;
    let decoder = Decoder::of(recorded, interfaces)?;
    let points = points.clamp(2, MOST_POINTS);
    let start = bags.iter().filter_map(Reader::start_time).min().unwrap_or(0);
    let end = bags.iter().filter_map(Reader::end_time).max().unwrap_or(0);
    let part = if recorded.message_count <= points as u64 {
        1
    } else {
        // Two points for each.
        (end.abs_diff(start) / (points as u64 / 2)).max(1)
    };
    let mut curves: Vec<BTreeMap<u64, Extremes>> = vec![BTreeMap::new(); fields.len()];
    let mut problems: Vec<Option<String>> = vec![None; fields.len()];
    for message in merged.messages(&Selection::all(), |_| true)?.flatten() {
        let Ok(content) = decoder.decode(message.data) else { continue };
        let place = message.log_time.abs_diff(start) / part;
        for ((field, curve), problem) in fields.iter().zip(&mut curves).zip(&mut problems) {
            let value = match content.get(field) {
                Ok(value) => number(value),
                Err(error) => {
                    problem.get_or_insert_with(|| error.to_string());
                    continue;
                }
            };
            if let Some(value) = value.filter(|value| value.is_finite()) {
                curve
                    .entry(place)
                    .or_insert_with(|| Extremes::new(message.log_time, value))
                    .add(message.log_time, value);
            } else {
                problem.get_or_insert_with(|| "it is no finite number".to_owned());
            }
        }
    }
    let finished =
        curves.into_iter().zip(problems).zip(fields).map(|((curve, problem), field)| match problem {
            Some(problem) if curve.is_empty() => {
                Err(SeriesError::Field { topic: topic.to_owned(), field: (*field).to_owned(), problem })
            }
            _ => Ok(curve.into_values().fold(Series::default(), |mut series, extremes| {
                extremes.add_to(&mut series);
                series
            })),
        });
    finished.collect()
}

/// The lowest and the highest value of a part, with their times.
#[derive(Clone)]
struct Extremes {
    low: (i64, f64),
    high: (i64, f64),
}

impl Extremes {
    fn new(time: i64, value: f64) -> Self {
        Self { low: (time, value), high: (time, value) }
    }

    fn add(&mut self, time: i64, value: f64) {
        if value < self.low.1 {
            self.low = (time, value);
        }
        if value > self.high.1 {
            self.high = (time, value);
        }
    }

    fn add_to(&self, series: &mut Series) {
        let (first, second) =
            if self.low.0 <= self.high.0 { (self.low, self.high) } else { (self.high, self.low) };
        let mut push = |(time, value): (i64, f64)| {
            series.times.push(time as f64 / 1e9);
            series.values.push(value);
        };
        push(first);
        if first != second {
            push(second);
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use downbeat_bags::{TopicDescription, WriterOptions};
    use downbeat_msgs::cdr;
    use downbeat_msgs::std_msgs::msg::Float64;

    use super::*;

    /// Numbers 0 to 999, one each 10 ms, with a peak.
    fn bag(folder: &std::path::Path) -> Vec<Reader> {
        let mut writer = WriterOptions::new().create(folder.join("bag")).unwrap();
        let topic = TopicDescription {
            name: "/height".to_owned(),
            type_name: "std_msgs/msg/Float64".to_owned(),
            definition: "float64 data\n".to_owned(),
            ..TopicDescription::default()
        };
        let topic = writer.add_topic(topic).unwrap();
        for n in 0..1000_i64 {
            let data = if n == 333 { 1e6 } else { n as f64 };
            let time = (100_000 + n * 10) * 1_000_000;
            writer.write(topic, time, time, &cdr::to_vec(&Float64 { data })).unwrap();
        }
        writer.finish().unwrap();
        vec![Reader::open(folder.join("bag")).unwrap()]
    }

    #[test]
    fn few_messages_are_all_there() {
        let folder = tempfile::tempdir().unwrap();
        let bags = bag(folder.path());
        let all = series(&bags, "/height", &["data"], 1000, &Interfaces::carried()).unwrap();
        assert_eq!(all[0].values.len(), 1000);
        assert_eq!((all[0].times[0], all[0].times[999]), (100.0, 109.99));
    }

    #[test]
    fn a_peak_survives_among_few_points() {
        let folder = tempfile::tempdir().unwrap();
        let bags = bag(folder.path());
        let few = series(&bags, "/height", &["data"], 20, &Interfaces::carried()).unwrap();
        assert!((18..=22).contains(&few[0].values.len()), "{}", few[0].values.len());
        let peak = few[0].values.iter().position(|value| *value == 1e6).unwrap();
        assert_eq!(few[0].times[peak], 103.33);
        assert!(few[0].times.is_sorted());
    }

    #[test]
    fn a_field_that_is_no_number_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let bags = bag(folder.path());
        let error = |topic, field| {
            series(&bags, topic, &[field], 20, &Interfaces::carried()).unwrap_err().to_string()
        };
        assert!(error("/height", "width").contains("/height has no number at width"));
        assert_eq!(error("/depth", "data"), "the bag has no topic /depth");
    }
}
