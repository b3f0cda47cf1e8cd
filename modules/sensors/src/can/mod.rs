//! CAN buses by SocketCAN.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `from_can_bus` | `can_msgs/Frame` | what was received |
//! | `to_can_bus` (in) | `can_msgs/Frame` | what is to be sent; the stamp is ignored |
//! | `diagnostics` | `diagnostic_msgs/DiagnosticArray` | once a second and when the level changes; errors of the controller in words |
//! | `can/exchanges` | `downbeat_interfaces/BusExchange` | all frames as the kernel has them, for replays |
//!
//! | setting | default | |
//! | --- | --- | --- |
//! | `interface` | `can0` | the network interface. Of an emulated bus: a log of `candump -l`, by default none |
//! | `filters` | | which frames are received, as `candump` and `ros2_socketcan` have it: `["123:7FF", "400~700"]`; all by default |
//! | `receive_own` | false | whether frames that are sent come back on `from_can_bus` |
//! | `frame_id` | `can` | |
//!
//! Topics are those of `ros2_socketcan`. CAN FD is not supported. A frame that no bus can carry is refused. A
//! frame waits for room in the driver for 0.1 s at most, and one that comes while there is no bus is dropped,
//! because a late command is worse than none; both are counted. Stamps are the times at which frames were
//! read. A bus that is lost is opened again each second. Reading waits for 5 ms at most; run the module
//! detached, as its kind does. Bit rate and restart after the state "bus off" are set with `ip link`.

mod frame;
mod log;
mod source;

use std::collections::VecDeque;
use std::time::Duration;

use downbeat_device::{Device, DeviceLink};
use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError, Time};
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::std_msgs::msg::Header;

pub use frame::{Filter, Frame, LENGTH};
pub use log::CandumpLog;
pub use source::{CanDevice, Request, Sent, SocketCan, Source, Wanted};

use crate::diagnostics::{Complaint, Reporter, Status, value};
use crate::kernel::name_of;
use frame::{Controller, Trouble};

/// How often frames are read.
const PERIOD: Duration = Duration::from_millis(10);
/// How long the module waits before it opens a bus again.
const RETRY: Duration = Duration::from_secs(1);
/// How long a frame waits for room in the driver.
const PATIENCE: Duration = Duration::from_millis(100);
/// How many frames wait for it.
const MOST_WAITING: usize = 512;
/// The most requests for frames in one run.
const MOST_READS: usize = 8;
/// How long diagnostics speak of an error.
const RECENT: Duration = Duration::from_secs(2);

/// A CAN bus; see the [module page](self).
pub struct CanBus {
    link: DeviceLink<CanDevice>,
    wanted: Wanted,
    is_emulated: bool,
    is_open: bool,
    retry_at: Time,
    complaint: Complaint,
    waiting: VecDeque<(Time, [u8; LENGTH])>,
    controller: Controller,
    /// The last error or refusal: when, and what.
    trouble: Option<(Time, String)>,
    /// Of the controller, on sending and on reception.
    error_counters: Option<[u8; 2]>,
    counts: Counts,
    reporter: Reporter,
}

#[derive(Debug, Default)]
struct Counts {
    received: u64,
    sent: u64,
    refused: u64,
    dropped: u64,
    errors: u64,
    not_opened: u64,
    lost: u64,
}

/// The keys of [`CanBus`].
pub struct Ports {
    received: Publication<Frame>,
    exchanges: Publication<BusExchange>,
    diagnostics: Publication<DiagnosticArray>,
    frame_id: Setting<String>,
}

impl Module for CanBus {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let about = "the network interface; of an emulated bus a log of candump -l, or empty";
        let default = if self.is_emulated { "" } else { "can0" };
        let interface = setup.read_only_setting("interface", default.to_owned(), about)?;
        let about = "which frames are received, such as \"123:7FF\" or \"400~700\"; all if empty";
        let filters = setup.read_only_setting("filters", Vec::<String>::new(), about)?;
        let about = "whether frames that are sent come back";
        let receive_own = setup.read_only_setting("receive_own", false, about)?;
        let frame_id = setup.setting("frame_id", "can".to_owned(), "frame of from_can_bus")?;
        let given = setup.value(filters).cloned().unwrap_or_default();
        self.wanted = Wanted {
            interface: setup.value(interface).cloned().unwrap_or_default(),
            filters: Filter::parse_all(&given).map_err(|problem| setup.refuse_value(filters, problem))?,
            receives_own: setup.value(receive_own) == Some(&true),
        };
        setup.subscribe("to_can_bus", Self::on_frame)?;
        setup.every(PERIOD, Self::run)?;
        Ok(Ports {
            received: setup.publish("from_can_bus")?,
            exchanges: setup.publish(CanDevice::TOPIC)?,
            diagnostics: setup.publish("diagnostics")?,
            frame_id,
        })
    }

    opened_while_active!();
}

