//! The functions of the program, during one call of a library.

#![expect(unsafe_code, reason = "functions that a library calls with pointers")]

use crate::variables::{LARGEST, LONGEST_NAME, LONGEST_VALUE, Variables};
use downbeat_edge::foreign::{Declarations, ForeignContext, SettingDeclaration};
use downbeat_executor::{SettingValue, Time, Transition};
use downbeat_library_abi::{
    ABI_VERSION, Host, HostV1, LentValue, SettingV1, ValueV1, check_struct, severity, shown_name, shown_text,
    shown_value, text_of, transition, value_of,
};
use std::ffi::{CStr, c_char, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

/// What a library can request in an event.
pub(crate) trait Requests {
    fn now(&self) -> Time;
    fn publish(&mut self, publisher: u32, cdr: &[u8]) -> Result<(), String>;
    fn call(&mut self, client: u32, cdr: &[u8]) -> Result<u64, String>;
    fn reply(&mut self, request: u64, result: Result<&[u8], String>) -> Result<(), String>;
    fn setting(&mut self, setting: u32) -> Result<SettingValue, String>;
    fn set(&mut self, module: &str, setting: &str, value: SettingValue);
    fn schedule_after(&mut self, task: u32, delay: Duration) -> Result<(), String>;
    fn cancel(&mut self, task: u32) -> Result<(), String>;
    fn transition(&mut self, module: &str, transition: Transition);
    fn remove(&mut self, module: &str);
}

impl Requests for ForeignContext<'_, '_> {
    fn now(&self) -> Time {
        self.now()
    }

    fn publish(&mut self, publisher: u32, cdr: &[u8]) -> Result<(), String> {
        self.publish(publisher, cdr).map_err(|error| error.to_string())
    }

    fn call(&mut self, client: u32, cdr: &[u8]) -> Result<u64, String> {
        self.call(client, cdr).map_err(|error| error.to_string())
    }

    fn reply(&mut self, request: u64, result: Result<&[u8], String>) -> Result<(), String> {
        self.reply(request, result).map_err(|error| error.to_string())
    }

    fn setting(&mut self, setting: u32) -> Result<SettingValue, String> {
        (*self).setting(setting).cloned().map_err(|error| error.to_string())
    }

    fn set(&mut self, module: &str, setting: &str, value: SettingValue) {
        self.set(module, setting, value);
    }

    fn schedule_after(&mut self, task: u32, delay: Duration) -> Result<(), String> {
        self.schedule_after(task, delay).map_err(|error| error.to_string())
    }

    fn cancel(&mut self, task: u32) -> Result<(), String> {
        self.cancel(task).map_err(|error| error.to_string())
    }

    fn transition(&mut self, module: &str, transition: Transition) {
        self.transition(module, transition);
    }

    fn remove(&mut self, module: &str) {
        self.remove(module);
    }
}

/// Takes what a library declares.
pub(crate) trait Declare {
    fn define(&mut self, name: &str, text: &str) -> Result<(), String>;
    fn publish(&mut self, topic: &str, message: &str, hash: Option<&str>) -> u32;
    fn subscribe(&mut self, topic: &str, message: &str, hash: Option<&str>) -> u32;
    fn serve(&mut self, service: &str, of: &str, hash: Option<&str>) -> u32;
    fn client(&mut self, service: &str, of: &str, hash: Option<&str>, timeout: Duration) -> u32;
    fn every(&mut self, period: Duration) -> u32;
    fn task(&mut self) -> u32;
    fn setting(&mut self, setting: SettingDeclaration) -> Result<(u32, SettingValue), String>;
    fn each_run(&mut self);
}

impl Declare for Declarations {
    fn define(&mut self, name: &str, text: &str) -> Result<(), String> {
        self.define(name, text)
    }

    fn publish(&mut self, topic: &str, message: &str, hash: Option<&str>) -> u32 {
        self.publish(topic, message, hash)
    }

    fn subscribe(&mut self, topic: &str, message: &str, hash: Option<&str>) -> u32 {
        self.subscribe(topic, message, hash)
    }

    fn serve(&mut self, service: &str, of: &str, hash: Option<&str>) -> u32 {
        self.serve(service, of, hash)
    }

    fn client(&mut self, service: &str, of: &str, hash: Option<&str>, timeout: Duration) -> u32 {
        self.client(service, of, hash, timeout)
    }

    fn every(&mut self, period: Duration) -> u32 {
        self.every(period)
    }

    fn task(&mut self) -> u32 {
        self.task()
    }

    fn setting(&mut self, setting: SettingDeclaration) -> Result<(u32, SettingValue), String> {
        self.setting(setting)
    }

    fn each_run(&mut self) {
        self.each_run();
    }
}

/// What a library may do in a call.
pub(crate) enum Phase<'a> {
    /// Create, accept and restore: neither declare nor request.
    Apart,
    Setup(&'a mut dyn Declare),
    Run(&'a mut dyn Requests),
    Save(&'a mut Vec<u8>),
    /// What a debugger asks for, at the time of the module's last call.
    Variables {
        now: Time,
        taken: &'a mut Variables,
    },
}

/// One call of a library, which the functions of the program find through [`HostV1::context`].
struct Call<'a> {
    module: &'a CStr,
    phase: Phase<'a>,
    /// In the setup: the values of the settings so far.
    values: Vec<SettingValue>,
    /// What the last `get` returned.
    lent: Option<LentValue>,
    failure: Option<String>,
    log: &'a dyn Fn(&LogLine<'_>),
}

/// Calls a function of a library with the functions of the program, and returns its result and the reason
/// given for a failure.
pub(crate) fn with_host<'a, R>(
    module: &'a CStr,
    phase: Phase<'a>,
    log: &'a dyn Fn(&LogLine<'_>),
    call: impl FnOnce(Host) -> R,
) -> (R, Option<String>) {
    let mut state = Call { module, phase, values: Vec::new(), lent: None, failure: None, log };
    let context: *mut Call<'_> = &raw mut state;
    let host = HostV1 {
        abi_version: ABI_VERSION,
        struct_size: size_of::<HostV1>() as u32,
        context: context.cast::<c_void>(),
        name,
        now,
        log: self::log,
        fail,
        publisher,
        subscription,
        server,
        client,
        timer,
        task,
        setting,
        each_run,
        get,
        publish,
        call: self::call,
        reply,
        reply_error,
        set,
        schedule_after,
        cancel,
        transition: self::transition,
        remove,
        saved,
        define,
        log_at,
        variable,
    };
    let result = call(&raw const host);
    (result, state.failure)
}

