//! The module of a match.

use crate::drill::Drill;
use crate::field_world::world_of;
use crate::game::{Event, Order, Phase, Seat, Team, Truth};
use crate::official::Official;
use crate::referee::{Referee, Rules};
use crate::statistics::Statistics;
use crate::team_radio::TeamRadio;
use downbeat_darwin_op::emulator::MemoryPorts;
use downbeat_executor::{
    Context, Job, JobError, Module, Publication, Received, Setting, SettingType, Setup, SetupError, Time,
    TransitionError,
};
use downbeat_football::Field;
use downbeat_football::football_interfaces::msg::{
    GameState, Kick, MatchState, MatchStatistics, TeamMessage,
};
use downbeat_football::soccer_model_msgs::msg::{Robot as OtherRobot, RobotArray};
use downbeat_football::soccer_vision_attribute_msgs::msg::Robot as RobotAttributes;
use downbeat_msgs::builtin_interfaces;
use downbeat_msgs::geometry_msgs::msg::{
    Point, PointStamped, Pose, PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped, Quaternion,
};
use downbeat_msgs::nav_msgs::msg::Odometry;
use downbeat_msgs::sensor_msgs::msg::{CameraInfo, Image};
use downbeat_msgs::std_msgs::msg::{Header, String as Text};
use downbeat_physics::camera::Camera;
use downbeat_physics::{
    Arena, ArenaOptions, ArenaRobot, ArenaSnapshot, Motion, Picture, RobotTruth, Variation,
};
use downbeat_transforms::Isometry;
use glam::{DQuat, DVec2, DVec3};
use serde_json::json;
use std::collections::VecDeque;
use std::f64::consts::PI;
use std::num::NonZeroUsize;
use std::panic::resume_unwind;
use std::path::PathBuf;
use std::thread;
use std::time::Duration;

/// A football field with a ball, robots and a referee. All data is simulated.
///
/// Each robot is behind a simulated bus at the port `memory:NAME`; its modules are in the namespace of its
/// name. All robots share one world and one clock. With `downbeat run --fast`, or `downbeat match`, the same
/// file gives the same match.
///
/// | topic | type | |
/// | --- | --- | --- |
/// | `match/state` | football_interfaces/MatchState | ten times a second: score, time and positions |
/// | `match/field` | std_msgs/String | the field as JSON, once every 2 s |
/// | `match/event` | std_msgs/String | at each event: time of the match, score and event |
/// | `match/kick` | football_interfaces/Kick | each kick, when it is known what became of it, see [`Statistics`] |
/// | `match/statistics` | football_interfaces/MatchStatistics | what each player did so far: at each event, and twice a second |
/// | `NAME/game_state` | football_interfaces/GameState | the state of the game for this robot: at each event, and twice a second |
/// | `NAME/ground_truth/odom` | nav_msgs/Odometry | the pose in `map`, in which the own goal is at -x; 50 times a second |
/// | `NAME/ground_truth/ball` | geometry_msgs/PoseStamped | the ball in the same frame |
/// | `NAME/ground_truth/robots` | soccer_model_msgs/RobotArray | the other robots in the same frame; 10 times a second |
/// | `NAME/camera/image_raw`, `NAME/camera/camera_info` | sensor_msgs/Image, CameraInfo | if `camera_hz` is not 0; published 30 ms after the exposure, with the exposure time as stamp |
/// | `NAME/team_status` (in), `NAME/team_messages` | football_interfaces/TeamMessage | the messages of a player to its team; each mate receives a message after 50 to 150 ms, unless it is lost; penalised players neither send nor receive |
///
/// | `match/place_ball` (in) | geometry_msgs/PointStamped | places the ball, in the frame of the world |
/// | `match/pick_up` (in) | std_msgs/String | the name of a robot that the referee picks up, as its team asks |
///
/// | setting | |
/// | --- | --- |
/// | `robots` | their names, such as `blue_1`: the team, blue or red, and the number; number 1 is the goalkeeper |
/// | `game` | `match`, or `empty_goal`: one robot shoots at an empty goal, in `tries` tries |
/// | `field` | a built-in field, or a file |
/// | `half_s`, `initial_s`, `ready_s` | the duration of a half while the ball is in play, and before it the time for which players stand, and that for them to take their positions, in s |
/// | `seed` | of all noise, of the robots' deviations from their description, and of the tries |
/// | `team_loss` | the share of team messages that are lost |
/// | `camera_hz` | pictures per second; 0 for none |
/// | `ports` | a folder for the ports of robots in other processes; empty: in memory |
///
/// A replay leaves the module out, because its messages are in the bag; with `--simulators` it runs again.
pub struct FootballMatch {
    memory: MemoryPorts,
    game: Option<Game>,
}

