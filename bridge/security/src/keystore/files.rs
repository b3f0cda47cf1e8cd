//! The files and links of a keystore.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

use zeroize::Zeroizing;

use super::KeystoreError;
use crate::pki::{Certificate, PkiError, PrivateKey};

pub(super) fn make_folder(path: &Path) -> Result<(), KeystoreError> {
    fs::create_dir_all(path).map_err(failed("create", path))
}

/// Writes a file that must not be there yet.
pub(super) fn write_new(path: &Path, content: &[u8]) -> Result<(), KeystoreError> {
    write_with(File::options().write(true).create_new(true), path, content)
}

/// Writes a key that only this user can read.
pub(super) fn write_key(path: &Path, key: &PrivateKey) -> Result<(), KeystoreError> {
    let mut options = File::options();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    write_with(&options, path, key.to_pem().as_bytes())
}

/// Writes a file, or replaces it: whoever reads it at the same time sees all of the old or of the new one.
pub(super) fn write(path: &Path, content: &[u8]) -> Result<(), KeystoreError> {
    let new = path.with_extension("new");
    write_with(File::options().write(true).create(true).truncate(true), &new, content)?;
    fs::rename(&new, path).map_err(failed("write", path))
}

fn write_with(options: &OpenOptions, path: &Path, content: &[u8]) -> Result<(), KeystoreError> {
    options.open(path).and_then(|mut file| file.write_all(content)).map_err(failed("write", path))
}

/// Makes a link to a file, relative to the folder of the link; an existing file stays.
pub(super) fn link(path: &Path, target: &Path) -> Result<(), KeystoreError> {
    if path.exists() {
        return Ok(());
    }
    #[cfg(unix)]
    let linked = std::os::unix::fs::symlink(target, path);
    #[cfg(not(unix))]
    let linked = fs::copy(path.with_file_name(target), path).map(|_| ());
    linked.map_err(failed("link", path))
}

pub(super) fn read_text(path: &Path) -> Result<Vec<u8>, KeystoreError> {
    fs::read(path).map_err(failed("read", path))
}

pub(super) fn read_certificate(path: &Path) -> Result<Certificate, KeystoreError> {
    read(path, Certificate::from_pem)
}

pub(super) fn read_key(path: &Path) -> Result<PrivateKey, KeystoreError> {
    read(path, PrivateKey::from_pem)
}

fn read<T>(path: &Path, parse: impl FnOnce(&[u8]) -> Result<T, PkiError>) -> Result<T, KeystoreError> {
    let bytes = Zeroizing::new(fs::read(path).map_err(failed("read", path))?);
    parse(&bytes).map_err(|source| KeystoreError::Pki { path: path.to_owned(), source })
}

/// Adds the names of the enclaves in a folder, whose own name is `name`. Links are not followed.
pub(super) fn find_enclaves(folder: &Path, name: &str, names: &mut Vec<String>) -> Result<(), KeystoreError> {
    if folder.join("key.pem").exists() {
        names.push(if name.is_empty() { "/".to_owned() } else { name.to_owned() });
    }
    let entries = fs::read_dir(folder).map_err(failed("read", folder))?;
    for entry in entries {
        let entry = entry.map_err(failed("read", folder))?;
        if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            let name = format!("{name}/{}", entry.file_name().to_string_lossy());
            find_enclaves(&entry.path(), &name, names)?;
        }
    }
    Ok(())
}

fn failed(attempt: &'static str, path: &Path) -> impl FnOnce(io::Error) -> KeystoreError {
    let path = path.to_owned();
    move |source| KeystoreError::File { attempt, path, source }
}
