//! Two messages that downbeat does not contain: one derived from a struct, one generated from a `.msg` file.
#![allow(rustdoc::broken_intra_doc_links)] // units in brackets, as ROS writes them in comments of messages

use std::process::ExitCode;
use std::time::Duration;

use downbeat::App;
use downbeat::executor::{Context, Module, Publication, Received, Setup, SetupError};
use downbeat_msgs::Message;
use downbeat_msgs::builtin_interfaces::msg::Time;

// `robot_msgs::msg::Stuck` from `robot_msgs/msg/Stuck.msg`, and `INTERFACES`, the set of all interfaces in
// `robot_msgs`.
downbeat_msgs::include_interfaces!();

use robot_msgs::msg::Stuck;

/// How fast the wheels turn, and how hard they are driven.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "own_message/msg/Wheels")]
struct Wheels {
    stamp: Time,
    /// Left and right [rad/s].
    speeds: [f64; 2],
    /// Left and right [N m].
    efforts: [f64; 2],
}

/// A simulated base with two wheels: in every second step the right wheel stands still.
#[derive(Default)]
struct Base {
    steps: u32,
}

struct BasePorts {
    wheels: Publication<Wheels>,
}

impl Module for Base {
    type Ports = BasePorts;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<BasePorts, SetupError> {
        setup.every(Duration::from_millis(50), Self::tick)?;
        Ok(BasePorts { wheels: setup.publish("wheels")? })
    }
}

impl Base {
    fn tick(&mut self, ctx: &mut Context<'_, BasePorts>) {
        self.steps += 1;
        let right = f64::from(self.steps % 2);
        let stamp = Time::from_nanos(ctx.now().as_nanos());
        ctx.publish(ctx.ports.wheels, Wheels { stamp, speeds: [1.0, right], efforts: [0.25, 0.5] });
    }
}

/// Reports wheels that stand still although they are driven.
struct Watch;

struct WatchPorts {
    stuck: Publication<Stuck>,
}

impl Module for Watch {
    type Ports = WatchPorts;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<WatchPorts, SetupError> {
        setup.subscribe("wheels", Self::look)?;
        Ok(WatchPorts { stuck: setup.publish("stuck")? })
    }
}

impl Watch {
    fn look(&mut self, wheels: Received<'_, Wheels>, ctx: &mut Context<'_, WatchPorts>) {
        for (index, wheel) in ["left", "right"].into_iter().enumerate() {
            let (speed, effort) = (wheels.speeds[index], wheels.efforts[index]);
            if speed == 0.0 && effort > 0.1 {
                tracing::info!("the {wheel} wheel is stuck");
                ctx.publish(ctx.ports.stuck, Stuck { stamp: wheels.stamp, wheel: wheel.into(), effort });
            }
        }
    }
}

fn app() -> App {
    App::new()
        .interfaces(Wheels::INTERFACES)
        .interfaces(INTERFACES)
        .kind("base", "a base with two wheels (made up)", Base::default)
        .kind("watch", "reports wheels that are stuck", || Watch)
}

fn main() -> ExitCode {
    app().main()
}
