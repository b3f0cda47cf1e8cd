//! Cameras: USB cameras and others that Linux has as video devices, and emulated ones.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `image_raw/compressed` | `sensor_msgs/CompressedImage` | with `format = "mjpeg"`: the JPEGs as the camera sent them |
//! | `image_raw` | `sensor_msgs/Image` | in the encoding of the setting `image_raw` |
//! | `camera_info` | `sensor_msgs/CameraInfo` | with each picture; all zero except the size without a calibration |
//! | `diagnostics` | `diagnostic_msgs/DiagnosticArray` | once a second and when the level changes |
//! | `camera/exchanges` | `downbeat_interfaces/BusExchange` | the bytes of all pictures and what was asked of the driver, for replays |
//!
//! | setting | default | |
//! | --- | --- | --- |
//! | `device` | `/dev/video0` | a device file, or the name of the camera. Of an emulated camera: a JPEG file or a folder of them, by default a pattern |
//! | `format` | `mjpeg` | how pictures come: `mjpeg`, or `yuyv` |
//! | `width`, `height` | 640, 480 | pixels; the driver may choose others |
//! | `rate_hz` | 30 | pictures per second; the driver may choose another |
//! | `image_raw` | `rgb8` | `rgb8`, `yuv422_yuy2` (of `yuyv` only), or `off` |
//! | `calibration` | | a file of `camera_calibration` |
//! | `controls` | | controls of the driver by the names that `v4l2-ctl --list-ctrls` prints, such as `["auto_exposure=1", "exposure_time_absolute=200"]`; set in this order |
//! | `frame_id` | `camera` | the optical frame: x right, y down, z forward |
//! | `hardware_id` | | the camera in diagnostics, instead of its name |
//!
//! A stamp is the time of capture that the driver reports. Incomplete pictures are counted and not
//! published; their bytes are in `camera/exchanges`. The newest picture is published, so none is older than
//! one that was skipped. A camera that does not open, stops, or is silent for 5 s is opened again each
//! second. Waiting for a picture takes twice the time between two, at most 0.5 s; run the module detached, as
//! its kind does.

mod calibration;
mod emulated;
mod source;
mod v4l2;
mod yuyv;

use std::time::Duration;

use downbeat_device::{Device, DeviceLink};
use downbeat_executor::{Context, Module, Publication, Setting, Setup, SetupError, Time};
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::sensor_msgs::msg::{CameraInfo, CompressedImage, Image};
use downbeat_msgs::std_msgs::msg::Header;
use downbeat_pictures::jpeg::{self, Head};

pub use calibration::{Calibration, CalibrationError};
pub use emulated::Pictures;
pub use source::{Captured, Format, Frame, Granted, LONGEST_SIDE, Request, Source, VideoDevice, Wanted};
pub use v4l2::V4l2;

use crate::diagnostics::{Complaint, Reporter, Status, value};
use crate::kernel::name_of;

/// How long the module waits before it opens a camera again.
const RETRY: Duration = Duration::from_secs(1);
/// A camera that gives nothing for this long is opened again.
const SILENCE: Duration = Duration::from_secs(5);
/// How long diagnostics speak of a damaged picture.
const RECENT: Duration = Duration::from_secs(2);

/// A camera; see the [module page](self).
pub struct Camera {
    link: DeviceLink<VideoDevice>,
    device: &'static str,
    wanted: Wanted,
    state: State,
    calibration: Option<Calibration>,
    encoding: Encoding,
    /// Why the camera is not open, or the last thing that was told about it.
    complaint: Complaint,
    counts: Counts,
    damaged_at: Option<Time>,
    reporter: Reporter,
}

#[derive(Debug)]
enum State {
    Closed { retry_at: Time },
    Open(Running),
}

#[derive(Debug)]
struct Running {
    granted: Granted,
    last_picture_at: Time,
    last_number: Option<u64>,
    has_other_size: bool,
}

