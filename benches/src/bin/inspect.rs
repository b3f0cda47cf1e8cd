//! Measures the cost of measuring runs and cycles: the same robot with and without, in turns.

use std::io::Write as _;
use std::time::Duration;

use benches::contestants::Contestant;
use benches::measure::{Effort, best_of_rounds};
use benches::{Football, Relay, launchers};

fn main() -> anyhow::Result<()> {
    let effort = Effort { rounds: 200, turn: Duration::from_millis(20), budget: Duration::from_secs(30) };
    let mut out = std::io::stdout();
    for launcher in launchers::LAUNCHERS.iter().filter(|launcher| launcher.name != launchers::THREADS) {
        let mut contestants: Vec<Box<dyn Contestant>> = vec![
            Box::new(Football::new(launcher.launch)?),
            Box::new(Football::new(|core| (launcher.launch)(core.without_times()))?),
            Box::new(Relay::new(launcher.launch)?),
            Box::new(Relay::new(|core| (launcher.launch)(core.without_times()))?),
        ];
        let times = best_of_rounds(&mut contestants, effort);
        for (what, pair) in ["football robot", "one hop"].iter().zip(times.chunks(2)) {
            let (with, without) = (nanoseconds(pair[0]), nanoseconds(pair[1]));
            let cost = 100.0 * (with / without - 1.0);
            let name = launcher.name;
            writeln!(
                out,
                "{name:>8} {what:>15}: {with:7.0} ns a cycle, {without:7.0} without times: {cost:+.1} %"
            )?;
        }
    }
    Ok(())
}

fn nanoseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e9
}
