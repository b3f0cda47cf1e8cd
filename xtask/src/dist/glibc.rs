//! Which glibc a program or library needs.

use std::path::Path;

use anyhow::{Context, ensure};

/// The latest version that a release may need: that of Debian 10, which docs/install.md and `Depends` of the
/// Debian package promise, and the name of the wheel.
const LATEST: Version = Version(2, 28, 0);

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Version(u32, u32, u32);

/// Checks that a program or library runs with the glibc that releases promise.
pub(super) fn check(file: &Path) -> anyhow::Result<()> {
    let bytes = std::fs::read(file).with_context(|| file.display().to_string())?;
    let needed = needed(&bytes);
    let needed = needed.with_context(|| format!("{} names no version of glibc", file.display()))?;
    ensure!(
        needed <= LATEST,
        "{} needs glibc {}.{}, and releases promise to run with {}.{}: `objdump -T` shows which functions do, find what calls \
         them, or raise the version in xtask/src/dist (glibc.rs, cross.rs, wheel.rs), packaging/debian/control and docs/install.md",
        file.display(),
        needed.0,
        needed.1,
        LATEST.0,
        LATEST.1,
    );
    Ok(())
}

/// The latest version in the names of an ELF file, whose symbols refer to texts such as `GLIBC_2.28` between
/// zeros.
fn needed(bytes: &[u8]) -> Option<Version> {
    let texts = bytes.split(|byte| *byte == 0);
    texts.filter_map(|text| version(std::str::from_utf8(text.strip_prefix(b"GLIBC_")?).ok()?)).max()
}

fn version(text: &str) -> Option<Version> {
    let mut numbers = text.split('.').map(|number| number.parse().ok());
    let version = Version(numbers.next()??, numbers.next()??, numbers.next().unwrap_or(Some(0))?);
    numbers.next().is_none().then_some(version)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_symbol_of_a_later_glibc_is_refused() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let with = |names: &str| std::fs::write(file.path(), format!("\u{7f}ELF\0memcpy\0{names}\0.text\0"));
        with("GLIBC_2.2.5\0GLIBC_2.28\0GLIBC_2.9\0GLIBC_PRIVATE\0GLIBCXX_3.4.30").unwrap();
        check(file.path()).unwrap();
        with("GLIBC_2.2.5\0GLIBC_2.34").unwrap();
        let error = check(file.path()).unwrap_err().to_string();
        assert!(error.contains(" needs glibc 2.34, and releases promise to run with 2.28: "), "{error}");
        with("strlen").unwrap();
        assert!(check(file.path()).unwrap_err().to_string().contains("names no version of glibc"));
    }

    #[test]
    fn the_version_of_a_program_of_this_machine_is_found() {
        let program = std::fs::read(std::env::current_exe().unwrap()).unwrap();
        assert!(needed(&program).unwrap() >= Version(2, 2, 5));
    }
}