/// What `image_raw` holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Encoding {
    Rgb8,
    Yuyv,
    Off,
}

/// What happened since the start.
#[derive(Debug, Default)]
struct Counts {
    pictures: u64,
    damaged: u64,
    skipped: u64,
    not_opened: u64,
    lost: u64,
}

/// The keys of [`Camera`].
pub struct Ports {
    exchanges: Publication<BusExchange>,
    compressed: Option<Publication<CompressedImage>>,
    image: Option<Publication<Image>>,
    info: Publication<CameraInfo>,
    diagnostics: Publication<DiagnosticArray>,
    controls: Setting<Vec<String>>,
    frame_id: Setting<String>,
    hardware_id: Setting<String>,
}

impl Module for Camera {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let about =
            "the device file or the name of the camera; of an emulated one a JPEG file or a folder of them";
        let device = setup.read_only_setting("device", self.device.to_owned(), about)?;
        let format = setup.read_only_choice("format", "mjpeg", &["mjpeg", "yuyv"], "how pictures come")?;
        let side = |setup: &mut Setup<'_, Self>, name, default| {
            setup.setting_in(
                name,
                default,
                1.0..=f64::from(LONGEST_SIDE),
                "pixels; the driver may choose another",
            )
        };
        let (width, height) = (side(setup, "width", 640_i64)?, side(setup, "height", 480)?);
        let rate_hz = setup.setting_in(
            "rate_hz",
            30.0,
            0.1..=1_000.0,
            "1/s, pictures; the driver may choose another",
        )?;
        let about = "the encoding of image_raw; yuv422_yuy2 needs the format yuyv";
        let image_raw =
            setup.read_only_choice("image_raw", "rgb8", &["rgb8", "yuv422_yuy2", "off"], about)?;
        let about = "the file with the calibration, relative to the robot file; or its text";
        let calibration = setup.read_only_setting("calibration", String::new(), about)?;
        let about = "controls of the driver, such as \"gain=20\"; set in this order";
        let controls = setup.setting("controls", Vec::<String>::new(), about)?;
        let frame_id = setup.setting("frame_id", "camera".to_owned(), "the optical frame")?;
        let about = "the camera in diagnostics, instead of its name";
        let hardware_id = setup.setting("hardware_id", String::new(), about)?;

        let text = |setting| setup.value::<String>(setting).cloned().unwrap_or_default();
        let pixels = |setting| setup.value::<i64>(setting).and_then(|side| u32::try_from(*side).ok());
        self.wanted = Wanted {
            device: text(device),
            format: text(format).parse().unwrap_or_default(),
            width: pixels(width).unwrap_or_default(),
            height: pixels(height).unwrap_or_default(),
            rate_hz: setup.value(rate_hz).copied().unwrap_or_default(),
        };
        self.encoding = match &*text(image_raw) {
            "rgb8" => Encoding::Rgb8,
            "yuv422_yuy2" => Encoding::Yuyv,
            _ => Encoding::Off,
        };
        if self.encoding == Encoding::Yuyv && self.wanted.format != Format::Yuyv {
            return Err(setup.refuse_value(image_raw, "pictures come as mjpeg; set format = \"yuyv\""));
        }
        let file = text(calibration);
        self.calibration = match file.is_empty() {
            true => None,
            false => {
                let read = Calibration::load(&file)
                    .map_err(|error| setup.refuse_value(calibration, error.to_string()))?;
                Some(read)
            }
        };
        let given = setup.value(controls).cloned().unwrap_or_default();
        if let Err(problem) = parsed(&given) {
            return Err(setup.refuse_value(controls, problem));
        }
        setup.accept_if(controls, |_, controls| parsed(controls).map(drop));
        setup.on_change(controls, Self::set_controls);
        for setting in [width, height] {
            setup.on_change(setting, move |camera, ctx| camera.reopen(width, height, rate_hz, ctx));
        }
        setup.on_change(rate_hz, move |camera, ctx| camera.reopen(width, height, rate_hz, ctx));
        let period = Duration::from_secs_f64(0.5 / self.wanted.rate_hz);
        setup.every(period.min(RETRY), Self::run)?;
        let is_jpeg = self.wanted.format == Format::Mjpeg;
        Ok(Ports {
            exchanges: setup.publish(VideoDevice::TOPIC)?,
            compressed: if is_jpeg { Some(setup.publish("image_raw/compressed")?) } else { None },
            image: match self.encoding {
                Encoding::Off => None,
                Encoding::Rgb8 | Encoding::Yuyv => Some(setup.publish("image_raw")?),
            },
            info: setup.publish("camera_info")?,
            diagnostics: setup.publish("diagnostics")?,
            controls,
            frame_id,
            hardware_id,
        })
    }

    opened_while_active!();
}

