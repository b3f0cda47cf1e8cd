//! The words of a game: who plays, what the game is in, what happens, and what an official orders.

use downbeat_football::football_interfaces::msg::GameState;
use glam::DVec2;
use std::fmt;

/// A team: that which defends the left goal, at -x of the world, in the first half, or the other one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Team {
    /// On the left in the first half.
    Blue,
    /// On the right in the first half.
    Red,
}

/// Who plays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seat {
    /// Its team.
    pub team: Team,
    /// Its number in the team, from 1; number 1 keeps the goal.
    pub number: u8,
}

/// What the game is in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Before the game.
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

/// Whose ball it is, and why.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetPlay {
    /// The ball left at a touch line.
    ThrowIn,
    /// The ball left at a goal line, touched last by the attackers.
    GoalKick,
    /// The ball left at a goal line, touched last by the defenders.
    CornerKick,
}

/// Why a player is off the field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Penalty {
    /// It lay too long.
    Fallen,
    /// It left the carpet.
    LeftField,
}

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// A phase began.
    Phase(Phase),
    /// A team shot a goal.
    Goal(Team),
    /// A set play of a team.
    SetPlay(SetPlay, Team),
    /// The ball did not move: it is dropped in the centre.
    Stuck,
    /// The time of a try at the empty goal is up.
    TimeUp,
    /// A player is off the field.
    Penalised(Seat, Penalty),
    /// It is back.
    Returned(Seat),
    /// A player stood where it must not when *set* began.
    PutBack(Seat),
    /// The first half is over.
    HalfTime,
}

/// What somebody has to do at once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// Put the ball there, at rest.
    Ball(DVec2),
    /// Put a robot there, on its feet.
    Robot {
        /// Its index.
        robot: usize,
        /// Where.
        position: DVec2,
        /// Its heading, in rad.
        heading: f64,
    },
}

/// What is true on the field, in the frame of the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// The centre of the ball.
    pub ball: DVec2,
    /// Its height above the floor.
    pub ball_height: f64,
    /// The robot that touched it last.
    pub last_touch: Option<usize>,
    /// Where the robots are, and whether they are on their feet.
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

    /// As the game controllers number teams.
    #[must_use]
    pub fn number(self) -> u8 {
        match self {
            Self::Blue => 1,
            Self::Red => 2,
        }
    }

    /// As `GameState` numbers what it wears.
    pub(crate) fn colour(self) -> u8 {
        match self {
            Self::Blue => GameState::COLOUR_BLUE,
            Self::Red => GameState::COLOUR_RED,
        }
    }
}

impl Penalty {
    /// As the humanoid soccer league numbers them in its packets of version 20: *incapable robot* and *leaving the field*.
    #[must_use]
    pub fn number(self) -> u8 {
        match self {
            Self::Fallen => 5,
            Self::LeftField => 8,
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
            Self::Returned(seat) => write!(f, "{seat} returns"),
            Self::PutBack(seat) => write!(f, "{seat} is put back to its half"),
            Self::HalfTime => f.write_str("half-time"),
        }
    }
}
