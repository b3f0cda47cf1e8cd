//! The transform buffer compared with scipy, and in modules of a core.
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat_executor::{Context, Core, ManualClock, Module, Setup, SetupError, Time};
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::geometry_msgs::msg::{Quaternion, TransformStamped, Vector3};
use downbeat_msgs::tf2_msgs::msg::TFMessage;
use downbeat_transforms::{At, LookupError, TransformBroadcaster, TransformBuffer, listen};
use fuzzing::Random;
use python_peer::{Python, printed, with_file};
use serde_json::{Value, json};
use std::fs::File;
use std::sync::mpsc::{Sender, channel};
use std::time::Duration;

/// From -1 to 1.
fn unit(random: &mut Random) -> f64 {
    (random.bits() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

fn below(random: &mut Random, end: i64) -> i64 {
    (random.bits() % end.unsigned_abs()).cast_signed()
}

fn quaternion(random: &mut Random) -> Quaternion {
    loop {
        let [x, y, z, w] = std::array::from_fn(|_| unit(random));
        let norm = (x * x + y * y + z * z + w * w).sqrt();
        if (0.1..=1.0).contains(&norm) {
            return Quaternion { x: x / norm, y: y / norm, z: z / norm, w: w / norm };
        }
    }
}

/// The results of scipy; `None` without Python.
fn scipy(asked: &Value) -> Option<Vec<[f64; 7]>> {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/transforms/scipy_lookup.py");
    let answer = with_file(&asked.to_string(), |file| {
        let input = File::open(file).unwrap();
        Some(printed(Python::find()?.command(script).stdin(input)))
    })?;
    Some(serde_json::from_str(&answer).unwrap())
}

#[test]
fn every_lookup_agrees_with_scipy() {
    const SECOND: i64 = 1_000_000_000;
    let (mut numbers, mut buffer) = (Random::new(1), TransformBuffer::new());
    let start = 1_795_239_822 * SECOND;
    let mut transforms = Vec::new();
    for child in 1..25 {
        let (parent, is_static) = (below(&mut numbers, child), below(&mut numbers, 4) == 0);
        let mut time = start;
        while time <= start + 9 * SECOND {
            let stamped = random_transform(&mut numbers, parent, child, time);
            if is_static {
                buffer.insert_static(&stamped).unwrap();
            } else {
                buffer.insert(&stamped).unwrap();
            }
            let (Vector3 { x, y, z }, rotation) = (stamped.transform.translation, stamped.transform.rotation);
            transforms.push(json!({
                "parent": parent.to_string(), "child": child.to_string(), "time": time, "is_static": is_static,
                "translation": [x, y, z], "rotation": [rotation.x, rotation.y, rotation.z, rotation.w],
            }));
            time += 100_000_000 + below(&mut numbers, 900_000_000);
        }
    }
    let queries: Vec<_> = (0..1000)
        .map(|_| (below(&mut numbers, 25), below(&mut numbers, 25), start + below(&mut numbers, 8 * SECOND)))
        .collect();
    let query = |&(target, source, time): &(i64, i64, i64)| json!({"target": target.to_string(), "source": source.to_string(), "time": time});
    let asked = json!({"transforms": transforms, "queries": queries.iter().map(query).collect::<Vec<_>>()});
    let Some(answers) = scipy(&asked) else { return };
    assert_eq!(answers.len(), queries.len());
    let mut worst = 0.0_f64;
    for (&(target, source, time), theirs) in queries.iter().zip(answers) {
        let found = buffer.lookup(&target.to_string(), &source.to_string(), Time::from_nanos(time)).unwrap();
        let (translation, rotation) =
            (found.target_from_source.translation, found.target_from_source.rotation);
        // Both signs of a quaternion are the same rotation.
        let dot: f64 = rotation.to_array().iter().zip(&theirs[3..]).map(|(one, other)| one * other).sum();
        let theirs_rotation = theirs[3..].iter().map(|number| number * dot.signum());
        let ours = translation.to_array().into_iter().chain(rotation.to_array());
        let theirs = theirs[..3].iter().copied().chain(theirs_rotation);
        worst = ours.zip(theirs).map(|(one, other)| (one - other).abs()).fold(worst, f64::max);
    }
    assert!(worst < 1e-12, "the worst difference is {worst}");
}

fn random_transform(numbers: &mut Random, parent: i64, child: i64, time: i64) -> TransformStamped {
    let mut stamped = TransformStamped { child_frame_id: child.to_string(), ..TransformStamped::default() };
    stamped.header.frame_id = parent.to_string();
    stamped.header.stamp = Stamp::from_nanos(time);
    stamped.transform.translation = Vector3 { x: unit(numbers), y: unit(numbers), z: unit(numbers) };
    stamped.transform.rotation = quaternion(numbers);
    stamped
}

/// Walks at 1 m/s, and publishes static transforms of its sensors one after another.
struct Walker {
    sensors: Vec<&'static str>,
}

impl Module for Walker {
    type Ports = TransformBroadcaster;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Self::Ports, SetupError> {
        setup.every(Duration::from_millis(100), Self::walk)?;
        TransformBroadcaster::declare(setup)
    }
}

impl Walker {
    fn walk(&mut self, ctx: &mut Context<'_, TransformBroadcaster>) {
        let stamp = Stamp::from_nanos(ctx.now().as_nanos());
        let transform = |parent: &str, child: &str, x| {
            let mut transform =
                TransformStamped { child_frame_id: child.into(), ..TransformStamped::default() };
            (transform.header.frame_id, transform.header.stamp) = (parent.into(), stamp);
            transform.transform.translation.x = x;
            transform
        };
        let transforms = ctx.ports;
        transforms.send(ctx, [transform("odom", "base_link", ctx.now().as_nanos() as f64 / 1e9)]);
        if let Some(sensor) = self.sensors.pop() {
            transforms.send_static(ctx, [transform("base_link", sensor, 0.5)]);
        }
    }
}

/// Reports where the camera was 50 ms ago.
struct Looker {
    transforms: TransformBuffer,
    found: Sender<Result<f64, LookupError>>,
}

impl Module for Looker {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        listen(setup, |looker| &mut looker.transforms)?;
        setup.every(Duration::from_millis(100), |looker: &mut Self, ctx| {
            let found = looker.transforms.lookup("odom", "camera", ctx.now() - Duration::from_millis(150));
            looker.found.send(found.map(|found| found.target_from_source.translation.x)).unwrap();
        })
    }
}

/// Passes on static transforms.
struct Fixed(Sender<Vec<String>>);

impl Module for Fixed {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe::<TFMessage, _>("tf_static", |fixed: &mut Self, message, _| {
            let frames = message.transforms.iter().map(|transform| transform.child_frame_id.clone());
            fixed.0.send(frames.collect()).unwrap();
        })
    }
}

