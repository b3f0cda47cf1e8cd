//! The runs that a bag contains, for the search of causes.

use downbeat_bags::Reader;
use downbeat_edge::Interfaces;
use downbeat_msgs::downbeat_interfaces::msg::{CycleTimes, ModuleRuns};

use super::PlaybackError;
use super::journals::{Extract, MessageCycles};
use crate::causes::Recorded;
use crate::journal;

/// What the journals of a bag say about runs and their causes. Empty for bags without `module_runs`.
///
/// # Errors
/// If the bag cannot be read, or a message of a journal is damaged.
pub fn recorded_runs(reader: &Reader, interfaces: &Interfaces) -> Result<Recorded, PlaybackError> {
    let mut extract = Extract::new(interfaces);
    let journals = [
        journal::RUNS,
        journal::STEPS,
        journal::EVENTS,
        journal::SETTINGS,
        journal::MESSAGES,
        journal::CYCLES,
    ];
    extract.read(reader, journals.into_iter().filter_map(|topic| reader.topic(&format!("/{topic}"))))?;
    let runs: Vec<ModuleRuns> = extract.messages(reader, journal::RUNS)?.unwrap_or_default();
    let steps = extract.messages(reader, journal::STEPS)?.unwrap_or_default();
    let events = extract.messages(reader, journal::EVENTS)?.unwrap_or_default();
    let settings = extract.messages(reader, journal::SETTINGS)?.unwrap_or_default();
    let joined = MessageCycles::read(reader, &mut extract, |topic| topic == journal::SETTINGS)?;
    let cycles: Vec<CycleTimes> = extract.messages(reader, journal::CYCLES)?.unwrap_or_default();
    Recorded::new(&runs, steps, events, settings, joined, &cycles)
        .map_err(|problem| PlaybackError::journal(journal::RUNS, problem))
}
