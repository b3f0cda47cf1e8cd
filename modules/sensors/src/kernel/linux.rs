//! Requests to device files and mapped memory, on 64-bit Linux.
#![allow(unsafe_code)]

use std::ffi::c_void;
use std::fs::File;
use std::io;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::path::Path;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags};
use rustix::fs::{Mode, OFlags};
use rustix::ioctl::{Ioctl, IoctlOutput, Opcode, opcode};
use rustix::mm::{MapFlags, ProtFlags};
use rustix::time::{ClockId, clock_gettime};

use super::put_u32;

/// A request whose argument is a structure of that many bytes. Only this file makes them, because the safety
/// of [`request`] depends on their numbers.
#[derive(Clone, Copy)]
pub(crate) struct Request<const LENGTH: usize>(Opcode);

impl<const LENGTH: usize> Request<LENGTH> {
    const fn read(group: u8, number: u8) -> Self {
        Self(opcode::read::<[u8; LENGTH]>(group, number))
    }

    const fn write(group: u8, number: u8) -> Self {
        Self(opcode::write::<[u8; LENGTH]>(group, number))
    }

    const fn exchange(group: u8, number: u8) -> Self {
        Self(opcode::read_write::<[u8; LENGTH]>(group, number))
    }

    /// The number, as `ioctl` has it.
    #[cfg(test)]
    pub(crate) fn number(self) -> u32 {
        self.0
    }
}

/// Of `linux/videodev2.h`. Types of buffers other than that of capture are not used: their formats have
/// pointers.
pub(crate) mod video {
    use super::Request;

    pub(crate) const QUERYCAP: Request<104> = Request::read(b'V', 0);
    pub(crate) const ENUM_FMT: Request<64> = Request::exchange(b'V', 2);
    pub(crate) const S_FMT: Request<208> = Request::exchange(b'V', 5);
    pub(crate) const REQBUFS: Request<20> = Request::exchange(b'V', 8);
    pub(crate) const STREAMON: Request<4> = Request::write(b'V', 18);
    pub(crate) const S_PARM: Request<204> = Request::exchange(b'V', 22);
    pub(crate) const S_CTRL: Request<8> = Request::exchange(b'V', 28);
    pub(crate) const QUERYCTRL: Request<68> = Request::exchange(b'V', 36);
}

/// Of `linux/input.h`.
pub(crate) mod input {
    use super::Request;

    pub(crate) const NAME: Request<256> = Request::read(b'E', 0x06);
    /// Which keys and buttons are pressed, a bit for each.
    pub(crate) const PRESSED: Request<96> = Request::read(b'E', 0x18);
    /// Which keys and buttons there are.
    pub(crate) const KEYS: Request<96> = Request::read(b'E', 0x21);
    /// Which axes there are.
    pub(crate) const AXES: Request<8> = Request::read(b'E', 0x23);

    /// Range and value of an axis. There are 64.
    pub(crate) const fn axis(code: u8) -> Request<24> {
        Request::read(b'E', 0x40 + (code & 0x3f))
    }
}

/// Of `linux/gpio.h`, version 2.
pub(crate) mod gpio {
    use std::fs::File;
    use std::io;
    use std::os::fd::{FromRawFd, OwnedFd};

    use super::{Request, request};
    use crate::kernel::i32_at;

    pub(crate) const CHIP_INFO: Request<68> = Request::read(0xb4, 1);
    pub(crate) const LINE_INFO: Request<256> = Request::exchange(0xb4, 5);
    const LINE: Request<592> = Request::exchange(0xb4, 7);
    pub(crate) const GET_VALUES: Request<16> = Request::exchange(0xb4, 14);
    pub(crate) const SET_VALUES: Request<16> = Request::exchange(0xb4, 15);

    /// Requests lines, by a `gpio_v2_line_request`: the file through which they are used.
    pub(crate) fn request_line(chip: &File, bytes: &mut [u8; 592]) -> io::Result<File> {
        super::put_u32(bytes, 588, u32::MAX);
        request(chip, LINE, bytes)?;
        let descriptor = i32_at(bytes, 588);
        if descriptor < 0 {
            return Err(io::Error::other("the kernel gave no file for the line"));
        }
        // SAFETY: the kernel has opened the descriptor for this request, so it belongs to nobody else.
        Ok(unsafe { OwnedFd::from_raw_fd(descriptor) }.into())
    }

    /// The number of the request for lines, as `ioctl` has it.
    #[cfg(test)]
    pub(crate) fn line_number() -> u32 {
        LINE.number()
    }
}

