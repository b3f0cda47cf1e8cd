//! Users of topics and services that know a type only by its identity, among users that know the Rust type.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::any::{Any, TypeId};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex};

use common::*;
use downbeat_executor::*;

/// A text with a count of the values that live.
#[derive(Clone, Debug)]
struct Line(String, #[allow(dead_code)] Arc<()>);

struct Lines;

impl ErasedType for Lines {
    fn message_type(&self) -> TypeId {
        TypeId::of::<Line>()
    }

    fn type_name(&self) -> &'static str {
        std::any::type_name::<Line>()
    }

    fn copy(&self, message: &dyn Any) -> Option<AnyMessage> {
        message.downcast_ref::<Line>().map(|line| Box::new(line.clone()) as AnyMessage)
    }
}

const LINES: MessageType = MessageType::erased(&Lines);

fn collect(core: &mut Core, topic: &str) -> (Outlet, Receiver<(String, bool)>) {
    let (sender, lines) = channel();
    let outlet = core.outlet_of(LINES, topic, Inbox::KeepAll, move |received| {
        let Line(text, _) = received.message.downcast_ref().unwrap();
        drop(sender.send((text.clone(), received.is_last)));
    });
    (outlet.unwrap(), lines)
}

/// Notes the lines on "lines".
fn reader(log: &Log) -> Scripted {
    let log = log.clone();
    module(move |setup| {
        setup.subscribe("lines", move |_, line: Received<'_, Line>, _| {
            log.note(format!("{} {}", line.0, line.is_last()));
        })
    })
}

#[test]
fn messages_stay_in_their_boxes_where_no_user_knows_the_type() {
    let (mut core, clock) = manual_core();
    let (_outlet, outside) = collect(&mut core, "lines");
    let log = Log::default();
    let inside = log.clone();
    let relay = module(move |setup| {
        let again = setup.publish_of(LINES, "again")?;
        setup.subscribe_of(LINES, "lines", move |_, received, ctx| {
            let line: &Line = received.message.downcast_ref().unwrap();
            inside.note(line.0.clone());
            ctx.publish_any(again, Box::new(line.clone()));
        })
    });
    core.add("relay", relay).unwrap();
    let (_outlet_again, again) = collect(&mut core, "again");
    let living = Arc::new(());
    let [first, second] = [(); 2].map(|()| core.inlet_of(LINES, "lines", queue::LockFree::new()).unwrap());
    for (inlet, text) in [(&second, "b"), (&first, "a"), (&second, "c")] {
        inlet.publish(Box::new(Line(text.to_owned(), Arc::clone(&living)))).unwrap();
    }
    first.publish(Box::new("no line")).unwrap();
    cycles(&mut core, &clock, 4);
    let lines = |texts: [&str; 3]| texts.map(|text| (text.to_owned(), text == texts[2]));
    assert_eq!(outside.try_iter().collect::<Vec<_>>(), lines(["a", "b", "c"]));
    assert_eq!(log.take(), ["a", "b", "c"]);
    assert_eq!(again.try_iter().collect::<Vec<_>>(), lines(["a", "b", "c"]));
    assert_eq!(Arc::strong_count(&living), 1, "messages are dropped in the cycle after they were read");
    let info = core.topics().find(|topic| &*topic.name == "lines").unwrap();
    assert_eq!((info.counter.messages(), info.message_type_id), (3, TypeId::of::<Line>()));
    let error = core.inlet::<String>("lines").err().unwrap().to_string();
    assert!(error.contains("String") && error.contains("Line"), "{error}");
}

#[test]
fn a_user_that_knows_the_type_and_users_that_do_not_exchange_messages() {
    let (mut core, clock) = manual_core();
    let log = Log::default();
    let boxed = core.inlet_of(LINES, "lines", queue::LockFree::new()).unwrap();
    core.add("reader", reader(&log)).unwrap();
    let typed = core.inlet::<Line>("lines").unwrap();
    let (_outlet, outside) = collect(&mut core, "lines");
    let living = Arc::new(());
    let line = |text: &str| Line(text.to_owned(), Arc::clone(&living));
    for round in ["1", "2"] {
        boxed.publish(Box::new(line(round))).unwrap();
        typed.publish(line("typed")).unwrap();
        cycles(&mut core, &clock, 2);
        assert_eq!(log.take(), [format!("{round} false"), "typed true".to_owned()]);
        let expected = [(round.to_owned(), false), ("typed".to_owned(), true)];
        assert_eq!(outside.try_iter().collect::<Vec<_>>(), expected);
    }
    cycles(&mut core, &clock, 1);
    assert_eq!(Arc::strong_count(&living), 1);
    let info = core.topics().find(|topic| &*topic.name == "lines").unwrap();
    assert_eq!(info.counter.messages(), 4);
}

