//! Replay of the modules inside the cycle, together, in the recorded cycles.

use downbeat_bags::Reader;
use downbeat_executor::{Core, ManualClock, Time};

use super::ReplayError;
use super::calls::Calls;
use super::captured::Captured;
use super::comparison::Comparisons;
use super::plan::Plan;
use crate::playback::Extract;
use crate::playback::events::{self, Events};
use crate::playback::follow::Follower;
use crate::playback::inputs::Inputs;
use crate::playback::settings::SettingsChanges;
use crate::robot::RobotFile;

/// Returns how many cycles there were.
pub(super) fn replay(
    file: &RobotFile,
    reader: &Reader,
    plan: &Plan,
    extract: &mut Extract,
    comparisons: &mut Comparisons,
    calls: &mut Calls,
) -> Result<u64, ReplayError> {
    let start = plan.cycles.first().or(reader.start_time()).unwrap_or(0);
    let clock = ManualClock::new(Time::from_nanos(start));
    let mut core = file.launch(Core::new().with_clock(clock.clone()))?;
    let is_replayed = |module: &str| plan.attached.iter().any(|name| name == module);
    core = build(file, reader, extract, core, is_replayed)?;
    let interfaces = &file.catalog.interfaces;
    let captured = Captured::add(&mut core, interfaces, |topic| plan.outputs.contains_key(topic))?;
    let inputs = Inputs::open(&mut core, reader, plan.inputs.iter().map(String::as_str), interfaces)?;
    let settings = SettingsChanges::read::<ReplayError>(reader, extract, is_replayed)?;
    let end = plan.cycles.end();
    let recorded = events::read::<ReplayError>(reader, extract)?;
    let events = Events::of_core(&mut core, recorded.as_deref(), interfaces)?;
    let mut follower = Follower { core: &mut core, clock: &clock, inputs, settings, events };
    let cycles = follower.run(reader, &plan.cycles, || {
        let before_end = captured.take().into_iter().filter(|replayed| replayed.time < end);
        before_end.for_each(|replayed| comparisons.replayed(replayed));
    })?;
    captured.take_events().iter().for_each(|event| calls.replayed(plan, event, is_replayed));
    comparisons.end_before(end);
    Ok(cycles)
}

/// Adds the modules that are wanted to a core; those that drive a device with its recorded answers.
pub(super) fn build(
    file: &RobotFile,
    reader: &Reader,
    extract: &mut Extract,
    core: Core,
    is_wanted: impl Fn(&str) -> bool,
) -> Result<Core, ReplayError> {
    let mut problem = None;
    let built = file.build_modules(core, |module, core| {
        if !is_wanted(&module.name) {
            return Some(Ok(()));
        }
        let replayed = module.kind.replayed()?;
        let options = module.options();
        let answers = reader.topic(&replayed.topic_of(&options)).map(|id| extract.of(reader, id));
        match answers.unwrap_or(Ok(&[])) {
            Ok(answers) => match replayed.add_to(core, &module.name, options, answers) {
                Ok(added) => Some(added),
                Err(error) => {
                    problem = Some(ReplayError::Device { module: module.name.clone(), problem: error });
                    Some(Ok(()))
                }
            },
            Err(error) => {
                problem = Some(error);
                Some(Ok(()))
            }
        }
    });
    problem.map_or_else(|| Ok(built?), Err)
}
