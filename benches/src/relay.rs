//! One message that two modules pass back and forth.

use std::hint::black_box;

use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time};

use crate::Reading;
use crate::contestants::Contestant;

/// Two modules that return each received message. In each cycle one of them runs, receives the message
/// published by the other in the previous cycle, and publishes it. A trial is one cycle, and measures one
/// hop.
pub struct Relay {
    core: Core,
}

impl Relay {
    /// Adds the modules to the core returned by `prepare`, and publishes the message.
    ///
    /// # Errors
    /// If the core cannot be prepared.
    pub fn new(prepare: impl FnOnce(Core) -> anyhow::Result<Core>) -> anyhow::Result<Self> {
        let mut core = prepare(Core::new().with_clock(ManualClock::new(Time::ZERO)))?;
        core.add("ping", Passer { hears: "to_ping", says: "to_pong" })?;
        core.add("pong", Passer { hears: "to_pong", says: "to_ping" })?;
        core.inlet("to_ping")?.publish(Reading::new(0))?;
        core.cycle()?;
        Ok(Self { core })
    }
}

impl Contestant for Relay {
    fn trial(&mut self) {
        // Fails only at the start, and the core has started. A lost message shows in the number of hops.
        let _ = self.core.cycle();
    }

    /// The number of hops.
    fn finish(self: Box<Self>) -> u64 {
        self.core.topics().map(|topic| topic.counter.messages()).sum::<u64>().saturating_sub(1)
    }
}

struct Passer {
    hears: &'static str,
    says: &'static str,
}

impl Module for Passer {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let out = setup.publish(self.says)?;
        setup
            .subscribe::<Reading, _>(self.hears, move |_, reading, ctx| ctx.publish(out, black_box(*reading)))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::launchers::LAUNCHERS;

    #[test]
    fn each_cycle_is_a_hop_under_every_launcher() {
        for launcher in LAUNCHERS {
            let mut relay = Box::new(Relay::new(launcher.launch).unwrap());
            (0..10).for_each(|_| relay.trial());
            assert_eq!(relay.finish(), 10, "{}", launcher.name);
        }
    }
}
