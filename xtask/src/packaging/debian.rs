//! The Debian package: program, service, rules for serial adapters, and an example of a robot at boot.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, ensure};

use super::{NOTICES, copy, write};
use crate::crates::repository;
use crate::files;
use crate::steps::{run, workspace};

/// What the package says of itself.
pub(crate) struct About<'a> {
    pub(crate) version: &'a str,
    /// In Debian's words: `amd64` or `arm64`.
    pub(crate) architecture: &'a str,
    /// In seconds since 1970: all files have this time, so that the same commit gives the same package.
    pub(crate) time: u64,
    /// Options of dpkg-deb: small for a release, quick for a test.
    pub(crate) compression: &'a [&'a str],
}

/// Makes the package in a folder from what [`arrange`](super::arrange) put into another; returns its path.
pub(crate) fn package(arranged: &Path, about: &About<'_>, out: &Path) -> anyhow::Result<PathBuf> {
    let scratch = tempfile::tempdir()?;
    let root = scratch.path().join("root");
    let packaging = workspace().join("packaging");
    let program = root.join("usr/bin/downbeat");
    copy(&arranged.join("bin/downbeat"), &program)?;
    copy(
        &packaging.join("systemd/downbeat@.service"),
        &root.join("usr/lib/systemd/system/downbeat@.service"),
    )?;
    copy(&packaging.join("sysusers/downbeat.conf"), &root.join("usr/lib/sysusers.d/downbeat.conf"))?;
    copy(&packaging.join("udev/60-downbeat.rules"), &root.join("usr/lib/udev/rules.d/60-downbeat.rules"))?;
    copy(&workspace().join("robots/darwin_op.toml"), &root.join("etc/downbeat/darwin_op.toml"))?;
    for (from, to) in [
        ("downbeat.bash", "bash-completion/completions/downbeat"),
        ("_downbeat", "zsh/vendor-completions/_downbeat"),
        ("downbeat.fish", "fish/vendor_completions.d/downbeat.fish"),
    ] {
        copy(&arranged.join("share/completions").join(from), &root.join("usr/share").join(to))?;
    }
    let pages = arranged.join("share/man/man1");
    for page in fs::read_dir(&pages).with_context(|| pages.display().to_string())? {
        let page = page?.path();
        let name = page.file_name().unwrap_or_default().to_string_lossy().into_owned();
        write(&root.join("usr/share/man/man1").join(name + ".gz"), &compressed(&fs::read(&page)?)?)?;
    }
    let documents = root.join("usr/share/doc/downbeat");
    write(&documents.join("changelog.gz"), &compressed(changelog(about)?.as_bytes())?)?;
    let arranged_documents = arranged.join("share/doc/downbeat");
    write(&documents.join("copyright"), copyright(&arranged_documents)?.as_bytes())?;
    copy(&arranged_documents.join(NOTICES), &documents.join(NOTICES))?;
    let overrides = root.join("usr/share/lintian/overrides/downbeat");
    copy(&packaging.join("debian/lintian-overrides"), &overrides)?;
    control(&root, about)?;
    modes(&root, &program)?;
    fs::create_dir_all(out).with_context(|| format!("cannot create {}", out.display()))?;
    let package = out.join(format!("downbeat_{}_{}.deb", about.version, about.architecture));
    let mut build = Command::new("dpkg-deb");
    build
        .args(about.compression)
        .args(["--root-owner-group", "--build"])
        .arg(&root)
        .arg(&package)
        .stdout(Stdio::null());
    run(build.env("SOURCE_DATE_EPOCH", about.time.to_string()))
        .context("dpkg-deb is needed, which Debian and Ubuntu have")?;
    Ok(package)
}