/// A module's first run receives the messages of the cycle before, whether or not they are in use elsewhere.
#[test]
fn a_user_that_knows_the_type_and_joins_late_receives_messages_in_boxes() {
    for is_in_use in [false, true] {
        let (mut core, clock) = manual_core();
        let inlet = core.inlet_of(LINES, "lines", queue::LockFree::new()).unwrap();
        // Under a manual clock, the sink has the batch until the next cycle.
        let kept = is_in_use.then(|| collect(&mut core, "lines"));
        let living = Arc::new(());
        for text in ["old", "new"] {
            inlet.publish(Box::new(Line(text.to_owned(), Arc::clone(&living)))).unwrap();
            cycles(&mut core, &clock, 1);
        }
        let log = Log::default();
        core.add("reader", reader(&log)).unwrap();
        cycles(&mut core, &clock, 1);
        assert_eq!(log.take(), ["new true"], "in use: {is_in_use}");
        if let Some((_outlet, lines)) = kept {
            let lines: Vec<_> = lines.try_iter().map(|(line, _)| line).collect();
            assert_eq!(lines, ["old", "new"]);
        }
        cycles(&mut core, &clock, 1);
        assert_eq!(Arc::strong_count(&living), 1, "in use: {is_in_use}");
    }
}

#[test]
fn a_detached_reader_receives_messages_of_inlets_of_boxes() {
    let mut core = Core::new();
    let inlet = core.inlet_of(LINES, "lines", queue::LockFree::new()).unwrap();
    let log = Log::default();
    core.add_with("reader", reader(&log), detached()).unwrap();
    inlet.publish(Box::new(Line("a".to_owned(), Arc::default()))).unwrap();
    let noted = Mutex::new(Vec::new());
    wait_until("the line arrives", || {
        core.cycle().unwrap();
        noted.lock().unwrap().extend(log.take());
        !noted.lock().unwrap().is_empty()
    });
    assert_eq!(*noted.lock().unwrap(), ["a true"]);
}

/// Doubles a number, up to 99.
fn double(number: u32) -> Result<String, String> {
    if number < 100 { Ok((2 * number).to_string()) } else { Err(format!("{number} is too large")) }
}

fn doubling() -> ServiceType<AnyValue, AnyValue> {
    let text = (TypeId::of::<String>(), std::any::type_name::<String>());
    ServiceType::erased((TypeId::of::<u32>(), std::any::type_name::<u32>()), text)
}

fn typed_server() -> Scripted {
    module(|setup| setup.serve("double", |_, number: &u32, _| double(*number)))
}

fn boxed_server() -> Scripted {
    module(|setup| {
        setup.serve_later_of(doubling(), "double", |_, number, responder, ctx| {
            let number: u32 = *number.0.downcast().unwrap();
            ctx.reply(responder, double(number).map(|text| AnyValue(Box::new(text))));
        })
    })
}

/// Asks for 21 and for 100 in its first run, and notes the answers.
fn typed_client(log: &Log) -> Scripted {
    let log = log.clone();
    module(move |setup| {
        let client = setup.client("double", WATCHDOG, move |_, reply: Reply<String>, _| {
            log.note(format!("{:?}", reply.result.map_err(|error| error.to_string())));
        })?;
        setup.subscribe("go", move |_, _: Received<'_, ()>, ctx| {
            ctx.call(client, 21_u32);
            ctx.call(client, 100_u32);
        })
    })
}

fn boxed_client(log: &Log) -> Scripted {
    let log = log.clone();
    module(move |setup| {
        let client =
            setup.client_of(doubling(), "double", WATCHDOG, move |_, reply: Reply<AnyValue>, _| {
                let result = reply.result.map(|text| *text.0.downcast::<String>().unwrap());
                log.note(format!("{:?}", result.map_err(|error| error.to_string())));
            })?;
        setup.subscribe("go", move |_, _: Received<'_, ()>, ctx| {
            ctx.call(client, AnyValue(Box::new(21_u32)));
            ctx.call(client, AnyValue(Box::new(100_u32)));
        })
    })
}

