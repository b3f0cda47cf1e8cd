//! Which keystore and enclave protect a participant, as ROS 2 environment variables say it.

use std::path::{Path, PathBuf};

use super::MiddlewareError;

/// How a participant is to be protected: what `ROS_SECURITY_ENABLE=true` asks for, with the meaning that rcl
/// of Jazzy gives the variables (`rcl/src/security.c`).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SecurityOptions {
    /// `ROS_SECURITY_KEYSTORE`: the folder that `ros2 security create_keystore` made.
    pub keystore: Option<PathBuf>,
    /// The name of the enclave: that of `--enclave`, or `/`.
    pub enclave: String,
    /// `ROS_SECURITY_ENCLAVE_OVERRIDE`: the name of the enclave, whatever the command line says.
    pub enclave_override: Option<String>,
    /// `ROS_SECURITY_STRATEGY=Enforce`: without a usable enclave the participant does not join. Otherwise it
    /// joins without protection.
    pub is_enforced: bool,
}

impl SecurityOptions {
    /// The options in the variables from `lookup`, and a sentence for each value that rcl ignores although
    /// somebody wanted something with it.
    pub(super) fn from_variables(lookup: impl Fn(&str) -> Option<String>) -> (Option<Self>, Vec<String>) {
        let mut ignored = Vec::new();
        let mut is_exactly = |variable: &str, expected: &str| {
            let found = lookup(variable)?;
            if found != expected && wants(&found, expected) {
                ignored.push(format!(
                    "{variable}={found:?} has no effect: ROS 2 knows only {variable}={expected}, exactly so"
                ));
            }
            Some(found == expected)
        };
        let is_enabled = is_exactly("ROS_SECURITY_ENABLE", "true").unwrap_or_default();
        let is_enforced = is_exactly("ROS_SECURITY_STRATEGY", "Enforce").unwrap_or_default();
        if !is_enabled {
            return (None, ignored);
        }
        let options = Self {
            keystore: lookup("ROS_SECURITY_KEYSTORE").map(PathBuf::from),
            enclave: "/".to_owned(),
            enclave_override: lookup("ROS_SECURITY_ENCLAVE_OVERRIDE"),
            is_enforced,
        };
        (Some(options), ignored)
    }

    /// The name of the enclave that counts.
    #[must_use]
    pub fn enclave(&self) -> &str {
        self.enclave_override.as_deref().unwrap_or(&self.enclave)
    }

    /// The folder with the files of the enclave.
    ///
    /// # Errors
    /// [`MiddlewareError::Security`] when no keystore is named, or the name is none of an enclave.
    pub fn folder(&self) -> Result<PathBuf, MiddlewareError> {
        let keystore = self.keystore.as_deref().ok_or_else(|| {
            let reason = "ROS_SECURITY_KEYSTORE is not set: name the folder that `downbeat security create-keystore` or `ros2 \
                          security create_keystore` made";
            MiddlewareError::Security { reason: reason.to_owned() }
        })?;
        let name = self.enclave();
        if !is_name(name) {
            let reason = format!(
                "{name:?} is no name of an enclave: it begins with a slash, and between slashes stand letters, digits and \
                 underscores, the first no digit, as in /robots/one"
            );
            return Err(MiddlewareError::Security { reason });
        }
        Ok(enclave_folder(keystore, name))
    }
}

/// Whether a value was meant to be the expected one, or to say yes.
fn wants(found: &str, expected: &str) -> bool {
    let found = found.trim().to_ascii_lowercase();
    found == expected.to_ascii_lowercase()
        || ["1", "on", "yes", "true", "enable", "enabled"].contains(&&*found)
}

/// Whether a name is one of an enclave, by the rules of rcl (`rcl_validate_enclave_name`).
fn is_name(name: &str) -> bool {
    let is_part = |part: &str| {
        part.starts_with(|first: char| first.is_ascii_alphabetic() || first == '_')
            && part.chars().all(|character| character.is_ascii_alphanumeric() || character == '_')
    };
    name == "/" || name.strip_prefix('/').is_some_and(|rest| rest.split('/').all(is_part))
}

/// The folder of an enclave in a keystore.
fn enclave_folder(keystore: &Path, enclave: &str) -> PathBuf {
    keystore.join("enclaves").join(enclave.trim_start_matches('/'))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn read(variables: &[(&str, &str)]) -> (Option<SecurityOptions>, Vec<String>) {
        SecurityOptions::from_variables(|name| {
            variables.iter().find(|(key, _)| *key == name).map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn only_the_exact_words_of_rcl_count_and_others_are_told() {
        assert_eq!(read(&[]), (None, Vec::new()));
        assert_eq!(read(&[("ROS_SECURITY_ENABLE", "false")]), (None, Vec::new()));
        for found in ["TRUE", "1", "True", "on"] {
            let (options, ignored) = read(&[("ROS_SECURITY_ENABLE", found)]);
            assert_eq!(options, None);
            assert!(
                ignored[0].contains(found) && ignored[0].contains("ROS_SECURITY_ENABLE=true"),
                "{ignored:?}"
            );
        }
        let (options, ignored) =
            read(&[("ROS_SECURITY_ENABLE", "true"), ("ROS_SECURITY_STRATEGY", "enforce")]);
        assert!(!options.unwrap().is_enforced);
        assert!(ignored[0].contains("ROS_SECURITY_STRATEGY=Enforce"), "{ignored:?}");
        let permissive = [("ROS_SECURITY_ENABLE", "true"), ("ROS_SECURITY_STRATEGY", "Permissive")];
        assert!(read(&permissive).1.is_empty());
    }

    #[test]
    fn the_folder_is_that_of_the_enclave_and_the_override_wins() {
        let variables = [
            ("ROS_SECURITY_ENABLE", "true"),
            ("ROS_SECURITY_STRATEGY", "Enforce"),
            ("ROS_SECURITY_KEYSTORE", "/keys"),
        ];
        let (options, _) = read(&variables);
        let mut options = options.unwrap();
        assert!(options.is_enforced);
        assert_eq!(options.folder().unwrap(), Path::new("/keys/enclaves/"));
        options.enclave = "/robots/one".to_owned();
        assert_eq!(options.folder().unwrap(), Path::new("/keys/enclaves/robots/one"));
        options.enclave_override = Some("/lab".to_owned());
        assert_eq!(options.folder().unwrap(), Path::new("/keys/enclaves/lab"));
        for wrong in ["", "lab", "/../lab", "/lab;", "/lab/", "//lab", "/1"] {
            options.enclave_override = Some(wrong.to_owned());
            assert!(options.folder().unwrap_err().to_string().contains("no name of an enclave"), "{wrong}");
        }
        options.keystore = None;
        assert!(options.folder().unwrap_err().to_string().contains("ROS_SECURITY_KEYSTORE"));
    }
}
