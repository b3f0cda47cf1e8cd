//! The behaviour of the executor, through its public API.
#![allow(clippy::unwrap_used, missing_docs)]

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use downbeat_executor::*;

const MILLISECOND: Duration = Duration::from_millis(1);

/// A module made of closures, for tests.
struct Lambda(Box<Declare>);

type Declare = dyn FnMut(&mut Setup<'_, Lambda>) -> Result<(), SetupError> + Send;

fn lambda(declare: impl FnMut(&mut Setup<'_, Lambda>) -> Result<(), SetupError> + Send + 'static) -> Lambda {
    Lambda(Box::new(declare))
}

impl Module for Lambda {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        (self.0)(setup)
    }
}

/// Logs its start and its stop.
struct Lifecycle(&'static str, Arc<Mutex<Vec<String>>>);

impl Module for Lifecycle {
    type Ports = ();

    fn setup(&mut self, _: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        Ok(())
    }

    fn activate(&mut self, _: &mut Context<'_>) -> Result<(), TransitionError> {
        self.1.lock().unwrap().push(format!("start {}", self.0));
        Ok(())
    }

    fn shutdown(&mut self, _: &mut Context<'_>) {
        self.1.lock().unwrap().push(format!("stop {}", self.0));
    }
}

fn manual_core() -> (Core, ManualClock) {
    let clock = ManualClock::new(Time::ZERO);
    (Core::new().with_clock(clock.clone()), clock)
}

fn listen<T: Clone + Send + Sync + 'static>(core: &mut Core, topic: &'static str) -> Receiver<T> {
    let (sender, receiver) = channel();
    let name = format!("listener of {topic}");
    let observer = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
    core.add_with(&name, listener(topic, sender), observer).unwrap();
    receiver
}

fn listener<T: Clone + Send + Sync + 'static>(topic: &'static str, sender: Sender<T>) -> Lambda {
    let mut sender = Some(sender);
    lambda(move |setup| {
        let sender = sender.take().unwrap();
        setup.subscribe(topic, move |_, message: Received<'_, T>, _| drop(sender.send(message.clone())))
    })
}

fn ticker(topic: &'static str, period: Duration) -> Lambda {
    lambda(move |setup| {
        let out = setup.publish::<u64>(topic)?;
        let mut count = 0;
        setup.every(period, move |_, ctx| {
            count += 1;
            ctx.publish(out, count);
        })
    })
}

#[test]
fn a_message_arrives_in_the_cycle_after_it_was_published() {
    let (mut core, clock) = manual_core();
    core.add("ticker", ticker("count", MILLISECOND)).unwrap();
    let counts = listen::<u64>(&mut core, "/count");
    core.cycle().unwrap();
    clock.advance(MILLISECOND);
    core.cycle().unwrap();
    assert_eq!(counts.try_recv().ok(), None);
    core.cycle().unwrap();
    assert_eq!(counts.try_recv().ok(), Some(1));
}

#[test]
fn messages_of_one_topic_come_in_the_order_of_registration_and_publishing() {
    let (mut core, clock) = manual_core();
    for base in [10_u64, 20] {
        core.add(
            &format!("source {base}"),
            lambda(move |setup| {
                let out = setup.publish::<u64>("numbers")?;
                setup.every(MILLISECOND, move |_, ctx| {
                    ctx.publish(out, base);
                    ctx.publish(out, base + 1);
                })
            }),
        )
        .unwrap();
    }
    let numbers = listen::<u64>(&mut core, "numbers");
    core.cycle().unwrap();
    clock.advance(MILLISECOND);
    core.cycle().unwrap();
    core.cycle().unwrap();
    assert_eq!(numbers.try_iter().collect::<Vec<_>>(), [10, 11, 20, 21]);
}

#[test]
fn a_kept_message_outlives_its_cycle() {
    let (mut core, clock) = manual_core();
    core.add("ticker", ticker("count", MILLISECOND)).unwrap();
    let kept = Arc::new(Mutex::new(Vec::new()));
    let store = Arc::clone(&kept);
    core.add(
        "keeper",
        lambda(move |setup| {
            let store = Arc::clone(&store);
            setup.subscribe("count", move |_, count: Received<'_, u64>, _| {
                store.lock().unwrap().push(count.keep());
            })
        }),
    )
    .unwrap();
    for _ in 0..5 {
        core.cycle().unwrap();
        clock.advance(MILLISECOND);
    }
    let counts: Vec<u64> = kept.lock().unwrap().iter().map(|kept: &Kept<u64>| **kept).collect();
    assert_eq!(counts, [1, 2, 3]);
}

