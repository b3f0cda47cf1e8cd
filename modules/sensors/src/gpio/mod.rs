//! Lines of GPIO chips: buttons, switches, lamps, relays.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `gpio/<input>` | `std_msgs/Bool` | the value of an input, at the start and at each change |
//! | `gpio/<output>` (in) | `std_msgs/Bool` | the value of an output |
//! | `gpio/edges` | `downbeat_sensors/Edge` | the changes of all inputs, with their times |
//! | `diagnostics` | `diagnostic_msgs/DiagnosticArray` | once a second and when the level changes |
//! | `gpio/exchanges` | `downbeat_interfaces/BusExchange` | all of it, for replays |
//!
//! | setting | default | |
//! | --- | --- | --- |
//! | `chip` | `/dev/gpiochip0` | the device file or the label of a chip. Of an emulated chip: a folder with a file for each line |
//! | `inputs` | | such as `["button = 17, pull_up, active_low, debounce_ms=10"]`: a name, the number or name of the line, and `pull_up`, `pull_down` or `no_bias`, `active_low`, `debounce_ms` |
//! | `outputs` | | such as `["lamp = 27, safe=false"]`: likewise, with `open_drain` or `open_source`, `active_low`, `safe` |
//! | `timeout_s` | 0 | s without a command after which an output gets its safe value; 0: never |
//!
//! An output has its safe value, false unless the setting says another, from the start until the first
//! command, after silence, and when the module ends. If the process is killed the kernel takes the lines
//! back, and what they are then depends on the chip. An interrupt of the kernel stamps each change, after its
//! debouncing. Waiting takes 5 ms at most; run the module detached, as its kind does. A chip that is lost is
//! opened again each second.

mod chip;
mod lines;
mod pins;
mod source;

use std::time::Duration;

use downbeat_device::{Device, DeviceLink};
use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError, Time};
use downbeat_msgs::Message;
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::std_msgs::msg::{Bool, Header};

pub use chip::Chip;
pub use lines::{Bias, Drive, Line, MOST_LINES, Use};
pub use pins::Pins;
pub use source::{Edge as Change, GpioDevice, Request, Source};

use crate::diagnostics::{Complaint, Reporter, Status, header, value};
use crate::kernel::name_of;
use lines::{Direction, parse_all};

/// How often changes are looked for.
const PERIOD: Duration = Duration::from_millis(10);
/// How long the module waits before it opens a chip again.
const RETRY: Duration = Duration::from_secs(1);

/// A change of an input.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "downbeat_sensors/msg/Edge")]
pub struct Edge {
    /// When it happened; the frame is the name of the module.
    pub header: Header,
    /// The name of the input.
    pub name: String,
    /// What it is now.
    pub value: bool,
}

/// Lines of a GPIO chip; see the [module page](self).
pub struct Gpio {
    link: DeviceLink<GpioDevice>,
    is_emulated: bool,
    chip: String,
    lines: Vec<Line>,
    outputs: Vec<Output>,
    is_open: bool,
    retry_at: Time,
    complaint: Complaint,
    /// What was published of each input.
    known: Vec<Option<bool>>,
    counts: Counts,
    reporter: Reporter,
}

/// What is wanted of an output.
#[derive(Clone, Debug)]
struct Output {
    /// Its place among the lines.
    line: usize,
    safe: bool,
    wanted: bool,
    /// What the line is; `None` if that is not known.
    set: Option<bool>,
    commanded_at: Option<Time>,
}

#[derive(Debug, Default)]
struct Counts {
    changes: u64,
    lost_changes: u64,
    silences: u64,
    not_opened: u64,
    lost: u64,
}

/// The keys of [`Gpio`].
pub struct Ports {
    inputs: Vec<Publication<Bool>>,
    edges: Publication<Edge>,
    exchanges: Publication<BusExchange>,
    diagnostics: Publication<DiagnosticArray>,
    timeout_s: Setting<f64>,
}

