//! A sonar on a simulated serial line. Its answers differ in each run, as with real hardware.

use std::time::{Duration, SystemTime};

use downbeat::device::{Device, DeviceLink};
use downbeat::executor::{Context, Module, Publication, Setting, Setup, SetupError, Time};
use downbeat::msgs::Message;
use downbeat::msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat::msgs::std_msgs::msg::Header;

/// Distance to the next obstacle.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "sonar_msgs/msg/Echo", crate = "downbeat::msgs")]
pub struct Echo {
    pub header: Header,
    /// [m]
    pub distance: f64,
}

/// The bytes of a request and of its answer.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "sonar_msgs/msg/Exchange", crate = "downbeat::msgs")]
pub struct Exchange {
    pub request: Vec<u8>,
    pub answer: Vec<u8>,
    /// Why there is no answer; empty if there is one.
    pub error: String,
}

downbeat::msgs::interfaces! {
    /// The messages of the sonar.
    pub INTERFACES: Echo, Exchange
}

/// The serial line.
pub struct Line;

impl Line {
    pub fn open() -> Self {
        Self
    }
}

impl Device for Line {
    type Request = [u8; 2];
    type Exchange = Exchange;
    const TOPIC: &'static str = "sonar/exchanges";

    fn exchange(&mut self, request: &Self::Request, _now: Time) -> Exchange {
        let noise = SystemTime::UNIX_EPOCH.elapsed().map_or(0, |since| since.subsec_nanos());
        let micros = 5000 + noise % 1000; // until the echo arrived
        Exchange { request: request.to_vec(), answer: micros.to_le_bytes().to_vec(), error: String::new() }
    }

    fn answers(exchange: &Exchange, request: &Self::Request) -> bool {
        exchange.request == request
    }

    fn failed(request: &Self::Request, _now: Time, reason: &str) -> Exchange {
        Exchange { request: request.to_vec(), error: reason.into(), ..Exchange::default() }
    }
}

/// Measures the distance to the next obstacle.
pub struct Sonar {
    line: DeviceLink<Line>,
}

pub struct Ports {
    exchanges: Publication<Exchange>,
    echo: Publication<Echo>,
    pulses: Setting<i64>,
    speed: Setting<f64>,
}

impl Sonar {
    pub fn new(line: DeviceLink<Line>) -> Self {
        Self { line }
    }

    fn measure(&mut self, ctx: &mut Context<'_, Ports>) {
        let pulses = u8::try_from(*ctx.get(ctx.ports.pulses)).unwrap_or(1);
        let exchange = self.line.exchange(&[b'P', pulses], ctx.ports.exchanges, ctx);
        if let Ok(micros) = exchange.answer.try_into().map(u32::from_le_bytes) {
            let distance = *ctx.get(ctx.ports.speed) * f64::from(micros) * 1e-6 / 2.0;
            let stamp = Stamp::from_nanos(ctx.now().as_nanos());
            ctx.publish(ctx.ports.echo, Echo { header: Header { stamp, frame_id: "sonar".into() }, distance });
        }
    }
}

impl Module for Sonar {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        setup.every(Duration::from_millis(50), Self::measure)?;
        Ok(Ports {
            exchanges: setup.publish(Line::TOPIC)?,
            echo: setup.publish("sonar/echo")?,
            pulses: setup.setting_in("pulses", 1, 1.0..=8.0, "pulses of a measurement")?,
            speed: setup.setting("speed", 343.0, "of sound, m/s")?,
        })
    }
}
