//! How long a module is that listens, ticks and publishes: half a screen, from `struct` to the last brace.
//!
//! ```sh
//! cargo run -p downbeat-executor --example half_a_screen
//! ```

use std::error::Error;
use std::time::Duration;

use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time};

/// Commands a forward speed, m/s, that goes towards what was asked for by at most 0.02 m/s every 10 ms.
#[derive(Default)]
struct Ramp {
    goal: f64,
    speed: f64,
}

impl Module for Ramp {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let speed = setup.publish::<f64>("speed")?;
        setup.subscribe::<f64, _>("goal_speed", |ramp, goal, _| ramp.goal = *goal)?;
        setup.every(Duration::from_millis(10), move |ramp, ctx| {
            ramp.speed += (ramp.goal - ramp.speed).clamp(-0.02, 0.02);
            ctx.publish(speed, ramp.speed);
        })
    }
}

/// Prints what it hears.
struct Printer;

impl Module for Printer {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe::<f64, _>("speed", |_, speed, ctx| println!("{} s  {:.2} m/s", ctx.now(), *speed))
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let clock = ManualClock::new(Time::ZERO);
    let mut core = Core::new().with_clock(clock.clone());
    core.add("ramp", Ramp::default())?;
    core.add("printer", Printer)?;
    core.inlet("goal_speed")?.publish(0.1_f64)?;
    for _ in 0..8 {
        core.cycle()?;
        clock.advance(Duration::from_millis(10));
    }
    core.stop();
    Ok(())
}
