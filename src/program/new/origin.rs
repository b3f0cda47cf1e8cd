//! The source from which a project depends on downbeat.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use toml::Value;

/// The source of downbeat for a project, since the crates are not published.
#[derive(Debug)]
pub(super) enum Origin {
    /// The folder that this program was built from.
    Checkout(PathBuf),
    Git {
        url: String,
        revision: String,
    },
}

/// The folder of the templates' dependencies.
const TEMPLATE: &str = "/checkout";

const CONFIG: &str = include_str!("templates/shared/cargo_config.toml");

impl Origin {
    pub(super) fn git(url: &str, revision: &str) -> Self {
        Self::Git { url: url.to_owned(), revision: revision.to_owned() }
    }

    pub(super) fn checkout() -> anyhow::Result<Self> {
        Self::of_folder(Path::new(env!("CARGO_MANIFEST_DIR")))
    }

    fn of_folder(folder: &Path) -> anyhow::Result<Self> {
        if !folder.join("Cargo.toml").is_file() || folder.to_str().is_none() {
            bail!(
                "a project depends on the source of downbeat, but {}, from which this program was built, no longer exists: \
                 set another source with --git URL --rev REV, or build the program again",
                folder.display()
            );
        }
        Ok(Self::Checkout(folder.to_owned()))
    }

    /// Replaces the template's `path = "/checkout…"`.
    pub(super) fn put_into(&self, text: &str) -> String {
        let begin = format!("path = \"{TEMPLATE}");
        let line = |line: &str| match line.split_once(&begin) {
            Some((before, rest)) => {
                let (package, after) = rest.split_once('"').unwrap_or((rest, ""));
                format!("{before}{}{after}", self.dependency(package))
            }
            None => line.to_owned(),
        };
        text.split('\n').map(line).collect::<Vec<_>>().join("\n")
    }

    /// `package` is a path within the repository.
    fn dependency(&self, package: &str) -> String {
        match self {
            Self::Checkout(folder) => format!("path = {}", quoted(format!("{}{package}", folder.display()))),
            Self::Git { url, revision } => {
                format!("git = {}, rev = {}", quoted(url.clone()), quoted(revision.clone()))
            }
        }
    }

    /// Files that let a project reuse the crates compiled by a checkout: its lock file, and cargo's
    /// configuration.
    pub(super) fn files(&self) -> anyhow::Result<Vec<(&'static str, String)>> {
        let Self::Checkout(folder) = self else {
            return Ok(Vec::new());
        };
        let lock = folder.join("Cargo.lock");
        let lock =
            std::fs::read_to_string(&lock).with_context(|| format!("cannot read {}", lock.display()))?;
        let target = quoted(format!("{}/target", folder.display()));
        let config = CONFIG.replace(&format!("\"{TEMPLATE}/target\""), &target);
        Ok(vec![("Cargo.lock", lock), (".cargo/config.toml", config)])
    }
}

/// Quotes a TOML string.
fn quoted(text: String) -> String {
    Value::String(text).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINE: &str = "a = { path = \"/checkout/msgs\" } # b";

    #[test]
    fn a_dependency_is_a_path_or_a_revision() {
        let path = Origin::Checkout("/opt/down \"beat\"".into()).put_into(LINE);
        let table: toml::Table = path.parse().expect(&path);
        assert_eq!(table["a"]["path"].as_str(), Some("/opt/down \"beat\"/msgs"));
        let git = Origin::git("https://example.org/downbeat.git", "1f2e").put_into(LINE);
        assert_eq!(git, "a = { git = \"https://example.org/downbeat.git\", rev = \"1f2e\" } # b");
    }

    #[test]
    fn a_missing_checkout_is_an_error_with_instructions() {
        let error =
            Origin::of_folder("/no/such/checkout".as_ref()).map(|_| ()).map_err(|error| error.to_string());
        assert!(error.as_ref().is_err_and(|error| error.contains("--git URL --rev REV")), "{error:?}");
    }
}
