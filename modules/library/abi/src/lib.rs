//! The C interface between downbeat and modules in shared libraries: `include/downbeat.h`, as Rust types.
//!
//! The header describes what the functions do and when they may be called. A test of `downbeat-library-host`
//! compares the layouts with those of a C compiler.

mod lent;
mod shown;

pub use lent::{LentValue, c_string, check_struct, text_of, value_of};
pub use shown::{shown_name, shown_text, shown_value};

use std::ffi::{c_char, c_void};

/// The version of the interface.
pub const ABI_VERSION: u32 = 1;

/// The name of the function that each library exports, a [`ModuleFunction`].
pub const SYMBOL: &str = "downbeat_module";

/// Returns the table of a library.
pub type ModuleFunction = unsafe extern "C" fn() -> *const ModuleV1;

/// `downbeat_value_v1`: a value of a setting.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
#[expect(missing_docs, reason = "the header describes them")]
pub struct ValueV1 {
    pub abi_version: u32,
    pub struct_size: u32,
    pub kind: u32,
    pub reserved: u32,
    pub data: *const c_void,
    pub count: usize,
}

/// `downbeat_setting_v1`: a setting to declare.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
#[expect(missing_docs, reason = "the header describes them")]
pub struct SettingV1 {
    pub abi_version: u32,
    pub struct_size: u32,
    pub name: *const c_char,
    pub description: *const c_char,
    pub initial: *const ValueV1,
    pub minimum: f64,
    pub maximum: f64,
    pub has_range: u8,
    pub is_read_only: u8,
}

/// `downbeat_event_v1`: what comes to a module.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
#[expect(missing_docs, reason = "the header describes them")]
pub struct EventV1 {
    pub abi_version: u32,
    pub struct_size: u32,
    pub kind: u32,
    pub port: u32,
    pub id: u64,
    pub data: *const u8,
    pub size: usize,
    pub time_ns: i64,
    pub missed: u32,
    pub is_last: u8,
    pub is_error: u8,
}

/// A pointer to [`HostV1`], which each function of the program takes first.
pub type Host = *const HostV1;
type Text = *const c_char;

/// `downbeat_host_v1`: the functions of the program.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
#[expect(missing_docs, reason = "the header describes them")]
pub struct HostV1 {
    pub abi_version: u32,
    pub struct_size: u32,
    pub context: *mut c_void,
    pub name: unsafe extern "C" fn(Host) -> Text,
    pub now: unsafe extern "C" fn(Host) -> i64,
    pub log: unsafe extern "C" fn(Host, i32, Text),
    pub fail: unsafe extern "C" fn(Host, Text) -> i32,
    pub publisher: unsafe extern "C" fn(Host, Text, Text, Text, *mut u32) -> i32,
    pub subscription: unsafe extern "C" fn(Host, Text, Text, Text, *mut u32) -> i32,
    pub server: unsafe extern "C" fn(Host, Text, Text, Text, *mut u32) -> i32,
    pub client: unsafe extern "C" fn(Host, Text, Text, Text, i64, *mut u32) -> i32,
    pub timer: unsafe extern "C" fn(Host, i64, *mut u32) -> i32,
    pub task: unsafe extern "C" fn(Host, *mut u32) -> i32,
    pub setting: unsafe extern "C" fn(Host, *const SettingV1, *mut u32) -> i32,
    pub each_run: unsafe extern "C" fn(Host) -> i32,
    pub get: unsafe extern "C" fn(Host, u32, *mut ValueV1) -> i32,
    pub publish: unsafe extern "C" fn(Host, u32, *const u8, usize) -> i32,
    pub call: unsafe extern "C" fn(Host, u32, *const u8, usize, *mut u64) -> i32,
    pub reply: unsafe extern "C" fn(Host, u64, *const u8, usize) -> i32,
    pub reply_error: unsafe extern "C" fn(Host, u64, Text) -> i32,
    pub set: unsafe extern "C" fn(Host, Text, Text, *const ValueV1) -> i32,
    pub schedule_after: unsafe extern "C" fn(Host, u32, i64) -> i32,
    pub cancel: unsafe extern "C" fn(Host, u32) -> i32,
    pub transition: unsafe extern "C" fn(Host, Text, u32) -> i32,
    pub remove: unsafe extern "C" fn(Host, Text) -> i32,
    pub saved: unsafe extern "C" fn(Host, *const u8, usize) -> i32,
    /// Programs whose `struct_size` ends before it lack it.
    pub define: unsafe extern "C" fn(Host, Text, *const Text) -> i32,
    /// As `define`.
    pub log_at: unsafe extern "C" fn(Host, i32, Text, Text, u32, Text),
    /// Programs that lack it do not call `variables`.
    pub variable: unsafe extern "C" fn(Host, Text, *const ValueV1) -> i32,
}

