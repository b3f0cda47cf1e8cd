//! Calls between modules: their servers and times, and the errors of unanswered calls.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::sync::mpsc::channel;
use std::time::Duration;

use common::*;
use downbeat_executor::*;

const TIMEOUT: Duration = Duration::from_millis(20);

/// Answers with twice the number, and refuses odd numbers.
fn doubler(name: &'static str) -> Scripted {
    module(move |setup| {
        setup.serve(name, |_, &number: &u32, _| match number % 2 {
            0 => Ok(2 * number),
            _ => Err(format!("{number} is odd")),
        })
    })
}

/// Takes requests and answers none of them.
fn silent(name: &'static str) -> Scripted {
    module(move |setup| setup.serve_later::<u32, u32, _>(name, |_, _, _responder, _| {}))
}

/// Sends one call for each number in its first run, and logs the result of each.
fn caller(log: &Log, service: &'static str, numbers: Vec<u32>) -> Scripted {
    let log = log.clone();
    module(move |setup| {
        let client = setup.client(service, TIMEOUT, move |_, reply: Reply<u32>, ctx| {
            let cycle = ctx.now().as_nanos() / 1_000_000;
            match reply.result {
                Ok(answer) => log.note(format!("{cycle}: {answer}")),
                Err(error) => log.note(format!("{cycle}: {error}")),
            }
        })?;
        let start = setup.task(move |_, ctx| {
            numbers.iter().for_each(|&number| {
                ctx.call(client, number);
            })
        });
        setup.each_run({
            let mut has_called = false;
            move |_, ctx| {
                if !std::mem::replace(&mut has_called, true) {
                    ctx.schedule(start, ctx.now());
                }
            }
        });
        Ok(())
    })
}

#[test]
fn an_answer_comes_two_cycles_after_the_call() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    core.add("server", doubler("double")).unwrap();
    core.add("client", caller(&log, "double", vec![4, 6, 7])).unwrap();
    // The client calls in cycle 1, and the server runs in cycle 2.
    cycles(&mut core, &clock, 6);
    assert_eq!(log.take(), ["3: 8", "3: 12", "3: service \"double\": 7 is odd"]);
}

#[test]
fn a_call_nobody_serves_fails_in_the_next_cycle() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    core.add("client", caller(&log, "double", vec![4])).unwrap();
    cycles(&mut core, &clock, 6);
    assert_eq!(log.take(), ["2: service \"double\": no module serves it"]);
}

#[test]
fn a_server_may_answer_later_and_in_another_order() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let server = module(|setup| {
        let mut waiting = Vec::new();
        setup.serve_later("double", move |_, number: u32, responder, ctx| {
            waiting.push((number, responder));
            if waiting.len() == 2 {
                for (number, responder) in waiting.drain(..).rev() {
                    ctx.reply(responder, Ok(2 * number));
                }
            }
        })
    });
    core.add("server", server).unwrap();
    core.add("first", caller(&log, "double", vec![1])).unwrap();
    core.add("second", caller(&log, "double", vec![2])).unwrap();
    cycles(&mut core, &clock, 6);
    // Replies are delivered in the order of registration of the clients.
    assert_eq!(log.take(), ["3: 2", "3: 4"]);
}

#[test]
fn a_call_that_is_not_answered_in_time_ends_once() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    core.add("server", silent("double")).unwrap();
    core.add("client", caller(&log, "double", vec![4])).unwrap();
    cycles(&mut core, &clock, 60);
    assert_eq!(log.take(), ["21: service \"double\": no answer in 20ms"]);
}

