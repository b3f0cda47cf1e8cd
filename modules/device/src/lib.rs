//! Devices whose exchanges with a module are recorded, so that a replay can answer in place of the device.
//!
//! A module that talks to hardware cannot repeat a run by its inputs alone. It can if everything it learns
//! from the device passes through one place that records it. That place is a [`DeviceLink`]: it publishes
//! each exchange on a topic, so that a bag holds it, and in a replay answers with the recorded exchanges in
//! place of the device. A request that differs from the recorded one fails and shows as the first difference
//! of the replay.
//!
//! ```
//! use std::time::Duration;
//! use downbeat_executor::{Context, Core, ManualClock, Module, Publication, Setup, SetupError, Time};
//! use downbeat_device::{Device, DeviceLink};
//! use downbeat_msgs::std_msgs::msg::{Float64, String as Line};
//!
//! /// A sonar on a serial line that answers "ping" with a distance in metres.
//! struct Sonar;
//!
//! impl Device for Sonar {
//!     type Request = &'static str;
//!     type Exchange = Line; // "ping 1.25", or "ping ! no answer"
//!     const TOPIC: &'static str = "sonar/exchanges";
//!
//!     fn exchange(&mut self, request: &Self::Request, _now: Time) -> Line {
//!         Line { data: format!("{request} 1.25") } // a real device writes to the port and reads from it
//!     }
//!
//!     fn answers(exchange: &Line, request: &Self::Request) -> bool {
//!         exchange.data.starts_with(request)
//!     }
//!
//!     fn failed(request: &Self::Request, _now: Time, reason: &str) -> Line {
//!         Line { data: format!("{request} ! {reason}") }
//!     }
//! }
//!
//! struct SonarModule(DeviceLink<Sonar>);
//!
//! struct Ports {
//!     exchanges: Publication<Line>,
//!     range: Publication<Float64>, // m
//! }
//!
//! impl Module for SonarModule {
//!     type Ports = Ports;
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
//!         setup.every(Duration::from_millis(50), Self::ping)?;
//!         Ok(Ports { exchanges: setup.publish(Sonar::TOPIC)?, range: setup.publish("range")? })
//!     }
//! }
//!
//! impl SonarModule {
//!     fn ping(&mut self, ctx: &mut Context<'_, Ports>) {
//!         let answer = self.0.exchange(&"ping", ctx.ports.exchanges, ctx);
//!         if let Some(Ok(data)) = answer.data.split_once(' ').map(|(_, metres)| metres.parse()) {
//!             ctx.publish(ctx.ports.range, Float64 { data });
//!         }
//!     }
//! }
//!
//! // With the device, and on a recording of it.
//! for link in [DeviceLink::new(Sonar), DeviceLink::recorded([Line { data: "ping 1.25".into() }])] {
//!     let clock = ManualClock::new(Time::ZERO);
//!     let mut core = Core::new().with_clock(clock.clone());
//!     core.add("sonar", SonarModule(link))?;
//!     core.cycle()?;
//!     clock.advance(Duration::from_millis(50));
//!     core.cycle()?;
//!     assert_eq!(core.topics().find(|topic| &*topic.name == "range").unwrap().counter.messages(), 1);
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod counted;
pub mod serial_port;

use downbeat_executor::{Context, Publication, Time};
use downbeat_msgs::Message;
use std::collections::VecDeque;

/// A device outside the process that answers requests: servos on a bus, a sensor, a camera.
///
/// Everything a module learns from it, errors and times included, is in the exchanges.
pub trait Device: Send + 'static {
    /// A request of the module.
    type Request;

    /// A request with its outcome, as a message that a bag can hold.
    type Exchange: Message;

    /// The topic on which exchanges are published, before remapping.
    const TOPIC: &'static str;

    /// Sends a request to the device and waits for the answer. Failures are reported in the exchange. `now`
    /// is the time of the module's run.
    fn exchange(&mut self, request: &Self::Request, now: Time) -> Self::Exchange;

    /// Returns whether `exchange` belongs to this request. A replay compares each request with the recorded
    /// one by this; the comparison should be byte for byte.
    fn answers(exchange: &Self::Exchange, request: &Self::Request) -> bool;

    /// The exchange for a request to which a replay has no recorded answer.
    fn failed(request: &Self::Request, now: Time, reason: &str) -> Self::Exchange;
}