struct Game {
    arena: Arena,
    official: Official,
    field: Field,
    seats: Vec<Seat>,
    names: Vec<String>,
    began: Option<Time>,
    tell_at: Time,
    radio: TeamRadio,
    statistics: Statistics,
    /// Pictures that have not been delivered, in the order of their times: robot, time, pixels.
    pictures: VecDeque<(usize, Time, Vec<u8>)>,
    reported_left_out: Duration,
    /// When a robot that a drill put somewhere stands.
    stands_at: Option<Time>,
}

/// The keys of [`FootballMatch`].
pub struct Ports {
    state: Publication<MatchState>,
    field: Publication<Text>,
    event: Publication<Text>,
    kick: Publication<Kick>,
    statistics: Publication<MatchStatistics>,
    robots: Vec<RobotPorts>,
    pictures: Job<(Time, Vec<Rendered>)>,
}

struct RobotPorts {
    game_state: Publication<GameState>,
    odometry: Publication<Odometry>,
    ball: Publication<PoseStamped>,
    others: Publication<RobotArray>,
    team_messages: Publication<TeamMessage>,
    /// Where a drill puts it.
    initial_pose: Option<Publication<PoseWithCovarianceStamped>>,
    camera: Option<(Publication<Image>, Publication<CameraInfo>)>,
}

/// The period in which the world advances for robots in other processes.
const MOVE: Duration = Duration::from_millis(4);
/// The skipped time after which a warning is logged.
const LEFT_OUT: Duration = Duration::from_secs(1);
/// The period of the referee.
const LOOK: Duration = Duration::from_millis(100);
/// The longest interval between states of the game sent to players.
const TELL: Duration = Duration::from_millis(500);
const TRUTH: Duration = Duration::from_millis(20);
/// The delay from exposure to delivery, as of a USB camera.
const LATENCY: Duration = Duration::from_millis(30);
const DELIVER: Duration = Duration::from_millis(10);
const FIELD: Duration = Duration::from_secs(2);
/// How long a robot that a drill put somewhere needs to stand.
const STANDS_AFTER: Duration = Duration::from_millis(1500);
const MOST_ROBOTS: usize = 22;

impl FootballMatch {
    /// A match whose robots are among these ports in memory.
    #[must_use]
    pub fn new(memory: MemoryPorts) -> Self {
        Self { memory, game: None }
    }