#[test]
fn an_answer_after_the_time_is_up_is_ignored() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let late = module(|setup| {
        setup.serve_later::<u32, u32, _>("late", {
            let mut held = Vec::new();
            move |_, number, responder, ctx| {
                held.push((ctx.now() + 2 * TIMEOUT, number, responder));
                let due = held.iter().position(|(due, ..)| *due <= ctx.now());
                if let Some(due) = due {
                    let (_, number, responder) = held.remove(due);
                    ctx.reply(responder, Ok(number));
                }
            }
        })
    });
    core.add("late", late).unwrap();
    let log_of = log.clone();
    let client = module(move |setup| {
        let client = setup.client("late", TIMEOUT, move |_, reply: Reply<u32>, _| {
            log_of.note(format!("{:?}: {}", reply.call, reply.result.is_ok()));
        })?;
        setup.every(2 * TIMEOUT + STEP, move |_, ctx| {
            ctx.call(client, 1_u32);
        })
    });
    core.add("client", client).unwrap();
    // The first request is answered when the second one comes, long after its time-out.
    cycles(&mut core, &clock, 110);
    assert_eq!(log.take(), ["CallId(0): false", "CallId(1): false"]);
}

#[test]
fn a_module_may_call_a_service_of_its_own() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let noted = log.clone();
    let both = module(move |setup| {
        setup.serve("double", |_, &number: &u32, _| Ok(2 * number))?;
        let client = setup.client("double", TIMEOUT, move |_, reply: Reply<u32>, _| {
            noted.note(format!("{:?}", reply.result))
        })?;
        setup.every(5 * STEP, move |_, ctx| {
            ctx.call(client, 21_u32);
        })
    });
    core.add("both", both).unwrap();
    cycles(&mut core, &clock, 9);
    assert_eq!(log.take(), ["Ok(42)"]);
}

#[test]
fn a_server_that_leaves_panics_or_is_not_active_cannot_answer() {
    let gone = |server: Scripted, after: fn(&mut Core)| {
        let ((mut core, clock), log) = (manual_core(), Log::default());
        core.add("server", server).unwrap();
        core.add("client", caller(&log, "double", vec![4])).unwrap();
        cycles(&mut core, &clock, 2);
        after(&mut core);
        cycles(&mut core, &clock, 5);
        log.take()
    };
    let gone_message = "service \"double\": module \"server\" does not run and cannot answer";
    let removed = gone(silent("double"), |core| drop(core.handle().remove("server")));
    assert_eq!(removed, [format!("3: {gone_message}")]);
    let inactive =
        gone(silent("double"), |core| drop(core.handle().transition("server", Transition::Deactivate)));
    assert_eq!(inactive, [format!("4: {gone_message}")]);
    let panicking = module(|setup| {
        setup.serve::<u32, u32, _>("double", |_, _, _| panic!("a server that panics, as this test wants it"))
    });
    let failed =
        "service \"double\": module \"server\" has failed: a server that panics, as this test wants it";
    assert_eq!(gone(panicking, |_| {}), [format!("3: {failed}")]);
}

#[test]
fn a_paused_server_keeps_its_requests() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    core.add("server", doubler("double")).unwrap();
    core.add("client", caller(&log, "double", vec![4])).unwrap();
    let paused = core.handle().pause_module("server");
    cycles(&mut core, &clock, 6);
    assert_eq!(paused.try_take(), Some(Ok(())));
    assert_eq!(log.take(), [""; 0]);
    drop(core.handle().resume_module("server"));
    cycles(&mut core, &clock, 3);
    assert_eq!(log.take(), ["8: 8"]);
}

#[test]
fn two_servers_and_two_types_are_refused_with_both_names() {
    let (mut core, _) = manual_core();
    core.add("server", doubler("double")).unwrap();
    let error = core.add("other", doubler("double")).unwrap_err().to_string();
    assert!(
        error.contains("\"other\"") && error.contains("\"server\"") && error.contains("double"),
        "{error}"
    );
    let wrong = module(|setup| setup.serve::<u8, u8, _>("double", |_, number, _| Ok(*number)));
    let error = core.add("wrong", wrong).unwrap_err().to_string();
    assert!(error.contains("u32 -> u32") && error.contains("u8 -> u8"), "{error}");
    let named = module(|setup| setup.serve::<u8, u8, _>("no name", |_, number, _| Ok(*number)));
    assert!(core.add("named", named).unwrap_err().to_string().contains("\"no name\" is not a service name"));
}

