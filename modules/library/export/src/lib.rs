//! Exports a Rust module as a shared library, for robots that were built by another compiler or with other
//! versions.
//!
//! ```
//! use downbeat_library::executor::{Module, Publication, Setup, SetupError};
//! use downbeat_library::msgs::std_msgs::msg::Float64;
//!
//! #[derive(Default)]
//! struct Doubler;
//!
//! impl Module for Doubler {
//!     type Ports = Publication<Float64>;
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Publication<Float64>, SetupError> {
//!         setup.subscribe::<Float64, _>("in", |_, message, ctx| {
//!             let out = *ctx.ports;
//!             ctx.publish(out, Float64 { data: 2.0 * message.data });
//!         })?;
//!         setup.publish("out")
//!     }
//! }
//!
//! downbeat_library::export_module!(Doubler);
//! # fn main() {}
//! ```
//!
//! The package has `crate-type = ["cdylib"]`; a robot file names the result with `kind = "library"`.
//! Interfaces of the user's own come second: `export_module!(Doubler, my_msgs::INTERFACES)`. The library
//! carries their definitions, so the robot need not know them. Actions are served and used with [`actions`],
//! as in a module that is compiled in.
//!
//! # What is different in a library
//! The library contains a core of its own with this one module. A run of the module in the robot is one or
//! more cycles of this core, at the time of the robot. Callbacks, their order, timers and panics are those of
//! a module that is compiled in, except:
//!
//! - topics carry messages of ROS 2, not plain Rust types, and services and actions are those of ROS 2;
//! - a module can neither receive a topic that it publishes nor call a service that it serves;
//! - messages of several cycles that a detached module receives in one run have the time of the run;
//! - the work of a job runs within the run that spawns it;
//! - commands to other modules, and their settings, have no effect;
//! - the defaults of the settings must be a complete configuration, since the settings are read from a first
//!   setup;
//! - if the library is reloaded, its module starts anew; settings keep their values.

#![expect(unsafe_code, reason = "the functions that a robot calls")]

mod host;
mod inner;

pub use downbeat_actions as actions;
pub use downbeat_edge::Interfaces;
pub use downbeat_executor as executor;
pub use downbeat_library_abi as abi;
pub use downbeat_msgs as msgs;

use abi::{ABI_VERSION, EventV1, Host, ModuleV1, ValueV1, value_of};
use downbeat_executor::{Module, SettingValue};
use host::Robot;
use inner::Inner;
use std::any::Any;
use std::cell::RefCell;
use std::ffi::{CStr, c_void};
use std::marker::PhantomData;
use std::panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind};

/// What a library exports. [`export_module!`] implements it.
pub trait Export: 'static {
    /// The module.
    type Module: Module;

    /// Its type, for messages about the library.
    const NAME: &'static CStr;

    /// Creates a module.
    fn module() -> Self::Module;

    /// The interfaces that the module uses.
    ///
    /// # Errors
    /// If two of them have one name and different definitions.
    fn interfaces() -> Result<Interfaces, String>;
}

/// Exports a module with a `Default` as the module of the library, optionally with a set of interfaces of the
/// user.
#[macro_export]
macro_rules! export_module {
    ($module:ty) => {
        $crate::export_module!(@ $module, ::std::result::Result::Ok($crate::Interfaces::carried()));
    };
    ($module:ty, $interfaces:expr) => {
        $crate::export_module!(
            @ $module,
            $crate::Interfaces::carried().with($interfaces).map_err(|conflict| conflict.to_string())
        );
    };
    (@ $module:ty, $interfaces:expr) => {
        const _: () = {
            struct Exported;

            impl $crate::Export for Exported {
                type Module = $module;

                const NAME: &'static ::std::ffi::CStr =
                    match ::std::ffi::CStr::from_bytes_with_nul(concat!(stringify!($module), "\0").as_bytes()) {
                        Ok(name) => name,
                        Err(_) => c"module",
                    };

                fn module() -> $module {
                    ::std::default::Default::default()
                }

                fn interfaces() -> ::std::result::Result<$crate::Interfaces, ::std::string::String> {
                    $interfaces
                }
            }

            #[allow(unsafe_code)]
            #[unsafe(no_mangle)]
            extern "C" fn downbeat_module() -> *const $crate::abi::ModuleV1 {
                $crate::table::<Exported>()
            }
        };
    };
}

/// The table of a library.
#[must_use]
pub fn table<E: Export>() -> &'static ModuleV1 {
    &Functions::<E>::TABLE
}

/// The functions of a library. A robot calls them as downbeat.h says: with the host of the call, with the
/// module that `create` returned, and with pointers that are valid during the call.
struct Functions<E>(PhantomData<E>);

