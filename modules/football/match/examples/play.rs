//! Plays seeded matches, or shots at an empty goal, as fast as possible, and checks the players: goals, the
//! longest time a player that may move stands still, falls, and how fast penalised players stop.
#![allow(missing_docs)]

use clap::Parser;
use downbeat_darwin_op::emulator::MemoryPorts;
use downbeat_edge::Interfaces;
use downbeat_edge::foreign::ForeignModule;
use downbeat_executor::{
    Core, Inbox, Linear, ManualClock, ModuleOptions, ModuleState, Pool, Receipt, Received, SettingValue,
    Snapshot, Time,
};
use downbeat_football::football_interfaces::msg::{GameState, MatchState, MatchStatistics};
use downbeat_football::soccer_model_msgs::msg::{Robot, RobotArray};
use downbeat_kinematics::robot_state_publisher::RobotStatePublisher;
use downbeat_localisation::Localisation;
use downbeat_match::{FootballMatch, player};
use downbeat_msgs::geometry_msgs::msg::{Point, PoseWithCovarianceStamped, Twist};
use downbeat_msgs::nav_msgs::msg::Odometry;
use downbeat_msgs::std_msgs::msg::String as Text;
use downbeat_state_machine::StateMachineOptions;
use downbeat_vision::Vision;
use glam::DVec2;
use parking_lot::Mutex;
use serde_json::json;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

#[derive(Parser)]
struct Arguments {
    /// match or empty_goal
    #[arg(long, default_value = "match")]
    game: String,
    /// The robots
    #[arg(long, value_delimiter = ',', default_value = "blue_1,blue_2,red_1,red_2")]
    robots: Vec<String>,
    /// The first seed of a match, or of the tries
    #[arg(long, default_value_t = 1)]
    seed: i64,
    /// The number of matches, or of tries
    #[arg(long, default_value_t = 1)]
    count: i64,
    /// The duration of a half, in s
    #[arg(long, default_value_t = 300.0)]
    half: f64,
    /// The state chart of every player
    #[arg(long, default_value = "robots/football/player.scxml")]
    chart: PathBuf,
    /// Use vision and localisation instead of the truth with noise
    #[arg(long)]
    eyes: bool,
    /// The number of threads
    #[arg(long, default_value_t = 1)]
    threads: usize,
    /// Print the positions of robots and ball every second
    #[arg(long)]
    trace: bool,
    /// Print the results of each match as a line of JSON, after its events
    #[arg(long)]
    json: bool,
}

/// The observations of one player.
#[derive(Default)]
struct Watched {
    /// The position and time of its last movement.
    moved: Option<(DVec2, f64)>,
    stillness: f64,
    is_down: bool,
    /// The time of its penalty, and its position half a second later.
    penalised: Option<(f64, Option<DVec2>)>,
    /// The distance that a penalised player walked after half a second, in m.
    strayed: f64,
}

#[derive(Default)]
struct Watch {
    players: Vec<Watched>,
    walking: Vec<String>,
    /// The motion that each robot plays.
    motions: Vec<String>,
    commands: Vec<[f64; 3]>,
    /// The other robots that each knows, in its map.
    known: Vec<Vec<DVec2>>,
    /// Where each robot is, and how far off it believed to be each time, in m.
    places: Vec<DVec2>,
    errors: Vec<Vec<f64>>,
    traced: f64,
    is_over: bool,
    last: MatchState,
    counts: MatchStatistics,
    /// The statistics of the core at the end.
    core: Option<Receipt<Snapshot>>,
}

/// A player that moves less than this stands still, in m.
const STILL: f64 = 0.05;

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let is_drill = arguments.game == "empty_goal";
    let matches = if is_drill { 1 } else { arguments.count };
    for seed in arguments.seed..arguments.seed + matches {
        let started = Instant::now();
        let watch = play(&arguments, seed)?;
        let MatchState { blue_score, red_score, header, .. } = &watch.last;
        let simulated = header.stamp.as_nanos() as f64 / 1e9 - 1.0;
        let speed = simulated / started.elapsed().as_secs_f64();
        if arguments.json {
            println!("{}", watch.json(&arguments.robots, seed, simulated, speed));
            continue;
        }
        println!("seed {seed}: {blue_score}:{red_score} in {simulated:.0} s, {speed:.1} times real time");
        for ((name, player), counts) in arguments.robots.iter().zip(&watch.players).zip(&watch.counts.players)
        {
            println!(
                "  {name}: still for up to {:.0} s, {} falls, {} times up again, {} shots, {:.1} m walked, {:.3} m when penalised",
                player.stillness, counts.falls, counts.get_ups, counts.shots, counts.distance, player.strayed
            );
        }
    }
    Ok(())
}

