//! Listens to the referee's program (GameController), and answers it.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `game_state` | football_interfaces/GameState | what the referee says, for this player of this team, with each packet |
//! | `team_status` (in) | football_interfaces/TeamMessage | where this player is and what it sees, for the answer |
//! | `datagrams` | downbeat_interfaces/BusExchange | all datagrams, for replays |
//!
//! Packets of another version, of other teams or of another length are ignored, and reported when they are
//! first seen. Run the module detached.

use std::net::SocketAddrV4;
use std::time::Duration;

use downbeat_device::{Device, DeviceLink};
use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError, Time};
use downbeat_football::football_interfaces::msg::{GameState, TeamMessage};
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::std_msgs::msg::Header;
use downbeat_network::mailbox::Mailbox;
use downbeat_network::udp::{Target, Udp, address_of};

use crate::packets::{ANSWER_PORT, Answer, CONTROL_PORT, ControlPacket, Phase, SetPlay, State, Version};

/// How often the socket is polled.
const PERIOD: Duration = Duration::from_millis(20);
/// Without a packet for so long, the referee counts as gone.
const LOST_AFTER: Duration = Duration::from_secs(5);

/// The module.
pub struct GameController {
    mailbox: Mailbox<Udp>,
    team: u8,
    player: u8,
    is_answering: bool,
    status: Option<TeamMessage>,
    /// When the last packet came, and its version.
    heard: Option<(Time, Version)>,
    answered: Option<Time>,
    complaint: String,
}

/// The ports of [`GameController`].
pub struct Ports {
    game_state: Publication<GameState>,
    datagrams: Publication<BusExchange>,
    answer_rate: Setting<f64>,
}

impl Module for GameController {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let team = setup.read_only_setting("team", 1_i64, "the number of the own team, 1 to 254")?;
        let player = setup.read_only_setting("player", 1_i64, "the number of this player, 1 to 20")?;
        let port = setup.read_only_setting(
            "port",
            i64::from(CONTROL_PORT),
            "the UDP port of the referee's packets",
        )?;
        let address = setup.read_only_setting(
            "address",
            "0.0.0.0".to_owned(),
            "the own address on which it receives; 0.0.0.0 for all",
        )?;
        let answer_port = setup.read_only_setting(
            "answer_port",
            i64::from(ANSWER_PORT),
            "the UDP port for answers; 0 for none",
        )?;
        let answer_rate = setup.setting_in("answer_rate", 1.0, 0.5..=2.0, "how often it answers (Hz)")?;
        let number = |setup: &Setup<'_, Self>, setting, range: std::ops::RangeInclusive<i64>| {
            let value = setup.value(setting).copied().unwrap_or_default();
            let outside = || format!("{value} is not between {} and {}", range.start(), range.end());
            if range.contains(&value) { Ok(value) } else { Err(setup.refuse_value(setting, outside())) }
        };
        self.team = number(setup, team, 1..=254)? as u8;
        self.player = number(setup, player, 1..=20)? as u8;
        let port = number(setup, port, 1..=65535)? as u16;
        let answer_port = number(setup, answer_port, 0..=65535)? as u16;
        self.is_answering = answer_port != 0;
        let target = Target::LastSender { port: answer_port, prefix: *b"RGme" };
        let own = address_of(setup, address)?;
        if let Some(udp) = self.mailbox.device() {
            udp.configure(SocketAddrV4::new(own, port), target);
        }
        setup.subscribe("team_status", |module, status: Received<'_, TeamMessage>, _| {
            module.status = Some(status.clone());
        })?;
        setup.every(PERIOD, Self::listen)?;
        Ok(Ports {
            game_state: setup.publish("game_state")?,
            datagrams: setup.publish(Udp::TOPIC)?,
            answer_rate,
        })
    }
}

impl GameController {
    /// A module that listens on this link.
    #[must_use]
    pub fn new(link: DeviceLink<Udp>) -> Self {
        Self {
            mailbox: Mailbox::new(link),
            team: 0,
            player: 0,
            is_answering: false,
            status: None,
            heard: None,
            answered: None,
            complaint: String::new(),
        }
    }

    fn listen(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        for datagram in self.mailbox.receive(ctx.ports.datagrams, ctx) {
            match ControlPacket::parse(&datagram) {
                Ok(packet) => match game_state(&packet, self.team, self.player, now) {
                    Some(state) => {
                        self.heard = Some((now, packet.version));
                        self.complaint.clear();
                        ctx.publish(ctx.ports.game_state, state);
                    }
                    None => {
                        let [first, second] = packet.teams.map(|team| team.number);
                        self.complain(format!(
                            "the referee plays teams {first} and {second}: if one of them is this robot's, set `team`, now {}",
                            self.team
                        ));
                    }
                },
                Err(error) => self.complain(error.to_string()),
            }
        }
        let Some((heard, version)) = self.heard else { return };
        if now.saturating_since(heard) > LOST_AFTER {
            tracing::warn!("no packet of the referee for {LOST_AFTER:?}: the last game state still holds");
            self.heard = None;
            return;
        }
        let period = Duration::from_secs_f64(1.0 / ctx.get(ctx.ports.answer_rate).clamp(0.5, 2.0));
        let is_due = self.answered.is_none_or(|answered| now.saturating_since(answered) >= period);
        if self.is_answering && is_due {
            self.answered = Some(now);
            self.mailbox.send(self.answer(version, now).build(), ctx.ports.datagrams, ctx);
        }
    }

