//! Modules in the executor alone: a core with a manually advanced clock, under several launchers.

use std::error::Error;
use std::sync::mpsc::{Sender, channel};
use std::time::Duration;

use downbeat_executor::{
    Context, Core, Launcher, Linear, ManualClock, Module, Pool, Publication, Received, Setup, SetupError,
    Threads, Time,
};

const PERIOD: Duration = Duration::from_millis(10);

/// Commands a forward speed, m/s, that approaches the goal by at most 0.02 m/s every 10 ms.
#[derive(Default)]
struct Ramp {
    goal: f64,
    speed: f64,
}

struct RampPorts {
    speed: Publication<f64>,
}

impl Module for Ramp {
    type Ports = RampPorts;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<RampPorts, SetupError> {
        setup.subscribe::<f64, _>("goal_speed", |ramp, goal, _| ramp.goal = *goal)?;
        setup.every(PERIOD, Self::tick)?;
        Ok(RampPorts { speed: setup.publish("speed")? })
    }
}

impl Ramp {
    fn tick(&mut self, ctx: &mut Context<'_, RampPorts>) {
        self.speed += (self.goal - self.speed).clamp(-0.02, 0.02);
        ctx.publish(ctx.ports.speed, self.speed);
    }
}

/// Reports each speed with the time at which it was published.
struct Log(Sender<String>);

impl Module for Log {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe("speed", Self::report)
    }
}

impl Log {
    fn report(&mut self, speed: Received<'_, f64>, _: &mut Context<'_>) {
        // The receiver is dropped only after the core has stopped.
        let _ = self.0.send(format!("{} s  {:.2} m/s", speed.time(), *speed));
    }
}

/// Runs eight cycles of 10 ms each and returns what the log reports.
fn run(launcher: impl Launcher + 'static) -> Result<Vec<String>, Box<dyn Error>> {
    let clock = ManualClock::new(Time::ZERO);
    let mut core = Core::new().with_launcher(launcher).with_clock(clock.clone());
    let (sender, lines) = channel();
    core.add("ramp", Ramp::default())?;
    core.add("log", Log(sender))?;
    core.inlet("goal_speed")?.publish(0.1_f64)?;
    for _ in 0..8 {
        core.cycle()?;
        clock.advance(PERIOD);
    }
    core.stop();
    Ok(lines.try_iter().collect())
}

fn main() -> Result<(), Box<dyn Error>> {
    let lines = run(Linear)?;
    lines.iter().for_each(|line| println!("{line}"));
    if run(Pool::new(2)?)? != lines || run(Threads::new())? != lines {
        return Err("the launchers give different results".into());
    }
    println!("the same on one thread, on two threads, and on a thread per module");
    Ok(())
}
