//! Packets of the football leagues' GameController, and the answers of players.
//!
//! | version | league | bytes |
//! | --- | --- | --- |
//! | 12 | humanoid league until 2025 | 688, answered with 8 |
//! | 15, 18 | standard platform league 2023 to 2026 | 118, answered with 32 |
//! | 19 | humanoid soccer league 2026, first edition | 198, answered with 32 |
//! | 20 | humanoid soccer league 2026 | 158, answered with 32 |
//!
//! Numbers are little-endian, without padding. A packet has exactly the length of its version.
//!
//! ```
//! use downbeat_leagues::packets::{ControlPacket, State, Version};
//!
//! let packet = ControlPacket { state: State::Playing, ..ControlPacket::new(Version::Hsl20, [3, 7]) };
//! let bytes = packet.build();
//! assert_eq!(bytes.len(), 158);
//! assert_eq!(ControlPacket::parse(&bytes)?, packet);
//! # Ok::<(), downbeat_leagues::packets::PacketError>(())
//! ```
//!
//! # References
//! The headers `RoboCupGameControlData.h` of RoboCup-SPL/GameController3 (18),
//! RoboCup-HumanoidSoccerLeague/GameController (19; 20 since its release 7) and
//! RoboCup-Humanoid-TC/GameController (12, 15).

use thiserror::Error;

/// The UDP port on which the GameController broadcasts to players.
pub const CONTROL_PORT: u16 = 3838;
/// The UDP port on which it receives the answers of players.
pub const ANSWER_PORT: u16 = 3939;
/// The number of players in a team for which the packets have room; version 12 has room for 11.
pub const MOST_PLAYERS: usize = 20;

const CONTROL: &[u8; 4] = b"RGme";
const ANSWER: &[u8; 4] = b"RGrt";
const NO_TEAM: u8 = 255;
/// Size of the coach's message in version 12 (`SPL_COACH_MESSAGE_SIZE`).
const COACH_MESSAGE: usize = 253;

/// The version of a packet, which determines its layout and the numbers of states, set plays and penalties.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Version {
    /// 12, of the humanoid league.
    Humanoid12,
    /// 15, of the standard platform league.
    Spl15,
    /// 18, of the standard platform league: 15 with the state [`State::Standby`].
    Spl18,
    /// 19, of the humanoid soccer league.
    Hsl19,
    /// 20, of the humanoid soccer league.
    Hsl20,
}

/// The bytes are not a packet of a known version.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum PacketError {
    /// The first four bytes differ.
    #[error("the datagram is no packet of a GameController: it does not begin with {0:?}")]
    Header(&'static str),
    /// The version is not supported.
    #[error(
        "the GameController sends packets of version {0}; known are 12, 15, 18, 19 and 20: use a GameController of one of these, \
         or a newer downbeat"
    )]
    Version(u16),
    /// The length does not fit the version.
    #[error(
        "a packet of version {version} has {expected} bytes, not {found}: it is cut off, or of another league with that number"
    )]
    Length {
        /// The version in the packet.
        version: u16,
        /// The length of its layout.
        expected: usize,
        /// The length of the datagram.
        found: usize,
    },
    /// A field has a value that the version does not define.
    #[error("{field} is {value}, which version {version} does not define")]
    Value {
        /// The version in the packet.
        version: u16,
        /// The field, as in the header of the league.
        field: &'static str,
        /// Its value.
        value: u8,
    },
}

/// The state of the game.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum State {
    /// Before a half: players do not move.
    #[default]
    Initial,
    /// Players walk to their positions.
    Ready,
    /// Players stand and wait.
    Set,
    /// The ball is in play.
    Playing,
    /// The half has ended.
    Finished,
    /// Before `Ready`: players may be told by a gesture of the referee.
    Standby,
}

