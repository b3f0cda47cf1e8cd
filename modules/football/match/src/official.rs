//! The official that decides the state of the game.

use crate::drill::Drill;
use crate::game::{Event, Order, Phase, Seat, Team, Truth};
use crate::referee::Referee;
use downbeat_football::football_interfaces::msg::{GameState, MatchState};
use glam::DVec2;
use std::time::Duration;

/// The referee of a match, or the official of shots at an empty goal.
pub enum Official {
    /// The referee of a match.
    Referee(Box<Referee>),
    /// The official of shots at an empty goal.
    Drill(Box<Drill>),
}

impl Official {
    /// The initial place of a robot: position and heading in the world.
    #[must_use]
    pub fn place_of(&self, robot: usize) -> (DVec2, f64) {
        match self {
            Self::Referee(referee) => referee.place_of(robot),
            Self::Drill(drill) => {
                let placement = drill.placement();
                (placement.robot, placement.heading)
            }
        }
    }

    /// Takes the true state at this time since the start, and returns events and orders.
    pub fn step(&mut self, now: Duration, truth: &Truth) -> (Vec<Event>, Vec<Order>) {
        match self {
            Self::Referee(referee) => referee.step(now, truth),
            Self::Drill(drill) => drill.step(now, truth),
        }
    }

    /// Picks a player up at the next step, as its team asks, see [`Referee::pick_up`]. At an empty goal
    /// nobody is picked up.
    pub fn pick_up(&mut self, robot: usize) {
        if let Self::Referee(referee) = self {
            referee.pick_up(robot);
        }
    }

    /// The phase of the game.
    #[must_use]
    pub fn phase(&self) -> Phase {
        match self {
            Self::Referee(referee) => referee.phase(),
            Self::Drill(drill) => drill.phase(),
        }
    }

    /// The state of the game for one player. The header is empty.
    #[must_use]
    pub fn game_state(&self, robot: usize, now: Duration) -> GameState {
        match self {
            Self::Referee(referee) => referee.game_state(robot, now),
            Self::Drill(drill) => drill.game_state(now),
        }
    }

    /// True if a team currently defends the goal at +x.
    #[must_use]
    pub fn defends_right(&self, team: Team) -> bool {
        match self {
            Self::Referee(referee) => referee.defends_right(team),
            Self::Drill(_) => team == Team::Red,
        }
    }

    /// The state of the match for spectators, without the header, the robots and the ball.
    #[must_use]
    pub fn match_state(&self, seats: &[Seat], now: Duration) -> MatchState {
        // From the view of the first blue player, or of red with the sides exchanged.
        let blue = seats.iter().position(|seat| seat.team == Team::Blue);
        let state = self.game_state(blue.unwrap_or_default(), now);
        let (own, opponent) = (state.own_score, state.opponent_score);
        let [blue_score, red_score] = if blue.is_some() { [own, opponent] } else { [opponent, own] };
        let kick_team = match (blue, state.kick_team) {
            (None, GameState::OWN) => GameState::OPPONENT,
            (None, GameState::OPPONENT) => GameState::OWN,
            (_, team) => team,
        };
        MatchState {
            phase: state.state,
            set_play: state.set_play,
            kick_team,
            is_first_half: state.is_first_half,
            seconds_remaining: state.seconds_remaining,
            blue_score,
            red_score,
            blue_defends_right: self.defends_right(Team::Blue),
            is_penalised: (0..seats.len()).map(|robot| self.game_state(robot, now).is_penalised).collect(),
            ..MatchState::default()
        }
    }
}