impl Camera {
    /// A camera of this machine.
    #[must_use]
    pub fn new(link: DeviceLink<VideoDevice>) -> Self {
        Self {
            link,
            device: "/dev/video0",
            wanted: Wanted::default(),
            state: State::Closed { retry_at: Time::ZERO },
            calibration: None,
            encoding: Encoding::Off,
            complaint: Complaint::default(),
            counts: Counts::default(),
            damaged_at: None,
            reporter: Reporter::default(),
        }
    }

    /// An emulated camera, which shows a pattern if its setting `device` names no pictures.
    #[must_use]
    pub fn emulated(link: DeviceLink<VideoDevice>) -> Self {
        Self { device: "", ..Self::new(link) }
    }

    fn open_soon(&mut self) {
        self.state = State::Closed { retry_at: Time::ZERO };
    }

    fn run(&mut self, ctx: &mut Context<'_, Ports>) {
        match std::mem::replace(&mut self.state, State::Closed { retry_at: Time::ZERO }) {
            State::Closed { retry_at } if ctx.now() < retry_at => self.state = State::Closed { retry_at },
            State::Closed { .. } => self.open(ctx),
            State::Open(running) => self.state = self.take(running, ctx),
        }
        self.diagnose(ctx);
    }

    fn open(&mut self, ctx: &mut Context<'_, Ports>) {
        let exchange = self.link.exchange(&Request::Open(self.wanted.clone()), ctx.ports.exchanges, ctx);
        let granted = match source::granted(&exchange) {
            Ok(granted) => granted,
            Err(reason) => {
                self.counts.not_opened += 1;
                self.state = State::Closed { retry_at: ctx.now() + RETRY };
                self.complaint.say(&format!("{reason}; this is tried again every second"), ctx);
                return;
            }
        };
        let Granted { format, width, height, rate_hz, name, .. } = &granted;
        let rate =
            if *rate_hz > 0.0 { format!("at {rate_hz:.4} Hz") } else { "at the camera's rate".to_owned() };
        tracing::info!("{}: {name} gives {} of {width}x{height} {rate}", ctx.module_name(), format.name());
        let Wanted { format: wanted_format, width: wanted_width, height: wanted_height, .. } = self.wanted;
        let mut told = String::new();
        if (*format, *width, *height) != (wanted_format, wanted_width, wanted_height) {
            told = format!(
                "the camera gives {} of {width}x{height} in place of {} of {wanted_width}x{wanted_height}",
                format.name(),
                wanted_format.name()
            );
        } else if *rate_hz > 0.0 && (rate_hz / self.wanted.rate_hz - 1.0).abs() > 0.02 {
            told = format!("the camera gives {rate_hz:.4} Hz in place of {} Hz", self.wanted.rate_hz);
        }
        let size = self.calibration.as_ref().map(Calibration::size);
        let has_other_size = size.is_some_and(|size| size != [*width, *height]);
        if let (true, Some([calibrated_width, calibrated_height])) = (has_other_size, size) {
            told = format!(
                "the calibration is for {calibrated_width}x{calibrated_height} pixels, the pictures have {width}x{height}: camera_info has no calibration"
            );
        }
        self.complaint.say(&told, ctx);
        let last_picture_at = ctx.now();
        self.state = State::Open(Running { granted, last_picture_at, last_number: None, has_other_size });
        self.set_controls(ctx);
    }

