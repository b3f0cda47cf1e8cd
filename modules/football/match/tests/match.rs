//! Matches of players with a referee.
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat_darwin_op::emulator::MemoryPorts;
use downbeat_executor::{
    Clock, Core, Inbox, Launcher, Linear, ManualClock, ModuleOptions, Pool, Received, SettingValue, Time,
};
use downbeat_football::football_interfaces::msg::{GameState, MatchState, TeamMessage};
use downbeat_match::{FootballMatch, player};
use downbeat_msgs::geometry_msgs::msg::{PointStamped, PoseStamped, PoseWithCovarianceStamped};
use downbeat_msgs::std_msgs::msg::String as Text;
use std::sync::{Arc, Mutex};
use std::time::Duration;

const START: Time = Time::from_nanos(1_000_000_000);

struct Game {
    core: Core,
    clock: ManualClock,
    states: Arc<Mutex<Vec<MatchState>>>,
    events: Arc<Mutex<Vec<String>>>,
}

impl Game {
    fn new(seed: i64, launcher: impl Launcher + 'static) -> Self {
        Self::of(&["blue_2", "red_2"], seed, launcher)
    }

    fn of(robots: &[&str], seed: i64, launcher: impl Launcher + 'static) -> Self {
        let clock = ManualClock::new(START);
        let mut core = Core::new().with_clock(clock.clone()).with_launcher(launcher);
        let ports = MemoryPorts::default();
        let robots: Vec<String> = robots.iter().map(|name| (*name).to_owned()).collect();
        let settings: [(&str, SettingValue); 4] = [
            ("robots", robots.clone().into()),
            ("seed", seed.into()),
            ("initial_s", 0.0.into()),
            ("ready_s", 3.0.into()),
        ];
        let settings = settings.map(|(name, value)| (name.to_owned(), value)).into();
        let options = ModuleOptions { settings, ..ModuleOptions::default() };
        core.add_with("match", FootballMatch::new(ports.clone()), options).unwrap();
        for name in &robots {
            player::add_skills(&mut core, &ports, name, seed).unwrap();
        }
        let (states, events) = (Arc::<Mutex<Vec<_>>>::default(), Arc::<Mutex<Vec<_>>>::default());
        let seen = Arc::clone(&states);
        let see = move |state: Received<'_, MatchState>| seen.lock().unwrap().push(state.clone());
        core.outlet("match/state", Inbox::KeepAll, see).unwrap().keep();
        let heard = Arc::clone(&events);
        let hear = move |event: Received<'_, Text>| heard.lock().unwrap().push(event.data.clone());
        core.outlet("match/event", Inbox::KeepAll, hear).unwrap().keep();
        Self { core, clock, states, events }
    }

    /// Runs all events of this time.
    fn run(&mut self, seconds: u64) {
        let end = START + (self.clock.now().saturating_since(START) + Duration::from_secs(seconds));
        while let Some(next) = self.core.next_event().filter(|next| *next < end) {
            self.clock.set(next);
            self.core.cycle().unwrap();
        }
        self.clock.set(end);
    }

    /// Ends the match; dropping the core drains the outlets.
    fn end(self) -> (Vec<MatchState>, Vec<String>) {
        let Self { core, states, events, .. } = self;
        drop(core);
        let states = std::mem::take(&mut *states.lock().unwrap());
        let events = std::mem::take(&mut *events.lock().unwrap());
        (states, events)
    }
}

#[test]
fn a_match_is_the_same_under_every_launcher_and_another_with_another_seed() {
    let played = |mut game: Game| {
        game.run(6);
        game.end().0
    };
    let first = played(Game::new(1, Linear));
    assert!(first.len() >= 59, "{} states", first.len());
    assert_eq!(first, played(Game::new(1, Pool::new(2).unwrap())));
    assert_ne!(first, played(Game::new(2, Linear)));
}

#[test]
fn both_teams_hear_the_referee_and_see_the_field_from_their_own_side() {
    let mut game = Game::new(1, Linear);
    let heard = Arc::<Mutex<Vec<(&str, u8)>>>::default();
    let poses = Arc::<Mutex<Vec<(&str, f64)>>>::default();
    for name in ["blue_2", "red_2"] {
        let (heard, poses) = (Arc::clone(&heard), Arc::clone(&poses));
        let hear = move |state: Received<'_, GameState>| heard.lock().unwrap().push((name, state.state));
        game.core.outlet(&format!("{name}/game_state"), Inbox::KeepAll, hear).unwrap().keep();
        let see = move |pose: Received<'_, PoseWithCovarianceStamped>| {
            poses.lock().unwrap().push((name, pose.pose.pose.position.x));
        };
        game.core.outlet(&format!("{name}/pose"), Inbox::KeepAll, see).unwrap().keep();
    }
    game.run(10);
    let (states, events) = game.end();
    let ends: Vec<&str> = events.iter().map(|event| event.rsplit("  ").next().unwrap()).collect();
    assert_eq!(ends, ["ready", "set", "playing"]);
    assert_eq!(states.last().unwrap().phase, GameState::PLAYING);
    for name in ["blue_2", "red_2"] {
        let mut states: Vec<u8> =
            heard.lock().unwrap().iter().filter(|(of, _)| *of == name).map(|(_, state)| *state).collect();
        states.dedup();
        assert_eq!(states, [GameState::READY, GameState::SET, GameState::PLAYING]);
        let poses = poses.lock().unwrap();
        let x = poses.iter().filter(|(of, _)| *of == name).map(|(_, x)| *x).next_back().unwrap();
        assert!((-1.5..-0.5).contains(&x), "{name} stands at {x} in the frame of its team");
    }
}

