//! The program with what belongs to it on a machine: man pages, completions, documents; and the Debian
//! package of that.

pub(crate) mod debian;

use std::path::Path;
use std::process::Command;

use anyhow::Context;

use crate::steps::{output_of, run, workspace};

/// The licences of the crates that are compiled in, beside the documents of the program.
const NOTICES: &str = "THIRD-PARTY.txt";

/// Puts a program into a folder, as in a tarball: `bin/downbeat`, `share/man/man1/`, `share/completions/`
/// (`downbeat.bash`, `_downbeat`, `downbeat.fish`), `share/doc/downbeat/`. `runs` is the command that runs
/// it, which may be for another processor; `notices` are those of the crates in it.
pub(crate) fn arrange(
    program: &Path,
    runs: &dyn Fn(&Path) -> Command,
    notices: &str,
    folder: &Path,
) -> anyhow::Result<()> {
    let placed = folder.join("bin/downbeat");
    copy(program, &placed)?;
    run(runs(&placed).arg("man").arg(folder.join("share/man/man1")))?;
    for (shell, file) in [("bash", "downbeat.bash"), ("zsh", "_downbeat"), ("fish", "downbeat.fish")] {
        let script = output_of(runs(&placed).args(["completions", shell]))?;
        write(&folder.join("share/completions").join(file), script.as_bytes())?;
    }
    let documents = folder.join("share/doc/downbeat");
    for (from, to) in [("LICENSE", "LICENSE"), ("msgs/NOTICE", "NOTICE"), ("CHANGELOG.md", "CHANGELOG.md")] {
        copy(&workspace().join(from), &documents.join(to))?;
    }
    write(&documents.join(NOTICES), notices.as_bytes())
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
