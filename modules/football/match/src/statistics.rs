//! What the players of a match do: kicks and what becomes of them, falls, distances, possession of the ball.

use crate::game::{Event, Order, Seat, Team, Truth};
use downbeat_football::Field;
use downbeat_football::football_interfaces::msg::{
    GameState, Kick, MatchState, MatchStatistics, PlayerStatistics,
};
use downbeat_msgs::geometry_msgs::msg::Point;
use downbeat_physics::Ball;
use glam::DVec2;
use std::time::Duration;

/// Counts what players do, from the true state of the field.
///
/// A *kick* is a ball that suddenly rolls at [`Statistics::KICK_SPEED`] or faster. It is of the player who
/// touched the ball last, and ends where the ball is touched by another player, kicked again, almost at rest,
/// or out of play. It is a *shot* if the ball would reach the goal line of the opponents in spite of rolling
/// friction, and cross it in the goal or at most half a metre beside it.
///
/// The result depends only on what is passed to [`Statistics::step`].
pub struct Statistics {
    field: Field,
    seats: Vec<Seat>,
    players: Vec<Player>,
    kick: Option<Flight>,
    last_shot: Option<(usize, Duration)>,
    /// The ball at the last step, unless it was placed since.
    ball: Option<DVec2>,
    speed: f64,
    last_step: Option<Duration>,
    played: Duration,
}

struct Player {
    counts: PlayerStatistics,
    is_down: bool,
    /// To where its distance is counted.
    counted_to: Option<DVec2>,
    distance: f64,
    possession: Duration,
}

/// A ball that was kicked.
struct Flight {
    robot: usize,
    at: Duration,
    from: DVec2,
    speed: f64,
    aim: Aim,
}

/// How the ball moved in a step.
struct BallStep {
    now: Duration,
    from: DVec2,
    to: DVec2,
    velocity: DVec2,
    toucher: Option<usize>,
    goal: Option<Team>,
    /// It is not in play any more, or was placed.
    is_out: bool,
}

#[derive(Clone, Copy, PartialEq)]
enum Aim {
    Elsewhere,
    BesideGoal,
    OnGoal,
}

/// For how long a kick makes the ball faster.
const ACCELERATION: Duration = Duration::from_millis(300);
/// By how much a kick makes the ball faster between two steps, in m/s.
const RISE: f64 = 0.15;
/// A slower ball lies, in m/s.
const SLOW: f64 = 0.1;
/// A faster ball was put elsewhere, in m/s.
const FASTEST: f64 = 10.0;
/// How far beside a goal the ball of a shot may cross the line, in m.
const BESIDE: f64 = 0.5;
/// A ball that a mate touches after a shorter way was not passed, in m.
const SHORTEST_PASS: f64 = 0.3;
/// A goal within this time of a shot is of that shot, whoever of the defenders touched the ball in between.
const DEFLECTED: Duration = Duration::from_secs(5);
/// Walked distances are counted in steps of this length, so that swaying is no way, in m.
const STRIDE: f64 = 0.1;
/// Whoever is farther away a step later was put there, in m.
const JUMP: f64 = 0.5;
const GRAVITY: f64 = 9.81;

impl Statistics {
    /// The least speed of a kicked ball, in m/s.
    pub const KICK_SPEED: f64 = 0.5;

    /// Statistics of a match of these players, before it begins. The names are those of the robots.
    #[must_use]
    pub fn new(field: Field, seats: Vec<Seat>, names: &[String]) -> Self {
        let player = |name: &String| Player {
            counts: PlayerStatistics { robot: name.clone(), ..PlayerStatistics::default() },
            is_down: false,
            counted_to: None,
            distance: 0.0,
            possession: Duration::ZERO,
        };
        Self {
            field,
            seats,
            players: names.iter().map(player).collect(),
            kick: None,
            last_shot: None,
            ball: None,
            speed: 0.0,
            last_step: None,
            played: Duration::ZERO,
        }
    }

    /// The statistics so far. The header is empty.
    #[must_use]
    pub fn message(&self) -> MatchStatistics {
        let counts = |player: &Player| PlayerStatistics {
            distance: player.distance as f32,
            possession: player.possession.as_secs_f32(),
            ..player.counts.clone()
        };
        MatchStatistics {
            played: self.played.as_secs_f32(),
            players: self.players.iter().map(counts).collect(),
            ..MatchStatistics::default()
        }
    }

