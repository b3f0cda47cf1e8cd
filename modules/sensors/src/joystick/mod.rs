//! Joysticks and gamepads, and driving with them.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `joy` | `sensor_msgs/Joy` | axes from -1 to 1, positive at the left and at the top; buttons 0 or 1 |
//! | `diagnostics` | `diagnostic_msgs/DiagnosticArray` | once a second and when the level changes |
//! | `joystick/exchanges` | `downbeat_interfaces/BusExchange` | the events of the kernel as they came, for replays |
//!
//! | setting | default | |
//! | --- | --- | --- |
//! | `device` | | a device file such as `/dev/input/by-id/usb-…-event-joystick`, or the name of a joystick; the first one by default. Of an emulated joystick: a file of events or a pipe |
//! | `deadzone` | 0.05 | how far from the centre an axis is still 0; the rest is stretched to reach 1 |
//! | `autorepeat_rate` | 20 | Hz at which a state is repeated that does not change; 0: never |
//! | `coalesce_interval_ms` | 5 | ms within which movements of axes become one message; pressed and released buttons never do |
//! | `sticky_buttons` | false | a button switches at each press |
//! | `frame_id` | `joy` | |
//!
//! Names and meaning are those of the node `joy` of ROS; the order of axes and buttons is that of the
//! joystick driver of Linux, as `joy_linux` has it. When a joystick is lost, all axes and buttons return to 0
//! in one last message, and the module opens a joystick again each second. Stamps are the times at which the
//! events were read. Reading waits for 40 ms at most; run the module detached, as its kind does.
//!
//! # References
//! `joy/README.md` and `joy_linux` of `ros-drivers/joystick_drivers`.

mod events;
mod recorded;
mod source;
pub mod teleop;

use std::time::Duration;

use downbeat_device::{Device, DeviceLink};
use downbeat_executor::{Context, Module, Publication, Setting, Setup, SetupError, Time};
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::sensor_msgs::msg::Joy;

pub use events::{Axis, Button, Event, Layout};
pub use recorded::RecordedEvents;
pub use source::{Evdev, InputDevice, Request, Source};

use crate::diagnostics::{Complaint, Reporter, Status, header, value};
use crate::kernel::name_of;
use events::{ABSOLUTE, DROPPED, KEY, REPORT, Receiver, SYNCHRONISATION};

/// How long the module waits before it opens a joystick again.
const RETRY: Duration = Duration::from_secs(1);

/// A joystick; see the [module page](self).
pub struct Joystick {
    link: DeviceLink<InputDevice>,
    device: String,
    state: State,
    complaint: Complaint,
    published_at: Option<Time>,
    counts: Counts,
    reporter: Reporter,
}

enum State {
    Closed { retry_at: Time },
    Open(Held),
}

/// A joystick that is open.
struct Held {
    receiver: Receiver,
    layout: Layout,
    /// For sticky buttons: how they are switched.
    switched: Vec<bool>,
    /// Events were lost: nothing is believed before the next report.
    is_behind: bool,
}

#[derive(Debug, Default)]
struct Counts {
    events: u64,
    overruns: u64,
    not_opened: u64,
    lost: u64,
}

/// The keys of [`Joystick`].
pub struct Ports {
    joy: Publication<Joy>,
    exchanges: Publication<BusExchange>,
    diagnostics: Publication<DiagnosticArray>,
    deadzone: Setting<f64>,
    autorepeat_rate: Setting<f64>,
    sticky_buttons: Setting<bool>,
    frame_id: Setting<String>,
}

