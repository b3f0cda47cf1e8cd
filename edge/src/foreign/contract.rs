//! What a module in another language implements, what comes to it, and what it can ask for.

use super::declarations::Declarations;
use crate::KnownType;
use bytes::Bytes;
use downbeat_executor::{
    AnyMessage, AnyPublication, Context, Failure, Setting, SettingValue, StopRequest, Task, Time, Transition,
};
use downbeat_msgs::cdr;
use std::any::Any;
use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;
use thiserror::Error;

/// A module in another language. All its functions are called by one thread at a time, but not always by the
/// same.
///
/// An error is a sentence, or a traceback. One of [`handle`](Self::handle) ends the module as a panic does,
/// with its report in the log and its sentence for clients that wait for an answer; the restart policy
/// decides whether it is made again.
pub trait Foreign: Send + 'static {
    /// Declares what the module publishes, receives, does periodically and can be set to.
    ///
    /// # Errors
    /// Why the module cannot join.
    fn setup(&mut self, declarations: &mut Declarations) -> Result<(), String>;

    /// Takes an event.
    ///
    /// # Errors
    /// Ends the module.
    fn handle(&mut self, event: Event, context: &mut ForeignContext<'_, '_>) -> Result<(), Failure>;

    /// Makes a transition of its lifecycle.
    ///
    /// # Errors
    /// Why it cannot; the module stays in its state.
    fn transition(
        &mut self,
        _transition: Transition,
        _context: &mut ForeignContext<'_, '_>,
    ) -> Result<(), String> {
        Ok(())
    }

    /// Checks a value that a setting is about to have while the module runs.
    ///
    /// # Errors
    /// Why the module refuses it; nothing changes.
    fn accept(&mut self, _setting: u32, _value: &SettingValue) -> Result<(), String> {
        Ok(())
    }

    /// Returns a newer version of the module, once, if its source has changed. Called while the module runs,
    /// if it declared [`Declarations::reload`]. The core sets the new version up and hands it what
    /// [`save`](Self::save) returns; until all of that has succeeded, the module goes on as it is.
    ///
    /// # Errors
    /// Why the new version cannot be used; logged.
    fn successor(&mut self) -> Result<Option<Box<dyn Foreign>>, String> {
        Ok(None)
    }

    /// Returns the state for a successor.
    ///
    /// # Errors
    /// Why there is none; the module goes on.
    fn save(&mut self) -> Result<SavedState, String> {
        Ok(Box::new(()))
    }

    /// Takes over the state of the version before, after its setup.
    ///
    /// # Errors
    /// Why it cannot; the version before goes on.
    fn restore(&mut self, _state: SavedState) -> Result<(), String> {
        Ok(())
    }

    /// What a debugger shows of the module, as [`Module::debug`](downbeat_executor::Module::debug).
    fn debug(&self) -> Option<&dyn fmt::Debug> {
        None
    }
}

/// What a version of a module hands to the next.
pub type SavedState = Box<dyn Any + Send>;

/// Makes a module in another language, at the start and after each panic.
pub type MakeForeign = dyn Fn() -> Result<Box<dyn Foreign>, String> + Send + Sync;

/// What comes to a module. Numbers are those of [`Declarations`].
#[derive(Debug)]
pub enum Event {
    /// A message of a topic.
    Message {
        /// The subscription.
        subscription: u32,
        /// Encapsulation header (little-endian) and body.
        cdr: Bytes,
        /// The time of the cycle that published it.
        time: Time,
        /// How many messages before it the bounded inbox dropped.
        missed: u32,
        /// True if the topic carried no message after it in that cycle.
        is_last: bool,
    },
    /// A request, to be answered once with [`ForeignContext::reply`], now or later.
    Request {
        /// The server.
        server: u32,
        /// Identifies the request.
        request: u64,
        /// The serialized request.
        cdr: Bytes,
    },
    /// The end of a call.
    Reply {
        /// The client.
        client: u32,
        /// The call, as [`ForeignContext::call`] returned it.
        call: u64,
        /// The serialized response, or why there is none.
        result: Result<Bytes, String>,
    },
    /// A setting has another value.
    Setting {
        /// The setting.
        setting: u32,
    },
    /// A timer is due.
    Timer {
        /// The timer.
        timer: u32,
    },
    /// A scheduled task is due.
    Task {
        /// The task.
        task: u32,
    },
    /// The end of a run.
    EachRun,
}

/// Why a request of a module in another language was refused.
#[derive(Debug, Error)]
pub enum ForeignError {
    /// A number that no declaration returned.
    #[error("there is no {what} {number}; setup declared {count}")]
    Unknown {
        /// What the number should name.
        what: &'static str,
        /// The number.
        number: u32,
        /// How many there are.
        count: usize,
    },
    /// The bytes are no value of the type.
    #[error("the bytes for \"{name}\" are no {type_name}: {error}")]
    Decode {
        /// The topic or service.
        name: String,
        /// The type that is expected.
        type_name: String,
        /// What is wrong with the bytes.
        error: cdr::Error,
    },
    /// The request was answered before, or never existed.
    #[error("request {0} is not open: it was answered before")]
    Answered(u64),
}

impl From<ForeignError> for Failure {
    fn from(error: ForeignError) -> Self {
        error.to_string().into()
    }
}

/// What a module in another language can ask for in an event. It takes effect in the sync phase.
pub struct ForeignContext<'a, 'b> {
    pub(super) context: &'a mut Context<'b>,
    pub(super) ports: &'a mut Ports,
}