/// The phase of the game.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Phase {
    /// One of the two halves.
    #[default]
    Normal,
    /// The penalty shoot-out.
    PenaltyShootOut,
    /// Extra time.
    ExtraTime,
    /// A time-out.
    TimeOut,
}

/// How the game is resumed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SetPlay {
    /// Kick-off, or the game goes on.
    #[default]
    None,
    /// A goal kick.
    GoalKick,
    /// A corner kick.
    CornerKick,
    /// A throw-in; in the standard platform league a kick-in.
    ThrowIn,
    /// A free kick that may go into the goal; in the standard platform league a pushing free kick.
    DirectFreeKick,
    /// A free kick that another player has to touch before a goal.
    IndirectFreeKick,
    /// A penalty kick.
    PenaltyKick,
}

/// What the referee says about the game. Fields that a version lacks are zero, false or `None` when parsed,
/// and are not built.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ControlPacket {
    /// The version.
    pub version: Version,
    /// Counts the packets, modulo 256.
    pub packet_number: u8,
    /// The number of players in a team.
    pub players_per_team: u8,
    /// Round robin (0) or play-off (1); 15 and 18 only.
    pub competition_phase: u8,
    /// The kind of competition; in version 12 the kind of game.
    pub competition_type: u8,
    /// The game is interrupted and all players have to stand still; 19 and 20 only.
    pub is_stopped: bool,
    /// The phase.
    pub phase: Phase,
    /// The state.
    pub state: State,
    /// How the game is resumed. Version 12 has one number for phase and set play, and tells a set play in
    /// preference to the phase.
    pub set_play: SetPlay,
    /// The stage of a set play, version 12 only: 0 freeze, 1 placing, 2 freeze again before it goes on.
    pub set_play_stage: u8,
    /// The first half, of the game or of extra time.
    pub is_first_half: bool,
    /// The number of the team that has the kick-off or set play.
    pub kicking_team: Option<u8>,
    /// Until the end of the half; negative when it is over time.
    pub seconds_remaining: i16,
    /// Until the end of what the state waits for.
    pub secondary_seconds: i16,
    /// The teams. The first one defends the left goal, as the referee sees the field.
    pub teams: [Team; 2],
}

/// A team in a [`ControlPacket`].
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Team {
    /// The number of the team.
    pub number: u8,
    /// The colour of the field players, as numbered in the headers.
    pub field_player_colour: u8,
    /// The colour of the goalkeeper; not in version 12.
    pub goalkeeper_colour: u8,
    /// The number of the player who is goalkeeper; 0 for none.
    pub goalkeeper: u8,
    /// Goals.
    pub score: u8,
    /// Counts the penalty shots.
    pub penalty_shot: u8,
    /// Bit n is set if the n-th penalty shot was a goal.
    pub single_shots: u16,
    /// How many team messages the team may still send; `None` in version 12, which does not count them.
    pub message_budget: Option<u16>,
    /// The players, by their number minus one.
    pub players: [Player; MOST_PLAYERS],
}

/// A player in a [`ControlPacket`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Player {
    /// The number of the penalty in this version; 0 for none.
    pub penalty: u8,
    /// Until the penalty ends, an estimate.
    pub seconds_penalised: u8,
    /// 12 and 19 only.
    pub warnings: u8,
    /// Yellow cards; not in 15 and 18.
    pub cautions: u8,
    /// Version 12 only.
    pub red_cards: u8,
}

/// What a player answers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Answer {
    /// Version 2, for packets of version 12.
    Alive {
        /// The number of the team.
        team: u8,
        /// The number of the player.
        player: u8,
        /// What the player says (`GAMECONTROLLER_RETURN_MSG_…`): [`Answer::ALIVE`], or that it was penalised
        /// by hand.
        message: u8,
    },
    /// Version 4, for the others.
    Status {
        /// The number of the team.
        team: u8,
        /// The number of the player.
        player: u8,
        /// Cannot play.
        is_fallen: bool,
        /// x, y (mm) and direction (rad) on the field; x towards the goal of the opponents, origin in the
        /// centre.
        pose: [f32; 3],
        /// Since the ball was seen (s); negative if it was never.
        ball_age: f32,
        /// x, y (mm) from the robot: forward, left.
        ball: [f32; 2],
    },
}

