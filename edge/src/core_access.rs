//! A core that is idle or running.

use downbeat_executor::queue::Queue;
use downbeat_executor::{
    AnyMessage, AnyReceived, AnyValue, Caller, Core, CoreHandle, Inlet, MessageType, Module, ModuleOptions,
    Outlet, OutletGate, OutletInbox, Receipt, Received, ServiceType, SettingInfo, SetupError,
};
use std::any::Any;
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
    /// Adds a module.
    ///
    /// # Errors
    /// Those of [`Core::add_with`], and one if the core does not answer.
    pub fn add<M: Module>(
        &mut self,
        name: &str,
        module: M,
        options: ModuleOptions,
    ) -> Result<(), SetupError> {
        match self {
            Self::Idle(core) => core.add_with(name, module, options),
            Self::Running(core) => answer(name, &core.add(name, module, options)),
        }
    }

    /// The settings of a module with their values; `None` if there is no such module, or the core does not
    /// answer.
    #[must_use]
    pub fn settings(&self, module: &str) -> Option<Vec<SettingInfo>> {
        match self {
            Self::Idle(core) => core.settings(module),
            Self::Running(core) => core.settings(module).wait(PATIENCE)?,
        }
    }

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
        gate: Option<OutletGate>,
        sink: impl FnMut(AnyReceived<'_>) + Send + 'static,
    ) -> Result<Outlet, SetupError> {
        match (self, gate) {
            (Self::Idle(core), None) => core.outlet_of(message_type, topic, inbox, sink),
            (Self::Idle(core), Some(gate)) => core.gated_outlet_of(message_type, topic, inbox, gate, sink),
            (Self::Running(core), None) => {
                answer("outlet", &core.outlet_of(message_type, topic, inbox, sink))
            }
            (Self::Running(core), Some(gate)) => {
                answer("outlet", &core.gated_outlet_of(message_type, topic, inbox, gate, sink))
            }
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

    /// Opens a caller of a service, see [`Core::caller_of`].
    pub(crate) fn caller_of<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        of: ServiceType<Q, R>,
        service: &str,
    ) -> Result<Caller<Q, R>, SetupError> {
        match self {
            Self::Idle(core) => core.caller_of(of, service),
            Self::Running(core) => answer("caller", &core.caller_of(of, service)),
        }
    }

    /// Encodes the requests and answers of a service in events, see [`Core::encode_service_of`].
    pub(crate) fn encode_service_of(
        &mut self,
        of: ServiceType<AnyValue, AnyValue>,
        service: &str,
        request: impl Fn(&dyn Any) -> Option<Vec<u8>> + Send + 'static,
        answer_of: impl Fn(&dyn Any) -> Option<Vec<u8>> + Send + 'static,
    ) -> Result<(), SetupError> {
        match self {
            Self::Idle(core) => core.encode_service_of(of, service, request, answer_of),
            Self::Running(core) => {
                answer("encoder", &core.encode_service_of(of, service, request, answer_of))
            }
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
