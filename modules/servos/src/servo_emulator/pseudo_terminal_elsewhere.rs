//! The same names where there are no pseudo terminals: emulators work in memory.

use super::error::EmulatorError;
use std::convert::Infallible;
use std::io;
use std::path::Path;
use std::time::Duration;

/// A pseudo terminal, of which there are none.
pub struct PseudoTerminal(Infallible);

impl PseudoTerminal {
    /// Opens a terminal, and creates the link to it.
    ///
    /// # Errors
    /// Always.
    pub fn open(_link: Option<&Path>) -> Result<Self, EmulatorError> {
        Err(EmulatorError::Unsupported)
    }

    /// The device file for the peer.
    #[must_use]
    pub fn path(&self) -> &Path {
        match self.0 {}
    }

    /// The next bytes, or none after `timeout`; and the speed that the peer has set, if it is known.
    ///
    /// # Errors
    /// None, since there is no terminal.
    pub fn receive<'a>(&mut self, _: &'a mut [u8], _: Duration) -> io::Result<(&'a [u8], Option<u32>)> {
        match self.0 {}
    }

    /// Sends bytes to the peer.
    ///
    /// # Errors
    /// None, since there is no terminal.
    pub fn send(&mut self, _: &[u8]) -> io::Result<()> {
        match self.0 {}
    }
}

/// Removes the links of all emulators of this process, of which there are none.
pub fn remove_links() {}
