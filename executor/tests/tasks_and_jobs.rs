//! Scheduled tasks, and jobs that run outside the cycle.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use common::*;
use downbeat_executor::*;

fn now(ctx: &Context<'_>) -> i64 {
    ctx.now().as_nanos() / 1_000_000
}

/// Calls `run` once, in the module's first run.
fn at_first(setup: &mut Setup<'_, Scripted>, mut run: impl FnMut(&mut Context<'_>) + Send + 'static) {
    let mut is_first = true;
    setup.each_run(move |_, ctx| {
        if std::mem::take(&mut is_first) {
            run(ctx);
        }
    });
}

/// Starts jobs of one kind in its first run, and logs their results.
fn working<T: std::fmt::Debug + Send + 'static>(
    log: &Log,
    mut start: impl FnMut(Job<T>, &mut Context<'_>) + Send + 'static,
) -> Scripted {
    let log = log.clone();
    module(move |setup| {
        let job = setup.job(move |_, result: Result<T, JobError>, ctx: &mut Context<'_>| {
            log.note(format!("{}: {result:?}", ctx.module_name()));
        });
        at_first(setup, move |ctx| start(job, ctx));
        Ok(())
    })
}

#[test]
fn a_task_runs_at_its_time_and_a_past_one_in_the_next_cycle() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let noted = log.clone();
    let module = module(move |setup| {
        let [late, soon, past] = ["late", "soon", "past"].map(|name| {
            let log = noted.clone();
            setup.task(move |_, ctx| log.note(format!("{name} at {}", now(ctx))))
        });
        at_first(setup, move |ctx| {
            ctx.schedule(late, Time::ZERO + 5 * STEP);
            ctx.schedule_after(soon, 2 * STEP);
            ctx.schedule(past, ctx.now());
        });
        Ok(())
    });
    core.add("module", module).unwrap();
    cycles(&mut core, &clock, 8);
    assert_eq!(log.take(), ["past at 1", "soon at 2", "late at 5"]);
}

#[test]
fn a_cancelled_task_does_not_run_however_often_it_was_scheduled() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let noted = log.clone();
    let module = module(move |setup| {
        let cancelled = setup.task(|_, _| panic!("a task that was cancelled runs"));
        let kept = setup.task(move |_, ctx| noted.note(format!("kept at {}", now(ctx))));
        let canceller = setup.task(move |_, ctx| ctx.cancel(cancelled));
        at_first(setup, move |ctx| {
            ctx.schedule_after(cancelled, 3 * STEP);
            ctx.schedule_after(cancelled, 4 * STEP);
            ctx.schedule_after(canceller, 2 * STEP);
            ctx.schedule_after(kept, 3 * STEP);
        });
        Ok(())
    });
    core.add("module", module).unwrap();
    cycles(&mut core, &clock, 8);
    assert_eq!(log.take(), ["kept at 3"]);
    assert_eq!(core.modules()[0].state, LifecycleState::Active);
}

#[test]
fn a_task_that_schedules_itself_runs_once_in_a_cycle() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let noted = log.clone();
    let module = module(move |setup| {
        let own = Arc::new(Mutex::new(None));
        let known = Arc::clone(&own);
        let task = setup.task(move |_, ctx| {
            noted.note(now(ctx).to_string());
            ctx.schedule(known.lock().unwrap().unwrap(), ctx.now());
        });
        *own.lock().unwrap() = Some(task);
        at_first(setup, move |ctx| ctx.schedule(task, ctx.now()));
        Ok(())
    });
    core.add("module", module).unwrap();
    cycles(&mut core, &clock, 5);
    assert_eq!(log.take(), ["1", "2", "3", "4"]);
}