#[test]
fn a_module_may_listen_to_itself() {
    let (mut core, _clock) = manual_core();
    let mut inlet = None;
    core.add(
        "countdown",
        lambda(|setup| {
            let out = setup.publish::<u64>("countdown")?;
            setup.subscribe("countdown", move |_, count: Received<'_, u64>, ctx| {
                if *count > 0 {
                    ctx.publish(out, *count - 1);
                }
            })
        }),
    )
    .unwrap();
    inlet.replace(core.inlet::<u64>("countdown").unwrap());
    let counts = listen::<u64>(&mut core, "countdown");
    inlet.unwrap().publish(3).unwrap();
    for _ in 0..9 {
        core.cycle().unwrap();
    }
    assert_eq!(counts.try_iter().collect::<Vec<_>>(), [3, 2, 1, 0]);
}

#[test]
fn a_remap_connects_topics_of_different_names_and_a_wrong_one_names_the_right_ones() {
    let (mut core, _clock) = manual_core();
    let remapped = |from: &str| ModuleOptions {
        remaps: BTreeMap::from([(from.into(), "wheel/count".into())]),
        ..ModuleOptions::default()
    };
    core.add_with("ticker", ticker("count", MILLISECOND), remapped("count")).unwrap();
    assert!(core.topics().any(|topic| &*topic.name == "wheel/count" && topic.is_published));
    let error = core.add_with("other", ticker("count", MILLISECOND), remapped("cuont")).unwrap_err();
    assert_eq!(error.to_string(), "module \"other\" has no topic \"cuont\" to remap; it has \"count\"");
}

#[test]
fn mistakes_in_registration_are_refused_with_module_and_topic() {
    let (mut core, _clock) = manual_core();
    core.add("ticker", ticker("count", MILLISECOND)).unwrap();
    let duplicate = core.add("ticker", ticker("count", MILLISECOND)).unwrap_err();
    assert!(duplicate.to_string().contains("\"ticker\""), "{duplicate}");
    let (sender, _receiver) = channel::<f32>();
    let conflict = core.add("listener", listener("count", sender)).unwrap_err().to_string();
    assert!(
        conflict.contains("listener") && conflict.contains("count") && conflict.contains("u64"),
        "{conflict}"
    );
    assert!(matches!(core.add("idle", ticker("x", Duration::ZERO)), Err(SetupError::ZeroPeriod(_))));
    assert!(matches!(
        core.add("odd", ticker("no way", MILLISECOND)),
        Err(SetupError::InvalidTopicName { .. })
    ));
}

#[test]
fn a_changed_setting_is_seen_and_announced_in_the_next_cycle_and_a_wrong_one_changes_nothing() {
    let (mut core, _clock) = manual_core();
    let (sender, seen) = channel();
    let mut sender = Some(sender);
    let module = lambda(move |setup| {
        let sender = sender.take().unwrap();
        let gain = setup.setting_in("gain", 1.0, 0.0..=4.0, "of the loop")?;
        setup.on_change(gain, move |_, ctx| sender.send(*ctx.get(gain)).unwrap());
        Ok(())
    });
    let settings = BTreeMap::from([("gain".to_owned(), SettingValue::Integer(2))]);
    core.add_with("loop", module, ModuleOptions { settings, ..ModuleOptions::default() }).unwrap();
    assert_eq!(core.settings("loop").unwrap()[0].value, SettingValue::Double(2.0));
    core.cycle().unwrap();
    core.handle().set("loop", "gain", 9.0);
    core.handle().set("loop", "gian", 1.0);
    core.handle().set("loop", "gain", 3.5);
    core.cycle().unwrap();
    core.cycle().unwrap();
    assert_eq!(seen.try_iter().collect::<Vec<_>>(), [3.5]);
}