/// A line that a library logs, with its place in the source; empty and 0 where that is not known.
#[derive(Clone, Copy, Default)]
pub(crate) struct LogLine<'a> {
    pub(crate) severity: i32,
    pub(crate) text: &'a str,
    pub(crate) file: &'a str,
    pub(crate) line: u32,
    pub(crate) function: &'a str,
}

/// Writes a line of a library's log.
pub(crate) fn log_line(module: &str, logged: &LogLine<'_>) {
    // The place is that in the source of the library, or none: that of this file would mislead.
    let LogLine { severity, text, file, line, function } = *logged;
    macro_rules! write_line {
        ($write:ident) => {
            tracing::$write!(module, log.file = file, log.line = line, log.module_path = function, "{text}")
        };
    }
    match severity {
        ..severity::INFO => write_line!(debug),
        severity::INFO..severity::WARN => write_line!(info),
        severity::WARN..severity::ERROR => write_line!(warn),
        severity::ERROR.. => write_line!(error),
    }
}

/// No definition of an interface is larger.
const LARGEST_DEFINITION: usize = 16 << 20;

/// What a function returns that refused something.
const REFUSED: i32 = -1;

/// Runs a function of the program. A refusal or a panic becomes the failure of the call.
///
/// # Safety
/// `host` is the pointer that [`with_host`] passed to the library, during that call.
unsafe fn with(host: Host, run: impl FnOnce(&mut Call<'_>) -> Result<(), String>) -> i32 {
    // SAFETY: `with_host` set the context, and does not use it until the library returns; a library calls on
    // one thread.
    let call = unsafe { &mut *(*host).context.cast::<Call<'_>>() };
    let result = catch_unwind(AssertUnwindSafe(|| run(call)));
    let reason = match result {
        Ok(Ok(())) => return 0,
        Ok(Err(reason)) => reason,
        Err(_) => "a function of the program failed; this is a mistake of downbeat".to_owned(),
    };
    call.failure = Some(reason);
    REFUSED
}

impl Call<'_> {
    fn declare(&mut self) -> Result<&mut dyn Declare, String> {
        match &mut self.phase {
            Phase::Setup(declare) => Ok(*declare),
            _ => Err("ports and settings can be declared in `setup` only".to_owned()),
        }
    }

    fn requests(&mut self) -> Result<&mut dyn Requests, String> {
        match &mut self.phase {
            Phase::Run(requests) => Ok(*requests),
            _ => Err("this can be requested in `handle` and `transition` only".to_owned()),
        }
    }
}

unsafe fn hash_of(hash: *const c_char) -> Result<Option<String>, String> {
    // SAFETY: null, or a text by the contract of downbeat.h.
    if hash.is_null() { Ok(None) } else { unsafe { text_of(hash, "the hash") }.map(Some) }
}

unsafe fn bytes_of<'a>(data: *const u8, size: usize) -> Result<&'a [u8], String> {
    match (data.is_null(), size) {
        (_, 0) => Ok(&[]),
        (true, _) => Err("the bytes are NULL".to_owned()),
        // SAFETY: `size` bytes by the contract of downbeat.h.
        _ => Ok(unsafe { std::slice::from_raw_parts(data, size) }),
    }
}

fn duration(nanoseconds: i64, what: &str) -> Result<Duration, String> {
    let nanoseconds = u64::try_from(nanoseconds);
    nanoseconds.map(Duration::from_nanos).map_err(|_| format!("{what} is negative"))
}

unsafe fn store<T>(place: *mut T, value: T) {
    if !place.is_null() {
        // SAFETY: not null, so a place for the value by the contract of downbeat.h.
        unsafe { place.write(value) };
    }
}

// Libraries call the functions below as downbeat.h says: with the host of the call, with texts that have a
// terminating zero, and with pointers that are valid during the call.

unsafe extern "C" fn name(host: Host) -> *const c_char {
    let mut name = c"".as_ptr();
    // SAFETY: by the contract of downbeat.h, `host` is that of this call.
    unsafe {
        with(host, |call| {
            name = call.module.as_ptr();
            Ok(())
        });
    }
    name
}

unsafe extern "C" fn now(host: Host) -> i64 {
    let mut now = 0;
    // SAFETY: by the contract of downbeat.h, `host` is that of this call.
    unsafe {
        with(host, |call| {
            now = match &call.phase {
                Phase::Run(requests) => requests.now().as_nanos(),
                Phase::Variables { now, .. } => now.as_nanos(),
                _ => 0,
            };
            Ok(())
        });
    }
    now
}

unsafe extern "C" fn log(host: Host, severity: i32, text: *const c_char) {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call and `text` is null or a text.
    unsafe {
        with(host, |call| {
            let text = text_of(text, "the line of the log")?;
            (call.log)(&LogLine { severity, text: &text, ..LogLine::default() });
            Ok(())
        });
    }
}

unsafe extern "C" fn log_at(
    host: Host,
    severity: i32,
    text: *const c_char,
    file: *const c_char,
    line: u32,
    function: *const c_char,
) {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call and `text`, `file` and `function`
    // are null or texts.
    unsafe {
        with(host, |call| {
            let text = text_of(text, "the line of the log")?;
            let place = |text: *const c_char, what| match text.is_null() {
                true => Ok(String::new()),
                false => text_of(text, what),
            };
            let (file, function) = (place(file, "the file")?, place(function, "the function")?);
            (call.log)(&LogLine { severity, text: &text, file: &file, line, function: &function });
            Ok(())
        });
    }
}

unsafe extern "C" fn fail(host: Host, reason: *const c_char) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call and `reason` is null or a text.
    unsafe { with(host, |_| Err(text_of(reason, "the reason").unwrap_or_else(|problem| problem))) }
}

