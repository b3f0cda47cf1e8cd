//! Modules are added, removed, paused and restarted while the core runs.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;

use common::*;
use downbeat_executor::*;

/// Publishes its number in every cycle, from its first one on.
fn talker(topic: &'static str, number: u32) -> Scripted {
    module(move |setup| {
        let out = setup.publish(topic)?;
        setup.each_run(move |_, ctx| ctx.publish(out, number));
        Ok(())
    })
}

fn every_cycle() -> ModuleOptions {
    ModuleOptions { synchrony: Synchrony::EveryCycle, ..ModuleOptions::default() }
}

fn listener(topic: &'static str, log: &Log) -> Scripted {
    let log = log.clone();
    module(move |setup| {
        setup.subscribe(topic, move |_, number: Received<'_, u32>, _| log.note(number.to_string()))
    })
}

fn panicking(log: &Log) -> Scripted {
    let log = log.clone();
    module(move |setup| {
        setup.every(STEP, move |_, ctx| {
            log.note(format!("{} ticks", ctx.module_name()));
            panic!("a module that panics, as this test wants it");
        })
    })
}

fn names(core: &Core) -> Vec<String> {
    core.modules().iter().map(|module| module.name.to_string()).collect()
}

#[test]
fn a_module_that_joins_hears_what_was_published_in_the_cycle_before_its_first() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    core.add_with("talker", talker("numbers", 1), every_cycle()).unwrap();
    cycles(&mut core, &clock, 3);
    let added = core.handle().add("late", listener("numbers", &log), ModuleOptions::default());
    cycles(&mut core, &clock, 1);
    assert!(added.try_take().unwrap().is_ok());
    assert_eq!(log.take(), [""; 0]);
    cycles(&mut core, &clock, 1);
    assert_eq!(log.take(), ["1"]);
}

#[test]
fn a_module_adds_others_and_removes_itself() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let noted = log.clone();
    let founder = module_that_ends(&log, move |setup| {
        let noted = noted.clone();
        setup.each_run(move |_, ctx| {
            ctx.add("child", module_that_ends(&noted, |_| Ok(())), every_cycle());
            ctx.add("child", module(|_| Ok(())), ModuleOptions::default());
            ctx.remove_self();
        });
        Ok(())
    });
    core.add("founder", founder).unwrap();
    cycles(&mut core, &clock, 1);
    assert_eq!(names(&core), ["child"]);
    assert_eq!(log.take(), ["founder ends"]);
    core.stop();
    assert_eq!(log.take(), ["child ends"]);
}

#[test]
fn a_removed_module_frees_everything_it_held() {
    struct Holder(Arc<()>);
    impl Module for Holder {
        type Ports = ();

        fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
            setup.publish::<u32>("of the holder".trim_start_matches("of the "))?;
            setup.serve("hold", |_: &mut Self, &number: &u32, _: &mut Context<'_>| Ok(number))?;
            setup.subscribe("numbers", |holder: &mut Self, _: Received<'_, u32>, _: &mut Context<'_>| {
                assert_eq!(Arc::strong_count(&holder.0), 1);
            })
        }
    }
    let (mut core, clock) = manual_core();
    let held = Arc::new(());
    let weak: Weak<()> = Arc::downgrade(&held);
    core.add("holder", Holder(held)).unwrap();
    cycles(&mut core, &clock, 2);
    assert_eq!((core.topics().count(), core.services().count()), (2 + OWN_TOPICS.len(), 1));
    let removed = core.handle().remove("holder");
    cycles(&mut core, &clock, 1);
    assert_eq!(removed.try_take(), Some(Ok(())));
    assert!(weak.upgrade().is_none());
    assert_eq!(core.topics().map(|topic| &*topic.name).collect::<Vec<_>>(), OWN_TOPICS);
    assert_eq!(core.services().count(), 0);
    assert!(core.modules().is_empty());
}