impl Module for Gpio {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let about =
            "the device file or the label of a chip; of an emulated one a folder with a file for each line";
        let default = if self.is_emulated { "" } else { "/dev/gpiochip0" };
        let chip = setup.read_only_setting("chip", default.to_owned(), about)?;
        let about = "names and lines, such as \"button = 17, pull_up, active_low, debounce_ms=10\"";
        let inputs = setup.read_only_setting("inputs", Vec::<String>::new(), about)?;
        let about = "names and lines, such as \"lamp = 27, safe=false\"";
        let outputs = setup.read_only_setting("outputs", Vec::<String>::new(), about)?;
        let about = "s without a command after which an output gets its safe value; 0 for never";
        let timeout_s = setup.setting_in("timeout_s", 0.0, 0.0..=86_400.0, about)?;
        self.chip = setup.value(chip).cloned().unwrap_or_default();
        let given = setup.value(inputs).cloned().unwrap_or_default();
        self.lines =
            parse_all(&given, Direction::In).map_err(|problem| setup.refuse_value(inputs, problem))?;
        self.known = vec![None; self.lines.len()];
        let given = setup.value(outputs).cloned().unwrap_or_default();
        let of_outputs =
            parse_all(&given, Direction::Out).map_err(|problem| setup.refuse_value(outputs, problem))?;
        if self.lines.len() + of_outputs.len() > MOST_LINES {
            return Err(
                setup.refuse_value(outputs, format!("more than {MOST_LINES} lines; use a second module"))
            );
        }
        if let Some(both) =
            of_outputs.iter().find(|line| self.lines.iter().any(|input| input.name == line.name))
        {
            let name = &both.name;
            return Err(setup.refuse_value(outputs, format!("\"{name}\" is the name of an input also")));
        }
        let mut topics = Vec::new();
        for line in &self.lines {
            topics.push(setup.publish(&format!("gpio/{}", line.name))?);
        }
        self.outputs.clear();
        for (place, line) in of_outputs.into_iter().enumerate() {
            let safe = matches!(line.purpose, Use::Output { safe: true, .. });
            let output = Output { line: self.lines.len(), safe, wanted: safe, set: None, commanded_at: None };
            setup.subscribe(
                &format!("gpio/{}", line.name),
                move |gpio: &mut Self, value: Received<'_, Bool>, ctx: &mut Context<'_, Ports>| {
                    gpio.command(place, value.data, ctx);
                },
            )?;
            self.outputs.push(output);
            self.lines.push(line);
        }
        setup.every(PERIOD, Self::run)?;
        Ok(Ports {
            inputs: topics,
            edges: setup.publish("gpio/edges")?,
            exchanges: setup.publish(GpioDevice::TOPIC)?,
            diagnostics: setup.publish("diagnostics")?,
            timeout_s,
        })
    }

    opened_while_active!();
}

impl Gpio {
    /// Lines of a chip of this machine.
    #[must_use]
    pub fn new(link: DeviceLink<GpioDevice>) -> Self {
        Self {
            link,
            is_emulated: false,
            chip: String::new(),
            lines: Vec::new(),
            outputs: Vec::new(),
            is_open: false,
            retry_at: Time::ZERO,
            complaint: Complaint::default(),
            known: Vec::new(),
            counts: Counts::default(),
            reporter: Reporter::default(),
        }
    }

    /// Lines of an emulated chip.
    #[must_use]
    pub fn emulated(link: DeviceLink<GpioDevice>) -> Self {
        Self { is_emulated: true, ..Self::new(link) }
    }

    fn open_soon(&mut self) {
        self.retry_at = Time::ZERO;
    }

    fn command(&mut self, place: usize, value: bool, ctx: &mut Context<'_, Ports>) {
        let Some(output) = self.outputs.get_mut(place) else { return };
        output.wanted = value;
        output.commanded_at = Some(ctx.now());
        self.set_outputs(ctx);
    }

    fn run(&mut self, ctx: &mut Context<'_, Ports>) {
        if !self.is_open && ctx.now() >= self.retry_at {
            self.open(ctx);
        }
        self.look_for_silence(ctx);
        self.set_outputs(ctx);
        self.read(ctx);
        self.diagnose(ctx);
    }

    fn open(&mut self, ctx: &mut Context<'_, Ports>) {
        let request = Request::Open(self.chip.clone(), self.lines.clone());
        let exchange = self.link.exchange(&request, ctx.ports.exchanges, ctx);
        if exchange.outcome != BusExchange::OK {
            self.counts.not_opened += 1;
            self.retry_at = ctx.now() + RETRY;
            self.complaint.say(&format!("{}; this is tried again every second", exchange.error), ctx);
            return;
        }
        tracing::info!("{}: {} lines of {} are requested", ctx.module_name(), self.lines.len(), self.name());
        self.complaint.clear();
        self.is_open = true;
        let time = Time::from_nanos(exchange.stamp.as_nanos());
        for (index, value) in exchange.reply.iter().enumerate() {
            self.learn(index, *value != 0, time, ctx);
        }
        for output in &mut self.outputs {
            output.set = Some(output.safe);
        }
    }

    fn look_for_silence(&mut self, ctx: &Context<'_, Ports>) {
        let (timeout, now) = (*ctx.get(ctx.ports.timeout_s), ctx.now());
        for output in &mut self.outputs {
            let is_silent =
                output.commanded_at.is_some_and(|at| now.saturating_since(at).as_secs_f64() > timeout);
            if timeout > 0.0 && is_silent {
                output.commanded_at = None;
                if std::mem::replace(&mut output.wanted, output.safe) != output.safe {
                    self.counts.silences += 1;
                    let name = self.lines.get(output.line).map_or("", |line| &line.name);
                    tracing::warn!(
                        "{}: no command for {name} came for {timeout} s: it is {} now",
                        ctx.module_name(),
                        output.safe
                    );
                }
            }
        }
    }

