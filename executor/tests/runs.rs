//! The account of runs: which modules ran in a cycle, why, and what they published.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};

use common::{STEP, cycles, detached, manual_core, module};
use downbeat_executor::*;

fn accounts(core: &mut Core) -> Receiver<Arc<CycleRuns>> {
    let (sender, receiver) = channel();
    let observer = module(move |setup| {
        setup.subscribe(CycleRuns::TOPIC, move |_, runs: Received<'_, Arc<CycleRuns>>, _| {
            sender.send(Arc::clone(&runs)).unwrap();
        })
    });
    let options = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
    core.add_with("listener", observer, options).unwrap();
    receiver
}

/// The accounts as lines: the cycle, messages of inlets, and each run.
fn lines(accounts: &Receiver<Arc<CycleRuns>>) -> Vec<String> {
    let published = |account: &CycleRuns, published: &[Published]| {
        let each = published.iter().map(|published| {
            format!(" {} {}", published.count, account.wiring.topics[published.topic as usize])
        });
        each.collect::<String>()
    };
    let line = |account: Arc<CycleRuns>| {
        let inlets = published(&account, &account.from_inlets);
        let runs = account.runs.iter().map(|run| {
            let causes: Vec<_> = run.causes.iter().map(|cause| format!("{cause:?}")).collect();
            let name = &account.wiring.modules[run.module as usize].name;
            let step = run.step.map(|step| format!("#{step}")).unwrap_or_default();
            format!(" | {name}{step}: {} ->{}", causes.join("+"), published(&account, account.published(run)))
        });
        format!("{}:{inlets}{}", account.cycle, runs.collect::<String>())
    };
    accounts.try_iter().map(line).collect()
}

/// Publishes each number of a topic twice on another one.
fn doubler(from: &'static str, to: &'static str) -> impl Module {
    module(move |setup| {
        let out = setup.publish::<u32>(to)?;
        setup.subscribe(from, move |_, number: Received<'_, u32>, ctx| {
            ctx.publish_all(out, [*number, *number]);
        })
    })
}

#[test]
fn each_run_is_reported_with_its_causes_and_messages_in_the_order_of_the_batches() {
    let (mut core, clock) = manual_core();
    let accounts = accounts(&mut core);
    core.add("second", doubler("twice", "four times")).unwrap_err();
    core.add("first", doubler("number", "twice")).unwrap();
    core.add("second", doubler("twice", "four_times")).unwrap();
    let number = core.inlet("number").unwrap();
    cycles(&mut core, &clock, 1);
    number.publish(1_u32).unwrap();
    number.publish(2_u32).unwrap();
    cycles(&mut core, &clock, 5);
    assert_eq!(
        lines(&accounts),
        [
            "0: | first: Start+Messages -> | second: Start+Messages ->",
            "1: 2 number",
            "2: | first: Messages -> 4 twice",
            "3: | second: Messages -> 8 four_times",
        ]
    );
}

#[test]
fn the_report_brings_about_no_cycle() {
    let clock = ManualClock::new(Time::ZERO);
    let mut core = Core::new().with_clock(clock.clone());
    let accounts = accounts(&mut core);
    core.add("ticker", module(|setup| setup.every(STEP, |_, _| ()))).unwrap();
    core.run_simulated(&clock, Some(Time::ZERO + STEP * 3)).unwrap();
    // The last line comes with the cycles of the stop.
    let expected = ["0: | ticker: Start+Messages ->", "1: | ticker: Time ->", "2: | ticker: Time ->"];
    assert_eq!(lines(&accounts)[..3], expected);
    assert_eq!(core.cycle().unwrap_err().to_string(), RunError::Stopped.to_string());
}

#[test]
fn a_run_that_panics_publishes_nothing_and_its_successor_is_wired_anew() {
    let (mut core, clock) = manual_core();
    let accounts = accounts(&mut core);
    let options = ModuleOptions { restart: Restart::Always { backoff: STEP }, ..ModuleOptions::default() };
    let faulty = || {
        module(|setup| {
            let out = setup.publish::<u32>("out")?;
            setup.subscribe("in", move |_, number: Received<'_, u32>, ctx| {
                ctx.publish(out, *number);
                assert!(*number != 0, "zero");
            })
        })
    };
    core.add_restartable("faulty", faulty, options).unwrap();
    let number = core.inlet("in").unwrap();
    for value in [1_u32, 0, 1] {
        number.publish(value).unwrap();
        cycles(&mut core, &clock, 2);
    }
    cycles(&mut core, &clock, 1);
    let all: Vec<_> = accounts.try_iter().collect();
    let since: Vec<_> = all.iter().map(|account| (account.cycle, account.wiring.modules[0].since)).collect();
    let (sender, receiver) = channel();
    all.into_iter().for_each(|account| sender.send(account).unwrap());
    assert_eq!(
        lines(&receiver),
        [
            "0: 1 in | faulty: Start+Messages ->",
            "1: | faulty: Messages -> 1 out",
            "2: 1 in",
            "3: | faulty: Messages ->",
            "4: 1 in",
            "5: | faulty: Start+Messages -> 1 out",
        ]
    );
    assert_eq!(since, [(0, 0), (1, 0), (2, 0), (3, 0), (4, 4), (5, 4)]);
}

