//! Behaviour of the executor in edge cases: full queues, slow modules, faults, shutdown.
#![allow(clippy::unwrap_used, missing_docs)]

use std::num::NonZeroUsize;
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use downbeat_executor::*;

const WATCHDOG: Duration = Duration::from_secs(30);

type Log = Arc<Mutex<Vec<String>>>;

/// Logs the messages of two topics. The second topic is subscribed first, so that the order of subscription
/// differs from that of publishing. Waits at the gate after the first message on "gate".
struct Listener {
    log: Log,
    heard: Sender<()>,
    gate: Option<std::sync::mpsc::Receiver<()>>,
}

impl Listener {
    fn note(&mut self, entry: String) {
        self.log.lock().unwrap().push(entry);
        self.heard.send(()).unwrap();
    }
}

impl Module for Listener {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe("second", |module: &mut Self, number: Received<'_, u64>, _: &mut Context<'_>| {
            module.note(format!("second {}", *number));
        })?;
        setup.subscribe("first", |module: &mut Self, number: Received<'_, u64>, _: &mut Context<'_>| {
            module.note(format!("first {}", *number));
        })?;
        setup.subscribe("gate", |module: &mut Self, _: Received<'_, u64>, _: &mut Context<'_>| {
            module.heard.send(()).unwrap();
            if let Some(gate) = module.gate.take() {
                gate.recv_timeout(WATCHDOG).unwrap();
            }
        })
    }
}

/// The log of a listener for messages that arrive while it is busy, one per cycle: "first 1", "second 1",
/// "first 2", "first 3".
fn heard_while_busy(inbox: Inbox, role: Role) -> Vec<String> {
    let mut core = Core::new();
    let (heard, waiting) = channel();
    let (opener, gate) = channel();
    let log = Log::default();
    let listener = Listener { log: Arc::clone(&log), heard, gate: Some(gate) };
    let options = ModuleOptions { synchrony: Synchrony::Detached(inbox), role, ..ModuleOptions::default() };
    core.add_with("listener", listener, options).unwrap();
    let [gate, first, second] = ["gate", "first", "second"].map(|topic| core.inlet::<u64>(topic).unwrap());
    gate.publish(0).unwrap();
    core.cycle().unwrap();
    waiting.recv_timeout(WATCHDOG).unwrap();
    for (inlet, number) in [(&first, 1), (&second, 1), (&first, 2), (&first, 3)] {
        inlet.publish(number).unwrap();
        core.cycle().unwrap();
    }
    opener.send(()).unwrap();
    core.stop();
    log.lock().unwrap().clone()
}

#[test]
fn a_busy_detached_module_receives_by_order_of_subscription_as_it_will_in_replay() {
    let heard = heard_while_busy(Inbox::KeepAll, Role::Part);
    assert_eq!(heard, ["second 1", "first 1", "first 2", "first 3"]);
}

#[test]
fn a_busy_detached_observer_receives_in_the_order_of_the_cycles() {
    let heard = heard_while_busy(Inbox::KeepAll, Role::Observer);
    assert_eq!(heard, ["first 1", "second 1", "first 2", "first 3"]);
}

#[test]
fn a_busy_topic_does_not_push_another_one_out_of_an_inbox() {
    let heard = heard_while_busy(Inbox::KeepLast(NonZeroUsize::MIN), Role::Part);
    assert_eq!(heard, ["second 1", "first 3"]);
}

/// Subscribes twice to one topic.
struct Twice(Log);

impl Module for Twice {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        for name in ["a", "b"] {
            setup.subscribe(
                "numbers",
                move |module: &mut Self, number: Received<'_, u64>, _: &mut Context<'_>| {
                    module.0.lock().unwrap().push(format!("{name} {}", *number));
                },
            )?;
        }
        Ok(())
    }
}

/// Collects the steps that it receives.
struct Steps(Arc<Mutex<Vec<DetachedStep>>>);

impl Module for Steps {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe(
            DetachedStep::TOPIC,
            |module: &mut Self, step: Received<'_, DetachedStep>, _: &mut Context<'_>| {
                module.0.lock().unwrap().push(step.clone());
            },
        )
    }
}

#[test]
fn a_message_that_a_detached_module_receives_twice_is_counted_once_in_its_step() {
    let mut core = Core::new();
    let (log, steps) = (Log::default(), Arc::default());
    let synchrony = Synchrony::Detached(Inbox::KeepLast(NonZeroUsize::MIN));
    let options = ModuleOptions { synchrony, ..ModuleOptions::default() };
    core.add_with("twice", Twice(Arc::clone(&log)), options).unwrap();
    let observer = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
    core.add_with("steps", Steps(Arc::clone(&steps)), observer).unwrap();
    let inlet = core.inlet::<u64>("numbers").unwrap();
    inlet.publish(7).unwrap();
    core.cycle().unwrap();
    core.stop();
    assert_eq!(*log.lock().unwrap(), ["a 7", "b 7"]);
    let steps = steps.lock().unwrap();
    let inputs: Vec<_> =
        steps.iter().flat_map(|step| &step.inputs).map(|input| (input.skipped, input.received)).collect();
    assert_eq!(inputs, [(0, 1)]);
}

#[test]
fn a_full_inlet_refuses_until_the_core_has_taken_what_waits() {
    let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    let inlet = core.inlet::<u64>("numbers").unwrap();
    for number in 0..Inlet::<u64>::CAPACITY as u64 {
        inlet.clone().publish(number).unwrap();
    }
    assert_eq!(inlet.publish(0), Err(InletError::Full(Inlet::<u64>::CAPACITY)));
    core.cycle().unwrap();
    assert_eq!(inlet.publish(0), Ok(()));
}

