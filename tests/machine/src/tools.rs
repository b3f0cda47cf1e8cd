//! The tools that several tests need. Each function reports a missing tool.

use std::ffi::OsString;
use std::process::{Command, Stdio};

use crate::skips::missing;

/// The Python interpreter that a variable names.
#[track_caller]
pub fn interpreter(variable: &str) -> Option<OsString> {
    let python = std::env::var_os(variable);
    if python.is_none() {
        missing(variable, "`cargo xtask test` installs that interpreter and sets the variable");
    }
    python
}

/// The folder with the npm packages of the tests.
#[track_caller]
pub fn node_modules() -> Option<OsString> {
    const VARIABLE: &str = "DOWNBEAT_NODE_MODULES";
    let modules = std::env::var_os(VARIABLE);
    if modules.is_none() {
        missing(VARIABLE, "`cargo xtask test` sets it where Node.js 18 and npm are installed");
    }
    modules
}

/// Whether all these compilers are installed.
#[track_caller]
pub fn has_compilers(names: &[&str]) -> bool {
    let lacking = names.iter().find(|name| !has_program(name));
    if let Some(name) = lacking {
        missing(name, "install a compiler for C and C++ (Debian: the package g++)");
    }
    lacking.is_none()
}

/// Whether a program can be started. Unlike the other functions, this one reports nothing.
pub fn has_program(name: &str) -> bool {
    let mut command = Command::new(name);
    command.arg("--version").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command.status().is_ok()
}
