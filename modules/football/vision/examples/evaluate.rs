//! Evaluates the detector on simulated pictures:
//! `cargo run --release -p downbeat-vision --example evaluate [PICTURES]`, 2000 by default. Fails if ball
//! recall, ball precision or the median error miss their goals.
#![allow(clippy::unwrap_used)]

#[path = "../tests/evaluation/mod.rs"]
mod evaluation;

use evaluation::{Near, Totals, evaluate, evaluate_near};
use std::process::ExitCode;

fn main() -> ExitCode {
    let pictures = std::env::args().nth(1).map_or(2000, |text| text.parse().expect("a number of pictures"));
    let mut totals = Totals::default();
    // Other pictures than those of the tests.
    (1000..1000 + pictures).for_each(|seed| evaluate(seed, &mut totals));
    println!("{pictures} simulated pictures: {totals}");
    let mut near = Near::default();
    (1000..1000 + pictures / 4).for_each(|seed| evaluate_near(seed, &mut near));
    println!("{} pictures of a ball at the feet: {near}", pictures / 4);
    let is_good = totals.recall() >= 0.95 && totals.precision() >= 0.98 && totals.median_error() < 0.05;
    if is_good { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
