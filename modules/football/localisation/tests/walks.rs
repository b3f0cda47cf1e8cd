//! The filter on seeded walks.
#![allow(clippy::unwrap_used, missing_docs)]

mod walk;

use downbeat_localisation::Filter;
use walk::Walk;

/// How many walks each test takes: more in `cargo xtask football`.
fn walks() -> u64 {
    std::env::var("DOWNBEAT_WALKS").map_or(20, |walks| walks.parse().unwrap())
}

fn filter_at_the_start(walk: &Walk, seed: u64) -> Filter {
    Filter::new(&walk.field, &[walk.truth], (0.3, 0.2), seed)
}

fn share(sorted: &mut [f64], of: f64) -> f64 {
    sorted.sort_by(f64::total_cmp);
    sorted[((sorted.len() - 1) as f64 * of) as usize]
}

/// Errors of position (m) and heading (rad) at each of 600 pictures, without the first seconds, which are for
/// settling.
fn errors_of(walk: &mut Walk, filter: &mut Filter) -> Vec<(f64, f64)> {
    let pictures = (0..600).map(|_| {
        let step = walk.step();
        filter.walk(step);
        let seen = walk.see();
        walk.error(filter.see(&seen).pose)
    });
    pictures.skip(50).collect()
}

#[test]
fn twenty_walks_are_followed() {
    let (mut metres, mut radians) = (Vec::new(), Vec::new());
    for seed in 0..walks() {
        let mut walk = Walk::new(seed);
        let mut filter = filter_at_the_start(&walk, seed);
        for (off, turned) in errors_of(&mut walk, &mut filter) {
            metres.push(off);
            radians.push(turned);
        }
    }
    let found = [
        share(&mut metres, 0.5),
        share(&mut metres, 0.95),
        share(&mut radians, 0.5).to_degrees(),
        share(&mut radians, 0.95).to_degrees(),
    ];
    println!(
        "median {:.3} m, 95 % {:.3} m; heading: median {:.2}, 95 % {:.2} degrees",
        found[0], found[1], found[2], found[3]
    );
    assert!(found[0] <= 0.10 && found[1] <= 0.30 && found[3] <= 5.0, "{found:?}");
}

/// As measured in matches: 0.03 rad of all pictures, and as much between them.
#[test]
fn a_robot_that_nods_and_does_not_know_the_pitch_of_its_camera_is_followed() {
    let mut metres = Vec::new();
    for seed in 200..200 + walks() {
        let mut walk = Walk::new(seed);
        walk.pitch = (if seed % 2 == 0 { -0.03 } else { 0.03 }, 0.03);
        let mut filter = filter_at_the_start(&walk, seed);
        metres.extend(errors_of(&mut walk, &mut filter).into_iter().map(|(off, _)| off));
    }
    let found = [share(&mut metres, 0.5), share(&mut metres, 0.95)];
    println!("median {:.3} m, 95 % {:.3} m", found[0], found[1]);
    assert!(found[0] <= 0.11, "{found:?}");
}

#[test]
fn a_kidnapped_robot_finds_back_within_ten_seconds() {
    let mut back = 0;
    for seed in 100..100 + walks() {
        let mut walk = Walk::new(seed);
        let mut filter = filter_at_the_start(&walk, seed);
        for _ in 0..300 {
            let step = walk.step();
            filter.walk(step);
            filter.see(&walk.see());
        }
        let turn = walk.kidnap();
        filter.walk(turn);
        let mut good = 0;
        for _ in 0..100 {
            let step = walk.step();
            filter.walk(step);
            let seen = walk.see();
            let (off, turned) = walk.error(filter.see(&seen).pose);
            good = if off < 0.4 && turned < 0.2 { good + 1 } else { 0 };
        }
        println!("{seed}: within 0.4 m and 0.2 rad for the last {good} of 100 pictures");
        back += u64::from(good >= 5);
    }
    println!("{back} of {} are back", walks());
    assert!(back * 20 >= walks() * 18, "{back} of {}", walks());
}

#[test]
fn the_same_inputs_give_the_same_bits() {
    let run = || {
        let mut walk = Walk::new(5);
        let mut filter = filter_at_the_start(&walk, 5);
        (0..100)
            .map(|_| {
                let step = walk.step();
                filter.walk(step);
                filter.see(&walk.see())
            })
            .collect::<Vec<_>>()
    };
    assert_eq!(run(), run());
}
