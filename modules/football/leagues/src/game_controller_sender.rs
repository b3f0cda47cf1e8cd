//! Sends what a referee decides as packets of a GameController, and collects what players answer.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `NAME/game_state` (in) | football_interfaces/GameState | what the referee says to each player of `players` |
//! | `answers` | football_interfaces/TeamMessage | what a player answers; pose and ball in the frame of the field of its team |
//! | `datagrams` | downbeat_interfaces/BusExchange | all datagrams, for replays |
//!
//! A packet goes out with each new state, at most 20 ms later: a referee that speaks when something happens
//! and twice a second is heard so. Players that do not answer for 5 s are reported, once. Teams wear the
//! colours of their states; where those are unknown, the team with the smaller number wears blue and the
//! other one red. Run the module detached.

use std::collections::BTreeMap;
use std::net::{SocketAddr, SocketAddrV4};
use std::time::Duration;

use downbeat_device::{Device, DeviceLink};
use downbeat_executor::{Context, Module, Publication, Received, Setup, SetupError, Time};
use downbeat_football::football_interfaces::msg::{GameState, TeamMessage};
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::geometry_msgs::msg::{Point, Quaternion};
use downbeat_msgs::std_msgs::msg::Header;
use downbeat_network::mailbox::Mailbox;
use downbeat_network::udp::{Target, Udp, address_of};

use crate::packets::{
    ANSWER_PORT, Answer, CONTROL_PORT, ControlPacket, MOST_PLAYERS, Phase, SetPlay, State, Version,
};

/// How often the socket is polled.
const PERIOD: Duration = Duration::from_millis(20);
/// Without an answer for so long, a player counts as silent.
const SILENT_AFTER: Duration = Duration::from_secs(5);
/// How long players may take for their first answer: they start when the referee does.
const PATIENCE: Duration = Duration::from_secs(20);
/// The numbers of colours in the headers of the leagues.
const COLOURS: [u8; 2] = [0, 1];

/// The module.
pub struct GameControllerSender {
    mailbox: Mailbox<Udp>,
    version: Version,
    /// What each player was told last.
    told: Vec<Option<GameState>>,
    has_news: bool,
    packet_number: u8,
    players: BTreeMap<(u8, u8), Player>,
    complaint: String,
}

/// A player that is expected to answer.
struct Player {
    name: String,
    expected_by: Time,
    is_silent: bool,
    has_answered: bool,
}

/// The ports of [`GameControllerSender`].
pub struct Ports {
    answers: Publication<TeamMessage>,
    datagrams: Publication<BusExchange>,
}

impl Module for GameControllerSender {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let players = setup.read_only_setting(
            "players",
            Vec::<String>::new(),
            "the namespaces of the players, whose game_state is sent",
        )?;
        let version = setup.read_only_setting(
            "version",
            i64::from(Version::Hsl20.number()),
            "of the packets: 12, 15, 18, 19 or 20",
        )?;
        let to = setup.read_only_setting(
            "to",
            "255.255.255.255".to_owned(),
            "the address to which packets go: one of broadcast, or one machine",
        )?;
        let port =
            setup.read_only_setting("port", i64::from(CONTROL_PORT), "the UDP port to which packets go")?;
        let address = setup.read_only_setting(
            "address",
            "0.0.0.0".to_owned(),
            "the own address on which it receives answers; 0.0.0.0 for all",
        )?;
        let answer_port =
            setup.read_only_setting("answer_port", i64::from(ANSWER_PORT), "the UDP port for answers")?;
        let names = setup.value(players).cloned().unwrap_or_default();
        if names.is_empty() || names.len() > 2 * MOST_PLAYERS {
            let problem = format!("{} players; a packet describes 1 to {}", names.len(), 2 * MOST_PLAYERS);
            return Err(setup.refuse_value(players, problem));
        }
        let number = setup.value(version).copied().unwrap_or_default();
        let known = Version::ALL.into_iter().find(|version| i64::from(version.number()) == number);
        self.version = known
            .ok_or_else(|| setup.refuse_value(version, format!("{number} is not 12, 15, 18, 19 or 20")))?;
        let port_of = |setup: &Setup<'_, Self>, setting| {
            let port: i64 = setup.value(setting).copied().unwrap_or_default();
            let port = u16::try_from(port).ok().filter(|port| *port != 0);
            port.ok_or_else(|| setup.refuse_value(setting, "it is not between 1 and 65535"))
        };
        let target = Target::Address(SocketAddr::from((address_of(setup, to)?, port_of(setup, port)?)));
        let receives_on = SocketAddrV4::new(address_of(setup, address)?, port_of(setup, answer_port)?);
        if let Some(udp) = self.mailbox.device() {
            udp.configure(receives_on, target);
        }
        self.told = vec![None; names.len()];
        for (index, name) in names.into_iter().enumerate() {
            let topic = format!("{name}/game_state");
            setup.subscribe(&topic, move |module: &mut Self, state: Received<'_, GameState>, ctx| {
                module.hear(index, &name, &state, ctx);
            })?;
        }
        setup.every(PERIOD, Self::run)?;
        Ok(Ports { answers: setup.publish("answers")?, datagrams: setup.publish(Udp::TOPIC)? })
    }
}

