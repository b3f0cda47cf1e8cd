//! When one module replaces another, requests to and from the first one do not reach the second.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use common::*;
use downbeat_executor::*;

const PANIC: &str = "a module that panics, as this test wants it";

fn restart(backoff: Duration) -> ModuleOptions {
    ModuleOptions { restart: Restart::Always { backoff }, ..ModuleOptions::default() }
}

fn server<Q: Send + 'static>(service: &'static str, log: &Log) -> Scripted {
    let log = log.clone();
    module(move |setup| {
        setup.serve(service, move |_, _: &Q, ctx| {
            log.note(format!("{} was called", ctx.module_name()));
            Ok(1_u32)
        })
    })
}

/// Calls once, in cycle 1, and leaves.
fn caller_that_leaves(service: &'static str) -> Scripted {
    module(move |setup| {
        let client = setup.client(service, STEP, |_, _: Reply<u32>, _| {})?;
        setup.every(STEP, move |_, ctx| {
            ctx.call(client, 1_u32);
            ctx.remove_self();
        })
    })
}

#[test]
fn the_last_call_of_a_module_that_leaves_does_not_reach_another_service() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    core.add("client", caller_that_leaves("wanted")).unwrap();
    cycles(&mut core, &clock, 1);
    // The new service is added in the sync phase in which the module leaves.
    let same_types = core.handle().add("same types", server::<u32>("other", &log), ModuleOptions::default());
    cycles(&mut core, &clock, 3);
    assert!(same_types.try_take().unwrap().is_ok());
    assert_eq!(log.take(), [""; 0]);
}

#[test]
fn the_last_call_of_a_module_that_leaves_harms_no_service_of_other_types() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    core.add("client", caller_that_leaves("wanted")).unwrap();
    cycles(&mut core, &clock, 1);
    drop(core.handle().add("other types", server::<String>("other", &log), ModuleOptions::default()));
    cycles(&mut core, &clock, 3);
    assert_eq!(log.take(), [""; 0]);
}

#[test]
fn the_last_call_of_a_module_that_leaves_is_served() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    core.add("server", server::<u32>("wanted", &log)).unwrap();
    core.add("client", caller_that_leaves("wanted")).unwrap();
    cycles(&mut core, &clock, 4);
    assert_eq!(log.take(), ["server was called"]);
}

#[test]
fn requests_that_were_open_when_a_server_panicked_fail_even_where_it_starts_again_at_once() {
    for backoff in [Duration::ZERO, STEP] {
        let ((mut core, clock), log) = (manual_core(), Log::default());
        let make = || {
            module(|setup| {
                setup.serve_later::<u32, u32, _>("keep", |_, number, _responder, _| {
                    assert_eq!(number, 0, "{PANIC}")
                })
            })
        };
        core.add_restartable("server", make, restart(backoff)).unwrap();
        let noted = log.clone();
        let client = module(move |setup| {
            let client = setup.client("keep", WATCHDOG, move |_, reply: Reply<u32>, _| {
                noted.note(format!("{:?} {}", reply.call, reply.result.unwrap_err()));
            })?;
            let mut number = 0_u32;
            setup.every(STEP, move |_, ctx| {
                if number < 2 {
                    ctx.call(client, number);
                }
                number += 1;
            })
        });
        core.add("client", client).unwrap();
        cycles(&mut core, &clock, 8);
        let answers = log.take();
        let failed = "service \"keep\": module \"server\" has failed: ";
        for (number, answer) in answers.iter().enumerate() {
            let is_told = answer.starts_with(&format!("CallId({number}) {failed}")) && answer.contains(PANIC);
            assert!(is_told, "{answers:?} {backoff:?}");
        }
        assert_eq!(answers.len(), 2, "{backoff:?}");
        assert_eq!(core.modules()[0].restarts, 1);
    }
}

#[test]
fn a_module_that_paused_itself_in_a_tick_ticks_again_when_it_is_resumed() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let noted = log.clone();
    let ticking = module(move |setup| {
        setup.every(10 * STEP, move |_, ctx| {
            noted.note(format!("{}", ctx.now().as_nanos() / 1_000_000));
            ctx.pause("ticking");
        })
    });
    core.add("ticking", ticking).unwrap();
    cycles(&mut core, &clock, 12);
    assert_eq!(log.take(), ["10"]);
    drop(core.handle().resume_module("ticking"));
    cycles(&mut core, &clock, 12);
    assert_eq!(log.take(), ["20"]);
}

