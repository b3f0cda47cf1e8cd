//! The same names where there are no Unix sockets: the directory cannot be opened, so that there is neither a
//! listener nor a stream.

use std::convert::Infallible;
use std::io::{self, Read, Write};
use std::net::Shutdown;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::error::DirectoryError;

pub(super) fn default_directory() -> PathBuf {
    std::env::temp_dir().join("downbeat")
}

pub(super) fn create_private(_path: &Path) -> Result<(), DirectoryError> {
    Err(DirectoryError::Unsupported)
}

pub(super) fn is_alive(_pid: u32) -> bool {
    false
}

pub(super) struct UnixListener(Infallible);

impl UnixListener {
    pub(super) fn bind(_path: &Path) -> io::Result<Self> {
        Err(io::ErrorKind::Unsupported.into())
    }

    pub(super) fn accept(&self) -> io::Result<(UnixStream, Infallible)> {
        match self.0 {}
    }
}

pub(super) struct UnixStream(Infallible);

impl UnixStream {
    pub(super) fn connect(_path: &Path) -> io::Result<Self> {
        Err(io::ErrorKind::Unsupported.into())
    }

    pub(super) fn set_read_timeout(&self, _timeout: Option<Duration>) -> io::Result<()> {
        match self.0 {}
    }

    pub(super) fn set_write_timeout(&self, _timeout: Option<Duration>) -> io::Result<()> {
        match self.0 {}
    }

    pub(super) fn try_clone(&self) -> io::Result<Self> {
        match self.0 {}
    }

    pub(super) fn shutdown(&self, _how: Shutdown) -> io::Result<()> {
        match self.0 {}
    }
}

impl Read for &UnixStream {
    fn read(&mut self, _buffer: &mut [u8]) -> io::Result<usize> {
        match self.0 {}
    }
}

impl Write for &UnixStream {
    fn write(&mut self, _bytes: &[u8]) -> io::Result<usize> {
        match self.0 {}
    }

    fn flush(&mut self) -> io::Result<()> {
        match self.0 {}
    }
}

impl Read for UnixStream {
    fn read(&mut self, _buffer: &mut [u8]) -> io::Result<usize> {
        match self.0 {}
    }
}

impl Write for UnixStream {
    fn write(&mut self, _bytes: &[u8]) -> io::Result<usize> {
        match self.0 {}
    }

    fn flush(&mut self) -> io::Result<()> {
        match self.0 {}
    }
}
