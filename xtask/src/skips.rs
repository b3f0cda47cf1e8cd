//! The list of the tests that a run skipped.

use std::io::Write;
use std::path::PathBuf;

use anyhow::Context;
use test_machine::Skips;

/// The list of one run of several commands.
pub(crate) struct Run {
    file: PathBuf,
}

impl Run {
    /// Begins an empty list.
    pub(crate) fn new() -> anyhow::Result<Self> {
        let file = test_machine::list_file().context("xtask is in no target folder")?;
        std::fs::write(&file, "").with_context(|| file.display().to_string())?;
        Ok(Self { file })
    }

    /// The environment variable that lets the tests of a command append to this list.
    pub(crate) fn variable(&self) -> (&'static str, &PathBuf) {
        (test_machine::LIST, &self.file)
    }

    /// Lists a step that is skipped for a reason.
    ///
    /// # Errors
    /// In a strict run, which skips nothing.
    pub(crate) fn missing(&self, step: &str, reason: &str) -> anyhow::Result<()> {
        anyhow::ensure!(!test_machine::is_strict(), "{reason}");
        eprintln!("skipped: {step}: {reason}");
        let mut list = std::fs::File::options().append(true).open(&self.file)?;
        writeln!(list, "{}\t{step}", reason.replace(['\n', '\t'], " "))
            .with_context(|| self.file.display().to_string())
    }

    pub(crate) fn print(&self) -> anyhow::Result<()> {
        let skips = Skips::read(&self.file, None).with_context(|| self.file.display().to_string())?;
        println!("\n{skips}");
        Ok(())
    }
}

/// Prints what the latest run of tests skipped, with all tests.
pub(crate) fn print_latest() -> anyhow::Result<()> {
    println!("{}", Skips::of_latest_run()?.in_full());
    Ok(())
}
