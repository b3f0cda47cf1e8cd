//! For use in modules: why a serial port cannot be opened, and what to do.

use downbeat_files::FileKind;
use std::fs;
use std::io::{self, ErrorKind};

/// Checks that a path is that of a device, before it is opened as a serial port.
///
/// # Errors
/// A sentence with what the path is, and what to do.
pub fn check_port(path: &str) -> Result<(), String> {
    if path.is_empty() {
        return Err(
            "no serial port is given: name one, such as /dev/ttyUSB0 (ls /dev/serial/by-id)".to_owned()
        );
    }
    if cfg!(windows) {
        // Ports there have names, such as COM3, and no files.
        return Ok(());
    }
    let metadata = fs::metadata(path).map_err(|error| port_refusal(path, &error))?;
    match FileKind::of(&metadata) {
        FileKind::CharacterDevice => Ok(()),
        what => Err(format!("{path} is {what}, not a serial port: name a device, such as /dev/ttyUSB0")),
    }
}

/// A sentence that says why a serial port could not be opened, and what to do.
#[must_use]
pub fn port_refusal(path: &str, error: &io::Error) -> String {
    match error.kind() {
        ErrorKind::NotFound => {
            format!("{path} does not exist: plug the device in, or name another (ls /dev/serial/by-id)")
        }
        ErrorKind::PermissionDenied => format!(
            "no permission to open {path}: add the user to the group dialout (sudo usermod -aG dialout $USER) and log in again"
        ),
        _ if is_no_terminal(error) => {
            format!("{path} is a device, but not a serial port: name one, such as /dev/ttyUSB0")
        }
        _ => format!("opening the serial port {path}: {error}; does another program use it?"),
    }
}

/// ENOTTY: a device that is no line to other devices. The crate of serial ports keeps only these words of it.
fn is_no_terminal(error: &io::Error) -> bool {
    error.raw_os_error() == Some(25) || error.to_string().contains("Not a typewriter")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_port_is_named_with_the_remedy() {
        let why = |path: &str| check_port(path).err().unwrap_or_default();
        assert_eq!(
            why("Cargo.toml"),
            "Cargo.toml is a regular file, not a serial port: name a device, such as /dev/ttyUSB0"
        );
        assert!(why("src").starts_with("src is a folder, not a serial port"));
        assert!(
            why("/dev/nothing")
                .starts_with("/dev/nothing does not exist: plug the device in, or name another")
        );
        assert!(why("").starts_with("no serial port is given"));
        assert_eq!(why("/dev/null"), "");
    }

    #[test]
    fn what_the_operating_system_refuses_is_explained() {
        let why = |error: io::Error| port_refusal("/dev/ttyUSB0", &error);
        assert!(why(ErrorKind::PermissionDenied.into()).contains("usermod -aG dialout $USER"));
        for error in [io::Error::other("Not a typewriter"), io::Error::from_raw_os_error(25)] {
            assert!(why(error).starts_with("/dev/ttyUSB0 is a device, but not a serial port"));
        }
        assert!(why(ErrorKind::ResourceBusy.into()).ends_with("does another program use it?"));
    }
}
