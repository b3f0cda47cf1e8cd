//! Two players of a team in a core; each sees a part of the field and receives the messages of the other.
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat_executor::{Clock as _, Core, Inbox, Inlet, ManualClock, ModuleOptions, Received, Time};
use downbeat_football::football_interfaces::msg::{GameState, TeamMessage, TeamReport};
use downbeat_football::soccer_model_msgs::msg::{Ball, Robot, RobotArray};
use downbeat_football::soccer_vision_attribute_msgs::msg::Robot as Attributes;
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::diagnostic_msgs::msg::DiagnosticArray;
use downbeat_msgs::geometry_msgs::msg::PoseWithCovarianceStamped;
use downbeat_msgs::std_msgs::msg::{String as Text, UInt8};
use downbeat_player::team::Team;
use std::sync::{Arc, Mutex};
use std::time::Duration;

#[derive(Default)]
struct Heard {
    balls: Vec<Ball>,
    robots: Vec<RobotArray>,
    reports: Vec<TeamReport>,
    statuses: Vec<TeamMessage>,
    diagnostics: Vec<DiagnosticArray>,
}

struct Player {
    core: Core,
    clock: ManualClock,
    heard: Arc<Mutex<Heard>>,
    poses: Inlet<PoseWithCovarianceStamped>,
    balls: Inlet<Ball>,
    robots: Inlet<RobotArray>,
    games: Inlet<GameState>,
    states: Inlet<Text>,
    roles: Inlet<UInt8>,
    messages: Inlet<TeamMessage>,
    at: [f64; 2],
}

impl Player {
    /// Player 2 of team 1, at a place, facing the opponents' goal.
    fn at(x: f64, y: f64) -> Self {
        let clock = ManualClock::new(Time::from_nanos(1_000_000_000));
        let mut core = Core::new().with_clock(clock.clone());
        core.add_with("team", Team::default(), ModuleOptions::default()).unwrap();
        let heard = Arc::<Mutex<Heard>>::default();
        macro_rules! hear {
            ($topic:literal, $field:ident, $kind:ty) => {
                let sink = Arc::clone(&heard);
                let hear =
                    move |message: Received<'_, $kind>| sink.lock().unwrap().$field.push(message.clone());
                core.outlet($topic, Inbox::KeepAll, hear).unwrap().keep();
            };
        }
        hear!("team/ball", balls, Ball);
        hear!("team/robots", robots, RobotArray);
        hear!("team/report", reports, TeamReport);
        hear!("team_status", statuses, TeamMessage);
        hear!("diagnostics", diagnostics, DiagnosticArray);
        let player = Self {
            poses: core.inlet("pose").unwrap(),
            balls: core.inlet("ball").unwrap(),
            robots: core.inlet("robots").unwrap(),
            games: core.inlet("game_state").unwrap(),
            states: core.inlet("robot_state").unwrap(),
            roles: core.inlet("team/role").unwrap(),
            messages: core.inlet("team_messages").unwrap(),
            core,
            clock,
            heard,
            at: [x, y],
        };
        player.plays(u16::MAX, false);
        player
    }

    fn plays(&self, message_budget: u16, is_penalised: bool) {
        let game = GameState {
            state: GameState::PLAYING,
            own_team: 1,
            player: 2,
            seconds_remaining: 60.0,
            message_budget,
            is_penalised,
            ..GameState::default()
        };
        self.games.publish(game).unwrap();
    }

    /// Runs for this number of tenths of a second, and returns the messages published meanwhile.
    fn run(&mut self, tenths: u32) -> Heard {
        for _ in 0..tenths {
            let mut pose = PoseWithCovarianceStamped::default();
            [pose.pose.pose.position.x, pose.pose.pose.position.y] = self.at;
            pose.pose.pose.orientation.w = 1.0;
            self.poses.publish(pose).unwrap();
            self.clock.advance(Duration::from_millis(100));
            let now = self.clock.now();
            while self.core.next_event().is_some_and(|next| next <= now) {
                self.core.cycle().unwrap();
            }
        }
        std::mem::take(&mut *self.heard.lock().unwrap())
    }