    fn look(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        let Some(game) = &mut self.game else { return };
        game.arena.advance_to(now);
        let elapsed = now.saturating_since(*game.began.get_or_insert(now));
        let snapshot = game.arena.snapshot();
        let truth = truth_of(&snapshot);
        let (events, orders) = game.official.step(elapsed, &truth);
        for &order in &orders {
            match order {
                Order::Ball(at) => game.arena.place_ball(at.to_array()),
                Order::Robot { robot, position, heading } => {
                    game.arena.place_robot(robot, position.to_array(), heading);
                }
            }
        }
        let is_put =
            |event: &Event| matches!(event, Event::Phase(Phase::Playing) | Event::Goal(_) | Event::TimeUp);
        let is_put = events.iter().any(is_put);
        // Again when it stands, because to be turned by hand looks to it like a turn of its own.
        let stands = game.stands_at.take_if(|at| *at <= now).is_some();
        if is_put {
            game.stands_at = Some(now + STANDS_AFTER);
        }
        if is_put || stands {
            for robot in 0..game.seats.len() {
                if let Some(publication) = ctx.ports.robots[robot].initial_pose {
                    let (position, heading) = game.official.place_of(robot);
                    ctx.publish(publication, initial_pose(header(now, "map"), position, heading));
                }
            }
        }
        let state = game.official.match_state(&game.seats, elapsed);
        for event in &events {
            let (time, blue, red) = (elapsed.as_secs_f64(), state.blue_score, state.red_score);
            ctx.publish(ctx.ports.event, Text { data: format!("{time:.1} s  {blue}:{red}  {event}") });
        }
        if let Some((at, kick)) = game.statistics.step(elapsed, &truth, (&events, &orders), &state) {
            let header = header(now - elapsed.saturating_sub(at), "world");
            ctx.publish(ctx.ports.kick, Kick { header, ..kick });
        }
        let header = header(now, "map");
        // In real time, the timer is not exact.
        if !events.is_empty() || now + LOOK / 2 >= game.tell_at {
            game.tell_at = now + TELL;
            for robot in 0..game.seats.len() {
                let state = game.official.game_state(robot, elapsed);
                let publication = ctx.ports.robots[robot].game_state;
                ctx.publish(publication, GameState { header: header.clone(), ..state });
            }
            let statistics = MatchStatistics { header: header.clone(), ..game.statistics.message() };
            ctx.publish(ctx.ports.statistics, statistics);
        }
        for robot in 0..game.seats.len() {
            let others = RobotArray { header: header.clone(), robots: game.others_of(robot, &snapshot) };
            ctx.publish(ctx.ports.robots[robot].others, others);
        }
        let state = MatchState {
            header: Header { frame_id: "world".to_owned(), ..header },
            robots: game.names.clone(),
            poses: snapshot.robots.iter().map(|robot| pose_message(&robot.root.world_from_body)).collect(),
            ball: snapshot
                .ball
                .map_or_else(Point::default, |ball| pose_message(&ball.world_from_body).position),
            ..state
        };
        ctx.publish(ctx.ports.state, state);
    }

    /// Advances the world between the referee's steps, for robots in other processes.
    fn follow_the_clock(&mut self, ctx: &mut Context<'_, Ports>) {
        let Some(game) = &mut self.game else { return };
        game.arena.advance_to(ctx.now());
        let left_out = game.arena.left_out();
        if left_out >= game.reported_left_out + LEFT_OUT {
            game.reported_left_out = left_out;
            tracing::warn!("this machine is too slow: the world has stood still for {left_out:.1?} so far");
        }
    }

    fn tell_truth(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        let Some(game) = &self.game else { return };
        game.arena.advance_to(now);
        let snapshot = game.arena.snapshot();
        let header = header(now, "map");
        for (robot, truth) in snapshot.robots.iter().enumerate() {
            let defends_right = game.official.defends_right(game.seats[robot].team);
            let RobotPorts { odometry, ball, .. } = ctx.ports.robots[robot];
            let mut message = Odometry {
                header: header.clone(),
                child_frame_id: "base_link".to_owned(),
                ..Odometry::default()
            };
            message.pose.pose = seen_by_team(&truth.root, defends_right);
            ctx.publish(odometry, message);
            if let Some(motion) = &snapshot.ball {
                let pose = seen_by_team(motion, defends_right);
                ctx.publish(ball, PoseStamped { header: header.clone(), pose });
            }
        }
    }

    fn place_ball(&mut self, at: Received<'_, PointStamped>, _: &mut Context<'_, Ports>) {
        let Some(game) = &self.game else { return };
        let [x, y] = [at.point.x, at.point.y];
        if x.abs() <= game.field.length && y.abs() <= game.field.length {
            game.arena.place_ball([x, y]);
        } else {
            tracing::warn!("the ball cannot be placed at {x}, {y}: the place is not on the field");
        }
    }

    fn pick_up(&mut self, name: Received<'_, Text>, _: &mut Context<'_, Ports>) {
        let Some(game) = &mut self.game else { return };
        match game.names.iter().position(|known| *known == name.data) {
            Some(robot) => game.official.pick_up(robot),
            None => tracing::warn!("nobody is picked up: no robot \"{}\" plays", name.data.escape_debug()),
        }
    }

    fn tell_field(&mut self, ctx: &mut Context<'_, Ports>) {
        let Some(game) = &self.game else { return };
        ctx.publish(ctx.ports.field, Text { data: field_json(&game.field) });
    }