    fn take(&mut self, mut running: Running, ctx: &mut Context<'_, Ports>) -> State {
        let exchange = self.link.exchange(&Request::Frame, ctx.ports.exchanges, ctx);
        if exchange.outcome == BusExchange::FAILED {
            self.counts.lost += 1;
            self.complaint.say(&exchange.error, ctx);
            return self.closed(RETRY, ctx);
        }
        if exchange.outcome == BusExchange::TIMEOUT && exchange.reply.is_empty() {
            let silent_for = ctx.now().saturating_since(running.last_picture_at);
            if silent_for >= SILENCE {
                self.counts.lost += 1;
                let seconds = silent_for.as_secs();
                self.complaint
                    .say(&format!("no picture came for {seconds} s; the camera is opened again"), ctx);
                return self.closed(Duration::ZERO, ctx);
            }
            return State::Open(running);
        }
        running.last_picture_at = ctx.now();
        if let Some(last) = running.last_number.replace(exchange.sequence) {
            let skipped = exchange.sequence.saturating_sub(last).saturating_sub(1);
            self.counts.skipped = self.counts.skipped.saturating_add(skipped);
        }
        self.counts.pictures += 1;
        let frame_id = ctx.get::<String>(ctx.ports.frame_id).clone();
        let published = match exchange.outcome {
            BusExchange::OK => self.publish(&running, exchange, frame_id, ctx),
            _ => Err(exchange.error),
        };
        if let Err(reason) = published {
            self.counts.damaged += 1;
            self.damaged_at = Some(ctx.now());
            let count = self.counts.damaged;
            if 10_u64.pow(count.ilog10()) == count {
                let name = ctx.module_name();
                tracing::warn!("{name}: a picture is dropped ({count} so far): {reason}");
            }
        }
        State::Open(running)
    }

    /// Publishes a picture in all its forms, or says why it is none.
    fn publish(
        &self,
        running: &Running,
        exchange: BusExchange,
        frame_id: String,
        ctx: &mut Context<'_, Ports>,
    ) -> Result<(), String> {
        let Granted { format, width, height, bytes_per_line, .. } = running.granted;
        let header = Header { stamp: exchange.stamp, frame_id };
        let (ports, bytes) = (ctx.ports, exchange.reply);
        let (encoding, step, data) = match format {
            Format::Mjpeg => {
                let head = Head::of(&bytes)?;
                if (head.width, head.height) != (width, height) {
                    let Head { width: has_width, height: has_height, .. } = head;
                    return Err(format!("it has {has_width}x{has_height} pixels, not {width}x{height}"));
                }
                if !head.has_end(&bytes) {
                    return Err("it is cut off".to_owned());
                }
                let pixels = match ports.image {
                    Some(_) => jpeg::decode(&bytes, &head)?,
                    None => Vec::new(),
                };
                if let Some(topic) = ports.compressed {
                    let format = "jpeg".to_owned();
                    ctx.publish(topic, CompressedImage { header: header.clone(), format, data: bytes });
                }
                ("rgb8", width * 3, pixels)
            }
            Format::Yuyv => {
                let whole = bytes_per_line as usize * height as usize;
                let rows = bytes.get(..whole).ok_or("it is cut off")?;
                match self.encoding {
                    Encoding::Rgb8 => {
                        let rgb = yuyv::to_rgb(rows, width as usize, bytes_per_line as usize);
                        ("rgb8", width * 3, rgb)
                    }
                    Encoding::Yuyv | Encoding::Off => ("yuv422_yuy2", bytes_per_line, rows.to_vec()),
                }
            }
        };
        if let Some(topic) = ports.image {
            let encoding = encoding.to_owned();
            let header = header.clone();
            ctx.publish(topic, Image { header, height, width, encoding, is_bigendian: 0, step, data });
        }
        let info = match self.calibration.as_ref().filter(|_| !running.has_other_size) {
            Some(calibration) => calibration.info(header),
            None => CameraInfo { header, width, height, ..CameraInfo::default() },
        };
        ctx.publish(ports.info, info);
        Ok(())
    }