unsafe extern "C" fn define(host: Host, of: *const c_char, text: *const *const c_char) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call, `of` is null or a text, and `text`
    // is null or a list of texts that ends with null.
    unsafe {
        with(host, |call| {
            let (of, mut whole) = (text_of(of, "the type")?, String::new());
            if text.is_null() {
                return Err(format!("the definition of {of} is NULL"));
            }
            let mut part = text;
            while !(*part).is_null() {
                whole.push_str(&text_of(*part, "the definition")?);
                if whole.len() > LARGEST_DEFINITION {
                    return Err(format!("the definition of {of} has more than {LARGEST_DEFINITION} bytes"));
                }
                part = part.add(1);
            }
            call.declare()?.define(&of, &whole)
        })
    }
}

unsafe extern "C" fn publisher(
    host: Host,
    topic: *const c_char,
    of: *const c_char,
    hash: *const c_char,
    number: *mut u32,
) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call, `topic`, `of` and `hash` are null
    // or texts, and `number` is null or a place for the number.
    unsafe {
        with(host, |call| {
            let (topic, of, hash) = (text_of(topic, "the topic")?, text_of(of, "the type")?, hash_of(hash)?);
            store(number, call.declare()?.publish(&topic, &of, hash.as_deref()));
            Ok(())
        })
    }
}

