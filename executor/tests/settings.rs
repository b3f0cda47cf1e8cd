//! Settings: permissions, validity, and reports of changes.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;

use common::*;
use downbeat_executor::*;

/// Declares a gain from 0 to 4 that must be even, a read-only port, and a name. Logs every change.
fn tuned(log: &Log) -> Scripted {
    let log = log.clone();
    module(move |setup| {
        let gain = setup.setting_in("gain", 2.0, 0.0..=4.0, "of the loop")?;
        setup.read_only_setting("port", "usb0".to_owned(), "where the motors are")?;
        let name = setup.setting("name", "one".to_owned(), "its name")?;
        setup.accept_if(gain, |_, gain: &f64| match gain % 2.0 == 0.0 {
            true => Ok(()),
            false => Err(format!("{gain} is odd")),
        });
        setup.accept_if(name, |_, name: &String| {
            assert!(!name.is_empty(), "a check that panics, as this test wants it");
            Ok(())
        });
        let (gains, names) = (log.clone(), log);
        setup.on_change(gain, move |_, ctx| gains.note(format!("gain {}", ctx.get(gain))));
        setup.on_change(name, move |_, ctx| names.note(format!("name {}", ctx.get(name))));
        Ok(())
    })
}

fn values(infos: &[SettingInfo]) -> Vec<String> {
    infos.iter().map(|info| format!("{} {}", info.name, info.value)).collect()
}

/// A core that runs on its own thread.
struct Running {
    handle: CoreHandle,
    thread: Option<JoinHandle<Result<(), RunError>>>,
}

impl Running {
    fn new(mut core: Core) -> Self {
        let handle = core.handle();
        Self { handle, thread: Some(std::thread::spawn(move || core.run())) }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.handle.stop();
        let ended = self.thread.take().unwrap().join();
        if !std::thread::panicking() {
            ended.unwrap().unwrap();
        }
    }
}

/// Refused values, each with its error text.
fn refusals() -> [(&'static str, SettingValue, &'static str); 6] {
    [
        ("gain", 1.0.into(), "module \"tuned\", setting \"gain\": 1 is odd"),
        ("gain", 6.0.into(), "module \"tuned\", setting \"gain\": 6 is out of range, 0 to 4 is allowed"),
        ("gain", true.into(), "module \"tuned\", setting \"gain\": expected double, found bool true"),
        (
            "port",
            "usb1".to_owned().into(),
            "module \"tuned\", setting \"port\": it is read-only; give it in the robot file",
        ),
        (
            "gian",
            2.0.into(),
            "module \"tuned\", setting \"gian\": there is no such setting; there is gain, port, name",
        ),
        (
            "name",
            String::new().into(),
            "module \"tuned\", setting \"name\": the module's check of it panicked: a check that panics, as this test wants it",
        ),
    ]
}

#[test]
fn what_a_setting_or_its_module_refuses_changes_nothing_and_is_told() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    core.add("tuned", tuned(&log)).unwrap();
    cycles(&mut core, &clock, 1);
    for (setting, value, expected) in refusals() {
        let receipt = core.handle().set("tuned", setting, value);
        cycles(&mut core, &clock, 2);
        assert_eq!(receipt.try_take().unwrap().unwrap_err().to_string(), expected);
    }
    assert_eq!(log.take(), [""; 0]);
    assert_eq!(values(&core.settings("tuned").unwrap()), ["gain 2", "port \"usb0\"", "name \"one\""]);
    assert_eq!(
        core.modules()[0].state,
        LifecycleState::Active,
        "a check that panics does not end its module"
    );
}

#[test]
fn a_detached_module_refuses_the_same() {
    let (mut core, log) = (Core::new(), Log::default());
    core.add_with("tuned", tuned(&log), detached()).unwrap();
    let core = Running::new(core);
    for (setting, value, expected) in refusals() {
        let receipt = core.handle.set("tuned", setting, value);
        assert_eq!(receipt.wait(WATCHDOG).unwrap().unwrap_err().to_string(), expected);
    }
    assert_eq!(core.handle.set("tuned", "gain", 4.0).wait(WATCHDOG), Some(Ok(())));
    wait_until("the change is announced", || log.take() == ["gain 4"]);
}