#[test]
fn an_inactive_module_receives_nothing_and_its_transitions_and_last_callback_are_runs() {
    struct Managed(Option<Publication<&'static str>>);

    impl Module for Managed {
        type Ports = ();

        fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
            self.0 = Some(setup.publish("out")?);
            setup.subscribe("in", |_, _: Received<'_, u32>, _| ())
        }

        fn activate(&mut self, ctx: &mut Context<'_>) -> Result<(), TransitionError> {
            ctx.publish(self.0.unwrap(), "active");
            Ok(())
        }

        fn shutdown(&mut self, ctx: &mut Context<'_>) {
            ctx.publish(self.0.unwrap(), "end");
        }
    }

    let (mut core, clock) = manual_core();
    let accounts = accounts(&mut core);
    let options = ModuleOptions { initial_state: LifecycleState::Inactive, ..ModuleOptions::default() };
    core.add_with("managed", Managed(None), options).unwrap();
    let number = core.inlet("in").unwrap();
    number.publish(1_u32).unwrap();
    cycles(&mut core, &clock, 2);
    let activated = core.handle().transition("managed", Transition::Activate);
    cycles(&mut core, &clock, 2);
    assert!(activated.try_take().unwrap().is_ok());
    let removed = core.handle().remove("managed");
    cycles(&mut core, &clock, 2);
    assert!(removed.try_take().unwrap().is_ok());
    assert_eq!(
        lines(&accounts),
        ["0: 1 in | managed: Transition ->", "3: | managed: Start -> 1 out", "4: | managed: Stop -> 1 out",]
    );
}

#[test]
fn runs_of_detached_modules_come_first_with_their_numbers() {
    let mut core = Core::new();
    let accounts = accounts(&mut core);
    core.add_with("slow", doubler("ticks", "slow_ticks"), detached()).unwrap();
    let handle = core.handle();
    let mut count = 0_u32;
    let ticker = module(move |setup| {
        let out = setup.publish("ticks")?;
        setup.every(STEP, move |_, ctx| {
            ctx.publish(out, count);
            count += 1;
        })
    });
    core.add("ticker", ticker).unwrap();
    let mut received = 0_u32;
    let counter = module(move |setup| {
        setup.subscribe("slow_ticks", move |_, _: Received<'_, u32>, _| {
            received += 1;
            if received == 20 {
                handle.stop();
            }
        })
    });
    core.add("counter", counter).unwrap();
    core.run().unwrap();
    let accounts: Vec<_> = accounts.try_iter().collect();
    let steps = accounts.iter().flat_map(|account| account.runs.iter().map(move |run| (account, run)));
    let steps: Vec<_> = steps.filter(|(_, run)| run.step.is_some()).collect();
    let numbers: Vec<_> = steps.iter().filter_map(|(_, run)| run.step).collect();
    assert!(numbers.iter().copied().eq(0..numbers.len() as u64), "{numbers:?}");
    assert!(numbers.len() > 3);
    let published = steps.iter().flat_map(|(account, run)| account.published(run));
    assert!(published.map(|published| published.count).sum::<u32>() >= 20);
    let causes: Vec<_> = steps.iter().map(|(_, run)| run.causes).collect();
    assert!(causes[0].has(RunCause::Start) && causes.last().unwrap().has(RunCause::Stop));
    assert!(causes[1].iter().eq([RunCause::Messages]));
    for account in accounts {
        assert!(account.runs.is_sorted_by_key(|run| run.step.is_none()));
    }
}

#[test]
fn the_account_is_the_same_under_every_launcher() {
    let account = |launcher: Box<dyn Launcher>| {
        let clock = ManualClock::new(Time::ZERO);
        let mut core = Core::new().with_launcher(launcher).with_clock(clock.clone());
        let accounts = accounts(&mut core);
        for stage in 0..4 {
            let (from, to): (&'static str, &'static str) =
                [("a", "b"), ("b", "c"), ("a", "c"), ("c", "d")][stage];
            core.add(&format!("stage_{stage}"), doubler(from, to)).unwrap();
        }
        let inlet = core.inlet("a").unwrap();
        for number in 0..20_u32 {
            (0..number % 3).for_each(|_| inlet.publish(number).unwrap());
            cycles(&mut core, &clock, 1);
        }
        core.stop();
        lines(&accounts)
    };
    let linear = account(Box::new(Linear));
    assert!(linear.len() > 15);
    assert_eq!(account(Box::new(Pool::new(3).unwrap())), linear);
    assert_eq!(account(Box::new(Threads::new())), linear);
}
