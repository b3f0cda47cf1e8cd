#![allow(clippy::unwrap_used)]
use super::error::TimeDirection;
use super::*;
use downbeat_executor::Time;
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::geometry_msgs::msg::{
    Point, PointStamped, Pose, PoseWithCovariance, TransformStamped, Twist, TwistWithCovariance, Vector3,
    Wrench,
};
use glam::{DQuat, DVec3};
use proptest::prelude::*;
use std::time::Duration;

const MILLISECOND: i64 = 1_000_000;

fn at(milliseconds: i64) -> Time {
    Time::from_nanos(milliseconds * MILLISECOND)
}

fn stamped(parent: &str, child: &str, milliseconds: i64, isometry: &Isometry) -> TransformStamped {
    let mut transform = TransformStamped { child_frame_id: child.into(), ..TransformStamped::default() };
    transform.header.frame_id = parent.into();
    transform.header.stamp = Stamp::from_nanos(milliseconds * MILLISECOND);
    transform.transform = transform_message(isometry);
    transform
}

fn along_x(metres: f64) -> Isometry {
    Isometry::from_translation(metres, 0.0, 0.0)
}

/// `map` - `odom` (moves) - `base` (moves) - `head` (moves) - `camera` (static), and `base` - `foot`
/// (static).
fn robot() -> TransformBuffer {
    let mut buffer = TransformBuffer::new();
    for second in 1..=5 {
        let moved = along_x(second as f64);
        buffer.insert(&stamped("map", "odom", second * 2000, &moved)).unwrap();
        buffer.insert(&stamped("odom", "base", second * 1000, &moved)).unwrap();
        buffer.insert(&stamped("base", "head", second * 900, &moved)).unwrap();
    }
    buffer.insert_static(&stamped("head", "camera", 0, &along_x(0.1))).unwrap();
    buffer.insert_static(&stamped("/base", "/foot", 0, &along_x(-0.5))).unwrap();
    buffer
}

fn x_of(found: &FoundTransform) -> f64 {
    found.target_from_source.translation.x
}

#[test]
fn a_path_up_down_and_over_the_common_ancestor_is_found() {
    let buffer = robot();
    let lookup = |target, source| x_of(&buffer.lookup(target, source, at(3000)).unwrap());
    let near = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-12, "{found} {expected}");
    near(lookup("odom", "base"), 3.0);
    near(lookup("base", "odom"), -3.0);
    near(lookup("base", "camera"), 3.0 / 0.9 + 0.1);
    near(lookup("foot", "camera"), 3.0 / 0.9 + 0.6);
    near(lookup("camera", "/foot"), -3.0 / 0.9 - 0.6);
    near(lookup("map", "foot"), 1.5 + 3.0 - 0.5);
    near(lookup("foot", "foot"), 0.0);
}

#[test]
fn an_unknown_time_is_reported_with_the_frame_and_the_distance() {
    let buffer = robot();
    let error = buffer.lookup("odom", "camera", at(4623)).unwrap_err();
    let LookupError::Extrapolation { frame, direction, by, oldest, latest, .. } = &error else {
        panic!("{error}")
    };
    assert_eq!(
        (frame.as_str(), *direction, *by),
        ("head", TimeDirection::Future, Duration::from_millis(123))
    );
    assert_eq!((*oldest, *latest), (at(900), at(4500)));
    assert_eq!(
        error.to_string(),
        "cannot look up \"camera\" in \"odom\" at 4.623000000: it would require extrapolation 0.123000000 s into the future \
         of \"head\", which is known from 0.900000000 to 4.500000000"
    );
    let error = buffer.lookup("map", "base", at(1999)).unwrap_err().to_string();
    assert!(error.contains("0.001000000 s into the past of \"odom\""), "{error}");
    // Frames outside of the path do not matter.
    buffer.lookup("base", "odom", at(4800)).unwrap();
}

