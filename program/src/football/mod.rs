//! `downbeat match`

mod processes;
mod restarts;
pub(crate) mod robot;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::Args;
use parking_lot::Mutex;

use crate::logging::Log;
use crate::network::participant_options;
use crate::new_output::{Force, Output};
use crate::parameters::ParameterArguments;
use crate::run::report_recording;
use crate::screen::Screen;
use crate::stop::Stop;
use downbeat_bridge::middleware::DiscoveryRange;
use downbeat_executor::{Inbox, Received, SettingValue};
use downbeat_files::duration::parse as duration;
use downbeat_football::Field;
use downbeat_football::football_interfaces::msg::{
    GameState, Kick, MatchState, MatchStatistics, TeamMessage,
};
use downbeat_match::Summary;
use downbeat_msgs::std_msgs::msg::String as Text;
use downbeat_robot::running::{PreparedRobot, RecordPlan};
use downbeat_robot::{Catalog, ModuleEntry, RobotFile, RosArgs};
use processes::{Prepared, Processes};

#[derive(Args)]
pub(crate) struct MatchArguments {
    /// The robot file of the match, or the name of a carried one (`downbeat robots list`): by default two
    /// against two, all of whom know of the field only what their cameras show and their mates say.
    #[arg(value_name = "MATCH.toml", default_value = DEFAULT_MATCH)]
    robot: PathBuf,
    /// Run each robot in a process of its own, in real time: they meet only through the bytes of their buses,
    /// pictures, packets of the referee and team messages. --record then makes a folder with a bag of the
    /// match and one of each robot.
    #[arg(long, conflicts_with_all = ["fast", "speed"])]
    processes: bool,
    /// The ROS domain of the first robot with --processes; the others have the next ones. By default the one
    /// after that of the match.
    #[arg(long, value_name = "N", requires = "processes")]
    robot_domains: Option<u16>,
    /// Play as fast as it can be computed, instead of in real time.
    #[arg(long)]
    fast: bool,
    /// Play at most so many times as fast as real time.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = speed, conflicts_with = "fast")]
    speed: f64,
    /// End after this simulated time: 500ms, 10s, 5min, 1h.
    #[arg(long, value_parser = duration, value_name = "TIME")]
    duration: Option<Duration>,
    /// Draw the match into this picture when it ends: where the robots walked, their kicks, and what each
    /// player did.
    #[arg(long, value_name = "FILE.svg", value_parser = picture)]
    summary: Option<PathBuf>,
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
    began: Option<i64>,
    state: Option<MatchState>,
    events: Vec<String>,
    summary: Summary,
    /// When each player answered last, by the numbers of team and player.
    answers: BTreeMap<(u8, u8), Instant>,
}

/// The carried match that is played if none is named.
const DEFAULT_MATCH: &str = "seeing_teams";
const REFRESH: Duration = Duration::from_millis(100);
/// The last events below the field.
const SHOWN_EVENTS: usize = 4;
/// A player whose last answer is older is silent.
const SILENT_AFTER: Duration = Duration::from_secs(5);

