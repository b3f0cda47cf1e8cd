//! Modules tested with a probe.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use common::{Log, module};
use downbeat_executor::log::{info_every, warn_once};
use downbeat_executor::*;

fn elapsed_ms(time: Time) -> u128 {
    time.saturating_since(Probe::START).as_millis()
}

#[test]
fn timers_and_tasks_run_at_their_times_up_to_the_end_of_what_passes() {
    let log = Log::default();
    let noted = log.clone();
    let mut probe = Probe::new();
    let timers = module(move |setup| {
        let later = noted.clone();
        let task = setup.task(move |_, ctx| later.note(format!("task {}", elapsed_ms(ctx.now()))));
        setup
            .subscribe::<(), _>("go", move |_, _, ctx| ctx.schedule_after(task, Duration::from_millis(15)))?;
        setup.every(Duration::from_millis(10), move |_, ctx| {
            noted.note(format!("timer {}", elapsed_ms(ctx.now())));
        })
    });
    probe.add("timers", timers).unwrap();
    probe.publish("go", ()).unwrap();
    assert_eq!(log.take(), Vec::<String>::new());
    probe.advance(Duration::from_millis(20)).unwrap();
    assert_eq!(log.take(), ["timer 10", "task 15", "timer 20"]);
}

#[test]
fn a_chain_of_modules_has_run_to_its_end_when_a_message_was_published() {
    let mut probe = Probe::new();
    for number in 0..20 {
        let link = module(move |setup| {
            let out = setup.publish(&format!("link_{}", number + 1))?;
            setup.subscribe::<u32, _>(&format!("link_{number}"), move |_, value, ctx| {
                ctx.publish(out, *value + 1)
            })
        });
        probe.add(&format!("module_{number}"), link).unwrap();
    }
    let end = probe.listen::<u32>("link_20").unwrap();
    probe.publish("link_0", 0_u32).unwrap();
    assert_eq!(end.take(), [20]);
    assert!(end.take().is_empty() && end.take_last().is_none());
    assert!(matches!(probe.publish("link_0", "text"), Err(ProbeError::Setup(SetupError::TopicType { .. }))));
}

#[test]
fn calls_are_answered_later_refused_missed_or_given_up() {
    let mut probe = Probe::new();
    let server = module(|setup| {
        setup.serve::<u32, u32, _>("double", |_, &number, _| match number {
            0..100 => Ok(number * 2),
            _ => Err("too much".to_owned()),
        })?;
        let waiting = Arc::<Mutex<Vec<Responder<u32, u32>>>>::default();
        let asked = Arc::clone(&waiting);
        let task = setup.task(move |_, ctx| {
            waiting.lock().unwrap().drain(..).for_each(|responder| ctx.reply(responder, Ok(7)));
        });
        setup.serve_later::<u32, u32, _>("later", move |_, delay, responder, ctx| {
            asked.lock().unwrap().push(responder);
            ctx.schedule_after(task, Duration::from_secs(delay.into()));
        })
    });
    probe.add("server", server).unwrap();
    assert_eq!(probe.call::<u32, u32>("double", 4).unwrap(), 8);
    let refused = probe.call::<u32, u32>("double", 100).unwrap_err();
    assert!(refused.to_string().contains("too much"), "{refused}");
    let before = probe.now();
    assert_eq!(probe.call::<u32, u32>("later", 2).unwrap(), 7);
    assert_eq!(probe.now().saturating_since(before), Duration::from_secs(2));
    let late = probe.call::<u32, u32>("later", 60).unwrap_err();
    assert!(matches!(late, ProbeError::Call(CallError::TimedOut { .. })), "{late}");
    assert!(matches!(probe.call::<u32, u32>("nobody", 1), Err(ProbeError::Call(_))));
}

