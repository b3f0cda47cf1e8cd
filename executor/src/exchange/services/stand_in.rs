//! Stand-ins: answers for a server that is not in the core.

use std::marker::PhantomData;
use std::sync::Arc;

use super::Services;
use super::call::{CallError, CallId, Reply, ReplyTo};
use crate::CoreHandle;
use crate::module::SERVICES;

/// Answers calls of modules in place of the server, from any thread; from
/// [`Core::stand_in`](crate::Core::stand_in). A replay uses it for recorded answers.
///
/// ```
/// use std::time::Duration;
/// use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time};
///
/// struct Asker(std::sync::mpsc::Sender<u32>);
///
/// impl Module for Asker {
///     type Ports = ();
///
///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
///         let ask = setup.client::<(), u32, _>("count", Duration::from_secs(1), |asker: &mut Self, reply, _| {
///             drop(reply.result.map(|count| asker.0.send(count)));
///         })?;
///         setup.subscribe::<(), _>("go", move |_, _, ctx| drop(ctx.call(ask, ())))
///     }
/// }
///
/// let (sender, counts) = std::sync::mpsc::channel();
/// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
/// core.add("asker", Asker(sender))?;
/// let count = core.stand_in::<(), u32>("count")?;
/// core.inlet("go")?.publish(())?;
/// core.cycle()?;
/// count.answer("asker", 0, 0, Ok(7)); // The call is made in the next cycle, and answered at its end.
/// core.cycle()?;
/// core.cycle()?;
/// assert_eq!(counts.try_recv()?, 7);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct StandIn<R> {
    core: CoreHandle,
    answer: PhantomData<fn(R)>,
}

impl<R: Send + 'static> StandIn<R> {
    pub(crate) fn new(core: CoreHandle) -> Self {
        Self { core, answer: PhantomData }
    }

    /// Answers a call in the next sync phase. The call is identified by the calling module `client`, the
    /// index of the client in the order of declaration by that module, and the number of the call. The answer
    /// is dropped if that call is not waiting for one.
    pub fn answer(&self, client: &str, port: u32, number: u64, result: Result<R, CallError>) {
        let client: Arc<str> = client.into();
        self.core.look(move |phase| {
            let Some(member) = phase.state.members.find(&client) else { return };
            let to = ReplyTo::Module { module: member.id, port, call: number };
            let (name, reply) = (Arc::clone(&member.name), Reply { call: CallId(number), result });
            if let Some(services) = phase.mechanisms.get_mut::<Services>(SERVICES) {
                services.answers.push((to, name, Box::new(Some(reply))));
                phase.ask(SERVICES);
            }
        });
    }
}
