//! The report of two runs, in Markdown with pictures beside it.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

use anyhow::Context;
use downbeat_bags::{Reader, Selection};
use downbeat_edge::Interfaces;
use downbeat_robot::table::{Cell, Columns, Decoder, Survey, series};

use super::Runs;

/// The name of the report in its folder.
pub(super) const FILE: &str = "report.md";

/// Topics with curves, and curves of each.
const MOST_TOPICS: usize = 6;
const MOST_CURVES: usize = 3;

/// Points of a curve.
const POINTS: usize = 1500;

/// Writes the report, and a picture for each field that differs most.
pub(super) fn write(
    folder: &Path,
    title: &str,
    bag: &Reader,
    runs: &Runs,
    interfaces: &Interfaces,
) -> anyhow::Result<()> {
    let name = bag.path().file_name().unwrap_or_default().to_string_lossy();
    let mut text = format!("# What if: {title}\n\n");
    let _ = writeln!(
        text,
        "The recorded run {name} was replayed twice, with and without the change, in {} cycles.",
        runs.changed.cycles
    );
    let _ = writeln!(
        text,
        "Inputs are those of the recording: what the change would have made of them is not in it. With `--simulators`, a simulated world answers.\n"
    );
    match &runs.first {
        None => text += "The two runs are the same, message by message.\n",
        Some(first) => {
            let _ = writeln!(text, "They part {}.\n", first.sentence(runs.plain.start_ns));
        }
    }
    text += "| topic | compared | different | more messages with the change | largest deviation |\n| --- | --- | --- | --- | --- |\n";
    let (before, after) = (runs.plain.reader()?, runs.changed.reader()?);
    let mut pictures = Vec::new();
    for (topic, counts) in &runs.topics {
        let deviations = match counts.different {
            0 => Vec::new(),
            _ => deviations(&before, &after, topic, interfaces)?,
        };
        let largest = deviations.first().map_or_else(String::new, |largest| {
            format!("`{}`: {} (its range is {})", largest.field, short(largest.most), short(largest.range))
        });
        let _ = writeln!(
            text,
            "| {topic} | {} | {} | {:+} | {largest} |",
            counts.compared, counts.different, counts.more
        );
        if !deviations.is_empty() {
            pictures.push((topic, deviations));
        }
    }
    pictures.sort_by(|(_, one), (_, other)| other[0].relative().total_cmp(&one[0].relative()));
    for (topic, deviations) in pictures.into_iter().take(MOST_TOPICS) {
        for Deviation { field, .. } in deviations.into_iter().take(MOST_CURVES) {
            let file = format!("{}.svg", file_name(&format!("{topic}_{field}")));
            let curves = [("without", &before), ("with", &after)].map(|(which, bag)| -> anyhow::Result<_> {
                let found = series(std::slice::from_ref(bag), topic, &[&field], POINTS, interfaces)?;
                Ok((which, found.into_iter().next().unwrap_or_default()))
            });
            let [without, with] = curves;
            let heading = format!("{topic} {field}");
            if draw(&folder.join(&file), &heading, [without?, with?], runs.plain.start_ns)? {
                let _ = writeln!(text, "\n![{heading}, with and without the change]({file})");
            }
        }
    }
    let _ = writeln!(text, "\nThe bags `before` and `after` beside this file hold the two runs.");
    let path = folder.join(FILE);
    std::fs::write(&path, text).with_context(|| path.display().to_string())
}

/// How far a field of two runs is apart.
struct Deviation {
    field: String,
    most: f64,
    /// From its smallest to its largest value without the change.
    range: f64,
}

impl Deviation {
    fn relative(&self) -> f64 {
        self.most / self.range.max(f64::MIN_POSITIVE)
    }
}

/// The numbers of a topic that differ, those that differ most first, as a part of their range.
fn deviations(
    before: &Reader,
    after: &Reader,
    topic: &str,
    interfaces: &Interfaces,
) -> anyhow::Result<Vec<Deviation>> {
    let decoder = |bag: &Reader| -> anyhow::Result<_> {
        let id = bag.topic(topic).with_context(|| format!("one of the runs has no {topic}"))?;
        Ok((id, Decoder::of(&bag.topics()[id.index()], interfaces)?))
    };
    let [(one_id, one), (other_id, other)] = [decoder(before)?, decoder(after)?];
    let mut survey = Survey::default();
    for message in before.messages(Selection::all().topics([one_id]))? {
        survey.see(&one.decode(message?.data)?);
    }
    let columns: Columns = survey.columns();
    let mut found: BTreeMap<usize, (f64, f64, f64)> = BTreeMap::new();
    let pairs = before.messages(Selection::all().topics([one_id]))?;
    let pairs = pairs.zip(after.messages(Selection::all().topics([other_id]))?);
    for (first, second) in pairs {
        let first = columns.row(&one.decode(first?.data)?);
        let second = columns.row(&other.decode(second?.data)?);
        for (index, cells) in first.iter().zip(&second).enumerate() {
            let (Some(first), Some(second)) = (number(cells.0), number(cells.1)) else { continue };
            let (most, least, largest) = found.entry(index).or_insert((0.0, first, first));
            *most = most.max((first - second).abs());
            (*least, *largest) = (least.min(first), largest.max(first));
        }
    }
    let names: Vec<&str> = columns.iter().map(|column| column.name.as_str()).collect();
    let of_time = |name: &str| name.contains("stamp");
    let mut deviations: Vec<Deviation> = found
        .into_iter()
        .filter(|(_, (most, ..))| *most > 0.0)
        .filter_map(|(index, (most, least, largest))| {
            let field = (*names.get(index)?).to_owned();
            Some(Deviation { field, most, range: largest - least })
        })
        .filter(|deviation| !of_time(&deviation.field))
        .collect();
    deviations.sort_by(|one, other| other.relative().total_cmp(&one.relative()));
    Ok(deviations)
}

fn number(cell: &Cell) -> Option<f64> {
    let number = match cell {
        Cell::Int(value) => *value as f64,
        Cell::UInt(value) => *value as f64,
        Cell::Float32(value) => f64::from(*value),
        Cell::Float64(value) => *value,
        Cell::Bool(_) | Cell::Nothing | Cell::Text(_) | Cell::Bytes(_) => return None,
    };
    number.is_finite().then_some(number)
}

fn short(number: f64) -> String {
    format!("{number:.3e}")
}

fn file_name(text: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    text.trim_start_matches('/').chars().map(|c| if is_plain(c) { c } else { '_' }).collect()
}

/// Draws two curves over each other. Returns false if this program draws none.
#[cfg(feature = "plots")]
fn draw(
    path: &Path,
    title: &str,
    curves: [(&str, downbeat_robot::table::Series); 2],
    start_ns: i64,
) -> anyhow::Result<bool> {
    use crate::bag::chart::{Chart, Curve};
    let start = start_ns as f64 / 1e9;
    let curves = curves.map(|(name, series)| Curve {
        name: name.to_owned(),
        points: series.times.iter().map(|time| time - start).zip(series.values).collect(),
    });
    let chart = Chart { title: title.to_owned(), size: (1000, 360), curves: curves.into() };
    chart.write(path)?;
    Ok(true)
}

#[cfg(not(feature = "plots"))]
fn draw(_: &Path, _: &str, _: [(&str, downbeat_robot::table::Series); 2], _: i64) -> anyhow::Result<bool> {
    Ok(false)
}
