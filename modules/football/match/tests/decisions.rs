//! What a player decides by its chart, `robots/football/player.scxml`, for what it believes of the field.
#![allow(clippy::unwrap_used, missing_docs)]

use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use downbeat_edge::Interfaces;
use downbeat_edge::foreign::ForeignModule;
use downbeat_executor::{Clock as _, Core, Inbox, ManualClock, ModuleOptions, Received, SettingValue, Time};
use downbeat_football::football_interfaces::msg::{GameState, TeamMessage, TeamReport};
use downbeat_football::soccer_model_msgs::msg::{Ball, Robot, RobotArray};
use downbeat_football::soccer_vision_attribute_msgs::msg::Robot as Attributes;
use downbeat_msgs::geometry_msgs::msg::{PointStamped, PoseStamped, PoseWithCovarianceStamped};
use downbeat_state_machine::StateMachineOptions;

/// Half the length of the field of 9 x 6 m, in m.
const HALF_LENGTH: f64 = 4.5;

/// What a player believes that faces +x, in the frame of its team, whose goal is at -x.
struct Belief<'a> {
    number: u8,
    place: [f64; 2],
    ball: [f64; 2],
    /// Places and teams of robots on their feet.
    others: &'a [([f64; 2], u8)],
    /// Numbers and roles of mates.
    mates: &'a [(u8, u8)],
}

/// Where it goes, and where it would kick the ball.
#[derive(Clone, Copy, Default)]
struct Decided {
    go: Option<[f64; 2]>,
    aim: Option<[f64; 2]>,
}

/// What is decided last, in two seconds of play with these beliefs after an own kick-off.
fn decides(belief: &Belief<'_>) -> Decided {
    let clock = ManualClock::new(Time::from_nanos(1_000_000_000));
    let mut core = Core::new().with_clock(clock.clone());
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../robots/football/player.scxml");
    let chart = StateMachineOptions { path, is_reloaded: false };
    let settings = [("half_length".to_owned(), SettingValue::from(HALF_LENGTH))].into();
    let options = ModuleOptions { settings, ..ModuleOptions::default() };
    let interfaces = Interfaces::carried()
        .with(downbeat_football::INTERFACES)
        .unwrap()
        .with(downbeat_state_machine::INTERFACES)
        .unwrap();
    let of_module = options.clone();
    let make = move || {
        let chart = chart.clone();
        let load = Arc::new(move || downbeat_state_machine::load(&chart));
        ForeignModule::new(load, interfaces.clone(), of_module.clone())
    };
    core.add_restartable("player", make, options).unwrap();
    let decided = Arc::<Mutex<Decided>>::default();
    let goes = Arc::clone(&decided);
    let go = move |pose: Received<'_, PoseStamped>| {
        goes.lock().unwrap().go = Some([pose.pose.position.x, pose.pose.position.y]);
    };
    core.outlet("walk_to/pose", Inbox::KeepAll, go).unwrap().keep();
    let aims = Arc::clone(&decided);
    let aim = move |at: Received<'_, PointStamped>| aims.lock().unwrap().aim = Some([at.point.x, at.point.y]);
    core.outlet("walk_to/strike", Inbox::KeepAll, aim).unwrap().keep();

    let (games, poses) = (core.inlet("game_state").unwrap(), core.inlet("pose").unwrap());
    let (balls, others) = (core.inlet("team/ball").unwrap(), core.inlet("team/robots").unwrap());
    let reports = core.inlet("team/report").unwrap();
    for tenth in 0..20 {
        let state = if tenth < 5 { GameState::SET } else { GameState::PLAYING };
        let (player, kick_team) = (belief.number, GameState::OWN);
        games.publish(GameState { state, player, kick_team, ..GameState::default() }).unwrap();
        let mut pose = PoseWithCovarianceStamped::default();
        [pose.pose.pose.position.x, pose.pose.pose.position.y] = belief.place;
        pose.pose.pose.orientation.w = 1.0;
        poses.publish(pose).unwrap();
        let mut ball = Ball::default();
        [ball.point.point.x, ball.point.point.y] = belief.ball;
        balls.publish(ball).unwrap();
        let robot = |([x, y], team): &([f64; 2], u8)| {
            let mut robot = Robot::default();
            [robot.pose.pose.position.x, robot.pose.pose.position.y] = [*x, *y];
            (robot.attributes.team, robot.attributes.state) = (*team, Attributes::STATE_STANDING);
            robot
        };
        let robots = belief.others.iter().map(robot).collect();
        others.publish(RobotArray { robots, ..RobotArray::default() }).unwrap();
        // All are as near to the ball.
        let told = |(player, role): &(u8, u8)| TeamMessage {
            player: *player,
            role: *role,
            time_to_ball: 5.0,
            ..TeamMessage::default()
        };
        let (own, mates) =
            (told(&(belief.number, TeamMessage::IDLE)), belief.mates.iter().map(told).collect());
        reports.publish(TeamReport { own, mates, ..TeamReport::default() }).unwrap();
        clock.advance(Duration::from_millis(100));
        let now = clock.now();
        while core.next_event().is_some_and(|next| next <= now) {
            core.cycle().unwrap();
        }
    }
    drop(core);
    let decided = decided.lock().unwrap();
    *decided
}