fn play(arguments: &Arguments, seed: i64) -> anyhow::Result<Watch> {
    let clock = ManualClock::new(Time::from_nanos(1_000_000_000));
    let mut core = Core::new().with_clock(clock.clone());
    core = match arguments.threads {
        1 => core.with_launcher(Linear),
        threads => core.with_launcher(Pool::new(threads)?),
    };
    let ports = MemoryPorts::default();
    let settings: [(&str, SettingValue); 6] = [
        ("camera_hz", if arguments.eyes { 10.0 } else { 0.0 }.into()),
        ("game", arguments.game.clone().into()),
        ("robots", arguments.robots.clone().into()),
        ("seed", seed.into()),
        ("tries", arguments.count.into()),
        ("half_s", arguments.half.into()),
    ];
    let options = ModuleOptions {
        settings: settings.map(|(name, value)| (name.to_owned(), value)).into(),
        ..ModuleOptions::default()
    };
    core.add_with("match", FootballMatch::new(ports.clone()), options)?;
    let interfaces = Interfaces::carried()
        .with(downbeat_football::INTERFACES)?
        .with(downbeat_state_machine::INTERFACES)?;
    for (number, name) in (1..).zip(&arguments.robots) {
        if arguments.eyes {
            add_eyes(&mut core, &ports, name, seed * 100 + number)?;
        } else {
            player::add_skills(&mut core, &ports, name, seed * 100 + number)?;
        }
        let chart = StateMachineOptions { path: arguments.chart.clone(), is_reloaded: false };
        let make = Arc::new(move || downbeat_state_machine::load(&chart));
        let options = ModuleOptions { namespace: name.clone(), ..ModuleOptions::default() };
        let (interfaces, of_module) = (interfaces.clone(), options.clone());
        let make = move || ForeignModule::new(make.clone(), interfaces.clone(), of_module.clone());
        core.add_restartable(&format!("{name}/player"), make, options)?;
    }
    let watch = Arc::new(Mutex::new(Watch::default()));
    watch.lock().players.resize_with(arguments.robots.len(), Watched::default);
    watch.lock().walking.resize(arguments.robots.len(), String::new());
    watch.lock().motions.resize(arguments.robots.len(), String::new());
    watch.lock().commands.resize(arguments.robots.len(), [0.0; 3]);
    watch.lock().known.resize(arguments.robots.len(), Vec::new());
    watch.lock().places.resize(arguments.robots.len(), DVec2::ZERO);
    watch.lock().errors.resize(arguments.robots.len(), Vec::new());
    for (robot, name) in arguments.robots.iter().enumerate() {
        let seen = Arc::clone(&watch);
        let see = move |state: Received<'_, Text>| seen.lock().walking[robot].clone_from(&state.data);
        core.outlet(&format!("{name}/walk_to/state"), Inbox::KeepAll, see)?.keep();
        let seen = Arc::clone(&watch);
        let see = move |motion: Received<'_, Text>| seen.lock().motions[robot].clone_from(&motion.data);
        core.outlet(&format!("{name}/motions/playing"), Inbox::KeepAll, see)?.keep();
        let seen = Arc::clone(&watch);
        let see = move |twist: Received<'_, Twist>| {
            seen.lock().commands[robot] = [twist.linear.x, twist.linear.y, twist.angular.z];
        };
        core.outlet(&format!("{name}/cmd_vel"), Inbox::KeepAll, see)?.keep();
        let seen = Arc::clone(&watch);
        let see = move |robots: Received<'_, RobotArray>| {
            let at = |robot: &Robot| DVec2::new(robot.pose.pose.position.x, robot.pose.pose.position.y);
            seen.lock().known[robot] = robots.robots.iter().map(at).collect();
        };
        core.outlet(&format!("{name}/team/robots"), Inbox::KeepAll, see)?.keep();
        let seen = Arc::clone(&watch);
        let see = move |truth: Received<'_, Odometry>| {
            let Point { x, y, .. } = truth.pose.pose.position;
            seen.lock().places[robot] = DVec2::new(x, y);
        };
        core.outlet(&format!("{name}/ground_truth/odom"), Inbox::KeepAll, see)?.keep();
        let seen = Arc::clone(&watch);
        let see = move |pose: Received<'_, PoseWithCovarianceStamped>| {
            let Point { x, y, .. } = pose.pose.pose.position;
            seen.lock().believes(robot, DVec2::new(x, y));
        };
        core.outlet(&format!("{name}/pose"), Inbox::KeepAll, see)?.keep();
    }
    let (seen, handle, trace) = (Arc::clone(&watch), core.handle(), arguments.trace);
    let see = move |state: Received<'_, MatchState>| {
        let mut watch = seen.lock();
        watch.see(&state, trace);
        if state.phase == GameState::FINISHED && !watch.is_over {
            watch.is_over = true;
            watch.core = Some(handle.snapshot());
            handle.stop();
        }
    };
    core.outlet("match/state", Inbox::KeepAll, see)?.keep();
    let seen = Arc::clone(&watch);
    let count = move |counts: Received<'_, MatchStatistics>| seen.lock().counts = counts.clone();
    core.outlet("match/statistics", Inbox::KeepAll, count)?.keep();
    let tell = |event: Received<'_, Text>| println!("{}", event.data);
    core.outlet("match/event", Inbox::KeepAll, tell)?.keep();
    let end = Time::from_nanos(1_000_000_000) + Duration::from_secs(36_000);
    core.run_simulated(&clock, Some(end))?;
    drop(core);
    Ok(std::mem::take(&mut *watch.lock()))
}

