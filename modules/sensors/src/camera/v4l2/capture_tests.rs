//! A capture on a driver that is a test: it answers the bytes of requests as `linux/videodev2.h` lays them
//! out.
#![allow(clippy::unwrap_used)]

use std::collections::VecDeque;

use super::*;
use crate::kernel::{Request, put_u64};

/// `ENODEV`.
const NO_DEVICE: i32 = 19;

#[derive(Default)]
struct Fake {
    capabilities: u32,
    /// What the driver makes of a wanted format: the code, the size, the bytes per line, the bytes of a
    /// picture.
    format: Option<(u32, u32, u32, u32, u32)>,
    /// The time between pictures, as a fraction.
    interval: Option<(u32, u32)>,
    is_busy: bool,
    is_gone: bool,
    is_running: bool,
    mapped: usize,
    queued: VecDeque<u32>,
    filled: VecDeque<[u8; 88]>,
    contents: Vec<Vec<u8>>,
    control: Option<(u32, i32)>,
    last_number: u32,
}

impl Fake {
    fn camera() -> Self {
        Self {
            capabilities: CAP_VIDEO_CAPTURE | CAP_STREAMING,
            format: Some((MJPG, 640, 480, 0, 614_400)),
            interval: Some((1, 30)),
            contents: vec![Vec::new(); 4],
            ..Self::default()
        }
    }

    /// Takes a picture, as the driver does if it has a free buffer.
    fn take(&mut self, content: &[u8], flags: u32) {
        let number = self.last_number;
        self.last_number += 1;
        let Some(index) = self.queued.pop_front() else { return };
        self.contents[index as usize] = content.to_vec();
        let mut bytes = [0; 88];
        put_u32(&mut bytes, 0, index);
        put_u32(&mut bytes, 8, content.len() as u32);
        put_u32(&mut bytes, 12, flags);
        put_u64(&mut bytes, 24, 1); // a second after the start of the machine
        put_u32(&mut bytes, 56, number);
        self.filled.push_back(bytes);
    }
}

impl Driver for Fake {
    fn request<const LENGTH: usize>(
        &mut self,
        request: Request<LENGTH>,
        bytes: &mut [u8; LENGTH],
    ) -> io::Result<()> {
        let number = request.number();
        if self.is_gone {
            return Err(io::Error::from_raw_os_error(NO_DEVICE));
        }
        if number == video::QUERYCAP.number() {
            put(bytes, 16, b"A Camera\0");
            put_u32(bytes, 84, self.capabilities);
        } else if number == video::S_FMT.number() {
            if self.is_busy {
                return Err(ErrorKind::ResourceBusy.into());
            }
            assert_eq!(u32_at(bytes, 0), CAPTURE);
            let asked = (u32_at(bytes, 16), u32_at(bytes, 8), u32_at(bytes, 12));
            let (code, width, height, bytes_per_line, size) =
                self.format.unwrap_or((asked.0, asked.1, asked.2, 0, 0));
            for (offset, value) in [(16, code), (8, width), (12, height), (24, bytes_per_line), (28, size)] {
                put_u32(bytes, offset, value);
            }
        } else if number == video::S_PARM.number() {
            let Some((numerator, denominator)) = self.interval else {
                return Err(io::Error::from_raw_os_error(25));
            };
            put_u32(bytes, 4, CAP_TIMEPERFRAME);
            put_u32(bytes, 12, numerator);
            put_u32(bytes, 16, denominator);
        } else if number == video::ENUM_FMT.number() {
            if u32_at(bytes, 0) > 0 {
                return Err(ErrorKind::InvalidInput.into());
            }
            put(bytes, 12, b"RGB3\0");
            put(bytes, 44, b"RGB3");
        } else if number == video::QUERYCTRL.number() {
            let after = u32_at(bytes, 0) & !CTRL_FLAG_NEXT;
            let all: [(u32, &[u8], i32, u32); 4] = [
                (0x98_0001, b"User Controls\0", 0, 0),
                (0x98_0913, b"Gain\0", 255, 0),
                (0x98_0914, b"Broken\0", 255, CTRL_FLAG_DISABLED),
                (0x9a_0902, b"Exposure Time, Absolute\0", 5_000, 0),
            ];
            let next = all.iter().find(|control| control.0 > after).ok_or(ErrorKind::InvalidInput)?;
            put_u32(bytes, 0, next.0);
            put(bytes, 8, next.1);
            put(bytes, 44, &next.2.to_ne_bytes());
            put_u32(bytes, 56, next.3);
        } else if number == video::S_CTRL.number() {
            if i32_at(bytes, 4) > 255 {
                return Err(io::Error::from_raw_os_error(34));
            }
            self.control = Some((u32_at(bytes, 0), i32_at(bytes, 4)));
        } else if number == video::STREAMON.number() {
            self.is_running = true;
        } else {
            assert_eq!((number, u32_at(bytes, 8)), (video::REQBUFS.number(), MAPPED));
            put_u32(bytes, 0, self.contents.len() as u32);
        }
        Ok(())
    }