#[test]
fn a_module_can_be_replaced_in_one_cycle() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let server = |answer: u32| {
        module(move |setup| {
            setup.serve("answer", move |_, (): &(), _| Ok(answer))?;
            let out = setup.publish("numbers")?;
            setup.each_run(move |_, ctx| ctx.publish(out, answer));
            Ok(())
        })
    };
    core.add_with("server", server(1), every_cycle()).unwrap();
    core.add("listener", listener("numbers", &log)).unwrap();
    cycles(&mut core, &clock, 2);
    let (added, removed) =
        (core.handle().add("server", server(2), every_cycle()), core.handle().remove("server"));
    cycles(&mut core, &clock, 4);
    assert_eq!(removed.try_take(), Some(Ok(())));
    assert!(added.try_take().unwrap().is_ok(), "removals come first");
    assert_eq!(log.take(), ["1", "1", "1", "2", "2"]);
    assert_eq!(names(&core), ["listener", "server"], "a module that is added again is last");
}

#[test]
fn a_setup_that_fails_or_panics_leaves_nothing_behind() {
    let (mut core, clock) = manual_core();
    cycles(&mut core, &clock, 1);
    let failing = |fails: fn(&mut Setup<'_, Scripted>) -> Result<(), SetupError>| {
        module(move |setup| {
            setup.publish::<u32>("numbers")?;
            setup.serve("answer", |_, (): &(), _| Ok(1_u32))?;
            setup.subscribe("texts", |_, _: Received<'_, String>, _| {})?;
            fails(setup)
        })
    };
    let refused = core.add("module", failing(|setup| Err(setup.refuse("it does not want to"))));
    assert_eq!(refused.unwrap_err().to_string(), "module \"module\": it does not want to");
    let panicked = core.add("module", failing(|_| panic!("a setup that panics, as this test wants it")));
    assert!(panicked.unwrap_err().to_string().contains("panicked in its setup: a setup that panics"));
    assert_eq!(
        (core.topics().count(), core.services().count(), core.modules().len()),
        (OWN_TOPICS.len(), 0, 0)
    );
    core.add("module", failing(|_| Ok(()))).unwrap();
    cycles(&mut core, &clock, 1);
}

#[test]
fn the_messages_of_a_modules_end_are_delivered() {
    struct LastWords;
    impl Module for LastWords {
        type Ports = ();

        fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
            setup.publish::<u32>("numbers").map(drop)
        }
        fn shutdown(&mut self, ctx: &mut Context<'_>) {
            ctx.set("listener", "gone", true);
        }
    }
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let noted = log.clone();
    let listener = module(move |setup| {
        let gone = setup.setting("gone", false, "whether the other module was removed")?;
        setup.on_change(gone, move |_, ctx| noted.note(format!("gone: {}", ctx.get(gone))));
        Ok(())
    });
    core.add("listener", listener).unwrap();
    core.add("module", LastWords).unwrap();
    cycles(&mut core, &clock, 1);
    drop(core.handle().remove("module"));
    cycles(&mut core, &clock, 3);
    assert_eq!(log.take(), ["gone: true"]);
}

#[test]
fn what_is_asked_of_an_unknown_module_is_refused_with_the_known_ones() {
    let (mut core, clock) = manual_core();
    core.add("known", module(|_| Ok(()))).unwrap();
    let handle = core.handle();
    let (removed, paused) = (handle.remove("unknown"), handle.pause_module("unknown"));
    let (moved, set) =
        (handle.transition("unknown", Transition::Activate), handle.set("unknown", "gain", 1.0));
    let settings = handle.settings("unknown");
    cycles(&mut core, &clock, 1);
    let message = "there is no module \"unknown\"; there is \"known\"";
    assert_eq!(removed.try_take().unwrap().unwrap_err().to_string(), message);
    assert_eq!(paused.try_take().unwrap().unwrap_err().to_string(), message);
    assert_eq!(set.try_take().unwrap().unwrap_err().to_string(), message);
    assert_eq!(moved.try_take().unwrap().unwrap_err().to_string(), "there is no module \"unknown\"");
    assert_eq!(settings.try_take(), Some(None));
}

