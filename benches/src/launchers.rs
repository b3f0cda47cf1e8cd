//! The launchers that are measured. This is the one place that names them.

use downbeat_executor::{Core, Pool, Threads};

/// A launcher, and how to give it to a core.
pub struct LauncherUnderTest {
    /// As the tables show it.
    pub name: &'static str,
    /// Gives the launcher to a core without modules; fails if the system refuses a thread.
    pub launch: fn(Core) -> anyhow::Result<Core>,
}

/// The launcher without threads, the default.
pub const LINEAR: &str = "Linear";
/// The launcher with two threads, that of the core among them.
pub const POOL_2: &str = "Pool(2)";

/// The launcher with a thread per module.
pub const THREADS: &str = "Threads";

/// All of them.
pub const LAUNCHERS: &[LauncherUnderTest] = &[
    LauncherUnderTest { name: LINEAR, launch: Ok },
    LauncherUnderTest { name: POOL_2, launch: |core| Ok(core.with_launcher(Pool::new(2)?)) },
    LauncherUnderTest { name: THREADS, launch: |core| Ok(core.with_launcher(Threads::new())) },
];
