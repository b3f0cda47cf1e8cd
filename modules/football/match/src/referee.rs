//! The referee of a match: a deterministic state machine over the true state of the field.

use crate::game::{Event, Order, Penalty, Phase, Seat, SetPlay, Team, Truth};
use downbeat_football::Field;
use downbeat_football::football_interfaces::msg::GameState;
use glam::DVec2;
use std::f64::consts::FRAC_PI_2;
use std::time::Duration;

/// The durations of the rules.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rules {
    /// The duration of a half, while the ball is in play.
    pub half: Duration,
    /// The time for which players stand where they were put before a half: their gyroscopes settle.
    pub initial: Duration,
    /// The time for players to walk to their positions.
    pub ready: Duration,
    /// The time for which players stand before the game continues.
    pub set: Duration,
    /// The longest duration of a set play.
    pub set_play: Duration,
    /// The longest time a player may lie.
    pub fallen: Duration,
    /// The time a penalised player is off the field.
    pub penalty: Duration,
    /// The longest time the ball may lie.
    pub stuck: Duration,
}

/// A referee that sees the true state of the field.
///
/// # Rules
/// - A half begins with *initial* (players are put to their places, and stand); it goes on, as after a
///   goal, with *ready* (players walk to their positions), *set* (players stand) and *playing*. The ball
///   lies in the centre; the team that did not score kicks off.
/// - A goal counts if the whole ball is behind the goal line, between the posts and below the crossbar.
/// - If the ball crosses a touch line, it is put back where it left, as a throw-in for the other team. If it
///   crosses a goal line, the set play is a goal kick at the corner of the goal area or a corner kick. Play
///   continues at once; a set play ends when its team touches the ball, or after [`Rules::set_play`].
/// - When *set* begins, a player outside its own half is put back to its place there, and so is a player
///   within the circle if its team does not kick off.
/// - If the ball hardly moves for [`Rules::stuck`], it is dropped: *ready* begins again without a goal.
/// - A player that lies for longer than [`Rules::fallen`] or leaves the carpet is *picked up*: it is taken
///   off the field for [`Rules::penalty`], and returns upright at the touch line of its own half. The same
///   happens to a player whose team asks for it, for example to start its computer again.
/// - The game has two halves; sides change in between, and the other team kicks off.
///
/// Not implemented: pushing, handling the ball, and the distance to a set play.
///
/// The result depends only on the times and states passed to [`Referee::step`].
pub struct Referee {
    field: Field,
    rules: Rules,
    seats: Vec<Seat>,
    players: Vec<Player>,
    phase: Phase,
    /// The time at which the phase began.
    since: Duration,
    /// The time in play of the current half.
    played: Duration,
    last_step: Option<Duration>,
    is_first_half: bool,
    score: [u8; 2],
    kick_off: Team,
    set_play: Option<(SetPlay, Team, Duration)>,
    /// The position and time of the ball's last movement.
    lay_at: (DVec2, Duration),
    last_touch: Option<usize>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Player {
    down_since: Option<Duration>,
    penalty: Option<(Penalty, Duration)>,
    /// Its team asked for a pick-up that has not happened.
    asks_for_pick_up: bool,
}

/// A ball that moves less than this counts as lying, in m.
const STUCK_DISTANCE: f64 = 0.1;
/// The distance of penalised players from the touch line, in m.
const BESIDE: f64 = 0.4;
/// The distance of a throw-in from the touch line, in m, inside the field.
const INSIDE: f64 = 0.1;

impl Default for Rules {
    /// Rules with halves of ten minutes.
    fn default() -> Self {
        Self {
            half: Duration::from_secs(600),
            initial: Duration::from_secs(6),
            ready: Duration::from_secs(30),
            set: Duration::from_secs(5),
            set_play: Duration::from_secs(10),
            fallen: Duration::from_secs(20),
            penalty: Duration::from_secs(30),
            stuck: Duration::from_secs(30),
        }
    }
}

impl Referee {
    /// A referee before a game.
    #[must_use]
    pub fn new(field: Field, rules: Rules, seats: Vec<Seat>) -> Self {
        Self {
            field,
            rules,
            players: vec![Player::default(); seats.len()],
            seats,
            phase: Phase::Initial,
            since: Duration::ZERO,
            played: Duration::ZERO,
            last_step: None,
            is_first_half: true,
            score: [0, 0],
            kick_off: Team::Blue,
            set_play: None,
            lay_at: (DVec2::ZERO, Duration::ZERO),
            last_touch: None,
        }
    }