/// Collects the identifiers of modules that left.
struct Guestbook(Sender<ModuleId>);

impl Mechanism for Guestbook {
    type View = ();
    type Port = Vec<()>;

    const NAME: &'static str = "guestbook";
    const VERSION: Version = Version::new(1, 0);

    fn view(&self) {}

    fn sync(&mut self, _: &mut SyncPhase<'_>) {}

    fn module_left(&mut self, module: ModuleId, _: &mut SyncPhase<'_>) {
        self.0.send(module).unwrap();
    }
}

fn core_with_guestbook() -> (Core, ManualClock, Receiver<ModuleId>) {
    let (clock, (sender, left)) = (ManualClock::new(Time::ZERO), channel());
    (Core::new().with_clock(clock.clone()).with_mechanism(Guestbook(sender)), clock, left)
}

#[test]
fn mechanisms_are_told_when_a_module_is_replaced_by_its_restart() {
    let (mut core, clock, left) = core_with_guestbook();
    let make = || module(|setup| setup.every(STEP, |_, _| panic!("{PANIC}")));
    core.add_restartable("module", make, restart(Duration::ZERO)).unwrap();
    cycles(&mut core, &clock, 3);
    let first = left.try_recv().unwrap();
    assert!(left.try_recv().is_err());
    drop(core.handle().remove("module"));
    cycles(&mut core, &clock, 1);
    let second = left.try_recv().unwrap();
    assert_ne!(first, second, "the two instances have different identifiers");
}

#[test]
fn a_restart_whose_setup_fails_keeps_the_name_and_frees_all_else_that_was_held() {
    let (mut core, clock, left) = core_with_guestbook();
    let mut lives = 0;
    let make = move || {
        lives += 1;
        let is_first = lives == 1;
        module(move |setup| {
            setup.publish::<u32>("numbers")?;
            setup.serve("answer", |_, (): &(), _| Ok(1_u32))?;
            setup.every(STEP, |_, _| panic!("{PANIC}"))?;
            if is_first { Ok(()) } else { Err(setup.refuse("it does not want to start again")) }
        })
    };
    core.add_restartable("module", make, restart(STEP)).unwrap();
    cycles(&mut core, &clock, 8);
    assert_eq!(left.try_iter().count(), 1);
    let states: Vec<_> = core.modules().iter().map(|module| module.state).collect();
    assert_eq!(states, [LifecycleState::Finalized]);
    assert_eq!((core.topics().count(), core.services().count()), (OWN_TOPICS.len(), 0));
    assert!(core.add("module", module(|_| Ok(()))).is_err());
    drop(core.handle().remove("module"));
    cycles(&mut core, &clock, 2);
    core.add("module", module(|_| Ok(()))).unwrap();
    cycles(&mut core, &clock, 1);
}

#[test]
fn a_removed_module_does_not_start_again_after_a_panic() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let made = log.clone();
    let make = move || {
        made.note("made");
        module(|setup| setup.every(STEP, |_, _| panic!("{PANIC}")))
    };
    core.add_restartable("module", make, restart(10 * STEP)).unwrap();
    cycles(&mut core, &clock, 2);
    drop(core.handle().remove("module"));
    cycles(&mut core, &clock, 20);
    assert_eq!(log.take(), ["made"]);
    assert!(core.modules().is_empty());
}

/// Panics in its last callback.
struct BadEnd;

impl Module for BadEnd {
    type Ports = ();

    fn setup(&mut self, _: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        Ok(())
    }

    fn shutdown(&mut self, _: &mut Context<'_>) {
        panic!("{PANIC}");
    }
}

#[test]
fn a_panic_in_the_last_callback_does_not_bring_a_module_back() {
    for options in [ModuleOptions::default(), detached()] {
        let (mut core, log) = (Core::new(), Log::default());
        let made = log.clone();
        let make = move || {
            made.note("made");
            BadEnd
        };
        let options = ModuleOptions { restart: Restart::Always { backoff: Duration::ZERO }, ..options };
        core.add_restartable("module", make, options).unwrap();
        let handle = core.handle();
        let running = std::thread::spawn(move || core.run());
        handle.remove("module").wait(WATCHDOG).unwrap().unwrap();
        wait_until("it is gone", || handle.modules().wait(WATCHDOG).unwrap().is_empty());
        // Takes the name while the panic may still be on its way.
        handle.add("module", module(|_| Ok(())), ModuleOptions::default()).wait(WATCHDOG).unwrap().unwrap();
        for _ in 0..3 {
            assert_eq!(handle.modules().wait(WATCHDOG).unwrap().len(), 1);
        }
        handle.stop();
        running.join().unwrap().unwrap();
        assert_eq!(log.take(), ["made"]);
    }
}

