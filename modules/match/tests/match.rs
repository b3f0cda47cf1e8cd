//! Players on a pitch with a referee.
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat_executor::{Inbox, Received};
use downbeat_football::Field;
use downbeat_football::football_interfaces::msg::GameState;
use downbeat_match::{Event, Game, GameOptions, Phase, Rules, Seat, Team, player};
use downbeat_msgs::geometry_msgs::msg::{PoseStamped, PoseWithCovarianceStamped};
use std::sync::{Arc, Mutex};
use std::time::Duration;

fn options(seed: u64) -> GameOptions {
    GameOptions {
        field: Field::named("kid_size_2013").unwrap(),
        rules: Rules { ready: Duration::from_secs(3), set: Duration::from_secs(1), ..Rules::default() },
        seats: [Team::Blue, Team::Red].map(|team| Seat { team, number: 2 }).to_vec(),
        seed,
    }
}

fn game(seed: u64) -> Game {
    Game::new(options(seed), |_, core, bus, seed| player::with_skills(core, bus, seed.cast_signed())).unwrap()
}

/// What happens in this time.
fn run(game: &mut Game, seconds: u32) -> Vec<Event> {
    (0..seconds * 10).flat_map(|_| game.step().unwrap()).collect()
}

#[test]
fn a_match_is_the_same_in_each_run_and_another_with_another_seed() {
    let hash = |seed| {
        let mut game = game(seed);
        run(&mut game, 6);
        game.pitch().arena().hash()
    };
    let first = hash(1);
    assert_eq!(first, hash(1));
    assert_ne!(first, hash(2));
}

#[test]
fn both_teams_hear_the_referee_and_see_the_field_from_their_own_side() {
    let mut game = game(1);
    let heard = Arc::<Mutex<Vec<(usize, GameState)>>>::default();
    let poses = Arc::<Mutex<Vec<(usize, f64)>>>::default();
    for robot in 0..2 {
        let (heard, poses) = (Arc::clone(&heard), Arc::clone(&poses));
        let core = game.pitch().core(robot).unwrap();
        let hear = move |state: Received<'_, GameState>| heard.lock().unwrap().push((robot, state.clone()));
        core.outlet("game_state", Inbox::KeepAll, hear).unwrap().keep();
        let see = move |pose: Received<'_, PoseWithCovarianceStamped>| {
            poses.lock().unwrap().push((robot, pose.pose.pose.position.x));
        };
        core.outlet("pose", Inbox::KeepAll, see).unwrap().keep();
    }
    let events = run(&mut game, 5);
    assert_eq!(events, [Phase::Ready, Phase::Set, Phase::Playing].map(Event::Phase));
    let heard = heard.lock().unwrap();
    for robot in 0..2 {
        let states: Vec<u8> =
            heard.iter().filter(|(of, _)| *of == robot).map(|(_, state)| state.state).collect();
        assert!(
            states.starts_with(&[GameState::READY]) && states.ends_with(&[GameState::PLAYING]),
            "{states:?}"
        );
        assert!(poses.lock().unwrap().iter().filter(|(of, _)| *of == robot).all(|(_, x)| *x < -0.5));
    }
}

#[test]
fn a_player_walks_where_it_is_sent() {
    let mut game = game(1);
    let goal = game.pitch().core(0).unwrap().inlet::<PoseStamped>("walk_to/pose").unwrap();
    let mut place = PoseStamped::default();
    place.header.frame_id = "map".into();
    (place.pose.position.x, place.pose.position.y) = (-0.6, 0.5);
    place.pose.orientation.w = 1.0;
    goal.publish(place).unwrap();
    run(&mut game, 25);
    let at = game.pitch().snapshot().robots[0].root.world_from_body.translation;
    assert!((at.truncate() - glam::DVec2::new(-0.6, 0.5)).length() < 0.2, "{at}");
}

#[test]
fn a_ball_in_the_goal_counts_and_comes_back_to_the_centre() {
    let mut game = game(1);
    run(&mut game, 5);
    game.pitch().arena().place_ball([3.2, 0.3]);
    let events = run(&mut game, 1);
    assert_eq!(events, [Event::Goal(Team::Blue), Event::Phase(Phase::Ready)]);
    assert_eq!(game.referee().score(), [1, 0]);
    let ball = game.pitch().snapshot().ball.unwrap().world_from_body.translation;
    assert!(ball.truncate().length() < 0.02, "{ball}");
}