    /// The phase of the game.
    #[must_use]
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// The goals of blue and red.
    #[must_use]
    pub fn score(&self) -> [u8; 2] {
        self.score
    }

    /// The time in play of this half.
    #[must_use]
    pub fn played(&self) -> Duration {
        self.played
    }

    /// True in the first half.
    #[must_use]
    pub fn is_first_half(&self) -> bool {
        self.is_first_half
    }

    /// True if a team currently defends the goal at +x.
    #[must_use]
    pub fn defends_right(&self, team: Team) -> bool {
        (team == Team::Red) == self.is_first_half
    }

    /// True if a player is off the field.
    #[must_use]
    pub fn is_penalised(&self, robot: usize) -> bool {
        self.players.get(robot).is_some_and(|player| player.penalty.is_some())
    }

    /// Picks a player up at the next step, as its team asks. If it is penalised, its penalty begins anew.
    pub fn pick_up(&mut self, robot: usize) {
        if let Some(player) = self.players.get_mut(robot) {
            player.asks_for_pick_up = true;
        }
    }

    /// The place where a player starts and to which it is put back: position and heading in the world.
    #[must_use]
    pub fn place_of(&self, robot: usize) -> (DVec2, f64) {
        let Some(seat) = self.seats.get(robot) else { return (DVec2::ZERO, 0.0) };
        let (length, width) = (self.field.length, self.field.width);
        // In the frame of the team.
        let place = match seat.number {
            1 => DVec2::new(-length / 2.0 + 0.3, 0.0),
            number => {
                let rank = f64::from(number - 2);
                let side = if number.is_multiple_of(2) { 1.0 } else { -1.0 };
                let outside = self.field.circle_diameter / 2.0 + 0.3;
                DVec2::new(-outside - 0.3 * rank, side * width / 16.0 * rank)
            }
        };
        if self.defends_right(seat.team) { (-place, std::f64::consts::PI) } else { (place, 0.0) }
    }

    /// Takes the true state at this time since the start, and returns events and orders.
    pub fn step(&mut self, now: Duration, truth: &Truth) -> (Vec<Event>, Vec<Order>) {
        let (mut events, mut orders) = (Vec::new(), Vec::new());
        let elapsed = now.saturating_sub(self.last_step.replace(now).unwrap_or(now));
        if truth.last_touch.is_some() {
            self.last_touch = truth.last_touch;
        }
        let in_phase = now.saturating_sub(self.since);
        match self.phase {
            Phase::Initial if in_phase >= self.rules.initial => {
                self.begin_ready(now, &mut events, &mut orders);
            }
            Phase::Ready if in_phase >= self.rules.ready => {
                self.enter(Phase::Set, now, &mut events);
                orders.push(Order::Ball(DVec2::ZERO));
                self.put_back(truth, &mut events, &mut orders);
            }
            Phase::Set if in_phase >= self.rules.set => {
                self.lay_at = (truth.ball, now);
                self.last_touch = None;
                self.enter(Phase::Playing, now, &mut events);
            }
            Phase::Playing => {
                self.played += elapsed;
                self.watch_ball(now, truth, &mut events, &mut orders);
                if self.played >= self.rules.half {
                    self.end_half(now, &mut events, &mut orders);
                }
            }
            Phase::Initial | Phase::Ready | Phase::Set | Phase::Finished => {}
        }
        if self.phase != Phase::Finished {
            self.watch_players(now, truth, &mut events, &mut orders);
        }
        (events, orders)
    }

    fn enter(&mut self, phase: Phase, now: Duration, events: &mut Vec<Event>) {
        (self.phase, self.since, self.set_play) = (phase, now, None);
        events.push(Event::Phase(phase));
    }

    fn begin_ready(&mut self, now: Duration, events: &mut Vec<Event>, orders: &mut Vec<Order>) {
        self.enter(Phase::Ready, now, events);
        orders.push(Order::Ball(DVec2::ZERO));
    }