#[test]
fn latest_is_the_latest_time_at_which_the_whole_path_is_known() {
    let buffer = robot();
    let latest = |target, source| buffer.lookup(target, source, At::Latest).unwrap().time;
    assert_eq!(latest("odom", "camera"), at(4500));
    assert_eq!(latest("odom", "foot"), at(5000));
    assert_eq!(latest("camera", "map"), at(4500));
    assert_eq!(latest("base", "foot"), Time::ZERO);
    assert_eq!(buffer.latest_common_time("base", "foot"), Ok(None));
    assert_eq!(buffer.latest_common_time("odom", "odom"), Ok(Some(at(10_000))));
}

#[test]
fn through_a_fixed_frame_both_ends_have_separate_times() {
    let buffer = robot();
    // The base has moved 2 m in odom since.
    let found = buffer.lookup_through("base", at(4000), "base", at(2000), "odom").unwrap();
    assert!((x_of(&found) + 2.0).abs() < 1e-12);
    assert_eq!(found.time, at(4000));
    let error = buffer.lookup_through("base", at(5001), "base", at(2000), "odom").unwrap_err();
    assert!(error.to_string().contains("0.001000000 s into the future of \"base\""), "{error}");
}

#[test]
fn unknown_and_unconnected_frames_are_reported_with_suggestions() {
    let mut buffer = TransformBuffer::new();
    let empty = buffer.lookup("odom", "base", At::Latest).unwrap_err().to_string();
    assert!(empty.contains("no frame \"odom\"; no frames are known yet"), "{empty}");
    buffer = robot();
    let unknown = buffer.lookup("odom", "camra", At::Latest).unwrap_err().to_string();
    assert!(unknown.ends_with("there is no frame \"camra\", did you mean \"camera\"?"), "{unknown}");
    buffer.insert_static(&stamped("dock", "plug", 0, &along_x(0.1))).unwrap();
    for time in [At::Latest, At::Time(at(3000))] {
        let apart = buffer.lookup("plug", "camera", time).unwrap_err().to_string();
        assert!(apart.contains("below \"map\"") && apart.contains("below \"dock\""), "{apart}");
    }
}

#[test]
fn invalid_transforms_are_refused_and_change_nothing() {
    let mut buffer = robot();
    let before = buffer.frames().count();
    let mut refuse = |transform: &TransformStamped, expected: &str| {
        let refused = buffer.insert(transform).unwrap_err().to_string();
        assert!(refused.contains(expected), "{refused}");
        assert_eq!(buffer.insert_static(transform).unwrap_err().to_string(), refused);
    };
    refuse(&stamped("a", "/a", 0, &along_x(1.0)), "\"a\" is its own parent");
    refuse(&stamped("a", "", 0, &along_x(1.0)), "names no frame (child_frame_id)");
    refuse(&stamped("", "a", 0, &along_x(1.0)), "names no parent (header.frame_id)");
    refuse(&stamped("a", "b", 0, &along_x(f64::NAN)), "not finite");
    refuse(&stamped("a", &"b".repeat(1000), 0, &along_x(1.0)), "longer than 255 bytes");
    let mut stretched = stamped("a", "b", 0, &along_x(1.0));
    stretched.transform.rotation.w = 2.0;
    refuse(&stretched, "its norm is 2");
    refuse(&stamped("camera", "odom", 3000, &along_x(1.0)), "camera is in head is in base is in odom");
    assert_eq!(buffer.frames().count(), before);
    let old = stamped("base", "head", -6000, &along_x(1.0));
    assert!(buffer.insert(&old).unwrap_err().to_string().contains("10.5 s older"));
}

#[test]
fn endless_names_do_not_fill_the_memory() {
    let mut buffer = TransformBuffer::new();
    let fill = (0..5000).try_for_each(|number| {
        buffer.insert(&stamped("root", &format!("frame {number}"), 0, &along_x(1.0))).map(drop)
    });
    assert!(matches!(fill, Err(TransformRefused::TooManyFrames { limit: 4096, .. })));
    buffer.clear();
    assert_eq!(buffer.frames().count(), 0);
}

