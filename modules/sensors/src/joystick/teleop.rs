//! Driving with a joystick, as `teleop_twist_joy` of ROS does it.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `joy` (in) | `sensor_msgs/Joy` | |
//! | `cmd_vel` | `geometry_msgs/Twist`, or `TwistStamped` with `publish_stamped_twist` | m/s, rad/s |
//!
//! | setting | default | |
//! | --- | --- | --- |
//! | `require_enable_button` | true | whether a button has to be held |
//! | `enable_button` | 4 | the button that has to be held; -1: none |
//! | `enable_turbo_button` | 5 | the button for the scales of turbo; -1: none |
//! | `axis_linear.x`, `.y`, `.z` | 1, -1, -1 | the axis for each direction; -1: none |
//! | `axis_angular.yaw`, `.pitch`, `.roll` | 0, -1, -1 | the axis for each rotation |
//! | `scale_linear.x`, `.y`, `.z` | 0.5, 0, 0 | m/s at the end of the axis |
//! | `scale_linear_turbo.x`, `.y`, `.z` | 1, 0, 0 | likewise, with turbo |
//! | `scale_angular.yaw`, `.pitch`, `.roll` | 0.5, 0, 0 | rad/s at the end of the axis |
//! | `scale_angular_turbo.yaw`, `.pitch`, `.roll` | 1, 0, 0 | likewise, with turbo |
//! | `inverted_reverse` | false | yaw has the other sign while driving backwards |
//! | `publish_stamped_twist`, `frame` | false, `teleop_twist_joy` | |
//! | `timeout_s` | 0.5 | s without `joy` after which it stops; 0: never |
//!
//! Buttons and axes are counted from 0. The defaults are for gamepads as Linux numbers them: drive with the
//! left stick while the left shoulder button is held, or the right one for turbo. When the button is released
//! one command of zero is sent, and no more, so that others may drive; likewise when `joy` falls silent while
//! the button is held, which `teleop_twist_joy` does not do. So `joy` has to be repeated, as the kind
//! `joystick` does by default.
//!
//! # References
//! `README.md` and `config/` of `ros2/teleop_twist_joy`, branch jazzy: names, units, and the command at
//! release.

use std::time::Duration;

use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError, Time};
use downbeat_msgs::geometry_msgs::msg::{Twist, TwistStamped, Vector3};
use downbeat_msgs::sensor_msgs::msg::Joy;

use crate::diagnostics::header;

/// How often silence of `joy` is looked for.
const PERIOD: Duration = Duration::from_millis(20);

/// Drives with a joystick; see the [module page](self).
#[derive(Debug, Default)]
pub struct JoyTeleop {
    /// While driving: when `joy` came last.
    driving_since: Option<Time>,
    dropped: u64,
}

/// The keys of [`JoyTeleop`].
pub struct Ports {
    commands: Commands,
    require_enable_button: Setting<bool>,
    enable_button: Setting<i64>,
    enable_turbo_button: Setting<i64>,
    linear: [Direction; 3],
    /// Roll, pitch, yaw.
    angular: [Direction; 3],
    inverted_reverse: Setting<bool>,
    timeout_s: Setting<f64>,
    frame: Setting<String>,
}

enum Commands {
    Plain(Publication<Twist>),
    Stamped(Publication<TwistStamped>),
}

/// Which axis is for a direction, and what its end means: normally, and with turbo.
#[derive(Clone, Copy)]
struct Direction {
    axis: Setting<i64>,
    scales: [Setting<f64>; 2],
}

