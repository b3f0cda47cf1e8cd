//! What stands behind a path.

use std::fs::Metadata;

/// What stands behind a path, after its links.
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
    /// The kind that the metadata of a file tell.
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
