//! The same names where there is no such kernel: devices cannot be opened, and emulated ones work.

use std::fs::File;
use std::io::{self, ErrorKind};
use std::path::Path;
use std::time::Duration;

#[derive(Clone, Copy)]
pub(crate) struct Request<const LENGTH: usize>(());

pub(crate) mod video {
    use super::Request;

    pub(crate) const QUERYCAP: Request<104> = Request(());
    pub(crate) const ENUM_FMT: Request<64> = Request(());
    pub(crate) const S_FMT: Request<208> = Request(());
    pub(crate) const REQBUFS: Request<20> = Request(());
    pub(crate) const STREAMON: Request<4> = Request(());
    pub(crate) const S_PARM: Request<204> = Request(());
    pub(crate) const S_CTRL: Request<8> = Request(());
    pub(crate) const QUERYCTRL: Request<68> = Request(());
}

pub(crate) mod input {
    use super::Request;

    pub(crate) const NAME: Request<256> = Request(());
    pub(crate) const PRESSED: Request<96> = Request(());
    pub(crate) const KEYS: Request<96> = Request(());
    pub(crate) const AXES: Request<8> = Request(());

    pub(crate) const fn axis(_code: u8) -> Request<24> {
        Request(())
    }
}

pub(crate) mod gpio {
    use super::{Request, unsupported};
    use std::fs::File;
    use std::io;

    pub(crate) const CHIP_INFO: Request<68> = Request(());
    pub(crate) const LINE_INFO: Request<256> = Request(());
    pub(crate) const GET_VALUES: Request<16> = Request(());
    pub(crate) const SET_VALUES: Request<16> = Request(());

    pub(crate) fn request_line(_chip: &File, _bytes: &mut [u8; 592]) -> io::Result<File> {
        Err(unsupported())
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BufferRequest {
    Query,
    Queue,
    Dequeue,
}

pub(crate) const CAPTURE: u32 = 1;
pub(crate) const MAPPED: u32 = 1;

pub(crate) struct Mapping(());

impl Mapping {
    pub(crate) fn new(_device: &File, _length: usize, _offset: u64) -> io::Result<Self> {
        Err(unsupported())
    }

    pub(crate) fn copy(&self, _length: usize) -> Vec<u8> {
        Vec::new()
    }
}

pub(crate) fn request<const LENGTH: usize>(
    _device: &File,
    _request: Request<LENGTH>,
    _bytes: &mut [u8; LENGTH],
) -> io::Result<()> {
    Err(unsupported())
}

pub(crate) fn buffer(_device: &File, _about: BufferRequest, _index: u32) -> io::Result<[u8; 88]> {
    Err(unsupported())
}

/// Pipes of emulated joysticks are not supported either.
pub(crate) fn open_without_waiting(_path: &Path, _is_written: bool) -> io::Result<File> {
    Err(unsupported())
}

pub(crate) fn wait(_device: &File, _most: Duration) -> io::Result<bool> {
    Err(unsupported())
}

pub(crate) fn wait_for_any(_devices: &[&File], _most: Duration) -> io::Result<bool> {
    Err(unsupported())
}

pub(crate) fn age(_seconds: u64, _nanoseconds: u64) -> Option<Duration> {
    None
}

pub(crate) fn is_gone(_error: &io::Error) -> bool {
    false
}

pub(crate) fn is_foreign(_error: &io::Error) -> bool {
    false
}

/// # Errors
/// Always: a sentence.
pub(crate) fn check_supported() -> io::Result<()> {
    Err(unsupported())
}

pub(crate) fn is_full(_error: &io::Error) -> bool {
    false
}

pub(crate) fn can_socket(_interface: u32, _filters: &[(u32, u32)], _receives_own: bool) -> io::Result<File> {
    Err(unsupported())
}

fn unsupported() -> io::Error {
    io::Error::new(
        ErrorKind::Unsupported,
        "devices of this kind are supported on 64-bit Linux only; on other systems use emulated ones",
    )
}