#[test]
fn a_paused_module_does_not_run_until_it_is_stepped_or_resumed() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    core.add_with("talker", talker("numbers", 1), every_cycle()).unwrap();
    core.add("listener", listener("numbers", &log)).unwrap();
    let handle = core.handle();
    drop(handle.pause_module("listener"));
    cycles(&mut core, &clock, 5);
    assert_eq!(log.take(), [""; 0]);
    assert!(core.modules()[1].is_paused);
    drop(handle.step_module("listener"));
    cycles(&mut core, &clock, 4);
    assert_eq!(log.take(), ["1"], "one run, with the input of the cycle");
    drop(handle.resume_module("listener"));
    cycles(&mut core, &clock, 3);
    assert_eq!(log.take(), ["1", "1"]);
}

#[test]
fn a_resumed_module_goes_on_with_its_timers() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let noted = log.clone();
    let ticking = module(move |setup| setup.every(STEP, move |_, _| noted.note("tick")));
    core.add("ticking", ticking).unwrap();
    cycles(&mut core, &clock, 3);
    drop(core.handle().pause_module("ticking"));
    cycles(&mut core, &clock, 5);
    log.take();
    drop(core.handle().resume_module("ticking"));
    cycles(&mut core, &clock, 4);
    assert_eq!(log.take().len(), 3);
}

#[test]
fn a_paused_core_runs_only_the_cycles_it_is_told_to() {
    let (log, mut core) = (Log::default(), Core::new());
    let noted = log.clone();
    let ticking = module(move |setup| setup.every(STEP, move |_, _| noted.note("tick")));
    core.add("ticking", ticking).unwrap();
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run());
    wait_until("it ticks", || !log.take().is_empty());
    handle.pause();
    assert_eq!(handle.is_paused().wait(WATCHDOG), Some(true));
    log.take();
    std::thread::sleep(5 * STEP);
    assert_eq!(log.take(), [""; 0]);
    handle.step();
    wait_until("it ticks once", || !log.take().is_empty());
    assert_eq!(handle.modules().wait(WATCHDOG).unwrap().len(), 1, "a paused core answers");
    assert_eq!(log.take(), [""; 0]);
    handle.resume();
    wait_until("it ticks on", || log.take().len() > 1);
    handle.stop();
    running.join().unwrap().unwrap();
}

#[test]
fn a_detached_module_that_joins_a_paused_core_waits_with_it() {
    let (log, mut core) = (Log::default(), Core::new());
    let noted = log.clone();
    let ticking = module(move |setup| setup.every(STEP, move |_, _| noted.note("tick")));
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run());
    handle.pause();
    let added = handle.add("ticking", ticking, detached());
    handle.step();
    added.wait(WATCHDOG).unwrap().unwrap();
    std::thread::sleep(5 * STEP);
    assert_eq!(log.take(), [""; 0]);
    handle.resume();
    wait_until("it ticks", || !log.take().is_empty());
    handle.stop();
    running.join().unwrap().unwrap();
}

#[test]
fn a_detached_module_is_removed_with_its_thread_and_its_topics() {
    let (log, mut core) = (Log::default(), Core::new());
    let gone = Arc::new(());
    let (weak, noted) = (Arc::downgrade(&gone), log.clone());
    let module = module_that_ends(&log, move |setup| {
        let out = setup.publish("numbers")?;
        setup.every(STEP, move |_, ctx| {
            let _held = &gone;
            ctx.publish(out, 1_u32);
        })
    });
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run().map(|()| core.topics().count()));
    handle.add("detached", module, detached()).wait(WATCHDOG).unwrap().unwrap();
    handle.remove("detached").wait(WATCHDOG).unwrap().unwrap();
    wait_until("it is gone", || weak.upgrade().is_none());
    assert_eq!(noted.take(), ["detached ends"]);
    wait_until("it is forgotten", || handle.modules().wait(WATCHDOG).unwrap().is_empty());
    handle.stop();
    assert_eq!(running.join().unwrap().unwrap(), OWN_TOPICS.len());
}