impl GameControllerSender {
    /// A module that speaks on this link.
    #[must_use]
    pub fn new(link: DeviceLink<Udp>) -> Self {
        Self {
            mailbox: Mailbox::new(link),
            version: Version::Hsl20,
            told: Vec::new(),
            has_news: false,
            packet_number: 0,
            players: BTreeMap::new(),
            complaint: String::new(),
        }
    }

    fn hear(&mut self, index: usize, name: &str, state: &GameState, ctx: &mut Context<'_, Ports>) {
        if let Some(told) = self.told.get_mut(index) {
            *told = Some(state.clone());
        }
        self.has_news = true;
        let expected_by = ctx.now() + PATIENCE;
        self.players.entry((state.own_team, state.player)).or_insert_with(|| Player {
            name: name.to_owned(),
            expected_by,
            is_silent: false,
            has_answered: false,
        });
    }

    fn run(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        for datagram in self.mailbox.receive(ctx.ports.datagrams, ctx) {
            match Answer::parse(&datagram) {
                Ok(answer) => {
                    let message = team_message(&answer, now);
                    match self.players.get_mut(&(message.team, message.player)) {
                        Some(player) => {
                            if player.is_silent || !player.has_answered {
                                tracing::info!("{} answers the referee", player.name);
                            }
                            player.expected_by = now + SILENT_AFTER;
                            (player.is_silent, player.has_answered) = (false, true);
                            ctx.publish(ctx.ports.answers, message);
                        }
                        None => self.complain(format!(
                            "player {} of team {} answers, but does not play",
                            message.player, message.team
                        )),
                    }
                }
                Err(error) => self.complain(error.to_string()),
            }
        }
        for player in self.players.values_mut().filter(|player| !player.is_silent && now > player.expected_by)
        {
            tracing::warn!("{} does not answer the referee", player.name);
            player.is_silent = true;
        }
        if std::mem::take(&mut self.has_news)
            && let Some(packet) = control_packet(self.told.iter().flatten(), self.version)
        {
            self.packet_number = self.packet_number.wrapping_add(1);
            let packet = ControlPacket { packet_number: self.packet_number, ..packet };
            self.mailbox.send(packet.build(), ctx.ports.datagrams, ctx);
        }
    }

    /// Warns, but not again about the same.
    fn complain(&mut self, complaint: String) {
        if self.complaint != complaint {
            tracing::warn!("ignored: {complaint}");
            self.complaint = complaint;
        }
    }
}

