//! What an engine behind [`Middleware`](downbeat_bridge::middleware::Middleware) must do, as cases that any
//! engine can be held against.
//!
//! ```
//! use downbeat_conformance::{CASES, engines, run};
//!
//! let engine = engines::in_process();
//! let case = CASES.iter().find(|case| case.name == "a_sample_arrives_as_it_was_written").unwrap();
//! assert!(run(&engine, case).is_as_expected());
//! ```

pub mod engines;
pub mod peer;

mod cases;
mod engine;
mod peer_process;
mod report;
mod support;

pub use cases::{CASES, Case, Heading};
pub use engine::{Domain, Engine, KnownFailure};
pub use report::{CaseResult, Outcome, limits_page, run, run_all};