/// `downbeat_module_v1`: the functions of a module.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
#[expect(missing_docs, reason = "the header describes them")]
pub struct ModuleV1 {
    pub abi_version: u32,
    pub struct_size: u32,
    pub name: Text,
    pub create: Option<unsafe extern "C" fn(Host) -> *mut c_void>,
    pub setup: Option<unsafe extern "C" fn(*mut c_void, Host) -> i32>,
    pub handle: Option<unsafe extern "C" fn(*mut c_void, Host, *const EventV1) -> i32>,
    pub destroy: Option<unsafe extern "C" fn(*mut c_void)>,
    pub transition: Option<unsafe extern "C" fn(*mut c_void, Host, u32) -> i32>,
    pub accept: Option<unsafe extern "C" fn(*mut c_void, Host, u32, *const ValueV1) -> i32>,
    pub save: Option<unsafe extern "C" fn(*mut c_void, Host) -> i32>,
    pub restore: Option<unsafe extern "C" fn(*mut c_void, Host, *const u8, usize) -> i32>,
    /// Tables whose `struct_size` ends before it lack it.
    pub variables: Option<unsafe extern "C" fn(*mut c_void, Host) -> i32>,
}

impl ModuleV1 {
    /// The size of the first tables of this version, in bytes. None is shorter.
    pub const FIRST_SIZE: usize = std::mem::offset_of!(Self, variables);

    /// A table without functions.
    pub const EMPTY: Self = Self {
        abi_version: ABI_VERSION,
        struct_size: size_of::<Self>() as u32,
        name: std::ptr::null(),
        create: None,
        setup: None,
        handle: None,
        destroy: None,
        transition: None,
        accept: None,
        save: None,
        restore: None,
        variables: None,
    };
}

/// Kinds of values.
pub mod value {
    #![expect(missing_docs, reason = "the header describes them")]
    pub const BOOL: u32 = 1;
    pub const INTEGER: u32 = 2;
    pub const DOUBLE: u32 = 3;
    pub const TEXT: u32 = 4;
    pub const BYTES: u32 = 5;
    pub const BOOLS: u32 = 6;
    pub const INTEGERS: u32 = 7;
    pub const DOUBLES: u32 = 8;
    pub const TEXTS: u32 = 9;
}

/// Kinds of events.
pub mod event {
    #![expect(missing_docs, reason = "the header describes them")]
    pub const MESSAGE: u32 = 1;
    pub const REQUEST: u32 = 2;
    pub const REPLY: u32 = 3;
    pub const SETTING: u32 = 4;
    pub const TIMER: u32 = 5;
    pub const TASK: u32 = 6;
    pub const EACH_RUN: u32 = 7;
}

/// Transitions.
pub mod transition {
    #![expect(missing_docs, reason = "the header describes them")]
    pub const CONFIGURE: u32 = 1;
    pub const CLEANUP: u32 = 2;
    pub const ACTIVATE: u32 = 3;
    pub const DEACTIVATE: u32 = 4;
    pub const SHUTDOWN: u32 = 5;
}

/// Severities of lines of the log.
pub mod severity {
    #![expect(missing_docs, reason = "the header describes them")]
    pub const DEBUG: i32 = 10;
    pub const INFO: i32 = 20;
    pub const WARN: i32 = 30;
    pub const ERROR: i32 = 40;
}

// SAFETY: a table holds only a static text and functions.
#[expect(unsafe_code, reason = "a static of a library")]
unsafe impl Sync for ModuleV1 {}