#[test]
fn callers_and_servers_that_know_the_types_and_those_that_do_not_understand_each_other() {
    let expected = ["Ok(\"42\")", "Err(\"service \\\"double\\\": 100 is too large\")"];
    for (is_server_boxed, is_client_boxed, are_detached, is_client_first) in
        (0..16).map(|bits: u32| (bits & 1 != 0, bits & 2 != 0, bits & 4 != 0, bits & 8 != 0))
    {
        let case = format!("{is_server_boxed} {is_client_boxed} {are_detached} {is_client_first}");
        let (mut core, log, outside) = (Core::new(), Log::default(), Log::default());
        let options = || if are_detached { detached() } else { ModuleOptions::default() };
        let server = if is_server_boxed { boxed_server() } else { typed_server() };
        let client = if is_client_boxed { boxed_client(&log) } else { typed_client(&log) };
        let mut modules = [("server", server), ("client", client)];
        if is_client_first {
            modules.reverse();
        }
        for (name, module) in modules {
            core.add_with(name, module, options()).unwrap();
        }
        for number in [21_u32, 100] {
            let outside = outside.clone();
            let note = move |result: Result<String, CallError>| {
                outside.note(format!("{:?}", result.map_err(|error| error.to_string())));
            };
            if is_client_boxed {
                let caller = core.caller_of(doubling(), "double").unwrap();
                let unbox = |text: AnyValue| *text.0.downcast::<String>().unwrap();
                let answered = move |result: Result<AnyValue, CallError>| note(result.map(unbox));
                caller.call(AnyValue(Box::new(number)), WATCHDOG, answered).unwrap();
            } else {
                core.caller::<u32, String>("double").unwrap().call(number, WATCHDOG, note).unwrap();
            }
        }
        core.inlet("go").unwrap().publish(()).unwrap();
        let (mut answers, mut answers_outside) = (Vec::new(), Vec::new());
        wait_until(&case, || {
            core.cycle().unwrap();
            answers.extend(log.take());
            answers_outside.extend(outside.take());
            answers.len() == 2 && answers_outside.len() == 2
        });
        assert_eq!(answers, expected, "{case}");
        assert_eq!(answers_outside, expected, "{case}");
    }
}

#[test]
fn a_stand_in_of_boxes_answers_a_client_that_knows_the_types() {
    let (mut core, clock) = manual_core();
    let log = Log::default();
    core.add("client", typed_client(&log)).unwrap();
    let stand_in = core.stand_in_of(doubling(), "double").unwrap();
    core.inlet("go").unwrap().publish(()).unwrap();
    cycles(&mut core, &clock, 1);
    stand_in.answer("client", 0, 0, Ok(AnyValue(Box::new("42".to_owned()))));
    cycles(&mut core, &clock, 3);
    assert_eq!(log.take(), ["Ok(\"42\")"]);
}

#[test]
fn events_hold_the_encoded_values_whether_or_not_these_are_in_boxes() {
    for (is_server_boxed, is_client_boxed) in [(false, false), (false, true), (true, false), (true, true)] {
        let (mut core, clock) = manual_core();
        let log = Log::default();
        core.add("server", if is_server_boxed { boxed_server() } else { typed_server() }).unwrap();
        core.add("client", if is_client_boxed { boxed_client(&log) } else { typed_client(&log) }).unwrap();
        let request =
            |value: &dyn Any| value.downcast_ref::<u32>().map(|number| number.to_le_bytes().to_vec());
        let answer = |value: &dyn Any| value.downcast_ref::<String>().map(|text| text.clone().into_bytes());
        core.encode_service_of(doubling(), "double", request, answer).unwrap();
        let (sender, events) = channel();
        let sink = move |event: Received<'_, ModuleEvent>| drop(sender.send(event.kind.clone()));
        let _outlet = core.outlet(ModuleEvent::TOPIC, Inbox::KeepAll, sink).unwrap();
        core.inlet("go").unwrap().publish(()).unwrap();
        cycles(&mut core, &clock, 6);
        let bodies = events.try_iter().filter_map(|event| match event {
            ModuleEventKind::Request { body, .. } => body,
            ModuleEventKind::Answer { result, .. } => result.ok().flatten(),
            _ => None,
        });
        let bodies: Vec<_> = bodies.collect();
        assert_eq!(bodies, [vec![21, 0, 0, 0], vec![100, 0, 0, 0], b"42".to_vec()]);
        assert_eq!(log.take().len(), 2);
    }
}