#[test]
fn whoever_has_the_answer_of_a_detached_module_finds_it_in_the_core() {
    let mut core = Core::new();
    core.add_with("tuned", tuned(&Log::default()), detached()).unwrap();
    let core = Running::new(core);
    // Often, since it depends on who of two threads comes first.
    for gain in [0, 2, 4].repeat(200) {
        assert_eq!(core.handle.set("tuned", "gain", gain).wait(WATCHDOG), Some(Ok(())));
        let known = core.handle.settings("tuned").wait(WATCHDOG).unwrap().unwrap();
        assert_eq!(values(&known), [&format!("gain {gain}"), "port \"usb0\"", "name \"one\""]);
    }
    for transition in [Transition::Deactivate, Transition::Activate].repeat(300) {
        let state = core.handle.transition("tuned", transition).wait(WATCHDOG).unwrap();
        assert_eq!(Ok(core.handle.modules().wait(WATCHDOG).unwrap()[0].state), state);
    }
}

#[test]
fn a_read_only_setting_is_given_at_the_start() {
    let (mut core, _) = manual_core();
    let settings = [("port".to_owned(), SettingValue::Text("usb7".into()))].into();
    core.add_with("tuned", tuned(&Log::default()), ModuleOptions { settings, ..ModuleOptions::default() })
        .unwrap();
    let infos = core.settings("tuned").unwrap();
    assert_eq!(values(&infos), ["gain 2", "port \"usb7\"", "name \"one\""]);
    assert_eq!(infos.iter().map(|info| info.is_read_only).collect::<Vec<_>>(), [false, true, false]);
}

#[test]
fn a_value_out_of_range_at_the_start_keeps_the_module_out() {
    let (mut core, _) = manual_core();
    let settings = [("gain".to_owned(), SettingValue::Double(5.0))].into();
    let added = core.add_with(
        "tuned",
        tuned(&Log::default()),
        ModuleOptions { settings, ..ModuleOptions::default() },
    );
    let message = "module \"tuned\", setting \"gain\": 5 is out of range, 0 to 4 is allowed";
    assert_eq!(added.unwrap_err().to_string(), message);
    assert!(core.modules().is_empty());
}

#[test]
fn a_module_sets_another_in_the_sync_phase_and_the_last_one_in_order_counts() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    core.add("tuned", tuned(&log)).unwrap();
    for (name, value) in [("first", 0.0), ("second", 4.0), ("third", 3.0)] {
        core.add(name, module(move |setup| setup.every(STEP, move |_, ctx| ctx.set("tuned", "gain", value))))
            .unwrap();
    }
    cycles(&mut core, &clock, 2);
    assert_eq!(log.take(), [""; 0]);
    cycles(&mut core, &clock, 1);
    // The value of the third module is refused.
    assert_eq!(log.take(), ["gain 4"]);
}

#[test]
fn a_module_sets_itself_and_is_told() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let noted = log.clone();
    let counting = module(move |setup| {
        let count = setup.setting("count", 0_i64, "how often it has run")?;
        setup.on_change(count, move |_, ctx| noted.note(ctx.get(count).to_string()));
        setup.every(STEP, move |_, ctx| ctx.set("counting", "count", ctx.get(count) + 1))
    });
    core.add("counting", counting).unwrap();
    cycles(&mut core, &clock, 5);
    assert_eq!(log.take(), ["1", "2", "3"]);
}

#[test]
fn a_value_that_stays_the_same_is_not_announced() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    core.add("tuned", tuned(&log)).unwrap();
    let receipt = core.handle().set("tuned", "gain", 2.0);
    cycles(&mut core, &clock, 2);
    assert_eq!((receipt.try_take(), log.take()), (Some(Ok(())), vec![]));
}

#[test]
fn settings_are_transferred_where_both_have_them_and_the_taker_does_not_refuse() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let settings = [
        ("gain".to_owned(), SettingValue::Double(4.0)),
        ("name".to_owned(), SettingValue::Text("other".into())),
        ("port".to_owned(), SettingValue::Text("usb1".into())),
    ];
    let options = ModuleOptions { settings: settings.into(), ..ModuleOptions::default() };
    core.add_with("giver", tuned(&Log::default()), options).unwrap();
    core.add("taker", tuned(&log)).unwrap();
    let small = module(|setup| {
        setup.setting("name", "small".to_owned(), "its name")?;
        setup.setting_in("gain", 1.0, 0.0..=2.0, "of the loop")?;
        setup.setting("own", true, "only in this module").map(drop)
    });
    core.add("small", small).unwrap();
    let receipts = ["taker", "small"].map(|taker| core.handle().transfer_settings("giver", taker));
    cycles(&mut core, &clock, 2);
    assert_eq!(receipts.map(|receipt| receipt.try_take()), [Some(Ok(())), Some(Ok(()))]);
    assert_eq!(log.take(), ["gain 4", "name other"]);
    assert_eq!(values(&core.settings("taker").unwrap()), ["gain 4", "port \"usb0\"", "name \"other\""]);
    assert_eq!(values(&core.settings("small").unwrap()), ["name \"other\"", "gain 1", "own true"]);
}

