//! User-defined mechanisms: access to them, and the order of requests.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::*;
use downbeat_executor::*;

/// Keeps all requests in order, and shows them to modules.
#[derive(Default)]
struct Ledger {
    requests: Vec<(ModuleId, u32)>,
}

impl Mechanism for Ledger {
    type View = Vec<String>;
    type Port = Vec<u32>;

    const NAME: &'static str = "ledger";
    const VERSION: Version = Version::new(1, 2);

    fn view(&self) -> Vec<String> {
        vec!["empty".into()]
    }

    fn sync(&mut self, phase: &mut SyncPhase<'_>) {
        let requests = &mut self.requests;
        phase
            .each_port::<Self>(|module, port| requests.extend(port.drain(..).map(|number| (module, number))));
        for (module, number) in self.requests.drain(..) {
            let name = phase.module_name(module).unwrap_or("nobody").to_owned();
            let entry = format!("{} {name} {number}", phase.cycle());
            phase.view::<Self>().push(entry);
            phase.wake(module);
        }
    }
}

/// Another type under the same name.
struct OtherLedger;

impl Mechanism for OtherLedger {
    type View = ();
    type Port = Vec<()>;

    const NAME: &'static str = "ledger";
    const VERSION: Version = Version::new(1, 2);

    fn view(&self) {}

