use downbeat_executor::{Heard, ModuleOptions, Probe};
use downbeat_msgs::geometry_msgs::msg::{Twist, TwistStamped};
use downbeat_msgs::sensor_msgs::msg::Joy;
use downbeat_sensors::joystick::teleop::JoyTeleop;

use super::{options, pass, text};

fn bench(options: ModuleOptions) -> (Probe, Heard<Twist>) {
    let mut probe = Probe::new();
    probe.add_with("teleop", JoyTeleop::default(), options).unwrap();
    let commands = probe.listen("cmd_vel").unwrap();
    (probe, commands)
}

/// The left stick at these positions, and which buttons are pressed.
fn joy(yaw: f32, x: f32, pressed: &[usize]) -> Joy {
    let mut buttons = vec![0; 11];
    pressed.iter().for_each(|button| buttons[*button] = 1);
    Joy { axes: vec![yaw, x, 1.0], buttons, ..Joy::default() }
}

fn xw(twists: &[Twist]) -> Vec<(f64, f64)> {
    twists.iter().map(|twist| (twist.linear.x, twist.angular.z)).collect()
}

#[test]
fn it_drives_while_the_button_is_held_and_sends_one_zero_when_it_is_released() {
    let (mut probe, commands) = bench(options([]));
    let mut send = |joy: Joy| {
        probe.publish("joy", joy).unwrap();
        xw(&commands.take())
    };
    assert!(send(joy(0.5, 1.0, &[])).is_empty(), "nothing before the button is held");
    assert_eq!(send(joy(0.5, 1.0, &[4])), [(0.5, 0.25)]);
    assert_eq!(send(joy(0.5, 1.0, &[5])), [(1.0, 0.5)], "turbo");
    assert_eq!(send(joy(0.5, -1.0, &[4, 5])), [(-1.0, 0.5)]);
    assert_eq!(send(joy(0.5, 1.0, &[])), [(0.0, 0.0)]);
    assert!(send(joy(0.5, 1.0, &[])).is_empty(), "others may drive");
    assert_eq!(send(joy(f32::NAN, 1.0, &[4])), [], "nothing to stop");
    assert_eq!(send(joy(0.0, 1.0, &[4])), [(0.5, 0.0)]);
    assert_eq!(send(joy(f32::NAN, 1.0, &[4])), [(0.0, 0.0)]);
    assert_eq!(send(Joy::default()), [], "a joystick without axes and buttons");
}

#[test]
fn it_stops_once_when_joy_falls_silent() {
    let (mut probe, commands) = bench(options([("timeout_s", 0.3.into())]));
    probe.publish("joy", joy(0.0, 1.0, &[4])).unwrap();
    pass(&mut probe, 290);
    assert_eq!(xw(&commands.take()), [(0.5, 0.0)]);
    pass(&mut probe, 1_000);
    assert_eq!(xw(&commands.take()), [(0.0, 0.0)]);
}

#[test]
fn axes_scales_and_signs_are_settings() {
    let (mut probe, commands) = bench(options([
        ("require_enable_button", false.into()),
        ("enable_turbo_button", (-1).into()),
        ("axis_linear.y", 0.into()),
        ("scale_linear.y", 2.0.into()),
        ("axis_angular.roll", 2.into()),
        ("scale_angular.roll", (-3.0).into()),
        ("axis_angular.yaw", 77.into()),
        ("inverted_reverse", true.into()),
    ]));
    probe.publish("joy", joy(0.5, -1.0, &[])).unwrap();
    let twist = commands.take().remove(0);
    assert_eq!((twist.linear.x, twist.linear.y, twist.angular.x), (-0.5, 1.0, -3.0));
    assert_eq!(twist.angular.z, 0.0, "an axis that the joystick lacks");
    probe.set("teleop", "axis_angular.yaw", 0).unwrap();
    probe.publish("joy", joy(0.5, -1.0, &[])).unwrap();
    assert_eq!(commands.take().remove(0).angular.z, -0.25, "reversed while driving backwards");
    probe.publish("joy", joy(0.5, 1.0, &[])).unwrap();
    assert_eq!(commands.take().remove(0).angular.z, 0.25);
}

#[test]
fn commands_may_have_stamps() {
    let mut probe = Probe::new();
    let settings = options([("publish_stamped_twist", true.into()), ("frame", text("base_link"))]);
    probe.add_with("teleop", JoyTeleop::default(), settings).unwrap();
    let commands = probe.listen::<TwistStamped>("cmd_vel").unwrap();
    pass(&mut probe, 30);
    probe.publish("joy", joy(0.0, 1.0, &[4])).unwrap();
    let command = commands.take().remove(0);
    assert_eq!((&*command.header.frame_id, command.twist.linear.x), ("base_link", 0.5));
    assert_eq!(command.header.stamp.as_nanos(), probe.now().as_nanos());
}
