//! The module that reads a receiver.

use std::time::Duration;

use downbeat_device::{Device, DeviceLink};
use downbeat_executor::{Context, Module, Publication, Setting, Setup, SetupError, Time, TransitionError};
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::geometry_msgs::msg::TwistStamped;
use downbeat_msgs::sensor_msgs::msg::{NavSatFix, TimeReference};

use super::sentence::Receiver;
use super::solution::{Deviations, Output, Solution, SolutionSettings};
use crate::diagnostics::{Reporter, Status, value};
use crate::serial::{Event, Line, PortSettings, Role, SerialDevice};

/// How often the port is read. A read waits for bytes, so that it returns when they come.
const PERIOD: Duration = Duration::from_millis(10);
/// A receiver that has sent no sentence for so long is reported.
const SILENCE: Duration = Duration::from_secs(3);

/// The port of a receiver.
pub struct GpsPort;

impl Role for GpsPort {
    const TOPIC: &'static str = "gps/exchanges";
}

/// A receiver that speaks NMEA 0183 on a serial port.
///
/// | topic | type | |
/// | --- | --- | --- |
/// | `fix` | `sensor_msgs/NavSatFix` | with each GGA; without a fix NaN and `STATUS_NO_FIX` |
/// | `vel` | `geometry_msgs/TwistStamped` | m/s, x east, y north |
/// | `time_reference` | `sensor_msgs/TimeReference` | the time of the receiver |
/// | `diagnostics` | `diagnostic_msgs/DiagnosticArray` | once a second and when the level changes |
/// | `gps/exchanges` | `downbeat_interfaces/BusExchange` | all bytes of the port, for replays |
///
/// Run it detached: it waits for bytes, at most 50 ms. docs/sensors.md lists the settings.
pub struct Gps {
    line: Line<GpsPort>,
    baud: u32,
    receiver: Receiver,
    solution: Solution,
    hardware_id: String,
    /// When the last sentence came, or the port was opened.
    heard: Time,
    reporter: Reporter,
}

/// The keys of [`Gps`].
pub struct Ports {
    fix: Publication<NavSatFix>,
    velocity: Publication<TwistStamped>,
    time: Publication<TimeReference>,
    exchanges: Publication<BusExchange>,
    diagnostics: Publication<DiagnosticArray>,
}

impl Gps {
    /// A receiver behind this link.
    #[must_use]
    pub fn new(link: DeviceLink<SerialDevice<GpsPort>>) -> Self {
        Self {
            line: Line::new(link),
            baud: 0,
            receiver: Receiver::default(),
            solution: Solution::default(),
            hardware_id: String::new(),
            heard: Time::ZERO,
            reporter: Reporter::default(),
        }
    }

    fn run(&mut self, ctx: &mut Context<'_, Ports>) {
        match self.line.step(ctx.ports.exchanges, ctx) {
            Event::Opened => {
                self.heard = ctx.now();
                self.receiver.reset();
                self.solution.reset();
            }
            Event::Bytes(bytes, arrived) => {
                self.receiver.push(&bytes);
                while let Some((sentence, following)) = self.receiver.next_sentence() {
                    self.heard = ctx.now();
                    // What follows was on the line after it: ten bits each.
                    let nanoseconds = following as u64 * 10_000_000_000 / u64::from(self.baud.max(1));
                    let arrived = arrived - Duration::from_nanos(nanoseconds);
                    let (fix, velocity, time) = (ctx.ports.fix, ctx.ports.velocity, ctx.ports.time);
                    self.solution.take(&sentence, arrived, |output| match output {
                        Output::Fix(message) => ctx.publish(fix, message),
                        Output::Velocity(message) => ctx.publish(velocity, message),
                        Output::Time(message) => ctx.publish(time, message),
                    });
                }
            }
            Event::Silent | Event::Closed => {}
        }
        self.diagnose(ctx);
    }