unsafe extern "C" fn subscription(
    host: Host,
    topic: *const c_char,
    of: *const c_char,
    hash: *const c_char,
    number: *mut u32,
) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call, `topic`, `of` and `hash` are null
    // or texts, and `number` is null or a place for the number.
    unsafe {
        with(host, |call| {
            let (topic, of, hash) = (text_of(topic, "the topic")?, text_of(of, "the type")?, hash_of(hash)?);
            store(number, call.declare()?.subscribe(&topic, &of, hash.as_deref()));
            Ok(())
        })
    }
}

unsafe extern "C" fn server(
    host: Host,
    service: *const c_char,
    of: *const c_char,
    hash: *const c_char,
    number: *mut u32,
) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call, `service`, `of` and `hash` are null
    // or texts, and `number` is null or a place for the number.
    unsafe {
        with(host, |call| {
            let (service, of, hash) =
                (text_of(service, "the service")?, text_of(of, "the type")?, hash_of(hash)?);
            store(number, call.declare()?.serve(&service, &of, hash.as_deref()));
            Ok(())
        })
    }
}

unsafe extern "C" fn client(
    host: Host,
    service: *const c_char,
    of: *const c_char,
    hash: *const c_char,
    timeout_ns: i64,
    number: *mut u32,
) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call, `service`, `of` and `hash` are null
    // or texts, and `number` is null or a place for the number.
    unsafe {
        with(host, |call| {
            let (service, of, hash) =
                (text_of(service, "the service")?, text_of(of, "the type")?, hash_of(hash)?);
            let timeout = duration(timeout_ns, "the timeout")?;
            store(number, call.declare()?.client(&service, &of, hash.as_deref(), timeout));
            Ok(())
        })
    }
}

unsafe extern "C" fn timer(host: Host, period_ns: i64, number: *mut u32) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call and `number` is null or a place for
    // the number.
    unsafe {
        with(host, |call| {
            store(number, call.declare()?.every(duration(period_ns, "the period")?));
            Ok(())
        })
    }
}

unsafe extern "C" fn task(host: Host, number: *mut u32) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call and `number` is null or a place for
    // the number.
    unsafe {
        with(host, |call| {
            store(number, call.declare()?.task());
            Ok(())
        })
    }
}

unsafe extern "C" fn setting(host: Host, setting: *const SettingV1, number: *mut u32) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call, `setting` is null or a declaration,
    // and `number` is null or a place for the number.
    unsafe {
        with(host, |call| {
            let given = setting.as_ref().ok_or("the setting is NULL")?;
            let size = size_of::<SettingV1>();
            check_struct("downbeat_setting_v1", given.abi_version, given.struct_size, size)?;
            let declaration = SettingDeclaration {
                name: text_of(given.name, "the name of the setting")?,
                description: text_of(given.description, "the description of the setting")?,
                default: value_of(given.initial)?,
                range: (given.has_range != 0).then_some(given.minimum..=given.maximum),
                is_read_only: given.is_read_only != 0,
            };
            let (declared, value) = call.declare()?.setting(declaration)?;
            call.values.push(value);
            store(number, declared);
            Ok(())
        })
    }
}

unsafe extern "C" fn each_run(host: Host) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call.
    unsafe {
        with(host, |call| {
            call.declare()?.each_run();
            Ok(())
        })
    }
}

unsafe extern "C" fn get(host: Host, setting: u32, value: *mut ValueV1) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call and `value` is null or a place for a
    // value.
    unsafe {
        with(host, |call| {
            let place = value.as_mut().ok_or("the place for the value is NULL")?;
            let size = size_of::<ValueV1>();
            check_struct("downbeat_value_v1", place.abi_version, place.struct_size, size)?;
            let value = match &mut call.phase {
                Phase::Setup(_) => {
                    let found = call.values.get(setting as usize).cloned();
                    found.ok_or_else(|| format!("there is no setting {setting} yet"))?
                }
                Phase::Run(requests) => requests.setting(setting)?,
                _ => return Err("settings can be read in `setup`, `handle` and `transition` only".to_owned()),
            };
            *place = call.lent.insert(LentValue::new(value)).in_c();
            Ok(())
        })
    }
}

unsafe extern "C" fn publish(host: Host, publisher: u32, cdr: *const u8, size: usize) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call and `cdr` points to `size` bytes.
    unsafe { with(host, |call| call.requests()?.publish(publisher, bytes_of(cdr, size)?)) }
}