#[test]
fn an_unknown_setting_is_refused_with_the_known_ones() {
    let (mut core, _clock) = manual_core();
    let module = lambda(|setup| setup.setting("gain", 1.0, "").map(drop));
    let settings = BTreeMap::from([("gian".to_owned(), SettingValue::Double(2.0))]);
    let error = core.add_with("loop", module, ModuleOptions { settings, ..ModuleOptions::default() });
    assert_eq!(error.unwrap_err().to_string(), "module \"loop\" has no setting \"gian\"; it has \"gain\"");
}

#[test]
fn a_panic_stops_one_module_and_the_others_go_on() {
    let (mut core, clock) = manual_core();
    core.add(
        "faulty",
        lambda(|setup| {
            let out = setup.publish::<u64>("count")?;
            setup.every(MILLISECOND, move |_, ctx| {
                ctx.publish(out, 666);
                panic!("a fault in a test");
            })
        }),
    )
    .unwrap();
    core.add("ticker", ticker("count", MILLISECOND)).unwrap();
    let counts = listen::<u64>(&mut core, "count");
    for _ in 0..4 {
        core.cycle().unwrap();
        clock.advance(MILLISECOND);
    }
    assert_eq!(counts.try_iter().collect::<Vec<_>>(), [1, 2]);
}

#[test]
fn timekeepers_stop_first_parts_in_reverse_order_and_observers_last() {
    let (mut core, _clock) = manual_core();
    let log = Arc::default();
    let observer = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
    core.add_with("recorder", Lifecycle("recorder", Arc::clone(&log)), observer).unwrap();
    core.add("first", Lifecycle("first", Arc::clone(&log))).unwrap();
    let timekeeper = ModuleOptions { role: Role::Timekeeper, ..ModuleOptions::default() };
    core.add_with("clock", Lifecycle("clock", Arc::clone(&log)), timekeeper).unwrap();
    core.add("second", Lifecycle("second", Arc::clone(&log))).unwrap();
    core.cycle().unwrap();
    core.stop();
    core.stop();
    let started = ["start recorder", "start first", "start clock", "start second"];
    let stopped = ["stop clock", "stop second", "stop first", "stop recorder"];
    assert_eq!(*log.lock().unwrap(), [started, stopped].concat());
}

#[test]
fn run_needs_a_clock_that_goes_on() {
    let (mut core, _clock) = manual_core();
    assert!(matches!(core.run(), Err(RunError::ClockStandsStill)));
}

#[test]
fn a_running_core_stops_when_asked_and_delivers_what_came_from_other_threads() {
    let mut core = Core::new();
    let inlet = core.inlet::<u64>("numbers").unwrap();
    let numbers = listen::<u64>(&mut core, "numbers");
    let handle = core.handle();
    let runner = std::thread::spawn(move || core.run());
    for number in 0..100 {
        inlet.publish(number).unwrap();
    }
    for number in 0..100 {
        assert_eq!(numbers.recv_timeout(Duration::from_secs(30)).unwrap(), number);
    }
    handle.stop();
    runner.join().unwrap().unwrap();
    assert_eq!(inlet.publish(1), Err(InletError::Stopped));
}