    fn end_half(&mut self, now: Duration, events: &mut Vec<Event>, orders: &mut Vec<Order>) {
        if !self.is_first_half {
            return self.enter(Phase::Finished, now, events);
        }
        events.push(Event::HalfTime);
        (self.is_first_half, self.played, self.kick_off) = (false, Duration::ZERO, Team::Red);
        for robot in 0..self.seats.len() {
            self.players[robot] = Player::default();
            let (position, heading) = self.place_of(robot);
            orders.push(Order::Robot { robot, position, heading });
        }
        orders.push(Order::Ball(DVec2::ZERO));
        self.enter(Phase::Initial, now, events);
    }

    /// Puts players in forbidden places back to their places.
    fn put_back(&mut self, truth: &Truth, events: &mut Vec<Event>, orders: &mut Vec<Order>) {
        for (robot, seat) in self.seats.iter().enumerate() {
            let Some(&(position, _)) = truth.robots.get(robot) else { continue };
            let towards_own = if self.defends_right(seat.team) { 1.0 } else { -1.0 };
            let is_in_own_half = position.x * towards_own > -0.1;
            let may_be_near = seat.team == self.kick_off;
            let is_near = position.length() < self.field.circle_diameter / 2.0;
            if self.is_penalised(robot) || is_in_own_half && (may_be_near || !is_near) {
                continue;
            }
            let (position, heading) = self.place_of(robot);
            orders.push(Order::Robot { robot, position, heading });
            events.push(Event::PutBack(*seat));
        }
    }

    fn watch_ball(&mut self, now: Duration, truth: &Truth, events: &mut Vec<Event>, orders: &mut Vec<Order>) {
        let touching = self.last_touch.and_then(|robot| self.seats.get(robot)).map(|seat| seat.team);
        let until = |(_, team, until): &(SetPlay, Team, Duration)| now < *until && touching != Some(*team);
        self.set_play = self.set_play.filter(until);
        let radius = self.field.ball.diameter / 2.0;
        let (ball, [x, y]) = (truth.ball, [self.field.length / 2.0, self.field.width / 2.0]);
        if ball.x.abs() > x + radius {
            let is_right = ball.x > 0.0;
            let is_goal =
                ball.y.abs() < self.field.goal.width / 2.0 && truth.ball_height < self.field.goal.height;
            let defender = if self.defends_right(Team::Red) == is_right { Team::Red } else { Team::Blue };
            if is_goal {
                let scorer = defender.other();
                self.score[scorer.index()] = self.score[scorer.index()].saturating_add(1);
                self.kick_off = defender;
                events.push(Event::Goal(scorer));
                return self.begin_ready(now, events, orders);
            }
            let (sign_x, sign_y) = (1.0_f64.copysign(ball.x), 1.0_f64.copysign(ball.y));
            let area = self.field.goal_area;
            let (kind, team, at) = if touching == Some(defender) {
                let corner = DVec2::new((x - INSIDE) * sign_x, (y - INSIDE) * sign_y);
                (SetPlay::CornerKick, defender.other(), corner)
            } else {
                let corner = DVec2::new((x - area.depth) * sign_x, area.width / 2.0 * sign_y);
                (SetPlay::GoalKick, defender, corner)
            };
            self.begin_set_play(kind, team, at, now, events, orders);
        } else if ball.y.abs() > y + radius {
            let team = touching.map_or(self.kick_off, Team::other);
            let at = DVec2::new(ball.x.clamp(INSIDE - x, x - INSIDE), (y - INSIDE).copysign(ball.y));
            self.begin_set_play(SetPlay::ThrowIn, team, at, now, events, orders);
        } else if (ball - self.lay_at.0).length() > STUCK_DISTANCE {
            self.lay_at = (ball, now);
        } else if now.saturating_sub(self.lay_at.1) >= self.rules.stuck {
            events.push(Event::Stuck);
            self.begin_ready(now, events, orders);
        }
    }

    fn begin_set_play(
        &mut self,
        kind: SetPlay,
        team: Team,
        at: DVec2,
        now: Duration,
        events: &mut Vec<Event>,
        orders: &mut Vec<Order>,
    ) {
        self.set_play = Some((kind, team, now + self.rules.set_play));
        self.last_touch = None;
        self.lay_at = (at, now);
        events.push(Event::SetPlay(kind, team));
        orders.push(Order::Ball(at));
    }

