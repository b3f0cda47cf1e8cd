//! Types of files.

use std::fs::Metadata;

/// The type of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A regular file.
    Regular,
    /// A directory.
    Directory,
    /// A pipe with a name.
    Pipe,
    /// A socket.
    Socket,
    /// A device that is read byte by byte, such as a serial port.
    CharacterDevice,
    /// A disk or a part of one.
    BlockDevice,
    /// None of these; outside of Unix all that is neither a regular file nor a directory.
    Other,
}

impl FileKind {
    /// The type of the file with this metadata.
    #[must_use]
    pub fn of(metadata: &Metadata) -> Self {
        if metadata.is_file() {
            Self::Regular
        } else if metadata.is_dir() {
            Self::Directory
        } else {
            special(metadata)
        }
    }
}

impl std::fmt::Display for FileKind {
    /// With its article, for sentences.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Regular => "a regular file",
            Self::Directory => "a folder",
            Self::Pipe => "a pipe",
            Self::Socket => "a socket",
            Self::CharacterDevice => "a device",
            Self::BlockDevice => "a disk",
            Self::Other => "no regular file",
        })
    }
}

#[cfg(unix)]
fn special(metadata: &Metadata) -> FileKind {
    use std::os::unix::fs::FileTypeExt;
    let kind = metadata.file_type();
    if kind.is_fifo() {
        FileKind::Pipe
    } else if kind.is_socket() {
        FileKind::Socket
    } else if kind.is_char_device() {
        FileKind::CharacterDevice
    } else if kind.is_block_device() {
        FileKind::BlockDevice
    } else {
        FileKind::Other
    }
}

#[cfg(not(unix))]
fn special(_: &Metadata) -> FileKind {
    FileKind::Other
}

#[cfg(all(test, unix))]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::path::Path;

    #[test]
    fn each_type_of_file_is_known() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("file"), "").unwrap();
        let _socket = std::os::unix::net::UnixListener::bind(at("socket")).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(at("pipe")).status().unwrap().success());
        std::os::unix::fs::symlink(at("pipe"), at("link")).unwrap();
        let of = |path: &Path| FileKind::of(&path.metadata().unwrap()).to_string();
        assert_eq!(of(Path::new("/dev/null")), "a device");
        assert_eq!(of(folder.path()), "a folder");
        assert_eq!(
            ["file", "socket", "pipe", "link"].map(|name| of(&at(name))),
            ["a regular file", "a socket", "a pipe", "a pipe"]
        );
        let link = at("link").symlink_metadata().unwrap();
        assert_eq!(FileKind::of(&link), FileKind::Other);
    }
}
