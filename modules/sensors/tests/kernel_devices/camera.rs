use std::fs;
use std::path::Path;
use std::sync::{Arc, Mutex};

use downbeat_device::DeviceLink;
use downbeat_executor::{Heard, ModuleOptions, Probe, Time};
use downbeat_msgs::diagnostic_msgs::msg::DiagnosticStatus;
use downbeat_msgs::sensor_msgs::msg::{CameraInfo, CompressedImage, Image};
use downbeat_sensors::camera::{
    Camera, Captured, Format, Frame, Granted, Pictures, Source, VideoDevice, Wanted,
};
use fuzzing::{Random, rounds};

use super::{Bench, bench_of, last_status, last_value, options, pass, text, texts};

struct Topics {
    compressed: Heard<CompressedImage>,
    images: Heard<Image>,
    infos: Heard<CameraInfo>,
}

fn bench(camera: Camera, options: ModuleOptions) -> Bench<Topics> {
    let is_jpeg = options.settings.get("format") != Some(&text("yuyv"));
    let has_image = options.settings.get("image_raw") != Some(&text("off"));
    let unheard = "unheard";
    bench_of(("front", camera), options, "camera/exchanges", |probe| Topics {
        compressed: probe.listen(if is_jpeg { "image_raw/compressed" } else { unheard }).unwrap(),
        images: probe.listen(if has_image { "image_raw" } else { "unheard_too" }).unwrap(),
        infos: probe.listen("camera_info").unwrap(),
    })
}

fn emulated() -> Camera {
    Camera::emulated(DeviceLink::new(VideoDevice::new(Pictures::default())))
}

