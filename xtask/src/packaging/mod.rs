//! The program with what belongs to it on a machine: man pages, completions, documents; and the Debian
//! package of that.

pub(crate) mod debian;

use std::ffi::OsString;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, ensure};

use crate::steps::{run, workspace};

/// Puts a program into a folder, as in a tarball: `bin/downbeat`, `share/man/man1/`, `share/completions/`
/// (`downbeat.bash`, `_downbeat`, `downbeat.fish`), `share/doc/downbeat/`. `runner` is what runs the program
/// where it is for another processor.
pub(crate) fn arrange(program: &Path, runner: &[OsString], folder: &Path) -> anyhow::Result<()> {
    let placed = folder.join("bin/downbeat");
    copy(program, &placed)?;
    let command = |arguments: &[&str]| {
        let mut words = runner.iter().map(OsString::as_os_str).chain([placed.as_os_str()]);
        let mut command = Command::new(words.next().unwrap_or(placed.as_os_str()));
        command.args(words).args(arguments);
        command
    };
    run(command(&["man"]).arg(folder.join("share/man/man1")))?;
    for (shell, file) in [("bash", "downbeat.bash"), ("zsh", "_downbeat"), ("fish", "downbeat.fish")] {
        let output = command(&["completions", shell]).output().context("cannot run the program")?;
        ensure!(output.status.success(), "no completions: {}", String::from_utf8_lossy(&output.stderr));
        write(&folder.join("share/completions").join(file), &output.stdout)?;
    }
    let documents = folder.join("share/doc/downbeat");
    for (from, to) in [("LICENSE", "LICENSE"), ("msgs/NOTICE", "NOTICE"), ("CHANGELOG.md", "CHANGELOG.md")] {
        copy(&workspace().join(from), &documents.join(to))?;
    }
    Ok(())
}

/// Copies a file into a folder that is made if there is none.
pub(crate) fn copy(from: &Path, to: &Path) -> anyhow::Result<()> {
    let copied = std::fs::create_dir_all(to.parent().unwrap_or(to)).and_then(|()| std::fs::copy(from, to));
    copied.map(drop).with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))
}

/// Writes a file into a folder that is made if there is none.
pub(crate) fn write(path: &Path, content: &[u8]) -> anyhow::Result<()> {
    let written =
        std::fs::create_dir_all(path.parent().unwrap_or(path)).and_then(|()| std::fs::write(path, content));
    written.with_context(|| format!("cannot write {}", path.display()))
}