#[test]
fn a_deactivated_module_forgets_its_tasks() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let noted = log.clone();
    let module = module(move |setup| {
        let task = setup.task(move |_, _| noted.note("runs"));
        at_first(setup, move |ctx| ctx.schedule_after(task, 5 * STEP));
        Ok(())
    });
    core.add("module", module).unwrap();
    cycles(&mut core, &clock, 1);
    for transition in [Transition::Deactivate, Transition::Activate] {
        drop(core.handle().transition("module", transition));
        cycles(&mut core, &clock, 10);
    }
    assert_eq!(log.take(), [""; 0]);
}

#[test]
fn jobs_under_a_clock_that_stands_still_run_in_the_sync_phase_in_order() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    for name in ["first", "second"] {
        let module = working(&log, move |job, ctx| {
            ctx.spawn(job, move || format!("{name} blocking"));
            ctx.spawn_async(job, async move { format!("{name} async") });
        });
        core.add(name, module).unwrap();
    }
    cycles(&mut core, &clock, 1);
    assert_eq!(log.take(), [""; 0]);
    cycles(&mut core, &clock, 1);
    let expected = [
        "first: Ok(\"first blocking\")",
        "first: Ok(\"first async\")",
        "second: Ok(\"second blocking\")",
        "second: Ok(\"second async\")",
    ];
    assert_eq!(log.take(), expected);
}

#[test]
fn a_job_that_panics_or_whose_completion_is_dropped_is_lost_and_told_so() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let module = working::<u32>(&log, |job, ctx| {
        ctx.spawn(job, || panic!("a job that panics, as this test wants it"));
        ctx.spawn_async(job, async { panic!("a job that panics, as this test wants it") });
        drop(ctx.completion(job));
        ctx.spawn(job, || 1);
    });
    core.add("module", module).unwrap();
    cycles(&mut core, &clock, 3);
    let mut results = log.take();
    results.sort();
    assert_eq!(results, ["module: Err(Lost)", "module: Err(Lost)", "module: Err(Lost)", "module: Ok(1)"]);
}

/// Runs the core until the log has this number of entries, and returns them.
fn run_until(mut core: Core, log: &Log, entries: usize) -> Vec<String> {
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run());
    let mut found = Vec::new();
    wait_until("all results are there", || {
        found.append(&mut log.take());
        found.len() >= entries
    });
    handle.stop();
    running.join().unwrap().unwrap();
    found.append(&mut log.take());
    found.sort();
    found
}

/// A closure that waits for a signal of the test, and the sender of the signal.
fn gate() -> (impl FnOnce() + Send + 'static, std::sync::mpsc::Sender<()>) {
    let (sender, gate): (_, Receiver<()>) = channel();
    (move || gate.recv_timeout(WATCHDOG).unwrap(), sender)
}

#[test]
fn a_job_that_blocks_holds_up_no_cycle() {
    let (mut core, log, (wait, opener)) = (Core::new(), Log::default(), gate());
    let mut wait = Some(wait);
    let blocking = working(&log, move |job, ctx| {
        let wait = wait.take().unwrap();
        ctx.spawn(job, move || {
            wait();
            1
        });
    });
    core.add("blocking", blocking).unwrap();
    let (noted, mut ticks) = (log.clone(), 0);
    let ticking = module(move |setup| {
        setup.every(STEP, move |_, _| {
            ticks += 1;
            if ticks == 10 {
                noted.note("ten ticks");
                let _ = opener.send(());
            }
        })
    });
    core.add("ticking", ticking).unwrap();
    // The job ends only because the ticks went on.
    assert_eq!(run_until(core, &log, 2), ["blocking: Ok(1)", "ten ticks"]);
}

#[test]
fn blocking_and_async_work_of_attached_and_detached_modules_comes_back() {
    let (mut core, log) = (Core::new(), Log::default());
    for (name, options) in [("attached", ModuleOptions::default()), ("detached", detached())] {
        let module = working(&log, |job, ctx| {
            ctx.spawn(job, || "blocking");
            ctx.spawn_async(job, async { "async" });
            let completion = ctx.completion(job);
            std::thread::spawn(move || completion.finish("own thread"));
        });
        core.add_with(name, module, options).unwrap();
    }
    let expected = ["async", "blocking", "own thread"].map(|how| format!("Ok({how:?})"));
    let expected: Vec<_> = ["attached", "detached"]
        .iter()
        .flat_map(|name| expected.iter().map(move |result| format!("{name}: {result}")))
        .collect();
    assert_eq!(run_until(core, &log, 6), expected);
}