#[test]
fn a_module_that_panics_starts_again_as_often_as_its_policy_says() {
    let runs = |restart: Restart, count: usize| {
        let ((mut core, clock), log) = (manual_core(), Log::default());
        let (made, noted) = (log.clone(), log.clone());
        let options = ModuleOptions { restart, ..ModuleOptions::default() };
        core.add_restartable("module", move || panicking(&made), options).unwrap();
        cycles(&mut core, &clock, count);
        (noted.take().len(), core.modules()[0].restarts, core.modules()[0].state)
    };
    let backoff = 2 * STEP;
    let gone = LifecycleState::Finalized;
    assert_eq!(runs(Restart::Never, 50), (1, 0, gone));
    assert_eq!(runs(Restart::Times { limit: 2, backoff }, 50), (3, 2, gone));
    // The module ticks in cycle 1, then waits for 2, 4, 8, 16 and 32 ms. It starts one cycle later and ticks
    // one cycle after that.
    assert_eq!(runs(Restart::Always { backoff }, 50).0, 5);
}

#[test]
fn a_restarted_module_keeps_its_place_and_its_settings() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let made = log.clone();
    let make = move || {
        let noted = made.clone();
        module(move |setup| {
            let gain = setup.setting("gain", 1.0, "a gain")?;
            let fuse = setup.task(|_, _| panic!("a module that panics, as this test wants it"));
            setup.each_run(move |_, ctx| {
                noted.note(format!("{} {}", ctx.module_name(), ctx.get(gain)));
                ctx.schedule_after(fuse, 3 * STEP);
            });
            Ok(())
        })
    };
    let options = ModuleOptions {
        restart: Restart::Always { backoff: STEP },
        settings: [("gain".to_owned(), SettingValue::Double(2.0))].into(),
        synchrony: Synchrony::EveryCycle,
        ..ModuleOptions::default()
    };
    core.add_restartable("first", make, options).unwrap();
    let noted = log.clone();
    let second = module(move |setup| {
        setup.each_run(move |_, _| noted.note("second"));
        Ok(())
    });
    core.add_with("second", second, every_cycle()).unwrap();
    cycles(&mut core, &clock, 3);
    assert_eq!(log.take(), ["first 2", "second", "first 2", "second", "first 2", "second"]);
    cycles(&mut core, &clock, 2);
    assert_eq!(log.take(), ["second", "second"]);
    cycles(&mut core, &clock, 1);
    assert_eq!(log.take(), ["first 2", "second"], "the same place in the order");
    assert_eq!(core.modules()[0].restarts, 1);
}

#[test]
fn a_policy_needs_a_way_to_make_the_module_again() {
    let (mut core, _) = manual_core();
    let restart = Restart::Always { backoff: Duration::ZERO };
    let options = ModuleOptions { restart, ..ModuleOptions::default() };
    let error = core.add_with("module", module(|_| Ok(())), options).unwrap_err();
    assert_eq!(error.to_string(), "module \"module\" cannot be restarted: add it with Core::add_restartable");
}

#[test]
fn a_detached_module_that_panics_starts_again() {
    let (log, mut core) = (Log::default(), Core::new());
    let made = log.clone();
    let options = ModuleOptions { restart: Restart::Always { backoff: Duration::ZERO }, ..detached() };
    core.add_restartable("module", move || panicking(&made), options).unwrap();
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run());
    let mut ticks = 0;
    wait_until("it has started again", || {
        ticks += log.take().len();
        ticks > 2
    });
    handle.stop();
    running.join().unwrap().unwrap();
}

#[test]
fn a_stopped_core_takes_nothing_more() {
    let (mut core, clock) = manual_core();
    core.add("module", module(|_| Ok(()))).unwrap();
    cycles(&mut core, &clock, 1);
    core.stop();
    assert!(matches!(core.cycle(), Err(RunError::Stopped)));
    assert!(matches!(core.add("late", module(|_| Ok(()))), Err(SetupError::Stopped(_))));
    assert_eq!(core.handle().remove("module").wait(Duration::ZERO), None);
}