impl CanBus {
    /// A bus of this machine.
    #[must_use]
    pub fn new(link: DeviceLink<CanDevice>) -> Self {
        Self {
            link,
            wanted: Wanted::default(),
            is_emulated: false,
            is_open: false,
            retry_at: Time::ZERO,
            complaint: Complaint::default(),
            waiting: VecDeque::new(),
            controller: Controller::Active,
            trouble: None,
            error_counters: None,
            counts: Counts::default(),
            reporter: Reporter::default(),
        }
    }

    /// An emulated bus, on which nothing comes by itself unless its setting `interface` names a log.
    #[must_use]
    pub fn emulated(link: DeviceLink<CanDevice>) -> Self {
        Self { is_emulated: true, ..Self::new(link) }
    }

    fn open_soon(&mut self) {
        self.retry_at = Time::ZERO;
    }

    fn on_frame(&mut self, frame: Received<'_, Frame>, ctx: &mut Context<'_, Ports>) {
        match frame.emit() {
            Ok(bytes) if self.is_open => {
                if self.waiting.len() == MOST_WAITING {
                    self.waiting.pop_front();
                    self.drop_frames(1, "the driver has no room", ctx);
                }
                self.waiting.push_back((ctx.now(), bytes));
                self.send(ctx);
            }
            Ok(_) => self.drop_frames(1, "the bus is not open", ctx),
            Err(problem) => {
                self.counts.refused += 1;
                let (count, name) = (self.counts.refused, ctx.module_name());
                if count.is_power_of_two() {
                    tracing::warn!("{name}: a frame of to_can_bus is refused ({count} so far): {problem}");
                }
                self.trouble = Some((ctx.now(), format!("a frame was refused: {problem}")));
            }
        }
    }

    fn run(&mut self, ctx: &mut Context<'_, Ports>) {
        if !self.is_open && ctx.now() >= self.retry_at {
            self.open(ctx);
        }
        if self.is_open {
            self.send(ctx);
            self.receive(ctx);
        }
        self.diagnose(ctx);
    }

    fn open(&mut self, ctx: &mut Context<'_, Ports>) {
        let exchange = self.link.exchange(&Request::Open(self.wanted.clone()), ctx.ports.exchanges, ctx);
        self.is_open = exchange.outcome == BusExchange::OK;
        if self.is_open {
            tracing::info!("{}: {} is open", ctx.module_name(), self.name());
            self.complaint.clear();
            self.controller = Controller::Active;
            self.error_counters = None;
        } else {
            self.counts.not_opened += 1;
            self.retry_at = ctx.now() + RETRY;
            self.complaint.say(&format!("{}; this is tried again every second", exchange.error), ctx);
        }
    }

    /// Sends what waits, as far as the driver has room.
    fn send(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        let late =
            self.waiting.iter().take_while(|(since, _)| now.saturating_since(*since) > PATIENCE).count();
        if late > 0 {
            self.waiting.drain(..late);
            self.drop_frames(late as u64, "the driver has no room", ctx);
        }
        while self.is_open
            && let Some((_, frame)) = self.waiting.front()
        {
            let exchange = self.link.exchange(&Request::Send(*frame), ctx.ports.exchanges, ctx);
            match exchange.outcome {
                BusExchange::OK => {
                    self.waiting.pop_front();
                    self.counts.sent += 1;
                }
                BusExchange::TIMEOUT => break,
                _ => self.lose(&exchange.error, ctx),
            }
        }
    }

    fn receive(&mut self, ctx: &mut Context<'_, Ports>) {
        for _ in 0..MOST_READS {
            if !self.is_open {
                return;
            }
            let exchange = self.link.exchange(&Request::Receive, ctx.ports.exchanges, ctx);
            if exchange.outcome == BusExchange::FAILED {
                self.lose(&exchange.error, ctx);
                return;
            }
            for bytes in exchange.reply.chunks_exact(LENGTH).filter_map(|chunk| chunk.first_chunk()) {
                let frame_id = ctx.get::<String>(ctx.ports.frame_id).clone();
                let frame = Frame::parse(bytes, Header { stamp: exchange.stamp, frame_id });
                if frame.is_error {
                    self.take_error(&frame, ctx);
                } else {
                    self.counts.received += 1;
                    if self.controller == Controller::Off {
                        self.controller = Controller::Active;
                    }
                    ctx.publish(ctx.ports.received, frame);
                }
            }
            if exchange.reply.len() < source::MOST_FRAMES * LENGTH {
                return;
            }
        }
    }

