//! What the kernel offers in C for devices of its classes: cameras, input devices, CAN sockets, lines of a
//! GPIO chip, I²C buses.
//!
//! Structures are arrays of bytes here, so that only requests and mapped memory need `unsafe`, in `linux.rs`
//! and `i2c.rs`. Their layouts and numbers are those of 64-bit Linux; tests compare them with the headers of
//! Linux 6.1 (`linux/videodev2.h`, `input.h`, `can.h`, `gpio.h`).

#[cfg_attr(not(all(target_os = "linux", target_pointer_width = "64")), path = "elsewhere.rs")]
mod linux;

pub(crate) mod i2c;

use std::fs::File;
use std::io;
use std::path::Path;

use downbeat_files::FileKind;

pub(crate) use linux::*;

/// Opens a device file for reading and writing, or for reading only, without waiting for the device.
///
/// # Errors
/// A sentence with what is wrong and what to do. `what` names the device (a camera), `group` the group whose
/// members may use it.
pub(crate) fn open_device(path: &Path, is_written: bool, what: &str, group: &str) -> Result<File, String> {
    check_supported().map_err(|error| error.to_string())?;
    let at = path.display();
    let failed = |error: io::Error| match error.kind() {
        io::ErrorKind::NotFound => format!("there is no {at}; is the {what} plugged in?"),
        io::ErrorKind::PermissionDenied => format!(
            "no permission to use {at}: add the user to the group {group} (sudo usermod -aG {group} $USER) and log in again"
        ),
        io::ErrorKind::ResourceBusy => format!("{at} is in use by another program; end that one"),
        _ => format!("opening {at}: {error}"),
    };
    let found = std::fs::metadata(path).map_err(failed)?;
    if FileKind::of(&found) != FileKind::CharacterDevice {
        return Err(format!("{at} is {}, not the device file of a {what}", FileKind::of(&found)));
    }
    open_without_waiting(path, is_written).map_err(failed)
}

/// Whether the name of a device that nothing has is the path of a file, from the working directory.
pub(crate) fn is_file(name: &str) -> bool {
    !name.is_empty() && Path::new(name).exists()
}

/// The last part of a path, or a whole name: what recordings and diagnostics hold of a device, so that a run
/// replays from any folder.
pub(crate) fn name_of(device: &str) -> &str {
    device.trim_end_matches('/').rsplit('/').next().unwrap_or(device)
}

/// The number at an offset of a structure; 0 beyond its end.
pub(crate) fn u32_at(bytes: &[u8], offset: usize) -> u32 {
    let four = bytes.get(offset..).and_then(|rest| rest.first_chunk());
    u32::from_ne_bytes(four.copied().unwrap_or_default())
}

/// Likewise.
pub(crate) fn i32_at(bytes: &[u8], offset: usize) -> i32 {
    u32_at(bytes, offset).cast_signed()
}

/// Likewise.
pub(crate) fn u64_at(bytes: &[u8], offset: usize) -> u64 {
    let eight = bytes.get(offset..).and_then(|rest| rest.first_chunk());
    u64::from_ne_bytes(eight.copied().unwrap_or_default())
}

/// The text at an offset, up to its end mark.
pub(crate) fn text_at(bytes: &[u8], offset: usize, length: usize) -> String {
    let field = bytes.get(offset..).unwrap_or_default();
    let field = field.get(..length).unwrap_or(field);
    let text = field.split(|byte| *byte == 0).next().unwrap_or_default();
    String::from_utf8_lossy(text).into_owned()
}

/// Writes into a structure; what would be beyond its end is left out.
pub(crate) fn put(bytes: &mut [u8], offset: usize, value: &[u8]) {
    for (to, from) in bytes.iter_mut().skip(offset).zip(value) {
        *to = *from;
    }
}

/// Writes a number into a structure.
pub(crate) fn put_u32(bytes: &mut [u8], offset: usize, value: u32) {
    put(bytes, offset, &value.to_ne_bytes());
}

/// Likewise.
pub(crate) fn put_u64(bytes: &mut [u8], offset: usize, value: u64) {
    put(bytes, offset, &value.to_ne_bytes());
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// `printf("%x", VIDIOC_QUERYCAP)` and so on, compiled with the headers of Linux 6.1 on x86-64.
    #[cfg(all(target_os = "linux", any(target_arch = "x86_64", target_arch = "aarch64")))]
    #[test]
    fn requests_have_the_numbers_of_the_headers() {
        let numbers = [
            (video::QUERYCAP.number(), 0x8068_5600),
            (video::ENUM_FMT.number(), 0xc040_5602),
            (video::S_FMT.number(), 0xc0d0_5605),
            (video::REQBUFS.number(), 0xc014_5608),
            (video::S_PARM.number(), 0xc0cc_5616),
            (video::STREAMON.number(), 0x4004_5612),
            (video::S_CTRL.number(), 0xc008_561c),
            (video::QUERYCTRL.number(), 0xc044_5624),
            (input::NAME.number(), 0x8100_4506),
            (input::PRESSED.number(), 0x8060_4518),
            (input::KEYS.number(), 0x8060_4521),
            (input::AXES.number(), 0x8008_4523),
            (input::axis(0).number(), 0x8018_4540),
            (input::axis(17).number(), 0x8018_4551),
            (gpio::CHIP_INFO.number(), 0x8044_b401),
            (gpio::LINE_INFO.number(), 0xc100_b405),
            (gpio::line_number(), 0xc250_b407),
            (gpio::GET_VALUES.number(), 0xc010_b40e),
            (gpio::SET_VALUES.number(), 0xc010_b40f),
            (BufferRequest::Query.number(), 0xc058_5609),
            (BufferRequest::Queue.number(), 0xc058_560f),
            (BufferRequest::Dequeue.number(), 0xc058_5611),
        ];
        for (number, expected) in numbers {
            assert_eq!(number, expected, "{expected:#x}");
        }
    }

    #[test]
    fn what_is_no_device_is_told_with_the_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("video0");
        let refusal = |path: &Path| open_device(path, true, "camera", "video").unwrap_err();
        assert!(refusal(&file).contains("is the camera plugged in?"), "{}", refusal(&file));
        std::fs::write(&file, "").unwrap();
        assert!(refusal(&file).ends_with("video0 is a regular file, not the device file of a camera"));
        assert!(refusal(folder.path()).contains(" is a folder, "));
        assert!(open_device(Path::new("/dev/null"), true, "camera", "video").is_ok());
    }

    #[test]
    fn a_device_has_the_same_name_in_each_folder() {
        assert_eq!(
            ["/dev/video0", "/home/a/pins/", "HD Webcam", ""].map(name_of),
            ["video0", "pins", "HD Webcam", ""]
        );
    }

    #[test]
    fn structures_are_read_and_written_within_their_bounds() {
        let mut bytes = [0; 10];
        put_u32(&mut bytes, 8, 0x0403_0201);
        put_u64(&mut bytes, 0, u64::MAX);
        put(&mut bytes, 30, b"beyond");
        assert_eq!((u32_at(&bytes, 8), u32_at(&bytes, 400), u64_at(&bytes, 0)), (0, 0, u64::MAX));
        assert_eq!(text_at(b"\x01a name\0rest", 1, 32), "a name");
        assert_eq!(text_at(b"a name", 2, 2), "na");
        assert_eq!(text_at(b"a name", 20, 2), "");
    }
}
