//! The module in a core, with messages as odometry and vision publish them on seeded walks.
#![allow(clippy::unwrap_used, missing_docs)]

mod walk;

use downbeat_executor::{Core, Inbox, Inlet, ManualClock, ModuleOptions, Received, SettingValue, Time};
use downbeat_football::football_interfaces::msg::GameState;
use downbeat_football::soccer_model_msgs::msg::{Ball, RobotArray};
use downbeat_football::soccer_vision_3d_msgs::msg as seen;
use downbeat_football::soccer_vision_attribute_msgs::msg::Robot as Attributes;
use downbeat_football::{IntersectionKind, floor_covariance};
use downbeat_localisation::{Landmarks, Localisation, Pose};
use downbeat_msgs::builtin_interfaces;
use downbeat_msgs::diagnostic_msgs::msg::DiagnosticArray;
use downbeat_msgs::geometry_msgs::msg::{Point, PoseWithCovarianceStamped, Vector3};
use downbeat_msgs::nav_msgs::msg::Odometry;
use downbeat_msgs::std_msgs::msg::{Header, String as Text};
use downbeat_msgs::tf2_msgs::msg::TFMessage;
use downbeat_transforms::isometry;
use glam::{DQuat, DVec2, DVec3};
use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use walk::{HEIGHT, RATE, Walk, wrapped};

/// What the module published.
#[derive(Default)]
struct Heard {
    poses: Vec<PoseWithCovarianceStamped>,
    balls: Vec<Ball>,
    transforms: Vec<TFMessage>,
    robots: Vec<RobotArray>,
    diagnostics: Vec<String>,
}

struct Robot {
    core: Core,
    clock: ManualClock,
    walk: Walk,
    odometry: Pose,
    ball: DVec2,
    sees: bool,
    odom: Inlet<Odometry>,
    markings: Inlet<seen::MarkingArray>,
    posts: Inlet<seen::GoalpostArray>,
    balls: Inlet<Ball>,
    robots: Inlet<seen::RobotArray>,
    game: Inlet<GameState>,
    initial_pose: Inlet<PoseWithCovarianceStamped>,
    robot_state: Inlet<Text>,
    heard: Arc<Mutex<Heard>>,
    /// What arrives one picture later, as vision takes its time.
    late: Option<(seen::MarkingArray, seen::GoalpostArray, Option<Ball>)>,
}

const START: Time = Time::from_nanos(1_000_000_000);

