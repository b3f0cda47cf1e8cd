//! What a module does at a time: timers and tasks.

mod sync;
mod task;
mod timer;

pub(crate) use sync::Timers;
pub use task::Task;
pub(crate) use task::Tasks;
pub(crate) use timer::Timer;
