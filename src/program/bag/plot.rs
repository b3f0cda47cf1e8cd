//! `downbeat bag plot`

use std::path::PathBuf;

use crate::bags::Reader;
use crate::bridge::edge::Interfaces;
use crate::robot::Catalog;
use crate::table::{Cell, Column, ColumnKind, Decoder};
use anyhow::{Context, bail};
use clap::Args;

use super::chart::{Chart, Curve};
use super::open;
use super::select::absolute;
use super::source::Source;

/// More than can be told apart.
const MOST_CURVES: usize = 40;

#[derive(Args)]
pub(crate) struct PlotArguments {
    /// A rosbag2 directory or a single file.
    pub(crate) bag: PathBuf,
    /// What to plot over time: "joint_states:position[3]"; of an array or a message all numbers in it:
    /// "joint_states:position", "imu/data_raw:angular_velocity".
    #[arg(required = true, value_name = "TOPIC:FIELD", value_parser = Wanted::parse)]
    pub(crate) fields: Vec<Wanted>,
    /// The new file: .svg or .png.
    #[arg(long, short, value_name = "FILE")]
    pub(crate) output: PathBuf,
    /// Width and height in pixels.
    #[arg(long, default_value = "1200x600", value_name = "WxH", value_parser = size)]
    pub(crate) size: (u32, u32),
    /// What stands above it; the name of the bag unless given.
    #[arg(long, value_name = "TEXT")]
    pub(crate) title: Option<String>,
}

/// A field of a topic.
#[derive(Clone, Debug)]
pub(crate) struct Wanted {
    topic: String,
    path: String,
}

impl Wanted {
    fn parse(text: &str) -> Result<Self, String> {
        match text.rsplit_once(':') {
            Some((topic, path)) if !topic.is_empty() && !path.is_empty() => {
                Ok(Self { topic: absolute(topic), path: path.to_owned() })
            }
            _ => Err("write TOPIC:FIELD, such as joint_states:position[3]".to_owned()),
        }
    }

    /// Whether the column is the field, or in it.
    fn holds(&self, column: &Column) -> bool {
        let below = column.name.strip_prefix(&self.path);
        below.is_some_and(|below| below.is_empty() || below.starts_with(['.', '[']))
    }
}

pub(crate) fn plot(arguments: &PlotArguments, catalog: &Catalog) -> anyhow::Result<()> {
    let bag = open(&arguments.bag)?;
    let mut curves = Vec::new();
    for wanted in &arguments.fields {
        curves.extend(curves_of(&bag, wanted, &catalog.interfaces)?);
    }
    if curves.len() > MOST_CURVES {
        bail!(
            "these are {} curves; name at most {MOST_CURVES}, as in joint_states:position[3]",
            curves.len()
        );
    }
    let name = bag.path().file_name().map(|name| name.to_string_lossy().into_owned());
    let title = arguments.title.clone().or(name).unwrap_or_default();
    let chart = Chart { title, size: arguments.size, curves };
    chart.write(&arguments.output)?;
    let (curves, path) = (chart.curves.len(), arguments.output.display());
    println!("{curves} {} in {path}", if curves == 1 { "curve" } else { "curves" });
    Ok(())
}

fn curves_of(bag: &Reader, wanted: &Wanted, interfaces: &Interfaces) -> anyhow::Result<Vec<Curve>> {
    let Wanted { topic: name, path } = wanted;
    let known = || bag.topics().iter().map(|topic| topic.info.name.as_str()).collect::<Vec<_>>().join(", ");
    let id = bag.topic(name).with_context(|| format!("the bag has no topic {name}; it has {}", known()))?;
    let source = Source::new(bag, id);
    let decoder = Decoder::of(source.topic, interfaces)?;
    let columns = source.columns(&decoder)?;
    let is_number = |kind| !matches!(kind, ColumnKind::Text | ColumnKind::Bytes);
    let chosen: Vec<_> = columns.iter().enumerate().filter(|(_, column)| wanted.holds(column)).collect();
    let mut curves: Vec<(usize, Curve)> = chosen
        .iter()
        .filter(|(_, column)| is_number(column.kind))
        .map(|(index, column)| {
            (*index, Curve { name: format!("{name}:{}", column.name), points: Vec::new() })
        })
        .collect();
    if curves.is_empty() {
        let numbers = columns.iter().filter(|column| is_number(column.kind));
        let numbers: Vec<_> = numbers.map(|column| column.name.as_str()).collect();
        bail!("{name} has no number at {path}; it has {}", numbers.join(", "));
    }
    let start = bag.start_time().unwrap_or(0);
    // Only numbers are kept: images are large.
    let rows = |data| Ok(columns.row(&decoder.decode(data)?));
    source.each("reading", rows, |[time, _], row| {
        let seconds = time.saturating_sub(start) as f64 / 1e9;
        for (index, curve) in &mut curves {
            curve.points.extend(number(&row[*index]).map(|value| (seconds, value)));
        }
        Ok(())
    })?;
    Ok(curves.into_iter().map(|(_, curve)| curve).collect())
}

fn number(cell: &Cell) -> Option<f64> {
    match cell {
        Cell::Bool(value) => Some(f64::from(u8::from(*value))),
        Cell::Int(value) => Some(*value as f64),
        Cell::UInt(value) => Some(*value as f64),
        Cell::Float32(value) => Some(f64::from(*value)),
        Cell::Float64(value) => Some(*value),
        Cell::Nothing | Cell::Text(_) | Cell::Bytes(_) => None,
    }
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let parts =
        text.split_once('x').and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    parts
        .filter(|(width, height)| (200..=10_000).contains(width) && (100..=10_000).contains(height))
        .ok_or_else(|| {
            "write width and height in pixels, 200x100 to 10000x10000, such as 1200x600".to_owned()
        })
}