    fn answer(&self, version: Version, now: Time) -> Answer {
        let (team, player) = (self.team, self.player);
        if version == Version::Humanoid12 {
            return Answer::Alive { team, player, message: Answer::ALIVE };
        }
        let Some(status) = &self.status else {
            return Answer::Status {
                team,
                player,
                is_fallen: false,
                pose: [0.0; 3],
                ball_age: -1.0,
                ball: [0.0; 2],
            };
        };
        let position = &status.pose.pose.position;
        let q = &status.pose.pose.orientation;
        let direction = libm::atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z));
        let (sin, cos) = libm::sincos(direction);
        let (x, y) = (status.ball.x - position.x, status.ball.y - position.y);
        let mm = |metres: f64| (metres * 1000.0) as f32;
        let age = now.as_nanos().saturating_sub(status.header.stamp.as_nanos()).max(0) as f32 / 1e9;
        Answer::Status {
            team,
            player,
            is_fallen: status.state == TeamMessage::FALLEN,
            pose: [mm(position.x), mm(position.y), direction as f32],
            ball_age: if status.sees_ball { status.ball_age + age } else { -1.0 },
            ball: if status.sees_ball { [mm(x * cos + y * sin), mm(y * cos - x * sin)] } else { [0.0; 2] },
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

/// What a packet means for a player; `None` if its team does not play.
#[must_use]
pub fn game_state(packet: &ControlPacket, team: u8, player: u8, now: Time) -> Option<GameState> {
    let index = packet.teams.iter().position(|each| each.number == team)?;
    let [first, second] = &packet.teams;
    let (own, opponent) = if index == 0 { (first, second) } else { (second, first) };
    let this = own.players.get(usize::from(player).checked_sub(1)?)?;
    // Version 12 has no field for it: players freeze in the first and last stage of a set play.
    let is_frozen = packet.version == Version::Humanoid12
        && packet.set_play != SetPlay::None
        && packet.set_play_stage != 1;
    let kick_team = match packet.kicking_team {
        Some(kicking) if kicking == own.number => GameState::OWN,
        Some(kicking) if kicking == opponent.number => GameState::OPPONENT,
        _ => GameState::NEITHER,
    };
    Some(GameState {
        header: Header { stamp: Stamp::from_nanos(now.as_nanos()), ..Header::default() },
        state: match packet.state {
            State::Initial => GameState::INITIAL,
            State::Ready => GameState::READY,
            State::Set => GameState::SET,
            State::Playing => GameState::PLAYING,
            State::Finished => GameState::FINISHED,
            State::Standby => GameState::STANDBY,
        },
        set_play: match packet.set_play {
            SetPlay::None => GameState::NO_SET_PLAY,
            SetPlay::GoalKick => GameState::GOAL_KICK,
            SetPlay::CornerKick => GameState::CORNER_KICK,
            SetPlay::ThrowIn => GameState::THROW_IN,
            SetPlay::DirectFreeKick => GameState::DIRECT_FREE_KICK,
            SetPlay::IndirectFreeKick => GameState::INDIRECT_FREE_KICK,
            SetPlay::PenaltyKick => GameState::PENALTY_KICK,
        },
        is_stopped: packet.is_stopped || packet.phase == Phase::TimeOut || is_frozen,
        is_first_half: packet.is_first_half,
        is_penalty_shootout: packet.phase == Phase::PenaltyShootOut,
        kick_team,
        seconds_remaining: packet.seconds_remaining.into(),
        secondary_seconds: packet.secondary_seconds.into(),
        own_team: own.number,
        opponent_team: opponent.number,
        own_colour: colour(own.field_player_colour),
        opponent_colour: colour(opponent.field_player_colour),
        own_score: own.score,
        opponent_score: opponent.score,
        own_half_is_left: index == 0,
        player,
        is_goalkeeper: own.goalkeeper == player,
        is_penalised: this.penalty != 0,
        penalty: this.penalty,
        penalty_seconds: this.seconds_penalised.into(),
        message_budget: own.message_budget.unwrap_or(u16::MAX),
    })
}

/// A colour as the headers of the leagues number it.
fn colour(number: u8) -> u8 {
    match number {
        0 => GameState::COLOUR_BLUE,
        1 => GameState::COLOUR_RED,
        _ => GameState::COLOUR_UNKNOWN,
    }
}
