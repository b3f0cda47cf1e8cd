//! The input of a detached module is recorded with its times; the same input again gives the same output.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::num::NonZeroUsize;
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use common::*;
use downbeat_executor::*;

/// Hashes its input and the times of its runs into its state, and publishes the state.
struct Mixer {
    state: u64,
    out: Option<Publication<u64>>,
}

impl Mixer {
    fn mix(&mut self, value: u64, ctx: &mut Context<'_>) {
        let now = ctx.now().as_nanos() as u64;
        self.state = (self.state ^ value ^ now).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(17);
        ctx.publish(self.out.unwrap(), self.state);
    }
}

impl Module for Mixer {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        self.out = Some(setup.publish("states")?);
        setup.subscribe(
            "numbers",
            |mixer: &mut Self, number: Received<'_, u64>, ctx: &mut Context<'_>| {
                mixer.mix(*number, ctx);
                if number.is_multiple_of(5) {
                    // Occasionally slow, so that messages of several cycles wait or are dropped.
                    std::thread::sleep(2 * STEP);
                }
            },
        )?;
        setup.every(3 * STEP, |mixer: &mut Self, ctx: &mut Context<'_>| mixer.mix(1, ctx))
    }

    fn activate(&mut self, ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        self.mix(2, ctx);
        Ok(())
    }

    fn shutdown(&mut self, ctx: &mut Context<'_>) {
        self.mix(3, ctx);
    }
}

fn observer<T: Clone + Send + Sync + 'static>(core: &mut Core, topic: &'static str) -> Receiver<T> {
    let (sender, receiver) = channel();
    let observer = module(move |setup| {
        setup.subscribe(topic, move |_, message: Received<'_, T>, _| sender.send(message.clone()).unwrap())
    });
    let options = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
    core.add_with(&format!("observer of {topic}"), observer, options).unwrap();
    receiver
}

struct Recording {
    steps: Vec<DetachedStep>,
    numbers: Vec<u64>,
    states: Vec<u64>,
}

fn options(inbox: Inbox) -> ModuleOptions {
    ModuleOptions { synchrony: Synchrony::Detached(inbox), ..ModuleOptions::default() }
}

/// Runs a detached module among others under the system clock.
fn record(inbox: Inbox) -> Recording {
    let mut core = Core::new();
    let steps = observer::<DetachedStep>(&mut core, DetachedStep::TOPIC);
    let (numbers, states) = (observer(&mut core, "numbers"), observer(&mut core, "states"));
    core.add_with("mixer", Mixer { state: 0, out: None }, options(inbox)).unwrap();
    let (handle, mut count) = (core.handle(), 0_u64);
    let source = module(move |setup| {
        let out = setup.publish("numbers")?;
        setup.every(STEP, move |_, ctx| {
            ctx.publish_all(out, count..count + 1 + count % 3);
            count += 1 + count % 3;
            if count > 200 {
                handle.stop();
            }
        })
    });
    core.add("source", source).unwrap();
    core.run().unwrap();
    let (steps, numbers) = (steps.try_iter().collect(), numbers.try_iter().collect());
    Recording { steps, numbers, states: states.try_iter().collect() }
}

/// Runs the same module alone, under a clock that is set to the times of its steps.
fn replay(recording: &Recording, inbox: Inbox) -> Vec<u64> {
    let clock = ManualClock::new(recording.steps[0].time);
    let mut core = Core::new().with_clock(clock.clone());
    let numbers = core.inlet::<u64>("numbers").unwrap();
    let states = observer(&mut core, "states");
    core.add_with("mixer", Mixer { state: 0, out: None }, options(inbox)).unwrap();
    let mut recorded = recording.numbers.iter();
    for step in &recording.steps {
        for input in &step.inputs {
            assert_eq!(&*input.topic, "numbers");
            recorded.by_ref().take(input.skipped as usize).for_each(drop);
            recorded
                .by_ref()
                .take(input.received as usize)
                .for_each(|&number| numbers.publish(number).unwrap());
            // The messages are published at the time of the previous step, at which nothing is due any more.
            core.cycle().unwrap();
        }
        clock.set(step.time);
        if !step.is_stop {
            core.cycle().unwrap();
        }
    }
    core.stop();
    states.try_iter().collect()
}

#[test]
fn the_recorded_steps_of_a_detached_module_give_the_same_output_again() {
    for inbox in [Inbox::KeepAll, Inbox::KeepLast(NonZeroUsize::MIN)] {
        let recording = record(inbox);
        assert!(recording.steps.len() > 10 && recording.steps.last().unwrap().is_stop);
        assert!(recording.states.len() > 50, "{} states", recording.states.len());
        assert_eq!(replay(&recording, inbox), recording.states, "{inbox:?}");
    }
}

#[test]
fn steps_tell_in_which_order_and_at_which_times_they_ran() {
    let steps = record(Inbox::KeepAll).steps;
    assert!(steps.iter().zip(0..).all(|(step, number)| step.step == number && &*step.module == "mixer"));
    assert!(steps.is_sorted_by_key(|step| (step.time, step.cycle)));
    assert!(steps.last().unwrap().time.saturating_since(steps[0].time) > Duration::ZERO);
}