    /// Takes what the official saw and decided at this time since the start, and the state of the match after
    /// that. Returns a kick that has ended, without a header, and its time.
    pub fn step(
        &mut self,
        now: Duration,
        truth: &Truth,
        decided: (&[Event], &[Order]),
        state: &MatchState,
    ) -> Option<(Duration, Kick)> {
        let (events, orders) = decided;
        let elapsed = now.saturating_sub(self.last_step.replace(now).unwrap_or(now));
        self.watch_players(truth, decided, state);
        let goal = events.iter().find_map(|event| match event {
            Event::Goal(team) => Some(*team),
            _ => None,
        });
        let toucher = truth.last_touch.filter(|robot| *robot < self.players.len());
        let is_in_play = state.phase == GameState::PLAYING || goal.is_some();
        if is_in_play {
            self.played += elapsed;
            toucher.into_iter().for_each(|robot| self.players[robot].possession += elapsed);
        }
        let is_placed = orders.iter().any(|order| matches!(order, Order::Ball(_)));
        let last = self.ball.filter(|_| elapsed > Duration::ZERO);
        let moved = last.map_or(DVec2::ZERO, |last| truth.ball - last);
        let step = BallStep {
            now,
            from: last.unwrap_or(truth.ball),
            to: truth.ball,
            velocity: moved / elapsed.as_secs_f64().max(0.001),
            toucher,
            goal,
            is_out: is_placed || !is_in_play,
        };
        let ended = self.watch_ball(&step, state);
        if let Some(team) = goal {
            self.credit_goal(team, &step, ended.as_ref());
        }
        self.ball = (!is_placed).then_some(truth.ball);
        ended
    }

    fn watch_ball(&mut self, step: &BallStep, state: &MatchState) -> Option<(Duration, Kick)> {
        let speed = step.velocity.length();
        // A ball that somebody put elsewhere rests there.
        let speed = if speed > FASTEST { 0.0 } else { speed };
        let rises = speed > std::mem::replace(&mut self.speed, speed) + RISE;
        let ended = match self.kick.take() {
            Some(mut kick) => {
                let is_young = step.now.saturating_sub(kick.at) < ACCELERATION;
                let is_touched = step.toucher != Some(kick.robot);
                if step.is_out || is_touched || speed < SLOW || rises && !is_young {
                    Some(self.judge(&kick, step))
                } else {
                    if is_young && speed > kick.speed {
                        let aim = self.aim_of(kick.robot, step, state);
                        kick = Flight { speed, aim, ..kick };
                    }
                    self.kick = Some(kick);
                    None
                }
            }
            None => None,
        };
        if self.kick.is_none()
            && !step.is_out
            && rises
            && speed >= Self::KICK_SPEED
            && let Some(robot) = step.toucher
        {
            let aim = self.aim_of(robot, step, state);
            self.kick = Some(Flight { robot, at: step.now, from: step.from, speed, aim });
        }
        ended
    }

    /// Where the ball goes if nobody touches it: rolling friction is a share of its weight.
    fn aim_of(&self, robot: usize, step: &BallStep, state: &MatchState) -> Aim {
        let defends_right = state.blue_defends_right == (self.seats[robot].team == Team::Blue);
        let forwards = if defends_right { -1.0 } else { 1.0 };
        let towards = forwards * step.velocity.x;
        if towards <= 0.0 {
            return Aim::Elsewhere;
        }
        let way = step.velocity * ((self.field.length / 2.0 - forwards * step.to.x) / towards);
        let reach = step.velocity.length_squared() / (2.0 * Ball::default().rolling_friction * GRAVITY);
        let beside = (step.to.y + way.y).abs() - self.field.goal.width / 2.0;
        if reach < way.length() || beside > BESIDE {
            Aim::Elsewhere
        } else if beside < -self.field.ball.diameter / 2.0 {
            Aim::OnGoal
        } else {
            Aim::BesideGoal
        }
    }