    fn sees_ball(&self, x: f64, y: f64, variance: f64) {
        let mut ball = Ball::default();
        (ball.point.point.x, ball.point.point.y) = (x, y);
        (ball.point.covariance[0], ball.point.covariance[4]) = (variance, variance);
        self.balls.publish(ball).unwrap();
    }

    fn sees_robots(&self, robots: &[(f64, f64, u8)]) {
        let robot = |(x, y, team): &(f64, f64, u8)| {
            let mut robot = Robot::default();
            (robot.pose.pose.position.x, robot.pose.pose.position.y) = (*x, *y);
            robot.attributes.team = *team;
            robot
        };
        let robots = robots.iter().map(robot).collect();
        self.robots.publish(RobotArray { robots, ..RobotArray::default() }).unwrap();
    }

    /// A message of player 3 at a place, sent now.
    fn message(&self, x: f64, y: f64) -> TeamMessage {
        let mut message = TeamMessage { team: 1, player: 3, time_to_ball: 5.0, ..TeamMessage::default() };
        message.header.stamp = Stamp::from_nanos(self.clock.now().as_nanos());
        (message.pose.pose.position.x, message.pose.pose.position.y) = (x, y);
        message.pose.pose.orientation.w = 1.0;
        message
    }
}

#[test]
fn a_player_tells_where_it_is_what_it_sees_and_when_it_could_have_the_ball() {
    let mut player = Player::at(-1.0, 0.0);
    player.roles.publish(UInt8 { data: TeamMessage::STRIKER }).unwrap();
    player.sees_robots(&[(2.0, 0.0, Attributes::TEAM_OPPONENT), (0.0, 0.5, Attributes::TEAM_OWN)]);
    player.sees_ball(0.0, 0.0, 0.01);
    let told = player.run(10).statuses;
    assert_eq!(told.len(), 5, "five times a second");
    let last = told.last().unwrap();
    assert_eq!(
        (last.team, last.player, last.state, last.role),
        (1, 2, TeamMessage::ACTIVE, TeamMessage::STRIKER)
    );
    assert_eq!((last.pose.pose.position.x, last.sees_ball), (-1.0, true));
    // The ball is one metre straight ahead.
    assert!((9.0..11.0).contains(&last.time_to_ball), "{}", last.time_to_ball);
    let others: Vec<(f32, u8)> = told[0].others.iter().map(|other| (other.x, other.team)).collect();
    assert_eq!(others, [(0.0, 1), (2.0, 2)], "the nearest first");

    player.states.publish(Text { data: "fallen".to_owned() }).unwrap();
    player.sees_ball(0.0, 0.0, 0.01);
    let told = player.run(2).statuses;
    assert_eq!(told[0].state, TeamMessage::FALLEN);
    assert!(told[0].time_to_ball > 15.0);
    player.plays(u16::MAX, true);
    let told = player.run(3).statuses;
    assert_eq!((told[0].state, told[0].time_to_ball), (TeamMessage::PENALISED, f32::INFINITY));
}

#[test]
fn the_own_ball_goes_on_at_once_and_that_of_a_mate_stands_in() {
    let mut player = Player::at(-1.0, 0.0);
    player.sees_ball(0.5, 0.0, 0.01);
    let balls = player.run(1).balls;
    assert_eq!((balls.len(), balls[0].point.point.x), (1, 0.5));
    assert!(player.run(35).balls.len() > 5, "the ball stays known for a while");
    assert!(player.run(5).balls.is_empty());
    // The player sees no ball, but a mate does.
    let mut message = player.message(0.0, 1.0);
    (message.sees_ball, message.ball.x, message.ball.y, message.ball_variance) = (true, 1.5, 1.0, 0.02);
    player.messages.publish(message).unwrap();
    let balls = player.run(5).balls;
    let last = &balls.last().unwrap().point;
    assert!((last.point.x - 1.5).abs() < 1e-6 && last.covariance[0] > 0.02, "{last:?}");
    // A certain ball of the player itself takes precedence.
    player.sees_ball(0.6, 0.0, 0.01);
    assert_eq!(player.run(2).balls.last().unwrap().point.point.x, 0.6);
}

