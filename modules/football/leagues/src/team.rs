//! Team messages of the humanoid league, and the module that exchanges them.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `team_status` (in) | football_interfaces/TeamMessage | what this player tells its team: the latest is sent, at most `rate` times a second |
//! | `game_state` (in) | football_interfaces/GameState | how many messages the team may still send |
//! | `team_messages` | football_interfaces/TeamMessage | what the team mates say, with the time of arrival |
//! | `datagrams` | downbeat_interfaces/BusExchange | all datagrams, for replays |
//!
//! Messages are Protobuf, `robocup.humanoid.Message` with the extensions of Bit-Bots for the time to the ball
//! (102) and the role (103). A few fields do not justify a code generator: [`encode`] and [`decode`] are
//! written by hand. What the league's message lacks travels as follows: a fallen player is `UNPENALISED`; the
//! ball counts as seen when it is sent, when it was sent.
//!
//! # References
//! - `robocup.proto` of RoboCup-Humanoid-TC/RobocupProtocol; its users in bit-bots/bitbots_main
//! - <https://protobuf.dev/programming-guides/encoding/>

use std::net::{SocketAddr, SocketAddrV4};
use std::time::Duration;

use downbeat_device::{Device, DeviceLink};
use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError, Time};
use downbeat_football::football_interfaces::msg::{GameState, SeenRobot, TeamMessage};
use downbeat_football::soccer_vision_attribute_msgs::msg::Robot as Attributes;
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::geometry_msgs::msg::{Point, Quaternion, Vector3};
use downbeat_network::mailbox::Mailbox;
use downbeat_network::udp::{Target, Udp, address_of};
use thiserror::Error;

/// How often the socket is polled.
const PERIOD: Duration = Duration::from_millis(20);
/// The longest message, in bytes, that the league allows (512); longer ones are ignored.
pub const LONGEST: usize = 512;

/// The bytes are not a team message.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DecodeError {
    /// Too long.
    #[error("a team message has at most {LONGEST} bytes, this one has {0}")]
    TooLong(usize),
    /// Not Protobuf.
    #[error("the datagram is no Protobuf: {0}")]
    Malformed(&'static str),
    /// Without it nobody knows who speaks.
    #[error("the team message has no player, or one beyond 255")]
    Player,
}

/// Encodes a message. The orientation travels as the angle about z.
#[must_use]
pub fn encode(message: &TeamMessage) -> Vec<u8> {
    let mut out = Vec::new();
    put(&mut out, 1, &{
        let mut time = Vec::new();
        put_number(&mut time, 1, u64::from(message.header.stamp.sec.max(0).unsigned_abs()));
        put_number(&mut time, 2, message.header.stamp.nanosec.into());
        time
    });
    let is_penalised = message.state == TeamMessage::PENALISED;
    put_number(&mut out, 2, if is_penalised { PENALISED } else { UNPENALISED });
    put(&mut out, 3, &{
        let mut robot = Vec::new();
        put_number(&mut robot, 1, message.player.into());
        let position = &message.pose.pose.position;
        put_vector(&mut robot, 2, [position.x, position.y, yaw_of(&message.pose.pose.orientation)]);
        let of = |row: usize, column: usize| message.pose.covariance[row * 6 + column];
        put_matrix(&mut robot, 3, [0, 1, 5].map(|row| [0, 1, 5].map(|column| of(row, column))));
        robot
    });
    if message.sees_ball {
        put(&mut out, 7, &{
            let mut ball = Vec::new();
            put_vector(&mut ball, 1, [message.ball.x, message.ball.y, message.ball.z]);
            let velocity = &message.ball_velocity;
            put_vector(&mut ball, 2, [velocity.x, velocity.y, velocity.z]);
            let variance = f64::from(message.ball_variance);
            put_matrix(&mut ball, 3, [[variance, 0.0, 0.0], [0.0, variance, 0.0], [0.0; 3]]);
            ball
        });
    }
    for other in message.others.iter().take(MOST_OTHERS) {
        put(&mut out, 8, &{
            let mut robot = Vec::new();
            put_number(&mut robot, 1, other.player_number.into());
            put_vector(&mut robot, 2, [f64::from(other.x), f64::from(other.y), 0.0]);
            // Only what is not zero: a message has to stay short.
            put(&mut robot, 3, &{
                let mut covariance = Vec::new();
                for (row, column) in [(1, 1), (2, 2)] {
                    let mut values = Vec::new();
                    put_float(&mut values, column, other.variance);
                    put(&mut covariance, row, &values);
                }
                covariance
            });
            put_number(&mut robot, 4, team_of(other.team, message.team));
            robot
        });
    }
    put_float(&mut out, TIME_TO_BALL, message.time_to_ball);
    put_number(
        &mut out,
        ROLE,
        match message.role {
            TeamMessage::STRIKER => 3,
            TeamMessage::SUPPORT => 4,
            TeamMessage::GOALKEEPER => 6,
            _ => 1,
        },
    );
    out
}

