//! The port of the emulator.

use super::error::EmulatorError;
use parking_lot::Mutex;
use serialport::{SerialPort, TTYPort};
use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Read, Write};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How long the operating system may take to accept bytes; if they are not read, they are lost, as on a wire.
const WRITE_TIMEOUT: Duration = Duration::from_millis(20);

/// A pseudo terminal, and the link to it. Both are removed when it is dropped.
pub struct PseudoTerminal {
    ours: TTYPort,
    // Kept open: without a peer, reading would fail instead of wait.
    _theirs: TTYPort,
    path: PathBuf,
    link: Option<PathBuf>,
}

impl PseudoTerminal {
    /// Opens a terminal, and creates the link to it.
    ///
    /// # Errors
    /// If no terminal is available, or the path of the link is in use.
    pub fn open(link: Option<&Path>) -> Result<Self, EmulatorError> {
        let pair = |error: serialport::Error| EmulatorError::PseudoTerminal { source: error.into() };
        let (ours, theirs) = TTYPort::pair().map_err(pair)?;
        let path = theirs.name().map(PathBuf::from).unwrap_or_default();
        if let Some(link) = link {
            make_link(&path, link)?;
        }
        if let Some(link) = link {
            LINKS.lock().insert(link.to_owned(), path.clone());
        }
        Ok(Self { ours, _theirs: theirs, path, link: link.map(Path::to_owned) })
    }

    /// The device file for the peer.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The next bytes, or none after `timeout`; and the speed that the peer has set, if it is known.
    ///
    /// # Errors
    /// If the terminal is broken.
    pub fn receive<'a>(
        &mut self,
        buffer: &'a mut [u8],
        timeout: Duration,
    ) -> io::Result<(&'a [u8], Option<u32>)> {
        self.ours.set_timeout(timeout)?;
        match self.ours.read(buffer) {
            // Both ends have the same settings.
            Ok(count) => Ok((&buffer[..count], self.ours.baud_rate().ok())),
            Err(error) if matches!(error.kind(), io::ErrorKind::TimedOut | io::ErrorKind::Interrupted) => {
                Ok((&[], None))
            }
            Err(error) => Err(error),
        }
    }

    /// Sends bytes to the peer. They are lost if it does not read them.
    ///
    /// # Errors
    /// If the terminal is broken.
    pub fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.ours.set_timeout(WRITE_TIMEOUT)?;
        match self.ours.write_all(bytes) {
            Err(error) if error.kind() == io::ErrorKind::TimedOut => Ok(()),
            sent => sent,
        }
    }
}

impl Drop for PseudoTerminal {
    fn drop(&mut self) {
        let Some(link) = &self.link else { return };
        let mut links = LINKS.lock();
        if links.get(link) == Some(&self.path) {
            links.remove(link);
        }
        remove_link(link, &self.path);
    }
}

/// The links of this process and their terminals.
static LINKS: Mutex<BTreeMap<PathBuf, PathBuf>> = Mutex::new(BTreeMap::new());

/// Removes the links of all emulators of this process, for a process that is about to end without dropping
/// them.
pub fn remove_links() {
    LINKS.lock().iter().for_each(|(link, path)| remove_link(link, path));
}

fn remove_link(link: &Path, path: &Path) {
    // Another emulator may have replaced the link.
    if fs::read_link(link).is_ok_and(|target| target == path) {
        // If it cannot be removed, it is dangling, and opening it reports that.
        let _ = fs::remove_file(link);
    }
}

/// The directory of pseudo terminals.
const TERMINALS: &str = "/dev/pts";

/// The same directory, in the spelling that only emulators use for their links: links of other programs are
/// not removed.
const OWN_TERMINALS: &str = "/dev/./pts";

/// Creates a link. Replaces one left by a killed emulator: a link of an emulator to a pseudo terminal that no
/// longer exists, or whose number is now that of `target`. Other links are not touched.
fn make_link(target: &Path, link: &Path) -> Result<(), EmulatorError> {
    let failed = |source| EmulatorError::Link { link: link.to_owned(), source };
    if let Ok(old) = fs::read_link(link) {
        let is_own = old.as_os_str().as_bytes().starts_with(OWN_TERMINALS.as_bytes());
        if !is_own || old.parent() != Some(Path::new(TERMINALS)) {
            return Err(EmulatorError::OtherLink { link: link.to_owned(), target: old });
        }
        if old != target && old.exists() {
            return Err(EmulatorError::LinkInUse { link: link.to_owned(), target: old });
        }
        fs::remove_file(link).map_err(failed)?;
    }
    let own = target.strip_prefix(TERMINALS).map(|name| Path::new(OWN_TERMINALS).join(name));
    symlink(own.as_deref().unwrap_or(target), link).map_err(failed)
}