/// The packet that tells each of these players its state; `None` without players.
///
/// What concerns all is that of the last player. Times are rounded up to whole seconds. [`State::Standby`]
/// exists only in version 18.
#[must_use]
pub fn control_packet<'a>(
    states: impl IntoIterator<Item = &'a GameState>,
    version: Version,
) -> Option<ControlPacket> {
    let mut packet: Option<ControlPacket> = None;
    for state in states {
        let is_first = state.own_half_is_left;
        let numbers = [state.own_team, state.opponent_team];
        let [left, right] = if is_first { numbers } else { [numbers[1], numbers[0]] };
        let packet = packet.get_or_insert_with(|| ControlPacket::new(version, [left, right]));
        tell_all(packet, state);
        let [first, second] = &mut packet.teams;
        let (own, opponent) = if is_first { (first, second) } else { (second, first) };
        (own.score, opponent.score) = (state.own_score, state.opponent_score);
        if version != Version::Humanoid12 {
            own.message_budget = Some(state.message_budget);
        }
        let [blue, red] = COLOURS;
        let number = |colour, otherwise| match colour {
            GameState::COLOUR_BLUE => blue,
            GameState::COLOUR_RED => red,
            _ => otherwise,
        };
        let (of_own, of_opponent) =
            if state.own_team < state.opponent_team { (blue, red) } else { (red, blue) };
        own.field_player_colour = number(state.own_colour, of_own);
        opponent.field_player_colour = number(state.opponent_colour, of_opponent);
        if state.is_goalkeeper {
            own.goalkeeper = state.player;
        }
        let player = usize::from(state.player).checked_sub(1).and_then(|index| own.players.get_mut(index));
        if let Some(player) = player {
            // Any other number but 0 says no more than that there is a penalty.
            player.penalty = if state.is_penalised { state.penalty.max(1) } else { 0 };
            player.seconds_penalised = seconds(state.penalty_seconds).clamp(0, 255) as u8;
        }
        packet.players_per_team = packet.players_per_team.max(state.player);
    }
    packet
}

/// What a state says to all players.
fn tell_all(packet: &mut ControlPacket, state: &GameState) {
    packet.is_stopped = state.is_stopped;
    packet.phase = if state.is_penalty_shootout { Phase::PenaltyShootOut } else { Phase::Normal };
    packet.state = match state.state {
        GameState::READY => State::Ready,
        GameState::SET => State::Set,
        GameState::PLAYING => State::Playing,
        GameState::FINISHED => State::Finished,
        GameState::STANDBY => State::Standby,
        _ => State::Initial,
    };
    packet.set_play = match state.set_play {
        GameState::GOAL_KICK => SetPlay::GoalKick,
        GameState::CORNER_KICK => SetPlay::CornerKick,
        GameState::THROW_IN => SetPlay::ThrowIn,
        GameState::DIRECT_FREE_KICK => SetPlay::DirectFreeKick,
        GameState::INDIRECT_FREE_KICK => SetPlay::IndirectFreeKick,
        GameState::PENALTY_KICK => SetPlay::PenaltyKick,
        _ => SetPlay::None,
    };
    // Version 12 has no other field for who stands still.
    packet.set_play_stage = u8::from(packet.set_play != SetPlay::None && !state.is_stopped);
    packet.is_first_half = state.is_first_half;
    packet.kicking_team = match state.kick_team {
        GameState::OWN => Some(state.own_team),
        GameState::OPPONENT => Some(state.opponent_team),
        _ => None,
    };
    packet.seconds_remaining = seconds(state.seconds_remaining);
    packet.secondary_seconds = seconds(state.secondary_seconds);
}

/// Whole seconds, so that 0 is the end. A conversion to integers saturates.
fn seconds(time: f32) -> i16 {
    time.ceil() as i16
}