    fn take_error(&mut self, frame: &Frame, ctx: &Context<'_, Ports>) {
        let trouble = Trouble::of(frame);
        self.counts.errors += 1;
        // `CAN_ERR_CNT`: the counters of the controller.
        if frame.id & 0x200 != 0 {
            self.error_counters = Some([frame.data[6], frame.data[7]]);
        }
        if let Some(controller) = trouble.controller
            && std::mem::replace(&mut self.controller, controller) != controller
        {
            let name = ctx.module_name();
            match controller {
                Controller::Active => tracing::info!("{name}: the controller works again"),
                _ => tracing::warn!("{name}: {}", words_of(controller)),
            }
        }
        self.trouble = Some((ctx.now(), trouble.words.join("; ")));
    }

    fn drop_frames(&mut self, count: u64, why: &str, ctx: &Context<'_, Ports>) {
        let before = self.counts.dropped;
        self.counts.dropped += count;
        if before.checked_ilog10() != self.counts.dropped.checked_ilog10() {
            let dropped = self.counts.dropped;
            tracing::warn!(
                "{}: frames of to_can_bus are dropped ({dropped} so far): {why}",
                ctx.module_name()
            );
        }
        self.trouble = Some((ctx.now(), format!("frames were not sent: {why}")));
    }

    fn lose(&mut self, reason: &str, ctx: &mut Context<'_, Ports>) {
        self.counts.lost += 1;
        self.complaint.say(reason, ctx);
        self.close(ctx);
    }

    fn close(&mut self, ctx: &mut Context<'_, Ports>) {
        if std::mem::take(&mut self.is_open) {
            self.link.exchange(&Request::Close, ctx.ports.exchanges, ctx);
        }
        let left = self.waiting.len() as u64;
        self.waiting.clear();
        if left > 0 {
            self.drop_frames(left, "the bus was closed", ctx);
        }
        self.retry_at = ctx.now() + RETRY;
    }

    fn name(&self) -> &str {
        if self.wanted.interface.is_empty() { "an emulated bus" } else { name_of(&self.wanted.interface) }
    }

    fn diagnose(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        let recent = self.trouble.as_ref().filter(|(at, _)| now < *at + RECENT).map(|(_, what)| what.clone());
        let (level, message) = match (self.is_open, self.controller, recent) {
            (false, ..) => (DiagnosticStatus::ERROR, self.complaint.text().to_owned()),
            (true, Controller::Off, _) => (DiagnosticStatus::ERROR, words_of(Controller::Off).to_owned()),
            (true, Controller::Active, None) => (DiagnosticStatus::OK, "running".to_owned()),
            (true, Controller::Active, Some(what)) => (DiagnosticStatus::WARN, what),
            (true, controller, _) => (DiagnosticStatus::WARN, words_of(controller).to_owned()),
        };
        let Counts { received, sent, refused, dropped, errors, not_opened, lost } = self.counts;
        let (hardware_id, counters, topic) =
            (self.name().to_owned(), self.error_counters, ctx.ports.diagnostics);
        self.reporter.report(level, topic, ctx, || {
            let mut values = vec![
                value("frames received", received),
                value("frames sent", sent),
                value("frames refused", refused),
                value("frames not sent", dropped),
                value("error frames", errors),
                value("times the bus was lost", lost),
                value("times the bus could not be opened", not_opened),
            ];
            if let Some([on_sending, on_reception]) = counters {
                values.push(value("errors on sending, as the controller counts", on_sending));
                values.push(value("errors on reception, as the controller counts", on_reception));
            }
            Status { message, hardware_id, values }
        });
    }
}

fn words_of(controller: Controller) -> &'static str {
    match controller {
        Controller::Active => "running",
        Controller::Warning => "many errors on the bus; check wiring, termination and bit rate",
        Controller::Passive => {
            "the controller is passive: too many errors; check wiring, termination and bit rate"
        }
        Controller::Off => {
            "the controller is off the bus: check wiring, termination and bit rate, and let it restart (ip link set … type can restart-ms 100)"
        }
    }
}
