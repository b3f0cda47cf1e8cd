//! Outlets: messages that leave a core.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::num::NonZeroUsize;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use common::*;
use downbeat_executor::*;

/// A sink that forwards its messages.
fn pass_on<T: Clone + Send + Sync + 'static>(
    sender: &Sender<T>,
) -> impl FnMut(Received<'_, T>) + Send + use<T> {
    let sender = sender.clone();
    move |message| drop(sender.send(message.clone()))
}

fn collect<T: Clone + Send + Sync + 'static>(
    core: &mut Core,
    topic: &str,
    inbox: Inbox,
) -> (Outlet, Receiver<T>) {
    let (sender, messages) = channel();
    (core.outlet(topic, inbox, pass_on(&sender)).unwrap(), messages)
}

/// Publishes 0, 1, 2, … on "numbers", one per step.
fn counter() -> Scripted {
    module(|setup| {
        let (out, mut count) = (setup.publish("numbers")?, 0_u64);
        setup.every(STEP, move |_, ctx| {
            ctx.publish(out, count);
            count += 1;
        })
    })
}

/// A sink that waits for a signal after each message.
struct Slow {
    at_work: Receiver<u64>,
    go: Sender<()>,
}

fn slow(core: &mut Core, topic: &str, inbox: &OutletInbox) -> (Outlet, Slow) {
    let ((told, at_work), (go, may_go)) = (channel(), channel());
    let outlet = core.outlet(topic, inbox, move |number: Received<'_, u64>| {
        told.send(*number).unwrap();
        let _ = may_go.recv_timeout(WATCHDOG);
    });
    (outlet.unwrap(), Slow { at_work, go })
}

#[test]
fn an_outlet_takes_all_messages_in_order_with_their_times() {
    let (mut core, clock) = manual_core();
    core.add("counter", counter()).unwrap();
    let (sender, taken) = channel();
    let sink = move |number: Received<'_, u64>| {
        sender.send((number.time(), *number, number.is_last(), number.missed())).unwrap();
    };
    let _outlet = core.outlet("numbers", Inbox::KeepAll, sink).unwrap();
    cycles(&mut core, &clock, 5);
    let at = |step: i64| Time::from_nanos(step * 1_000_000);
    let expected = [(at(1), 0, true, 0), (at(2), 1, true, 0), (at(3), 2, true, 0)];
    assert_eq!(taken.try_iter().collect::<Vec<_>>(), expected);
}

#[test]
fn outlets_of_one_inbox_keep_the_order_among_topics() {
    let mut core = Core::new();
    let inbox = OutletInbox::new("log", Inbox::KeepAll);
    let (sender, log) = channel();
    let _outlets = ["first", "second"].map(|topic| {
        let sender = sender.clone();
        let sink = move |number: Received<'_, u64>| drop(sender.send(format!("{topic} {}", *number)));
        core.outlet(topic, &inbox, sink).unwrap()
    });
    let [first, second] = ["first", "second"].map(|topic| core.inlet::<u64>(topic).unwrap());
    for (inlet, number) in [(&second, 1), (&first, 1), (&first, 2), (&second, 2)] {
        inlet.publish(number).unwrap();
        core.cycle().unwrap();
    }
    core.stop();
    assert_eq!(log.try_iter().collect::<Vec<_>>(), ["second 1", "first 1", "first 2", "second 2"]);
}

#[test]
fn a_sink_that_blocks_does_not_block_the_cycle() {
    let mut core = Core::new();
    let inlet = core.inlet::<u64>("numbers").unwrap();
    let (_outlet, sink) = slow(&mut core, "numbers", &Inbox::KeepAll.into());
    for number in 0..3 {
        inlet.publish(number).unwrap();
        core.cycle().unwrap();
    }
    assert_eq!(sink.at_work.recv_timeout(WATCHDOG), Ok(0));
    assert!(sink.at_work.try_recv().is_err(), "the cycles continued without it");
    (0..3).for_each(|_| sink.go.send(()).unwrap());
    core.stop();
    assert_eq!(sink.at_work.try_iter().collect::<Vec<_>>(), [1, 2]);
}