    fn sync(&mut self, _: &mut SyncPhase<'_>) {}
}

fn asking(version: Version) -> Scripted {
    module(move |setup| setup.mechanism::<Ledger>(version).map(drop))
}

fn refusal(core: &mut Core, version: Version, options: ModuleOptions) -> String {
    core.add_with("module", asking(version), options).unwrap_err().to_string()
}

#[test]
fn a_mechanism_is_used_at_its_version_or_an_earlier_compatible_one() {
    let mut core = Core::new().with_mechanism(Ledger::default());
    for minor in 0..=2 {
        core.add(&format!("module {minor}"), asking(Version::new(1, minor))).unwrap();
    }
}

#[test]
fn a_version_that_is_not_offered_is_refused_with_the_one_that_is() {
    let mut core = Core::new().with_mechanism(Ledger::default());
    for (major, minor) in [(1, 3), (2, 0), (0, 1)] {
        let expected = format!(
            "module \"module\" needs the mechanism \"ledger\" at version {major}.{minor}; this core offers version 1.2"
        );
        assert_eq!(refusal(&mut core, Version::new(major, minor), ModuleOptions::default()), expected);
    }
    assert!(core.modules().is_empty());
}

#[test]
fn an_unknown_mechanism_is_refused_with_those_there_are() {
    let expected = "module \"module\" needs the mechanism \"ledger\" at version 1.0; this core offers only modules 1.0, \
                    jobs 1.0, settings 1.0, messaging 1.0, services 1.0, timers 1.0";
    assert_eq!(refusal(&mut Core::new(), Version::new(1, 0), ModuleOptions::default()), expected);
}

#[test]
fn a_module_may_require_a_mechanism_of_the_core_by_name() {
    let (mut core, _) = manual_core();
    core.add("content", module(|setup| setup.require("services", Version::new(1, 0)))).unwrap();
    let early = module(|setup| setup.require("services", Version::new(7, 0)));
    let error = core.add("early", early).unwrap_err().to_string();
    assert!(error.ends_with("at version 7.0; this core offers version 1.0"), "{error}");
}

#[test]
fn a_detached_module_cannot_use_a_mechanism() {
    let mut core = Core::new().with_mechanism(Ledger::default());
    let error = refusal(&mut core, Version::new(1, 0), detached());
    assert!(
        error.starts_with("module \"module\": a detached module cannot use the mechanism \"ledger\""),
        "{error}"
    );
}

#[test]
fn another_mechanism_of_the_same_name_is_not_taken_for_it() {
    let mut core = Core::new().with_mechanism(OtherLedger);
    let error = refusal(&mut core, Version::new(1, 0), ModuleOptions::default());
    assert_eq!(error, "module \"module\": the mechanism \"ledger\" is of another Rust type");
}

#[test]
fn mechanisms_are_listed_in_the_order_of_the_sync_phase() {
    let core = Core::new().with_mechanism(Ledger::default());
    let listed = core.mechanisms().map(|(name, version)| format!("{name} {version}")).collect::<Vec<_>>();
    let expected = [
        "modules 1.0",
        "jobs 1.0",
        "settings 1.0",
        "messaging 1.0",
        "services 1.0",
        "timers 1.0",
        "ledger 1.2",
    ];
    assert_eq!(listed, expected);
}

/// Sends two requests in each of its first three runs, to which the mechanism wakes it, and logs the view.
fn scribe(log: &Log, base: u32) -> Scripted {
    let log = log.clone();
    module(move |setup| {
        let ledger = setup.mechanism::<Ledger>(Version::new(1, 0))?;
        let mut runs = 0;
        setup.each_run(move |_, ctx| {
            log.note(format!("{} {}", ctx.module_name(), ctx.view(ledger).len()));
            if runs < 3 {
                ctx.ask(ledger, base + 2 * runs);
                ctx.ask(ledger, base + 2 * runs + 1);
            }
            runs += 1;
        });
        Ok(())
    })
}

/// The final content of the ledger, and the views that each module logged.
fn ledger_under(launcher: impl Launcher + 'static) -> (Vec<String>, Vec<Vec<String>>) {
    let clock = ManualClock::new(Time::ZERO);
    let mut core =
        Core::new().with_clock(clock.clone()).with_launcher(launcher).with_mechanism(Ledger::default());
    let logs = [10, 20, 30, 40].map(|base| {
        let log = Log::default();
        core.add(&format!("m{base}"), scribe(&log, base)).unwrap();
        log
    });
    cycles(&mut core, &clock, 6);
    let last = Log::default();
    let noted = last.clone();
    let reader = module(move |setup| {
        let ledger = setup.mechanism::<Ledger>(Version::new(1, 2))?;
        setup.each_run(move |_, ctx| ctx.view(ledger).iter().for_each(|entry| noted.note(entry.clone())));
        Ok(())
    });
    core.add("reader", reader).unwrap();
    cycles(&mut core, &clock, 1);
    (last.take(), logs.map(|log| log.take()).into())
}

#[test]
fn requests_come_in_the_order_of_registration_and_asking_under_every_launcher() {
    let mut expected = vec!["empty".to_owned()];
    for cycle in 0..3 {
        for base in [10, 20, 30, 40] {
            expected.extend((0..2).map(|nth| format!("{cycle} m{base} {}", base + 2 * cycle + nth)));
        }
    }
    let (entries, views) = ledger_under(Linear);
    assert_eq!(entries, expected);
    // In a cycle all modules see the same view, whichever have already sent requests.
    assert_eq!(views[3], ["m40 1", "m40 9", "m40 17", "m40 25"]);
    for threads in 1..=4 {
        assert_eq!(
            ledger_under(Pool::new(threads).unwrap()),
            (entries.clone(), views.clone()),
            "Pool({threads})"
        );
    }
    assert_eq!(ledger_under(Threads::new()), (entries, views), "Threads");
}

#[test]
fn what_a_module_asked_in_a_run_that_panicked_is_not_applied() {
    let clock = ManualClock::new(Time::ZERO);
    let mut core = Core::new().with_clock(clock.clone()).with_mechanism(Ledger::default());
    let faulty = module(|setup| {
        let ledger = setup.mechanism::<Ledger>(Version::new(1, 0))?;
        setup.each_run(move |_, ctx| {
            ctx.ask(ledger, 1);
            panic!("a module that panics, as this test wants it");
        });
        Ok(())
    });
    core.add("faulty", faulty).unwrap();
    let log = Log::default();
    core.add("scribe", scribe(&log, 10)).unwrap();
    cycles(&mut core, &clock, 2);
    assert_eq!(log.take(), ["scribe 1", "scribe 3"]);
}

#[test]
fn a_key_of_another_module_ends_who_uses_it() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let (sender, keys) = std::sync::mpsc::channel();
    let owner = module(move |setup| {
        sender.send(setup.publish::<u32>("numbers")?).unwrap();
        Ok(())
    });
    core.add("owner", owner).unwrap();
    let key = keys.recv().unwrap();
    let noted = log.clone();
    let thief = module(move |setup| {
        setup.every(STEP, move |_, ctx| {
            noted.note("publishes");
            ctx.publish(key, 1);
        })
    });
    core.add("thief", thief).unwrap();
    cycles(&mut core, &clock, 4);
    assert_eq!(log.take(), ["publishes"]);
    assert_eq!(core.modules()[1].state, LifecycleState::Finalized);
}

