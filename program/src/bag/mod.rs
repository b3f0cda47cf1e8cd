//! `downbeat bag`, one file for each command.

pub(super) mod bisect;
mod causes;
#[cfg(feature = "plots")]
mod chart;
pub(super) mod check;
pub(super) mod convert;
pub(super) mod cut;
#[cfg(unix)]
pub(super) mod debug;
pub(super) mod diff;
pub(super) mod export;
#[cfg(feature = "tables")]
pub(super) mod import;
pub(super) mod info;
pub(super) mod latency;
mod output;
pub(super) mod play;
#[cfg(feature = "plots")]
pub(super) mod plot;
pub(super) mod record;
mod record_options;
pub(super) mod reindex;
pub(super) mod repair;
pub(super) mod replay;
mod replayed;
#[cfg(test)]
mod ros2_options;
mod select;
#[cfg(feature = "view")]
pub(super) mod view;
mod what_if;
pub(super) mod why;

use std::path::Path;

use downbeat_bags::Reader;

/// Opens a bag, and prints what is lost.
pub(super) fn open(bag: &Path) -> anyhow::Result<Reader> {
    let reader = Reader::open(bag)?;
    for truncation in reader.truncation() {
        tracing::warn!("{truncation}");
    }
    warn_of_oddities(&reader);
    Ok(reader)
}

/// Logs what was not understood of the descriptions of topics.
fn warn_of_oddities(reader: &Reader) {
    reader.oddities().for_each(|oddity| tracing::warn!("{}: {oddity}", reader.path().display()));
}

/// The custom data of several bags; the first value of each key.
fn custom_data(bags: &[Reader]) -> impl Iterator<Item = (String, String)> {
    let noted = bags.iter().rev().filter_map(Reader::metadata);
    noted.flat_map(|metadata| metadata.custom_data.clone())
}