#[test]
fn what_a_bounded_inbox_drops_is_counted_and_told_to_the_sink() {
    let mut core = Core::new();
    let inlet = core.inlet::<u64>("numbers").unwrap();
    let ((sender, taken), (opener, gate)) = (channel(), channel());
    let (told, at_work) = channel();
    let sink = move |number: Received<'_, u64>| {
        told.send(()).unwrap();
        let _ = gate.recv_timeout(WATCHDOG);
        sender.send((*number, number.missed())).unwrap();
    };
    let inbox = OutletInbox::new("bounded", Inbox::KeepLast(NonZeroUsize::new(2).unwrap()));
    let outlet = core.outlet("numbers", &inbox, sink).unwrap();
    inlet.publish(0).unwrap();
    core.cycle().unwrap();
    at_work.recv_timeout(WATCHDOG).unwrap();
    for number in 1..6 {
        inlet.publish(number).unwrap();
        core.cycle().unwrap();
    }
    let snapshot = core.handle().snapshot();
    core.cycle().unwrap();
    let snapshot = snapshot.try_take().unwrap();
    (0..3).for_each(|_| opener.send(()).unwrap());
    core.stop();
    assert_eq!(taken.try_iter().collect::<Vec<_>>(), [(0, 0), (4, 3), (5, 0)]);
    assert_eq!(outlet.dropped(), 3);
    let statistics = &snapshot.outlets[0];
    let counts = (statistics.name.as_str(), statistics.topics, statistics.inbox, statistics.dropped);
    assert_eq!(counts, ("bounded", 1, 2, 3));
    assert_eq!(snapshot.topics.iter().find(|topic| topic.name == "numbers").unwrap().dropped, 3);
}

