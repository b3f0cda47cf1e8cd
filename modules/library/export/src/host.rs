//! The functions of the robot, as a library in Rust calls them.

use downbeat_executor::{SettingInfo, SettingValue, Time};
use downbeat_library_abi::{
    ABI_VERSION, Host, HostV1, LentValue, SettingV1, ValueV1, c_string, severity, value_of,
};
use std::cell::Cell;
use std::ffi::CStr;
use std::fmt::Write;
use std::mem::offset_of;
use std::time::Duration;
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Level, Metadata, Subscriber};

/// The robot, during one call. A function that it refuses has told it why.
pub(crate) struct Robot {
    host: Host,
}

/// What a refused function returns: the robot knows the reason better.
const REFUSED: &str = "the robot refused what the module asked for";

fn check(code: i32) -> Result<(), String> {
    if code == 0 { Ok(()) } else { Err(REFUSED.to_owned()) }
}

impl Robot {
    pub(crate) fn new(host: Host) -> Self {
        Self { host }
    }

    fn functions(&self) -> &HostV1 {
        // SAFETY: the host lives during the call of the library, as `self` does.
        unsafe { &*self.host }
    }

    /// Makes this the robot that the lines of the log go to.
    pub(crate) fn during<R>(&self, run: impl FnOnce() -> R) -> R {
        let before = CURRENT.replace(self.host);
        let result = run();
        CURRENT.set(before);
        result
    }

    pub(crate) fn name(&self) -> String {
        // SAFETY: the host lives during the call of the library, and so does the text that it returns.
        unsafe { CStr::from_ptr((self.functions().name)(self.host)) }.to_string_lossy().into_owned()
    }

    pub(crate) fn now(&self) -> Time {
        // SAFETY: the host lives during the call of the library.
        Time::from_nanos(unsafe { (self.functions().now)(self.host) })
    }

    /// Returns the code with which the library reports it.
    pub(crate) fn fail(&self, reason: &str) -> i32 {
        match reason {
            REFUSED => -1,
            // SAFETY: the host lives during the call of the library, and the text during this call.
            reason => unsafe { (self.functions().fail)(self.host, c_string(reason).as_ptr()) },
        }
    }

    /// Gives the robot the definition of a type that it may not know.
    pub(crate) fn define(&self, name: &str, text: &str) -> Result<(), String> {
        let needed = offset_of!(HostV1, define) + size_of::<usize>();
        if (self.functions().struct_size as usize) < needed {
            return Ok(());
        }
        let [name, text] = [name, text].map(c_string);
        let parts = [text.as_ptr(), std::ptr::null()];
        // SAFETY: the host lives during the call of the library; the texts live during this call, and so does
        // their list, which ends with null.
        check(unsafe { (self.functions().define)(self.host, name.as_ptr(), parts.as_ptr()) })
    }

    pub(crate) fn publisher(&self, topic: &str, of: &str, hash: &str) -> Result<(), String> {
        let [topic, of, hash] = [topic, of, hash].map(c_string);
        let declare = self.functions().publisher;
        // SAFETY: the host lives during the call of the library, the texts live during this call, and the
        // place may be null.
        check(unsafe { declare(self.host, topic.as_ptr(), of.as_ptr(), hash.as_ptr(), std::ptr::null_mut()) })
    }

    pub(crate) fn subscription(&self, topic: &str, of: &str, hash: &str) -> Result<(), String> {
        let [topic, of, hash] = [topic, of, hash].map(c_string);
        let declare = self.functions().subscription;
        // SAFETY: the host lives during the call of the library, the texts live during this call, and the
        // place may be null.
        check(unsafe { declare(self.host, topic.as_ptr(), of.as_ptr(), hash.as_ptr(), std::ptr::null_mut()) })
    }