impl Robot {
    fn new(seed: u64, starts: &[f64]) -> Self {
        let clock = ManualClock::new(START);
        let mut core = Core::new().with_clock(clock.clone());
        let settings = [
            ("starts".to_owned(), SettingValue::Doubles(starts.to_vec())),
            ("seed".to_owned(), SettingValue::Integer(seed.cast_signed())),
        ];
        let options = ModuleOptions { settings: settings.into(), ..ModuleOptions::default() };
        core.add_with("localisation", Localisation::default(), options).unwrap();
        let heard = Arc::<Mutex<Heard>>::default();
        let sink = Arc::clone(&heard);
        let hear = move |pose: Received<'_, PoseWithCovarianceStamped>| {
            sink.lock().unwrap().poses.push(pose.clone());
        };
        core.outlet("pose", Inbox::KeepAll, hear).unwrap().keep();
        let sink = Arc::clone(&heard);
        let hear = move |ball: Received<'_, Ball>| sink.lock().unwrap().balls.push(ball.clone());
        core.outlet("ball", Inbox::KeepAll, hear).unwrap().keep();
        let sink = Arc::clone(&heard);
        let hear = move |tf: Received<'_, TFMessage>| sink.lock().unwrap().transforms.push(tf.clone());
        core.outlet("tf", Inbox::KeepAll, hear).unwrap().keep();
        let sink = Arc::clone(&heard);
        let hear = move |robots: Received<'_, RobotArray>| sink.lock().unwrap().robots.push(robots.clone());
        core.outlet("robots", Inbox::KeepAll, hear).unwrap().keep();
        let sink = Arc::clone(&heard);
        let hear = move |array: Received<'_, DiagnosticArray>| {
            sink.lock().unwrap().diagnostics.push(array.status[0].message.clone());
        };
        core.outlet("diagnostics", Inbox::KeepAll, hear).unwrap().keep();
        Self {
            odom: core.inlet("odom").unwrap(),
            markings: core.inlet("vision/markings").unwrap(),
            posts: core.inlet("vision/goalposts").unwrap(),
            balls: core.inlet("vision/ball").unwrap(),
            robots: core.inlet("vision/robots").unwrap(),
            game: core.inlet("game_state").unwrap(),
            initial_pose: core.inlet("initialpose").unwrap(),
            robot_state: core.inlet("robot_state").unwrap(),
            walk: Walk::new(seed),
            // Somewhere, as after a while of walking.
            odometry: Pose { position: DVec2::new(0.7, -3.0), heading: 2.0 },
            ball: DVec2::new(1.0, 0.5),
            sees: true,
            late: None,
            core,
            clock,
            heard,
        }
    }

    /// One picture's time.
    fn step(&mut self) {
        let step = self.walk.step();
        self.moves_by(step);
    }

    fn moves_by(&mut self, step: Pose) {
        let now = self.clock_now() + Duration::from_secs_f64(1.0 / RATE);
        self.clock.set(now);
        self.odometry = self.odometry.then(step);
        self.odom.publish(odometry(self.odometry, now)).unwrap();
        if let Some((markings, posts, ball)) = self.late.take() {
            self.markings.publish(markings).unwrap();
            self.posts.publish(posts).unwrap();
            ball.into_iter().for_each(|ball| self.balls.publish(ball).unwrap());
        }
        if self.sees {
            let landmarks = self.walk.see();
            let ball = self.walk.in_robot(self.ball);
            let ball = self.walk.is_visible(ball).then(|| self.walk.noisy(ball));
            self.late =
                Some((markings(&landmarks, now), posts(&landmarks, now), ball.map(|at| a_ball(at, now))));
        }
        while self.core.next_event().is_some_and(|next| next <= now) {
            self.core.cycle().unwrap();
        }
    }

    fn clock_now(&self) -> Time {
        use downbeat_executor::Clock;
        self.clock.now()
    }

    /// Errors of position (m) and heading (rad).
    fn error(&self) -> (f64, f64) {
        let heard = self.heard.lock().unwrap();
        let pose = &heard.poses.last().unwrap().pose.pose;
        let q = pose.orientation;
        let ahead = DQuat::from_xyzw(q.x, q.y, q.z, q.w) * DVec3::X;
        let position = DVec2::new(pose.position.x, pose.position.y);
        let turned = wrapped(libm::atan2(ahead.y, ahead.x) - self.walk.truth.heading).abs();
        (position.distance(self.walk.truth.position), turned)
    }
}

fn header(frame: &str, at: Time) -> Header {
    Header { stamp: builtin_interfaces::msg::Time::from_nanos(at.as_nanos()), frame_id: frame.to_owned() }
}

fn odometry(pose: Pose, at: Time) -> Odometry {
    let mut message = Odometry { header: header("odom", at), ..Odometry::default() };
    message.pose.pose.position = Point { x: pose.position.x, y: pose.position.y, z: 0.29 };
    // It leans forward.
    let q = DQuat::from_rotation_z(pose.heading) * DQuat::from_rotation_y(0.2);
    let orientation = &mut message.pose.pose.orientation;
    (orientation.x, orientation.y, orientation.z, orientation.w) = (q.x, q.y, q.z, q.w);
    message
}

fn on_floor(at: DVec2) -> Point {
    Point { x: at.x, y: at.y, z: 0.0 }
}

fn markings(landmarks: &Landmarks, at: Time) -> seen::MarkingArray {
    let mut message = seen::MarkingArray { header: header("base_footprint", at), ..Default::default() };
    for (place, kind, heading) in &landmarks.intersections {
        let arms: &[f64] = match kind {
            IntersectionKind::L => &[PI / 4.0, -PI / 4.0],
            IntersectionKind::T => &[FRAC_PI_2, 0.0, -FRAC_PI_2],
            IntersectionKind::X => &[0.0, FRAC_PI_2, PI, -FRAC_PI_2],
        };
        let ray = |arm: &f64| {
            let (y, x) = libm::sincos(heading + arm);
            Vector3 { x, y, z: 0.0 }
        };
        message.intersections.push(seen::MarkingIntersection {
            center: on_floor(*place),
            num_rays: i32::try_from(arms.len()).unwrap(),
            rays: arms.iter().map(ray).collect(),
            ..Default::default()
        });
    }
    for [start, end] in &landmarks.lines {
        let (start, end) = (on_floor(*start), on_floor(*end));
        message.segments.push(seen::MarkingSegment { start, end, ..Default::default() });
    }
    if let Some(centre) = landmarks.circle {
        let mut ellipse = seen::MarkingEllipse::default();
        ellipse.center.position = on_floor(centre);
        ellipse.confidence.confidence = 1.0;
        message.ellipses.push(ellipse);
    }
    message
}