pub(crate) fn play(
    arguments: &MatchArguments,
    catalog: &Catalog,
    ros: &RosArgs,
    screen: &Screen,
    log: &Log,
) -> anyhow::Result<()> {
    // A bag, or with processes a folder of bags.
    let bag = arguments
        .record
        .as_ref()
        .map(|path| if arguments.processes { path.join("match") } else { path.clone() });
    if let Some(directory) = &bag {
        arguments.force.check(Output::Bag, directory)?;
    }
    if let Some(path) = &arguments.summary {
        arguments.force.check(Output::File, path)?;
    }
    let mut stop = Stop::new()?;
    let mut file = arguments.parameters.read_robot(&arguments.robot, catalog, ros)?;
    let game = match_of(&file)?;
    let field = field_of(game)?;
    let options = game.options();
    let topics = ["match/state", "match/event", "match/kick", "match/statistics"];
    let [state, event, kick, statistics] = topics.map(|topic| options.resolved(topic));
    let names = match options.settings.get("robots") {
        Some(SettingValue::Texts(names)) => names.clone(),
        _ => Vec::new(),
    };
    #[cfg(feature = "view")]
    arguments.view.apply(&mut file.view);
    let mut network = ros.with_enclave(participant_options(arguments.domain)?);
    let mut prepared = None;
    let mut robot = if arguments.processes {
        if std::env::var_os("ROS_AUTOMATIC_DISCOVERY_RANGE").is_none() {
            network.discovery_range = DiscoveryRange::Localhost;
        }
        let first = arguments.robot_domains.unwrap_or(network.domain_id.saturating_add(1));
        prepared = Some(Prepared::take_robots(&mut file, first)?);
        stop = stop.after(arguments.duration);
        PreparedRobot::new(file)?
    } else {
        PreparedRobot::simulated(file, arguments.duration)?
    };
    if !arguments.fast && !arguments.processes {
        robot = robot.at_speed(arguments.speed);
    }
    robot.expose(&network, Some(&log.of_node))?;
    if let Some(prepared) = &prepared {
        let interfaces = robot.file().catalog.interfaces.clone();
        prepared.show_pictures(robot.core(), &interfaces, &network)?;
    }
    if let Some(directory) = &bag {
        let plan = RecordPlan::of_robot(directory, robot.file(), None);
        arguments.force.make_way(Output::Bag, directory, [])?;
        if arguments.processes {
            for name in &names {
                let of_robot = directory.with_file_name(name);
                arguments.force.make_way(Output::Bag, &of_robot, [])?;
            }
        }
        robot.record(plan)?;
    }
    #[cfg(feature = "view")]
    robot.view(Some(&log.of_node))?;

    let seen = Arc::<Mutex<Seen>>::default();
    let of_state = Arc::clone(&seen);
    let see = move |state: Received<'_, MatchState>| {
        let mut seen = of_state.lock();
        seen.began.get_or_insert(state.header.stamp.as_nanos());
        seen.summary.see(&state);
        seen.state = Some(state.clone());
    };
    robot.core().outlet(&state, Inbox::KeepAll, see)?.keep();
    let of_events = Arc::clone(&seen);
    let hear = move |event: Received<'_, Text>| of_events.lock().events.push(event.data.clone());
    robot.core().outlet(&event, Inbox::KeepAll, hear)?.keep();

    let of_kicks = Arc::clone(&seen);
    let add = move |kick: Received<'_, Kick>| of_kicks.lock().summary.add(&kick);
    robot.core().outlet(&kick, Inbox::KeepAll, add)?.keep();
    let of_statistics = Arc::clone(&seen);
    let count = move |counts: Received<'_, MatchStatistics>| of_statistics.lock().summary.count(&counts);
    robot.core().outlet(&statistics, Inbox::KeepAll, count)?.keep();
    if prepared.is_some() {
        let of_answers = Arc::clone(&seen);
        let hear = move |answer: Received<'_, TeamMessage>| {
            of_answers.lock().answers.insert((answer.team, answer.player), Instant::now());
        };
        robot.core().outlet(&options.resolved("answers"), Inbox::KeepAll, hear)?.keep();
    }
    let pick_up =
        prepared.as_ref().map(|_| robot.core().inlet(&options.resolved("match/pick_up"))).transpose()?;

    let robot = robot.start()?;
    #[cfg(feature = "view")]
    crate::run::print_urls(&robot);
    let start = |prepared: Prepared| {
        let bags = arguments.record.as_deref();
        prepared.start(&arguments.robot, arguments.parameters.to_arguments(), bags, screen)
    };
    let mut processes = prepared.map(start).transpose()?;
    processes.iter().flat_map(Processes::lines).for_each(|line| eprintln!("{line}"));
    let started = Instant::now();
    let mut printed = 0;
    while !stop.is_due() && !robot.is_finished() {
        for name in processes.iter_mut().flat_map(Processes::tend) {
            // If the match is over, nobody is picked up.
            let _ = pick_up.iter().try_for_each(|pick_up| pick_up.publish(Text { data: name.clone() }));
        }
        let seen = seen.lock();
        if screen.is_terminal() {
            let mut block = seen.block(&field);
            if processes.is_some() {
                block.insert(1.min(block.len()), seen.answers(&names));
            }
            screen.show(block);
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
    // Before the world: their hardware modules still speak to it.
    drop(processes);
    let summary = robot.stop()?;
    let took = started.elapsed();
    let seen = seen.lock();
    let rest = if screen.is_terminal() { 0 } else { printed };
    seen.events.iter().skip(rest).for_each(|event| println!("{event}"));
    if let Some(state) = &seen.state {
        let (blue, red) = (state.blue_score, state.red_score);
        if arguments.processes {
            let began = seen.began.unwrap_or_default();
            println!("blue {blue}:{red} red after {:.0} s", seconds_since(began, state));
        } else {
            let time = seconds_since(downbeat_robot::running::SIMULATION_START.as_nanos(), state);
            println!(
                "blue {blue}:{red} red after {time:.0} s, {:.1} times real time",
                time / took.as_secs_f64()
            );
        }
    }
    print!("{}", seen.summary.text());
    report_recording(summary.as_ref());
    if let Some(path) = &arguments.summary {
        arguments.force.make_way(Output::File, path, [])?;
        let written = std::fs::write(path, seen.summary.svg(&field));
        written.with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

impl Seen {
    /// Who answers the referee, and who does not.
    fn answers(&self, names: &[String]) -> String {
        let is_heard = |name: &String| {
            let seat = downbeat_match::seats(std::slice::from_ref(name))
                .ok()
                .and_then(|seats| seats.first().copied());
            let answered = seat.and_then(|seat| self.answers.get(&(seat.team.number(), seat.number)));
            answered.is_some_and(|answered| answered.elapsed() < SILENT_AFTER)
        };
        let (heard, silent): (Vec<_>, Vec<_>) = names.iter().cloned().partition(is_heard);
        let list = |names: Vec<String>| if names.is_empty() { "nobody".to_owned() } else { names.join(", ") };
        format!("answer the referee: {}   silent: {}", list(heard), list(silent))
    }

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
        lines.push(self.summary.line());
        let skipped = self.events.len().saturating_sub(SHOWN_EVENTS);
        lines.extend(self.events.iter().skip(skipped).cloned());
        lines
    }
}

/// The time of a match that began then, in s.
fn seconds_since(began: i64, state: &MatchState) -> f64 {
    (state.header.stamp.as_nanos() - began) as f64 / 1e9
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

/// The path of a picture.
fn picture(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    if path.extension().is_some_and(|extension| extension == "svg") {
        return Ok(path);
    }
    Err("the picture is an SVG file: let its name end in .svg".to_owned())
}

fn speed(text: &str) -> Result<f64, String> {
    let speed = text.parse::<f64>().map_err(|error| error.to_string())?;
    if (0.01..=1000.0).contains(&speed) { Ok(speed) } else { Err("it has to be 0.01 to 1000".to_owned()) }
}
