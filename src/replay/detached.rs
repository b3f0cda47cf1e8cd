//! Replay of a detached module by its recorded runs.

use downbeat_bags::Reader;
use downbeat_executor::{Core, ManualClock, Time};

use super::calls::Calls;
use super::captured::Captured;
use super::comparison::Comparisons;
use super::plan::Plan;
use super::{ReplayError, attached};
use crate::playback::{Extract, replay_steps};
use crate::robot::RobotFile;

/// Returns how many runs there were.
pub(super) fn replay(
    file: &RobotFile,
    reader: &Reader,
    plan: &Plan,
    extract: &mut Extract,
    name: &str,
    comparisons: &mut Comparisons,
    calls: &mut Calls,
) -> Result<usize, ReplayError> {
    let clock = ManualClock::new(Time::ZERO);
    let core = Core::new().with_clock(clock.clone());
    let mut core = attached::build(file, reader, extract, core, |module| module == name)?;
    let captured =
        Captured::add(&mut core, &file.catalog.interfaces, |topic| plan.outputs.contains_key(topic))?;
    let steps = replay_steps(&mut core, &clock, reader, extract, name);
    let steps =
        steps.map_err(|source| ReplayError::Steps { module: name.to_owned(), source: Box::new(source) })?;
    if !steps.is_whole {
        comparisons.interrupted(name);
        calls.interrupted(name);
    }
    // An end that was not recorded publishes what is not in the bag, at the time of the last run.
    let is_recorded = |time: i64| steps.is_whole || time < steps.last.as_nanos();
    for replayed in captured.take() {
        if is_recorded(replayed.time) {
            comparisons.replayed(replayed);
        }
    }
    captured.take_events().iter().for_each(|event| calls.replayed(plan, event, |module| module == name));
    Ok(steps.count)
}
