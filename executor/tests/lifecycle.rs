//! The states of a module, and its activity in each.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::*;
use downbeat_executor::*;

use LifecycleState::{Active, Finalized, Inactive, Unconfigured};

/// Logs its transitions, fails or panics in one of them, and logs an entry in every cycle and for every
/// message.
struct Managed {
    log: Log,
    fails_in: Option<Transition>,
    panics_in: Option<Transition>,
}

impl Managed {
    fn new(log: &Log) -> Self {
        Self { log: log.clone(), fails_in: None, panics_in: None }
    }

    fn make(&self, transition: Transition) -> Result<(), TransitionError> {
        self.log.note(transition.to_string());
        assert_ne!(self.panics_in, Some(transition), "a module that panics, as this test wants it");
        match self.fails_in == Some(transition) {
            true => Err(TransitionError::new("the port is taken")),
            false => Ok(()),
        }
    }
}

impl Module for Managed {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe(
            "numbers",
            |managed: &mut Self, number: Received<'_, u32>, _: &mut Context<'_>| {
                managed.log.note(format!("hears {}", *number));
            },
        )?;
        setup.every(10 * STEP, |managed: &mut Self, ctx: &mut Context<'_>| {
            managed.log.note(format!("ticks at {}", ctx.now().as_nanos() / 1_000_000));
        })
    }

    fn configure(&mut self, _: &mut Context<'_>) -> Result<(), TransitionError> {
        self.make(Transition::Configure)
    }

    fn activate(&mut self, _: &mut Context<'_>) -> Result<(), TransitionError> {
        self.make(Transition::Activate)
    }

    fn deactivate(&mut self, _: &mut Context<'_>) -> Result<(), TransitionError> {
        self.make(Transition::Deactivate)
    }

    fn cleanup(&mut self, _: &mut Context<'_>) -> Result<(), TransitionError> {
        self.make(Transition::Cleanup)
    }

    fn shutdown(&mut self, _: &mut Context<'_>) {
        // A shutdown cannot fail.
        let _ = self.make(Transition::Shutdown);
    }
}

fn initially(initial_state: LifecycleState) -> ModuleOptions {
    ModuleOptions { initial_state, ..ModuleOptions::default() }
}

fn state(core: &Core) -> LifecycleState {
    core.modules()[0].state
}

/// Requests a transition of the module and runs the cycles until it is made.
fn transit(
    core: &mut Core,
    clock: &ManualClock,
    transition: Transition,
) -> Result<LifecycleState, TransitionRefused> {
    let receipt = core.handle().transition("managed", transition);
    cycles(core, clock, 2);
    receipt.try_take().expect("the receipt is answered in the next cycle")
}

#[test]
fn a_module_is_brought_to_its_initial_state() {
    for (initial, made) in [
        (Unconfigured, vec![]),
        (Inactive, vec!["configure"]),
        (Active, vec!["configure", "activate"]),
        (Finalized, vec!["shutdown"]),
    ] {
        let ((mut core, clock), log) = (manual_core(), Log::default());
        core.add_with("managed", Managed::new(&log), initially(initial)).unwrap();
        assert_eq!(state(&core), Unconfigured, "before the first cycle");
        cycles(&mut core, &clock, 1);
        assert_eq!((state(&core), log.take()), (initial, made.into_iter().map(String::from).collect()));
    }
}

#[test]
fn a_module_goes_through_all_its_states_and_back() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    core.add_with("managed", Managed::new(&log), initially(Unconfigured)).unwrap();
    for (transition, reached) in [
        (Transition::Configure, Inactive),
        (Transition::Cleanup, Unconfigured),
        (Transition::Configure, Inactive),
        (Transition::Activate, Active),
        (Transition::Deactivate, Inactive),
        (Transition::Shutdown, Finalized),
    ] {
        assert_eq!(transit(&mut core, &clock, transition), Ok(reached));
        assert_eq!((state(&core), log.take()), (reached, vec![transition.to_string()]));
    }
}

