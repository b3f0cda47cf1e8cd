//! Compilers and linkers for the platforms of releases.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context;

use crate::python;
use crate::steps::workspace;

const ZIG: &str = "ziglang==0.17.1";

/// A platform that releases are for: Linux with glibc 2.28 or later.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Target {
    #[value(name = "x86_64-unknown-linux-gnu")]
    X86_64,
    #[value(name = "aarch64-unknown-linux-gnu")]
    Aarch64,
}

impl Target {
    pub(crate) fn triple(self) -> &'static str {
        match self {
            Self::X86_64 => "x86_64-unknown-linux-gnu",
            Self::Aarch64 => "aarch64-unknown-linux-gnu",
        }
    }

    /// The platform in the words of zig.
    fn of_zig(self) -> &'static str {
        match self {
            Self::X86_64 => "x86_64-linux-gnu.2.28",
            Self::Aarch64 => "aarch64-linux-gnu.2.28",
        }
    }

    /// The architecture in the words of Debian.
    pub(crate) fn of_debian(self) -> &'static str {
        match self {
            Self::X86_64 => "amd64",
            Self::Aarch64 => "arm64",
        }
    }

    /// The command that runs a program of this platform on this machine.
    pub(crate) fn runs(self, program: &Path) -> Command {
        match self {
            Self::X86_64 => Command::new(program),
            Self::Aarch64 => {
                let mut command = Command::new("qemu-aarch64-static");
                command.args(["-L", "/"]).arg(program);
                command
            }
        }
    }
}

impl std::fmt::Display for Target {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.triple())
    }
}

/// What cargo needs in its environment to compile and link for a platform: zig, for the libraries of old
/// systems, and Debian's compiler for aarch64, whose standard library it has.
pub(crate) fn environment(target: Target) -> anyhow::Result<Vec<(String, OsString)>> {
    let python = python::tools("target/zig-tools", &[ZIG])?;
    let zig = format!("exec '{}' -m ziglang", python.display());
    // Some crates give the platform in the words of clang, which zig refuses.
    let compile = format!(
        "for argument do\n    shift\n    case \"$argument\" in --target=*) ;; *) set -- \"$@\" \"$argument\" ;; esac\n\
         done\n{zig} cc -target {} \"$@\"",
        target.of_zig()
    );
    let compiler = script(target, "cc", &compile)?;
    let archiver = script(target, "ar", &format!("{zig} ar \"$@\""))?;
    let name = target.triple().replace('-', "_");
    let mut environment = vec![
        (format!("CARGO_TARGET_{}_LINKER", name.to_uppercase()), compiler.clone().into()),
        (format!("CC_{name}"), compiler.into()),
        (format!("AR_{name}"), archiver.into()),
    ];
    if target == Target::Aarch64 {
        let (rustc, library) = ("/usr/bin/rustc", "/usr/lib/rustlib/aarch64-unknown-linux-gnu");
        anyhow::ensure!(
            Path::new(rustc).exists() && Path::new(library).exists(),
            "no compiler for {target}: {rustc} or {library} is missing; on Debian: dpkg --add-architecture arm64, \
             then apt install rustc-web libstd-rust-web-dev:arm64 libc6:arm64 qemu-user-static"
        );
        environment.push(("RUSTC".to_owned(), rustc.into()));
    }
    Ok(environment)
}

/// Writes an executable script, if it is not the same already, for cargo compiles anew after changes.
fn script(target: Target, name: &str, lines: &str) -> anyhow::Result<PathBuf> {
    use std::os::unix::fs::PermissionsExt;
    let path = workspace().join("target/zig").join(target.triple()).join(name);
    let text = format!("#!/bin/sh\n{lines}\n");
    if std::fs::read_to_string(&path).is_ok_and(|old| old == text) {
        return Ok(path);
    }
    let write = || {
        std::fs::create_dir_all(path.parent().unwrap_or(&path))?;
        std::fs::write(&path, text)?;
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755))
    };
    write().with_context(|| format!("cannot write {}", path.display()))?;
    Ok(path)
}
