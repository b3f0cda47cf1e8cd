//! Says where a demonstration begins and ends, so that a recording of many becomes a data set to learn from.
//!
//! | topic, service | type | |
//! | --- | --- | --- |
//! | `episodes` | `downbeat_interfaces/Episode` | an episode was started, kept or discarded; expose it latched |
//! | `episodes/start` (service) | `std_srvs/Trigger` | begins an episode, and discards the current one, if there is one |
//! | `episodes/keep` (service) | `std_srvs/Trigger` | ends it: it is to be learned from |
//! | `episodes/discard` (service) | `std_srvs/Trigger` | ends it: it is not |
//!
//! | setting | default | |
//! | --- | --- | --- |
//! | `task` | | what is shown, in words; may be changed between episodes |
//!
//! `downbeat bag export --format lerobot` makes a data set of the kept ones. The panel *Episodes* has
//! buttons, and keys: space begins, the right arrow keeps, the left one discards.

use downbeat_executor::{Context, Module, Publication, Setting, Setup, SetupError};
use downbeat_msgs::downbeat_interfaces::msg::Episode;
use downbeat_msgs::std_srvs::srv::{TriggerRequest, TriggerResponse};

use crate::stamps::header;

/// Says where episodes begin and end; see the [module page](self).
#[derive(Debug, Default)]
pub struct Episodes {
    kept: u32,
    /// The task of the episode that is under way.
    current: Option<String>,
}

/// The keys of [`Episodes`].
pub struct Ports {
    episodes: Publication<Episode>,
    task: Setting<String>,
}

impl Episodes {
    fn start(&mut self, ctx: &mut Context<'_, Ports>) -> TriggerResponse {
        let discarded = self.end(Episode::DISCARDED, ctx);
        let task = ctx.get(ctx.ports.task).clone();
        self.say(Episode::STARTED, task.clone(), ctx);
        self.current = Some(task);
        let before = if discarded.is_some() { "; the one before it is discarded" } else { "" };
        done(true, format!("episode {} begins{before}", self.kept))
    }

    fn keep(&mut self, ctx: &mut Context<'_, Ports>) -> TriggerResponse {
        match self.end(Episode::KEPT, ctx) {
            Some(number) => done(true, format!("episode {number} is kept")),
            None => done(false, "no episode is under way; call episodes/start".to_owned()),
        }
    }

    fn discard(&mut self, ctx: &mut Context<'_, Ports>) -> TriggerResponse {
        match self.end(Episode::DISCARDED, ctx) {
            Some(number) => done(true, format!("episode {number} is discarded")),
            None => done(false, "no episode is under way".to_owned()),
        }
    }

    /// Ends the episode that is under way, and returns its number.
    fn end(&mut self, state: u8, ctx: &mut Context<'_, Ports>) -> Option<u32> {
        let task = self.current.take()?;
        self.say(state, task, ctx);
        let number = self.kept;
        self.kept += u32::from(state == Episode::KEPT);
        Some(number)
    }

    fn say(&self, state: u8, task: String, ctx: &mut Context<'_, Ports>) {
        let stamp = header(ctx.now(), "").stamp;
        ctx.publish(ctx.ports.episodes, Episode { stamp, number: self.kept, state, task });
    }
}

fn done(success: bool, message: String) -> TriggerResponse {
    TriggerResponse { success, message }
}

impl Module for Episodes {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        setup.serve("episodes/start", |module: &mut Self, _: &TriggerRequest, ctx| Ok(module.start(ctx)))?;
        setup.serve("episodes/keep", |module: &mut Self, _: &TriggerRequest, ctx| Ok(module.keep(ctx)))?;
        setup.serve("episodes/discard", |module: &mut Self, _: &TriggerRequest, ctx| {
            Ok(module.discard(ctx))
        })?;
        Ok(Ports {
            episodes: setup.publish("episodes")?,
            task: setup.setting("task", String::new(), "what is shown, in words")?,
        })
    }

    fn debug(&self) -> Option<&dyn std::fmt::Debug> {
        Some(self)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::testing::{Collector, core_at_zero};
    use std::sync::mpsc::channel;
    use std::time::Duration;

    #[test]
    fn episodes_are_started_kept_and_discarded() {
        let (mut core, _) = core_at_zero();
        core.add("episodes", Episodes::default()).unwrap();
        let said = Collector::<Episode>::add(&mut core, "episodes");
        let mut call = |what: &str| {
            let caller = core.caller::<TriggerRequest, TriggerResponse>(&format!("episodes/{what}")).unwrap();
            let (sender, answer) = channel();
            let answered = move |result: Result<TriggerResponse, _>| drop(sender.send(result.unwrap()));
            caller.call(TriggerRequest::default(), Duration::MAX, answered).unwrap();
            (0..4).for_each(|_| core.cycle().unwrap());
            let TriggerResponse { success, message } = answer.try_recv().unwrap();
            (success, message, said.take().iter().map(|said| (said.number, said.state)).collect::<Vec<_>>())
        };
        assert_eq!(call("keep"), (false, "no episode is under way; call episodes/start".to_owned(), vec![]));
        assert_eq!(call("start").2, [(0, Episode::STARTED)]);
        assert_eq!(call("keep"), (true, "episode 0 is kept".to_owned(), vec![(0, Episode::KEPT)]));
        assert_eq!(call("start").2, [(1, Episode::STARTED)]);
        let (success, message, said) = call("start");
        assert!(success && message.contains("before it is discarded"), "{message}");
        assert_eq!(said, [(1, Episode::DISCARDED), (1, Episode::STARTED)]);
        assert_eq!(call("discard").2, [(1, Episode::DISCARDED)]);
    }
}
