//! A core that is idle or running.

use downbeat_executor::queue::Queue;
use downbeat_executor::{
    AnyMessage, AnyReceived, Core, CoreHandle, Inlet, MessageType, Outlet, OutletInbox, Receipt, Received,
    SetupError,
};
use std::time::Duration;

/// How long a running core may take to come to the end of a cycle.
const PATIENCE: Duration = Duration::from_secs(5);

/// A core that may be running, for opening inlets and outlets.
pub enum CoreAccess<'a> {
    /// It does not run: changes take effect at once.
    Idle(&'a mut Core),
    /// It runs on another thread: each change waits for its next sync phase.
    Running(&'a CoreHandle),
}

impl CoreAccess<'_> {
    /// Takes the messages of a topic out of the core.
    ///
    /// # Errors
    /// Those of [`Core::outlet`], and one if the core does not answer.
    pub fn outlet<T: Send + Sync + 'static>(
        &mut self,
        topic: &str,
        inbox: &OutletInbox,
        sink: impl FnMut(Received<'_, T>) + Send + 'static,
    ) -> Result<Outlet, SetupError> {
        match self {
            Self::Idle(core) => core.outlet(topic, inbox, sink),
            Self::Running(core) => answer("outlet", &core.outlet(topic, inbox, sink)),
        }
    }

    /// Opens an inlet, which publishes on a topic from any thread.
    ///
    /// # Errors
    /// Those of [`Core::inlet_with`], and one if the core does not answer.
    pub fn inlet<T: Send + Sync + 'static>(
        &mut self,
        topic: &str,
        queue: impl Queue<T> + 'static,
    ) -> Result<Inlet<T>, SetupError> {
        match self {
            Self::Idle(core) => core.inlet_with(topic, queue),
            Self::Running(core) => answer("inlet", &core.inlet_with(topic, queue)),
        }
    }

    /// As [`outlet`](Self::outlet), for messages of a type that is a value.
    pub(crate) fn outlet_of(
        &mut self,
        message_type: MessageType,
        topic: &str,
        inbox: &OutletInbox,
        sink: impl FnMut(AnyReceived<'_>) + Send + 'static,
    ) -> Result<Outlet, SetupError> {
        match self {
            Self::Idle(core) => core.outlet_of(message_type, topic, inbox, sink),
            Self::Running(core) => answer("outlet", &core.outlet_of(message_type, topic, inbox, sink)),
        }
    }

    /// As [`inlet`](Self::inlet), for messages of a type that is a value.
    pub(crate) fn inlet_of(
        &mut self,
        message_type: MessageType,
        topic: &str,
        queue: impl Queue<AnyMessage> + 'static,
    ) -> Result<Inlet<AnyMessage>, SetupError> {
        match self {
            Self::Idle(core) => core.inlet_of(message_type, topic, queue),
            Self::Running(core) => answer("inlet", &core.inlet_of(message_type, topic, queue)),
        }
    }
}

fn answer<T: 'static>(module: &str, receipt: &Receipt<Result<T, SetupError>>) -> Result<T, SetupError> {
    receipt.wait(PATIENCE).unwrap_or_else(|| {
        let reason =
            "the core does not answer: it has stopped or is held, or a module does not return".into();
        Err(SetupError::Refused { module: module.to_owned(), reason })
    })
}