#[test]
fn a_frame_can_get_another_parent_and_stop_moving() {
    let mut buffer = TransformBuffer::new();
    for (parent, milliseconds) in [("table", 1000), ("table", 2000), ("hand", 3000), ("hand", 4000)] {
        buffer.insert(&stamped(parent, "cup", milliseconds, &along_x(milliseconds as f64))).unwrap();
    }
    let x = |buffer: &TransformBuffer, parent, milliseconds| {
        buffer.lookup(parent, "cup", at(milliseconds)).map(|found| x_of(&found))
    };
    assert_eq!(x(&buffer, "table", 2500), Ok(2000.0), "until the hand has it");
    assert_eq!(x(&buffer, "hand", 3500), Ok(3500.0));
    assert!(matches!(x(&buffer, "table", 3500), Err(LookupError::NotConnected { .. })));
    assert_eq!(buffer.insert(&stamped("hand", "cup", 4000, &along_x(4000.0))), Ok(Taken::Known));
    assert_eq!(buffer.insert(&stamped("hand", "cup", 4000, &along_x(4.0))), Ok(Taken::Replaced));
    buffer.insert_static(&stamped("hand", "cup", 0, &along_x(7.0))).unwrap();
    assert_eq!(x(&buffer, "hand", 99_000), Ok(7.0));
    let cup = buffer.frames().find(|frame| &*frame.name == "cup").unwrap();
    assert_eq!((cup.parent.as_deref(), cup.is_static, cup.span), (Some("hand"), true, None));
}

#[test]
fn a_stamped_value_is_transformed_at_its_time_and_says_so() {
    let buffer = robot();
    let mut seen = PointStamped { point: Point { x: 1.0, ..Point::default() }, ..PointStamped::default() };
    seen.header.frame_id = "base".into();
    let latest = buffer.transform(&seen, "odom").unwrap();
    assert_eq!((latest.point.x, latest.header.stamp.sec, latest.header.frame_id.as_str()), (6.0, 5, "odom"));
    seen.header.stamp.sec = 2;
    let then = buffer.transform(&seen, "odom").unwrap();
    assert_eq!((then.point.x, then.header.stamp.sec), (3.0, 2));
}

fn vector(x: f64, y: f64, z: f64) -> Vector3 {
    Vector3 { x, y, z }
}

#[test]
fn a_body_that_turns_about_the_source_moves_at_the_target() {
    // The target is 1 m ahead of the source; the body turns to the left at 1 rad/s about the source.
    let target_from_source = along_x(-1.0);
    let turning = Twist { linear: vector(0.0, 0.0, 0.0), angular: vector(0.0, 0.0, 1.0) };
    let moved = turning.transformed(&target_from_source);
    assert_eq!(moved, Twist { linear: vector(0.0, 1.0, 0.0), angular: vector(0.0, 0.0, 1.0) });
    // Its yaw rate is uncertain, and with it the velocity to the left.
    let mut covariance = [0.0; 36];
    covariance[35] = 0.25;
    let moved =
        TwistWithCovariance { twist: turning, covariance }.transformed(&target_from_source).covariance;
    assert_eq!((moved[7], moved[11], moved[31], moved[35]), (0.25, 0.25, 0.25, 0.25));
    // A force to the left at the source turns about the target to the right.
    let pushed = Wrench { force: vector(0.0, 1.0, 0.0), torque: vector(0.0, 0.0, 0.0) };
    assert_eq!(pushed.transformed(&target_from_source).torque, vector(0.0, 0.0, -1.0));
}

#[test]
fn the_covariance_of_a_pose_turns_with_it() {
    let rotation = DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2);
    let target_from_source = Isometry { rotation, ..along_x(5.0) };
    let mut covariance = [0.0; 36];
    (covariance[0], covariance[7], covariance[21]) = (1.0, 2.0, 3.0);
    let turned = PoseWithCovariance { pose: Pose::default(), covariance }.transformed(&target_from_source);
    let diagonal: Vec<_> = (0..6).map(|row| (turned.covariance[row * 7] * 1e9).round() / 1e9).collect();
    assert_eq!(diagonal, [2.0, 1.0, 0.0, 0.0, 3.0, 0.0]);
    assert_eq!(turned.pose.position, Point { x: 5.0, ..Point::default() });
}