#[test]
fn a_transition_that_does_not_begin_in_the_state_of_the_module_is_refused() {
    use Transition::{Activate, Cleanup, Configure, Deactivate, Shutdown};
    for (state, refused) in [
        (Unconfigured, vec![Activate, Deactivate, Cleanup]),
        (Inactive, vec![Configure, Deactivate]),
        (Active, vec![Configure, Activate, Cleanup]),
        (Finalized, vec![Configure, Activate, Deactivate, Cleanup, Shutdown]),
    ] {
        let ((mut core, clock), log) = (manual_core(), Log::default());
        core.add_with("managed", Managed::new(&log), initially(state)).unwrap();
        cycles(&mut core, &clock, 1);
        log.take();
        for transition in refused {
            let message = transit(&mut core, &clock, transition).unwrap_err().to_string();
            let expected = format!("module \"managed\" is {state}: {transition} is not possible from there");
            assert_eq!((message, log.take()), (expected, vec![]));
        }
    }
}

#[test]
fn a_module_that_cannot_be_configured_stays_unconfigured_and_may_be_asked_again() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let failing = Managed { fails_in: Some(Transition::Configure), ..Managed::new(&log) };
    core.add("managed", failing).unwrap();
    cycles(&mut core, &clock, 1);
    assert_eq!(
        (state(&core), log.take()),
        (Unconfigured, vec!["configure".to_owned()]),
        "activate is left out"
    );
    let refused = transit(&mut core, &clock, Transition::Configure).unwrap_err();
    let message = "module \"managed\" stays unconfigured: configure failed: the port is taken";
    assert_eq!(refused.to_string(), message);
}

#[test]
fn a_module_that_refuses_a_transition_stays_where_it_was() {
    for (fails_in, stays) in [(Transition::Activate, Inactive), (Transition::Deactivate, Active)] {
        let ((mut core, clock), log) = (manual_core(), Log::default());
        core.add_with(
            "managed",
            Managed { fails_in: Some(fails_in), ..Managed::new(&log) },
            initially(stays),
        )
        .unwrap();
        cycles(&mut core, &clock, 1);
        assert!(matches!(transit(&mut core, &clock, fails_in), Err(TransitionRefused::ByModule { .. })));
        assert_eq!(state(&core), stays);
    }
}

#[test]
fn a_panic_in_a_transition_ends_the_module() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let panicking = Managed { panics_in: Some(Transition::Activate), ..Managed::new(&log) };
    core.add_with("managed", panicking, initially(Inactive)).unwrap();
    cycles(&mut core, &clock, 1);
    let refused = transit(&mut core, &clock, Transition::Activate).unwrap_err();
    assert_eq!(refused.to_string(), "module \"managed\" panicked in activate");
    assert_eq!(state(&core), Finalized);
}

#[test]
fn transitions_that_were_asked_for_together_are_made_in_that_order_until_one_fails() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let failing = Managed { fails_in: Some(Transition::Activate), ..Managed::new(&log) };
    core.add_with("managed", failing, initially(Unconfigured)).unwrap();
    let handle = core.handle();
    let receipts = [Transition::Configure, Transition::Activate, Transition::Deactivate]
        .map(|transition| handle.transition("managed", transition));
    cycles(&mut core, &clock, 2);
    let [configured, activated, deactivated] = receipts.map(|receipt| receipt.try_take());
    assert_eq!(configured, Some(Ok(Inactive)));
    assert!(matches!(activated, Some(Err(TransitionRefused::ByModule { .. }))));
    assert!(matches!(deactivated, Some(Err(_))), "the refusal is reported: {deactivated:?}");
    assert_eq!(log.take(), ["configure", "activate"]);
}

#[test]
fn timers_start_when_the_module_becomes_active_and_stop_when_it_is_not() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    core.add_with("managed", Managed::new(&log), initially(Inactive)).unwrap();
    cycles(&mut core, &clock, 25);
    assert_eq!(log.take(), ["configure"]);
    // Requested in the sync phase of cycle 25, made in cycle 26.
    drop(core.handle().transition("managed", Transition::Activate));
    cycles(&mut core, &clock, 25);
    assert_eq!(log.take(), ["activate", "ticks at 36", "ticks at 46"]);
    drop(core.handle().transition("managed", Transition::Deactivate));
    cycles(&mut core, &clock, 25);
    assert_eq!(log.take(), ["deactivate"]);
}

#[test]
fn messages_pass_an_inactive_module_by() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let numbers = core.inlet::<u32>("numbers").unwrap();
    core.add_with("managed", Managed::new(&log), initially(Inactive)).unwrap();
    numbers.publish(1).unwrap();
    cycles(&mut core, &clock, 3);
    drop(core.handle().transition("managed", Transition::Activate));
    cycles(&mut core, &clock, 2);
    numbers.publish(2).unwrap();
    cycles(&mut core, &clock, 2);
    assert_eq!(log.take(), ["configure", "activate", "hears 2"]);
}