#[test]
fn mates_hear_each_other_late_and_not_always_and_opponents_do_not() {
    let heard = |launcher: Box<dyn Fn(i64) -> Game>, seed| {
        let mut game = launcher(seed);
        let heard = Arc::<Mutex<Vec<(&str, i64, TeamMessage)>>>::default();
        for name in ["blue_1", "blue_2", "red_2"] {
            let sink = Arc::clone(&heard);
            let clock = game.clock.clone();
            let hear = move |message: Received<'_, TeamMessage>| {
                let late = clock.now().as_nanos() - message.header.stamp.as_nanos();
                sink.lock().unwrap().push((name, late, message.clone()));
            };
            game.core.outlet(&format!("{name}/team_messages"), Inbox::KeepAll, hear).unwrap().keep();
        }
        game.run(10);
        game.end();
        Arc::try_unwrap(heard).unwrap().into_inner().unwrap()
    };
    let robots = ["blue_1", "blue_2", "red_2"];
    let linear = heard(Box::new(move |seed| Game::of(&robots, seed, Linear)), 1);
    assert!(linear.iter().all(|(name, ..)| *name != "red_2"), "red_2 has no mate");
    for name in ["blue_1", "blue_2"] {
        let messages: Vec<_> = linear.iter().filter(|(of, ..)| *of == name).collect();
        // Five messages a second, of which one in twenty is lost.
        assert!((38..50).contains(&messages.len()), "{}", messages.len());
        let player = if name == "blue_1" { 2 } else { 1 };
        for (_, late, message) in messages {
            assert_eq!((message.team, message.player), (1, player));
            assert!((45_000_000..=165_000_000).contains(late), "{late} ns");
            assert!(message.pose.pose.position.x < 0.0, "in the frame of its team");
        }
    }
    let pool = heard(Box::new(move |seed| Game::of(&robots, seed, Pool::new(2).unwrap())), 1);
    assert!(linear == pool, "the same under every launcher");
    assert!(linear != heard(Box::new(move |seed| Game::of(&robots, seed, Linear)), 2));
}

#[test]
fn penalised_players_are_not_heard() {
    let mut game = Game::of(&["blue_1", "blue_2"], 1, Linear);
    let heard = Arc::<Mutex<Vec<(u64, TeamMessage)>>>::default();
    let (sink, clock) = (Arc::clone(&heard), game.clock.clone());
    let hear = move |message: Received<'_, TeamMessage>| {
        sink.lock().unwrap().push((clock.now().saturating_since(START).as_secs(), message.clone()));
    };
    game.core.outlet("blue_1/team_messages", Inbox::KeepAll, hear).unwrap().keep();
    let state = game.core.inlet("blue_2/walk_to/pose").unwrap();
    game.run(9);
    // Far outside the field.
    let mut goal = PoseStamped::default();
    goal.header.frame_id = "map".to_owned();
    (goal.pose.position.y, goal.pose.orientation.w) = (9.0, 1.0);
    state.publish(goal).unwrap();
    game.run(50);
    let (_, events) = game.end();
    let penalised = events.iter().find(|event| event.contains("blue 2") || event.contains("blue_2"));
    let at: f64 = penalised.unwrap().split(' ').next().unwrap().parse().unwrap();
    let heard = heard.lock().unwrap();
    let in_penalty = |second: &u64| (at + 1.0..at + 29.0).contains(&(*second as f64));
    assert!(heard.iter().any(|(second, _)| (*second as f64) < at));
    assert!(!heard.iter().any(|(second, _)| in_penalty(second)), "{at} {events:?}");
}

#[test]
fn a_robot_whose_team_asks_is_picked_up() {
    let mut game = Game::new(1, Linear);
    let pick_up = game.core.inlet("match/pick_up").unwrap();
    game.run(2);
    for name in ["green_1", "red_2"] {
        pick_up.publish(Text { data: name.to_owned() }).unwrap();
    }
    game.run(1);
    let (states, events) = game.end();
    assert!(events.iter().any(|event| event.ends_with("red 2 is picked up as its team asked")), "{events:?}");
    let last = states.last().unwrap();
    assert_eq!(last.is_penalised, [false, true]);
    assert!(last.poses[1].position.y.abs() > 2.0, "beside the field: {:?}", last.poses[1]);
}

#[test]
fn a_ball_in_the_goal_counts_and_comes_back_to_the_centre() {
    let mut game = Game::new(1, Linear);
    game.run(9);
    let place = game.core.inlet("match/place_ball").unwrap();
    let mut at = PointStamped::default();
    (at.point.x, at.point.y) = (3.2, 0.3);
    place.publish(at).unwrap();
    game.run(1);
    let (states, events) = game.end();
    assert!(events.iter().any(|event| event.ends_with("1:0  goal for blue")), "{events:?}");
    let last = states.last().unwrap();
    assert_eq!((last.blue_score, last.phase), (1, GameState::READY));
    assert!(libm::hypot(last.ball.x, last.ball.y) < 0.02, "{:?}", last.ball);
}

#[test]
fn names_of_robots_say_which_player_they_are() {
    for (robots, problem) in [
        (vec!["green_1"], "names are blue_1 to blue_11 and red_1 to red_11"),
        (vec!["blue_1", "blue_1"], "is there twice"),
        (vec![], "1 to 22 can play"),
    ] {
        let robots: Vec<String> = robots.into_iter().map(str::to_owned).collect();
        let settings = [("robots".to_owned(), robots.into())].into();
        let options = ModuleOptions { settings, ..ModuleOptions::default() };
        let refused = Core::new().add_with("match", FootballMatch::new(MemoryPorts::default()), options);
        let refused = refused.unwrap_err().to_string();
        assert!(refused.contains(problem), "{refused}");
    }
}