    fn watch_players(
        &mut self,
        now: Duration,
        truth: &Truth,
        events: &mut Vec<Event>,
        orders: &mut Vec<Order>,
    ) {
        let outside = DVec2::new(self.field.length, self.field.width) / 2.0 + self.field.margin;
        for (robot, &(position, is_upright)) in truth.robots.iter().enumerate().take(self.seats.len()) {
            let (seat, mut player) = (self.seats[robot], self.players[robot]);
            let is_asked = std::mem::take(&mut player.asks_for_pick_up);
            if let Some((_, until)) = player.penalty.filter(|_| !is_asked) {
                if now >= until {
                    player = Player::default();
                    let (position, heading) = self.beside_the_field(robot, 0.0);
                    orders.push(Order::Robot { robot, position, heading });
                    events.push(Event::Returned(seat));
                }
            } else {
                let since = player.down_since.filter(|_| !is_upright).unwrap_or(now);
                player.down_since = (!is_upright).then_some(since);
                let penalty = if is_asked {
                    Some(Penalty::PickUp)
                } else if now.saturating_sub(since) >= self.rules.fallen {
                    Some(Penalty::Fallen)
                } else if position.x.abs() > outside.x || position.y.abs() > outside.y {
                    Some(Penalty::LeftField)
                } else {
                    None
                };
                if let Some(penalty) = penalty {
                    let until = now + self.rules.penalty;
                    player = Player { penalty: Some((penalty, until)), ..Player::default() };
                    let (position, heading) = self.beside_the_field(robot, BESIDE);
                    orders.push(Order::Robot { robot, position, heading });
                    events.push(Event::Penalised(seat, penalty));
                }
            }
            self.players[robot] = player;
        }
    }

    /// The place at this distance from the touch line of the own half, facing the field.
    fn beside_the_field(&self, robot: usize, distance: f64) -> (DVec2, f64) {
        let seat = self.seats[robot];
        let x = -self.field.length / 4.0 - 0.4 * f64::from(seat.number - 1);
        // Each team has its own side, so that no robot is put onto another.
        let (sign, own) = if self.defends_right(seat.team) { (1.0, -x) } else { (-1.0, x) };
        let y = (self.field.width / 2.0 + distance) * sign;
        (DVec2::new(own, y), -FRAC_PI_2 * sign)
    }

