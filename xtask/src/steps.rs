//! Runs commands one after another and reports their results.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};

/// The root of the workspace.
pub(crate) fn workspace() -> PathBuf {
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR"));
    manifest.parent().unwrap_or(manifest).to_owned()
}

/// Runs a command in the workspace. It inherits the output of this process.
pub(crate) fn run(command: &mut Command) -> anyhow::Result<()> {
    run_in(&workspace(), command)
}

/// Runs a command in a folder. It inherits the output of this process.
pub(crate) fn run_in(folder: &Path, command: &mut Command) -> anyhow::Result<()> {
    let name = format!("{command:?}");
    let status = command.current_dir(folder).status().with_context(|| format!("cannot run {name}"))?;
    if !status.success() {
        bail!("{name} failed: {status}");
    }
    Ok(())
}

/// Steps that all run, even if others fail.
#[derive(Default)]
pub(crate) struct Steps {
    done: Vec<(String, anyhow::Result<()>, Duration)>,
}

impl Steps {
    pub(crate) fn step(&mut self, name: &str, run: impl FnOnce() -> anyhow::Result<()>) {
        eprintln!("\n== {name}");
        let started = Instant::now();
        let result = run();
        if let Err(error) = &result {
            eprintln!("== {name}: {error:#}");
        }
        self.done.push((name.to_owned(), result, started.elapsed()));
    }

    /// Prints the result of each step.
    ///
    /// # Errors
    /// Returns an error if a step failed.
    pub(crate) fn finish(self) -> anyhow::Result<()> {
        println!("\nsummary");
        for (name, result, time) in &self.done {
            let verdict = if result.is_ok() { "passed" } else { "FAILED" };
            println!("  {verdict}  {:>5.0} s  {name}", time.as_secs_f64());
        }
        let failed = self.done.iter().filter(|(_, result, _)| result.is_err()).count();
        println!("\nsteps: {} passed, {failed} failed", self.done.len() - failed);
        if failed > 0 {
            bail!("{failed} of {} steps failed", self.done.len());
        }
        Ok(())
    }
}