impl Version {
    /// All versions.
    pub const ALL: [Self; 5] = [Self::Humanoid12, Self::Spl15, Self::Spl18, Self::Hsl19, Self::Hsl20];

    /// The number in packets.
    #[must_use]
    pub const fn number(self) -> u16 {
        match self {
            Self::Humanoid12 => 12,
            Self::Spl15 => 15,
            Self::Spl18 => 18,
            Self::Hsl19 => 19,
            Self::Hsl20 => 20,
        }
    }

    /// The length of a packet in bytes.
    #[must_use]
    pub const fn length(self) -> usize {
        match self {
            Self::Humanoid12 => 24 + 2 * (7 + COACH_MESSAGE + 6 + 11 * 6),
            Self::Spl15 | Self::Spl18 => 18 + 2 * (10 + MOST_PLAYERS * 2),
            Self::Hsl19 => 18 + 2 * (10 + MOST_PLAYERS * 4),
            Self::Hsl20 => 18 + 2 * (10 + MOST_PLAYERS * 3),
        }
    }

    /// How many players of a team a packet describes.
    #[must_use]
    pub const fn players(self) -> usize {
        match self {
            Self::Humanoid12 => 11,
            _ => MOST_PLAYERS,
        }
    }

    /// The version of a datagram, from its first six bytes.
    fn of(bytes: &[u8]) -> Result<Self, PacketError> {
        let [b'R', b'G', b'm', b'e', low, high, ..] = *bytes else { return Err(PacketError::Header("RGme")) };
        // Version 12 has 16 bits for it, the others 8, followed by a counter.
        let number = if low == 12 { u16::from_le_bytes([low, high]) } else { u16::from(low) };
        let found = Self::ALL.into_iter().find(|version| version.number() == number);
        let version = found.ok_or(PacketError::Version(number))?;
        let expected = version.length();
        let found = bytes.len();
        if found == expected {
            Ok(version)
        } else {
            Err(PacketError::Length { version: number, expected, found })
        }
    }

    /// What the numbers of set plays stand for, from 1 on.
    const fn set_plays(self) -> &'static [SetPlay] {
        use SetPlay::{CornerKick, DirectFreeKick, GoalKick, IndirectFreeKick, PenaltyKick, ThrowIn};
        match self {
            Self::Humanoid12 => &[],
            Self::Spl15 | Self::Spl18 => &[GoalKick, DirectFreeKick, CornerKick, ThrowIn, PenaltyKick],
            Self::Hsl19 | Self::Hsl20 => {
                &[DirectFreeKick, IndirectFreeKick, PenaltyKick, ThrowIn, GoalKick, CornerKick]
            }
        }
    }
}

const STATES: [State; 6] =
    [State::Initial, State::Ready, State::Set, State::Playing, State::Finished, State::Standby];
const PHASES: [Phase; 4] = [Phase::Normal, Phase::PenaltyShootOut, Phase::ExtraTime, Phase::TimeOut];
/// `STATE2_…` of version 12 from 4 on; those before are the phases.
const SECONDARY_STATES: [SetPlay; 6] = [
    SetPlay::DirectFreeKick,
    SetPlay::IndirectFreeKick,
    SetPlay::PenaltyKick,
    SetPlay::CornerKick,
    SetPlay::GoalKick,
    SetPlay::ThrowIn,
];

/// The number of a value in a table; the first for what the table lacks.
fn number_of<T: PartialEq>(table: &[T], value: &T) -> u8 {
    table.iter().position(|each| each == value).unwrap_or(0) as u8
}

