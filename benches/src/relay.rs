//! One message on its way between two modules.

use std::hint::black_box;

use anyhow::Context as _;
use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time};

use crate::Reading;
use crate::launchers::LauncherUnderTest;

/// Two modules that send each other what they receive: in each cycle one of them runs, receives what the other
/// published in the cycle before, and publishes it. A cycle is a hop and nothing else.
pub struct Relay {
    core: Core,
}

impl Relay {
    /// Makes the core and its modules and sends the message on its way.
    ///
    /// # Errors
    /// If the launcher gets no threads.
    pub fn new(launcher: &LauncherUnderTest) -> anyhow::Result<Self> {
        let core = Core::new().with_clock(ManualClock::new(Time::ZERO));
        let mut core = (launcher.launch)(core)
            .with_context(|| format!("cannot make a core with the launcher {}", launcher.name))?;
        core.add("ping", Passer { hears: "to_ping", says: "to_pong" })?;
        core.add("pong", Passer { hears: "to_pong", says: "to_ping" })?;
        core.inlet("to_ping")?.publish(Reading::new(0))?;
        core.cycle()?;
        Ok(Self { core })
    }

    /// Has the message pass from one module to the other.
    pub fn hop(&mut self) {
        // Fails only while it starts, and it has started. A message that is lost shows in `hops`.
        let _ = self.core.cycle();
    }

    /// How often the message was passed on.
    #[must_use]
    pub fn hops(&self) -> u64 {
        self.core.topics().map(|topic| topic.counter.messages()).sum::<u64>() - 1
    }
}

struct Passer {
    hears: &'static str,
    says: &'static str,
}

impl Module for Passer {
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
            let mut relay = Relay::new(launcher).unwrap();
            (0..10).for_each(|_| relay.hop());
            assert_eq!(relay.hops(), 10, "{}", launcher.name);
        }
    }
}