/// Sends a request to a device and receives its answer in the same bytes.
pub(crate) fn request<const LENGTH: usize>(
    device: &File,
    request: Request<LENGTH>,
    bytes: &mut [u8; LENGTH],
) -> io::Result<()> {
    // SAFETY: `Argument` points to as many bytes as the request's number says that the device reads and
    // writes, and no structure of the requests of this file has a pointer that a device follows.
    Ok(unsafe { rustix::ioctl::ioctl(device, Argument { opcode: request.0, bytes }) }?)
}

struct Argument<'a, const LENGTH: usize> {
    opcode: Opcode,
    bytes: &'a mut [u8; LENGTH],
}

// SAFETY: the output is not derived from the pointer, and the pointer is valid for `LENGTH` bytes, the size
// in the opcode.
unsafe impl<const LENGTH: usize> Ioctl for Argument<'_, LENGTH> {
    type Output = ();

    const IS_MUTATING: bool = true;

    fn opcode(&self) -> Opcode {
        self.opcode
    }

    fn as_ptr(&mut self) -> *mut c_void {
        self.bytes.as_mut_ptr().cast()
    }

    unsafe fn output_from_ptr(_: IoctlOutput, _: *mut c_void) -> rustix::io::Result<()> {
        Ok(())
    }
}

/// A request about one of the buffers of a video device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BufferRequest {
    /// Where it is.
    Query,
    /// Give the buffer to the driver, which fills it.
    Queue,
    /// Take the next buffer that the driver has filled.
    Dequeue,
}

impl BufferRequest {
    const fn request(self) -> Request<88> {
        Request::exchange(
            b'V',
            match self {
                Self::Query => 9,
                Self::Queue => 15,
                Self::Dequeue => 17,
            },
        )
    }

    /// The number, as `ioctl` has it.
    #[cfg(test)]
    pub(crate) fn number(self) -> u32 {
        self.request().number()
    }
}

/// `V4L2_BUF_TYPE_VIDEO_CAPTURE`.
pub(crate) const CAPTURE: u32 = 1;
/// `V4L2_MEMORY_MMAP`.
pub(crate) const MAPPED: u32 = 1;

/// Sends a request about a buffer for capture in mapped memory, so that the structure, a `v4l2_buffer`, has
/// no pointer.
pub(crate) fn buffer(device: &File, about: BufferRequest, index: u32) -> io::Result<[u8; 88]> {
    let mut bytes = [0; 88];
    put_u32(&mut bytes, 0, index);
    put_u32(&mut bytes, 4, CAPTURE);
    put_u32(&mut bytes, 60, MAPPED);
    request(device, about.request(), &mut bytes)?;
    Ok(bytes)
}

/// Memory that a device fills.
pub(crate) struct Mapping {
    start: *mut c_void,
    length: usize,
}

// SAFETY: the memory belongs to the process, not to a thread.
unsafe impl Send for Mapping {}

impl Mapping {
    /// Maps memory of a device for reading.
    pub(crate) fn new(device: &File, length: usize, offset: u64) -> io::Result<Self> {
        // SAFETY: the kernel chooses the place, so no memory of the process is replaced.
        let start = unsafe {
            rustix::mm::mmap(std::ptr::null_mut(), length, ProtFlags::READ, MapFlags::SHARED, device, offset)
        }?;
        Ok(Self { start, length })
    }

    /// Copies the first bytes, at most as many as there are.
    pub(crate) fn copy(&self, length: usize) -> Vec<u8> {
        let length = length.min(self.length);
        let mut copy = Vec::<u8>::with_capacity(length);
        // SAFETY: the mapping is readable for `length` bytes, and the new vector has room for them. No
        // reference to the mapping is made, as the device may write to it.
        unsafe {
            std::ptr::copy_nonoverlapping(self.start.cast::<u8>(), copy.as_mut_ptr(), length);
            copy.set_len(length);
        }
        copy
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: this is the mapping of `new`, to which there is no reference. It cannot fail for a mapping
        // that exists.
        let _ = unsafe { rustix::mm::munmap(self.start, self.length) };
    }
}

/// Opens a file for reading, and for writing if that is asked for; reads and writes then never wait.
pub(crate) fn open_without_waiting(path: &Path, is_written: bool) -> io::Result<File> {
    let access = if is_written { OFlags::RDWR } else { OFlags::RDONLY };
    let opened = rustix::fs::open(path, access | OFlags::NONBLOCK | OFlags::CLOEXEC, Mode::empty())?;
    Ok(opened.into())
}