    fn set_outputs(&mut self, ctx: &mut Context<'_, Ports>) {
        for index in 0..self.outputs.len() {
            let Output { line, wanted, set, .. } = self.outputs[index];
            if !self.is_open || set == Some(wanted) {
                continue;
            }
            let exchange = self.link.exchange(&Request::Set(line, wanted), ctx.ports.exchanges, ctx);
            if exchange.outcome == BusExchange::OK {
                self.outputs[index].set = Some(wanted);
            } else {
                self.lose(&exchange.error, ctx);
            }
        }
    }

    fn read(&mut self, ctx: &mut Context<'_, Ports>) {
        if !self.is_open || self.known.is_empty() {
            return;
        }
        let exchange = self.link.exchange(&Request::Edges, ctx.ports.exchanges, ctx);
        if exchange.outcome == BusExchange::FAILED {
            self.lose(&exchange.error, ctx);
            return;
        }
        for bytes in exchange.reply.chunks_exact(source::EDGE).filter_map(|chunk| chunk.first_chunk()) {
            let change = Change::parse(bytes);
            self.counts.changes += 1;
            self.counts.lost_changes += u64::from(change.lost);
            let age = i64::try_from(change.age_ns).unwrap_or(i64::MAX);
            let time = Time::from_nanos(exchange.stamp.as_nanos().saturating_sub(age));
            // Of two changes one may have been lost.
            if let Some(known) = self.known.get_mut(usize::from(change.line)).filter(|_| change.lost > 0) {
                *known = None;
            }
            self.learn(change.line.into(), change.is_true, time, ctx);
        }
    }

    /// Publishes the value of an input, if it is another.
    fn learn(&mut self, index: usize, value: bool, time: Time, ctx: &mut Context<'_, Ports>) {
        let (Some(known), Some(topic)) = (self.known.get_mut(index), ctx.ports.inputs.get(index)) else {
            return;
        };
        if known.replace(value) == Some(value) {
            return;
        }
        ctx.publish(*topic, Bool { data: value });
        let name = self.lines.get(index).map(|line| line.name.clone()).unwrap_or_default();
        let edge = Edge { header: header(time, ctx.module_name()), name, value };
        ctx.publish(ctx.ports.edges, edge);
    }

    fn lose(&mut self, reason: &str, ctx: &mut Context<'_, Ports>) {
        self.counts.lost += 1;
        self.complaint.say(reason, ctx);
        self.is_open = false;
        self.link.exchange(&Request::Close, ctx.ports.exchanges, ctx);
        self.forget(ctx);
    }

    /// Gives all outputs their safe values, and the lines back.
    fn close(&mut self, ctx: &mut Context<'_, Ports>) {
        for output in &mut self.outputs {
            (output.wanted, output.commanded_at) = (output.safe, None);
        }
        self.set_outputs(ctx);
        if std::mem::take(&mut self.is_open) {
            self.link.exchange(&Request::Close, ctx.ports.exchanges, ctx);
        }
        self.forget(ctx);
    }

    fn forget(&mut self, ctx: &Context<'_, Ports>) {
        self.retry_at = ctx.now() + RETRY;
        for output in &mut self.outputs {
            output.set = None;
        }
    }

    fn name(&self) -> &str {
        if self.chip.is_empty() { "an emulated chip" } else { name_of(&self.chip) }
    }

    fn diagnose(&mut self, ctx: &mut Context<'_, Ports>) {
        let (level, message) = match self.is_open {
            true => (DiagnosticStatus::OK, "running".to_owned()),
            false => (DiagnosticStatus::ERROR, self.complaint.text().to_owned()),
        };
        let Counts { changes, lost_changes, silences, not_opened, lost } = self.counts;
        let values = self.lines.iter().zip(&self.known).map(|(line, known)| (line.name.clone(), *known));
        let outputs = self.outputs.iter().map(|output| (self.lines[output.line].name.clone(), output.set));
        let (lines, hardware_id): (Vec<_>, _) = (values.chain(outputs).collect(), self.name().to_owned());
        let topic = ctx.ports.diagnostics;
        self.reporter.report(level, topic, ctx, || {
            let mut values = vec![
                value("changes", changes),
                value("changes lost", lost_changes),
                value("times commands fell silent", silences),
                value("times the chip was lost", lost),
                value("times the chip could not be opened", not_opened),
            ];
            for (name, is_true) in lines {
                let text = is_true.map_or_else(|| "unknown".to_owned(), |is_true| is_true.to_string());
                values.push(value(&name, text));
            }
            Status { message, hardware_id, values }
        });
    }
}