#[test]
fn a_detached_module_receives_whole_batches_and_its_steps_can_be_followed() {
    let mut core = Core::new();
    let inlet = core.inlet::<u64>("numbers").unwrap();
    let detached = Synchrony::Detached(Inbox::KeepAll);
    core.add_with(
        "doubler",
        lambda(|setup| {
            let out = setup.publish::<u64>("doubled")?;
            setup.subscribe("numbers", move |_, number: Received<'_, u64>, ctx| ctx.publish(out, *number * 2))
        }),
        ModuleOptions { synchrony: detached, ..ModuleOptions::default() },
    )
    .unwrap();
    let doubled = listen::<u64>(&mut core, "doubled");
    let steps = listen::<DetachedStep>(&mut core, DetachedStep::TOPIC);
    let handle = core.handle();
    let runner = std::thread::spawn(move || core.run());
    for number in 0..50 {
        inlet.publish(number).unwrap();
    }
    for number in 0..50 {
        assert_eq!(doubled.recv_timeout(Duration::from_secs(30)).unwrap(), number * 2);
    }
    handle.stop();
    runner.join().unwrap().unwrap();
    let steps: Vec<DetachedStep> = steps.try_iter().collect();
    assert!(steps.iter().zip(0..).all(|(step, number)| step.step == number));
    let inputs = steps.iter().flat_map(|step| &step.inputs);
    assert_eq!(inputs.map(|input| input.received).sum::<u32>(), 50);
}

#[test]
fn a_detached_module_runs_once_for_all_topics_of_a_cycle() {
    const TOPICS: usize = 100;
    let mut core = Core::new();
    let name = |number: usize| format!("numbers_{number}");
    let inlets: Vec<_> = (0..TOPICS).map(|number| core.inlet::<u64>(&name(number)).unwrap()).collect();
    let listener = lambda(move |setup| {
        (0..TOPICS).try_for_each(|number| setup.subscribe(&name(number), |_, _: Received<'_, u64>, _| ()))
    });
    let detached = Synchrony::Detached(Inbox::KeepAll);
    core.add_with("listener", listener, ModuleOptions { synchrony: detached, ..ModuleOptions::default() })
        .unwrap();
    let steps = listen::<DetachedStep>(&mut core, DetachedStep::TOPIC);
    for _ in 0..20 {
        inlets.iter().for_each(|inlet| inlet.publish(1).unwrap());
        core.cycle().unwrap();
    }
    core.stop();
    let topics = steps.try_iter().map(|step| step.inputs.len());
    let topics: Vec<_> = topics.filter(|&count| count > 0).collect();
    assert!(!topics.is_empty() && topics.iter().all(|&count| count == TOPICS), "{topics:?}");
}

#[test]
fn a_full_inbox_of_a_detached_module_drops_the_oldest_and_counts_it() {
    let mut core = Core::new();
    let inlet = core.inlet::<u64>("numbers").unwrap();
    let (gate_opener, gate) = channel::<()>();
    let (sender, received) = channel();
    let mut ends = Some((gate, sender));
    core.add_with(
        "slow",
        lambda(move |setup| {
            let (gate, sender) = ends.take().unwrap();
            setup.subscribe("numbers", move |_, number: Received<'_, u64>, _| {
                sender.send(*number).unwrap();
                gate.recv().unwrap();
            })
        }),
        ModuleOptions {
            synchrony: Synchrony::Detached(Inbox::KeepLast(NonZeroUsize::MIN)),
            ..ModuleOptions::default()
        },
    )
    .unwrap();
    let steps = listen::<DetachedStep>(&mut core, DetachedStep::TOPIC);
    let wait = Duration::from_secs(30);
    core.cycle().unwrap();
    inlet.publish(1).unwrap();
    core.cycle().unwrap();
    // The module is now inside the callback for 1, and cannot take more.
    assert_eq!(received.recv_timeout(wait).unwrap(), 1);
    for number in 2..=4 {
        inlet.publish(number).unwrap();
        core.cycle().unwrap();
    }
    gate_opener.send(()).unwrap();
    assert_eq!(received.recv_timeout(wait).unwrap(), 4);
    gate_opener.send(()).unwrap();
    core.stop();
    let inputs: Vec<StepInput> = steps.try_iter().flat_map(|step| step.inputs).collect();
    let counts: Vec<_> = inputs.iter().map(|input| (input.skipped, input.received)).collect();
    assert_eq!(counts, [(0, 1), (2, 1)]);
}