/// Waits until there is something to read, or an error, for that long at most.
pub(crate) fn wait(device: &File, most: Duration) -> io::Result<bool> {
    wait_for_any(&[device], most)
}

/// The same for any of several devices.
pub(crate) fn wait_for_any(devices: &[&File], most: Duration) -> io::Result<bool> {
    let timeout = rustix::time::Timespec::try_from(most).map_err(io::Error::other)?;
    let mut all: Vec<_> = devices.iter().map(|device| PollFd::new(*device, PollFlags::IN)).collect();
    match rustix::event::poll(&mut all, Some(&timeout)) {
        Ok(count) => Ok(count > 0),
        Err(rustix::io::Errno::INTR) => Ok(false),
        Err(error) => Err(error.into()),
    }
}

/// How long ago a time of the clock `CLOCK_MONOTONIC` was; `None` if that is in the future.
pub(crate) fn age(seconds: u64, nanoseconds: u64) -> Option<Duration> {
    let now = clock_gettime(ClockId::Monotonic);
    let now = Duration::new(now.tv_sec.try_into().ok()?, now.tv_nsec.try_into().ok()?);
    now.checked_sub(Duration::from_secs(seconds).checked_add(Duration::from_nanos(nanoseconds))?)
}

/// Whether an error says that the device is not there any more: `ENODEV`, or `ENXIO`.
pub(crate) fn is_gone(error: &io::Error) -> bool {
    let gone = [rustix::io::Errno::NODEV, rustix::io::Errno::NXIO];
    gone.iter().any(|errno| error.raw_os_error() == Some(errno.raw_os_error()))
}

/// Whether an error says that a file is no device of the kind that the request is for: `ENOTTY`.
pub(crate) fn is_foreign(error: &io::Error) -> bool {
    error.raw_os_error() == Some(rustix::io::Errno::NOTTY.raw_os_error())
}

/// Whether devices can be opened on this system.
pub(crate) fn check_supported() -> io::Result<()> {
    Ok(())
}

/// Whether an error says that a queue of a driver is full: `ENOBUFS`.
pub(crate) fn is_full(error: &io::Error) -> bool {
    error.raw_os_error() == Some(rustix::io::Errno::NOBUFS.raw_os_error())
}

/// Opens a CAN socket on the interface with this number. Errors of the controller come as frames; other
/// frames by the filters, all if there is none. Reads and writes never wait.
pub(crate) fn can_socket(interface: u32, filters: &[(u32, u32)], receives_own: bool) -> io::Result<File> {
    const FILTER: libc::c_int = 1;
    const ERROR_FILTER: libc::c_int = 2;
    const RECEIVES_OWN: libc::c_int = 4;
    const ALL_ERRORS: u32 = 0x1fff_ffff;
    let kind = libc::SOCK_RAW | libc::SOCK_NONBLOCK | libc::SOCK_CLOEXEC;
    // SAFETY: no pointer is passed.
    let socket = unsafe { libc::socket(libc::AF_CAN, kind, libc::CAN_RAW) };
    if socket < 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: the descriptor is new, and belongs to nobody else.
    let socket = unsafe { OwnedFd::from_raw_fd(socket) };
    let set = |option, value: &[u8]| {
        let length = value.len().try_into().map_err(io::Error::other)?;
        // SAFETY: the pointer is valid for `length` bytes, which the kernel only reads.
        let result = unsafe {
            libc::setsockopt(socket.as_raw_fd(), libc::SOL_CAN_RAW, option, value.as_ptr().cast(), length)
        };
        if result < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
    };
    let pair = |(id, mask): &(u32, u32)| [id.to_ne_bytes(), mask.to_ne_bytes()].concat();
    if !filters.is_empty() {
        set(FILTER, &filters.iter().flat_map(pair).collect::<Vec<u8>>())?;
    }
    set(ERROR_FILTER, &ALL_ERRORS.to_ne_bytes())?;
    set(RECEIVES_OWN, &i32::from(receives_own).to_ne_bytes())?;
    // SAFETY: zeros are a valid address.
    let mut address: libc::sockaddr_can = unsafe { std::mem::zeroed() };
    address.can_family = libc::AF_CAN.try_into().map_err(io::Error::other)?;
    address.can_ifindex = interface.try_into().map_err(io::Error::other)?;
    let length = size_of_val(&address).try_into().map_err(io::Error::other)?;
    // SAFETY: the pointer is valid for `length` bytes, which the kernel only reads.
    let result = unsafe { libc::bind(socket.as_raw_fd(), (&raw const address).cast(), length) };
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(socket.into()) }
}