    /// Counts a kick that has ended.
    fn judge(&mut self, kick: &Flight, step: &BallStep) -> (Duration, Kick) {
        let team = self.seats[kick.robot].team;
        let next = step.toucher.filter(|robot| *robot != kick.robot).map(|robot| self.seats[robot].team);
        let is_far = step.to.distance(kick.from) >= SHORTEST_PASS;
        let outcome = match (kick.aim, next) {
            _ if step.goal == Some(team) => Kick::GOAL,
            (_, Some(next)) if next == team && is_far => Kick::PASS,
            (Aim::OnGoal, _) => Kick::SHOT_ON_GOAL,
            (Aim::BesideGoal, _) => Kick::SHOT,
            (Aim::Elsewhere, Some(next)) if next != team => Kick::LOST,
            (Aim::Elsewhere, _) => Kick::PLAIN,
        };
        let is_on_goal = [Kick::SHOT_ON_GOAL, Kick::GOAL].contains(&outcome);
        let is_shot = is_on_goal || outcome == Kick::SHOT;
        if is_shot {
            self.last_shot = Some((kick.robot, step.now));
        }
        let counts = &mut self.players[kick.robot].counts;
        counts.kicks += 1;
        counts.shots += u32::from(is_shot);
        counts.shots_on_goal += u32::from(is_on_goal);
        counts.passes += u32::from(outcome == Kick::PASS);
        let point = |at: DVec2| Point { x: at.x, y: at.y, z: 0.0 };
        let seen = Kick {
            robot: counts.robot.clone(),
            from: point(kick.from),
            to: point(step.to),
            speed: kick.speed as f32,
            outcome,
            ..Kick::default()
        };
        (kick.at, seen)
    }

    /// Counts a goal for the player who shot it, for the attacker who walked the ball in, or as an own goal.
    fn credit_goal(&mut self, team: Team, step: &BallStep, ended: Option<&(Duration, Kick)>) {
        let seats = &self.seats;
        let is_of_team = |robot: &usize| seats[*robot].team == team;
        let shooter = self.last_shot.take().map(|(robot, at)| (robot, step.now.saturating_sub(at)));
        let shooter = shooter.filter(|(robot, ago)| is_of_team(robot) && *ago <= DEFLECTED);
        let is_shot = ended.is_some_and(|(_, kick)| kick.outcome == Kick::GOAL);
        let walker = step.toucher.filter(|robot| is_of_team(robot) && !is_shot);
        if let Some(robot) = walker {
            let counts = &mut self.players[robot].counts;
            counts.goals += 1;
            counts.shots += 1;
            counts.shots_on_goal += 1;
        } else if let Some((robot, _)) = shooter {
            self.players[robot].counts.goals += 1;
        } else if let Some(robot) = step.toucher {
            self.players[robot].counts.own_goals += 1;
        }
    }