impl<E: Export> Functions<E> {
    const TABLE: ModuleV1 = ModuleV1 {
        abi_version: ABI_VERSION,
        struct_size: size_of::<ModuleV1>() as u32,
        name: E::NAME.as_ptr(),
        create: Some(Self::create),
        setup: Some(Self::setup),
        handle: Some(Self::handle),
        destroy: Some(Self::destroy),
        transition: Some(Self::transition),
        accept: Some(Self::accept),
        save: None,
        restore: None,
        variables: Some(Self::variables),
    };

    unsafe extern "C" fn create(host: Host) -> *mut c_void {
        let mut created = std::ptr::null_mut();
        guarded(host, |_| {
            host::forward_log();
            // The library has its own copy of the standard library, so this is the hook of its own panics.
            std::panic::set_hook(Box::new(keep_panic));
            created = Box::into_raw(Box::new(Option::<Inner>::None)).cast();
            Ok(())
        });
        created
    }

    unsafe extern "C" fn setup(module: *mut c_void, host: Host) -> i32 {
        guarded(host, |robot| {
            // SAFETY: `create` returned this pointer, and calls of one module do not overlap.
            let place = unsafe { &mut *module.cast::<Option<Inner>>() };
            *place = Some(Inner::new(robot, || E::module(), E::interfaces()?)?);
            Ok(())
        })
    }

    unsafe extern "C" fn handle(module: *mut c_void, host: Host, event: *const EventV1) -> i32 {
        guarded(host, |robot| {
            // SAFETY: `create` returned this pointer, and calls of one module do not overlap.
            let inner = unsafe { inner(module) }?;
            // SAFETY: an event by the contract of downbeat.h; its data are bytes during the call.
            let (event, data) = unsafe {
                let event = &*event;
                let data: &[u8] = match event.size {
                    0 => &[],
                    size => std::slice::from_raw_parts(event.data, size),
                };
                (event, data)
            };
            inner.handle(robot, event, data)
        })
    }

    unsafe extern "C" fn transition(module: *mut c_void, host: Host, transition: u32) -> i32 {
        // SAFETY: `create` returned this pointer, and calls of one module do not overlap.
        guarded(host, |robot| unsafe { inner(module) }?.transition(robot, transition))
    }

    unsafe extern "C" fn accept(module: *mut c_void, host: Host, setting: u32, value: *const ValueV1) -> i32 {
        guarded(host, |_| {
            // SAFETY: a value by the contract of downbeat.h.
            let value: SettingValue = unsafe { value_of(value) }?;
            // SAFETY: `create` returned this pointer, and calls of one module do not overlap.
            unsafe { inner(module) }?.accept(setting, value)
        })
    }

    unsafe extern "C" fn variables(module: *mut c_void, host: Host) -> i32 {
        // SAFETY: `create` returned this pointer, and calls of one module do not overlap.
        guarded(host, |robot| match unsafe { inner(module) }?.debug() {
            Some(text) => robot.describe(&text),
            None => Ok(()),
        })
    }

    unsafe extern "C" fn destroy(module: *mut c_void) {
        // SAFETY: `create` returned this pointer, and nothing uses it afterwards.
        let module = unsafe { Box::from_raw(module.cast::<Option<Inner>>()) };
        // A panic of the module's destructor must not leave the library.
        let _ = catch_unwind(AssertUnwindSafe(|| drop(module)));
    }
}

unsafe fn inner<'a>(module: *mut c_void) -> Result<&'a mut Inner, String> {
    // SAFETY: by the caller.
    unsafe { &mut *module.cast::<Option<Inner>>() }
        .as_mut()
        .ok_or_else(|| "`setup` was not called".to_owned())
}

/// Runs a function of the library. An error or a panic becomes the reason that the robot logs.
fn guarded(host: Host, run: impl FnOnce(&Robot) -> Result<(), String>) -> i32 {
    let robot = Robot::new(host);
    let reason = match robot.during(|| catch_unwind(AssertUnwindSafe(|| run(&robot)))) {
        Ok(Ok(())) => return 0,
        Ok(Err(reason)) => reason,
        Err(panic) => last_panic().unwrap_or_else(|| text_of_panic(&*panic)),
    };
    robot.fail(&reason)
}

thread_local! {
    /// The text of the last panic on this thread.
    static PANIC: RefCell<Option<String>> = const { RefCell::new(None) };
}

fn keep_panic(info: &PanicHookInfo<'_>) {
    let place = info.location().map(|place| format!(" at {place}")).unwrap_or_default();
    let text = format!("it panicked{place}: {}", text_of_panic(info.payload()));
    PANIC.with_borrow_mut(|panic| *panic = Some(text));
}

fn last_panic() -> Option<String> {
    PANIC.with_borrow_mut(Option::take)
}

fn text_of_panic(panic: &(dyn Any + Send + 'static)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "it panicked".to_owned())
}