/// Adds up the deposits of each module, and returns the sum in the module's port.
struct Accounts;

#[derive(Default)]
struct Account {
    deposits: Vec<u32>,
    balance: u32,
}

impl Port for Account {
    fn changed(&mut self, change: ModuleChange<'_>) -> bool {
        if let ModuleChange::Panicked = change {
            self.deposits.clear();
        }
        false
    }
}

impl Mechanism for Accounts {
    type View = ();
    type Port = Account;

    const NAME: &'static str = "accounts";
    const VERSION: Version = Version::new(1, 0);

    fn view(&self) {}

    fn sync(&mut self, phase: &mut SyncPhase<'_>) {
        phase.each_port::<Self>(|_, account| account.balance += account.deposits.drain(..).sum::<u32>());
    }
}

#[test]
fn a_mechanism_gives_each_module_something_in_its_port() {
    let (core, _) = manual_core();
    let mut core = core.with_mechanism(Accounts);
    let balances = Log::default();
    for (name, deposit) in [("poor", 1), ("rich", 100)] {
        let balances = balances.clone();
        let saver = module(move |setup| {
            let accounts = setup.mechanism::<Accounts>(Version::new(1, 0))?;
            setup.each_run(move |_, ctx| {
                let name = ctx.module_name().to_owned();
                let account = ctx.port(accounts);
                balances.note(format!("{name} {}", account.balance));
                account.deposits.push(deposit);
            });
            Ok(())
        });
        let every_cycle = ModuleOptions { synchrony: Synchrony::EveryCycle, ..ModuleOptions::default() };
        core.add_with(name, saver, every_cycle).unwrap();
    }
    (0..3).for_each(|_| core.cycle().unwrap());
    assert_eq!(balances.take(), ["poor 0", "rich 0", "poor 1", "rich 100", "poor 2", "rich 200"]);
}

#[test]
fn what_a_module_asked_of_a_mechanism_is_void_if_it_panics_in_that_run() {
    let (core, _) = manual_core();
    let mut core = core.with_mechanism(Ledger::default());
    core.add(
        "reckless",
        module(|setup| {
            let ledger = setup.mechanism::<Ledger>(Version::new(1, 0))?;
            setup.each_run(move |_, ctx| {
                ctx.ask(ledger, 7);
                panic!("a module that panics, as this test wants it");
            });
            Ok(())
        }),
    )
    .unwrap();
    let seen = Log::default();
    let note = seen.clone();
    core.add_with(
        "reader",
        module(move |setup| {
            let ledger = setup.mechanism::<Ledger>(Version::new(1, 0))?;
            setup.each_run(move |_, ctx| note.note(ctx.view(ledger).join(",")));
            Ok(())
        }),
        ModuleOptions { synchrony: Synchrony::EveryCycle, ..ModuleOptions::default() },
    )
    .unwrap();
    (0..2).for_each(|_| core.cycle().unwrap());
    assert_eq!(seen.take(), ["empty", "empty"]);
}