#[test]
fn a_vague_ball_of_its_own_is_joined_with_that_of_a_mate() {
    let mut player = Player::at(-1.0, 0.0);
    let mut message = player.message(0.0, 1.0);
    (message.sees_ball, message.ball.x, message.ball_variance) = (true, 2.0, 0.02);
    player.messages.publish(message).unwrap();
    player.sees_ball(2.6, 0.0, 1.0);
    let balls = player.run(2).balls;
    let x = balls.last().unwrap().point.point.x;
    assert!((2.0..2.1).contains(&x), "{x}");
}

#[test]
fn mates_are_where_they_say_and_opponents_where_anybody_sees_them() {
    let mut player = Player::at(-1.0, 0.0);
    let mut message = player.message(0.0, 1.0);
    let other = |x: f32, y: f32, team| downbeat_football::football_interfaces::msg::SeenRobot {
        x,
        y,
        team,
        variance: 0.01,
        player_number: 0,
    };
    // An opponent, and the player itself.
    message.others = vec![other(2.0, 0.5, Attributes::TEAM_OPPONENT), other(-1.1, 0.1, Attributes::TEAM_OWN)];
    player.messages.publish(message).unwrap();
    player.run(1);
    player.sees_robots(&[(0.1, 1.1, Attributes::TEAM_OWN), (1.0, -1.0, Attributes::TEAM_OPPONENT)]);
    let robots = player.run(1).robots.pop().unwrap().robots;
    let mut who: Vec<(u8, u8, f64)> = robots
        .iter()
        .map(|robot| {
            let Attributes { team, player_number, .. } = robot.attributes;
            (team, player_number, robot.pose.pose.position.x.round())
        })
        .collect();
    who.sort_by(|one, other| one.partial_cmp(other).unwrap());
    assert_eq!(who, [(1, 3, 0.0), (2, 0, 1.0), (2, 0, 2.0)]);
    // The mate is silent, so its position and its observations are discarded.
    let robots = player.run(25).robots.pop().unwrap().robots;
    assert!(robots.is_empty(), "{robots:?}");
}

#[test]
fn the_report_has_its_own_time_to_the_ball_beside_that_of_its_mates() {
    let mut player = Player::at(-1.0, 0.0);
    player.sees_ball(0.0, 0.0, 0.01);
    player.messages.publish(player.message(0.0, 1.0)).unwrap();
    let report = player.run(4).reports.pop().unwrap();
    assert_eq!(report.mates.len(), 1);
    assert!(report.own.time_to_ball > report.mates[0].time_to_ball);
}

#[test]
fn a_counted_budget_is_spread_over_the_half_and_ends_at_the_reserve() {
    let mut player = Player::at(-1.0, 0.0);
    // 60 messages for 60 s.
    player.plays(160, false);
    assert!((9..=11).contains(&player.run(100).statuses.len()));
    player.plays(100, false);
    player.run(1);
    assert_eq!(player.run(100).statuses.len(), 0);
    player.plays(u16::MAX, false);
    assert!(player.run(100).statuses.len() >= 49);
}

#[test]
fn refused_messages_are_counted_by_reason_and_change_nothing() {
    let mut player = Player::at(-1.0, 0.0);
    player.run(1);
    let mut bad = vec![player.message(0.0, 1.0); 4];
    bad[0].team = 2;
    bad[1].pose.pose.position.y = f64::NAN;
    bad[2].pose.pose.position.y = 1e6;
    bad[3].header.stamp.sec -= 20;
    bad.into_iter().for_each(|message| player.messages.publish(message).unwrap());
    let heard = player.run(20);
    assert!(heard.reports.iter().all(|report| report.mates.is_empty()));
    let status = &heard.diagnostics.last().unwrap().status[0];
    for reason in ["foreign", "not_finite", "absurd", "old"] {
        let key = format!("refused_{reason}");
        let count = status.values.iter().find(|value| value.key == key);
        assert_eq!(count.map(|count| count.value.as_str()), Some("1"), "{reason}: {:?}", status.values);
    }
}

#[test]
fn who_does_not_know_which_player_it_is_says_nothing() {
    let mut player = Player::at(0.0, 0.0);
    let game = GameState { message_budget: u16::MAX, ..GameState::default() };
    player.games.publish(game).unwrap();
    assert!(player.run(10).statuses.is_empty());
}