    pub(crate) fn server(&self, service: &str, of: &str, hash: &str) -> Result<(), String> {
        let [service, of, hash] = [service, of, hash].map(c_string);
        let declare = self.functions().server;
        // SAFETY: the host lives during the call of the library, the texts live during this call, and the
        // place may be null.
        check(unsafe {
            declare(self.host, service.as_ptr(), of.as_ptr(), hash.as_ptr(), std::ptr::null_mut())
        })
    }

    pub(crate) fn client(
        &self,
        service: &str,
        of: &str,
        hash: &str,
        timeout: Duration,
    ) -> Result<(), String> {
        let [service, of, hash] = [service, of, hash].map(c_string);
        let timeout = i64::try_from(timeout.as_nanos()).unwrap_or(i64::MAX);
        let declare = self.functions().client;
        // SAFETY: the host lives during the call of the library, the texts live during this call, and the
        // place may be null.
        check(unsafe {
            declare(self.host, service.as_ptr(), of.as_ptr(), hash.as_ptr(), timeout, std::ptr::null_mut())
        })
    }

    pub(crate) fn task(&self) -> Result<u32, String> {
        let mut task = 0;
        // SAFETY: the host lives during the call of the library, and the place during this call.
        check(unsafe { (self.functions().task)(self.host, &raw mut task) })?;
        Ok(task)
    }

    pub(crate) fn each_run(&self) -> Result<(), String> {
        // SAFETY: the host lives during the call of the library.
        check(unsafe { (self.functions().each_run)(self.host) })
    }

    /// Declares a setting, and returns the value that it has in the robot.
    pub(crate) fn setting(&self, setting: &SettingInfo) -> Result<SettingValue, String> {
        let (name, description) = (c_string(&setting.name), c_string(&setting.description));
        let lent = LentValue::new(setting.value.clone());
        let initial = lent.in_c();
        let range = setting.range.as_ref();
        let declaration = SettingV1 {
            abi_version: ABI_VERSION,
            struct_size: size_of::<SettingV1>() as u32,
            name: name.as_ptr(),
            description: description.as_ptr(),
            initial: &raw const initial,
            minimum: range.map_or(0.0, |range| *range.start()),
            maximum: range.map_or(0.0, |range| *range.end()),
            has_range: range.is_some().into(),
            is_read_only: setting.is_read_only.into(),
        };
        let mut number = 0;
        // SAFETY: the host lives during the call of the library; the declaration, what it points to and the
        // place live during this call.
        check(unsafe { (self.functions().setting)(self.host, &raw const declaration, &raw mut number) })?;
        self.get(number)
    }

    pub(crate) fn get(&self, setting: u32) -> Result<SettingValue, String> {
        let mut value = ValueV1 {
            abi_version: ABI_VERSION,
            struct_size: size_of::<ValueV1>() as u32,
            kind: 0,
            reserved: 0,
            data: std::ptr::null(),
            count: 0,
        };
        // SAFETY: the host lives during the call of the library, and the place during this call.
        check(unsafe { (self.functions().get)(self.host, setting, &raw mut value) })?;
        // SAFETY: the host has written a value, whose data live until the next call of the host.
        unsafe { value_of(&raw const value) }
    }

    pub(crate) fn publish(&self, publisher: u32, cdr: &[u8]) -> Result<(), String> {
        // SAFETY: the host lives during the call of the library, and the bytes during this call.
        check(unsafe { (self.functions().publish)(self.host, publisher, cdr.as_ptr(), cdr.len()) })
    }

    pub(crate) fn call(&self, client: u32, cdr: &[u8]) -> Result<u64, String> {
        let mut id = 0;
        // SAFETY: the host lives during the call of the library; the bytes and the place live during this
        // call.
        check(unsafe { (self.functions().call)(self.host, client, cdr.as_ptr(), cdr.len(), &raw mut id) })?;
        Ok(id)
    }