fn posts(landmarks: &Landmarks, at: Time) -> seen::GoalpostArray {
    let post = |at: &DVec2| {
        let mut post = seen::Goalpost::default();
        post.bb.center.position = on_floor(*at);
        post
    };
    let posts = landmarks.posts.iter().map(post).collect();
    seen::GoalpostArray { header: header("base_footprint", at), posts }
}

fn a_ball(at: DVec2, time: Time) -> Ball {
    let mut message = Ball { header: header("base_footprint", time), ..Ball::default() };
    let [[xx, xy], [_, yy]] = floor_covariance(HEIGHT, at, 0.02);
    message.point.point = Point { z: 0.05, ..on_floor(at) };
    message.point.covariance = [xx, xy, 0.0, xy, yy, 0.0, 0.0, 0.0, 1e-6];
    message
}

fn share(sorted: &mut [f64], of: f64) -> f64 {
    sorted.sort_by(f64::total_cmp);
    sorted[((sorted.len() - 1) as f64 * of) as usize]
}

const AT_THE_TOUCH_LINE: [f64; 3] = [-2.0, 3.0, -FRAC_PI_2];

#[test]
fn robot_and_ball_are_followed_although_pictures_are_late() {
    let (mut metres, mut radians, mut ball_metres) = (Vec::new(), Vec::new(), Vec::new());
    for seed in 0..8 {
        let mut robot = Robot::new(seed, &AT_THE_TOUCH_LINE);
        for picture in 0..600 {
            robot.step();
            if picture >= 50 {
                let (off, turned) = robot.error();
                metres.push(off);
                radians.push(turned.to_degrees());
                let heard = robot.heard.lock().unwrap();
                if let Some(ball) = heard.balls.last()
                    && ball.header.stamp == heard.poses.last().unwrap().header.stamp
                    && robot.walk.in_robot(robot.ball).length() < 2.0
                {
                    let at = DVec2::new(ball.point.point.x, ball.point.point.y);
                    ball_metres.push(at.distance(robot.ball));
                }
            }
        }
        // One pose for each odometry, and map to odom agrees with it.
        let heard = robot.heard.lock().unwrap();
        let (pose, tf) = (heard.poses.last().unwrap(), &heard.transforms.last().unwrap().transforms[0]);
        assert_eq!(
            (tf.header.frame_id.as_str(), tf.child_frame_id.as_str(), pose.header.frame_id.as_str()),
            ("map", "odom", "map")
        );
        let map_from_odom = isometry(&tf.transform).unwrap();
        let through = map_from_odom.transform_point(robot.odometry.position.extend(0.29));
        let Point { x, y, z } = pose.pose.pose.position;
        assert!(through.distance(DVec3::new(x, y, z)) < 1e-9);
    }
    let found = [
        share(&mut metres, 0.5),
        share(&mut metres, 0.95),
        share(&mut radians, 0.95),
        share(&mut ball_metres, 0.5),
        share(&mut ball_metres, 0.95),
    ];
    println!(
        "pose: median {:.3} m, 95 % {:.3} m, 95 % {:.2} degrees; ball within 2 m: median {:.3} m, 95 % {:.3} m ({})",
        found[0],
        found[1],
        found[2],
        found[3],
        found[4],
        ball_metres.len()
    );
    assert!(found[0] <= 0.10 && found[1] <= 0.30 && found[2] <= 5.0, "{found:?}");
    assert!(found[3] <= 0.15 && ball_metres.len() > 200, "{found:?} {}", ball_metres.len());
}

#[test]
fn the_touch_line_from_which_a_robot_entered_is_found_out() {
    let mut right = 0;
    for seed in 0..10 {
        let mut robot = Robot::new(seed, &[-2.0, -3.0, FRAC_PI_2, -2.0, 3.0, -FRAC_PI_2]);
        (0..100).for_each(|_| robot.step());
        let (off, turned) = robot.error();
        right += usize::from(off < 0.4 && turned < 0.2);
    }
    assert!(right >= 9, "{right} of 10");
}

