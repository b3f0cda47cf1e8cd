//! Log lines for the program's log, and for `/rosout` in ROS 2, under the name of the module that writes
//! them.
//!
//! ```
//! use std::time::Duration;
//! use downbeat_executor::log::{info, warn_every, warn_once};
//! use downbeat_executor::{Module, Probe, Setup, SetupError};
//!
//! struct Battery;
//!
//! impl Module for Battery {
//!     type Ports = ();
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
//!         info!("measures the battery");
//!         setup.subscribe::<f64, _>("voltage", |_, received, ctx| {
//!             let voltage = *received;
//!             if voltage < 11.0 {
//!                 warn_every!(ctx, Duration::from_secs(10), "the battery has {voltage} V");
//!             }
//!             if voltage > 12.6 {
//!                 warn_once!(ctx, "{voltage} V: this is not the battery of the manual");
//!             }
//!         })
//!     }
//! }
//!
//! let mut probe = Probe::new();
//! probe.add("battery", Battery)?;
//! probe.publish("voltage", 10.9)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! `debug!`, `info!`, `warn!` and `error!` are those of the crate `tracing`: named values
//! (`warn!(servo = 5, "is silent")`) follow the text. The forms `_every` and `_once` take the context of the
//! callback as their first argument. Each call site is limited separately in each module, by the time of
//! cycles, so that a replay writes the same lines. A line of `_every` that follows suppressed lines ends with
//! `suppressed=` and their number.

use std::time::Duration;

use crate::Context;

#[doc(inline)]
pub use crate::{
    debug_every, debug_once, error_every, error_once, info_every, info_once, warn_every, warn_once,
};
pub use tracing::{debug, error, info, trace, warn};

impl<P> Context<'_, P> {
    /// Decides whether a limited line is due; for the macros of [`log`](crate::log), and for wrappers of
    /// other loggers. Returns `None` if the module has written the line of this call site within `period` (or
    /// at all, without a period), otherwise the number of lines suppressed since then.
    pub fn log_is_due(&mut self, site: &'static str, period: Option<Duration>) -> Option<u64> {
        let now = self.now();
        self.io().log_limits.is_due(site, now, period)
    }
}

#[doc(hidden)]
#[macro_export]
macro_rules! __log_limited {
    ($level:ident, $context:expr, $period:expr, $($line:tt)+) => {
        match $context.log_is_due(::core::concat!(::core::file!(), ":", ::core::line!(), ":", ::core::column!()), $period) {
            ::core::option::Option::None => {}
            ::core::option::Option::Some(0) => $crate::log::$level!($($line)+),
            ::core::option::Option::Some(suppressed) => $crate::log::$level!(suppressed, $($line)+),
        }
    };
}

/// Writes a line of level DEBUG at most once per period:
/// `debug_every!(ctx, Duration::from_secs(1), "{joint} is hot")`. See [`log`](crate::log).
#[macro_export]
macro_rules! debug_every {
    ($context:expr, $period:expr, $($line:tt)+) => {
        $crate::__log_limited!(debug, $context, ::core::option::Option::Some($period), $($line)+)
    };
}

/// Writes a line of level DEBUG once in the life of the module: `debug_once!(ctx, "the first picture")`. See
/// [`log`](crate::log).
#[macro_export]
macro_rules! debug_once {
    ($context:expr, $($line:tt)+) => {
        $crate::__log_limited!(debug, $context, ::core::option::Option::None, $($line)+)
    };
}

/// Writes a line of level INFO at most once per period:
/// `info_every!(ctx, Duration::from_secs(1), "{joint} is hot")`. See [`log`](crate::log).
#[macro_export]
macro_rules! info_every {
    ($context:expr, $period:expr, $($line:tt)+) => {
        $crate::__log_limited!(info, $context, ::core::option::Option::Some($period), $($line)+)
    };
}

/// Writes a line of level INFO once in the life of the module: `info_once!(ctx, "the first picture")`. See
/// [`log`](crate::log).
#[macro_export]
macro_rules! info_once {
    ($context:expr, $($line:tt)+) => {
        $crate::__log_limited!(info, $context, ::core::option::Option::None, $($line)+)
    };
}

/// Writes a line of level WARN at most once per period:
/// `warn_every!(ctx, Duration::from_secs(1), "{joint} is hot")`. See [`log`](crate::log).
#[macro_export]
macro_rules! warn_every {
    ($context:expr, $period:expr, $($line:tt)+) => {
        $crate::__log_limited!(warn, $context, ::core::option::Option::Some($period), $($line)+)
    };
}

/// Writes a line of level WARN once in the life of the module: `warn_once!(ctx, "the first picture")`. See
/// [`log`](crate::log).
#[macro_export]
macro_rules! warn_once {
    ($context:expr, $($line:tt)+) => {
        $crate::__log_limited!(warn, $context, ::core::option::Option::None, $($line)+)
    };
}

/// Writes a line of level ERROR at most once per period:
/// `error_every!(ctx, Duration::from_secs(1), "{joint} is hot")`. See [`log`](crate::log).
#[macro_export]
macro_rules! error_every {
    ($context:expr, $period:expr, $($line:tt)+) => {
        $crate::__log_limited!(error, $context, ::core::option::Option::Some($period), $($line)+)
    };
}

/// Writes a line of level ERROR once in the life of the module: `error_once!(ctx, "the first picture")`. See
/// [`log`](crate::log).
#[macro_export]
macro_rules! error_once {
    ($context:expr, $($line:tt)+) => {
        $crate::__log_limited!(error, $context, ::core::option::Option::None, $($line)+)
    };
}