impl Module for JoyTeleop {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let about = "whether a button has to be held";
        let require_enable_button = setup.setting("require_enable_button", true, about)?;
        let number = |setup: &mut Setup<'_, Self>, name: &str, default: i64, about: &str| {
            setup.setting_in(name, default, -1.0..=1_000.0, about)
        };
        let enable_button =
            number(setup, "enable_button", 4, "the button that has to be held, from 0; -1 for none")?;
        let about = "the button for the scales of turbo, from 0; -1 for none";
        let enable_turbo_button = number(setup, "enable_turbo_button", 5, about)?;
        let mut direction = |group: &str, name: &str, unit: &str, axis: i64, scale: f64| {
            let about = "the axis, from 0; -1 for none";
            let axis = number(setup, &format!("axis_{group}.{name}"), axis, about)?;
            let mut scaled = |suffix: &str, default: f64| {
                let name = format!("scale_{group}{suffix}.{name}");
                setup.setting(&name, default, &format!("{unit} at the end of the axis"))
            };
            Ok::<_, SetupError>(Direction {
                axis,
                scales: [scaled("", scale)?, scaled("_turbo", 2.0 * scale)?],
            })
        };
        let mut linear = |name, axis, scale| direction("linear", name, "m/s", axis, scale);
        let linear = [linear("x", 1, 0.5)?, linear("y", -1, 0.0)?, linear("z", -1, 0.0)?];
        let mut angular = |name, axis, scale| direction("angular", name, "rad/s", axis, scale);
        let angular = [angular("roll", -1, 0.0)?, angular("pitch", -1, 0.0)?, angular("yaw", 0, 0.5)?];
        let about = "whether yaw has the other sign while driving backwards";
        let inverted_reverse = setup.setting("inverted_reverse", false, about)?;
        let about = "whether cmd_vel is a TwistStamped";
        let is_stamped = setup.read_only_setting("publish_stamped_twist", false, about)?;
        let frame = setup.setting("frame", "teleop_twist_joy".to_owned(), "frame of a TwistStamped")?;
        let about = "s without joy after which it stops; 0 for never";
        let timeout_s = setup.setting_in("timeout_s", 0.5, 0.0..=3_600.0, about)?;
        let is_stamped = setup.value(is_stamped) == Some(&true);
        setup.subscribe("joy", Self::on_joy)?;
        setup.every(PERIOD, Self::watch)?;
        let commands = match is_stamped {
            true => Commands::Stamped(setup.publish("cmd_vel")?),
            false => Commands::Plain(setup.publish("cmd_vel")?),
        };
        Ok(Ports {
            commands,
            require_enable_button,
            enable_button,
            enable_turbo_button,
            linear,
            angular,
            inverted_reverse,
            timeout_s,
            frame,
        })
    }

    fn deactivate(&mut self, ctx: &mut Context<'_, Ports>) -> Result<(), downbeat_executor::TransitionError> {
        self.stop(ctx);
        Ok(())
    }

    fn shutdown(&mut self, ctx: &mut Context<'_, Ports>) {
        self.stop(ctx);
    }

    fn debug(&self) -> Option<&dyn std::fmt::Debug> {
        Some(self)
    }
}

impl JoyTeleop {
    fn on_joy(&mut self, joy: Received<'_, Joy>, ctx: &mut Context<'_, Ports>) {
        let ports = ctx.ports;
        let is_held = |button: i64| {
            let button = usize::try_from(button).ok().and_then(|button| joy.buttons.get(button));
            button.is_some_and(|state| *state != 0)
        };
        let is_turbo = is_held(*ctx.get(ports.enable_turbo_button));
        if !is_turbo && *ctx.get(ports.require_enable_button) && !is_held(*ctx.get(ports.enable_button)) {
            self.stop(ctx);
            return;
        }
        let along = |direction: &Direction| {
            let axis = usize::try_from(*ctx.get(direction.axis)).ok().and_then(|axis| joy.axes.get(axis));
            axis.map_or(0.0, |position| {
                f64::from(*position) * ctx.get(direction.scales[usize::from(is_turbo)])
            })
        };
        let [x, y, z] = ports.linear.each_ref().map(along);
        let [roll, pitch, yaw] = ports.angular.each_ref().map(along);
        let yaw = if x < 0.0 && *ctx.get(ports.inverted_reverse) { -yaw } else { yaw };
        if [x, y, z, roll, pitch, yaw].iter().any(|value| !value.is_finite()) {
            self.dropped += 1;
            if self.dropped.is_power_of_two() {
                tracing::warn!(
                    "joy has values that are not finite ({} times so far); they are dropped",
                    self.dropped
                );
            }
            self.stop(ctx);
            return;
        }
        self.driving_since = Some(ctx.now());
        let linear = Vector3 { x, y, z };
        command(Twist { linear, angular: Vector3 { x: roll, y: pitch, z: yaw } }, ctx);
    }

    fn watch(&mut self, ctx: &mut Context<'_, Ports>) {
        let timeout = *ctx.get(ctx.ports.timeout_s);
        let is_silent = self
            .driving_since
            .is_some_and(|last| timeout > 0.0 && ctx.now().saturating_since(last).as_secs_f64() > timeout);
        if is_silent {
            tracing::warn!("joy fell silent while driving: stopped");
            self.stop(ctx);
        }
    }

    /// Sends one command of zero, if the last one was another.
    fn stop(&mut self, ctx: &mut Context<'_, Ports>) {
        if self.driving_since.take().is_some() {
            command(Twist::default(), ctx);
        }
    }
}

fn command(twist: Twist, ctx: &mut Context<'_, Ports>) {
    match ctx.ports.commands {
        Commands::Plain(topic) => ctx.publish(topic, twist),
        Commands::Stamped(topic) => {
            let header = header(ctx.now(), ctx.get::<String>(ctx.ports.frame));
            ctx.publish(topic, TwistStamped { header, twist });
        }
    }
}