    fn watch_players(&mut self, truth: &Truth, decided: (&[Event], &[Order]), state: &MatchState) {
        let (events, orders) = decided;
        for (index, player) in self.players.iter_mut().enumerate() {
            let Some(&(position, is_upright)) = truth.robots.get(index) else { continue };
            let seat = self.seats.get(index);
            let is_its_penalty =
                |event: &Event| matches!(event, Event::Penalised(other, _) if Some(other) == seat);
            player.counts.penalties += u32::from(events.iter().any(is_its_penalty));
            let is_put =
                orders.iter().any(|order| matches!(order, Order::Robot { robot, .. } if *robot == index));
            if is_put || state.is_penalised.get(index).is_some_and(|is_penalised| *is_penalised) {
                (player.is_down, player.counted_to) = (false, None);
                continue;
            }
            player.counts.falls += u32::from(!is_upright && !player.is_down);
            player.counts.get_ups += u32::from(is_upright && player.is_down);
            player.is_down = !is_upright;
            if !is_upright {
                player.counted_to = None;
                continue;
            }
            let from = *player.counted_to.get_or_insert(position);
            let way = position.distance(from);
            if way >= STRIDE {
                player.counted_to = Some(position);
                player.distance += if way < JUMP { way } else { 0.0 };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::game::Penalty;

    /// A match of two against two on the default field, 9 m long, in play.
    struct Game {
        statistics: Statistics,
        now: Duration,
        truth: Truth,
        state: MatchState,
        kicks: Vec<Kick>,
    }

    const NAMES: [&str; 4] = ["blue_1", "blue_2", "red_1", "red_2"];

    impl Game {
        fn new() -> Self {
            let names = NAMES.map(str::to_owned);
            let seats = crate::seats(&names).unwrap();
            let robots = vec![(DVec2::new(-3.0, 0.0), true); 4];
            let truth = Truth { ball: DVec2::ZERO, ball_height: 0.05, last_touch: Some(1), robots };
            let state = MatchState {
                phase: GameState::PLAYING,
                is_penalised: vec![false; 4],
                ..MatchState::default()
            };
            let statistics = Statistics::new(Field::default(), seats, &names);
            let mut game = Self { statistics, now: Duration::ZERO, truth, state, kicks: Vec::new() };
            game.step(&[], &[]);
            game
        }

        fn step(&mut self, events: &[Event], orders: &[Order]) {
            let kick = self.statistics.step(self.now, &self.truth, (events, orders), &self.state);
            self.kicks.extend(kick.map(|(_, kick)| kick));
            self.now += Duration::from_millis(100);
        }

        /// Rolls the ball at this speed, which rolling friction reduces by 0.05 m/s in each step, until it
        /// lies or has passed `x`.
        fn roll(&mut self, direction: DVec2, mut speed: f64, x: f64) {
            while speed > 0.05 && self.truth.ball.x < x {
                self.truth.ball += direction.normalize() * speed * 0.1;
                speed -= 0.05;
                self.step(&[], &[]);
            }
        }

        fn player(&self, robot: usize) -> PlayerStatistics {
            self.statistics.message().players[robot].clone()
        }

        fn outcomes(&self) -> Vec<u8> {
            self.kicks.iter().map(|kick| kick.outcome).collect()
        }
    }

    #[test]
    fn a_kick_ends_where_the_ball_lies_and_counts_for_who_touched_it_last() {
        let mut game = Game::new();
        game.roll(DVec2::new(0.0, 1.0), 1.0, 9.0);
        game.step(&[], &[]);
        assert_eq!(game.outcomes(), [Kick::PLAIN]);
        let kick = &game.kicks[0];
        assert_eq!((kick.robot.as_str(), kick.from.y), ("blue_2", 0.0));
        assert!(kick.to.y > 0.8 && (kick.speed - 1.0).abs() < 0.01, "{kick:?}");
        let counts = game.player(1);
        assert_eq!((counts.kicks, counts.shots, counts.passes), (1, 0, 0));
        // A ball that is pushed gently is not kicked.
        game.roll(DVec2::X, 0.3, 9.0);
        assert_eq!(game.kicks.len(), 1);
    }

    #[test]
    fn who_touches_the_ball_next_decides_between_a_pass_and_a_loss() {
        for (next, outcome) in [(0, Kick::PASS), (2, Kick::LOST)] {
            let mut game = Game::new();
            game.truth.ball.y = 0.1;
            game.step(&[], &[]);
            game.truth.ball.y = 0.5;
            game.truth.last_touch = Some(next);
            game.step(&[], &[]);
            assert_eq!(game.outcomes(), [outcome]);
            assert_eq!(game.player(1).passes, u32::from(outcome == Kick::PASS));
        }
    }

    #[test]
    fn a_shot_is_fast_enough_and_goes_to_the_goal_or_close_beside_it() {
        let start = DVec2::new(3.5, 0.0);
        // The goal is 2.25 m wide and 1 m away: 1 m/s roll 1.02 m.
        for (towards, speed, outcome) in [
            (DVec2::new(1.0, 0.0), 1.2, Kick::SHOT_ON_GOAL),
            (DVec2::new(1.0, 1.3), 1.6, Kick::SHOT),
            (DVec2::new(1.0, 2.0), 2.0, Kick::PLAIN),
            (DVec2::new(1.0, 0.0), 0.9, Kick::PLAIN),
            (DVec2::new(-1.0, 0.0), 2.0, Kick::PLAIN),
        ] {
            let mut game = Game::new();
            game.truth.ball = start;
            game.step(&[], &[Order::Ball(start)]);
            game.step(&[], &[]);
            game.truth.ball += towards.normalize() * speed * 0.1;
            game.step(&[], &[]);
            game.step(&[], &[]);
            assert_eq!(game.outcomes(), [outcome], "{towards} {speed}");
            let counts = game.player(1);
            let is_on_goal = outcome == Kick::SHOT_ON_GOAL;
            assert_eq!(counts.shots_on_goal, u32::from(is_on_goal));
            assert_eq!(counts.shots, u32::from(is_on_goal || outcome == Kick::SHOT));
        }
    }

    #[test]
    fn goals_are_credited_to_who_shot_walked_in_or_touched_the_ball_last() {
        let goal = |of: Team, speed: f64, last_touch: usize, saved: Option<usize>| {
            let mut game = Game::new();
            let start = DVec2::new(3.6, 0.0);
            (game.truth.ball, game.truth.last_touch) = (start, Some(last_touch));
            game.step(&[], &[Order::Ball(start)]);
            game.step(&[], &[]);
            game.roll(DVec2::X, speed, 4.4);
            if saved.is_some() {
                game.truth.last_touch = saved;
                game.truth.ball.x += 0.02;
                game.step(&[], &[]);
            }
            game.truth.ball.x = 4.56;
            game.state.phase = GameState::READY;
            game.step(&[Event::Goal(of)], &[Order::Ball(DVec2::ZERO)]);
            (0..4).map(|robot| game.player(robot)).collect::<Vec<_>>()
        };
        let [shot, deflected, walked, own] = [
            goal(Team::Blue, 1.5, 1, None),
            goal(Team::Blue, 1.5, 1, Some(2)),
            goal(Team::Blue, 0.0, 1, None),
            goal(Team::Blue, 0.0, 2, None),
        ];
        for players in [&shot, &deflected, &walked] {
            let PlayerStatistics { goals, shots, shots_on_goal, .. } = players[1];
            assert_eq!([goals, shots, shots_on_goal], [1, 1, 1], "{players:?}");
            assert!(players.iter().all(|player| player.own_goals == 0), "{players:?}");
        }
        assert_eq!((own[2].own_goals, own[1].goals), (1, 0));
    }

    #[test]
    fn the_ball_is_possessed_by_who_touched_it_last_while_it_is_in_play() {
        let mut game = Game::new();
        (0..10).for_each(|_| game.step(&[], &[]));
        game.truth.last_touch = Some(2);
        (0..5).for_each(|_| game.step(&[], &[]));
        game.state.phase = GameState::READY;
        (0..20).for_each(|_| game.step(&[], &[]));
        let message = game.statistics.message();
        let possessed = message.players.iter().map(|player| player.possession);
        assert_eq!(possessed.map(|s| (s * 10.0).round()).collect::<Vec<_>>(), [0.0, 10.0, 5.0, 0.0]);
        assert!((message.played - 1.5).abs() < 1e-6, "{}", message.played);
    }

    #[test]
    fn falls_count_on_the_field_and_getting_up_only_without_help() {
        let mut game = Game::new();
        let lies = |game: &mut Game, is_upright: bool| {
            game.truth.robots[1].1 = is_upright;
            game.step(&[], &[]);
        };
        lies(&mut game, false);
        lies(&mut game, true);
        lies(&mut game, false);
        let seat = game.statistics.seats[1];
        game.state.is_penalised[1] = true;
        let beside = Order::Robot { robot: 1, position: DVec2::new(-2.0, 3.4), heading: 0.0 };
        game.step(&[Event::Penalised(seat, Penalty::Fallen)], &[beside]);
        game.state.is_penalised[1] = false;
        lies(&mut game, true);
        let counts = game.player(1);
        assert_eq!([counts.falls, counts.get_ups, counts.penalties], [2, 1, 1]);
        assert_eq!(game.player(0).falls, 0);
    }

    #[test]
    fn who_sways_on_the_spot_or_is_put_elsewhere_has_not_walked() {
        let mut game = Game::new();
        for step in 0..100 {
            game.truth.robots[0].0.y = if step % 2 == 0 { 0.03 } else { -0.03 };
            game.truth.robots[1].0.x += 0.02;
            game.step(&[], &[]);
        }
        game.truth.robots[1].0 = DVec2::new(1.0, -2.0);
        game.step(&[], &[]);
        assert_eq!(game.player(0).distance, 0.0);
        assert!((game.player(1).distance - 2.0).abs() < 0.11, "{}", game.player(1).distance);
    }
}