#[test]
fn an_outlet_that_is_dropped_is_unsubscribed_and_its_sink_is_gone() {
    let (mut core, clock) = manual_core();
    core.add("counter", counter()).unwrap();
    let (outlet, numbers) = collect::<u64>(&mut core, "numbers", Inbox::KeepAll);
    cycles(&mut core, &clock, 3);
    assert_eq!(numbers.try_iter().count(), 1);
    drop(outlet);
    assert!(numbers.recv().is_err(), "no sender is left");
    core.cycle().unwrap();
    assert_eq!(core.graph().outlets, []);
    let topic = "unused";
    drop(core.outlet(topic, Inbox::KeepAll, |_: Received<'_, u64>| ()).unwrap());
    core.cycle().unwrap();
    assert!(!core.topics().any(|known| &*known.name == topic), "an unused topic is removed");
}

#[test]
fn what_waits_for_an_outlet_that_is_dropped_is_discarded() {
    let mut core = Core::new();
    let inlet = core.inlet::<u64>("numbers").unwrap();
    let inbox = OutletInbox::new("shared", Inbox::KeepAll);
    let (_slow, sink) = slow(&mut core, "numbers", &inbox);
    let (sender, taken) = channel();
    let outlet = core.outlet("numbers", &inbox, pass_on::<u64>(&sender)).unwrap();
    inlet.publish(1).unwrap();
    core.cycle().unwrap();
    assert_eq!(sink.at_work.recv_timeout(WATCHDOG), Ok(1));
    drop((outlet, sender));
    sink.go.send(()).unwrap();
    core.stop();
    assert!(taken.recv().is_err());
}

#[test]
fn a_sink_may_drop_its_own_outlet() {
    let (mut core, _clock) = manual_core();
    let inlet = core.inlet::<u64>("numbers").unwrap();
    let own = Arc::<Mutex<Option<Outlet>>>::default();
    let (sender, taken) = channel();
    let sink = {
        let own = Arc::clone(&own);
        move |number: Received<'_, u64>| {
            drop(own.lock().unwrap().take());
            sender.send(*number).unwrap();
        }
    };
    *own.lock().unwrap() = Some(core.outlet("numbers", Inbox::KeepAll, sink).unwrap());
    (0..2).for_each(|number| inlet.publish(number).unwrap());
    (0..2).for_each(|_| core.cycle().unwrap());
    assert_eq!(taken.iter().collect::<Vec<_>>(), [0]);
}

#[test]
fn the_last_messages_of_all_modules_reach_an_outlet_before_its_sink_is_dropped() {
    struct Last(u32);
    impl Module for Last {
        type Ports = Publication<u32>;

        fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Self::Ports, SetupError> {
            setup.publish("last")
        }

        fn shutdown(&mut self, ctx: &mut Context<'_, Self::Ports>) {
            ctx.publish(*ctx.ports, self.0);
        }
    }
    for synchrony in [Synchrony::WhenDue, Synchrony::Detached(Inbox::KeepAll)] {
        let mut core = Core::new();
        let (_outlet, last) = collect::<u32>(&mut core, "last", Inbox::KeepAll);
        for (name, number) in [("a", 1), ("b", 2)] {
            let options = ModuleOptions { synchrony, ..ModuleOptions::default() };
            core.add_with(name, Last(number), options).unwrap();
        }
        let (sender, stopped) = channel();
        core.on_stop(move || sender.send(()).unwrap());
        core.cycle().unwrap();
        assert!(stopped.try_recv().is_err());
        core.stop();
        assert_eq!(last.iter().collect::<Vec<_>>(), [2, 1], "and then no sender is left");
        assert_eq!(stopped.recv(), Ok(()));
    }
}

#[test]
fn an_outlet_takes_the_same_under_every_launcher() {
    fn taken(launcher: impl Launcher + 'static) -> Vec<u64> {
        let clock = ManualClock::new(Time::ZERO);
        let mut core = Core::new().with_launcher(launcher).with_clock(clock.clone());
        for name in ["a", "b", "c"] {
            core.add(name, counter()).unwrap();
        }
        let (_outlet, numbers) = collect(&mut core, "numbers", Inbox::KeepAll);
        cycles(&mut core, &clock, 20);
        core.stop();
        numbers.try_iter().collect()
    }
    let expected = taken(Linear);
    assert_eq!(expected.len(), 3 * 20);
    assert_eq!(taken(Pool::new(2).unwrap()), expected);
    assert_eq!(taken(Threads::new()), expected);
}

#[test]
fn under_a_clock_that_is_moved_by_hand_a_sink_runs_inside_the_cycle() {
    let (mut core, _clock) = manual_core();
    let inlet = core.inlet::<u64>("numbers").unwrap();
    let (sender, threads) = channel();
    let sink = move |_: Received<'_, u64>| sender.send(std::thread::current().id()).unwrap();
    let _outlet = core.outlet("numbers", Inbox::KeepAll, sink).unwrap();
    inlet.publish(1).unwrap();
    core.cycle().unwrap();
    assert_eq!(core.next_event(), Some(Time::ZERO), "it waits for the next cycle");
    core.cycle().unwrap();
    assert_eq!(core.next_event(), None);
    assert_eq!(threads.try_recv(), Ok(std::thread::current().id()));
}

#[test]
fn outlets_are_opened_and_closed_while_the_core_runs() {
    let mut core = Core::new();
    core.add("counter", counter()).unwrap();
    let handle = core.handle();
    let thread = std::thread::spawn(move || core.run());
    let (sender, numbers) = channel();
    let outlet = handle.outlet("numbers", Inbox::KeepAll, pass_on::<u64>(&sender));
    let outlet = outlet.wait(WATCHDOG).unwrap().unwrap();
    let first = numbers.recv_timeout(WATCHDOG).unwrap();
    assert_eq!(numbers.recv_timeout(WATCHDOG), Ok(first + 1));
    drop((outlet, sender));
    numbers.iter().for_each(drop); // Ends: the sink is gone.
    assert_eq!(handle.graph().wait(WATCHDOG).unwrap().outlets, []);
    let wrong = handle.outlet("numbers", Inbox::KeepAll, |_: Received<'_, String>| ());
    assert!(matches!(wrong.wait(WATCHDOG).unwrap(), Err(SetupError::TopicType { .. })));
    handle.stop();
    thread.join().unwrap().unwrap();
}

#[test]
fn a_panic_in_a_sink_closes_its_outlet_and_no_other() {
    let (mut core, clock) = manual_core();
    core.add("counter", counter()).unwrap();
    let inbox = OutletInbox::new("shared", Inbox::KeepAll);
    let (sender, numbers) = channel();
    let mut calls = 0;
    let bomb = core.outlet("numbers", &inbox, move |_: Received<'_, u64>| {
        calls += 1;
        assert_eq!(calls, 1, "called again");
        panic!("a sink in a test");
    });
    let _bomb = bomb.unwrap();
    let _outlet = core.outlet("numbers", &inbox, pass_on::<u64>(&sender)).unwrap();
    cycles(&mut core, &clock, 6);
    assert_eq!(numbers.try_iter().collect::<Vec<_>>(), [0, 1, 2, 3]);
    let snapshot = core.handle().snapshot();
    core.cycle().unwrap();
    assert_eq!(snapshot.try_take().unwrap().outlets[0].failed, 1);
}

#[test]
fn a_graph_shows_outlets_by_their_inbox() {
    let (mut core, _clock) = manual_core();
    core.add("counter", counter()).unwrap();
    let bag = OutletInbox::new("bag", Inbox::KeepAll);
    let ignore = |_: Received<'_, u64>| ();
    let _outlets = [
        core.outlet("numbers", &bag, ignore).unwrap(),
        core.outlet("others", &bag, ignore).unwrap(),
        core.outlet("numbers", Inbox::KeepAll, ignore).unwrap(),
    ];
    let graph = core.graph();
    assert_eq!(graph.outlets.iter().map(|outlet| &outlet.name).collect::<Vec<_>>(), ["bag", "numbers"]);
    let leaves = graph.edges.iter().filter(|edge| matches!(edge, GraphEdge::Leaves { .. }));
    assert_eq!(leaves.count(), 3);
    assert_eq!(graph.modules.len(), 1);
}

#[test]
fn an_inbox_may_be_used_again_after_its_last_outlet_was_dropped() {
    let mut core = Core::new();
    let inlet = core.inlet::<u64>("numbers").unwrap();
    let inbox = OutletInbox::new("again", Inbox::KeepAll);
    for number in 0..3 {
        let (sender, numbers) = channel();
        let outlet = core.outlet("numbers", &inbox, pass_on::<u64>(&sender)).unwrap();
        inlet.publish(number).unwrap();
        core.cycle().unwrap();
        assert_eq!(numbers.recv_timeout(WATCHDOG), Ok(number));
        drop(outlet);
        core.cycle().unwrap();
    }
}

#[test]
fn an_outlet_that_is_kept_is_open_until_the_core_stops() {
    let (mut core, clock) = manual_core();
    core.add("counter", counter()).unwrap();
    let (outlet, numbers) = collect::<u64>(&mut core, "numbers", Inbox::KeepAll);
    outlet.keep();
    cycles(&mut core, &clock, 3);
    assert_eq!(numbers.try_iter().count(), 1);
    core.stop();
    assert_eq!(numbers.iter().count(), 2, "and then no sender is left");
}

#[test]
fn a_core_that_has_stopped_opens_no_outlet() {
    let mut core = Core::new();
    core.cycle().unwrap();
    core.stop();
    let refused = core.outlet("numbers", Inbox::KeepAll, |_: Received<'_, u64>| ());
    assert!(matches!(refused, Err(SetupError::Stopped(_))));
}

#[test]
fn dropping_a_core_that_never_ran_drops_the_sinks() {
    let mut core = Core::new();
    let (_outlet, numbers) = collect::<u64>(&mut core, "numbers", Inbox::KeepAll);
    drop(core);
    assert_eq!(numbers.recv_timeout(Duration::from_secs(30)).ok(), None);
    assert!(numbers.recv().is_err());
}

#[test]
fn messages_of_a_type_that_is_a_value_arrive_as_typed_ones_do() {
    let (mut core, _clock) = manual_core();
    let numbers = MessageType::of::<u64>();
    let (sender, received) = channel();
    let _outlet = core.outlet_of(numbers, "numbers", Inbox::KeepAll, move |message| {
        let number = *message.message.downcast_ref::<u64>().unwrap();
        sender.send((number, message.time, message.is_last, message.missed)).unwrap();
    });
    let (_typed, typed) = collect::<u64>(&mut core, "numbers", Inbox::KeepAll);
    let queue = queue::Locked::bounded(NonZeroUsize::new(2).unwrap(), queue::Overflow::DropOldest);
    let inlet = core.inlet_of(numbers, "numbers", queue).unwrap();
    for number in 0..3_u64 {
        inlet.publish(Box::new(number)).unwrap();
    }
    core.cycle().unwrap();
    inlet.publish(Box::new("no number")).unwrap();
    core.cycle().unwrap();
    let received: Vec<_> = received.try_iter().collect();
    assert_eq!(received, [(1, Time::ZERO, false, 0), (2, Time::ZERO, true, 0)]);
    assert_eq!(typed.try_iter().collect::<Vec<_>>(), [1, 2]);
    assert_eq!(inlet.dropped(), 1);
    assert!(core.outlet_of(MessageType::of::<u8>(), "numbers", Inbox::KeepAll, |_| {}).is_err());
}

#[test]
fn a_gate_is_asked_on_the_thread_of_the_core_and_while_it_is_closed_no_thread_is_woken() {
    use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
    let mut core = Core::new();
    let (is_open, offered) = (Arc::<AtomicBool>::default(), Arc::<AtomicU32>::default());
    let gate = {
        let (is_open, offered, here) =
            (Arc::clone(&is_open), Arc::clone(&offered), std::thread::current().id());
        OutletGate::new(move |messages| {
            assert_eq!(std::thread::current().id(), here);
            offered.fetch_add(messages, Ordering::Relaxed);
            is_open.load(Ordering::Relaxed)
        })
    };
    let (sender, received) = channel();
    let inbox = OutletInbox::new("behind_a_gate", Inbox::KeepAll);
    let sink = move |message: AnyReceived<'_>| {
        sender.send((*message.message.downcast_ref::<u64>().unwrap(), message.missed)).unwrap();
    };
    let _outlet = core.gated_outlet_of(MessageType::of::<u64>(), "numbers", &inbox, gate, sink).unwrap();
    let inlet = core.inlet("numbers").unwrap();
    for number in 0..100_u64 {
        inlet.publish(number).unwrap();
        inlet.publish(number).unwrap();
        core.cycle().unwrap();
    }
    assert_eq!(offered.load(Ordering::Relaxed), 200);
    let snapshot = core.handle().snapshot();
    core.cycle().unwrap();
    let outlet = &snapshot.try_take().unwrap().outlets[0];
    assert_eq!((outlet.received, outlet.inbox), (0, 0), "a thread is woken for what is in its inbox");
    is_open.store(true, Ordering::Relaxed);
    inlet.publish(100_u64).unwrap();
    core.cycle().unwrap();
    assert_eq!(received.recv_timeout(WATCHDOG).unwrap(), (100, 0), "nothing was missed: it was not wanted");
}

#[test]
fn a_gate_that_panics_closes_its_outlet_only() {
    let (mut core, _clock) = manual_core();
    let gate = OutletGate::new(|_| panic!("no gate"));
    let count = |_: AnyReceived<'_>| panic!("the gate never opened");
    let _outlet =
        core.gated_outlet_of(MessageType::of::<u64>(), "numbers", Inbox::KeepAll, gate, count).unwrap();
    let (_other, numbers) = collect::<u64>(&mut core, "numbers", Inbox::KeepAll);
    let inlet = core.inlet("numbers").unwrap();
    for number in 0..3_u64 {
        inlet.publish(number).unwrap();
        core.cycle().unwrap();
    }
    core.cycle().unwrap();
    assert_eq!(numbers.try_iter().collect::<Vec<_>>(), [0, 1, 2]);
}