#[test]
fn a_module_looks_up_what_another_one_publishes() {
    let clock = ManualClock::new(Time::ZERO);
    let mut core = Core::new().with_clock(clock.clone());
    let (found, finds) = channel();
    let (fixed, frames) = channel();
    core.add("walker", Walker { sensors: vec!["lidar", "camera"] }).unwrap();
    core.add("looker", Looker { transforms: TransformBuffer::new(), found }).unwrap();
    core.add("fixed", Fixed(fixed)).unwrap();
    for _ in 0..6 {
        core.cycle().unwrap();
        core.cycle().unwrap();
        clock.advance(Duration::from_millis(100));
    }
    let finds: Vec<_> = finds.try_iter().collect();
    assert!(matches!(finds[0], Err(LookupError::UnknownFrame { .. })), "{finds:?}");
    assert!(matches!(finds[1], Err(LookupError::Extrapolation { .. })), "{finds:?}");
    let last = finds.last().unwrap().as_ref().unwrap();
    assert!((last - (0.5 - 0.15 + 0.5)).abs() < 1e-12, "{last}");
    let frames: Vec<_> = frames.try_iter().collect();
    assert_eq!(
        frames,
        [vec!["camera".to_owned()], vec!["camera".into(), "lidar".into()]],
        "the last one has all"
    );
}

#[test]
fn refused_transforms_change_nothing_and_do_not_stop_the_module() {
    let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    let (found, _finds) = channel();
    core.add("looker", Looker { transforms: TransformBuffer::new(), found }).unwrap();
    let tf = core.inlet::<TFMessage>("tf").unwrap();
    for transforms in [vec![], vec![TransformStamped::default(); 3]] {
        tf.publish(TFMessage { transforms }).unwrap();
    }
    core.cycle().unwrap();
    core.cycle().unwrap();
    assert_eq!(core.modules()[0].state, downbeat_executor::LifecycleState::Active);
    assert!(TransformBuffer::new().lookup("a", "a", At::Latest).is_err());
}
