//! A seeded part of the evaluation on simulated pictures;
//! `cargo run --release -p downbeat-vision --example evaluate` runs the whole.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "evaluation/mod.rs"]
mod evaluation;

use evaluation::{Near, Totals, evaluate, evaluate_near};

#[test]
fn balls_places_and_robots_with_their_teams_are_found_in_varied_pictures() {
    let mut totals = Totals::default();
    for seed in 0..100 {
        evaluate(seed, &mut totals);
    }
    println!("{totals}");
    assert!(totals.balls >= 20, "{totals}");
    assert!(totals.recall() >= 0.9 && totals.precision() >= 0.95, "{totals}");
    assert!(totals.median_error() < 0.05, "{totals}");
    let robots = &totals.robots;
    assert!(robots.standing[0] >= 20 && robots.recall() >= 0.75 && robots.precision() >= 0.85, "{totals}");
    assert!(robots.teams[0] >= 20 && robots.team_precision() >= 0.85, "{totals}");
}

#[test]
fn a_robot_at_the_ball_is_found_by_the_part_of_it_in_the_picture() {
    let mut near = Near::default();
    for seed in 0..40 {
        evaluate_near(seed, &mut near);
    }
    println!("{near}");
    assert!(near.robots >= 15 && near.found * 20 >= near.robots * 19, "{near}");
    assert!(near.lying == 0 && near.teams[1] == 0 && near.wrong <= 4, "{near}");
}

#[test]
fn black_white_and_noisy_pictures_end_without_balls() {
    use downbeat_vision::{Encoding, Exposure, Picture};
    let mut detector = evaluation::detector();
    let view = evaluation::view_at(0.45, 0.5, 0.0);
    for (grey, expected) in [(0, Exposure::Black), (255, Exposure::White), (128, Exposure::NoCarpet)] {
        let data = vec![grey; 320 * 240 * 3];
        let picture = Picture::new([320, 240], 960, Encoding::Rgb8, &data).unwrap();
        let seen = detector.see(&picture, &view);
        assert_eq!(seen.exposure, expected);
        assert!(seen.balls.is_empty() && seen.lines.is_empty());
    }
    let mut random = fastrand::Rng::with_seed(7);
    for size in [[320, 240], [16, 16], [17, 900], [640, 480]] {
        let data: Vec<u8> = (0..size[0] * size[1] * 3).map(|_| random.u8(..)).collect();
        let picture = Picture::new(size, size[0] as usize * 3, Encoding::Rgb8, &data).unwrap();
        for tilt in [-1.5, 0.0, 0.4, 1.5] {
            let mut view = evaluation::view_at(0.45, tilt, 0.1);
            view.camera.size = size;
            assert!(detector.see(&picture, &view).balls.len() <= 8);
        }
    }
}
