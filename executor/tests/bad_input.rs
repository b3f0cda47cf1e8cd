//! Bad input at run time: blocking modules, full queues and missing services are reported, and the rest of
//! the robot continues.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::num::NonZeroUsize;
use std::sync::mpsc::channel;
use std::time::Duration;

use common::*;
use downbeat_executor::queue::{Locked, Overflow, Queue, Ring};
use downbeat_executor::*;

/// Blocks in its first tick until the test sends a signal or drops the sender.
fn blocking(gate: std::sync::mpsc::Receiver<()>) -> Scripted {
    module(move |setup| {
        let mut gate = Some(gate);
        setup.every(STEP, move |_, _| {
            if let Some(gate) = gate.take() {
                let _ = gate.recv_timeout(WATCHDOG);
            }
        })
    })
}

fn ticking(log: &Log) -> Scripted {
    let log = log.clone();
    module(move |setup| setup.every(STEP, move |_, _| log.note("tick")))
}

#[test]
fn a_detached_module_that_blocks_holds_up_nobody() {
    let (mut core, log, (opener, gate)) = (Core::new(), Log::default(), channel());
    core.add_with("blocking", blocking(gate), detached()).unwrap();
    core.add("ticking", ticking(&log)).unwrap();
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run());
    let mut ticks = 0;
    wait_until("the other module continues", || {
        ticks += log.take().len();
        ticks > 20
    });
    drop(opener);
    handle.stop();
    running.join().unwrap().unwrap();
}

#[test]
fn an_attached_module_that_blocks_is_told_while_it_does_and_the_rest_goes_on_after_it() {
    for launcher in [true, false] {
        let (log, (opener, gate), (overruns, told)) = (Log::default(), channel(), channel());
        let mut core = match launcher {
            true => Core::new(),
            false => Core::new().with_launcher(Pool::new(2).unwrap()),
        };
        core.on_overrun(move |overrun| overruns.send(overrun.clone()).unwrap());
        let options = ModuleOptions { deadline: Some(5 * STEP), ..ModuleOptions::default() };
        core.add_with("blocking", blocking(gate), options).unwrap();
        core.add("ticking", ticking(&log)).unwrap();
        let handle = core.handle();
        let running = std::thread::spawn(move || core.run());
        let overrun = told.recv_timeout(WATCHDOG).unwrap();
        assert_eq!((&*overrun.what, overrun.has_ended, overrun.deadline), ("blocking", false, 5 * STEP));
        opener.send(()).unwrap();
        let ended = told.iter().find(|overrun| overrun.has_ended).unwrap();
        assert!(ended.running_for > overrun.deadline);
        log.take();
        wait_until("the other modules continue", || log.take().len() > 2);
        handle.stop();
        running.join().unwrap().unwrap();
    }
}

#[test]
fn a_cycle_past_its_deadline_is_told_while_it_goes_on() {
    let ((opener, gate), (overruns, told)) = (channel(), channel());
    let mut core = Core::new().with_cycle_deadline(5 * STEP).unwrap();
    core.on_overrun(move |overrun| overruns.send(overrun.clone()).unwrap());
    core.add("blocking", blocking(gate)).unwrap();
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run());
    let overrun = told.iter().find(|overrun| !overrun.has_ended).unwrap();
    assert_eq!((&*overrun.what, overrun.deadline), ("the cycle", 5 * STEP));
    opener.send(()).unwrap();
    handle.stop();
    running.join().unwrap().unwrap();
}

#[test]
fn a_pool_of_no_threads_is_refused_with_what_to_do() {
    let error = Pool::new(0).map(drop).unwrap_err().to_string();
    assert!(error.starts_with("a pool of 0 threads cannot run modules: give it at least 1"), "{error}");
}

/// Publishes five messages through an inlet whose queue holds three. Returns the received messages, the
/// results of publishing, and the number of dropped messages.
fn through(queue: impl Queue<u32> + 'static) -> (Vec<String>, Vec<bool>, u64) {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let inlet = core.inlet_with("numbers", queue).unwrap();
    let noted = log.clone();
    let listener = module(move |setup| {
        setup.subscribe("numbers", move |_, number: Received<'_, u32>, _| noted.note(number.to_string()))
    });
    core.add("listener", listener).unwrap();
    let taken = (1..=5).map(|number| inlet.publish(number).is_ok()).collect();
    cycles(&mut core, &clock, 2);
    (log.take(), taken, inlet.dropped())
}

#[test]
fn a_full_inlet_drops_or_refuses_as_its_policy_says() {
    let size = NonZeroUsize::new(3).unwrap();
    for (policy, heard, taken, dropped) in [
        (Overflow::DropOldest, ["3", "4", "5"], [true; 5], 2),
        (Overflow::DropNewest, ["1", "2", "3"], [true; 5], 2),
        (Overflow::Refuse, ["1", "2", "3"], [true, true, true, false, false], 0),
    ] {
        let expected = (heard.map(String::from).to_vec(), taken.to_vec(), dropped);
        assert_eq!(through(Locked::bounded(size, policy)), expected, "Locked, {policy:?}");
        assert_eq!(through(Ring::new(size, policy)), expected, "Ring, {policy:?}");
    }
}

#[test]
fn a_service_that_never_comes_is_told_with_every_call_until_it_does() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let noted = log.clone();
    let client = module(move |setup| {
        let client = setup.client("walk", 10 * STEP, move |_, reply: Reply<u32>, _| match reply.result {
            Ok(answer) => noted.note(answer.to_string()),
            Err(error) => noted.note(error.to_string()),
        })?;
        setup.every(4 * STEP, move |_, ctx| _ = ctx.call(client, 1_u32))
    });
    core.add("client", client).unwrap();
    cycles(&mut core, &clock, 10);
    assert_eq!(log.take(), ["service \"walk\": no module serves it"; 2]);
    core.add("server", module(|setup| setup.serve("walk", |_, step: &u32, _| Ok(step + 1)))).unwrap();
    cycles(&mut core, &clock, 5);
    assert_eq!(log.take(), ["2"]);
}

#[test]
fn a_restart_policy_without_back_off_does_not_keep_the_others_from_running() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let restart = Restart::Always { backoff: Duration::ZERO };
    let make = || {
        module(|setup| {
            setup.each_run(|_, _| panic!("a module that panics, as this test wants it"));
            Ok(())
        })
    };
    core.add_restartable("faulty", make, ModuleOptions { restart, ..ModuleOptions::default() }).unwrap();
    core.add("ticking", ticking(&log)).unwrap();
    cycles(&mut core, &clock, 20);
    assert_eq!(log.take().len(), 19);
    assert!(core.modules()[0].restarts > 0);
}