#[test]
fn a_module_makes_others_make_transitions() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    core.add_with("managed", Managed::new(&log), initially(Unconfigured)).unwrap();
    let manager = module(|setup| {
        setup.every(STEP, |_, ctx| {
            let next =
                if ctx.now() == Time::ZERO + STEP { Transition::Configure } else { Transition::Activate };
            ctx.transition("managed", next);
        })
    });
    core.add("manager", manager).unwrap();
    cycles(&mut core, &clock, 4);
    assert_eq!((state(&core), log.take()), (Active, vec!["configure".into(), "activate".into()]));
}

#[test]
fn a_detached_module_makes_its_transitions_on_its_thread() {
    let (mut core, log) = (Core::new(), Log::default());
    let options = ModuleOptions { initial_state: Inactive, ..detached() };
    core.add_with("managed", Managed::new(&log), options).unwrap();
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run());
    let make = |transition| handle.transition("managed", transition).wait(WATCHDOG).unwrap();
    assert_eq!(make(Transition::Activate), Ok(Active));
    assert_eq!(make(Transition::Deactivate), Ok(Inactive));
    assert!(matches!(make(Transition::Deactivate), Err(TransitionRefused::WrongState { .. })));
    assert_eq!(handle.modules().wait(WATCHDOG).unwrap()[0].state, Inactive);
    handle.stop();
    running.join().unwrap().unwrap();
    assert_eq!(log.take(), ["configure", "activate", "deactivate", "shutdown"]);
}

#[test]
fn a_module_that_is_removed_while_unconfigured_still_gets_its_last_callback() {
    let ((mut core, clock), log) = (manual_core(), Log::default());
    core.add_with("managed", Managed::new(&log), initially(Unconfigured)).unwrap();
    cycles(&mut core, &clock, 1);
    drop(core.handle().remove("managed"));
    cycles(&mut core, &clock, 1);
    assert_eq!(log.take(), ["shutdown"]);
}

#[test]
fn who_listens_is_told_each_step_in_its_order_whatever_becomes_of_the_module() {
    use std::sync::{Arc, Mutex};
    let ((mut core, clock), log) = (manual_core(), Log::default());
    let failing = Managed { fails_in: Some(Transition::Activate), ..Managed::new(&log) };
    core.add_with("failing", failing, initially(Active)).unwrap();
    let panicking = Managed { panics_in: Some(Transition::Configure), ..Managed::new(&log) };
    core.add_with("panicking", panicking, initially(Inactive)).unwrap();
    let told = Arc::<Mutex<Vec<LifeEvent>>>::default();
    let events = Arc::clone(&told);
    let listening = core.handle().on_transition(move |event| events.lock().unwrap().push(event.clone()));
    let _other = core.handle().on_transition(|_| panic!("a listener that panics, as this test wants it"));
    cycles(&mut core, &clock, 2);
    let steps = |module: &str| {
        let told = told.lock().unwrap();
        told.iter().filter(|event| *event.module == *module).map(|event| event.step).collect::<Vec<_>>()
    };
    let (configure, activate) = (Transition::Configure, Transition::Activate);
    assert_eq!(
        steps("failing"),
        [
            LifeStep::Begins { transition: configure, from: Unconfigured },
            LifeStep::Made { transition: configure, to: Inactive },
            LifeStep::Begins { transition: activate, from: Inactive },
            LifeStep::Failed { transition: activate, state: Inactive },
        ]
    );
    assert_eq!(
        steps("panicking"),
        [
            LifeStep::Begins { transition: configure, from: Unconfigured },
            LifeStep::Panicked { transition: Some(configure), from: Unconfigured },
        ]
    );
    core.handle().remove("failing");
    cycles(&mut core, &clock, 1);
    let ended = LifeStep::Made { transition: Transition::Shutdown, to: Finalized };
    assert_eq!(steps("failing").last(), Some(&ended));
    drop(listening);
    core.add_with("failing", Managed::new(&log), initially(Inactive)).unwrap();
    cycles(&mut core, &clock, 1);
    assert_eq!(steps("failing").last(), Some(&ended), "no event follows");
}
