//! The Debian package, installed into an empty root.

use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, ensure};

use super::{Arrival, Home};
use crate::dist::FEATURES;
use crate::dist::cross::Target;
use crate::packaging::debian::{self, About};
use crate::packaging::{arrange, copy};
use crate::skips::Run;
use crate::steps::{output_of, run, workspace};
use crate::{crates, files, notices};

/// Packages an installed program, unpacks the package as dpkg does, runs what it has, and removes it again:
/// nothing is left. Lintian and systemd, where they are installed, find nothing.
pub(crate) fn debian_package(program: &Path, skips: &Run) -> anyhow::Result<()> {
    if !test_machine::has_program("dpkg-deb") {
        let reason = "dpkg-deb is missing: a Debian package can be made on Debian and Ubuntu";
        return skips.missing("cargo xtask deb", reason);
    }
    let home = Home::new()?;
    let arranged = home.path().join("arranged");
    let architecture = architecture()?;
    // Of what a release contains, so that lintian reads what it reads there.
    let notices = notices::of(&crates::of("downbeat", FEATURES, architecture.triple())?)?;
    arrange(program, &|program| Command::new(program), &notices, &arranged)?;
    let about = About {
        version: &crates::version()?,
        architecture: architecture.of_debian(),
        time: 1_700_000_000,
        compression: &["-Zgzip", "-z1"],
    };
    let package = debian::package(&arranged, &about, &workspace().join("target/install"))?;
    if !debian::lint(&package)? {
        skips.missing(
            "lintian of the Debian package",
            "lintian is missing: install Debian's package lintian",
        )?;
    }
    let root = home.path().join("root");
    prepare(&root)?;
    let before = files::below(&root)?;
    run(dpkg(&root).arg("--install").arg(&package))?;
    if test_machine::has_program("systemd-analyze") {
        verify(&root, home.path())?;
    } else {
        let reason = "systemd-analyze is missing: install Debian's package systemd";
        skips.missing("systemd's view of the service of the Debian package", reason)?;
    }
    let checked = installed(&root, &home)?.args(["check", "etc/downbeat/darwin_op.toml"]).output()?;
    ensure!(checked.status.success(), "check: {}", String::from_utf8_lossy(&checked.stderr));
    let arrival = Arrival::of(installed(&root, &home)?)?;
    println!("from the Debian package: first joint state after {} ms", arrival.first_joint_state.as_millis());
    run(dpkg(&root).args(["--purge", "downbeat"]))?;
    let before: BTreeSet<_> = before.into_iter().map(|file| file.path).collect();
    let mut left = files::below(&root)?;
    left.retain(|file| !before.contains(&file.path) && !is_left(&file.path));
    let left: Vec<_> = left.into_iter().map(|file| file.path).collect();
    ensure!(left.is_empty(), "after the package was purged, these are left: {left:?}");
    Ok(())
}

/// Lets systemd look at the service of a package that is installed in a root. It ignores keys and values that
/// it does not understand, with a line that names the file.
fn verify(root: &Path, scratch: &Path) -> anyhow::Result<()> {
    let unit = root.join("usr/lib/systemd/system/downbeat@.service");
    let text = fs::read_to_string(&unit).with_context(|| unit.display().to_string())?;
    let program = root.join("usr/bin/downbeat").display().to_string();
    // As an instance, whose program is that of the root.
    let instance = scratch.join("downbeat@darwin_op.service");
    fs::write(&instance, text.replace("/usr/bin/downbeat", &program))?;
    let mut verify = Command::new("systemd-analyze");
    let output = verify.args(["verify", "--man=no"]).arg(&instance).output()?;
    let found = String::from_utf8_lossy(&output.stderr);
    ensure!(
        output.status.success() && !found.contains("downbeat@"),
        "systemd-analyze verify of packaging/systemd/downbeat@.service: {}\n{found}",
        output.status
    );
    Ok(())
}

/// True for a file in a root that stays when the package is purged: what dpkg and the tools for accounts
/// write (the user of the service is removed on a running system only), and what docs/install.md says of
/// robots that were run.
pub(crate) fn is_left(path: &Path) -> bool {
    let accounts = ["etc/passwd", "etc/group", "etc/shadow", "etc/gshadow", "etc/.pwd.lock"];
    path.starts_with("var/lib/dpkg")
        || ["root/.cache/downbeat", "tmp/downbeat-0"].iter().any(|folder| path.starts_with(folder))
        || accounts.iter().any(|known| path.to_string_lossy().starts_with(known))
}

/// Makes a root that has what the package needs, as its `Depends` says, and nothing else: the C library,
/// which needs that of the compiler, in the versions of this machine. The tools of systemd, which it needs
/// too, work from outside.
pub(crate) fn prepare(root: &Path) -> anyhow::Result<()> {
    for folder in
        ["var/lib/dpkg/info", "var/lib/dpkg/updates", "var/lib/dpkg/triggers", "proc", "root", "tmp"]
    {
        fs::create_dir_all(root.join(folder))?;
    }
    for file in ["var/lib/dpkg/status", "var/lib/dpkg/available"] {
        fs::write(root.join(file), "")?;
    }
    // As on the systems that the package is for, where /lib is a link.
    for folder in ["lib", "lib64"] {
        fs::create_dir_all(root.join("usr").join(folder))?;
        std::os::unix::fs::symlink(Path::new("usr").join(folder), root.join(folder))?;
    }
    let architecture = architecture()?.of_debian();
    let packages = ["libc6", "libgcc-s1"].map(|name| format!("{name}:{architecture}"));
    let files = output_of(Command::new("dpkg").arg("--listfiles").args(packages))?;
    for file in files.lines().map(Path::new) {
        let is_library = ["/lib", "/lib64", "/usr/lib"].iter().any(|folder| file.starts_with(folder));
        if is_library && file.is_file() {
            copy(file, &root.join(file.strip_prefix("/")?))?;
        }
    }
    Ok(())
}

/// The installed program, which works in its root and sees nothing else. Only root may do that: for others it
/// runs with the libraries of this machine.
pub(crate) fn installed(root: &Path, home: &Home) -> anyhow::Result<Command> {
    let user = fs::metadata("/proc/self").context("the number of the user")?.uid();
    if user != 0 {
        eprintln!("xtask: not as root, so the program of the Debian package sees all of this machine");
        let mut command = home.command(root.join("usr/bin/downbeat"));
        command.current_dir(root);
        return Ok(command);
    }
    let mut command = home.command("unshare");
    command.arg("--mount-proc").arg(format!("--root={}", root.display())).arg("/usr/bin/downbeat");
    command.env("HOME", "/root").current_dir(root);
    Ok(command)
}

/// A command of dpkg for a root without the packages that ours depends on.
pub(crate) fn dpkg(root: &Path) -> Command {
    let mut dpkg = Command::new("dpkg");
    dpkg.arg(format!("--root={}", root.display())).args(["--force-not-root", "--force-depends"]);
    // The scripts see the root as DPKG_ROOT, and leave this machine alone.
    dpkg.args(["--force-script-chrootless", "--log=/dev/null"]);
    dpkg
}

/// The platform of this machine, as a release names it.
fn architecture() -> anyhow::Result<Target> {
    match std::env::consts::ARCH {
        "x86_64" => Ok(Target::X86_64),
        "aarch64" => Ok(Target::Aarch64),
        other => anyhow::bail!("no name of Debian is known for {other}"),
    }
}
