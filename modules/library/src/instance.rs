//! A module of a loaded library.

#![expect(unsafe_code, reason = "calls of a library")]

use crate::call::{Declare, LogLine, Phase, Requests, log_line, number_of, with_host};
use crate::library::Library;
use crate::variables::Variables;
use downbeat_edge::foreign::Event;
use downbeat_executor::{SettingValue, Time, Transition};
use downbeat_library_abi::{ABI_VERSION, EventV1, Host, LentValue, ModuleV1, c_string, event};
use std::ffi::{CStr, CString, c_void};

/// A module of a library, which is destroyed when dropped.
pub(crate) struct Instance {
    table: ModuleV1,
    module: *mut c_void,
    name: CString,
    log: Log,
    /// The time of the last event or transition.
    now: Time,
}

/// Takes the lines that a library logs.
pub(crate) type Log = Box<dyn Fn(&LogLine<'_>) + Send>;

// SAFETY: downbeat.h demands that modules may be called by different threads, one at a time.
unsafe impl Send for Instance {}

impl Instance {
    /// Creates a module that logs under its name.
    pub(crate) fn new(library: Library, name: &str) -> Result<Self, String> {
        let of_log = name.to_owned();
        Self::with_log(library, name, Box::new(move |line| log_line(&of_log, line)))
    }

    pub(crate) fn with_log(library: Library, name: &str, log: Log) -> Result<Self, String> {
        let (table, name) = (library.table, c_string(name));
        let create = |host: Host| match table.create {
            // SAFETY: the host lives during the call.
            Some(create) => unsafe { create(host) },
            None => std::ptr::null_mut(),
        };
        let (module, failure) = with_host(&name, Phase::Apart, &*log, create);
        if module.is_null() {
            return Err(failure.unwrap_or_else(|| "`create` returned NULL without a reason".to_owned()));
        }
        Ok(Self { table, module, name, log, now: Time::ZERO })
    }

    /// Calls a function of the module; the result is its code, 0 for one that the library lacks.
    fn enter<'a>(
        &'a self,
        function: &str,
        phase: Phase<'a>,
        call: impl FnOnce(&ModuleV1, *mut c_void, Host) -> Option<i32>,
    ) -> Result<(), String> {
        let (table, module) = (&self.table, self.module);
        let (code, failure) = with_host(&self.name, phase, &*self.log, |host| call(table, module, host));
        match (code.unwrap_or(0), failure) {
            // What a library goes on after is no failure.
            (0, _) => Ok(()),
            (_, Some(reason)) => Err(reason),
            (code, None) => Err(format!("`{function}` returned {code} without a reason; call `fail` before")),
        }
    }

    pub(crate) fn setup(&mut self, declare: &mut dyn Declare) -> Result<(), String> {
        self.enter("setup", Phase::Setup(declare), |table, module, host| {
            // SAFETY: `create` returned the module, and the host lives during the call.
            table.setup.map(|setup| unsafe { setup(module, host) })
        })
    }

    pub(crate) fn handle(&mut self, event: &EventV1, requests: &mut dyn Requests) -> Result<(), String> {
        self.now = requests.now();
        self.enter("handle", Phase::Run(requests), |table, module, host| {
            // SAFETY: `create` returned the module, and the host and the event live during the call.
            table.handle.map(|handle| unsafe { handle(module, host, event) })
        })
    }

    pub(crate) fn transition(
        &mut self,
        transition: Transition,
        requests: &mut dyn Requests,
    ) -> Result<(), String> {
        self.now = requests.now();
        self.enter("transition", Phase::Run(requests), |table, module, host| {
            // SAFETY: `create` returned the module, and the host lives during the call.
            table.transition.map(|make| unsafe { make(module, host, number_of(transition)) })
        })
    }

    pub(crate) fn accept(&mut self, setting: u32, value: SettingValue) -> Result<(), String> {
        let lent = LentValue::new(value);
        let value = lent.in_c();
        self.enter("accept", Phase::Apart, |table, module, host| {
            // SAFETY: `create` returned the module, and the host and the value live during the call.
            table.accept.map(|accept| unsafe { accept(module, host, setting, &raw const value) })
        })
    }

    pub(crate) fn save(&mut self) -> Result<Vec<u8>, String> {
        let mut saved = Vec::new();
        self.enter("save", Phase::Save(&mut saved), |table, module, host| {
            // SAFETY: `create` returned the module, and the host lives during the call.
            table.save.map(|save| unsafe { save(module, host) })
        })?;
        Ok(saved)
    }

    pub(crate) fn restore(&mut self, state: &[u8]) -> Result<(), String> {
        self.enter("restore", Phase::Apart, |table, module, host| {
            // SAFETY: `create` returned the module, and the host and the bytes live during the call.
            table.restore.map(|restore| unsafe { restore(module, host, state.as_ptr(), state.len()) })
        })
    }

    /// The variables of the module as a text for a debugger; `None` if it reports none.
    pub(crate) fn variables(&self) -> Option<String> {
        self.table.variables?;
        let mut taken = Variables::default();
        let phase = Phase::Variables { now: self.now, taken: &mut taken };
        let result = self.enter("variables", phase, |table, module, host| {
            // SAFETY: `create` returned the module, and the host lives during the call.
            table.variables.map(|variables| unsafe { variables(module, host) })
        });
        taken.text(&self.sort(), result.err())
    }

    /// The name that the library gives its sort of module.
    pub(crate) fn sort(&self) -> String {
        match self.table.name.is_null() {
            true => String::new(),
            // SAFETY: a static text by the contract of downbeat.h.
            false => unsafe { CStr::from_ptr(self.table.name) }.to_string_lossy().into_owned(),
        }
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        if let Some(destroy) = self.table.destroy {
            // SAFETY: `create` returned the module, and nothing uses it afterwards.
            unsafe { destroy(self.module) };
        }
    }
}