#[test]
fn a_detached_module_that_was_removed_while_it_was_busy_does_not_start_again_when_it_panics() {
    let (mut core, (opener, gate), log) = (Core::new(), channel::<()>(), Log::default());
    let (made, gate) = (log.clone(), std::sync::Arc::new(std::sync::Mutex::new(gate)));
    let (entered, busy) = channel();
    let make = move || {
        made.note("made");
        let (gate, entered) = (Arc::clone(&gate), entered.clone());
        module(move |setup| {
            setup.every(STEP, move |_, _| {
                entered.send(()).unwrap();
                let _ = gate.lock().unwrap().recv_timeout(WATCHDOG);
                panic!("{PANIC}");
            })
        })
    };
    let options = ModuleOptions { restart: Restart::Always { backoff: Duration::ZERO }, ..detached() };
    core.add_restartable("module", make, options).unwrap();
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run());
    busy.recv_timeout(WATCHDOG).unwrap();
    handle.remove("module").wait(WATCHDOG).unwrap().unwrap();
    opener.send(()).unwrap();
    wait_until("it is gone", || handle.modules().wait(WATCHDOG).unwrap().is_empty());
    handle.stop();
    running.join().unwrap().unwrap();
    assert_eq!(log.take(), ["made"]);
}

#[test]
fn a_stopped_core_still_knows_all_its_modules() {
    let mut core = Core::new();
    core.add("attached", module(|_| Ok(()))).unwrap();
    core.add_with("detached", module(|setup| setup.publish::<u32>("numbers").map(drop)), detached()).unwrap();
    core.cycle().unwrap();
    core.stop();
    let known = core.modules().into_iter().map(|module| (module.name.to_string(), module.state));
    let gone = LifecycleState::Finalized;
    assert_eq!(known.collect::<Vec<_>>(), [("attached".into(), gone), ("detached".into(), gone)]);
    assert!(core.topics().any(|topic| &*topic.name == "numbers"));
}

/// Panics when it is dropped.
struct BadDrop;

impl Module for BadDrop {
    type Ports = ();

    fn setup(&mut self, _: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        Ok(())
    }
}

impl Drop for BadDrop {
    fn drop(&mut self) {
        assert!(std::thread::panicking(), "{PANIC}");
    }
}

#[test]
fn a_refused_module_that_panics_in_its_drop_harms_nobody() {
    let (mut core, clock) = manual_core();
    core.add("module", module(|_| Ok(()))).unwrap();
    let added = core.handle().add("module", BadDrop, ModuleOptions::default());
    cycles(&mut core, &clock, 2);
    let error = added.try_take().unwrap().unwrap_err().to_string();
    assert!(error.contains("a module with this name exists already"), "{error}");
}

/// Panics when dropped; used as the payload of a panic.
struct BadPanic;

impl Drop for BadPanic {
    fn drop(&mut self) {
        assert!(std::thread::panicking(), "{PANIC}");
    }
}

#[test]
fn a_panic_whose_payload_panics_in_its_drop_ends_one_module() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    core.add("faulty", module(|setup| setup.every(STEP, |_, _| std::panic::panic_any(BadPanic)))).unwrap();
    let noted = log.clone();
    core.add("other", module(move |setup| setup.every(STEP, move |_, _| noted.note("tick")))).unwrap();
    cycles(&mut core, &clock, 3);
    assert_eq!(log.take(), ["tick", "tick"]);
}

#[test]
fn every_call_from_outside_ends_even_where_the_core_never_ran() {
    let mut core = Core::new();
    let caller = core.caller::<u32, u32>("nobody").unwrap();
    let (sender, answer) = channel();
    caller.call(1, WATCHDOG, move |result| sender.send(result).unwrap()).unwrap();
    drop(core);
    let error = answer.try_recv().unwrap().unwrap_err().to_string();
    assert_eq!(error, "service \"nobody\": the core has stopped");
}

#[test]
fn a_receipt_of_a_core_that_never_ran_does_not_keep_who_waits() {
    let core = Core::new();
    let handle = core.handle();
    let removed = handle.remove("module");
    drop(core);
    // The wait must end long before the watchdog's time.
    let begin = std::time::Instant::now();
    assert_eq!(removed.wait(2 * WATCHDOG), None);
    assert!(begin.elapsed() < WATCHDOG);
}