impl ControlPacket {
    /// A packet about two teams before their game, with 4 players each and no message budget limit.
    #[must_use]
    pub fn new(version: Version, teams: [u8; 2]) -> Self {
        let message_budget = (version != Version::Humanoid12).then_some(u16::MAX);
        Self {
            version,
            packet_number: 0,
            players_per_team: 4,
            competition_phase: 0,
            competition_type: 0,
            is_stopped: false,
            phase: Phase::Normal,
            state: State::Initial,
            set_play: SetPlay::None,
            set_play_stage: 0,
            is_first_half: true,
            kicking_team: None,
            seconds_remaining: 600,
            secondary_seconds: 0,
            teams: teams.map(|number| Team { number, message_budget, ..Team::default() }),
        }
    }

    /// Parses a datagram.
    ///
    /// # Errors
    /// Returns an error if it is not a packet of a known version with exactly its length, or a field has an
    /// undefined value.
    pub fn parse(bytes: &[u8]) -> Result<Self, PacketError> {
        let version = Version::of(bytes)?;
        let mut fields = Fields(bytes.get(4..).unwrap_or_default());
        if version == Version::Humanoid12 {
            Self::parse_humanoid(&mut fields)
        } else {
            Self::parse_common(version, &mut fields)
        }
    }

    fn parse_common(version: Version, fields: &mut Fields<'_>) -> Result<Self, PacketError> {
        let [_, packet_number, players_per_team, first, second, phase, state, set_play, half, kicking] =
            fields.take();
        let undefined = |field, value| PacketError::Value { version: version.number(), field, value };
        let is_spl = matches!(version, Version::Spl15 | Version::Spl18);
        let states = if version == Version::Spl18 { &STATES[..] } else { &STATES[..5] };
        Ok(Self {
            version,
            packet_number,
            players_per_team,
            competition_phase: if is_spl { first } else { 0 },
            competition_type: if is_spl { second } else { first },
            is_stopped: !is_spl && second != 0,
            phase: *PHASES.get(usize::from(phase)).ok_or_else(|| undefined("gamePhase", phase))?,
            state: *states.get(usize::from(state)).ok_or_else(|| undefined("state", state))?,
            set_play: match usize::from(set_play).checked_sub(1) {
                None => SetPlay::None,
                Some(index) => {
                    *version.set_plays().get(index).ok_or_else(|| undefined("setPlay", set_play))?
                }
            },
            set_play_stage: 0,
            is_first_half: half == 1,
            kicking_team: (kicking != NO_TEAM).then_some(kicking),
            seconds_remaining: i16::from_le_bytes(fields.take()),
            secondary_seconds: i16::from_le_bytes(fields.take()),
            teams: [(); 2].map(|()| {
                let [number, field_player_colour, goalkeeper_colour, goalkeeper, score, penalty_shot] =
                    fields.take();
                Team {
                    number,
                    field_player_colour,
                    goalkeeper_colour,
                    goalkeeper,
                    score,
                    penalty_shot,
                    single_shots: u16::from_le_bytes(fields.take()),
                    message_budget: Some(u16::from_le_bytes(fields.take())),
                    players: [(); MOST_PLAYERS].map(|()| {
                        let [penalty, seconds_penalised] = fields.take();
                        let player = Player { penalty, seconds_penalised, ..Player::default() };
                        match version {
                            Version::Hsl19 => {
                                let [warnings, cautions] = fields.take();
                                Player { warnings, cautions, ..player }
                            }
                            Version::Hsl20 => {
                                let [cautions] = fields.take();
                                Player { cautions, ..player }
                            }
                            _ => player,
                        }
                    }),
                }
            }),
        })
    }

