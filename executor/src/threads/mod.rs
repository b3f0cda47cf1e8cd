//! Threads: CPUs, priorities, synchronisation and deadlines.

mod error;
pub(crate) mod gate;
mod guard;
mod options;
mod receipt;
mod spin;
mod sync;
#[cfg_attr(not(target_os = "linux"), path = "elsewhere.rs")]
mod system;
mod watchdog;

pub use error::ThreadError;
pub use guard::Failure;
pub(crate) use guard::{drop_guarded, end_of, reason, sentence, unpoisoned};
pub use options::ThreadOptions;
pub use receipt::Receipt;
pub(crate) use receipt::{ReceiptSender, receipt};
pub use spin::Spin;
pub(crate) use spin::Spinner;
pub(crate) use system::{PromptTimers, processor_time};
pub use watchdog::Overrun;
pub(crate) use watchdog::{Watch, Watchdog};