/// Decodes a message of a player of `team`; the number of the team is not in the messages. Unknown fields are
/// skipped.
///
/// # Errors
/// Returns an error if the bytes are not a Protobuf message, are too long, or name no player.
pub fn decode(bytes: &[u8], team: u8) -> Result<TeamMessage, DecodeError> {
    if bytes.len() > LONGEST {
        return Err(DecodeError::TooLong(bytes.len()));
    }
    let mut message = TeamMessage { team, time_to_ball: f32::INFINITY, ..TeamMessage::default() };
    let mut player = 0;
    each_field(bytes, |field, content| {
        match (field, content) {
            (1, Content::Bytes(time)) => each_field(time, |field, content| {
                match (field, content) {
                    (1, Content::Number(sec)) => message.header.stamp.sec = i32::try_from(sec).unwrap_or(0),
                    (2, Content::Number(nanosec)) => {
                        message.header.stamp.nanosec = u32::try_from(nanosec).unwrap_or(0).min(999_999_999);
                    }
                    _ => {}
                }
                Ok(())
            })?,
            (2, Content::Number(state)) => {
                message.state = if state == PENALISED { TeamMessage::PENALISED } else { TeamMessage::ACTIVE };
            }
            (3, Content::Bytes(robot)) => each_field(robot, |field, content| {
                match (field, content) {
                    (1, Content::Number(number)) => player = number,
                    (2, Content::Bytes(position)) => {
                        let [x, y, yaw] = vector(position)?;
                        let (sin, cos) = libm::sincos(yaw / 2.0);
                        message.pose.pose.position = Point { x, y, z: 0.0 };
                        message.pose.pose.orientation = Quaternion { x: 0.0, y: 0.0, z: sin, w: cos };
                    }
                    (3, Content::Bytes(covariance)) => {
                        let rows = matrix(covariance)?;
                        for (row, values) in [0, 1, 5].into_iter().zip(rows) {
                            for (column, value) in [0, 1, 5].into_iter().zip(values) {
                                message.pose.covariance[row * 6 + column] = value;
                            }
                        }
                    }
                    _ => {}
                }
                Ok(())
            })?,
            (7, Content::Bytes(ball)) => {
                message.sees_ball = true;
                each_field(ball, |field, content| {
                    match (field, content) {
                        (1, Content::Bytes(position)) => {
                            let [x, y, z] = vector(position)?;
                            message.ball = Point { x, y, z };
                        }
                        (2, Content::Bytes(velocity)) => {
                            let [x, y, z] = vector(velocity)?;
                            message.ball_velocity = Vector3 { x, y, z };
                        }
                        (3, Content::Bytes(covariance)) => {
                            message.ball_variance = matrix(covariance)?[0][0] as f32;
                        }
                        _ => {}
                    }
                    Ok(())
                })?;
            }
            (8, Content::Bytes(robot)) if message.others.len() < MOST_OTHERS => {
                let mut other = SeenRobot::default();
                each_field(robot, |field, content| {
                    match (field, content) {
                        (1, Content::Number(number)) => {
                            other.player_number = u8::try_from(number).unwrap_or(0)
                        }
                        (2, Content::Bytes(position)) => {
                            [other.x, other.y, _] = vector(position)?.map(|number| number as f32);
                        }
                        (3, Content::Bytes(covariance)) => other.variance = matrix(covariance)?[0][0] as f32,
                        (4, Content::Number(colour)) => other.team = relation_of(colour, team),
                        _ => {}
                    }
                    Ok(())
                })?;
                message.others.push(other);
            }
            (TIME_TO_BALL, Content::Float(seconds)) => message.time_to_ball = seconds,
            (ROLE, Content::Number(role)) => {
                message.role = match role {
                    3 => TeamMessage::STRIKER,
                    4 | 5 => TeamMessage::SUPPORT,
                    6 => TeamMessage::GOALKEEPER,
                    _ => TeamMessage::IDLE,
                };
            }
            _ => {}
        }
        Ok(())
    })?;
    message.player = u8::try_from(player).ok().filter(|player| *player > 0).ok_or(DecodeError::Player)?;
    Ok(message)
}

/// The most other robots in a message: so it stays shorter than [`LONGEST`].
const MOST_OTHERS: usize = 6;
/// The colours of teams. The league's message knows no others, and gives no numbers to teams: team 1 counts
/// as blue, as in the simulated match, and all other teams as red.
const BLUE: u64 = 1;
const RED: u64 = 2;
const UNPENALISED: u64 = 1;
const PENALISED: u64 = 2;
const TIME_TO_BALL: u64 = 102;
const ROLE: u64 = 103;