    fn buffer(&mut self, about: BufferRequest, index: u32) -> io::Result<[u8; 88]> {
        if self.is_gone {
            return Err(io::Error::from_raw_os_error(NO_DEVICE));
        }
        let mut bytes = [0; 88];
        match about {
            BufferRequest::Query => {
                put_u32(&mut bytes, 64, index * 4_096);
                put_u32(&mut bytes, 72, 614_400);
            }
            BufferRequest::Queue => self.queued.push_back(index),
            BufferRequest::Dequeue => return self.filled.pop_front().ok_or(ErrorKind::WouldBlock.into()),
        }
        Ok(bytes)
    }

    fn map(&mut self, length: usize, offset: u64) -> io::Result<()> {
        assert_eq!((length, offset), (614_400, self.mapped as u64 * 4_096));
        self.mapped += 1;
        Ok(())
    }

    fn copy(&self, index: usize, length: usize) -> Vec<u8> {
        self.contents
            .get(index)
            .map(|content| content[..length.min(content.len())].to_vec())
            .unwrap_or_default()
    }

    fn wait(&mut self, most: Duration) -> io::Result<bool> {
        assert!(most <= WAIT[1]);
        Ok(self.is_gone || !self.filled.is_empty())
    }
}

fn wanted() -> Wanted {
    Wanted { device: "/dev/video0".into(), width: 800, height: 600, rate_hz: 30.0, ..Wanted::default() }
}

fn start(fake: Fake) -> Result<(Capture<Fake>, Granted), String> {
    Capture::start(fake, "/dev/video0", &wanted())
}

#[test]
fn what_the_driver_grants_is_told_and_pictures_come_newest_first_and_never_twice() {
    let (mut capture, granted) = start(Fake::camera()).unwrap();
    let expected = Granted {
        width: 640,
        height: 480,
        rate_hz: 30.0,
        name: "/dev/video0 \"A Camera\"".into(),
        ..Granted::default()
    };
    assert_eq!(granted, expected);
    assert!(capture.driver.is_running && capture.driver.mapped == 4);
    assert_eq!(capture.frame(), Ok(None));
    for content in [b"one", b"two"] {
        capture.driver.take(content, BUF_FLAG_TIMESTAMP_MONOTONIC);
    }
    let frame = capture.frame().unwrap().unwrap();
    assert_eq!((&frame.bytes[..], frame.number, frame.is_damaged), (&b"two"[..], 1, false));
    assert_eq!(capture.frame(), Ok(None));
    assert_eq!(capture.driver.queued.len(), 4, "all buffers are back with the driver");
    for _ in 0..6 {
        capture.driver.take(b"late", BUF_FLAG_ERROR);
    }
    let frame = capture.frame().unwrap().unwrap();
    assert_eq!((frame.number, frame.is_damaged), (5, true));
    assert_eq!(frame.captured, Captured::Ago(Duration::ZERO), "no stamp of a clock that is known");
}

