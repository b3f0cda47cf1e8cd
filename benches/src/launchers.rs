//! The measured launchers, listed only here.

use downbeat_executor::{Core, Pool, Threads};

/// A launcher, and the function that sets it.
pub struct LauncherUnderTest {
    /// The name in the tables.
    pub name: &'static str,
    /// Sets the launcher of a core without modules; fails if the system refuses a thread.
    pub launch: fn(Core) -> anyhow::Result<Core>,
}

/// The launcher without threads, the default.
pub const LINEAR: &str = "Linear";
/// The launcher with two threads, including the core's.
pub const POOL_2: &str = "Pool(2)";

/// The launcher with a thread per module.
pub const THREADS: &str = "Threads";

/// All measured launchers.
pub const LAUNCHERS: &[LauncherUnderTest] = &[
    LauncherUnderTest { name: LINEAR, launch: Ok },
    LauncherUnderTest { name: POOL_2, launch: |core| Ok(core.with_launcher(Pool::new(2)?)) },
    LauncherUnderTest { name: THREADS, launch: |core| Ok(core.with_launcher(Threads::new())) },
];