#[test]
fn a_panic_and_work_without_end_are_errors_and_a_setting_may_refuse() {
    let mut probe = Probe::new();
    let fragile = module(|setup| {
        setup.setting_in("speed", 0.5, 0.0..=1.0, "m/s")?;
        setup.subscribe::<u32, _>("number", |_, number, _| assert!(*number < 3, "{} is too much", *number))
    });
    probe.add("fragile", fragile).unwrap();
    probe.set("fragile", "speed", 0.75).unwrap();
    assert!(matches!(probe.set("fragile", "speed", 1.5), Err(ProbeError::Setting(_))));
    probe.publish("number", 2_u32).unwrap();
    let panicked = probe.publish("number", 3_u32).unwrap_err().to_string();
    assert!(panicked.contains("\"fragile\" panicked: 3 is too much"), "{panicked}");
    probe.advance(Duration::from_secs(1)).unwrap();

    let restless = module(|setup| {
        let out = setup.publish("echo")?;
        setup.subscribe::<(), _>("echo", move |_, _, ctx| ctx.publish(out, ()))
    });
    probe.add("restless", restless).unwrap();
    assert!(matches!(probe.publish("echo", ()), Err(ProbeError::Restless { .. })));
}

#[test]
fn a_module_that_starts_again_is_reported_for_each_panic() {
    let mut probe = Probe::new();
    let restart = Restart::Always { backoff: Duration::from_secs(1) };
    let options = ModuleOptions { restart, ..ModuleOptions::default() };
    let fragile =
        || module(|setup| setup.subscribe::<(), _>("fall", |_, _, _| panic!("fell, as this test wants it")));
    probe.core().add_restartable("fragile", fragile, options).unwrap();
    for _ in 0..2 {
        assert!(matches!(probe.publish("fall", ()), Err(ProbeError::Panicked { .. })));
        probe.advance(Duration::from_secs(2)).unwrap();
    }
}

/// Collects the lines of the log.
#[derive(Clone, Default)]
struct Lines(Arc<Mutex<Vec<String>>>);

impl tracing::Subscriber for Lines {
    fn enabled(&self, metadata: &tracing::Metadata<'_>) -> bool {
        metadata.target().starts_with("probe")
    }

    fn new_span(&self, _: &tracing::span::Attributes<'_>) -> tracing::span::Id {
        tracing::span::Id::from_u64(1)
    }

    fn record(&self, _: &tracing::span::Id, _: &tracing::span::Record<'_>) {}

    fn record_follows_from(&self, _: &tracing::span::Id, _: &tracing::span::Id) {}

    fn event(&self, event: &tracing::Event<'_>) {
        struct Text(String);
        impl tracing::field::Visit for Text {
            fn record_debug(&mut self, field: &tracing::field::Field, value: &dyn std::fmt::Debug) {
                self.0.push_str(&format!("{field}={value:?} "));
            }
        }
        let mut text = Text(format!("{} ", running_module().unwrap_or_default()));
        event.record(&mut text);
        self.0.lock().unwrap().push(text.0);
    }

    fn enter(&self, _: &tracing::span::Id) {}

    fn exit(&self, _: &tracing::span::Id) {}
}

#[test]
fn lines_of_the_log_are_limited_for_each_module_and_count_what_they_leave_out() {
    let lines = Lines::default();
    let _logging = tracing::subscriber::set_default(lines.clone());
    let mut probe = Probe::new();
    for name in ["left", "right"] {
        let wheel = module(|setup| {
            setup.every(Duration::from_millis(10), |_, ctx| {
                info_every!(ctx, Duration::from_millis(100), "turns");
                warn_once!(ctx, joint = 5, "is {}", "warm");
            })
        });
        probe.add(name, wheel).unwrap();
    }
    probe.advance(Duration::from_millis(200)).unwrap();
    let lines = lines.0.lock().unwrap();
    for name in ["left", "right"] {
        let found: Vec<_> = lines.iter().filter_map(|line| line.strip_prefix(name)).collect();
        assert_eq!(found, [" message=turns ", " message=is warm joint=5 ", " message=turns suppressed=9 "]);
    }
}
