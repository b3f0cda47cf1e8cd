//! Requests to I²C buses, on Linux of any size.

use std::fs::File;
use std::io;

/// Directs reads and writes of a bus to the chip at this address.
#[cfg(target_os = "linux")]
#[expect(unsafe_code, reason = "an ioctl that rustix does not have")]
pub(crate) fn select(bus: &File, address: u8) -> io::Result<()> {
    /// `I2C_SLAVE` of linux/i2c-dev.h.
    const SELECT: rustix::ioctl::Opcode = 0x0703;
    // SAFETY: `I2C_SLAVE` takes an integer and accesses no memory of this process.
    unsafe {
        let request = rustix::ioctl::IntegerSetter::<SELECT>::new_usize(address.into());
        rustix::ioctl::ioctl(bus, request)?;
    }
    Ok(())
}

/// Whether there are buses on this system.
#[cfg(target_os = "linux")]
pub(crate) fn check_supported() -> io::Result<()> {
    Ok(())
}

#[cfg(not(target_os = "linux"))]
pub(crate) fn select(_bus: &File, _address: u8) -> io::Result<()> {
    check_supported()
}

#[cfg(not(target_os = "linux"))]
pub(crate) fn check_supported() -> io::Result<()> {
    let reason =
        "I²C buses of this machine are supported on Linux only; on other systems use an emulated one";
    Err(io::Error::new(io::ErrorKind::Unsupported, reason))
}