/// Adds a player with vision, as in `robots/football/seeing_player.toml`, at the place given by the referee.
fn add_eyes(core: &mut Core, ports: &MemoryPorts, name: &str, seed: i64) -> anyhow::Result<()> {
    player::add_body(core, ports, name, 0.19)?;
    let mut add = |module: &str, settings: Vec<(&str, SettingValue)>| {
        let settings = settings.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
        let options = ModuleOptions { namespace: name.to_owned(), settings, ..ModuleOptions::default() };
        let full = format!("{name}/{module}");
        match module {
            "vision" => core.add_with(&full, Vision::default(), options),
            "localisation" => core.add_with(&full, Localisation::default(), options),
            _ => core.add_with(&full, RobotStatePublisher::default(), options),
        }
    };
    let urdf = downbeat_physics::DARWIN_OP.to_owned();
    add(
        "robot_state_publisher",
        vec![("robot_description", urdf.into()), ("publish_frequency", 50.0.into())],
    )?;
    let field = || ("field", "kid_size_2013".to_owned().into());
    add("vision", vec![field()])?;
    let is_goalkeeper = name.ends_with("_1");
    let [start, back] = if is_goalkeeper { [-2.7, -1.5] } else { [-0.9, -1.9] };
    let settings = vec![
        field(),
        ("seed", seed.into()),
        ("ball_timeout", 2.0.into()),
        ("robot_timeout", 5.0.into()),
        ("starts", vec![start, 0.0, 0.0].into()),
        ("returns", vec![back, -2.0, std::f64::consts::FRAC_PI_2].into()),
    ];
    add("localisation", settings)?;
    Ok(())
}

impl Watch {
    fn json(&self, names: &[String], seed: i64, simulated: f64, speed: f64) -> serde_json::Value {
        let players = names.iter().zip(&self.players).zip(&self.counts.players).zip(&self.errors);
        let players = players.map(|(((name, player), counts), errors)| {
            let Watched { stillness, strayed, .. } = player;
            let mut errors = errors.clone();
            errors.sort_by(f64::total_cmp);
            let error = |percent: usize| errors.get(errors.len() * percent / 100);
            json!({
                "pose_error_m": [error(50), error(95)],
                "name": name, "still_s": stillness, "falls": counts.falls, "get_ups": counts.get_ups, "strayed_m": strayed,
                "kicks": counts.kicks, "shots": counts.shots, "passes": counts.passes, "walked_m": counts.distance,
            })
        });
        // Requested in the last cycle.
        let core = self.core.as_ref().and_then(Receipt::try_take);
        let core = core.unwrap_or_default();
        let stopped =
            core.modules.iter().filter(|known| known.state != ModuleState::Active || known.panics > 0);
        let dropped = core.modules.iter().map(|module| module.dropped);
        let dropped = dropped.chain(core.outlets.iter().map(|outlet| outlet.dropped));
        json!({
            "seed": seed, "blue": self.last.blue_score, "red": self.last.red_score, "simulated_s": simulated,
            "speed": speed, "players": players.collect::<Vec<_>>(), "modules": core.modules.len(),
            "stopped_modules": stopped.map(|known| &known.name).collect::<Vec<_>>(), "dropped": dropped.sum::<u64>(),
        })
    }

