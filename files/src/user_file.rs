//! Reads files that a user names, and replaces them: robot files, descriptions, charts, parameters and the
//! like.
//!
//! A pipe, a device or a socket in the place of a file would block the program or fill its memory, and so
//! would a file of many gigabytes. They are refused by kind and size before anything is read.

use std::ffi::OsString;
use std::fs::{self, File, Metadata};
use std::io::{self, Read, Write};
use std::path::Path;

use crate::FileKind;
use crate::lines::line_of;

/// The largest file that is read as a whole, in bytes.
pub const LARGEST: u64 = 64 * 1024 * 1024;

/// Opens a regular file, or a link to one.
///
/// # Errors
/// Returns an error if it is something else, or cannot be opened.
pub fn open(path: impl AsRef<Path>) -> io::Result<File> {
    let path = path.as_ref();
    // Before opening: opening a pipe waits for its writer.
    require_regular(&path.metadata()?)?;
    let file = File::open(path)?;
    // It may have been replaced.
    require_regular(&file.metadata()?)?;
    Ok(file)
}

/// Reads a regular file of at most [`LARGEST`] bytes.
///
/// # Errors
/// Returns an error if it is not a regular file, is larger, or cannot be read.
pub fn read(path: impl AsRef<Path>) -> io::Result<Vec<u8>> {
    read_within(path, LARGEST)
}

/// Reads a regular file of at most `most` bytes.
///
/// # Errors
/// Returns an error if it is not a regular file, is larger, or cannot be read.
pub fn read_within(path: impl AsRef<Path>, most: u64) -> io::Result<Vec<u8>> {
    let file = open(path)?;
    let too_large = |length: u64| {
        io::Error::new(io::ErrorKind::FileTooLarge, format!("it has {length} bytes; at most {most} are read"))
    };
    let length = file.metadata()?.len();
    if length > most {
        return Err(too_large(length));
    }
    let mut bytes = Vec::new();
    // Files of /proc say that they are empty, and others grow.
    file.take(most.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        return Err(too_large(bytes.len() as u64));
    }
    Ok(bytes)
}

/// Reads a regular file of at most [`LARGEST`] bytes as UTF-8.
///
/// # Errors
/// Returns an error if it is not a regular file, is larger, is not UTF-8, or cannot be read.
pub fn read_text(path: impl AsRef<Path>) -> io::Result<String> {
    read_text_within(path, LARGEST)
}

/// Reads a regular file of at most `most` bytes as UTF-8.
///
/// # Errors
/// Returns an error if it is not a regular file, is larger, is not UTF-8, or cannot be read.
pub fn read_text_within(path: impl AsRef<Path>, most: u64) -> io::Result<String> {
    String::from_utf8(read_within(path, most)?).map_err(|error| {
        let line = line_of(error.as_bytes(), error.utf8_error().valid_up_to());
        io::Error::new(io::ErrorKind::InvalidData, format!("it is not UTF-8 text, from line {line} on"))
    })
}

/// Puts a new file in the place of another, which keeps its permissions. Whatever happens, the old one or the
/// new one is there as a whole.
///
/// # Errors
/// Returns an error if the new file cannot be written or put there. The old one is then as it was.
pub fn replace(path: impl AsRef<Path>, text: &str) -> io::Result<()> {
    let path = path.as_ref();
    let mut name = OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    name.push(format!(".{}.new", std::process::id()));
    let new = path.with_file_name(name);
    let written = (|| {
        let mut file = File::create(&new)?;
        file.write_all(text.as_bytes())?;
        if let Ok(metadata) = fs::metadata(path) {
            file.set_permissions(metadata.permissions())?;
        }
        file.sync_all()?;
        fs::rename(&new, path)
    })();
    if written.is_err() {
        let _ = fs::remove_file(&new);
    }
    written
}

fn require_regular(metadata: &Metadata) -> io::Result<()> {
    let (kind, name) = match FileKind::of(metadata) {
        FileKind::Regular => return Ok(()),
        FileKind::Directory => (io::ErrorKind::IsADirectory, "a directory"),
        FileKind::Pipe => (io::ErrorKind::InvalidInput, "a pipe"),
        FileKind::Socket => (io::ErrorKind::InvalidInput, "a socket"),
        FileKind::CharacterDevice | FileKind::BlockDevice => (io::ErrorKind::InvalidInput, "a device"),
        FileKind::Other => (io::ErrorKind::InvalidInput, "something else"),
    };
    Err(io::Error::new(kind, format!("it is {name}, and only regular files are read")))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[cfg(unix)]
    #[test]
    fn only_regular_files_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let fifo = folder.path().join("fifo");
        assert!(std::process::Command::new("mkfifo").arg(&fifo).status().unwrap().success());
        let socket = folder.path().join("socket");
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        let link = folder.path().join("link");
        std::os::unix::fs::symlink("/dev/zero", &link).unwrap();
        let found = [
            (fifo.as_path(), "a pipe"),
            (&socket, "a socket"),
            (&link, "a device"),
            (Path::new("/dev/zero"), "a device"),
            (Path::new("/dev/random"), "a device"),
            (folder.path(), "a directory"),
        ];
        for (path, kind) in found {
            let error = read_text(path).unwrap_err().to_string();
            assert_eq!(error, format!("it is {kind}, and only regular files are read"), "{}", path.display());
        }
    }

    #[test]
    fn the_size_and_the_text_are_checked() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("it has 1099511627776 bytes"));
        std::fs::write(&path, b"one\ntwo\xff").unwrap();
        assert!(read_text(&path).unwrap_err().to_string().contains("not UTF-8 text, from line 2 on"));
        std::fs::write(&path, "grün").unwrap();
        assert_eq!(read_text(&path).unwrap(), "grün");
        assert_eq!(read_within(&path, 5).unwrap(), "grün".as_bytes());
        assert!(read_within(&path, 4).is_err());
    }
}