unsafe extern "C" fn call(host: Host, client: u32, cdr: *const u8, size: usize, id: *mut u64) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call, `cdr` points to `size` bytes, and
    // `id` is null or a place for the number of the call.
    unsafe {
        with(host, |call| {
            store(id, call.requests()?.call(client, bytes_of(cdr, size)?)?);
            Ok(())
        })
    }
}

unsafe extern "C" fn reply(host: Host, request: u64, cdr: *const u8, size: usize) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call and `cdr` points to `size` bytes.
    unsafe { with(host, |call| call.requests()?.reply(request, Ok(bytes_of(cdr, size)?))) }
}

unsafe extern "C" fn reply_error(host: Host, request: u64, reason: *const c_char) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call and `reason` is null or a text.
    unsafe { with(host, |call| call.requests()?.reply(request, Err(text_of(reason, "the reason")?))) }
}

unsafe extern "C" fn set(
    host: Host,
    module: *const c_char,
    setting: *const c_char,
    value: *const ValueV1,
) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call, `module` and `setting` are null or
    // texts, and `value` is null or a value.
    unsafe {
        with(host, |call| {
            let (module, setting) =
                (text_of(module, "the module")?, text_of(setting, "the name of the setting")?);
            call.requests()?.set(&module, &setting, value_of(value)?);
            Ok(())
        })
    }
}

unsafe extern "C" fn schedule_after(host: Host, task: u32, delay_ns: i64) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call.
    unsafe { with(host, |call| call.requests()?.schedule_after(task, duration(delay_ns, "the delay")?)) }
}

unsafe extern "C" fn cancel(host: Host, task: u32) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call.
    unsafe { with(host, |call| call.requests()?.cancel(task)) }
}

unsafe extern "C" fn transition(host: Host, module: *const c_char, transition: u32) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call and `module` is null or a text.
    unsafe {
        with(host, |call| {
            let module = text_of(module, "the module")?;
            call.requests()?.transition(&module, transition_of(transition)?);
            Ok(())
        })
    }
}

unsafe extern "C" fn remove(host: Host, module: *const c_char) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call and `module` is null or a text.
    unsafe {
        with(host, |call| {
            let module = text_of(module, "the module")?;
            call.requests()?.remove(&module);
            Ok(())
        })
    }
}

unsafe extern "C" fn saved(host: Host, state: *const u8, size: usize) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call and `state` points to `size` bytes.
    unsafe {
        with(host, |call| match &mut call.phase {
            Phase::Save(saved) => {
                **saved = bytes_of(state, size)?.to_vec();
                Ok(())
            }
            _ => Err("`saved` can be called in `save` only".to_owned()),
        })
    }
}

unsafe extern "C" fn variable(host: Host, name: *const c_char, value: *const ValueV1) -> i32 {
    // SAFETY: by the contract of downbeat.h, `host` is that of this call, `name` is null or a text, and
    // `value` is null or a value.
    unsafe {
        with(host, |call| {
            let Phase::Variables { taken, .. } = &mut call.phase else {
                return Err("variables can be reported in `variables` only".to_owned());
            };
            if !taken.has_room() {
                return Ok(());
            }
            let Some(name) = shown_name(name, LONGEST_NAME) else {
                let (text, left_out) = shown_text(value, LARGEST)?;
                taken.describe(&text, left_out);
                return Ok(());
            };
            let shown = shown_value(value, LONGEST_VALUE);
            let shown = shown.inspect_err(|reason| taken.report(name.clone(), format!("<{reason}>")))?;
            taken.report(name, shown);
            Ok(())
        })
    }
}

/// The number of a transition.
pub(crate) fn number_of(of: Transition) -> u32 {
    match of {
        Transition::Configure => transition::CONFIGURE,
        Transition::Cleanup => transition::CLEANUP,
        Transition::Activate => transition::ACTIVATE,
        Transition::Deactivate => transition::DEACTIVATE,
        Transition::Shutdown => transition::SHUTDOWN,
    }
}

/// The transition with a number.
pub(crate) fn transition_of(number: u32) -> Result<Transition, String> {
    Ok(match number {
        transition::CONFIGURE => Transition::Configure,
        transition::CLEANUP => Transition::Cleanup,
        transition::ACTIVATE => Transition::Activate,
        transition::DEACTIVATE => Transition::Deactivate,
        transition::SHUTDOWN => Transition::Shutdown,
        other => return Err(format!("{other} is no transition")),
    })
}
