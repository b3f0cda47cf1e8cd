//! `cargo xtask portability`

use std::path::Path;
use std::process::Command;

use crate::steps::{Steps, run, workspace};

/// Systems for which the program is checked, without being linked or run.
const TARGETS: [(&str, &str); 2] = [("Windows", "x86_64-pc-windows-gnu"), ("macOS", "aarch64-apple-darwin")];

/// Beside the default ones. What is left out compiles C (`zenoh`, `sqlite`), or loads a C library (`mujoco`).
const FEATURES: &str = "football,mqtt,physics,policy,px4,security,sensors,tables";

/// Debian's compiler, whose package with sources of the standard library serves every system.
const COMPILER: &str = "/usr/bin/rustc";
const SOURCES: &str = "/usr/lib/rustlib/src/rust/library/Cargo.lock";
/// With which the standard library of Windows names the functions of that system.
const DLLTOOL: &str = "x86_64-w64-mingw32-dlltool";

/// Checks the program with its packages for other systems than Linux.
pub(crate) fn portability() -> anyhow::Result<()> {
    anyhow::ensure!(
        Path::new(COMPILER).exists() && Path::new(SOURCES).exists(),
        "no standard library for other systems: {COMPILER} or {SOURCES} is missing; on Debian: apt install rustc-web \
         rust-web-src. With rustup instead: `rustup target add TARGET`, then `cargo check --package downbeat --target TARGET`"
    );
    anyhow::ensure!(
        test_machine::has_program(DLLTOOL),
        "{DLLTOOL} is missing; on Debian: apt install binutils-mingw-w64-x86-64"
    );
    let mut steps = Steps::default();
    for (system, target) in TARGETS {
        steps.step(&format!("{system} ({target})"), || {
            let mut check = Command::new(env!("CARGO"));
            check.args(["check", "--locked", "--keep-going", "-Zbuild-std", "--target", target]);
            check.args(["--package", "downbeat", "--features", FEATURES]);
            // The sources of the standard library need what only a nightly compiler has without this.
            check.env("RUSTC_BOOTSTRAP", "1").env("RUSTC", COMPILER);
            run(check.env("CARGO_TARGET_DIR", workspace().join("target/portability")))
        });
    }
    steps.finish()
}