#[test]
fn a_job_that_panics_on_its_thread_takes_no_other_with_it() {
    let (mut core, log) = (Core::new(), Log::default());
    let module = working::<u32>(&log, |job, ctx| {
        for _ in 0..8 {
            ctx.spawn(job, || panic!("a job that panics, as this test wants it"));
            ctx.spawn_async(job, async { panic!("a job that panics, as this test wants it") });
        }
        ctx.spawn(job, || 1);
        ctx.spawn_async(job, async { 2 });
    });
    core.add("module", module).unwrap();
    let results = run_until(core, &log, 18);
    assert_eq!(results.iter().filter(|result| result.ends_with("Err(Lost)")).count(), 16);
    assert_eq!(results[16..], ["module: Ok(1)", "module: Ok(2)"]);
}

#[test]
fn the_result_of_a_job_whose_module_was_removed_reaches_nobody() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let (sender, completions) = channel();
    let work = move |job: Job<u32>, ctx: &mut Context<'_>| sender.send(ctx.completion(job)).unwrap();
    core.add("module", working(&log, work)).unwrap();
    cycles(&mut core, &clock, 1);
    drop(core.handle().remove("module"));
    // The new module has the same place, and a job of the same kind.
    drop(core.handle().add("module", working::<u32>(&log, |_, _| {}), ModuleOptions::default()));
    cycles(&mut core, &clock, 1);
    completions.recv().unwrap().finish(1);
    cycles(&mut core, &clock, 3);
    assert_eq!(log.take(), [""; 0]);
}

#[test]
fn the_result_of_a_job_from_before_a_restart_does_not_reach_the_module_after_it() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let (sender, completions) = channel();
    let made = log.clone();
    let make = move || {
        let (log, sender) = (made.clone(), sender.clone());
        module(move |setup| {
            let job = setup.job(move |_, result: Result<u32, JobError>, _: &mut Context<'_>| {
                log.note(format!("{result:?}"));
            });
            at_first(setup, move |ctx| sender.send(ctx.completion(job)).unwrap());
            setup.every(2 * STEP, |_, ctx| {
                assert!(ctx.now() > Time::ZERO + 2 * STEP, "a panic, as this test wants it")
            })
        })
    };
    let restart = Restart::Always { backoff: Duration::ZERO };
    core.add_restartable("module", make, ModuleOptions { restart, ..ModuleOptions::default() }).unwrap();
    cycles(&mut core, &clock, 5);
    let [before, after] = [completions.recv().unwrap(), completions.recv().unwrap()];
    before.finish(1);
    after.finish(2);
    cycles(&mut core, &clock, 2);
    assert_eq!((log.take(), core.modules()[0].restarts), (vec!["Ok(2)".to_owned()], 1));
}

#[test]
fn a_core_ends_while_a_job_still_blocks() {
    let (mut core, log, (wait, opener)) = (Core::new(), Log::default(), gate());
    let (entered, has_entered) = channel();
    let mut job = Some((wait, entered));
    let module = working(&log, move |key, ctx| {
        let (wait, entered) = job.take().unwrap();
        ctx.spawn(key, move || {
            entered.send(()).unwrap();
            wait();
        });
    });
    core.add("module", module).unwrap();
    core.cycle().unwrap();
    has_entered.recv_timeout(WATCHDOG).unwrap();
    core.stop();
    drop(core);
    // The job must still be waiting, otherwise the send would fail.
    opener.send(()).unwrap();
    assert_eq!(log.take(), [""; 0]);
}
