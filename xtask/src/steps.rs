//! Runs commands one after another and reports their results.

use std::collections::VecDeque;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
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

/// Runs a command in the workspace and returns what it prints on standard output.
pub(crate) fn output_of(command: &mut Command) -> anyhow::Result<String> {
    let name = format!("{command:?}");
    let output = command.current_dir(workspace()).output().with_context(|| format!("cannot run {name}"))?;
    anyhow::ensure!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).with_context(|| format!("{name} printed no UTF-8"))
}

/// Runs a command in the workspace. What it prints on standard error from the line with `mark` on is repeated
/// in the error if it fails.
pub(crate) fn run_and_repeat(mark: &str, command: &mut Command) -> anyhow::Result<()> {
    const MOST_LINES: usize = 400;
    let name = format!("{command:?}");
    let command = command.current_dir(workspace()).stderr(Stdio::piped());
    let mut child = command.spawn().with_context(|| format!("cannot run {name}"))?;
    let mut repeated = VecDeque::new();
    let mut is_marked = false;
    for line in child.stderr.take().into_iter().flat_map(|stderr| BufReader::new(stderr).split(b'\n')) {
        let line = String::from_utf8_lossy(&line?).into_owned();
        eprintln!("{line}");
        is_marked |= line.contains(mark);
        if is_marked {
            repeated.push_back(line);
        }
        if repeated.len() > MOST_LINES {
            repeated.pop_front();
        }
    }
    let status = child.wait()?;
    if !status.success() {
        bail!("{name} failed: {status}\n{}", Vec::from(repeated).join("\n"));
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
        let (verdict, elapsed) = (if result.is_ok() { "passed" } else { "FAILED" }, started.elapsed());
        // At once too: a run that is ended from outside never prints its summary.
        eprintln!("== {name}: {verdict} after {:.0} s", elapsed.as_secs_f64());
        self.done.push((name.to_owned(), result, elapsed));
    }

    /// Prints the errors, and the result of each step.
    ///
    /// # Errors
    /// Returns an error if a step failed.
    pub(crate) fn finish(self) -> anyhow::Result<()> {
        for (name, result, _) in &self.done {
            if let Err(error) = result {
                println!("\n== {name}: {error:#}");
            }
        }
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
