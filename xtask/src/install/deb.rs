//! The Debian package, installed into an empty root.

use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, ensure};

use super::{Arrival, Home};
use crate::dist::FEATURES;
use crate::dist::cross::Target;
use crate::packaging::arrange;
use crate::packaging::debian::{self, About};
use crate::skips::Run;
use crate::steps::{run, workspace};
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
    run(dpkg(&root).arg("--install").arg(&package))?;
    let installed = root.join("usr/bin/downbeat");
    if test_machine::has_program("systemd-analyze") {
        verify(&root, home.path())?;
    } else {
        let reason = "systemd-analyze is missing: install Debian's package systemd";
        skips.missing("systemd's view of the service of the Debian package", reason)?;
    }
    let checked =
        home.command(&installed).arg("check").arg(root.join("etc/downbeat/darwin_op.toml")).output()?;
    ensure!(checked.status.success(), "check: {}", String::from_utf8_lossy(&checked.stderr));
    let arrival = Arrival::of(&installed, &home)?;
    println!("from the Debian package: first joint state after {} ms", arrival.first_joint_state.as_millis());
    run(dpkg(&root).args(["--purge", "downbeat"]))?;
    // The user of the service, which systemd's tools put into the root, is removed on a running system only.
    let left: Vec<_> = files::below(&root)?.into_iter().map(|file| file.path).collect();
    let left: Vec<_> = left.iter().filter(|path| !is_of_system(path)).collect();
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

/// True for a file in a root that dpkg and the tools for accounts keep, whatever is installed.
pub(crate) fn is_of_system(path: &Path) -> bool {
    let accounts = ["etc/passwd", "etc/group", "etc/shadow", "etc/gshadow", "etc/.pwd.lock"];
    path.starts_with("var/lib/dpkg") || accounts.iter().any(|known| path.to_string_lossy().starts_with(known))
}

/// Makes an empty root for [`dpkg`].
pub(crate) fn prepare(root: &Path) -> anyhow::Result<()> {
    for folder in ["var/lib/dpkg/info", "var/lib/dpkg/updates", "var/lib/dpkg/triggers"] {
        fs::create_dir_all(root.join(folder))?;
    }
    for file in ["var/lib/dpkg/status", "var/lib/dpkg/available"] {
        fs::write(root.join(file), "")?;
    }
    Ok(())
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