prop_compose! {
    fn any_isometry()(x in -10.0..10.0, y in -10.0..10.0, z in -10.0..10.0, axis in prop::array::uniform3(-4.0..4.0))
        -> Isometry
    {
        Isometry { translation: DVec3::new(x, y, z), rotation: DQuat::from_scaled_axis(DVec3::from(axis)) }
    }
}

prop_compose! {
    /// A tree in which each frame is below an earlier one; samples at 0, 100, … ms.
    fn any_tree()(links in prop::collection::vec((any::<prop::sample::Index>(), prop::collection::vec(any_isometry(), 2..6)), 1..12))
        -> Vec<TransformStamped>
    {
        let link = |(child, (parent, samples)): (usize, (prop::sample::Index, Vec<_>))| {
            let parent = format!("f{}", parent.index(child + 1));
            let sample = move |(nth, isometry): (usize, Isometry)| {
                stamped(&parent, &format!("f{}", child + 1), nth as i64 * 100, &isometry)
            };
            samples.into_iter().enumerate().map(sample).collect::<Vec<_>>()
        };
        links.into_iter().enumerate().flat_map(link).collect()
    }
}

fn filled(transforms: &[TransformStamped]) -> TransformBuffer {
    let mut buffer = TransformBuffer::new();
    for transform in transforms {
        buffer.insert(transform).unwrap();
    }
    buffer
}

fn difference(one: &Isometry, other: &Isometry) -> f64 {
    let between = one.inverse() * *other;
    between.translation.length() + angle(between.rotation)
}

/// The angle of a rotation, accurate for small ones too.
fn angle(rotation: DQuat) -> f64 {
    2.0 * libm::atan2(rotation.xyz().length(), rotation.w.abs())
}

proptest! {
    #[test]
    fn there_and_back_is_the_identity(tree in any_tree(), milliseconds in 0..=100_i64, ends in any::<[prop::sample::Index; 3]>()) {
        let buffer = filled(&tree);
        let count = buffer.frames().count();
        let [a, b, c] = ends.map(|end| format!("f{}", end.index(count)));
        let lookup = |target: &str, source: &str| {
            buffer.lookup(target, source, at(milliseconds)).unwrap().target_from_source
        };
        prop_assert!(difference(&(lookup(&a, &b) * lookup(&b, &a)), &Isometry::IDENTITY) < 1e-6);
        prop_assert!(difference(&(lookup(&a, &b) * lookup(&b, &c)), &lookup(&a, &c)) < 1e-6);
    }

    #[test]
    fn the_order_of_insertion_does_not_matter(tree in any_tree(), seed in any::<u64>()) {
        let mut shuffled = tree.clone();
        let key = |transform: &TransformStamped| {
            use std::hash::{DefaultHasher, Hash, Hasher};
            let mut hasher = DefaultHasher::new();
            (seed, &transform.child_frame_id, transform.header.stamp.nanosec).hash(&mut hasher);
            hasher.finish()
        };
        shuffled.sort_by_key(key);
        let (buffer, other) = (filled(&tree), filled(&shuffled));
        for frame in buffer.frames() {
            for time in [At::Latest, At::Time(at(50)), At::Time(at(250))] {
                prop_assert_eq!(buffer.lookup("f0", &frame.name, time), other.lookup("f0", &frame.name, time));
            }
        }
    }

    #[test]
    fn interpolation_between_two_samples_is_proportional(from in any_isometry(), to in any_isometry(), ratio in 0..=100_i64) {
        let transforms = [stamped("a", "b", 0, &from), stamped("a", "b", 100, &to)];
        let found = filled(&transforms).lookup("a", "b", at(ratio)).unwrap().target_from_source;
        let share = ratio as f64 / 100.0;
        let turned = |to: &Isometry| angle((from.inverse() * *to).rotation);
        prop_assert!((turned(&found) - share * turned(&to)).abs() < 1e-9);
        let expected = from.translation.lerp(to.translation, share);
        prop_assert!((found.translation - expected).length() < 1e-9);
    }
}