    fn set_controls(&mut self, ctx: &mut Context<'_, Ports>) {
        let controls = parsed(ctx.get::<Vec<String>>(ctx.ports.controls)).unwrap_or_default();
        if !matches!(self.state, State::Open(_)) {
            return; // they are set when it is
        }
        for (name, value) in controls {
            let exchange = self.link.exchange(&Request::Control(name, value), ctx.ports.exchanges, ctx);
            if exchange.outcome == BusExchange::FAILED {
                tracing::warn!("{}: {}", ctx.module_name(), exchange.error);
            }
        }
    }

    /// Opens the camera again with another size or rate.
    fn reopen(
        &mut self,
        width: Setting<i64>,
        height: Setting<i64>,
        rate_hz: Setting<f64>,
        ctx: &mut Context<'_, Ports>,
    ) {
        let pixels = |setting| u32::try_from(*ctx.get::<i64>(setting)).unwrap_or(1);
        (self.wanted.width, self.wanted.height) = (pixels(width), pixels(height));
        self.wanted.rate_hz = *ctx.get(rate_hz);
        self.close(ctx);
    }

    fn close(&mut self, ctx: &mut Context<'_, Ports>) {
        if let State::Open(_) = self.state {
            self.state = self.closed(Duration::ZERO, ctx);
        }
    }

    /// Closes the camera, which is open.
    fn closed(&mut self, retry: Duration, ctx: &mut Context<'_, Ports>) -> State {
        self.link.exchange(&Request::Close, ctx.ports.exchanges, ctx);
        State::Closed { retry_at: ctx.now() + retry }
    }

    fn diagnose(&mut self, ctx: &mut Context<'_, Ports>) {
        let is_damaged = self.damaged_at.is_some_and(|at| ctx.now() < at + RECENT);
        let (level, message) = match &self.state {
            State::Closed { .. } => (DiagnosticStatus::ERROR, self.complaint.text().to_owned()),
            State::Open(_) if is_damaged => (DiagnosticStatus::WARN, "pictures are damaged".to_owned()),
            State::Open(_) if !self.complaint.text().is_empty() => {
                (DiagnosticStatus::WARN, self.complaint.text().to_owned())
            }
            State::Open(_) => (DiagnosticStatus::OK, "running".to_owned()),
        };
        let name = match &self.state {
            State::Open(running) => running.granted.name.clone(),
            State::Closed { .. } => name_of(&self.wanted.device).to_owned(),
        };
        let given = ctx.get::<String>(ctx.ports.hardware_id);
        let hardware_id = if given.is_empty() { name } else { given.clone() };
        let Counts { pictures, damaged, skipped, not_opened, lost } = self.counts;
        let topic = ctx.ports.diagnostics;
        self.reporter.report(level, topic, ctx, || Status {
            message,
            hardware_id,
            values: vec![
                value("pictures", pictures),
                value("pictures damaged", damaged),
                value("pictures skipped", skipped),
                value("times the camera was lost", lost),
                value("times the camera could not be opened", not_opened),
            ],
        });
    }
}

/// The controls that a setting names.
fn parsed(controls: &[String]) -> Result<Vec<(String, i32)>, String> {
    let parse = |text: &String| {
        let (name, value) = text.split_once('=')?;
        let name = name.trim();
        (!name.is_empty()).then_some((name.to_owned(), value.trim().parse().ok()?))
    };
    let all = controls.iter().map(|text| {
        parse(text).ok_or_else(|| {
            format!("\"{text}\" is not the name of a control with a whole number, such as \"gain=20\"")
        })
    });
    all.collect()
}