fn control(root: &Path, about: &About<'_>) -> anyhow::Result<()> {
    let packaging = workspace().join("packaging/debian");
    let text = fs::read_to_string(packaging.join("control"))?;
    let values = [
        ("@VERSION@", about.version.to_owned()),
        ("@ARCHITECTURE@", about.architecture.to_owned()),
        ("@SIZE@", (files::size(&files::below(root)?) / 1024).to_string()),
        ("@HOMEPAGE@", repository()?),
    ];
    let text = values.iter().fold(text, |text, (name, value)| text.replace(name, value));
    write(&root.join("DEBIAN/control"), text.as_bytes())?;
    write(&root.join("DEBIAN/conffiles"), b"/etc/downbeat/darwin_op.toml\n")?;
    for script in ["postinst", "prerm", "postrm"] {
        copy(&packaging.join(script), &root.join("DEBIAN").join(script))?;
    }
    let sums = Command::new("sh")
        .args(["-c", "find usr etc -type f -print0 | LC_ALL=C sort -z | xargs -0 md5sum"])
        .current_dir(root)
        .output()?;
    ensure!(sums.status.success(), "md5sum: {}", String::from_utf8_lossy(&sums.stderr));
    write(&root.join("DEBIAN/md5sums"), &sums.stdout)
}

/// Debian's form of a changelog: what changed is in the project's own.
fn changelog(about: &About<'_>) -> anyhow::Result<String> {
    let date =
        Command::new("date").args(["--utc", "--rfc-email", &format!("--date=@{}", about.time)]).output()?;
    Ok(format!(
        "downbeat ({}) unstable; urgency=medium\n\n  * The changes are in CHANGELOG.md of the sources.\n\n \
         -- the downbeat authors <downbeat@users.noreply.github.com>  {}",
        about.version,
        String::from_utf8_lossy(&date.stdout)
    ))
}

/// The licence, and notices of interfaces. Debian wants the full texts of common licences elsewhere.
fn copyright(documents: &Path) -> anyhow::Result<String> {
    let mut text = format!(
        "Format: https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/\nUpstream-Name: downbeat\n\n\
         Files: *\nCopyright: the downbeat authors\nLicense: Apache-2.0\n On Debian systems, the text of the Apache License 2.0 is in\n \
         /usr/share/common-licenses/Apache-2.0.\n\n\
         Comment: Crates of others, which are compiled into the program, and the texts of their licences are in\n \
         /usr/share/doc/downbeat/{NOTICES}.\n\n\
         Comment: Interface definitions of others, which the program contains:\n"
    );
    let notice = documents.join("NOTICE");
    let notice = fs::read_to_string(&notice).with_context(|| notice.display().to_string())?;
    for line in notice.lines() {
        let line = line.trim_end();
        text += &if line.is_empty() { " .\n".to_owned() } else { format!(" {line}\n") };
    }
    Ok(text)
}

/// Lets lintian look at a package, where it is installed: false where it is not.
///
/// # Errors
/// If lintian finds an error or a warning.
pub(crate) fn lint(package: &Path) -> anyhow::Result<bool> {
    if !test_machine::has_program("lintian") {
        return Ok(false);
    }
    run(Command::new("lintian").args(["--fail-on", "error,warning"]).arg(package))?;
    Ok(true)
}

/// The same bytes for the same content: without a name and a time.
fn compressed(content: &[u8]) -> anyhow::Result<Vec<u8>> {
    use std::io::Write;
    let mut gzip = Command::new("gzip");
    let mut child = gzip.args(["-9", "--no-name"]).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
    let mut input = child.stdin.take().context("gzip")?;
    // Read while it is written: gzip would wait for a reader of a long answer.
    std::thread::scope(|scope| {
        let writes = scope.spawn(move || input.write_all(content));
        let output = child.wait_with_output()?;
        ensure!(output.status.success(), "gzip failed");
        writes.join().map_err(|_| anyhow::anyhow!("gzip"))??;
        Ok(output.stdout)
    })
}

/// The modes that Debian expects, whatever the user's mask is.
fn modes(folder: &Path, program: &Path) -> anyhow::Result<()> {
    let set = |path: &Path, mode| fs::set_permissions(path, fs::Permissions::from_mode(mode));
    set(folder, 0o755)?;
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let is_script =
            ["postinst", "prerm", "postrm"].iter().any(|name| path.ends_with(Path::new("DEBIAN").join(name)));
        match path.is_dir() {
            true => modes(&path, program)?,
            false => set(&path, if path == program || is_script { 0o755 } else { 0o644 })?,
        }
    }
    Ok(())
}