impl Module for Joystick {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let about = "a device file or the name of a joystick, the first one if empty; of an emulated one a file of events";
        let device = setup.read_only_setting("device", String::new(), about)?;
        let about = "how far from the centre an axis is still 0, as a share of its way";
        let deadzone = setup.setting_in("deadzone", 0.05, 0.0..=0.9, about)?;
        let about = "Hz; a state that does not change is repeated at this rate; 0 for never";
        let autorepeat_rate = setup.setting_in("autorepeat_rate", 20.0, 0.0..=1_000.0, about)?;
        let about = "ms within which movements of axes become one message";
        let coalesce = setup.setting_in("coalesce_interval_ms", 5_i64, 1.0..=1_000.0, about)?;
        let sticky_buttons =
            setup.setting("sticky_buttons", false, "whether a button switches at each press")?;
        let frame_id = setup.setting("frame_id", "joy".to_owned(), "frame of joy")?;
        self.device = setup.value(device).cloned().unwrap_or_default();
        let rate = setup.value(autorepeat_rate).copied().unwrap_or_default();
        let interval = setup.value(coalesce).and_then(|ms| u64::try_from(*ms).ok()).unwrap_or(1);
        if let Some(device) = self.link.device()
            && rate > 0.0
        {
            device.set_wait(Duration::from_secs_f64(0.5 / rate));
        }
        setup.every(Duration::from_millis(interval.max(1)), Self::run)?;
        Ok(Ports {
            joy: setup.publish("joy")?,
            exchanges: setup.publish(InputDevice::TOPIC)?,
            diagnostics: setup.publish("diagnostics")?,
            deadzone,
            autorepeat_rate,
            sticky_buttons,
            frame_id,
        })
    }

    opened_while_active!();
}

impl Joystick {
    /// A joystick on this link.
    #[must_use]
    pub fn new(link: DeviceLink<InputDevice>) -> Self {
        Self {
            link,
            device: String::new(),
            state: State::Closed { retry_at: Time::ZERO },
            complaint: Complaint::default(),
            published_at: None,
            counts: Counts::default(),
            reporter: Reporter::default(),
        }
    }

    fn open_soon(&mut self) {
        self.state = State::Closed { retry_at: Time::ZERO };
    }

    fn run(&mut self, ctx: &mut Context<'_, Ports>) {
        match &self.state {
            State::Closed { retry_at } if ctx.now() < *retry_at => {}
            State::Closed { .. } => self.open(ctx),
            State::Open(_) => self.read(ctx),
        }
        let rate = *ctx.get(ctx.ports.autorepeat_rate);
        let is_due = self
            .published_at
            .is_none_or(|at| rate > 0.0 && ctx.now().saturating_since(at).as_secs_f64() * rate >= 1.0 - 1e-9);
        if is_due && let State::Open(held) = &self.state {
            let message = held.message(ctx);
            self.publish(message, ctx);
        }
        self.diagnose(ctx);
    }

    fn open(&mut self, ctx: &mut Context<'_, Ports>) {
        let exchange = self.link.exchange(&Request::Open(self.device.clone()), ctx.ports.exchanges, ctx);
        match layout_of(exchange) {
            Ok(layout) => {
                let (axes, buttons) = (layout.axes.len(), layout.buttons.len());
                let name = ctx.module_name();
                tracing::info!("{name}: \"{}\" has {axes} axes and {buttons} buttons", layout.name);
                self.complaint.clear();
                let switched = vec![false; buttons];
                self.state =
                    State::Open(Held { receiver: Receiver::default(), layout, switched, is_behind: false });
                self.published_at = None;
            }
            Err(reason) => {
                self.counts.not_opened += 1;
                self.state = State::Closed { retry_at: ctx.now() + RETRY };
                self.complaint.say(&format!("{reason}; this is tried again every second"), ctx);
            }
        }
    }

    fn read(&mut self, ctx: &mut Context<'_, Ports>) {
        let exchange = self.link.exchange(&Request::Read, ctx.ports.exchanges, ctx);
        if exchange.outcome == BusExchange::FAILED {
            self.lose(&exchange.error, ctx);
            return;
        }
        let is_sticky = *ctx.get(ctx.ports.sticky_buttons);
        let mut messages = Vec::new();
        let State::Open(held) = &mut self.state else { return };
        let (mut has_moved, mut has_overrun) = (false, false);
        for event in held.receiver.push(&exchange.reply) {
            self.counts.events += 1;
            match (event.kind, event.code) {
                (SYNCHRONISATION, DROPPED) => (held.is_behind, has_overrun) = (true, true),
                (SYNCHRONISATION, REPORT) => held.is_behind = false,
                _ if held.is_behind => {}
                (ABSOLUTE, code) => {
                    let axis = held.layout.axes.iter_mut().find(|axis| axis.code == code);
                    if let Some(axis) = axis.filter(|axis| axis.value != event.value) {
                        axis.value = event.value;
                        has_moved = true;
                    }
                }
                // A value of 2 is a button that is held.
                (KEY, code) if event.value < 2 => {
                    let place = held.layout.buttons.iter().position(|button| button.code == code);
                    let Some(place) = place else { continue };
                    let is_pressed = event.value != 0;
                    if std::mem::replace(&mut held.layout.buttons[place].is_pressed, is_pressed) != is_pressed
                    {
                        held.switched[place] ^= is_pressed;
                        if !is_sticky || is_pressed {
                            messages.push(held.message(ctx));
                        }
                        has_moved = false;
                    }
                }
                _ => {}
            }
        }
        if has_moved {
            messages.push(held.message(ctx));
        }
        for message in messages {
            self.publish(message, ctx);
        }
        if has_overrun {
            self.catch_up(ctx);
        }
    }