    /// Sends a message to the playing members of the team, under the number of the sender.
    fn relay(&mut self, robot: usize, message: &TeamMessage, ctx: &Context<'_, Ports>) {
        let Some(game) = &mut self.game else { return };
        let elapsed = ctx.now().saturating_since(game.began.unwrap_or(ctx.now()));
        let plays = |robot| !game.official.game_state(robot, elapsed).is_penalised;
        if !plays(robot) {
            return;
        }
        let Seat { team, number } = game.seats[robot];
        let message = TeamMessage { team: team.number(), player: number, ..message.clone() };
        let is_mate = |mate: &usize| *mate != robot && game.seats[*mate].team == team && plays(*mate);
        game.radio.send(&message, (0..game.seats.len()).filter(is_mate), ctx.now());
    }

    fn deliver_messages(&mut self, ctx: &mut Context<'_, Ports>) {
        let Some(game) = &mut self.game else { return };
        for (robot, message) in game.radio.arrived(ctx.now()) {
            ctx.publish(ctx.ports.robots[robot].team_messages, message);
        }
    }

    fn take_pictures(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        let Some(game) = &self.game else { return };
        game.arena.advance_to(now);
        let views = (0..game.seats.len()).filter_map(|robot| Some((robot, game.arena.picture(robot)?)));
        let views: Vec<_> = views.collect();
        ctx.spawn(ctx.ports.pictures, move || (now, rendered(&views)));
    }

    fn keep(&mut self, pictures: Result<(Time, Vec<Rendered>), JobError>, _: &mut Context<'_, Ports>) {
        match (pictures, &mut self.game) {
            (Ok((at, pictures)), Some(game)) => {
                game.pictures.extend(pictures.into_iter().map(|(robot, data)| (robot, at, data)));
            }
            (Err(error), _) => tracing::error!("pictures were not rendered: {error}"),
            (Ok(_), None) => {}
        }
    }

    fn deliver(&mut self, ctx: &mut Context<'_, Ports>) {
        let Some(game) = &mut self.game else { return };
        let now = ctx.now();
        let is_due = |(_, at, _): &(usize, Time, Vec<u8>)| now.saturating_since(*at) >= LATENCY;
        while game.pictures.front().is_some_and(is_due)
            && let Some((robot, at, data)) = game.pictures.pop_front()
        {
            let Some((image, info)) = ctx.ports.robots.get(robot).and_then(|robot| robot.camera) else {
                continue;
            };
            let Camera { width, height, .. } = Camera::darwin_op();
            let header = header(at, "camera_optical_frame");
            ctx.publish(info, Camera::darwin_op().info(header.clone()));
            let encoding = "rgb8".to_owned();
            let picture = Image { header, height, width, encoding, is_bigendian: 0, step: width * 3, data };
            ctx.publish(image, picture);
        }
    }
}

/// The picture of a robot, by its index.
type Rendered = (usize, Vec<u8>);

/// Renders pictures on all cores: in simulated time the executor waits for them.
fn rendered(views: &[(usize, Picture)]) -> Vec<Rendered> {
    let render = |(robot, view): &(usize, Picture)| (*robot, view.render(&Camera::darwin_op()));
    let cores = thread::available_parallelism().map_or(1, NonZeroUsize::get);
    let mut shares = views.chunks(views.len().div_ceil(cores).max(1));
    let first = shares.next().unwrap_or_default();
    thread::scope(|scope| {
        let others: Vec<_> =
            shares.map(|share| scope.spawn(move || share.iter().map(render).collect::<Vec<_>>())).collect();
        let mut pictures: Vec<_> = first.iter().map(render).collect();
        for other in others {
            pictures.extend(other.join().unwrap_or_else(|panic| resume_unwind(panic)));
        }
        pictures
    })
}

impl Game {
    /// The other robots, in the frame of this robot's team.
    fn others_of(&self, robot: usize, snapshot: &ArenaSnapshot) -> Vec<OtherRobot> {
        let own = self.seats[robot].team;
        let defends_right = self.official.defends_right(own);
        let others = self.seats.iter().zip(&snapshot.robots).enumerate().filter(|(other, _)| *other != robot);
        let seen = |(seat, truth): (&Seat, &RobotTruth)| {
            let mut other = OtherRobot::default();
            other.pose.pose = seen_by_team(&truth.root, defends_right);
            other.attributes = RobotAttributes {
                player_number: seat.number,
                team: if seat.team == own {
                    RobotAttributes::TEAM_OWN
                } else {
                    RobotAttributes::TEAM_OPPONENT
                },
                state: if is_upright(truth) {
                    RobotAttributes::STATE_STANDING
                } else {
                    RobotAttributes::STATE_FALLEN
                },
                ..RobotAttributes::default()
            };
            other
        };
        others.map(|(_, other)| seen(other)).collect()
    }
}

