//! The requests that a capture needs of a driver, and the driver behind a device file.

use std::fs::File;
use std::io;
use std::path::Path;
use std::time::Duration;

use crate::kernel::{self, BufferRequest, Mapping, Request};

/// A driver of a video device.
pub(super) trait Driver: Send {
    /// Sends a request, and receives the answer in the same bytes.
    fn request<const LENGTH: usize>(
        &mut self,
        request: Request<LENGTH>,
        bytes: &mut [u8; LENGTH],
    ) -> io::Result<()>;

    /// Asks about a buffer: its `v4l2_buffer`.
    fn buffer(&mut self, about: BufferRequest, index: u32) -> io::Result<[u8; 88]>;

    /// Maps the next buffer, of that many bytes at that offset.
    fn map(&mut self, length: usize, offset: u64) -> io::Result<()>;

    /// The first bytes of a buffer; fewer if it has not that many.
    fn copy(&self, index: usize, length: usize) -> Vec<u8>;

    /// Waits for a picture, for that long at most.
    fn wait(&mut self, most: Duration) -> io::Result<bool>;
}

/// A device file. Dropping it stops the camera.
pub(super) struct DeviceFile {
    file: File,
    buffers: Vec<Mapping>,
}

impl DeviceFile {
    pub(super) fn open(path: &Path) -> Result<Self, String> {
        let file = kernel::open_device(path, true, "camera", "video")?;
        Ok(Self { file, buffers: Vec::new() })
    }
}

impl Driver for DeviceFile {
    fn request<const LENGTH: usize>(
        &mut self,
        request: Request<LENGTH>,
        bytes: &mut [u8; LENGTH],
    ) -> io::Result<()> {
        kernel::request(&self.file, request, bytes)
    }

    fn buffer(&mut self, about: BufferRequest, index: u32) -> io::Result<[u8; 88]> {
        kernel::buffer(&self.file, about, index)
    }

    fn map(&mut self, length: usize, offset: u64) -> io::Result<()> {
        self.buffers.push(Mapping::new(&self.file, length, offset)?);
        Ok(())
    }

    fn copy(&self, index: usize, length: usize) -> Vec<u8> {
        self.buffers.get(index).map(|buffer| buffer.copy(length)).unwrap_or_default()
    }

    fn wait(&mut self, most: Duration) -> io::Result<bool> {
        kernel::wait(&self.file, most)
    }
}