    /// Asks where everything stands, after events were lost.
    fn catch_up(&mut self, ctx: &mut Context<'_, Ports>) {
        self.counts.overruns += 1;
        match layout_of(self.link.exchange(&Request::Layout, ctx.ports.exchanges, ctx)) {
            Ok(layout) => {
                if let State::Open(held) = &mut self.state {
                    held.switched.resize(layout.buttons.len(), false);
                    held.layout = layout;
                    let message = held.message(ctx);
                    self.publish(message, ctx);
                }
            }
            Err(reason) => self.lose(&reason, ctx),
        }
    }

    fn publish(&mut self, message: Joy, ctx: &mut Context<'_, Ports>) {
        self.published_at = Some(ctx.now());
        ctx.publish(ctx.ports.joy, message);
    }

    fn lose(&mut self, reason: &str, ctx: &mut Context<'_, Ports>) {
        self.counts.lost += 1;
        self.complaint.say(reason, ctx);
        self.close(ctx);
    }

    /// Closes the joystick. Whoever drives with it learns that nothing is pressed any more.
    fn close(&mut self, ctx: &mut Context<'_, Ports>) {
        let closed = State::Closed { retry_at: ctx.now() + RETRY };
        if let State::Open(held) = std::mem::replace(&mut self.state, closed) {
            self.link.exchange(&Request::Close, ctx.ports.exchanges, ctx);
            let Joy { header, axes, buttons } = held.message(ctx);
            let (axes, buttons) = (vec![0.0; axes.len()], vec![0; buttons.len()]);
            self.publish(Joy { header, axes, buttons }, ctx);
        }
    }

    fn diagnose(&mut self, ctx: &mut Context<'_, Ports>) {
        let (level, message, hardware_id) = match &self.state {
            State::Open(held) => (DiagnosticStatus::OK, "running".to_owned(), held.layout.name.clone()),
            State::Closed { .. } => {
                (DiagnosticStatus::ERROR, self.complaint.text().to_owned(), name_of(&self.device).to_owned())
            }
        };
        let Counts { events, overruns, not_opened, lost } = self.counts;
        let topic = ctx.ports.diagnostics;
        self.reporter.report(level, topic, ctx, || Status {
            message,
            hardware_id,
            values: vec![
                value("events", events),
                value("times events were lost", overruns),
                value("times the joystick was lost", lost),
                value("times no joystick could be opened", not_opened),
            ],
        });
    }
}

impl Held {
    fn message(&self, ctx: &Context<'_, Ports>) -> Joy {
        let deadzone = *ctx.get(ctx.ports.deadzone);
        let is_sticky = *ctx.get(ctx.ports.sticky_buttons);
        let axis = |axis: &Axis| {
            let position = axis.position();
            let beyond = (position.abs() - deadzone).max(0.0) / (1.0 - deadzone);
            beyond.copysign(position) as f32 + 0.0
        };
        let buttons = self.layout.buttons.iter().zip(&self.switched);
        let button = |(button, switched): (&Button, &bool)| match is_sticky {
            true => i32::from(*switched),
            false => i32::from(button.is_pressed),
        };
        Joy {
            header: header(ctx.now(), ctx.get::<String>(ctx.ports.frame_id)),
            axes: self.layout.axes.iter().map(axis).collect(),
            buttons: buttons.map(button).collect(),
        }
    }
}

fn layout_of(exchange: BusExchange) -> Result<Layout, String> {
    if exchange.outcome != BusExchange::OK {
        return Err(exchange.error);
    }
    let layout = std::str::from_utf8(&exchange.reply).ok().and_then(Layout::from_text);
    layout.ok_or_else(|| "the recording has no valid list of axes and buttons".to_owned())
}