impl Module for FootballMatch {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let settings = Settings::declare(setup)?;
        let names = value(setup, settings.robots);
        let seats = seats(&names).map_err(|problem| setup.refuse_value(settings.robots, problem))?;
        let field = Field::named(&value(setup, settings.field))
            .map_err(|error| setup.refuse_value(settings.field, error.to_string()))?;
        // Negative seeds are valid.
        let seed = value(setup, settings.seed).cast_unsigned();
        let official = match value(setup, settings.game).as_str() {
            "empty_goal" if seats.len() != 1 => {
                return Err(
                    setup.refuse_value(settings.robots, "the game empty_goal needs exactly one robot")
                );
            }
            "empty_goal" => {
                let tries = u32::try_from(value(setup, settings.tries)).ok();
                let tries = tries.filter(|tries| (1..=100_000).contains(tries));
                let tries =
                    tries.ok_or_else(|| setup.refuse_value(settings.tries, "it has to be 1 to 100000"))?;
                Official::Drill(Box::new(Drill::new(field.clone(), seed, tries)))
            }
            _ => {
                let half = Duration::from_secs_f64(within(setup, settings.half_s, [1.0, 36_000.0])?);
                let ready = Duration::from_secs_f64(within(setup, settings.ready_s, [0.0, 600.0])?);
                let initial = Duration::from_secs_f64(within(setup, settings.initial_s, [0.0, 600.0])?);
                let rules = Rules { half, initial, ready, ..Rules::default() };
                Official::Referee(Box::new(Referee::new(field.clone(), rules, seats.clone())))
            }
        };
        let folder = value(setup, settings.ports);
        let robots = names.iter().zip(&seats).enumerate().map(|(robot, (name, seat))| {
            let (position, heading) = official.place_of(robot);
            let mut entrant = ArenaRobot::named(name);
            (entrant.start.position, entrant.start.yaw) = (position.to_array(), heading);
            entrant.seed = seed.wrapping_mul(1000).wrapping_add(robot as u64 + 1);
            entrant.variation = Variation::of_seed(entrant.seed);
            entrant.colour = match seat.team {
                Team::Blue => [30, 60, 200],
                Team::Red => [190, 30, 40],
            };
            entrant.link = (!folder.is_empty()).then(|| PathBuf::from(&folder).join(name));
            entrant
        });
        let mut options = ArenaOptions::darwin_op(robots);
        options.world = world_of(&field);
        let arena = Arena::new(options).map_err(|error| setup.refuse(error.to_string()))?;
        if folder.is_empty() {
            // Offered here and not in the activation, because hardware modules may open the port in the same
            // cycle.
            for (name, emulator) in names.iter().zip(arena.emulators()) {
                let offered = self.memory.offer(&format!("memory:{name}"), emulator);
                offered.map_err(|error| setup.refuse_value(settings.robots, error.to_string()))?;
            }
        }
        let radio = TeamRadio::new(seed, within(setup, settings.team_loss, [0.0, 1.0])?);
        setup.every(DELIVER, Self::deliver_messages)?;
        for (robot, name) in names.iter().enumerate() {
            let topic = format!("{name}/team_status");
            setup.subscribe(&topic, move |game: &mut Self, message: Received<'_, TeamMessage>, ctx| {
                game.relay(robot, &message, ctx);
            })?;
        }
        let camera_hz = within(setup, settings.camera_hz, [0.0, 100.0])?;
        if !folder.is_empty() {
            setup.every(MOVE, Self::follow_the_clock)?;
        }
        setup.every(LOOK, Self::look)?;
        setup.every(TRUTH, Self::tell_truth)?;
        setup.every(FIELD, Self::tell_field)?;
        if camera_hz > 0.0 {
            setup.every(Duration::from_secs_f64(1.0 / camera_hz), Self::take_pictures)?;
            setup.every(DELIVER, Self::deliver)?;
        }
        setup.subscribe("match/place_ball", Self::place_ball)?;
        setup.subscribe("match/pick_up", Self::pick_up)?;
        let robots = names.iter().map(|name| {
            let camera = match camera_hz > 0.0 {
                false => None,
                true => Some((
                    setup.publish(&format!("{name}/camera/image_raw"))?,
                    setup.publish(&format!("{name}/camera/camera_info"))?,
                )),
            };
            Ok(RobotPorts {
                game_state: setup.publish(&format!("{name}/game_state"))?,
                odometry: setup.publish(&format!("{name}/ground_truth/odom"))?,
                ball: setup.publish(&format!("{name}/ground_truth/ball"))?,
                others: setup.publish(&format!("{name}/ground_truth/robots"))?,
                team_messages: setup.publish(&format!("{name}/team_messages"))?,
                initial_pose: match &official {
                    Official::Drill(_) => Some(setup.publish(&format!("{name}/initialpose"))?),
                    Official::Referee(_) => None,
                },
                camera,
            })
        });
        let robots = robots.collect::<Result<_, SetupError>>()?;
        let statistics = Statistics::new(field.clone(), seats.clone(), &names);
        self.game = Some(Game {
            arena,
            official,
            field,
            seats,
            names,
            began: None,
            tell_at: Time::ZERO,
            radio,
            statistics,
            pictures: VecDeque::new(),
            reported_left_out: Duration::ZERO,
            stands_at: None,
        });
        Ok(Ports {
            state: setup.publish("match/state")?,
            field: setup.publish("match/field")?,
            event: setup.publish("match/event")?,
            kick: setup.publish("match/kick")?,
            statistics: setup.publish("match/statistics")?,
            robots,
            pictures: setup.job(Self::keep),
        })
    }

    fn activate(&mut self, ctx: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        self.tell_field(ctx);
        Ok(())
    }
}

