//! `downbeat match`

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::Args;
use parking_lot::Mutex;

use super::cli::ParameterArguments;
use super::logging::Log;
use super::new_output::{Force, Output};
use super::run::{participant_options, report_recording};
use super::screen::Screen;
use super::stop::Stop;
use crate::duration::parse as duration;
use crate::executor::{Inbox, Received, SettingValue};
use crate::msgs::std_msgs::msg::String as Text;
use crate::robot::{Catalog, ModuleEntry, RobotFile, RosArgs};
use crate::running::{PreparedRobot, RecordPlan};
use downbeat_football::Field;
use downbeat_football::football_interfaces::msg::{GameState, MatchState};

#[derive(Args)]
pub(crate) struct MatchArguments {
    /// The robot file of the match, for example robots/match.toml.
    #[arg(value_name = "MATCH.toml")]
    robot: PathBuf,
    /// Play as fast as it can be computed, instead of in real time.
    #[arg(long)]
    fast: bool,
    /// Play at most so many times as fast as real time.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = speed, conflicts_with = "fast")]
    speed: f64,
    /// End after this simulated time: 500ms, 10s, 5m, 1h.
    #[arg(long, value_parser = duration, value_name = "TIME")]
    duration: Option<Duration>,
    /// Record the topics of the file's [record] into this new rosbag2 directory.
    #[arg(long, value_name = "DIR")]
    record: Option<PathBuf>,
    #[command(flatten)]
    force: Force,
    #[cfg(feature = "view")]
    #[command(flatten)]
    view: super::view::ViewArguments,
    /// The ROS domain, instead of ROS_DOMAIN_ID.
    #[arg(long, value_name = "N")]
    domain: Option<u16>,
    #[command(flatten)]
    parameters: ParameterArguments,
}

/// What is seen of the match.
#[derive(Default)]
struct Seen {
    state: Option<MatchState>,
    events: Vec<String>,
}

const REFRESH: Duration = Duration::from_millis(100);
/// The last events below the field.
const SHOWN_EVENTS: usize = 4;

pub(crate) fn play(
    arguments: &MatchArguments,
    catalog: &Catalog,
    ros: &RosArgs,
    screen: &Screen,
    log: &Log,
) -> anyhow::Result<()> {
    if let Some(directory) = &arguments.record {
        arguments.force.check(Output::Bag, directory)?;
    }
    let stop = Stop::new()?;
    let mut file = arguments.parameters.read_robot(&arguments.robot, catalog, ros)?;
    let game = match_of(&file)?;
    let field = field_of(game)?;
    let [state, event] = ["match/state", "match/event"].map(|topic| game.options().resolved(topic));
    #[cfg(feature = "view")]
    arguments.view.apply(&mut file.view);
    let mut robot = PreparedRobot::simulated(file, arguments.duration)?;
    if !arguments.fast {
        robot = robot.at_speed(arguments.speed);
    }
    robot.expose(&participant_options(arguments.domain)?, Some(&log.of_node))?;
    if let Some(directory) = &arguments.record {
        let plan = RecordPlan::of_robot(directory, robot.file(), None);
        arguments.force.make_way(Output::Bag, directory, [])?;
        robot.record(plan)?;
    }
    #[cfg(feature = "view")]
    robot.view(Some(&log.of_node))?;

    let seen = Arc::<Mutex<Seen>>::default();
    let of_state = Arc::clone(&seen);
    let see = move |state: Received<'_, MatchState>| of_state.lock().state = Some(state.clone());
    robot.core().outlet(&state, Inbox::KeepAll, see)?.keep();
    let of_events = Arc::clone(&seen);
    let hear = move |event: Received<'_, Text>| of_events.lock().events.push(event.data.clone());
    robot.core().outlet(&event, Inbox::KeepAll, hear)?.keep();

    let robot = robot.start()?;
    #[cfg(feature = "view")]
    super::run::print_urls(&robot);
    let started = Instant::now();
    let mut printed = 0;
    while !stop.is_due() && !robot.is_finished() {
        let seen = seen.lock();
        if screen.is_terminal() {
            screen.show(seen.block(&field));
        }
        if !screen.is_terminal() {
            seen.events.iter().skip(printed).for_each(|event| println!("{event}"));
        }
        printed = seen.events.len();
        let is_over = seen.state.as_ref().is_some_and(|state| state.phase == GameState::FINISHED);
        drop(seen);
        if is_over {
            break;
        }
        stop.sleep(REFRESH);
    }
    screen.show(Vec::new());
    let summary = robot.stop()?;
    let took = started.elapsed();
    let seen = seen.lock();
    let rest = if screen.is_terminal() { 0 } else { printed };
    seen.events.iter().skip(rest).for_each(|event| println!("{event}"));
    if let Some(state) = &seen.state {
        let time = time_of(state);
        let (blue, red) = (state.blue_score, state.red_score);
        println!("blue {blue}:{red} red after {time:.0} s, {:.1} times real time", time / took.as_secs_f64());
    }
    report_recording(summary.as_ref());
    Ok(())
}

impl Seen {
    /// Score, time, field and the last events.
    fn block(&self, field: &Field) -> Vec<String> {
        let Some(state) = &self.state else { return vec!["the match begins".to_owned()] };
        let phase = match state.phase {
            GameState::READY => "ready",
            GameState::SET => "set",
            GameState::PLAYING => "playing",
            GameState::FINISHED => "finished",
            _ => "initial",
        };
        let half = if state.is_first_half { "first half" } else { "second half" };
        let left = state.seconds_remaining.max(0.0);
        let clock = format!("{:02}:{:02}", (left / 60.0) as u32, (left % 60.0) as u32);
        let (blue, red) = (state.blue_score, state.red_score);
        let mut lines = vec![format!(
            "blue (a, b, …) {blue} : {red} red (A, B, …)   {phase}   {half}   {clock} left   simulated"
        )];
        lines.extend(downbeat_match::draw(field, state).lines().map(str::to_owned));
        let skipped = self.events.len().saturating_sub(SHOWN_EVENTS);
        lines.extend(self.events.iter().skip(skipped).cloned());
        lines
    }
}

/// The simulated time, in s.
fn time_of(state: &MatchState) -> f64 {
    let start = crate::running::SIMULATION_START.as_nanos();
    (state.header.stamp.as_nanos() - start) as f64 / 1e9
}

/// The module that is the match.
fn match_of(file: &RobotFile) -> anyhow::Result<&ModuleEntry> {
    let game = file.modules.iter().find(|module| module.kind.name() == "football_match");
    game.with_context(|| {
        format!("{} has no module of kind \"football_match\"; see docs/football.md", file.path().display())
    })
}

fn field_of(game: &ModuleEntry) -> anyhow::Result<Field> {
    let name = match game.options().settings.get("field") {
        Some(SettingValue::Text(name)) => name.clone(),
        // That of the setting.
        _ => "kid_size_2013".to_owned(),
    };
    Ok(Field::named(&name)?)
}

fn speed(text: &str) -> Result<f64, String> {
    let speed = text.parse::<f64>().map_err(|error| error.to_string())?;
    if (0.01..=1000.0).contains(&speed) { Ok(speed) } else { Err("it has to be 0.01 to 1000".to_owned()) }
}
