//! A custom launcher: two fixed groups of modules, each on its own thread.
//!
//! A robot may need its control modules on one CPU and all others on another, without modules that migrate.
//! This launcher groups modules by their slots: those in odd slots run on a second thread. As always, the
//! launcher changes nothing about the result, and the example ends by comparing it with that of `Linear`.
//!
//! ```sh
//! cargo run --bin launcher
//! ```

use std::error::Error;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::thread::JoinHandle;

use downbeat_executor::{
    Context, Core, Launcher, Linear, ManualClock, Module, Received, Setup, SetupError, Stage, ThreadError,
    ThreadOptions, Time,
};

/// Runs the modules in even slots on the core's thread and those in odd slots on another.
struct EvenAndOdd {
    /// `Some` until the drop, which takes it to end the thread.
    odd: Option<SyncSender<Arc<Stage>>>,
    done: Receiver<()>,
    thread: Option<JoinHandle<()>>,
}

impl EvenAndOdd {
    fn new(options: &ThreadOptions) -> Result<Self, ThreadError> {
        let (odd, stages) = sync_channel::<Arc<Stage>>(1);
        let (report, done) = channel();
        let life = move || {
            for stage in stages {
                run_group(&stage, 1);
                // Drop the stage before reporting: the core then changes its contents.
                drop(stage);
                if report.send(()).is_err() {
                    return;
                }
            }
        };
        Ok(Self { odd: Some(odd), done, thread: Some(options.spawn("odd", life)?) })
    }
}

fn run_group(stage: &Stage, group: usize) {
    (0..stage.runnable()).filter(|&nth| stage.slot(nth) % 2 == group).for_each(|nth| stage.run_nth(nth));
}

impl Launcher for EvenAndOdd {
    fn process(&mut self, stage: &mut Arc<Stage>) {
        let is_sent = self.odd.as_ref().is_some_and(|odd| odd.send(Arc::clone(stage)).is_ok());
        run_group(stage, 0);
        if is_sent {
            // Fails only if the thread has panicked, which also drops the stage.
            let _ = self.done.recv();
        } else {
            run_group(stage, 1);
        }
    }
}

impl Drop for EvenAndOdd {
    fn drop(&mut self) {
        self.odd = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Mixes received messages into a number that depends on every message and on their order, and publishes it.
struct Mixer {
    number: u64,
    listens: [&'static str; 2],
    publishes: &'static str,
    results: Sender<(&'static str, u64)>,
}

impl Module for Mixer {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let out = setup.publish(self.publishes)?;
        for topic in self.listens {
            setup.subscribe(
                topic,
                move |mixer: &mut Self, heard: Received<'_, u64>, ctx: &mut Context<'_>| {
                    mixer.number = mixer.number.rotate_left(7).wrapping_mul(0x9e37_79b9).wrapping_add(*heard);
                    // Both messages of a cycle arrive before the next one is published.
                    if mixer.listens[1] == topic {
                        ctx.publish(out, mixer.number);
                    }
                },
            )?;
        }
        Ok(())
    }

    fn shutdown(&mut self, _: &mut Context<'_>) {
        let _ = self.results.send((self.publishes, self.number));
    }
}

/// Returns the numbers of four modules after 1000 cycles.
fn results(launcher: impl Launcher + 'static) -> Result<Vec<(&'static str, u64)>, Box<dyn Error>> {
    let clock = ManualClock::new(Time::ZERO);
    let mut core = Core::new().with_launcher(launcher).with_clock(clock);
    let (results, received) = channel();
    for (number, listens, publishes) in
        [(1, ["d", "c"], "a"), (2, ["a", "d"], "b"), (3, ["a", "b"], "c"), (4, ["b", "c"], "d")]
    {
        core.add(publishes, Mixer { number, listens, publishes, results: results.clone() })?;
    }
    for topic in ["a", "b", "c", "d"] {
        core.inlet(topic)?.publish(1_u64)?;
    }
    for _ in 0..1000 {
        core.cycle()?;
    }
    core.stop();
    Ok(received.try_iter().collect())
}

fn main() -> Result<(), Box<dyn Error>> {
    let expected = results(Linear)?;
    let found = results(EvenAndOdd::new(&ThreadOptions::default())?)?;
    for (module, number) in &found {
        println!("module {module} has come to {number:016x}");
    }
    if found != expected {
        return Err(format!("under Linear it was {expected:x?}").into());
    }
    println!("the same as under Linear");
    Ok(())
}