struct Settings {
    robots: Setting<Vec<String>>,
    game: Setting<String>,
    tries: Setting<i64>,
    field: Setting<String>,
    half_s: Setting<f64>,
    initial_s: Setting<f64>,
    ready_s: Setting<f64>,
    seed: Setting<i64>,
    team_loss: Setting<f64>,
    camera_hz: Setting<f64>,
    ports: Setting<String>,
}

impl Settings {
    fn declare(setup: &mut Setup<'_, FootballMatch>) -> Result<Self, SetupError> {
        let two = ["blue_1", "red_1"].map(str::to_owned).to_vec();
        Ok(Self {
            robots: setup.read_only_setting("robots", two, "names: blue or red, _, number")?,
            game: setup.read_only_choice(
                "game",
                "match",
                &["match", "empty_goal"],
                "a match, or one robot that shoots at an empty goal",
            )?,
            tries: setup.read_only_setting("tries", 10, "1 to 100000; at an empty goal")?,
            field: setup.read_only_setting(
                "field",
                "kid_size_2013".to_owned(),
                "a built-in field, or a file",
            )?,
            half_s: setup.read_only_setting("half_s", 300.0, "s, 1 to 36000; duration of a half, in play")?,
            initial_s: setup.read_only_setting(
                "initial_s",
                6.0,
                "s, 0 to 600; for players to stand before a half, so that their gyroscopes settle",
            )?,
            ready_s: setup.read_only_setting(
                "ready_s",
                30.0,
                "s, 0 to 600; for players to walk to their positions",
            )?,
            seed: setup.read_only_setting("seed", 1, "same seed, same match")?,
            team_loss: setup.read_only_setting(
                "team_loss",
                0.05,
                "0 to 1; the share of team messages that do not arrive",
            )?,
            camera_hz: setup.read_only_setting("camera_hz", 0.0, "pictures per s, up to 100; 0: none")?,
            ports: setup.read_only_setting(
                "ports",
                String::new(),
                "a folder for ports of robots in other processes; empty: in memory",
            )?,
        })
    }
}

fn value<T: SettingType + Clone + Default>(setup: &Setup<'_, FootballMatch>, setting: Setting<T>) -> T {
    setup.value(setting).cloned().unwrap_or_default()
}