#[test]
fn a_core_that_is_dropped_stops_its_modules() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    core.add("module", module_that_ends(&log, |_| Ok(()))).unwrap();
    cycles(&mut core, &clock, 1);
    drop(core);
    assert_eq!(log.take(), ["module ends"]);
}

#[test]
fn a_module_that_has_stopped_is_started_again_on_request_whatever_its_policy_is() {
    for restart in [Restart::Never, Restart::Always { backoff: Duration::from_secs(3600) }] {
        for options in [ModuleOptions::default(), detached()] {
            let ((mut core, clock), log) = (manual_core(), Log::default());
            let made = log.clone();
            let options = ModuleOptions { restart, ..options };
            core.add_restartable("module", move || panicking(&made), options).unwrap();
            let refused = core.handle().restart("module");
            let unknown = core.handle().restart("nobody");
            cycles(&mut core, &clock, 1);
            assert!(matches!(refused.try_take().unwrap(), Err(RestartRefused::Runs { .. })));
            assert!(matches!(unknown.try_take().unwrap(), Err(RestartRefused::UnknownModule(_))));
            cycles(&mut core, &clock, 4);
            assert_eq!(log.take(), ["module ticks"]);
            let restarted = core.handle().restart("module");
            cycles(&mut core, &clock, 4);
            assert!(restarted.try_take().unwrap().is_ok());
            assert_eq!(log.take(), ["module ticks"]);
            assert_eq!(core.modules()[0].restarts, 1);
        }
    }
}

#[test]
fn a_module_that_cannot_be_made_again_keeps_its_place_until_it_can() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let (made, noted) = (AtomicU32::new(0), log.clone());
    let make = move || {
        let life = made.fetch_add(1, Ordering::Relaxed);
        let noted = noted.clone();
        module(move |setup| {
            if life == 1 {
                return Err(setup.refuse("it cannot be read"));
            }
            setup.every(STEP, move |_, ctx| {
                noted.note(format!("{} ticks", ctx.module_name()));
                panic!("a module that panics, as this test wants it");
            })
        })
    };
    let restart = Restart::Times { limit: 1, backoff: Duration::ZERO };
    core.add_restartable("first", make, ModuleOptions { restart, ..ModuleOptions::default() }).unwrap();
    core.add("second", module(|_| Ok(()))).unwrap();
    cycles(&mut core, &clock, 6);
    assert_eq!(log.take(), ["first ticks"]);
    assert_eq!(names(&core), ["first", "second"]);
    let reason = core.modules()[0].panic.clone().unwrap();
    assert!(reason.contains("it cannot be read"), "{reason}");
    assert_eq!(core.modules()[0].state, LifecycleState::Finalized);
    drop(core.handle().restart("first"));
    cycles(&mut core, &clock, 4);
    assert_eq!(log.take(), ["first ticks"]);
    assert_eq!(names(&core), ["first", "second"]);
}

#[test]
fn a_module_that_cannot_be_made_yet_joins_when_it_is_started() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let made = log.clone();
    let options = ModuleOptions {
        // A setting that only the module declares.
        settings: [("gain".to_owned(), SettingValue::Double(2.0))].into(),
        ..ModuleOptions::default()
    };
    let make = move || {
        let noted = made.clone();
        module(move |setup| {
            let gain = setup.setting("gain", 1.0, "a gain")?;
            setup.each_run(move |_, ctx| noted.note(format!("{}", ctx.get(gain))));
            Ok(())
        })
    };
    core.add_stopped("late", make, options, "it cannot be read").unwrap();
    cycles(&mut core, &clock, 2);
    assert_eq!(core.modules()[0].panic.as_deref(), Some("it cannot be read"));
    drop(core.handle().restart("late"));
    cycles(&mut core, &clock, 2);
    assert_eq!(log.take(), ["2"]);
}
