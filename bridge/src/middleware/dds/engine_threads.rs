//! Whether the threads of rustdds are still there.
//!
//! One that panics is gone without a word: nothing goes out or comes in any more, and no call says so. The system knows
//! the threads of a process by number and name; rustdds names its own.

use std::collections::BTreeSet;
use std::fs;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// With what the names begin, of which Linux keeps 15 characters.
const NAME: &str = "RustDDS";
/// One for the participant, one for discovery.
const COUNT: usize = 2;
/// How long a thread may take to give itself its name.
const NAMING: Duration = Duration::from_millis(200);

/// The threads of one participant; none where the system does not tell, so that nothing is ever missed of them.
#[derive(Debug, Default)]
pub(super) struct EngineThreads(BTreeSet<u64>);

impl EngineThreads {
    /// The threads that `start` leaves behind.
    pub(super) fn started_by<T, E>(start: impl FnOnce() -> Result<T, E>) -> Result<(T, Self), E> {
        // So that one does not count those of another.
        static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
        let _turn = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        let before = present();
        let started = start()?;
        if !cfg!(target_os = "linux") {
            return Ok((started, Self::default()));
        }
        let begin = Instant::now();
        loop {
            let new: BTreeSet<u64> = present().difference(&before).copied().collect();
            if new.len() >= COUNT || begin.elapsed() > NAMING {
                return Ok((started, Self(new)));
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// True if one of them has ended.
    pub(super) fn is_one_gone(&self) -> bool {
        !self.0.is_empty() && !self.0.is_subset(&present())
    }
}

/// All threads of rustdds in this process.
fn present() -> BTreeSet<u64> {
    let tasks = fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let is_of_engine = |path: &std::path::Path| {
        fs::read_to_string(path.join("comm")).is_ok_and(|name| name.starts_with(NAME))
    };
    tasks
        .filter(|task| is_of_engine(&task.path()))
        .filter_map(|task| task.file_name().to_str()?.parse().ok())
        .collect()
}
