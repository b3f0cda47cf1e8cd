//! What a picture of the simulated camera costs, and a second of simulated time.
#![allow(clippy::unwrap_used, missing_docs)]

use criterion::{Criterion, criterion_group, criterion_main};
use downbeat_physics::camera::{Camera, Scene};
use downbeat_physics::{Ball, Field, SimulatedRobot, SimulationOptions, WorldFile};
use downbeat_transforms::Isometry;
use glam::{DQuat, DVec3};
use std::hint::black_box;
use std::time::Duration;

/// The field from the height of the camera, straight ahead and slightly down: floor, lines, posts and ball in
/// the picture.
fn camera(c: &mut Criterion) {
    let ball = Ball { position: [0.5, 0.05], ..Ball::default() };
    let file = WorldFile { field: Some(Field::default()), ball: Some(ball), ..WorldFile::default() };
    let scene = Scene::new(&file, |_| None);
    let forward = DQuat::from_rotation_z(-std::f64::consts::FRAC_PI_2)
        * DQuat::from_rotation_x(-std::f64::consts::FRAC_PI_2);
    let at =
        Isometry { translation: DVec3::new(0.0, 0.0, 0.45), rotation: DQuat::from_rotation_y(0.3) * forward };
    c.bench_function("camera/320x240", |b| b.iter(|| scene.render(&Camera::darwin_op(), black_box(&at))));
}

fn standing(c: &mut Criterion) {
    let mut group = c.benchmark_group("a second of a standing robot");
    group.sample_size(10);
    for step_ms in [4, 2] {
        let options =
            SimulationOptions { step: Duration::from_millis(step_ms), ..SimulationOptions::darwin_op() };
        let mut robot = SimulatedRobot::new(options, 1).unwrap();
        robot.run_for(Duration::from_secs(2)).unwrap();
        let second = |robot: &mut SimulatedRobot| robot.run_for(Duration::from_secs(1)).unwrap();
        group.bench_function(format!("{step_ms} ms"), |b| b.iter(|| second(&mut robot)));
    }
}

criterion_group!(benches, camera, standing);
criterion_main!(benches);