    fn parse_humanoid(fields: &mut Fields<'_>) -> Result<Self, PacketError> {
        let version = Version::Humanoid12;
        let [_, _, packet_number, players_per_team, competition_type, state, half, kick_off, secondary] =
            fields.take();
        let [set_play_team, set_play_stage, _, _] = fields.take();
        let [_drop_in_team, _, _] = fields.take();
        let undefined = |field, value| PacketError::Value { version: version.number(), field, value };
        let set_play = match usize::from(secondary).checked_sub(PHASES.len()) {
            None => SetPlay::None,
            Some(index) => {
                *SECONDARY_STATES.get(index).ok_or_else(|| undefined("secondaryState", secondary))?
            }
        };
        let is_set_play = set_play != SetPlay::None;
        let kicking = if is_set_play { set_play_team } else { kick_off };
        Ok(Self {
            version,
            packet_number,
            players_per_team,
            competition_phase: 0,
            competition_type,
            is_stopped: false,
            phase: *PHASES.get(usize::from(secondary)).unwrap_or(&Phase::Normal),
            state: *STATES[..5].get(usize::from(state)).ok_or_else(|| undefined("state", state))?,
            set_play,
            set_play_stage: if is_set_play { set_play_stage } else { 0 },
            is_first_half: half == 1,
            kicking_team: (kicking != NO_TEAM).then_some(kicking),
            seconds_remaining: i16::from_le_bytes(fields.take()),
            secondary_seconds: i16::from_le_bytes(fields.take()),
            teams: [(); 2].map(|()| {
                let [number, field_player_colour, score, penalty_shot] = fields.take();
                let single_shots = u16::from_le_bytes(fields.take());
                let [_sequence] = fields.take();
                let _: [u8; COACH_MESSAGE] = fields.take();
                let _coach: [u8; 6] = fields.take();
                let mut team = Team {
                    number,
                    field_player_colour,
                    score,
                    penalty_shot,
                    single_shots,
                    ..Team::default()
                };
                for (index, player) in team.players.iter_mut().take(version.players()).enumerate() {
                    let [penalty, seconds_penalised, warnings, cautions, red_cards, is_goalkeeper] =
                        fields.take();
                    *player = Player { penalty, seconds_penalised, warnings, cautions, red_cards };
                    if is_goalkeeper != 0 && team.goalkeeper == 0 {
                        team.goalkeeper = index as u8 + 1;
                    }
                }
                team
            }),
        })
    }

    /// Builds the datagram. States and set plays that the version lacks are sent as `Initial` and none.
    #[must_use]
    pub fn build(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(self.version.length());
        out.extend(CONTROL);
        if self.version == Version::Humanoid12 {
            self.build_humanoid(&mut out)
        } else {
            self.build_common(&mut out)
        }
        out
    }

    fn build_common(&self, out: &mut Vec<u8>) {
        let is_spl = matches!(self.version, Version::Spl15 | Version::Spl18);
        let [first, second] = if is_spl {
            [self.competition_phase, self.competition_type]
        } else {
            [self.competition_type, u8::from(self.is_stopped)]
        };
        let states = if self.version == Version::Spl18 { &STATES[..] } else { &STATES[..5] };
        let set_play = self.version.set_plays().iter().position(|each| *each == self.set_play);
        out.extend([
            self.version.number() as u8,
            self.packet_number,
            self.players_per_team,
            first,
            second,
            number_of(&PHASES, &self.phase),
            number_of(states, &self.state),
            set_play.map_or(0, |index| index as u8 + 1),
            u8::from(self.is_first_half),
            self.kicking_team.unwrap_or(NO_TEAM),
        ]);
        out.extend(self.seconds_remaining.to_le_bytes());
        out.extend(self.secondary_seconds.to_le_bytes());
        for team in &self.teams {
            out.extend([
                team.number,
                team.field_player_colour,
                team.goalkeeper_colour,
                team.goalkeeper,
                team.score,
                team.penalty_shot,
            ]);
            out.extend(team.single_shots.to_le_bytes());
            out.extend(team.message_budget.unwrap_or(u16::MAX).to_le_bytes());
            for player in &team.players {
                out.extend([player.penalty, player.seconds_penalised]);
                match self.version {
                    Version::Hsl19 => out.extend([player.warnings, player.cautions]),
                    Version::Hsl20 => out.push(player.cautions),
                    _ => {}
                }
            }
        }
    }

