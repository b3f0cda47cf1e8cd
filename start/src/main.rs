//! `cargo run` in a checkout: builds the program `downbeat` and becomes it; see the library beside it.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

/// The features that this program was built with.
fn features() -> Vec<&'static str> {
    macro_rules! enabled {
        ($($feature:literal)*) => {
            [$((cfg!(feature = $feature), $feature)),*]
        };
    }
    let all = enabled!("default" "cli" "plots" "top" "view" "tables" "physics" "policy" "px4" "network" "leagues" "mqtt" "security" "sensors" "state_machine" "football" "mujoco" "rustdds" "sqlite" "zenoh");
    all.into_iter().filter_map(|(is_enabled, feature)| is_enabled.then_some(feature)).collect()
}

fn main() -> ExitCode {
    let start = Path::new(env!("CARGO_MANIFEST_DIR"));
    let program = start.join("program/Cargo.toml");
    if let Err(problem) = downbeat_start::lock(start) {
        eprintln!("start: {problem}");
        return ExitCode::FAILURE;
    }
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.arg("run").arg("--manifest-path").arg(&program).args(["--no-default-features", "--features"]);
    cargo.arg(features().join(","));
    if let Some((target, profile)) = place() {
        cargo.arg("--target-dir").arg(target).arg("--profile").arg(profile);
    }
    cargo.arg("--").args(std::env::args_os().skip(1));
    become_it(cargo)
}

/// The folder of what is compiled, and the name of the profile, which this program was compiled with.
fn place() -> Option<(PathBuf, OsString)> {
    let itself = std::env::current_exe().ok()?;
    let folder = itself.parent()?;
    let profile = match folder.file_name()? {
        debug if debug == "debug" => "dev".into(),
        other => other.to_owned(),
    };
    Some((folder.parent()?.to_owned(), profile))
}

#[cfg(unix)]
fn become_it(mut command: Command) -> ExitCode {
    use std::os::unix::process::CommandExt;
    eprintln!("start: cannot run cargo: {}", command.exec());
    ExitCode::FAILURE
}

#[cfg(not(unix))]
fn become_it(mut command: Command) -> ExitCode {
    match command.status() {
        Ok(status) if status.success() => ExitCode::SUCCESS,
        Ok(_) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("start: cannot run cargo: {error}");
            ExitCode::FAILURE
        }
    }
}