/// The ports of a module, by their numbers.
#[derive(Default)]
pub(super) struct Ports {
    pub(super) publishers: Vec<Publisher>,
    pub(super) clients: Vec<CallEncoded>,
    pub(super) settings: Vec<Setting<SettingValue>>,
    pub(super) tasks: Vec<Task>,
    /// Looks for a successor at the time of the recorded reload: a replay that begins in the middle of a run
    /// has other phases of timers.
    pub(super) reload: Option<Task>,
    pub(super) is_reload_due: bool,
    /// Requests without an answer so far.
    pub(super) open: BTreeMap<u64, ReplyEncoded>,
    pub(super) requests: u64,
}

pub(super) struct Publisher {
    pub(super) key: AnyPublication,
    pub(super) topic: String,
    pub(super) message: KnownType,
}

/// Calls a service with a serialized request. Returns the number of the call.
pub(super) type CallEncoded = Box<dyn Fn(&mut Context<'_>, &[u8]) -> Result<u64, ForeignError> + Send>;
/// Answers one request.
pub(super) type ReplyEncoded =
    Box<dyn FnOnce(&mut Context<'_>, Result<&[u8], String>) -> Result<(), ForeignError> + Send>;

impl ForeignContext<'_, '_> {
    /// The time of the cycle.
    #[must_use]
    pub fn now(&self) -> Time {
        self.context.now()
    }

    /// The name under which the module was added.
    #[must_use]
    pub fn module_name(&self) -> &str {
        self.context.module_name()
    }

    /// Whether the core is asked to stop.
    #[must_use]
    pub fn stop_request(&self) -> StopRequest {
        self.context.stop_request()
    }

    /// Publishes a message: encapsulation header (of either byte order) and body.
    ///
    /// # Errors
    /// If there is no such publisher, or the bytes are no message of its type.
    pub fn publish(&mut self, publisher: u32, cdr: &[u8]) -> Result<(), ForeignError> {
        self.publish_decoded(publisher, |of| of.decode(cdr))
    }

    /// As [`publish`](Self::publish), for bytes that can be shared: a raw message keeps them instead of a
    /// copy.
    ///
    /// # Errors
    /// As for [`publish`](Self::publish).
    pub fn publish_shared(&mut self, publisher: u32, cdr: &Bytes) -> Result<(), ForeignError> {
        self.publish_decoded(publisher, |of| of.decode_shared(cdr))
    }

    fn publish_decoded(
        &mut self,
        publisher: u32,
        decode: impl FnOnce(KnownType) -> cdr::Result<AnyMessage>,
    ) -> Result<(), ForeignError> {
        let found = find(&self.ports.publishers, publisher, "publisher")?;
        let message = decode(found.message).map_err(|error| ForeignError::Decode {
            name: found.topic.clone(),
            type_name: found.message.name().to_owned(),
            error,
        })?;
        self.context.publish_any(found.key, message);
        Ok(())
    }

    /// Calls a service. Returns the number of the call, which its [`Event::Reply`] has.
    ///
    /// # Errors
    /// If there is no such client, or the bytes are no request of its type.
    pub fn call(&mut self, client: u32, cdr: &[u8]) -> Result<u64, ForeignError> {
        find(&self.ports.clients, client, "client")?(self.context, cdr)
    }

    /// Answers a request with a serialized response or with an error in words.
    ///
    /// # Errors
    /// If the request is not open, or the bytes are no response of its type; the request stays open then no
    /// longer.
    pub fn reply(&mut self, request: u64, result: Result<&[u8], String>) -> Result<(), ForeignError> {
        let reply = self.ports.open.remove(&request).ok_or(ForeignError::Answered(request))?;
        reply(self.context, result)
    }

    /// The value of a setting in this cycle.
    ///
    /// # Errors
    /// If there is no such setting.
    pub fn setting(&self, setting: u32) -> Result<&SettingValue, ForeignError> {
        let setting = find(&self.ports.settings, setting, "setting")?;
        Ok(self.context.get(*setting))
    }

    /// Sets a setting of a module, this one or another. What is refused is logged.
    pub fn set(&mut self, module: &str, setting: &str, value: SettingValue) {
        self.context.set(module, setting, value);
    }

    /// Schedules a task once, `delay` after the time of the cycle.
    ///
    /// # Errors
    /// If there is no such task.
    pub fn schedule_after(&mut self, task: u32, delay: Duration) -> Result<(), ForeignError> {
        let task = *find(&self.ports.tasks, task, "task")?;
        self.context.schedule_after(task, delay);
        Ok(())
    }

    /// Forgets what a task was scheduled for.
    ///
    /// # Errors
    /// If there is no such task.
    pub fn cancel(&mut self, task: u32) -> Result<(), ForeignError> {
        let task = *find(&self.ports.tasks, task, "task")?;
        self.context.cancel(task);
        Ok(())
    }

    /// Requests a transition of a module, this one or another, in the next cycle.
    pub fn transition(&mut self, module: &str, transition: Transition) {
        self.context.transition(module, transition);
    }

    /// Removes a module, this one or another.
    pub fn remove(&mut self, module: &str) {
        self.context.remove(module);
    }
}

fn find<'a, T>(all: &'a [T], number: u32, what: &'static str) -> Result<&'a T, ForeignError> {
    all.get(number as usize).ok_or(ForeignError::Unknown { what, number, count: all.len() })
}