#[test]
fn a_module_takes_over_the_settings_of_one_that_is_detached() {
    let (mut core, log) = (Core::new(), Log::default());
    core.add_with("giver", tuned(&Log::default()), detached()).unwrap();
    core.add("taker", tuned(&log)).unwrap();
    let core = Running::new(core);
    core.handle.set("giver", "gain", 4.0).wait(WATCHDOG).unwrap().unwrap();
    let gain = |module: &str| core.handle.settings(module).wait(WATCHDOG).unwrap().unwrap()[0].value.clone();
    core.handle.transfer_settings("giver", "taker").wait(WATCHDOG).unwrap().unwrap();
    assert_eq!(gain("taker"), SettingValue::Double(4.0));
}

#[test]
fn who_does_not_exist_neither_gives_nor_takes_settings() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    core.add("tuned", tuned(&log)).unwrap();
    let handle = core.handle();
    let receipts = [handle.transfer_settings("nobody", "tuned"), handle.transfer_settings("tuned", "nobody")];
    cycles(&mut core, &clock, 1);
    for receipt in receipts {
        let error = receipt.try_take().unwrap().unwrap_err().to_string();
        assert_eq!(error, "there is no module \"nobody\"; there is \"tuned\"");
    }
}

#[test]
fn an_inactive_module_is_told_of_a_change_when_it_is_active() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let options = ModuleOptions { initial_state: LifecycleState::Inactive, ..ModuleOptions::default() };
    core.add_with("tuned", tuned(&log), options).unwrap();
    drop(core.handle().set("tuned", "gain", 4.0));
    cycles(&mut core, &clock, 3);
    assert_eq!((log.take(), values(&core.settings("tuned").unwrap())[0].as_str()), (vec![], "gain 4"));
    drop(core.handle().transition("tuned", Transition::Activate));
    cycles(&mut core, &clock, 2);
    assert_eq!(log.take(), ["gain 4"]);
}

#[test]
fn changes_of_parts_are_told_with_the_cycle_or_the_run_that_has_them() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let changes = changes_in(&mut core);
    core.add("tuned", tuned(&log)).unwrap();
    let observer = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
    core.add_with("watching", tuned(&log), observer).unwrap();
    cycles(&mut core, &clock, 1);
    // In this order: a refused change, the change of an observer, the change of a part.
    for (module, gain) in [("tuned", 1.0), ("watching", 4.0), ("tuned", 4.0)] {
        drop(core.handle().set(module, "gain", gain));
    }
    let time = clock.now();
    core.cycle().unwrap();
    cycles(&mut core, &clock, 2);
    let settings = vec![("gain".to_owned(), SettingValue::Double(4.0))];
    let told = SettingsChange { time, module: "tuned".into(), step: None, settings };
    assert_eq!(changes.try_iter().collect::<Vec<_>>(), [told]);
}

#[test]
fn changes_of_a_detached_part_are_told_with_its_first_run_that_has_them() {
    let (mut core, log) = (Core::new(), Log::default());
    let changes = changes_in(&mut core);
    core.add_with("tuned", tuned(&log), detached()).unwrap();
    let core = Running::new(core);
    assert_eq!(core.handle.set("tuned", "gain", 4_i64).wait(WATCHDOG), Some(Ok(())));
    let change = changes.recv_timeout(WATCHDOG).unwrap();
    assert_eq!((&*change.module, change.step), ("tuned", Some(1)));
    let gain = |value: f64| ("gain".to_owned(), SettingValue::Double(value));
    assert_eq!(change.settings, [gain(4.0)], "as the setting holds it");
    // Paused, so that both changes wait for the next run.
    core.handle.pause();
    drop(core.handle.set("tuned", "gain", 0.0));
    drop(core.handle.set("tuned", "gain", 4.0));
    core.handle.resume();
    let mut told = Vec::new();
    while told.len() < 2 {
        told.extend(changes.recv_timeout(WATCHDOG).unwrap().settings);
    }
    assert_eq!(told, [gain(0.0), gain(4.0)], "each, in order");
}

fn changes_in(core: &mut Core) -> Receiver<SettingsChange> {
    let (sender, changes) = channel();
    let listener = module(move |setup| {
        // The test may have dropped the receiver.
        let tell = move |_: &mut Scripted, change: Received<'_, SettingsChange>, _: &mut Context<'_>| {
            drop(sender.send(change.clone()));
        };
        setup.subscribe(SettingsChange::TOPIC, tell)
    });
    core.add("listener", listener).unwrap();
    changes
}