const MATE: u8 = Attributes::TEAM_OWN;
const OPPONENT: u8 = Attributes::TEAM_OPPONENT;

/// Where player 2 kicks to from this place of the ball, 0.6 m before it.
fn aim(ball: [f64; 2], others: &[([f64; 2], u8)]) -> [f64; 2] {
    let place = [ball[0] - 0.6, ball[1]];
    decides(&Belief { number: 2, place, ball, others, mates: &[] }).aim.unwrap()
}

#[test]
fn a_kick_off_passes_who_stands_ahead() {
    assert_eq!(aim([0.0, 0.0], &[]), [HALF_LENGTH + 0.5, 0.0]);
    for side in [-0.05, 0.05] {
        let [x, y] = aim([0.0, 0.0], &[([0.9, side], OPPONENT)]);
        let way = (0.9 * y - side * x).abs() / libm::hypot(x, y);
        assert!(way > 0.35 && x > 0.0, "{way} m beside the opponent, towards {x}, {y}");
    }
}

#[test]
fn a_ball_whose_way_is_barred_goes_to_a_free_mate_ahead() {
    let barred = ([0.9, 0.0], OPPONENT);
    let mate = ([0.6, 1.2], MATE);
    let passed = [0.8, 1.2];
    assert_eq!(aim([0.0, 0.0], &[barred, mate]), passed);
    assert_ne!(aim([0.0, 0.0], &[mate]), passed, "nobody bars its way");
    for (others, why) in [
        ([barred, mate, ([1.0, 1.4], OPPONENT)], "an opponent is at the mate"),
        ([barred, mate, ([0.2, 0.6], OPPONENT)], "an opponent is on the way to the mate"),
    ] {
        assert_ne!(aim([0.0, 0.0], &others), passed, "{why}");
    }
    assert_ne!(aim([0.0, 0.0], &[barred, ([-0.6, 1.2], MATE)])[1], 1.2, "the mate is behind the ball");
    let near = [2.5, 0.0];
    assert!(aim(near, &[([3.4, 0.0], OPPONENT), ([3.1, 1.2], MATE)])[0] > HALF_LENGTH, "a goal can be shot");
}

#[test]
fn the_second_who_helps_is_ahead_for_a_pass_and_the_first_behind_the_ball() {
    let goes = |mates: &[(u8, u8)]| {
        let (place, ball) = ([-1.5, 1.0], [0.0, -0.5]);
        decides(&Belief { number: 4, place, ball, others: &[], mates }).go.unwrap()
    };
    let striker = (2, TeamMessage::STRIKER);
    assert_eq!(goes(&[striker]), [-1.0, -0.35]);
    assert_eq!(goes(&[striker, (3, TeamMessage::SUPPORT)]), [0.6, 0.7]);
}