    /// The state of the game for one player. The header is empty.
    #[must_use]
    pub fn game_state(&self, robot: usize, now: Duration) -> GameState {
        let Some(seat) = self.seats.get(robot) else { return GameState::default() };
        let of = |team: Team| if team == seat.team { GameState::OWN } else { GameState::OPPONENT };
        let [own, opponent] = [seat.team, seat.team.other()];
        let waits_until = match self.phase {
            Phase::Ready => self.since + self.rules.ready,
            Phase::Set => self.since + self.rules.set,
            _ => self.set_play.map_or(now, |(.., until)| until),
        };
        let penalty = self.players[robot].penalty;
        GameState {
            state: match self.phase {
                Phase::Initial => GameState::INITIAL,
                Phase::Ready => GameState::READY,
                Phase::Set => GameState::SET,
                Phase::Playing => GameState::PLAYING,
                Phase::Finished => GameState::FINISHED,
            },
            set_play: match self.set_play {
                None => GameState::NO_SET_PLAY,
                Some((SetPlay::ThrowIn, ..)) => GameState::THROW_IN,
                Some((SetPlay::GoalKick, ..)) => GameState::GOAL_KICK,
                Some((SetPlay::CornerKick, ..)) => GameState::CORNER_KICK,
            },
            is_first_half: self.is_first_half,
            kick_team: match (self.phase, self.set_play) {
                (_, Some((_, team, _))) => of(team),
                (Phase::Ready | Phase::Set, None) => of(self.kick_off),
                _ => GameState::NEITHER,
            },
            seconds_remaining: self.rules.half.saturating_sub(self.played).as_secs_f32(),
            secondary_seconds: waits_until.saturating_sub(now).as_secs_f32(),
            own_team: own.number(),
            opponent_team: opponent.number(),
            own_colour: own.colour(),
            opponent_colour: opponent.colour(),
            own_score: self.score[own.index()],
            opponent_score: self.score[opponent.index()],
            own_half_is_left: !self.defends_right(own),
            player: seat.number,
            is_goalkeeper: seat.number == 1,
            is_penalised: penalty.is_some(),
            penalty: penalty.map_or(0, |(penalty, _)| penalty.number()),
            penalty_seconds: penalty.map_or(0.0, |(_, until)| until.saturating_sub(now).as_secs_f32()),
            message_budget: u16::MAX,
            ..GameState::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Game {
        referee: Referee,
        now: Duration,
        truth: Truth,
        events: Vec<Event>,
    }

    fn seat(team: Team, number: u8) -> Seat {
        Seat { team, number }
    }

    impl Game {
        /// A match of two against two on the default field, with each player at its place.
        fn new(half: u64) -> Self {
            let seats = [(Team::Blue, 1), (Team::Blue, 2), (Team::Red, 1), (Team::Red, 2)];
            let seats = seats.map(|(team, number)| seat(team, number)).to_vec();
            let half = Duration::from_secs(half);
            let rules = Rules { half, initial: Duration::ZERO, ..Rules::default() };
            let referee = Referee::new(Field::default(), rules, seats);
            let robots = (0..4).map(|robot| (referee.place_of(robot).0, true)).collect();
            let truth = Truth { ball: DVec2::ZERO, ball_height: 0.05, last_touch: None, robots };
            Self { referee, now: Duration::ZERO, truth, events: Vec::new() }
        }

        /// Runs the referee and carries out its orders.
        fn run(&mut self, seconds: f64) {
            for _ in 0..(seconds * 10.0).round() as u32 {
                let (events, orders) = self.referee.step(self.now, &self.truth);
                self.events.extend(events);
                for order in orders {
                    match order {
                        Order::Ball(at) => (self.truth.ball, self.truth.last_touch) = (at, None),
                        Order::Robot { robot, position, .. } => self.truth.robots[robot] = (position, true),
                    }
                }
                self.now += Duration::from_millis(100);
            }
        }

        fn playing() -> Self {
            let mut game = Self::new(600);
            game.run(36.0);
            assert_eq!(game.referee.phase(), Phase::Playing);
            game.events.clear();
            game
        }
    }

    #[test]
    fn a_half_begins_with_ready_and_set_and_nobody_is_put_back_from_its_place() {
        let mut game = Game::new(600);
        game.run(36.0);
        assert_eq!(game.events, [Phase::Ready, Phase::Set, Phase::Playing].map(Event::Phase));
    }

    #[test]
    fn before_each_half_players_stand_where_they_were_put() {
        let mut game = Game::new(20);
        let rules = Rules { half: Duration::from_secs(20), ..Rules::default() };
        game.referee.rules = rules;
        let initial = rules.initial.as_secs_f64();
        game.run(initial);
        assert_eq!(game.referee.game_state(0, game.now).state, GameState::INITIAL);
        game.run(0.2);
        assert_eq!(game.referee.phase(), Phase::Ready);
        // Until half-time.
        game.run(35.0 + 20.0);
        assert_eq!(game.referee.phase(), Phase::Initial);
        assert!(game.truth.robots[0].0.x > 4.0);
        game.run(initial);
        assert_eq!(game.referee.phase(), Phase::Ready);
    }

    #[test]
    fn a_goal_counts_when_the_whole_ball_is_in_and_the_other_team_kicks_off() {
        let mut game = Game::playing();
        game.truth.ball = DVec2::new(4.54, 1.0);
        game.run(0.2);
        assert_eq!(game.events, []);
        game.truth.ball.x = 4.56;
        game.run(0.1);
        assert_eq!(game.events, [Event::Goal(Team::Blue), Event::Phase(Phase::Ready)]);
        assert_eq!((game.referee.score(), game.truth.ball), ([1, 0], DVec2::ZERO));
        let kick_team = |robot| game.referee.game_state(robot, game.now).kick_team;
        assert_eq!([kick_team(0), kick_team(2)], [GameState::OPPONENT, GameState::OWN]);
        assert_eq!(game.referee.game_state(3, game.now).opponent_score, 1);
    }

    #[test]
    fn a_ball_that_leaves_comes_back_for_those_who_did_not_touch_it_last() {
        let cases = [
            (DVec2::new(1.0, 3.1), 1, SetPlay::ThrowIn, Team::Red, DVec2::new(1.0, 2.9)),
            (DVec2::new(4.6, -2.0), 1, SetPlay::GoalKick, Team::Red, DVec2::new(3.9, -1.725)),
            (DVec2::new(4.6, 2.0), 3, SetPlay::CornerKick, Team::Blue, DVec2::new(4.4, 2.9)),
        ];
        for (ball, toucher, kind, team, back) in cases {
            let mut game = Game::playing();
            (game.truth.ball, game.truth.last_touch) = (ball, Some(toucher));
            game.run(0.1);
            assert_eq!(game.events, [Event::SetPlay(kind, team)]);
            assert!((game.truth.ball - back).length() < 1e-9, "{}", game.truth.ball);
            assert_ne!(game.referee.game_state(0, game.now).set_play, GameState::NO_SET_PLAY);
            game.run(11.0);
            assert_eq!(game.referee.game_state(0, game.now).set_play, GameState::NO_SET_PLAY);
        }
    }

    #[test]
    fn who_lies_too_long_or_leaves_is_off_the_field_for_half_a_minute() {
        let mut game = Game::playing();
        game.truth.robots[1].1 = false;
        game.run(19.0);
        assert_eq!(game.events, []);
        game.run(2.0);
        assert_eq!(game.events, [Event::Penalised(seat(Team::Blue, 2), Penalty::Fallen)]);
        assert!(game.referee.game_state(1, game.now).is_penalised && game.truth.robots[1].0.y.abs() > 3.0);
        game.truth.robots[2].0 = DVec2::new(0.0, 5.0);
        game.truth.ball = DVec2::new(0.5, 0.5);
        game.run(31.0);
        assert!(game.events.contains(&Event::Penalised(seat(Team::Red, 1), Penalty::LeftField)));
        assert!(game.events.contains(&Event::Returned(seat(Team::Blue, 2))));
        assert!(!game.referee.is_penalised(1) && !game.referee.is_penalised(2));
    }

    #[test]
    fn who_is_picked_up_for_its_team_is_off_the_field_as_others_and_again_if_asked_again() {
        let mut game = Game::playing();
        game.truth.ball = DVec2::new(0.5, 0.5);
        game.referee.pick_up(1);
        game.run(1.0);
        assert_eq!(game.events, [Event::Penalised(seat(Team::Blue, 2), Penalty::PickUp)]);
        let state = game.referee.game_state(1, game.now);
        assert!(
            state.is_penalised && state.penalty == 6 && game.truth.robots[1].0.y.abs() > 3.0,
            "{state:?}"
        );
        game.run(20.0);
        game.referee.pick_up(1);
        game.run(20.0);
        assert!(game.referee.is_penalised(1), "its penalty began anew");
        game.run(11.0);
        assert!(game.events.contains(&Event::Returned(seat(Team::Blue, 2))) && !game.referee.is_penalised(1));
    }

    #[test]
    fn a_ball_that_nobody_moves_is_dropped() {
        let mut game = Game::playing();
        game.run(31.0);
        assert_eq!(game.events, [Event::Stuck, Event::Phase(Phase::Ready)]);
    }

    #[test]
    fn who_stands_in_the_other_half_is_put_back_when_set_begins() {
        let mut game = Game::new(600);
        game.run(10.0);
        game.truth.robots[1].0 = DVec2::new(2.0, 1.0);
        // Red may not be in the circle when blue kicks off.
        game.truth.robots[3].0 = DVec2::new(0.3, 0.0);
        game.run(21.0);
        let [blue, red] = [Team::Blue, Team::Red].map(|team| Event::PutBack(seat(team, 2)));
        assert!(game.events.contains(&blue) && game.events.contains(&red), "{:?}", game.events);
    }

    #[test]
    fn sides_change_at_half_time_and_the_game_ends() {
        let mut game = Game::new(20);
        game.run(56.0);
        assert!(game.events.contains(&Event::HalfTime));
        assert!(game.referee.defends_right(Team::Blue) && game.truth.robots[0].0.x > 4.0);
        assert_eq!(game.referee.game_state(2, game.now).kick_team, GameState::OWN);
        // A ball in the goal on the right is now a goal for red.
        game.run(36.0);
        game.truth.ball = DVec2::new(4.7, 0.0);
        game.run(0.1);
        assert_eq!(game.referee.score(), [0, 1]);
        game.run(60.0);
        assert_eq!(game.referee.phase(), Phase::Finished);
        let ended = game.events.len();
        game.run(5.0);
        assert_eq!(game.events.len(), ended);
    }
}