const CALIBRATION: &str = "image_width: 64
image_height: 48
camera_matrix: {rows: 3, cols: 3, data: [60, 0, 32, 0, 60, 24, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0.1, 0, 0, 0, 0]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix: {rows: 3, cols: 4, data: [60, 0, 32, 0, 0, 60, 24, 0, 0, 0, 1, 0]}
";

fn small() -> ModuleOptions {
    options([
        ("width", 64.into()),
        ("height", 48.into()),
        ("rate_hz", 10.0.into()),
        ("frame_id", text("front_optical")),
        ("calibration", text(CALIBRATION)),
    ])
}

#[test]
fn pictures_come_in_all_forms_with_one_stamp_and_a_recording_repeats_them_bit_for_bit() {
    let mut live = bench(emulated(), small());
    pass(&mut live.probe, 1_000);
    let (compressed, images, infos) = (live.compressed.take(), live.images.take(), live.infos.take());
    assert_eq!((compressed.len(), images.len(), infos.len()), (10, 10, 10));
    let image = &images[3];
    assert_eq!((image.width, image.height, image.step, &*image.encoding), (64, 48, 192, "rgb8"));
    assert_eq!(image.data.as_slice().len(), 64 * 48 * 3);
    assert_eq!(
        (&*image.header.frame_id, image.header.stamp.as_nanos() > 300_000_000),
        ("front_optical", true)
    );
    for (one, (other, info)) in images.iter().zip(compressed.iter().zip(&infos)) {
        assert_eq!((&one.header, &one.header), (&other.header, &info.header));
        assert_eq!((&*other.format, &other.data.as_slice()[..2]), ("jpeg", &[0xff, 0xd8][..]));
        assert_eq!((info.width, info.k[0], info.d.as_slice().len()), (64, 60.0, 5));
    }
    assert_ne!(images[0].data, images[1].data, "the square moves");
    assert_eq!(last_status(&live.diagnostics), (DiagnosticStatus::OK, "running".to_owned()));

    let recorded = DeviceLink::recorded(live.exchanges.take());
    let mut again = bench(Camera::emulated(recorded), small());
    pass(&mut again.probe, 1_000);
    assert_eq!(again.images.take(), images);
    assert_eq!(again.compressed.take(), compressed);
    assert_eq!(again.infos.take(), infos);
}

#[test]
fn yuyv_is_published_as_it_is_or_as_rgb() {
    let with = |image_raw| {
        let mut settings = small();
        settings.settings.insert("format".into(), text("yuyv"));
        settings.settings.insert("image_raw".into(), text(image_raw));
        let mut live = bench(emulated(), settings);
        pass(&mut live.probe, 200);
        live.images.take().remove(0)
    };
    let raw = with("yuv422_yuy2");
    assert_eq!((&*raw.encoding, raw.step, raw.data.as_slice().len()), ("yuv422_yuy2", 128, 64 * 48 * 2));
    let rgb = with("rgb8");
    assert_eq!((&*rgb.encoding, rgb.step, rgb.data.as_slice().len()), ("rgb8", 192, 64 * 48 * 3));
}

#[test]
fn a_camera_that_is_unplugged_is_told_and_is_back_when_it_is_plugged_in_again() {
    let folder = tempfile::tempdir().unwrap();
    let (here, away) = (folder.path().join("camera"), folder.path().join("away"));
    fs::create_dir(&here).unwrap();
    let picture = pictures(1).remove(0);
    fs::write(here.join("1.jpg"), &picture).unwrap();
    let mut settings = small();
    settings.settings.insert("device".into(), text(here.display()));
    let mut live = bench(emulated(), settings);
    pass(&mut live.probe, 500);
    assert_eq!(live.compressed.take().len(), 5);
    fs::rename(&here, &away).unwrap();
    pass(&mut live.probe, 2_000);
    assert!(live.compressed.take().is_empty());
    let (level, message) = last_status(&live.diagnostics);
    assert_eq!(level, DiagnosticStatus::ERROR);
    assert!(message.contains("camera") && message.ends_with("this is tried again every second"), "{message}");
    fs::rename(&away, &here).unwrap();
    pass(&mut live.probe, 2_000);
    assert!(live.compressed.take().len() >= 9);
    assert_eq!(last_status(&live.diagnostics), (DiagnosticStatus::OK, "running".to_owned()));
}

/// JPEGs of the pattern, in the size of [`small`].
fn pictures(count: usize) -> Vec<Vec<u8>> {
    let mut live = bench(emulated(), small());
    pass(&mut live.probe, 100 * count as u64);
    live.compressed.take().into_iter().map(|picture| picture.data.to_vec()).collect()
}

#[test]
fn damaged_pictures_are_counted_and_not_published() {
    let folder = tempfile::tempdir().unwrap();
    let picture = pictures(1).remove(0);
    fs::write(folder.path().join("1.jpg"), &picture).unwrap();
    fs::write(folder.path().join("2.jpg"), &picture[..picture.len() / 2]).unwrap();
    fs::write(folder.path().join("3.JPEG"), "no picture").unwrap();
    let mut settings = small();
    settings.settings.insert("device".into(), text(folder.path().display()));
    let mut live = bench(emulated(), settings);
    pass(&mut live.probe, 1_000);
    assert_eq!(live.images.take().len(), 4, "each third");
    assert_eq!(live.infos.take().len(), 4);
    pass(&mut live.probe, 1_000);
    let damaged = live.diagnostics.take();
    let damaged = &damaged.last().unwrap().status[0].values[1];
    let count: u32 = damaged.value.parse().unwrap();
    assert!(damaged.key == "pictures damaged" && (6..=13).contains(&count), "{damaged:?}");
    pass(&mut live.probe, 1_000);
    assert_eq!(last_status(&live.diagnostics), (DiagnosticStatus::WARN, "pictures are damaged".to_owned()));
}

#[test]
fn what_the_settings_contradict_is_refused_and_a_calibration_of_another_size_is_not_used() {
    let refusal = |name: &str, value| {
        let mut settings = small();
        settings.settings.insert(name.to_owned(), value);
        Probe::new().add_with("front", emulated(), settings).unwrap_err().to_string()
    };
    assert!(refusal("image_raw", text("yuv422_yuy2")).contains("set format = \"yuyv\""));
    assert!(refusal("calibration", text("/nowhere.yaml")).contains("/nowhere.yaml: No such file"));
    assert!(refusal("calibration", text("image_width: 1\n")).contains("missing field"));
    assert!(refusal("controls", texts(["gain"])).contains("\"gain\" is not the name of a control"));

    let mut settings = small();
    settings.settings.insert("width".into(), 80.into());
    let mut live = bench(emulated(), settings);
    pass(&mut live.probe, 1_500);
    let info = live.infos.take().remove(0);
    assert_eq!((info.width, info.height, info.k[0]), (80, 48, 0.0));
    let (level, message) = last_status(&live.diagnostics);
    assert_eq!(
        (level, &*message),
        (
            DiagnosticStatus::WARN,
            "the calibration is for 64x48 pixels, the pictures have 80x48: camera_info has no calibration"
        )
    );
}

/// A camera whose driver chooses for itself, and that loses pictures, falls silent and refuses controls.
#[derive(Clone, Default)]
struct Wilful(Arc<Mutex<WilfulState>>);

#[derive(Default)]
struct WilfulState {
    opened: u32,
    controls: Vec<(String, i32)>,
    frames: Vec<Frame>,
}

impl Source for Wilful {
    fn open(&mut self, _: &Wanted) -> Result<Granted, String> {
        self.0.lock().unwrap().opened += 1;
        Ok(Granted {
            format: Format::Mjpeg,
            width: 64,
            height: 48,
            rate_hz: 15.0,
            name: "/dev/video9 \"Wilful\"".into(),
            bytes_per_line: 0,
        })
    }

    fn frame(&mut self, _: Time) -> Result<Option<Frame>, String> {
        Ok(self.0.lock().unwrap().frames.pop())
    }

    fn control(&mut self, name: &str, value: i32) -> Result<(), String> {
        self.0.lock().unwrap().controls.push((name.to_owned(), value));
        if name == "gain" { Ok(()) } else { Err(format!("the camera has no control \"{name}\"")) }
    }

    fn close(&mut self) {}
}

#[test]
fn what_the_driver_chooses_is_told_and_a_silent_camera_is_opened_again() {
    let wilful = Wilful::default();
    let mut settings = small();
    settings.settings.insert("controls".into(), texts(["gain=20", "gian = -3"]));
    let camera = Camera::new(DeviceLink::new(VideoDevice::new(wilful.clone())));
    let mut live = bench(camera, settings);
    pass(&mut live.probe, 100);
    let told = last_status(&live.diagnostics);
    assert_eq!(told, (DiagnosticStatus::WARN, "the camera gives 15.0000 Hz in place of 10 Hz".to_owned()));
    let expected = [("gain".to_owned(), 20), ("gian".to_owned(), -3)];
    assert_eq!(wilful.0.lock().unwrap().controls, expected, "one that is refused stops nothing");
    live.probe.set("front", "controls", texts(["gain=5"])).unwrap();
    assert_eq!(wilful.0.lock().unwrap().controls.last(), Some(&("gain".to_owned(), 5)));
    let bytes = pictures(1).remove(0);
    for (number, is_damaged) in [(1, false), (4, false), (5, true)] {
        let captured = Captured::At(live.probe.now());
        wilful.0.lock().unwrap().frames.push(Frame { bytes: bytes.clone(), number, captured, is_damaged });
        pass(&mut live.probe, 60);
    }
    assert_eq!(live.images.take().len(), 2);
    pass(&mut live.probe, 1_000);
    assert_eq!(last_value(&live.diagnostics, "pictures skipped"), "2");
    pass(&mut live.probe, 5_000);
    assert_eq!(wilful.0.lock().unwrap().opened, 2);
    assert_eq!(last_value(&live.diagnostics, "times the camera was lost"), "1");
}

#[test]
fn a_damaged_recording_stops_nothing() {
    let mut live = bench(emulated(), small());
    pass(&mut live.probe, 500);
    let recorded = live.exchanges.take();
    for round in rounds(40) {
        let mut random = Random::new(round);
        let mut damaged = recorded.clone();
        for _ in 0..4 {
            let place = random.below(damaged.len());
            let exchange = &mut damaged[place];
            let mut reply = exchange.reply.to_vec();
            for _ in 0..random.below(6) {
                let at = random.below(reply.len());
                if let Some(byte) = reply.get_mut(at) {
                    *byte = random.below(256) as u8;
                }
            }
            reply.truncate(reply.len().saturating_sub(random.below(3) * random.below(500)));
            exchange.reply = reply;
            exchange.outcome = random.below(4) as u8;
            exchange.sequence = random.bits();
        }
        let mut again = bench(Camera::emulated(DeviceLink::recorded(damaged)), small());
        pass(&mut again.probe, 500);
        for image in again.images.take() {
            assert_eq!(image.data.as_slice().len(), (image.step * image.height) as usize);
        }
    }
}

#[test]
fn a_device_that_is_a_file_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("video0");
    fs::write(&file, "").unwrap();
    let told = |device: &Path| {
        let source = downbeat_sensors::camera::V4l2::default();
        let camera = Camera::new(DeviceLink::new(VideoDevice::new(source)));
        let mut live = bench(camera, options([("device", text(device.display()))]));
        pass(&mut live.probe, 100);
        last_status(&live.diagnostics).1
    };
    assert!(told(&file).contains("is a regular file, not the device file of a camera"), "{}", told(&file));
    assert!(told(folder.path()).contains("is a folder"));
    assert!(told(&folder.path().join("none")).contains("is the camera plugged in?"));
    assert!(told(Path::new("/dev/null")).contains("is no video device"));
}