    /// Notes how far off a robot that plays believes to be.
    fn believes(&mut self, robot: usize, place: DVec2) {
        let is_penalised = self.last.is_penalised.get(robot).is_none_or(|is_penalised| *is_penalised);
        if self.last.phase == GameState::PLAYING && !is_penalised && !self.players[robot].is_down {
            self.errors[robot].push(place.distance(self.places[robot]));
        }
    }

    fn see(&mut self, state: &MatchState, trace: bool) {
        let now = state.header.stamp.as_nanos() as f64 / 1e9;
        for (robot, player) in self.players.iter_mut().enumerate() {
            let pose = &state.poses[robot];
            let (place, q) = (DVec2::new(pose.position.x, pose.position.y), &pose.orientation);
            let is_down = 1.0 - 2.0 * (q.x * q.x + q.y * q.y) < 0.5;
            player.is_down = is_down;
            let is_able = state.phase == GameState::PLAYING && !is_down && !state.is_penalised[robot];
            let (from, since) = *player.moved.get_or_insert((place, now));
            if !is_able || place.distance(from) > STILL {
                player.moved = Some((place, now));
            } else {
                player.stillness = player.stillness.max(now - since);
            }
            player.penalised = match (state.is_penalised[robot], player.penalised) {
                (false, _) => None,
                (true, None) => Some((now, None)),
                (true, Some((since, None))) if now - since >= 0.5 => Some((since, Some(place))),
                (true, known) => known,
            };
            if let Some((_, Some(from))) = player.penalised {
                player.strayed = player.strayed.max(place.distance(from));
            }
        }
        if trace && now - self.traced >= 1.0 {
            self.traced = now;
            let ball = DVec2::new(state.ball.x, state.ball.y);
            print!("{now:6.0} ball {:.2} {:.2}", ball.x, ball.y);
            for (robot, pose) in state.poses.iter().enumerate() {
                // The map of its team is the world, or turned by half a circle.
                let here = DVec2::new(pose.position.x, pose.position.y);
                let sign = if self.places[robot].dot(here) < 0.0 { -1.0 } else { 1.0 };
                let others = state.poses.iter().enumerate().filter(|(other, _)| *other != robot);
                let offs = others.map(|(_, other)| {
                    let at = DVec2::new(other.position.x, other.position.y);
                    let off = self.known[robot].iter().map(|known| (*known * sign).distance(at));
                    (at.distance(here), off.fold(9.0, f64::min))
                });
                let nearest = offs.min_by(|one, other| one.0.total_cmp(&other.0)).unwrap_or_default();
                let (place, q) = (DVec2::new(pose.position.x, pose.position.y), &pose.orientation);
                let yaw = 2.0 * libm::atan2(q.z, q.w);
                let seen = DVec2::from_angle(-yaw).rotate(ball - place);
                let down = if self.players[robot].is_down { " down " } else { "" };
                let motion = &self.motions[robot];
                let (walking, [ahead, left, turn]) = (&self.walking[robot], self.commands[robot]);
                let error = self.errors[robot].last().unwrap_or(&0.0);
                print!(
                    " | {:.2} {:.2} {yaw:.1} off {error:.2} seen {:.2} {:.2} {walking} {ahead:.2} {left:.2} {turn:.2}{down}{motion} other {:.2} off {:.2} of {}",
                    place.x,
                    place.y,
                    seen.x,
                    seen.y,
                    nearest.0,
                    nearest.1,
                    self.known[robot].len()
                );
            }
            println!();
        }
        self.last = state.clone();
    }
}