/// What a player says of itself, in the units of ROS.
fn team_message(answer: &Answer, now: Time) -> TeamMessage {
    let header = Header { stamp: Stamp::from_nanos(now.as_nanos()), frame_id: String::new() };
    match *answer {
        Answer::Alive { team, player, .. } => TeamMessage { header, team, player, ..TeamMessage::default() },
        Answer::Status { team, player, is_fallen, pose: [x, y, direction], ball_age, ball } => {
            let metres = |mm: f32| f64::from(mm) / 1000.0;
            let (x, y, direction) = (metres(x), metres(y), f64::from(direction));
            let [forward, left] = ball.map(metres);
            let (sin, cos) = libm::sincos(direction);
            let mut message = TeamMessage {
                header,
                team,
                player,
                state: if is_fallen { TeamMessage::FALLEN } else { TeamMessage::ACTIVE },
                sees_ball: ball_age >= 0.0,
                ball: Point { x: x + forward * cos - left * sin, y: y + forward * sin + left * cos, z: 0.0 },
                ball_age: ball_age.max(0.0),
                time_to_ball: f32::INFINITY,
                ..TeamMessage::default()
            };
            message.pose.pose.position = Point { x, y, z: 0.0 };
            let (z, w) = libm::sincos(direction / 2.0);
            message.pose.pose.orientation = Quaternion { x: 0.0, y: 0.0, z, w };
            message
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::game_controller::game_state;

    /// The state of a player of one of two teams in a corner kick of team 2, which defends the left goal.
    fn corner_kick(team: u8, player: u8) -> GameState {
        let is_second = team == 2;
        GameState {
            state: GameState::PLAYING,
            set_play: GameState::CORNER_KICK,
            kick_team: if is_second { GameState::OWN } else { GameState::OPPONENT },
            seconds_remaining: 211.0,
            secondary_seconds: 7.0,
            own_team: team,
            opponent_team: 3 - team,
            own_colour: if is_second { GameState::COLOUR_RED } else { GameState::COLOUR_BLUE },
            opponent_colour: if is_second { GameState::COLOUR_BLUE } else { GameState::COLOUR_RED },
            own_score: if is_second { 1 } else { 4 },
            opponent_score: if is_second { 4 } else { 1 },
            own_half_is_left: is_second,
            player,
            is_goalkeeper: player == 1,
            message_budget: 900,
            ..GameState::default()
        }
    }

    #[test]
    fn players_read_from_the_packet_what_the_referee_told_them() {
        let mut told: Vec<_> =
            [(1, 1), (1, 2), (2, 1), (2, 3)].map(|(team, player)| corner_kick(team, player)).into();
        told[1] = GameState { is_penalised: true, penalty: 5, penalty_seconds: 20.0, ..told[1].clone() };
        for version in [Version::Spl15, Version::Spl18, Version::Hsl19, Version::Hsl20] {
            let packet = control_packet(&told, version).unwrap();
            let heard = ControlPacket::parse(&packet.build()).unwrap();
            assert_eq!(heard.teams.each_ref().map(|team| team.number), [2, 1]);
            for state in &told {
                let read = game_state(&heard, state.own_team, state.player, Time::ZERO);
                assert_eq!(read.as_ref(), Some(state), "{version:?}");
            }
        }
        // Version 12 does not count team messages.
        let packet = control_packet(&told, Version::Humanoid12).unwrap();
        let heard = ControlPacket::parse(&packet.build()).unwrap();
        for state in &told {
            let read = game_state(&heard, state.own_team, state.player, Time::ZERO);
            assert_eq!(read, Some(GameState { message_budget: u16::MAX, ..state.clone() }));
        }
    }

    #[test]
    fn times_are_whole_seconds_that_end_at_zero() {
        let times = |seconds: f32| {
            let state = GameState {
                seconds_remaining: seconds,
                secondary_seconds: seconds,
                penalty_seconds: seconds,
                ..corner_kick(1, 1)
            };
            let packet = control_packet([&state], Version::Hsl20).unwrap();
            (packet.seconds_remaining, packet.secondary_seconds, packet.teams[1].players[0].seconds_penalised)
        };
        assert_eq!(times(0.1), (1, 1, 1));
        assert_eq!(times(0.0), (0, 0, 0));
        assert_eq!(times(1e9), (i16::MAX, i16::MAX, u8::MAX));
    }

    #[test]
    fn an_answer_is_turned_into_the_frame_of_the_field() {
        let answer = Answer::Status {
            team: 1,
            player: 2,
            is_fallen: true,
            pose: [1000.0, -500.0, std::f32::consts::FRAC_PI_2],
            ball_age: 0.5,
            ball: [2000.0, 1000.0],
        };
        let message = team_message(&answer, Time::ZERO);
        assert_eq!((message.team, message.player, message.state), (1, 2, TeamMessage::FALLEN));
        assert!(message.sees_ball && (message.ball_age - 0.5).abs() < 1e-6);
        assert!(message.ball.x.abs() < 1e-6 && (message.ball.y - 1.5).abs() < 1e-6, "{:?}", message.ball);
        let position = message.pose.pose.position;
        assert!((position.x - 1.0).abs() < 1e-6 && (position.y + 0.5).abs() < 1e-6);
    }
}
