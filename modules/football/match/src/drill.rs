//! Shots at an empty goal, one try after another.

use crate::game::{Event, Order, Phase, Team, Truth};
use downbeat_football::Field;
use downbeat_football::football_interfaces::msg::GameState;
use downbeat_servos::servo_emulator::Random;
use glam::DVec2;
use std::f64::consts::TAU;
use std::time::Duration;

/// A drill with one robot and an empty goal at +x. Each try has its own seed: the ball lies within 2 m of the
/// goal, and the robot stands within 1.5 m of the ball, with a random heading. A try lasts up to
/// [`Drill::TIME`].
pub struct Drill {
    field: Field,
    seed: u64,
    tries: u32,
    /// The number of finished tries.
    done: u32,
    goals: u32,
    since: Option<Duration>,
}

/// The initial positions of a try.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// The ball.
    pub ball: DVec2,
    /// The robot.
    pub robot: DVec2,
    /// Its heading, in rad.
    pub heading: f64,
}

impl Drill {
    /// The time limit of a try.
    pub const TIME: Duration = Duration::from_secs(90);

    /// A drill of `tries` tries, with this seed and the following ones.
    #[must_use]
    pub fn new(field: Field, seed: u64, tries: u32) -> Self {
        Self { field, seed, tries, done: 0, goals: 0, since: None }
    }

    /// The initial positions of the current try.
    #[must_use]
    pub fn placement(&self) -> Placement {
        let mut random = Random::new(self.seed.wrapping_add(self.done.into()), 9);
        let goal = DVec2::new(self.field.length / 2.0, 0.0);
        let inside = DVec2::new(goal.x, self.field.width / 2.0) - 0.3;
        let mut on_field = |centre: DVec2, [from, to]: [f64; 2]| loop {
            let far = from + random.unit() * (to - from);
            let place = centre + DVec2::from_angle(random.unit() * TAU) * far;
            if place.abs().cmplt(inside).all() {
                return place;
            }
        };
        let ball = on_field(goal, [0.8, 2.0]);
        let robot = on_field(ball, [0.4, 1.5]);
        Placement { ball, robot, heading: random.unit() * TAU }
    }

    /// The number of goals, and of finished tries.
    #[must_use]
    pub fn score(&self) -> [u32; 2] {
        [self.goals, self.done]
    }

    pub(crate) fn phase(&self) -> Phase {
        if self.done == self.tries { Phase::Finished } else { Phase::Playing }
    }

    pub(crate) fn step(&mut self, now: Duration, truth: &Truth) -> (Vec<Event>, Vec<Order>) {
        if self.phase() == Phase::Finished {
            return Default::default();
        }
        let Some(since) = self.since else {
            self.since = Some(now);
            return (vec![Event::Phase(Phase::Playing)], vec![Order::Ball(self.placement().ball)]);
        };
        let [x, y] = [self.field.length / 2.0 + self.field.ball.diameter / 2.0, self.field.goal.width / 2.0];
        let is_goal =
            truth.ball.x > x && truth.ball.y.abs() < y && truth.ball_height < self.field.goal.height;
        let is_over = now.saturating_sub(since) >= Self::TIME;
        if !is_goal && !is_over {
            return Default::default();
        }
        (self.done, self.since) = (self.done + 1, Some(now));
        self.goals += u32::from(is_goal);
        let mut events = vec![if is_goal { Event::Goal(Team::Blue) } else { Event::TimeUp }];
        if self.phase() == Phase::Finished {
            events.push(Event::Phase(Phase::Finished));
            return (events, Vec::new());
        }
        let Placement { ball, robot, heading } = self.placement();
        (events, vec![Order::Ball(ball), Order::Robot { robot: 0, position: robot, heading }])
    }

    pub(crate) fn game_state(&self, now: Duration) -> GameState {
        let left = self.since.map_or(Self::TIME, |since| (since + Self::TIME).saturating_sub(now));
        GameState {
            state: if self.phase() == Phase::Finished { GameState::FINISHED } else { GameState::PLAYING },
            is_first_half: true,
            seconds_remaining: left.as_secs_f32(),
            own_team: Team::Blue.number(),
            opponent_team: Team::Red.number(),
            own_colour: Team::Blue.colour(),
            opponent_colour: Team::Red.colour(),
            own_score: u8::try_from(self.goals).unwrap_or(u8::MAX),
            own_half_is_left: true,
            player: 2,
            message_budget: u16::MAX,
            ..GameState::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn truth(ball: DVec2) -> Truth {
        Truth { ball, ball_height: 0.05, last_touch: Some(0), robots: vec![(DVec2::ZERO, true)] }
    }

    #[test]
    fn a_try_ends_with_a_goal_or_when_time_is_up_and_the_next_begins_elsewhere() {
        let field = Field::default();
        let mut drill = Drill::new(field.clone(), 1, 2);
        let first = drill.placement();
        assert_eq!(drill.step(Duration::ZERO, &truth(first.ball)).1, [Order::Ball(first.ball)]);
        let goal = DVec2::new(field.length / 2.0 + 0.2, 0.3);
        let (events, orders) = drill.step(Duration::from_secs(5), &truth(goal));
        assert_eq!((events, orders.len()), (vec![Event::Goal(Team::Blue)], 2));
        assert_ne!(drill.placement(), first);
        assert_eq!(drill.step(Duration::from_secs(94), &truth(DVec2::ZERO)).0, []);
        let (events, orders) = drill.step(Duration::from_secs(95), &truth(DVec2::ZERO));
        assert_eq!((events, orders), (vec![Event::TimeUp, Event::Phase(Phase::Finished)], vec![]));
        assert_eq!(drill.score(), [1, 2]);
    }

    #[test]
    fn ball_and_robot_are_on_the_field_and_not_in_each_other() {
        for seed in 0..200 {
            let field = Field::default();
            let Placement { ball, robot, .. } = Drill::new(field.clone(), seed, 1).placement();
            assert!(ball.distance(DVec2::new(field.length / 2.0, 0.0)) <= 2.0, "{ball}");
            assert!((0.4..=1.5).contains(&ball.distance(robot)), "{ball} {robot}");
            assert!(robot.x < field.length / 2.0 - 0.3, "{robot}");
        }
    }
}
