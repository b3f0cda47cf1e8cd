//! USB cameras and others by Video4Linux: formats are negotiated with the driver, pictures come through
//! mapped memory.
//!
//! # References
//! "Linux Media Infrastructure userspace API", part Video for Linux, chapters "Querying Capabilities", "Data
//! Negotiation" and "Streaming I/O (Memory Mapping)"; `linux/videodev2.h`.

mod capture;
mod driver;

use std::path::{Path, PathBuf};

use downbeat_executor::Time;

use super::source::{Frame, Granted, Source, Wanted};
use crate::kernel;
use capture::Capture;
use driver::DeviceFile;

/// Cameras of this machine.
#[derive(Default)]
pub struct V4l2 {
    open: Option<Capture<DeviceFile>>,
}

/// Where the kernel lists cameras.
const CLASS: &str = "/sys/class/video4linux";

impl Source for V4l2 {
    fn open(&mut self, wanted: &Wanted) -> Result<Granted, String> {
        self.close();
        let attempt = |path: &Path| {
            let device = DeviceFile::open(path)?;
            Capture::start(device, &path.display().to_string(), wanted)
        };
        let all = cameras(Path::new(CLASS));
        let is_named = all.iter().any(|camera| camera.name == wanted.device);
        let is_path = wanted.device.starts_with('/') || (!is_named && kernel::is_file(&wanted.device));
        let (capture, granted) = if is_path {
            let path = Path::new(&wanted.device);
            attempt(path).map_err(|reason| format!("{reason}{}", others(&all, path)))?
        } else {
            let mut refusal = None;
            // A camera often has a second device file for metadata, which has the same name.
            let named = all.iter().filter(|camera| camera.name == wanted.device);
            let found = named.into_iter().find_map(|camera| match attempt(&camera.path) {
                Ok(opened) => Some(opened),
                Err(reason) => {
                    refusal.get_or_insert(reason);
                    None
                }
            });
            found.ok_or_else(|| match refusal {
                Some(reason) => reason,
                None => {
                    let name = &wanted.device;
                    format!(
                        "no camera has the name \"{name}\"; is it plugged in?{}",
                        others(&all, Path::new(""))
                    )
                }
            })?
        };
        self.open = Some(capture);
        Ok(granted)
    }

    fn frame(&mut self, _now: Time) -> Result<Option<Frame>, String> {
        self.open.as_mut().map_or_else(|| Err("the camera is not open".to_owned()), Capture::frame)
    }

    fn control(&mut self, name: &str, value: i32) -> Result<(), String> {
        let closed = || Err("the camera is not open".to_owned());
        self.open.as_mut().map_or_else(closed, |capture| capture.control(name, value))
    }

    fn close(&mut self) {
        self.open = None;
    }
}

/// A camera that the kernel lists.
struct Listed {
    path: PathBuf,
    name: String,
}

/// The cameras of this machine, in the order of their numbers.
fn cameras(class: &Path) -> Vec<Listed> {
    let entries = std::fs::read_dir(class).into_iter().flatten().flatten();
    let mut numbered: Vec<(u32, Listed)> = entries
        .filter_map(|entry| {
            let number = entry.file_name().to_str()?.strip_prefix("video")?.parse().ok()?;
            let name = std::fs::read_to_string(entry.path().join("name")).ok()?;
            let path = PathBuf::from(format!("/dev/video{number}"));
            Some((number, Listed { path, name: name.trim().to_owned() }))
        })
        .collect();
    numbered.sort_by_key(|(number, _)| *number);
    numbered.into_iter().map(|(_, camera)| camera).collect()
}

/// The cameras that are there, as a sentence.
fn others(all: &[Listed], without: &Path) -> String {
    let others = all.iter().filter(|camera| camera.path != without);
    let names: Vec<_> =
        others.map(|camera| format!("{} \"{}\"", camera.path.display(), camera.name)).collect();
    if names.is_empty() { String::new() } else { format!("; there are {}", names.join(", ")) }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn cameras_are_listed_by_number_and_named_in_refusals() {
        let class = tempfile::tempdir().unwrap();
        for (entry, name) in [("video10", "Rear"), ("video2", "HD Webcam\n"), ("v4l-subdev0", "sensor")] {
            std::fs::create_dir(class.path().join(entry)).unwrap();
            std::fs::write(class.path().join(entry).join("name"), name).unwrap();
        }
        let all = cameras(class.path());
        assert_eq!(
            others(&all, Path::new("/dev/video0")),
            "; there are /dev/video2 \"HD Webcam\", /dev/video10 \"Rear\""
        );
        assert_eq!(others(&all, Path::new("/dev/video2")), "; there are /dev/video10 \"Rear\"");
        assert!(cameras(Path::new("/nowhere")).is_empty());
    }

    #[test]
    fn a_camera_that_is_not_there_is_told_by_its_path_and_by_its_name() {
        let mut source = V4l2::default();
        let mut refusal =
            |device: &str| source.open(&Wanted { device: device.to_owned(), ..Wanted::default() });
        let no_path = refusal("/dev/no-such-camera").unwrap_err();
        assert!(no_path.starts_with("there is no /dev/no-such-camera; is the camera plugged in?"));
        let no_name = refusal("No Such Camera").unwrap_err();
        assert!(no_name.starts_with("no camera has the name \"No Such Camera\"; is it plugged in?"));
        let no_camera = refusal("/dev/null").unwrap_err();
        assert!(no_camera.starts_with("/dev/null is no video device"), "{no_camera}");
        let file = refusal("Cargo.toml").unwrap_err();
        assert!(file.starts_with("Cargo.toml is a regular file, not the device file of a camera"), "{file}");
    }
}