    pub(crate) fn reply(&self, request: u64, result: &Result<Vec<u8>, String>) -> Result<(), String> {
        check(match result {
            // SAFETY: the host lives during the call of the library, and the bytes during this call.
            Ok(cdr) => unsafe { (self.functions().reply)(self.host, request, cdr.as_ptr(), cdr.len()) },
            // SAFETY: the host lives during the call of the library, and the text during this call.
            Err(reason) => unsafe {
                (self.functions().reply_error)(self.host, request, c_string(reason).as_ptr())
            },
        })
    }

    /// Schedules the task, instead of what it was scheduled for before.
    pub(crate) fn schedule_after(&self, task: u32, delay: Duration) -> Result<(), String> {
        let delay = i64::try_from(delay.as_nanos()).unwrap_or(i64::MAX);
        // SAFETY: the host lives during the call of the library.
        check(unsafe { (self.functions().cancel)(self.host, task) })?;
        // SAFETY: the host lives during the call of the library.
        check(unsafe { (self.functions().schedule_after)(self.host, task, delay) })
    }

    /// Reports to a debugger how the module describes itself. A robot that asks for it has the function.
    pub(crate) fn describe(&self, text: &str) -> Result<(), String> {
        let lent = LentValue::new(SettingValue::Text(text.to_owned()));
        let text = lent.in_c();
        // SAFETY: the host lives during the call of the library, the name may be null, and the value lives
        // during this call.
        check(unsafe { (self.functions().variable)(self.host, std::ptr::null(), &raw const text) })
    }

    pub(crate) fn remove(&self, module: &str) -> Result<(), String> {
        // SAFETY: the host lives during the call of the library, and the text during this call.
        check(unsafe { (self.functions().remove)(self.host, c_string(module).as_ptr()) })
    }
}

thread_local! {
    /// The robot that calls the library on this thread.
    static CURRENT: Cell<Host> = const { Cell::new(std::ptr::null()) };
}

/// Sends what the library logs to the robot that calls it.
pub(crate) fn forward_log() {
    // Set before by another module of the library.
    let _ = tracing::subscriber::set_global_default(Forward);
}

struct Forward;

impl Subscriber for Forward {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        // The core of the library reports the panic of its module, which the robot does too.
        let is_of_core =
            metadata.target().starts_with("downbeat_executor") && *metadata.level() == Level::ERROR;
        metadata.is_event() && *metadata.level() <= Level::DEBUG && !is_of_core
    }

    fn new_span(&self, _: &Attributes<'_>) -> Id {
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}

    fn event(&self, event: &Event<'_>) {
        let host = CURRENT.get();
        // On a thread of the library's own.
        if host.is_null() {
            return;
        }
        let mut line = Line::default();
        event.record(&mut line);
        let severity = match *event.metadata().level() {
            Level::ERROR => severity::ERROR,
            Level::WARN => severity::WARN,
            Level::INFO => severity::INFO,
            _ => severity::DEBUG,
        };
        let text = c_string(&(line.message + &line.fields));
        let metadata = event.metadata();
        let [file, path] =
            [metadata.file(), metadata.module_path()].map(|text| c_string(text.unwrap_or_default()));
        let needed = offset_of!(HostV1, log_at) + size_of::<usize>();
        // SAFETY: `during` sets the host for the time of the call only, and its size says whether it has the
        // function.
        unsafe {
            if (*host).struct_size as usize >= needed {
                let number = metadata.line().unwrap_or_default();
                ((*host).log_at)(host, severity, text.as_ptr(), file.as_ptr(), number, path.as_ptr());
            } else {
                ((*host).log)(host, severity, text.as_ptr());
            }
        }
    }

    fn enter(&self, _: &Id) {}

    fn exit(&self, _: &Id) {}
}

#[derive(Default)]
struct Line {
    message: String,
    fields: String,
}

impl Visit for Line {
    fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
        let _ = match field.name() {
            "message" => write!(self.message, "{value:?}"),
            name => write!(self.fields, " {name}={value:?}"),
        };
    }
}