    fn diagnose(&mut self, ctx: &mut Context<'_, Ports>) {
        let counts = self.receiver.counts();
        let is_silent = self.heard + SILENCE <= ctx.now();
        let satellites = self.solution.satellites();
        let (level, message) = match (self.line.is_open(), self.solution.has_fix()) {
            (false, _) => (DiagnosticStatus::ERROR, self.line.failure().to_owned()),
            (true, _) if is_silent && counts.sentences == 0 && counts.skipped + counts.corrupt > 0 => (
                DiagnosticStatus::ERROR,
                format!("bytes come, but no sentence of NMEA: is \"baud\" = {} right?", self.baud),
            ),
            (true, _) if is_silent => (
                DiagnosticStatus::ERROR,
                "nothing comes: has the receiver power, and is its data wire connected?".to_owned(),
            ),
            (true, false) => (
                DiagnosticStatus::WARN,
                format!("no fix, {satellites} satellites: does the antenna see the sky?"),
            ),
            (true, true) => (DiagnosticStatus::OK, format!("fix from {satellites} satellites")),
        };
        let status = || {
            let mut values = self.line.values();
            values.extend([
                value("sentences", counts.sentences),
                value("corrupt sentences", counts.corrupt),
                value("bytes skipped", counts.skipped),
                value("satellites", satellites),
            ]);
            Status { message, hardware_id: self.hardware_id.clone(), values }
        };
        self.reporter.report(level, ctx.ports.diagnostics, ctx, status);
    }
}

impl Module for Gps {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let port =
            setup.read_only_setting("port", "/dev/ttyUSB0".to_owned(), "serial port, or memory:NAME")?;
        let baud = setup.read_only_setting("baud", 9600_i64, "bit/s")?;
        let frame_id = setup.read_only_setting("frame_id", "gps".to_owned(), "frame of the antenna")?;
        let about = "the source in time_reference; empty for frame_id";
        let source = setup.read_only_setting("time_ref_source", String::new(), about)?;
        let about = "positions come from RMC, without altitude and covariance, instead of GGA";
        let uses_rmc = setup.read_only_setting("use_rmc", false, about)?;
        let default = Deviations::default();
        let mut epe = |quality: &str, default: f64, what: &str| {
            let about = format!("m; deviation of {what} at HDOP 1, if the receiver sends no GST");
            setup.read_only_setting(&format!("epe_quality{quality}"), default, &about)
        };
        let epe: [Setting<f64>; 5] = [
            epe("1", default.fix, "a position")?,
            epe("2", default.differential, "a differential position")?,
            epe("4", default.rtk, "an RTK position")?,
            epe("5", default.rtk_float, "an RTK position without whole cycles")?,
            epe("9", default.satellite_based, "a position with satellite-based corrections")?,
        ];
        let about = "the device in diagnostics; say there if it is emulated";
        let hardware_id = setup.read_only_setting("hardware_id", "GPS".to_owned(), about)?;

        let rate = setup.value(baud).and_then(|baud| u32::try_from(*baud).ok()).filter(|baud| *baud > 0);
        self.baud = rate.ok_or_else(|| setup.refuse_value(baud, "it is a speed in bit/s, such as 9600"))?;
        for setting in epe {
            if !setup.value(setting).is_some_and(|metres| metres.is_finite() && *metres >= 0.0) {
                return Err(setup.refuse_value(setting, "it is a distance in m, 0 or more"));
            }
        }
        let [fix, differential, rtk, rtk_float, satellite_based] =
            epe.map(|setting| setup.value(setting).copied().unwrap_or_default());
        let text = |setting| setup.value(setting).cloned().unwrap_or_default();
        let (frame_id, source) = (text(frame_id), text(source));
        self.solution = Solution::new(SolutionSettings {
            time_source: if source.is_empty() { frame_id.clone() } else { source },
            frame_id,
            uses_rmc: setup.value(uses_rmc).copied().unwrap_or_default(),
            deviations: Deviations { fix, differential, rtk, rtk_float, satellite_based },
        });
        self.hardware_id = text(hardware_id);
        self.line.configure(PortSettings { path: text(port), baud: self.baud, data_terminal_ready: None });
        setup.every(PERIOD, Self::run)?;
        Ok(Ports {
            fix: setup.publish("fix")?,
            velocity: setup.publish("vel")?,
            time: setup.publish("time_reference")?,
            exchanges: setup.publish(SerialDevice::<GpsPort>::TOPIC)?,
            diagnostics: setup.publish("diagnostics")?,
        })
    }

    fn deactivate(&mut self, ctx: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        self.line.close(ctx.ports.exchanges, ctx);
        Ok(())
    }

    fn shutdown(&mut self, ctx: &mut Context<'_, Ports>) {
        self.line.close(ctx.ports.exchanges, ctx);
    }
}