#[test]
fn a_camera_that_is_unplugged_is_an_error_with_the_remedy() {
    let (mut capture, _) = start(Fake::camera()).unwrap();
    capture.driver.is_gone = true;
    assert_eq!(capture.frame().unwrap_err(), "the camera is gone; plug it in again");
    assert!(start(Fake { is_gone: true, ..Fake::camera() }).is_err());
}

#[test]
fn yuyv_has_its_bytes_per_line_and_a_driver_without_a_rate_has_none() {
    let fake = Fake { format: Some((YUYV, 640, 480, 0, 0)), interval: None, ..Fake::camera() };
    let granted = start(fake).unwrap().1;
    assert_eq!((granted.format, granted.bytes_per_line, granted.rate_hz), (Format::Yuyv, 1_280, 0.0));
    let fake =
        Fake { format: Some((YUYV, 640, 480, 1_536, 0)), interval: Some((1_001, 30_000)), ..Fake::camera() };
    let granted = start(fake).unwrap().1;
    assert_eq!((granted.bytes_per_line, (granted.rate_hz * 100.0).round()), (1_536, 2_997.0));
}

#[test]
fn a_driver_that_cannot_serve_is_refused_with_what_it_offers() {
    let refusal = |fake| start(fake).map(|_| ()).unwrap_err();
    let rgb = Fake { format: Some((u32::from_le_bytes(*b"RGB3"), 640, 480, 0, 0)), ..Fake::camera() };
    let expected = "/dev/video0 gives pictures as RGB3, neither MJPG nor YUYV; it offers RGB3 (RGB3)";
    assert_eq!(refusal(rgb), expected);
    let metadata = Fake { capabilities: CAP_DEVICE_CAPS | CAP_VIDEO_CAPTURE, ..Fake::camera() };
    assert!(refusal(metadata).contains("second device file for metadata"));
    let without_stream = Fake { capabilities: CAP_VIDEO_CAPTURE, ..Fake::camera() };
    assert!(refusal(without_stream).contains("cannot stream"));
    assert!(refusal(Fake { is_busy: true, ..Fake::camera() }).contains("in use by another program"));
    for (width, height, size) in [(0, 480, 1), (640, 1_000_000, 1), (640, 480, u32::MAX)] {
        let fake = Fake { format: Some((MJPG, width, height, 0, size)), ..Fake::camera() };
        assert!(refusal(fake).contains("offers pictures of"), "{width}x{height} in {size}");
    }
    assert!(refusal(Fake { contents: Vec::new(), ..Fake::camera() }).contains("gives no buffers"));
}

#[test]
fn a_buffer_that_the_driver_overstates_is_bounded_by_its_length() {
    let (mut capture, _) = start(Fake::camera()).unwrap();
    let mut bytes = [0; 88];
    put_u32(&mut bytes, 8, u32::MAX);
    capture.driver.filled.push_back(bytes);
    assert!(capture.frame().unwrap().unwrap().bytes.is_empty());
    put_u32(&mut bytes, 0, 77);
    capture.driver.filled.push_back(bytes);
    let frame = capture.frame().map(|frame| frame.map(|frame| frame.bytes.len()));
    assert_eq!(frame, Ok(Some(0)));
}

#[test]
fn controls_have_the_names_of_v4l2_ctl_and_refusals_say_which_there_are() {
    let (mut capture, _) = start(Fake::camera()).unwrap();
    assert_eq!(capture.control("gain", 20), Ok(()));
    assert_eq!(capture.driver.control, Some((0x98_0913, 20)));
    assert_eq!(capture.control("exposure_time_absolute", 5), Ok(()));
    let unknown = capture.control("gian", 1).unwrap_err();
    assert_eq!(unknown, "the camera has no control \"gian\"; it has gain, exposure_time_absolute");
    assert!(capture.control("gain", 300).unwrap_err().starts_with("the camera refuses 300 for \"gain\": "));
    assert_eq!(name_of_control("White Balance, Automatic"), "white_balance_automatic");
    assert_eq!(name_of_control("  (odd)  "), "odd");
}