#[test]
fn an_inlet_of_a_core_that_was_stopped_refuses() {
    let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    let inlet = core.inlet::<u64>("numbers").unwrap();
    core.cycle().unwrap();
    core.stop();
    assert_eq!(inlet.publish(0), Err(InletError::Stopped));
}

struct Faulty {
    stopped: Arc<Mutex<bool>>,
}

impl Module for Faulty {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe("fault", |_: &mut Self, _: Received<'_, u64>, _: &mut Context<'_>| {
            panic!("a fault in a test");
        })
    }

    fn shutdown(&mut self, _: &mut Context<'_>) {
        *self.stopped.lock().unwrap() = true;
    }
}

impl Drop for Faulty {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            panic!("a fault in a drop of a test");
        }
    }
}

#[test]
fn a_detached_module_that_panicked_neither_holds_up_the_end_nor_is_stopped_again() {
    let mut core = Core::new();
    let stopped = Arc::default();
    let options =
        ModuleOptions { synchrony: Synchrony::Detached(Inbox::KeepAll), ..ModuleOptions::default() };
    core.add_with("faulty", Faulty { stopped: Arc::clone(&stopped) }, options).unwrap();
    let inlet = core.inlet::<u64>("fault").unwrap();
    for number in 0..10 {
        inlet.publish(number).unwrap();
        core.cycle().unwrap();
    }
    core.stop();
    assert!(!*stopped.lock().unwrap());
}

#[test]
fn a_panic_in_the_drop_of_a_module_stays_inside_the_core() {
    let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    for name in ["one", "two"] {
        core.add(name, Faulty { stopped: Arc::default() }).unwrap();
    }
    core.cycle().unwrap();
    core.stop();
    drop(core);
}

#[test]
fn next_event_tells_work_a_timer_or_nothing() {
    struct Idle;
    impl Module for Idle {
        type Ports = ();

        fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
            setup.every(Duration::from_millis(5), |_: &mut Self, _: &mut Context<'_>| ())
        }
    }
    let clock = ManualClock::new(Time::from_nanos(7));
    let mut core = Core::new().with_clock(clock.clone());
    assert_eq!(core.next_event(), None);
    core.add("idle", Idle).unwrap();
    assert_eq!(core.next_event(), Some(Time::from_nanos(7)), "the core has to start");
    core.cycle().unwrap();
    assert_eq!(core.next_event(), Some(Time::from_nanos(5_000_007)));
    core.handle().set("idle", "none", true);
    assert_eq!(core.next_event(), Some(Time::from_nanos(7)), "a request waits");
    core.stop();
    assert_eq!(core.next_event(), None);
}

/// Opens the gate when a warning is logged.
struct OpenOnWarning(Mutex<Sender<()>>);

impl tracing::Subscriber for OpenOnWarning {
    fn enabled(&self, metadata: &tracing::Metadata<'_>) -> bool {
        *metadata.level() == tracing::Level::WARN
    }

    fn new_span(&self, _: &tracing::span::Attributes<'_>) -> tracing::span::Id {
        tracing::span::Id::from_u64(1)
    }

    fn record(&self, _: &tracing::span::Id, _: &tracing::span::Record<'_>) {}

    fn record_follows_from(&self, _: &tracing::span::Id, _: &tracing::span::Id) {}

    fn event(&self, _: &tracing::Event<'_>) {
        // Fails only after the first warning, when the gate has been opened and dropped.
        let _ = self.0.lock().unwrap().send(());
    }

    fn enter(&self, _: &tracing::span::Id) {}

    fn exit(&self, _: &tracing::span::Id) {}
}

#[test]
fn a_stop_that_waits_for_a_detached_module_says_so() {
    let mut core = Core::new();
    let (heard, waiting) = channel();
    let (opener, gate) = channel();
    let log = Log::default();
    let listener = Listener { log: Arc::clone(&log), heard, gate: Some(gate) };
    let options =
        ModuleOptions { synchrony: Synchrony::Detached(Inbox::KeepAll), ..ModuleOptions::default() };
    core.add_with("listener", listener, options).unwrap();
    let [gate, first] = ["gate", "first"].map(|topic| core.inlet::<u64>(topic).unwrap());
    gate.publish(0).unwrap();
    core.cycle().unwrap();
    waiting.recv_timeout(WATCHDOG).unwrap();
    first.publish(1).unwrap();
    core.cycle().unwrap();
    // The module returns only because of the warning. After a time-out at its watchdog it would panic and log
    // nothing more.
    tracing::subscriber::with_default(OpenOnWarning(Mutex::new(opener)), || core.stop());
    assert_eq!(*log.lock().unwrap(), ["first 1"]);
}

/// Forwards the messages of one topic to another.
struct Relay {
    from: &'static str,
    to: &'static str,
    log: Log,
}

impl Module for Relay {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let out = setup.publish::<u64>(self.to)?;
        setup.subscribe(
            self.from,
            move |relay: &mut Self, number: Received<'_, u64>, ctx: &mut Context<'_>| {
                relay.log.lock().unwrap().push(format!("{} {}", relay.from, *number));
                ctx.publish(out, *number);
            },
        )
    }
}

#[test]
fn what_is_passed_on_while_the_core_stops_reaches_who_still_runs() {
    let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    let (log, first) = (Log::default(), core.inlet::<u64>("a").unwrap());
    // Modules stop in the reverse order of registration, so each receiver must stop after its sender.
    for (from, to) in [("e", "f"), ("d", "e"), ("c", "d"), ("b", "c"), ("a", "b")] {
        core.add(from, Relay { from, to, log: Arc::clone(&log) }).unwrap();
    }
    core.cycle().unwrap();
    first.publish(7).unwrap();
    core.stop();
    assert_eq!(*log.lock().unwrap(), ["a 7", "b 7", "c 7", "d 7", "e 7"]);
}