#[test]
fn after_a_penalty_it_is_where_it_returns() {
    let mut robot = Robot::new(3, &AT_THE_TOUCH_LINE);
    (0..100).for_each(|_| robot.step());
    let state = GameState { state: GameState::PLAYING, own_half_is_left: true, ..GameState::default() };
    robot.game.publish(state.clone()).unwrap();
    robot.game.publish(GameState { is_penalised: true, ..state.clone() }).unwrap();
    robot.walk.truth = Pose { position: DVec2::new(-2.0, 3.0), heading: -FRAC_PI_2 };
    robot.sees = false;
    // Carried by hands: odometry feels nothing.
    (0..5).for_each(|_| robot.moves_by(Pose::default()));
    assert!(robot.error().0 > 0.5, "it has walked away from there");
    robot.game.publish(state).unwrap();
    robot.moves_by(Pose::default());
    let (off, turned) = robot.error();
    assert!(off < 0.15 && turned < 0.15, "{off} {turned}");
}

/// As at half-time: its gyroscope feels that it is turned round.
#[test]
fn who_is_carried_to_its_place_before_a_half_faces_the_other_goal() {
    let mut robot = Robot::new(3, &AT_THE_TOUCH_LINE);
    (0..100).for_each(|_| robot.step());
    let half =
        |state: u8, own_half_is_left: bool| GameState { state, own_half_is_left, ..GameState::default() };
    robot.game.publish(half(GameState::PLAYING, true)).unwrap();
    robot.moves_by(Pose::default());
    robot.game.publish(half(GameState::INITIAL, false)).unwrap();
    robot.sees = false;
    robot.walk.truth = Pose { position: DVec2::new(-2.0, 3.0), heading: -FRAC_PI_2 };
    (0..10).for_each(|_| robot.moves_by(Pose { heading: PI / 10.0, ..Pose::default() }));
    robot.game.publish(half(GameState::READY, false)).unwrap();
    robot.moves_by(Pose::default());
    let (off, turned) = robot.error();
    assert!(off < 0.15 && turned < 0.15, "{off} {turned}");
    robot.sees = true;
    (0..100).for_each(|_| robot.step());
    let (off, turned) = robot.error();
    assert!(off < 0.3 && turned < 0.2, "{off} {turned}");
}

#[test]
fn what_a_robot_sees_that_lies_does_not_count() {
    let mut robot = Robot::new(3, &AT_THE_TOUCH_LINE);
    (0..100).for_each(|_| robot.step());
    let truth = robot.walk.truth;
    robot.robot_state.publish(Text { data: "falling".to_owned() }).unwrap();
    // What it sees on the floor looks like another place.
    robot.walk.truth = Pose { position: DVec2::new(2.0, -1.0), heading: truth.heading };
    (0..50).for_each(|_| robot.moves_by(Pose::default()));
    robot.walk.truth = truth;
    robot.robot_state.publish(Text { data: "upright".to_owned() }).unwrap();
    robot.moves_by(Pose::default());
    let (off, turned) = robot.error();
    assert!(off < 0.3 && turned < 0.2, "{off} {turned}");
}

#[test]
fn who_rolls_over_to_get_up_soon_knows_where_it_is() {
    let mut found = 0;
    for seed in 0..20 {
        let mut robot = Robot::new(seed, &AT_THE_TOUCH_LINE);
        (0..150).for_each(|_| robot.step());
        robot.robot_state.publish(Text { data: "falling".to_owned() }).unwrap();
        let way = DVec2::from_angle(seed as f64) * 0.5;
        robot.walk.truth.position += way;
        robot.walk.truth.heading += if seed % 2 == 0 { 0.35 } else { -0.35 };
        (0..50).for_each(|_| robot.moves_by(Pose::default()));
        robot.robot_state.publish(Text { data: "upright".to_owned() }).unwrap();
        (0..30).for_each(|_| robot.step());
        let (off, turned) = robot.error();
        println!("{seed}: {off:.2} m, {turned:.2} rad");
        found += u32::from(off < 0.3 && turned < 0.2);
    }
    assert!(found >= 18, "{found} of 20");
}