    fn build_humanoid(&self, out: &mut Vec<u8>) {
        let kicking = self.kicking_team.unwrap_or(NO_TEAM);
        let set_play = SECONDARY_STATES.iter().position(|each| *each == self.set_play);
        let (secondary, info) = match set_play {
            Some(index) => ((PHASES.len() + index) as u8, [kicking, self.set_play_stage, 0, 0]),
            None => (number_of(&PHASES, &self.phase), [0; 4]),
        };
        out.extend(self.version.number().to_le_bytes());
        out.extend([
            self.packet_number,
            self.players_per_team,
            self.competition_type,
            number_of(&STATES[..5], &self.state),
            u8::from(self.is_first_half),
            kicking,
            secondary,
        ]);
        out.extend(info);
        out.extend([0, 0xff, 0xff]); // no drop-in yet
        out.extend(self.seconds_remaining.to_le_bytes());
        out.extend(self.secondary_seconds.to_le_bytes());
        for team in &self.teams {
            out.extend([team.number, team.field_player_colour, team.score, team.penalty_shot]);
            out.extend(team.single_shots.to_le_bytes());
            out.extend([0; 1 + COACH_MESSAGE + 6]);
            for (index, player) in team.players.iter().take(self.version.players()).enumerate() {
                let is_goalkeeper = usize::from(team.goalkeeper) == index + 1;
                out.extend([
                    player.penalty,
                    player.seconds_penalised,
                    player.warnings,
                    player.cautions,
                    player.red_cards,
                    u8::from(is_goalkeeper),
                ]);
            }
        }
    }
}

impl Answer {
    /// The message of a player that has nothing else to say (`GAMECONTROLLER_RETURN_MSG_ALIVE`).
    pub const ALIVE: u8 = 2;

    /// Parses a datagram.
    ///
    /// # Errors
    /// Returns an error if it is not an answer of version 2 or 4 with exactly its length.
    pub fn parse(bytes: &[u8]) -> Result<Self, PacketError> {
        let [b'R', b'G', b'r', b't', version, ..] = *bytes else { return Err(PacketError::Header("RGrt")) };
        let expected = match version {
            2 => 8,
            4 => 32,
            other => return Err(PacketError::Version(other.into())),
        };
        if bytes.len() != expected {
            return Err(PacketError::Length { version: version.into(), expected, found: bytes.len() });
        }
        let mut fields = Fields(bytes.get(5..).unwrap_or_default());
        let [first, second, third] = fields.take();
        if version == 2 {
            return Ok(Self::Alive { team: first, player: second, message: third });
        }
        let mut number = || f32::from_le_bytes(fields.take());
        Ok(Self::Status {
            player: first,
            team: second,
            is_fallen: third == 1,
            pose: [number(), number(), number()],
            ball_age: number(),
            ball: [number(), number()],
        })
    }

    /// Builds the datagram.
    #[must_use]
    pub fn build(&self) -> Vec<u8> {
        let mut out = ANSWER.to_vec();
        match *self {
            Self::Alive { team, player, message } => out.extend([2, team, player, message]),
            Self::Status { team, player, is_fallen, pose, ball_age, ball } => {
                out.extend([4, player, team, u8::from(is_fallen)]);
                let numbers = pose.into_iter().chain([ball_age]).chain(ball);
                out.extend(numbers.flat_map(f32::to_le_bytes));
            }
        }
        out
    }
}

/// The bytes of a packet whose length was checked; zeros beyond its end.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let mut taken = [0; N];
        if let Some((bytes, rest)) = self.0.split_at_checked(N) {
            taken.copy_from_slice(bytes);
            self.0 = rest;
        }
        taken
    }
}