/// The colour of a seen robot's team, for a player of this team.
fn team_of(relation: u8, own: u8) -> u64 {
    let [own, opponent] = if own == 1 { [BLUE, RED] } else { [RED, BLUE] };
    match relation {
        Attributes::TEAM_OWN => own,
        Attributes::TEAM_OPPONENT => opponent,
        _ => 0,
    }
}

/// The inverse of [`team_of`].
fn relation_of(colour: u64, own: u8) -> u8 {
    match colour {
        BLUE | RED if (colour == BLUE) == (own == 1) => Attributes::TEAM_OWN,
        BLUE | RED => Attributes::TEAM_OPPONENT,
        _ => Attributes::TEAM_UNKNOWN,
    }
}

fn yaw_of(q: &Quaternion) -> f64 {
    libm::atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
}

enum Content<'a> {
    Number(u64),
    Bytes(&'a [u8]),
    Float(f32),
    Other,
}

fn each_field<'a>(
    mut bytes: &'a [u8],
    mut take: impl FnMut(u64, Content<'a>) -> Result<(), DecodeError>,
) -> Result<(), DecodeError> {
    const CUT_OFF: DecodeError = DecodeError::Malformed("it is cut off");
    while !bytes.is_empty() {
        let tag = varint(&mut bytes)?;
        let content = match tag & 7 {
            0 => Content::Number(varint(&mut bytes)?),
            1 => {
                bytes = bytes.get(8..).ok_or(CUT_OFF)?;
                Content::Other
            }
            2 => {
                let length = usize::try_from(varint(&mut bytes)?).map_err(|_| CUT_OFF)?;
                let (content, rest) = bytes.split_at_checked(length).ok_or(CUT_OFF)?;
                bytes = rest;
                Content::Bytes(content)
            }
            5 => {
                let (content, rest) = bytes.split_first_chunk().ok_or(CUT_OFF)?;
                bytes = rest;
                Content::Float(f32::from_le_bytes(*content))
            }
            _ => return Err(DecodeError::Malformed("it has a field of an unknown wire type")),
        };
        take(tag >> 3, content)?;
    }
    Ok(())
}

fn varint(bytes: &mut &[u8]) -> Result<u64, DecodeError> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let (byte, rest) = bytes.split_first().ok_or(DecodeError::Malformed("it is cut off"))?;
        *bytes = rest;
        value |= u64::from(byte & 0x7f) << shift;
        if *byte < 0x80 {
            return Ok(value);
        }
    }
    Err(DecodeError::Malformed("a varint has more than ten bytes"))
}

/// Three numbers; those that are not finite are zero.
fn vector(bytes: &[u8]) -> Result<[f64; 3], DecodeError> {
    let mut numbers = [0.0; 3];
    each_field(bytes, |field, content| {
        if let (1..=3, Content::Float(number)) = (field, content)
            && number.is_finite()
            && let Some(place) = numbers.get_mut(field as usize - 1)
        {
            *place = f64::from(number);
        }
        Ok(())
    })?;
    Ok(numbers)
}

fn matrix(bytes: &[u8]) -> Result<[[f64; 3]; 3], DecodeError> {
    let mut rows = [[0.0; 3]; 3];
    each_field(bytes, |field, content| {
        if let (1..=3, Content::Bytes(row)) = (field, content)
            && let Some(place) = rows.get_mut(field as usize - 1)
        {
            *place = vector(row)?;
        }
        Ok(())
    })?;
    Ok(rows)
}

fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

fn put_number(out: &mut Vec<u8>, field: u64, value: u64) {
    put_varint(out, field << 3);
    put_varint(out, value);
}

fn put_float(out: &mut Vec<u8>, field: u64, value: f32) {
    put_varint(out, field << 3 | 5);
    out.extend(value.to_le_bytes());
}

fn put(out: &mut Vec<u8>, field: u64, content: &[u8]) {
    put_varint(out, field << 3 | 2);
    put_varint(out, content.len() as u64);
    out.extend(content);
}

fn put_vector(out: &mut Vec<u8>, field: u64, numbers: [f64; 3]) {
    let mut content = Vec::new();
    for (field, number) in (1..).zip(numbers) {
        put_float(&mut content, field, number as f32);
    }
    put(out, field, &content);
}

fn put_matrix(out: &mut Vec<u8>, field: u64, rows: [[f64; 3]; 3]) {
    let mut content = Vec::new();
    for (field, row) in (1..).zip(rows) {
        put_vector(&mut content, field, row);
    }
    put(out, field, &content);
}

