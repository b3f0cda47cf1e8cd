//! Reports of a process on `diagnostics` (REP-107): its core, its modules, its ROS 2 endpoints, and what else
//! it is asked to look at.
//!
//! ```
//! use downbeat_bridge::diagnostics::ProcessDiagnostics;
//! use downbeat_executor::Core;
//! use downbeat_msgs::diagnostic_msgs::msg::DiagnosticStatus;
//!
//! let mut core = Core::new();
//! let diagnostics = ProcessDiagnostics::add(&mut core, "darwin_op")?;
//! diagnostics.watch(|| vec![DiagnosticStatus { name: "darwin_op: disk".into(), ..DiagnosticStatus::default() }]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod module;
mod status;

pub use module::{MODULE_NAME, ProcessDiagnostics, TOPIC};