#[test]
fn a_service_can_be_remapped() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let remaps = [("double".to_owned(), "arm/double".to_owned())].into();
    core.add_with("server", doubler("double"), ModuleOptions { remaps, ..ModuleOptions::default() }).unwrap();
    core.add("client", caller(&log, "arm/double", vec![4])).unwrap();
    cycles(&mut core, &clock, 6);
    assert_eq!(log.take(), ["3: 8"]);
    assert_eq!(core.services().map(|info| &*info.name).collect::<Vec<_>>(), ["arm/double"]);
}

#[test]
fn a_server_and_a_client_on_threads_of_their_own_reach_each_other() {
    let (log, mut core) = (Log::default(), Core::new());
    core.add_with("server", doubler("double"), detached()).unwrap();
    let (answers, answered) = channel();
    let client = module(move |setup| {
        let client = setup.client("double", WATCHDOG, move |_, reply: Reply<u32>, _| {
            answers.send(reply.result.map_err(|error| error.to_string())).unwrap();
        })?;
        setup.every(STEP, move |_, ctx| {
            ctx.call(client, 4_u32);
        })
    });
    core.add_with("client", client, detached()).unwrap();
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run());
    for _ in 0..5 {
        assert_eq!(answered.recv_timeout(WATCHDOG).unwrap(), Ok(8));
    }
    handle.stop();
    running.join().unwrap().unwrap();
    drop(log);
}

#[test]
fn other_threads_call_services_and_learn_how_it_went() {
    let mut core = Core::new();
    core.add("server", doubler("double")).unwrap();
    core.add("silent", silent("silence")).unwrap();
    let callers = ["double", "silence", "nobody"].map(|name| core.caller::<u32, u32>(name).unwrap());
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run());
    let ask = |caller: &Caller<u32, u32>, number, timeout| {
        let (sender, answer) = channel();
        caller.call(number, timeout, move |result| sender.send(result).unwrap()).unwrap();
        answer
    };
    let wait = |answer: std::sync::mpsc::Receiver<Result<u32, CallError>>| {
        answer.recv_timeout(WATCHDOG).unwrap().map_err(|error| error.to_string())
    };
    assert_eq!(wait(ask(&callers[0], 4, WATCHDOG)), Ok(8));
    assert_eq!(wait(ask(&callers[0], 3, WATCHDOG)), Err("service \"double\": 3 is odd".into()));
    assert_eq!(wait(ask(&callers[2], 4, WATCHDOG)), Err("service \"nobody\": no module serves it".into()));
    assert_eq!(wait(ask(&callers[1], 4, STEP)), Err("service \"silence\": no answer in 1ms".into()));
    let pending = ask(&callers[1], 4, WATCHDOG);
    handle.stop();
    running.join().unwrap().unwrap();
    assert!(wait(pending).is_err());
    let late = callers[0].call(4, WATCHDOG, |_| panic!("not called after the core has stopped"));
    assert_eq!(late.unwrap_err().to_string(), "service \"double\": the core has stopped");
}

#[test]
fn a_closure_for_an_answer_that_panics_harms_nobody() {
    let (mut core, clock) = manual_core();
    core.add("server", doubler("double")).unwrap();
    let caller = core.caller::<u32, u32>("double").unwrap();
    caller.call(4, TIMEOUT, |_| panic!("a closure that panics, as this test wants it")).unwrap();
    let (sender, answer) = channel();
    caller.call(4, TIMEOUT, move |result| sender.send(result).unwrap()).unwrap();
    cycles(&mut core, &clock, 4);
    assert_eq!(answer.try_recv().unwrap().unwrap(), 8);
}