#[test]
fn it_is_where_somebody_says_and_pictures_from_before_do_not_count() {
    let mut robot = Robot::new(3, &AT_THE_TOUCH_LINE);
    (0..100).for_each(|_| robot.step());
    robot.walk.truth = Pose { position: DVec2::new(2.0, -1.0), heading: FRAC_PI_2 };
    let told = robot.walk.truth;
    let pose = |frame: &str, orientation: DQuat| {
        let mut message =
            PoseWithCovarianceStamped { header: header(frame, robot.clock_now()), ..Default::default() };
        (message.pose.pose.position.x, message.pose.pose.position.y) = (told.position.x, told.position.y);
        let q = &mut message.pose.pose.orientation;
        (q.x, q.y, q.z, q.w) = (orientation.x, orientation.y, orientation.z, orientation.w);
        message
    };
    let somewhere_else = pose("odom", DQuat::from_rotation_z(told.heading));
    let no_pose = pose("map", DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0));
    let there = pose("map", DQuat::from_rotation_z(told.heading));
    robot.sees = false;
    for (refused, problem) in [(somewhere_else, "in the frame \"odom\""), (no_pose, "no pose")] {
        robot.initial_pose.publish(refused).unwrap();
        robot.moves_by(Pose::default());
        assert!(robot.error().0 > 0.5, "it is believed to be there");
        let told = robot.heard.lock().unwrap().diagnostics.clone();
        assert!(told.iter().any(|told| told.contains(problem)), "{told:?}");
    }
    // As vision takes its time, a picture of the old place arrives with it.
    let old = Landmarks { posts: vec![DVec2::new(1.0, 1.0), DVec2::new(1.0, -0.5)], ..Landmarks::default() };
    let at = robot.clock_now();
    robot.late = Some((markings(&old, at), posts(&old, at), None));
    robot.initial_pose.publish(there).unwrap();
    robot.moves_by(Pose::default());
    let (off, turned) = robot.error();
    assert!(off < 0.15 && turned < 0.15, "{off} {turned}");
    robot.sees = true;
    (0..50).for_each(|_| robot.step());
    assert!(robot.error().0 < 0.2, "{:?}", robot.error());
}

#[test]
fn odometry_that_begins_anew_does_not_move_the_robot() {
    let mut robot = Robot::new(4, &AT_THE_TOUCH_LINE);
    (0..100).for_each(|_| robot.step());
    let before = robot.error();
    robot.odometry = Pose::default();
    robot.sees = false;
    robot.late = None;
    robot.moves_by(Pose::default());
    let after = robot.error();
    assert!((after.0 - before.0).abs() < 0.1 && after.1 < 0.2, "{before:?} {after:?}");
}

#[test]
fn what_is_missing_is_reported_with_the_remedy() {
    let mut robot = Robot::new(5, &AT_THE_TOUCH_LINE);
    let told = |robot: &Robot| robot.heard.lock().unwrap().diagnostics.last().cloned().unwrap_or_default();
    for now in (0..3).map(|second| START + Duration::from_secs(second)) {
        robot.clock.set(now);
        while robot.core.next_event().is_some_and(|next| next <= now) {
            robot.core.cycle().unwrap();
        }
    }
    assert!(told(&robot).contains("let gait publish odom"), "{}", told(&robot));
    robot.sees = false;
    (0..20).for_each(|_| robot.step());
    assert!(told(&robot).contains("let vision run"), "{}", told(&robot));
    robot.sees = true;
    (0..30).for_each(|_| robot.step());
    assert_eq!(told(&robot), "knows where it is");
    robot.sees = false;
    robot.late = None;
    let mut strange = markings(&Landmarks::default(), robot.clock_now());
    strange.header.frame_id = "camera".to_owned();
    robot.markings.publish(strange).unwrap();
    (0..15).for_each(|_| robot.step());
    assert!(told(&robot).contains("base_footprint"), "{}", told(&robot));
    let late = markings(&Landmarks::default(), START - Duration::from_secs(1));
    robot.markings.publish(late).unwrap();
    (0..15).for_each(|_| robot.step());
    assert!(told(&robot).contains("before the odometry"), "{}", told(&robot));
}

#[test]
fn numbers_that_are_none_change_nothing() {
    let mut robot = Robot::new(6, &AT_THE_TOUCH_LINE);
    (0..50).for_each(|_| robot.step());
    let now = robot.clock_now();
    let nowhere = DVec2::new(f64::NAN, f64::INFINITY);
    robot.odom.publish(odometry(Pose { position: nowhere, heading: f64::NAN }, now)).unwrap();
    let mut ball = a_ball(nowhere, now);
    ball.point.covariance[0] = f64::NAN;
    robot.balls.publish(ball).unwrap();
    let mut strange = markings(
        &Landmarks {
            intersections: vec![(nowhere, IntersectionKind::T, f64::NAN); 1000],
            lines: vec![[nowhere, nowhere]; 1000],
            circle: Some(nowhere),
            ..Landmarks::default()
        },
        now,
    );
    strange.segments.push(seen::MarkingSegment::default());
    robot.markings.publish(strange).unwrap();
    robot
        .posts
        .publish(posts(&Landmarks { posts: vec![nowhere; 1000], ..Landmarks::default() }, now))
        .unwrap();
    (0..50).for_each(|_| robot.step());
    let (off, turned) = robot.error();
    assert!(off < 0.4 && turned < 0.2, "{off} {turned}");
}