/// A module's link to its device, or to the recording of one.
pub struct DeviceLink<D: Device> {
    way: Way<D>,
}

enum Way<D: Device> {
    Device(D),
    Recording(VecDeque<D::Exchange>),
}

impl<D: Device> DeviceLink<D> {
    /// A link to the device.
    pub fn new(device: D) -> Self {
        Self { way: Way::Device(device) }
    }

    /// A link to a recording: the exchanges of a device, in their order.
    pub fn recorded(exchanges: impl IntoIterator<Item = D::Exchange>) -> Self {
        Self { way: Way::Recording(exchanges.into_iter().collect()) }
    }

    /// The device, to configure it; `None` in a replay. What the module requests and publishes must not
    /// depend on which of the two it is.
    ///
    /// ```
    /// # use std::time::Duration;
    /// # use downbeat_executor::{Core, Module, ModuleOptions, Setup, SetupError, Time};
    /// # use downbeat_device::{Device, DeviceLink};
    /// # use downbeat_msgs::std_msgs::msg::String as Line;
    /// #[derive(Default)]
    /// struct Sonar {
    ///     port: String,
    /// }
    /// # impl Device for Sonar {
    /// #     type Request = &'static str;
    /// #     type Exchange = Line;
    /// #     const TOPIC: &'static str = "sonar/exchanges";
    /// #     fn exchange(&mut self, request: &Self::Request, _: Time) -> Line {
    /// #         Line { data: format!("{request} on {}", self.port) }
    /// #     }
    /// #     fn answers(_: &Line, _: &Self::Request) -> bool {
    /// #         true
    /// #     }
    /// #     fn failed(request: &Self::Request, _: Time, reason: &str) -> Line {
    /// #         Line { data: format!("{request} ! {reason}") }
    /// #     }
    /// # }
    ///
    /// struct SonarModule(DeviceLink<Sonar>);
    ///
    /// impl Module for SonarModule {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         let port = setup.read_only_setting("port", "/dev/ttyUSB0".to_owned(), "the serial port")?;
    ///         if let (Some(sonar), Some(port)) = (self.0.device(), setup.value(port)) {
    ///             sonar.port.clone_from(port);
    ///         }
    ///         Ok(())
    ///     }
    /// }
    /// # let mut core = Core::new();
    /// # core.add("sonar", SonarModule(DeviceLink::new(Sonar::default())))?;
    /// # core.add("replayed", SonarModule(DeviceLink::recorded([])))?;
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn device(&mut self) -> Option<&mut D> {
        match &mut self.way {
            Way::Device(device) => Some(device),
            Way::Recording(_) => None,
        }
    }

    /// Sends a request to the device, publishes the exchange on `topic` and returns it.
    ///
    /// In a replay this returns the next exchange of the recording, or [`Device::failed`] if that belongs to
    /// another request or the recording is over.
    pub fn exchange<P>(
        &mut self,
        request: &D::Request,
        topic: Publication<D::Exchange>,
        ctx: &mut Context<'_, P>,
    ) -> D::Exchange {
        let now = ctx.now();
        let exchange = match &mut self.way {
            Way::Device(device) => device.exchange(request, now),
            Way::Recording(exchanges) => match exchanges.pop_front() {
                Some(exchange) if D::answers(&exchange, request) => exchange,
                Some(_) => D::failed(request, now, "the recording has an exchange of another request here"),
                None => D::failed(request, now, "the recording has ended"),
            },
        };
        ctx.publish(topic, exchange.clone());
        exchange
    }
}
