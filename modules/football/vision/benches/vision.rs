//! One picture, from bytes to what is seen: a field with ball and robots, rendered here, at both sizes; and
//! the picture of a real camera. The goals are 8 ms at 320 x 240 and 25 ms at 640 x 480.
#![allow(missing_docs, clippy::unwrap_used)]

#[path = "../tests/evaluation/mod.rs"]
#[allow(dead_code)]
mod evaluation;

use criterion::{Criterion, criterion_group, criterion_main};
use downbeat_physics::camera::{Camera as Rendered, Scene};
use downbeat_physics::{Ball, Field, WorldFile};
use downbeat_vision::{Encoding, Picture};
use std::hint::black_box;

fn pictures(c: &mut Criterion) {
    let mut detector = evaluation::detector();
    for scale in [1_u32, 2] {
        let mut view = evaluation::view_at(0.45, 0.3, 0.02);
        view.camera.size = view.camera.size.map(|size| size * scale);
        view.camera.focal *= f64::from(scale);
        view.camera.centre = (glam::DVec2::new(320.0, 240.0) * f64::from(scale) - 1.0) / 2.0;
        let [width, height] = view.camera.size;
        let ball = Ball { position: [1.0, 0.1], ..Ball::default() };
        let file = WorldFile { ball: Some(ball), field: Some(Field::default()), ..WorldFile::default() };
        let camera = Rendered { width, height, focal: view.camera.focal.to_array() };
        let data = Scene::new(&file, |_| None).render(&camera, &view.ground_from_camera);
        c.bench_function(&format!("{width} x {height}"), |bencher| {
            bencher.iter(|| {
                let picture =
                    Picture::new([width, height], width as usize * 3, Encoding::Rgb8, black_box(&data))
                        .unwrap();
                detector.see(&picture, &view)
            });
        });
    }
}

criterion_group!(benches, pictures);
criterion_main!(benches);
