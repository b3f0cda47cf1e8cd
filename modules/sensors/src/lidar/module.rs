//! The module that drives a lidar.

use std::time::Duration;

use downbeat_device::{Device, DeviceLink};
use downbeat_executor::{Context, Module, Publication, Setup, SetupError, Time, TransitionError};
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::sensor_msgs::msg::LaserScan;

use super::scan::{ScanBuilder, ScanSettings};
use super::{Model, Protocol, Sample};
use crate::diagnostics::{Reporter, Status, value};
use crate::serial::{Event, Line, PortSettings, Role, SerialDevice};

/// How often the port is read. A read waits for bytes, so that it returns when they come.
const PERIOD: Duration = Duration::from_millis(5);
/// A lidar that has sent no scan for so long is reported.
const SILENCE: Duration = Duration::from_secs(2);

/// The port of a lidar.
pub struct LidarPort;

impl Role for LidarPort {
    const TOPIC: &'static str = "lidar/exchanges";
}

/// A lidar on a serial port.
///
/// | topic | type | |
/// | --- | --- | --- |
/// | `scan` | `sensor_msgs/LaserScan` | one revolution, see [`scan`](super::scan) |
/// | `diagnostics` | `diagnostic_msgs/DiagnosticArray` | once a second and when the level changes |
/// | `lidar/exchanges` | `downbeat_interfaces/BusExchange` | all bytes of the port, for replays |
///
/// Run it detached: it waits for bytes, at most 50 ms. docs/sensors.md lists the settings.
pub struct Lidar {
    line: Line<LidarPort>,
    model: Model,
    protocol: Box<dyn Protocol>,
    scans: Option<ScanBuilder>,
    samples: Vec<Sample>,
    hardware_id: String,
    count: u64,
    /// When the last scan was published, or the port was opened.
    heard: Time,
    reporter: Reporter,
}

/// The keys of [`Lidar`].
pub struct Ports {
    scan: Publication<LaserScan>,
    exchanges: Publication<BusExchange>,
    diagnostics: Publication<DiagnosticArray>,
}

impl Lidar {
    /// A lidar behind this link.
    #[must_use]
    pub fn new(link: DeviceLink<SerialDevice<LidarPort>>) -> Self {
        Self {
            line: Line::new(link),
            model: Model::default(),
            protocol: Model::default().protocol(),
            scans: None,
            samples: Vec::new(),
            hardware_id: String::new(),
            count: 0,
            heard: Time::ZERO,
            reporter: Reporter::default(),
        }
    }

    fn run(&mut self, ctx: &mut Context<'_, Ports>) {
        let (exchanges, topic) = (ctx.ports.exchanges, ctx.ports.scan);
        match self.line.step(exchanges, ctx) {
            Event::Opened => {
                self.heard = ctx.now();
                self.protocol.opened(ctx.now());
                if let Some(scans) = &mut self.scans {
                    scans.reset();
                }
            }
            Event::Bytes(bytes, arrived) => {
                self.protocol.take(&bytes, arrived, &mut self.samples);
                for sample in self.samples.drain(..) {
                    let Some(revolution) = self.scans.as_mut().and_then(|scans| scans.push(&sample)) else {
                        continue;
                    };
                    let duration = self.protocol.revolution(revolution.measurements);
                    ctx.publish(topic, revolution.into_scan(duration));
                    self.count += 1;
                    self.heard = ctx.now();
                }
            }
            Event::Silent | Event::Closed => {}
        }
        if self.line.is_open()
            && let Some(request) = self.protocol.request(ctx.now())
        {
            self.line.send(request, exchanges, ctx);
        }
        self.diagnose(ctx);
    }

    fn diagnose(&mut self, ctx: &mut Context<'_, Ports>) {
        let counts = self.protocol.counts();
        let is_silent = self.heard + SILENCE <= ctx.now();
        let (level, message) = match self.protocol.fault() {
            _ if !self.line.is_open() => (DiagnosticStatus::ERROR, self.line.failure()),
            Some(fault) => (DiagnosticStatus::ERROR, fault),
            None if is_silent && counts.packets == 0 && counts.skipped > 0 => (
                DiagnosticStatus::ERROR,
                "bytes come, but no packet of this lidar: are \"model\" and \"baud\" right?",
            ),
            None if is_silent => (
                DiagnosticStatus::ERROR,
                "no scan comes: has the lidar power, does it turn, and is its data wire connected?",
            ),
            None if self.count == 0 => (DiagnosticStatus::WARN, "waiting for the first scan"),
            None => (DiagnosticStatus::OK, "scanning"),
        };
        let status = || {
            let mut values = self.line.values();
            values.extend([
                value("scans", self.count),
                value("packets", counts.packets),
                value("corrupt packets", counts.corrupt),
                value("bytes skipped", counts.skipped),
            ]);
            Status { message: message.to_owned(), hardware_id: self.hardware_id.clone(), values }
        };
        self.reporter.report(level, ctx.ports.diagnostics, ctx, status);
    }

