//! Terms of the game: teams, phases, events and the orders of an official.

use downbeat_football::football_interfaces::msg::GameState;
use glam::DVec2;
use std::fmt;

/// A team: blue defends the left goal, at -x of the world, in the first half.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Team {
    /// On the left in the first half.
    Blue,
    /// On the right in the first half.
    Red,
}

/// A player's place in the match.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seat {
    /// The team.
    pub team: Team,
    /// The number in the team, from 1; number 1 is the goalkeeper.
    pub number: u8,
}

/// The phase of the game.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Before a half: players are put to their places.
    Initial,
    /// Players walk to their positions.
    Ready,
    /// Players stand.
    Set,
    /// The ball is in play.
    Playing,
    /// The game is over.
    Finished,
}

/// A set play, by its cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetPlay {
    /// The ball left at a touch line.
    ThrowIn,
    /// The ball left at a goal line, touched last by the attackers.
    GoalKick,
    /// The ball left at a goal line, touched last by the defenders.
    CornerKick,
}

/// The reason why a player is off the field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Penalty {
    /// The player lay on the floor for too long.
    Fallen,
    /// The player left the carpet.
    LeftField,
    /// The player's team asked for it.
    PickUp,
}

/// An event of the game.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// A phase began.
    Phase(Phase),
    /// A team scored a goal.
    Goal(Team),
    /// A set play was awarded to a team.
    SetPlay(SetPlay, Team),
    /// The ball did not move, and is dropped in the centre.
    Stuck,
    /// The time of a try at the empty goal is over.
    TimeUp,
    /// A player was taken off the field.
    Penalised(Seat, Penalty),
    /// A penalised player has returned.
    Returned(Seat),
    /// A player was in a forbidden place when *set* began, and was put back.
    PutBack(Seat),
    /// The first half is over.
    HalfTime,
}

/// An order to be carried out at once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// Put the ball at this position, at rest.
    Ball(DVec2),
    /// Put a robot at this position, upright.
    Robot {
        /// The index of the robot.
        robot: usize,
        /// The position.
        position: DVec2,
        /// The heading, in rad.
        heading: f64,
    },
}

/// The true state of the field, in the frame of the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// The centre of the ball.
    pub ball: DVec2,
    /// The height of the ball above the floor.
    pub ball_height: f64,
    /// The robot that touched the ball last.
    pub last_touch: Option<usize>,
    /// The positions of the robots, and whether each is upright.
    pub robots: Vec<(DVec2, bool)>,
}

impl Team {
    /// The other team.
    #[must_use]
    pub fn other(self) -> Self {
        match self {
            Self::Blue => Self::Red,
            Self::Red => Self::Blue,
        }
    }

    pub(crate) fn index(self) -> usize {
        self as usize
    }

    /// The number of the team, as in the game controllers.
    #[must_use]
    pub fn number(self) -> u8 {
        match self {
            Self::Blue => 1,
            Self::Red => 2,
        }
    }

    /// The number of the team's colour, as in `GameState`.
    pub(crate) fn colour(self) -> u8 {
        match self {
            Self::Blue => GameState::COLOUR_BLUE,
            Self::Red => GameState::COLOUR_RED,
        }
    }
}

impl Penalty {
    /// The number of the penalty in packets of version 20 of the humanoid soccer league: *incapable robot*,
    /// *leaving the field* and *pick-up*.
    #[must_use]
    pub fn number(self) -> u8 {
        match self {
            Self::Fallen => 5,
            Self::LeftField => 8,
            Self::PickUp => 6,
        }
    }
}

impl fmt::Display for Team {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Blue => "blue",
            Self::Red => "red",
        })
    }
}

impl fmt::Display for Seat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.team, self.number)
    }
}

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Initial => "initial",
            Self::Ready => "ready",
            Self::Set => "set",
            Self::Playing => "playing",
            Self::Finished => "finished",
        })
    }
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Phase(phase) => write!(f, "{phase}"),
            Self::Goal(team) => write!(f, "goal for {team}"),
            Self::SetPlay(SetPlay::ThrowIn, team) => write!(f, "throw-in for {team}"),
            Self::SetPlay(SetPlay::GoalKick, team) => write!(f, "goal kick for {team}"),
            Self::SetPlay(SetPlay::CornerKick, team) => write!(f, "corner kick for {team}"),
            Self::TimeUp => f.write_str("time is up"),
            Self::Stuck => f.write_str("the ball is dropped in the centre"),
            Self::Penalised(seat, Penalty::Fallen) => write!(f, "{seat} does not get up and is picked up"),
            Self::Penalised(seat, Penalty::LeftField) => write!(f, "{seat} left the field"),
            Self::Penalised(seat, Penalty::PickUp) => write!(f, "{seat} is picked up as its team asked"),
            Self::Returned(seat) => write!(f, "{seat} returns"),
            Self::PutBack(seat) => write!(f, "{seat} is put back to its half"),
            Self::HalfTime => f.write_str("half-time"),
        }
    }
}
