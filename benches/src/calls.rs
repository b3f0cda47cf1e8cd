//! One service call after another.

use std::hint::black_box;
use std::time::Duration;

use downbeat_executor::{Client, Core, ManualClock, Module, Setup, SetupError, Time};

use crate::Reading;
use crate::contestants::Contestant;

/// A module that calls a service of another module again and again: each answer triggers the next call. A
/// trial is two cycles: the server runs in one, the client in the other.
pub struct Calls {
    core: Core,
    trials: u64,
}

impl Calls {
    /// Adds the modules to a core and makes the first call.
    ///
    /// # Errors
    /// If the core cannot be prepared.
    pub fn new() -> anyhow::Result<Self> {
        let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
        core.add("server", Server)?;
        core.add("client", Caller { client: None, answers: 0 })?;
        core.inlet("begin")?.publish(())?;
        (0..2).try_for_each(|_| core.cycle())?;
        Ok(Self { core, trials: 0 })
    }
}

impl Contestant for Calls {
    fn trial(&mut self) {
        for _ in 0..2 {
            // Fails only at the start, and the core has started.
            let _ = self.core.cycle();
        }
        self.trials += 1;
    }

    /// The number of answers that the client received; 0 unless it is one per trial.
    fn finish(self: Box<Self>) -> u64 {
        let topics = self.core.topics().find(|topic| &*topic.name == "answers");
        topics.map(|topic| topic.counter.messages()).filter(|&answers| answers == self.trials).unwrap_or(0)
    }
}

struct Server;

impl Module for Server {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.serve::<Reading, u64, _>("sum", |_, reading, _| Ok(black_box(reading.time_ns + 1)))
    }
}

struct Caller {
    client: Option<Client<Reading, u64>>,
    answers: u64,
}

impl Module for Caller {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let answers = setup.publish::<u64>("answers")?;
        let timeout = Duration::from_secs(1);
        self.client =
            Some(setup.client::<Reading, u64, _>("sum", timeout, move |caller: &mut Self, _, ctx| {
                caller.answers += 1;
                ctx.publish(answers, caller.answers);
                if let Some(client) = caller.client {
                    ctx.call(client, Reading::new(caller.answers));
                }
            })?);
        setup.subscribe::<(), _>("begin", |caller, _, ctx| {
            if let Some(client) = caller.client {
                ctx.call(client, Reading::new(0));
            }
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn each_trial_is_one_call() {
        let mut calls = Box::new(Calls::new().unwrap());
        (0..5).for_each(|_| calls.trial());
        assert_eq!(calls.finish(), 5);
    }
}