/// An event of no kind.
pub(crate) fn no_event() -> EventV1 {
    EventV1 {
        abi_version: ABI_VERSION,
        struct_size: size_of::<EventV1>() as u32,
        kind: 0,
        port: 0,
        id: 0,
        data: std::ptr::null(),
        size: 0,
        time_ns: 0,
        missed: 0,
        is_last: 0,
        is_error: 0,
    }
}

/// An event with data, which it points to.
pub(crate) fn with_data(event: EventV1, data: &[u8]) -> EventV1 {
    EventV1 { data: data.as_ptr(), size: data.len(), ..event }
}

/// An event in the form of C. It points into `event`.
pub(crate) fn event_in_c(event: &Event) -> EventV1 {
    let empty = no_event();
    let with = |kind, port, id, data: &[u8]| with_data(EventV1 { kind, port, id, ..empty }, data);
    match event {
        Event::Message { subscription, cdr, time, missed, is_last } => EventV1 {
            time_ns: time.as_nanos(),
            missed: *missed,
            is_last: u8::from(*is_last),
            ..with(event::MESSAGE, *subscription, 0, cdr)
        },
        Event::Request { server, request, cdr } => with(event::REQUEST, *server, *request, cdr),
        Event::Reply { client, call, result: Ok(cdr) } => with(event::REPLY, *client, *call, cdr),
        Event::Reply { client, call, result: Err(reason) } => {
            EventV1 { is_error: 1, ..with(event::REPLY, *client, *call, reason.as_bytes()) }
        }
        Event::Setting { setting } => EventV1 { kind: event::SETTING, port: *setting, ..empty },
        Event::Timer { timer } => EventV1 { kind: event::TIMER, port: *timer, ..empty },
        Event::Task { task } => EventV1 { kind: event::TASK, port: *task, ..empty },
        Event::EachRun => EventV1 { kind: event::EACH_RUN, ..empty },
    }
}
