//! Two modules that share only topic names: a motor and the fan that cools it.

use std::process::ExitCode;
use std::time::Duration;

use downbeat::App;
use downbeat::executor::{Context, Module, Publication, Received, Setting, Setup, SetupError};
use downbeat::msgs::std_msgs::msg::{Bool, Float64};

/// A motor with a simulated temperature, which rises by 1 °C every 50 ms and falls while the fan is on.
struct Motor {
    celsius: f64,
    is_cooled: bool,
}

impl Default for Motor {
    fn default() -> Self {
        Self { celsius: 25.0, is_cooled: false }
    }
}

struct MotorPorts {
    temperature: Publication<Float64>,
}

impl Module for Motor {
    type Ports = MotorPorts;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<MotorPorts, SetupError> {
        setup.subscribe::<Bool, _>("fan", |motor, is_on, _| motor.is_cooled = is_on.data)?;
        setup.every(Duration::from_millis(50), Self::tick)?;
        Ok(MotorPorts { temperature: setup.publish("temperature")? })
    }
}

impl Motor {
    fn tick(&mut self, ctx: &mut Context<'_, MotorPorts>) {
        self.celsius += if self.is_cooled { -1.0 } else { 1.0 };
        ctx.publish(ctx.ports.temperature, Float64 { data: self.celsius });
    }
}

/// Switches on above the limit, and off again 5 °C below it.
#[derive(Default)]
struct Fan {
    is_on: bool,
}

struct FanPorts {
    limit: Setting<f64>,
    fan: Publication<Bool>,
}

impl Module for Fan {
    type Ports = FanPorts;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<FanPorts, SetupError> {
        setup.subscribe("temperature", Self::switch)?;
        Ok(FanPorts {
            limit: setup.setting("limit", 40.0, "temperature above which the fan is on, °C")?,
            fan: setup.publish("fan")?,
        })
    }
}

impl Fan {
    fn switch(&mut self, temperature: Received<'_, Float64>, ctx: &mut Context<'_, FanPorts>) {
        let (celsius, limit) = (temperature.data, *ctx.get(ctx.ports.limit));
        let wants_on = celsius > limit || self.is_on && celsius > limit - 5.0;
        if wants_on != self.is_on {
            self.is_on = wants_on;
            tracing::info!("{celsius} °C: fan {}", if wants_on { "on" } else { "off" });
            ctx.publish(ctx.ports.fan, Bool { data: wants_on });
        }
    }
}

fn app() -> App {
    App::new().kind("motor", "a motor that warms up (computed)", Motor::default).kind(
        "fan",
        "cools a motor that is too warm",
        Fan::default,
    )
}

fn main() -> ExitCode {
    app().main()
}