#[test]
fn other_robots_are_followed_on_the_field_while_the_head_looks_elsewhere() {
    let mut robot = Robot::new(8, &AT_THE_TOUCH_LINE);
    let others = [
        (DVec2::new(-0.5, 1.0), Attributes::TEAM_OWN),
        (DVec2::new(0.5, -0.8), Attributes::TEAM_OPPONENT),
        (DVec2::new(-3.0, 0.5), Attributes::TEAM_OPPONENT),
    ];
    let (mut found, mut wrong_teams, mut errors) = (0, 0, Vec::new());
    for step in 0..400 {
        robot.step();
        let now = robot.clock_now();
        let mut message = seen::RobotArray { header: header("base_footprint", now), ..Default::default() };
        for (at, team) in others {
            let at = robot.walk.in_robot(at);
            if robot.walk.is_visible(at) {
                let mut one = seen::Robot::default();
                one.bb.center.position = on_floor(robot.walk.noisy(at));
                (one.attributes.team, one.attributes.state) = (team, Attributes::STATE_STANDING);
                message.robots.push(one);
            }
        }
        // What no robot can be.
        let mut strange = seen::Robot::default();
        strange.bb.center.position = on_floor(DVec2::splat(f64::NAN));
        message.robots.push(strange);
        robot.robots.publish(message).unwrap();
        if step < 50 {
            continue;
        }
        let heard = robot.heard.lock().unwrap();
        let believed = heard.robots.last().unwrap();
        assert_eq!(believed.header.frame_id, "map");
        assert!(believed.robots.len() <= 2 * others.len(), "{believed:?}");
        for one in &believed.robots {
            let place = DVec2::new(one.pose.pose.position.x, one.pose.pose.position.y);
            let (truth, team) = others
                .into_iter()
                .min_by(|(a, _), (b, _)| a.distance(place).total_cmp(&b.distance(place)))
                .unwrap();
            found += 1;
            wrong_teams += usize::from(![0, team].contains(&one.attributes.team));
            errors.push(truth.distance(place));
            assert!(one.pose.covariance[0] > 0.0 && one.pose.covariance[7] > 0.0);
        }
    }
    errors.sort_by(f64::total_cmp);
    let median = errors[errors.len() / 2];
    println!("{found} robots in 350 messages, {wrong_teams} in the wrong team, median error {median:.2} m");
    assert!(found > 350 && wrong_teams == 0 && median < 0.25, "{found} {wrong_teams} {median}");
    // Ten times a second, also without any picture.
    let before = robot.heard.lock().unwrap().robots.len();
    (0..50).for_each(|_| robot.step());
    let heard = robot.heard.lock().unwrap();
    assert!((48..=51).contains(&(heard.robots.len() - before)), "{}", heard.robots.len() - before);
    assert!(heard.robots.last().unwrap().robots.is_empty(), "after the timeout");
}

#[test]
fn settings_that_are_no_places_and_fields_that_cannot_be_are_refused() {
    let refused = |name: &str, value: SettingValue| {
        let options =
            ModuleOptions { settings: [(name.to_owned(), value)].into(), ..ModuleOptions::default() };
        Core::new().add_with("localisation", Localisation::default(), options).unwrap_err().to_string()
    };
    assert!(refused("starts", SettingValue::Doubles(vec![1.0, 2.0])).contains("x, y (m) and heading"));
    let file = std::env::temp_dir().join(format!("wide_goal_{}.toml", std::process::id()));
    let text =
        downbeat_football::Field::BUILT_IN[0].1.replace("[goal]\nwidth = 2.25", "[goal]\nwidth = 25.0");
    std::fs::write(&file, text).unwrap();
    let problem = refused("field", SettingValue::Text(file.display().to_string()));
    std::fs::remove_file(&file).unwrap();
    assert!(problem.contains("goal.width is 25 m"), "{problem}");
}

#[test]
fn the_same_messages_give_the_same_bits() {
    let run = || {
        let mut robot = Robot::new(7, &[]);
        (0..60).for_each(|_| robot.step());
        let heard = robot.heard.lock().unwrap();
        (heard.poses.clone(), heard.balls.clone())
    };
    assert!(run() == run());
}
