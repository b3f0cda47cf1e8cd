//! The program `downbeat` of a checkout, compiled as the projects of users compile it.
//!
//! Cargo compiles the packages of a workspace for that workspace: what the checkout compiles for itself, the
//! project of a user would compile again. So the program and the extension module of the Python package are
//! packages outside of the workspace, in `program`, as projects are: with the same folder for what is
//! compiled, the same profiles and versions, all of them share everything but their own crates.

use std::path::Path;

/// Gives the program the versions that the workspace has. Cargo leaves out of the copy what the program does
/// not need.
///
/// # Errors
/// If the lock file cannot be copied; the text says why.
pub fn lock(start: &Path) -> Result<(), String> {
    let [from, to] = [start.join("../Cargo.lock"), start.join("program/Cargo.lock")];
    let modified = |path: &Path| path.metadata().and_then(|metadata| metadata.modified()).ok();
    if modified(&to).is_some() && modified(&from) <= modified(&to) {
        return Ok(());
    }
    std::fs::copy(&from, &to)
        .map(drop)
        .map_err(|error| format!("cannot copy {} to {}: {error}", from.display(), to.display()))
}