/// The module. Run it detached.
pub struct TeamCommunication {
    mailbox: Mailbox<Udp>,
    team: u8,
    player: u8,
    waiting: Option<TeamMessage>,
    sent: Option<Time>,
    /// What the referee says that is left for the team.
    budget: u16,
    complaint: String,
}

/// The ports of [`TeamCommunication`].
pub struct Ports {
    team_messages: Publication<TeamMessage>,
    datagrams: Publication<BusExchange>,
    rate: Setting<f64>,
    reserve: Setting<i64>,
}

impl Module for TeamCommunication {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let team = setup.read_only_setting("team", 1_i64, "the number of the own team, 1 to 254")?;
        let player = setup.read_only_setting("player", 1_i64, "the number of this player, 1 to 20")?;
        let port = setup.read_only_setting("port", 0_i64, "the UDP port of the team; 0 for 10000 + team")?;
        let address = setup.read_only_setting(
            "address",
            "0.0.0.0".to_owned(),
            "the own address on which it receives; 0.0.0.0 for all",
        )?;
        let to = setup.read_only_setting(
            "to",
            "255.255.255.255".to_owned(),
            "the address to which messages go: one of broadcast, or one machine",
        )?;
        let rate =
            setup.setting_in("rate", 10.0, 0.1..=10.0, "the most messages it sends in a second (Hz)")?;
        let reserve = setup.setting_in(
            "reserve",
            100_i64,
            0.0..=65535.0,
            "the rest of the team's message budget that it does not use",
        )?;
        let number = |setup: &Setup<'_, Self>, setting, range: std::ops::RangeInclusive<i64>| {
            let value = setup.value(setting).copied().unwrap_or_default();
            let outside = || format!("{value} is not between {} and {}", range.start(), range.end());
            if range.contains(&value) { Ok(value) } else { Err(setup.refuse_value(setting, outside())) }
        };
        self.team = number(setup, team, 1..=254)? as u8;
        self.player = number(setup, player, 1..=20)? as u8;
        let port = match number(setup, port, 0..=65535)? as u16 {
            0 => 10_000 + u16::from(self.team),
            port => port,
        };
        let target = Target::Address(SocketAddr::from((address_of(setup, to)?, port)));
        let own = address_of(setup, address)?;
        if let Some(udp) = self.mailbox.device() {
            udp.configure(SocketAddrV4::new(own, port), target);
        }
        setup.subscribe("team_status", |module, status: Received<'_, TeamMessage>, _| {
            module.waiting = Some(status.clone());
        })?;
        setup.subscribe("game_state", |module, state: Received<'_, GameState>, _| {
            module.budget = state.message_budget;
        })?;
        setup.every(PERIOD, Self::run)?;
        Ok(Ports {
            team_messages: setup.publish("team_messages")?,
            datagrams: setup.publish(Udp::TOPIC)?,
            rate,
            reserve,
        })
    }
}

impl TeamCommunication {
    /// A module that speaks on this link.
    #[must_use]
    pub fn new(link: DeviceLink<Udp>) -> Self {
        Self {
            mailbox: Mailbox::new(link),
            team: 0,
            player: 0,
            waiting: None,
            sent: None,
            budget: u16::MAX,
            complaint: String::new(),
        }
    }

    fn run(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        for datagram in self.mailbox.receive(ctx.ports.datagrams, ctx) {
            match decode(&datagram, self.team) {
                // Broadcasts come back.
                Ok(message) if message.player == self.player => {}
                Ok(mut message) => {
                    // Clocks of other robots differ.
                    message.header.stamp = Stamp::from_nanos(now.as_nanos());
                    ctx.publish(ctx.ports.team_messages, message);
                }
                Err(error) => {
                    let complaint = error.to_string();
                    if self.complaint != complaint {
                        tracing::warn!("a team message was ignored: {complaint}");
                        self.complaint = complaint;
                    }
                }
            }
        }
        let period = Duration::from_secs_f64(1.0 / ctx.get(ctx.ports.rate).clamp(0.1, 10.0));
        let is_due = self.sent.is_none_or(|sent| now.saturating_since(sent) >= period);
        let has_budget = i64::from(self.budget) > *ctx.get(ctx.ports.reserve);
        if is_due
            && has_budget
            && let Some(message) = self.waiting.take()
        {
            self.sent = Some(now);
            // The league counts for the whole team; until it says so, this player counts its own.
            self.budget = if self.budget == u16::MAX { u16::MAX } else { self.budget - 1 };
            let message = TeamMessage { team: self.team, player: self.player, ..message };
            self.mailbox.send(encode(&message), ctx.ports.datagrams, ctx);
        }
    }
}