    fn stop(&mut self, ctx: &mut Context<'_, Ports>) {
        let topic = ctx.ports.exchanges;
        if self.line.is_open()
            && let Some(request) = self.protocol.farewell()
        {
            self.line.send(request, topic, ctx);
        }
        self.line.close(topic, ctx);
    }
}

impl Module for Lidar {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let model = setup.read_only_choice("model", "ld19", &Model::NAMES, "which lidar it is")?;
        let port =
            setup.read_only_setting("port", "/dev/ttyUSB0".to_owned(), "serial port, or memory:NAME")?;
        let baud = setup.read_only_setting("baud", 0_i64, "bit/s; 0 for the speed of the model")?;
        let frame_id =
            setup.read_only_setting("frame_id", "laser".to_owned(), "frame of the scans: x forward, z up")?;
        let about = "the lidar's own direction that lies on the x axis of the frame, in degrees clockwise";
        let forward = setup.read_only_setting("forward_deg", 0.0, about)?;
        let beams = setup.read_only_setting(
            "beams",
            0_i64,
            "beams of a scan; 0 for the measurements of the model",
        )?;
        let near = setup.read_only_setting("range_min", 0.0, "m; nearer is -inf; 0 for that of the model")?;
        let far = setup.read_only_setting("range_max", 0.0, "m; farther is inf; 0 for that of the model")?;
        let about = "weaker echoes are no echoes; LD06, LD19: up to 255, RPLIDAR: up to 63";
        let weakest = setup.read_only_setting("min_intensity", 0.0, about)?;
        let about = "what a measurement without echo means: inf (free space) or nan (nothing known)";
        let no_echo = setup.read_only_choice("no_echo", "inf", &["inf", "nan"], about)?;
        let about = "the device in diagnostics; empty for the model; say there if it is emulated";
        let hardware_id = setup.read_only_setting("hardware_id", String::new(), about)?;

        self.model = setup.value(model).and_then(|name| Model::named(name)).unwrap_or_default();
        let data = self.model.data();
        let given = |setting| setup.value(setting).copied().unwrap_or_default();
        let baud_rate = match u32::try_from(given(baud)) {
            Ok(0) => data.baud,
            Ok(rate) => rate,
            Err(_) => return Err(setup.refuse_value(baud, "it is a speed in bit/s, such as 230400, or 0")),
        };
        let count = match usize::try_from(given(beams)) {
            Ok(0) => data.beams,
            Ok(count) if (4..=7200).contains(&count) => count,
            _ => return Err(setup.refuse_value(beams, "it is a number from 4 to 7200, or 0")),
        };
        let given = |setting| setup.value(setting).copied().unwrap_or_default();
        let or_model = |given: f64, of_model: f64| if given > 0.0 { given } else { of_model };
        let range = [or_model(given(near), data.range[0]), or_model(given(far), data.range[1])];
        if range[0] >= range[1] {
            let refusal = format!("it has to be less than range_max, {} m", range[1]);
            return Err(setup.refuse_value(near, refusal));
        }
        if !given(forward).is_finite() {
            return Err(setup.refuse_value(forward, "it has to be a finite angle"));
        }
        let text = |setting| setup.value(setting).cloned().unwrap_or_default();
        self.scans = Some(ScanBuilder::new(ScanSettings {
            frame_id: text(frame_id),
            beams: count,
            forward_deg: given(forward),
            range,
            min_intensity: given(weakest) as f32,
            no_echo: if text(no_echo) == "nan" { f32::NAN } else { f32::INFINITY },
        }));
        self.hardware_id =
            Some(text(hardware_id)).filter(|id| !id.is_empty()).unwrap_or(data.title.to_owned());
        self.protocol = self.model.protocol();
        self.line.configure(PortSettings {
            path: text(port),
            baud: baud_rate,
            data_terminal_ready: data.data_terminal_ready,
        });
        setup.every(PERIOD, Self::run)?;
        Ok(Ports {
            scan: setup.publish("scan")?,
            exchanges: setup.publish(SerialDevice::<LidarPort>::TOPIC)?,
            diagnostics: setup.publish("diagnostics")?,
        })
    }

    fn deactivate(&mut self, ctx: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        self.stop(ctx);
        Ok(())
    }

    fn shutdown(&mut self, ctx: &mut Context<'_, Ports>) {
        self.stop(ctx);
    }
}