/// The value of a setting, if it is within this range.
fn within(
    setup: &Setup<'_, FootballMatch>,
    setting: Setting<f64>,
    [low, high]: [f64; 2],
) -> Result<f64, SetupError> {
    let number = value(setup, setting);
    if (low..=high).contains(&number) {
        return Ok(number);
    }
    Err(setup.refuse_value(setting, format!("it has to be {low} to {high}")))
}

/// The players denoted by the names of robots, as in the setting `robots`.
///
/// # Errors
/// A text that describes the invalid name.
pub fn seats(names: &[String]) -> Result<Vec<Seat>, String> {
    if names.is_empty() || names.len() > MOST_ROBOTS {
        return Err(format!("{} robots; 1 to {MOST_ROBOTS} can play", names.len()));
    }
    let mut seats = Vec::with_capacity(names.len());
    for name in names {
        let parts = name.rsplit_once('_').and_then(|(team, number)| {
            let team = match team {
                "blue" => Team::Blue,
                "red" => Team::Red,
                _ => return None,
            };
            Some(Seat { team, number: number.parse().ok().filter(|number| (1..=11).contains(number))? })
        });
        let seat = parts.ok_or_else(|| {
            format!("\"{name}\" is not the name of a player; names are blue_1 to blue_11 and red_1 to red_11")
        })?;
        if seats.contains(&seat) {
            return Err(format!("\"{name}\" is there twice"));
        }
        seats.push(seat);
    }
    Ok(seats)
}

/// The dimensions, lines and posts of a field, in m.
fn field_json(field: &Field) -> String {
    let lines: Vec<_> = field.lines().iter().map(|line| [line.from.to_array(), line.to.to_array()]).collect();
    let posts = field.posts().map(|post| post.to_array());
    json!({
        "name": field.name, "length": field.length, "width": field.width, "margin": field.margin,
        "line_width": field.line_width, "circle_diameter": field.circle_diameter, "lines": lines, "posts": posts,
        "marks": field.marks().map(|mark| mark.to_array()), "goal_depth": field.goal.depth,
        "ball_diameter": field.ball.diameter,
    })
    .to_string()
}

fn truth_of(snapshot: &ArenaSnapshot) -> Truth {
    let ball = snapshot.ball.map_or(DVec3::ZERO, |ball| ball.world_from_body.translation);
    let robot = |truth: &RobotTruth| (truth.root.world_from_body.translation.truncate(), is_upright(truth));
    Truth {
        ball: ball.truncate(),
        ball_height: ball.z,
        last_touch: snapshot.last_touch,
        robots: snapshot.robots.iter().map(robot).collect(),
    }
}

fn is_upright(truth: &RobotTruth) -> bool {
    (truth.root.world_from_body.rotation * DVec3::Z).z > 0.5
}

/// A pose in the frame in which the own goal is at -x.
fn seen_by_team(motion: &Motion, defends_right: bool) -> Pose {
    let turn = DQuat::from_rotation_z(if defends_right { PI } else { 0.0 });
    let Isometry { translation, rotation } = motion.world_from_body;
    pose_message(&Isometry { translation: turn * translation, rotation: turn * rotation })
}

fn pose_message(of: &Isometry) -> Pose {
    let (DVec3 { x, y, z }, rotation) = (of.translation, of.rotation);
    let orientation = Quaternion { x: rotation.x, y: rotation.y, z: rotation.z, w: rotation.w };
    Pose { position: Point { x, y, z }, orientation }
}

/// Where a drill puts a robot, about as well as a human would know it.
fn initial_pose(header: Header, position: DVec2, heading: f64) -> PoseWithCovarianceStamped {
    const VARIANCES: [f64; 2] = [0.09, 0.04];
    let orientation = DQuat::from_rotation_z(heading);
    let pose = pose_message(&Isometry { translation: position.extend(0.0), rotation: orientation });
    let mut covariance = [0.0; 36];
    [covariance[0], covariance[7], covariance[35]] = [VARIANCES[0], VARIANCES[0], VARIANCES[1]];
    PoseWithCovarianceStamped { header, pose: PoseWithCovariance { pose, covariance } }
}

fn header(at: Time, frame_id: &str) -> Header {
    Header { stamp: builtin_interfaces::msg::Time::from_nanos(at.as_nanos()), frame_id: frame_id.to_owned() }
}
