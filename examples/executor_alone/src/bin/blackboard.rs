//! A custom mechanism: a blackboard on which all modules read and write values by name.
//!
//! While modules run they all read the same board, without a lock. Their writes are queued until all modules
//! have run; then the mechanism applies them in the order of registration of the modules, so that every
//! launcher gives the same board. When a module is removed, its entries are removed as well.
//!
//! ```sh
//! cargo run --bin blackboard
//! ```

use std::collections::BTreeMap;
use std::error::Error;
use std::sync::mpsc::{Sender, channel};
use std::time::Duration;

use downbeat_executor::{
    Context, Core, Launcher, Linear, ManualClock, Mechanism, MechanismKey, Module, ModuleId, Pool, Setup,
    SetupError, SyncPhase, Threads, Time, Version,
};

/// The mechanism.
struct Blackboard;

/// A value that a module has written and that is not applied yet.
struct Entry {
    name: &'static str,
    value: f64,
}

/// The board as modules see it: values with the modules that wrote them.
#[derive(Default)]
struct Board(BTreeMap<&'static str, (f64, ModuleId)>);

impl Board {
    fn value(&self, name: &str) -> Option<f64> {
        self.0.get(name).map(|&(value, _)| value)
    }
}

impl Mechanism for Blackboard {
    type View = Board;
    type Port = Vec<Entry>;

    const NAME: &'static str = "blackboard";
    const VERSION: Version = Version::new(1, 0);

    fn view(&self) -> Board {
        Board::default()
    }

    fn sync(&mut self, phase: &mut SyncPhase<'_>) {
        let mut board = std::mem::take(phase.view::<Self>());
        phase.each_port::<Self>(|module, entries| {
            for Entry { name, value } in entries.drain(..) {
                board.0.insert(name, (value, module));
            }
        });
        *phase.view::<Self>() = board;
    }

    fn module_left(&mut self, module: ModuleId, phase: &mut SyncPhase<'_>) {
        phase.view::<Self>().0.retain(|_, (_, writer)| *writer != module);
    }
}

const PERIOD: Duration = Duration::from_millis(8);

/// Writes the temperature of a motor, which rises in each run. Leaves when the motor is hot.
struct Motor {
    temperature: f64,
}

impl Module for Motor {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let board = setup.mechanism::<Blackboard>(Version::new(1, 0))?;
        setup.every(PERIOD, move |motor: &mut Self, ctx: &mut Context<'_>| motor.warm_up(board, ctx))
    }
}

impl Motor {
    fn warm_up(&mut self, board: MechanismKey<Blackboard>, ctx: &mut Context<'_>) {
        self.temperature += if ctx.view(board).value("fan") == Some(1.0) { 1.0 } else { 5.0 };
        ctx.ask(board, Entry { name: "temperature", value: self.temperature });
        if self.temperature > 36.0 {
            ctx.remove_self();
        }
    }
}

/// Switches the fan according to the temperature on the board.
struct Fan {
    heard: Sender<String>,
}

impl Module for Fan {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let board = setup.mechanism::<Blackboard>(Version::new(1, 0))?;
        setup.every(PERIOD, move |fan: &mut Self, ctx: &mut Context<'_>| {
            let temperature = ctx.view(board).value("temperature");
            let is_on = temperature.is_some_and(|celsius| celsius >= 30.0);
            ctx.ask(board, Entry { name: "fan", value: f64::from(u8::from(is_on)) });
            let seen = temperature.map_or("no motor".to_owned(), |celsius| format!("{celsius} °C"));
            let _ = fan.heard.send(format!("{seen}, fan {}", if is_on { "on" } else { "off" }));
        })
    }
}

/// Returns what the fan has read and done in seven periods and at the end.
fn run(launcher: impl Launcher + 'static) -> Result<Vec<String>, Box<dyn Error>> {
    let clock = ManualClock::new(Time::ZERO);
    let mut core = Core::new().with_launcher(launcher).with_clock(clock.clone()).with_mechanism(Blackboard);
    let (heard, log) = channel();
    core.add("motor", Motor { temperature: 20.0 })?;
    core.add("fan", Fan { heard })?;
    for _ in 0..8 {
        core.cycle()?;
        clock.advance(PERIOD);
    }
    core.stop();
    Ok(log.try_iter().collect())
}

fn main() -> Result<(), Box<dyn Error>> {
    let log = run(Linear)?;
    for line in &log {
        println!("{line}");
    }
    // The motor sees what the fan does one period later. The hot motor leaves, and its entry is removed with
    // it.
    let expected = [
        "no motor, fan off",
        "25 °C, fan off",
        "30 °C, fan on",
        "35 °C, fan on",
        "36 °C, fan on",
        "no motor, fan off",
        "no motor, fan off",
        "no motor, fan off",
    ];
    if log != expected || log != run(Pool::new(2)?)? || log != run(Threads::new())? {
        return Err(format!("expected {expected:?}, under every launcher").into());
    }
    println!("the same under every launcher");
    Ok(())
}
