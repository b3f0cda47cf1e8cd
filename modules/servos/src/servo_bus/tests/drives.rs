//! The module with joints that are driven by velocities and efforts.

use super::*;
use crate::controllers::forward_command::ForwardCommandController;

/// Two wheels, one of them reversed and geared, and a joint that goes to positions.
fn base(protocol: &str, model: &str, wheels: &str) -> String {
    let mut text = format!(
        "name = \"base\"\n[[bus]]\nname = \"bus\"\nport = \"p\"\nbaud = 1000000\nprotocol = \"{protocol}\"\ncycle_ms = 10\n[defaults]\nmodel = \"{model}\"\n"
    );
    for (id, (name, rest)) in [("left", ""), ("right", "sign = -1\ngear = 2.0")].iter().enumerate() {
        text += &format!("[[joint]]\nname = \"{name}\"\nid = {}\n{wheels}\n{rest}\n", id + 1);
    }
    text + "[[joint]]\nname = \"mast\"\nid = 3\nlimits = [-1.0, 1.0]\n"
}

const WHEELS: &str = "mode = \"velocity\"\nmax_velocity_rad_s = 2.0";
const MOTORS: &str = "mode = \"effort\"\nmax_current_a = 0.5";

impl Run {
    fn velocities(&self, joints: &[(&str, f64)]) {
        self.commands.publish(message(joints, |message, velocities| message.velocity = velocities)).unwrap();
    }

    fn efforts(&self, joints: &[(&str, f64)]) {
        self.commands.publish(message(joints, |message, efforts| message.effort = efforts)).unwrap();
    }

    /// Runs for this many cycles, commanding in each; returns the last state.
    fn driven(&mut self, cycles: usize, command: impl Fn(&Self)) -> JointState {
        let mut last = JointState::default();
        for _ in 0..cycles {
            command(self);
            last = self.cycles(1).pop().unwrap_or(last);
        }
        last
    }
}

fn near(found: f64, wanted: f64, tolerance: f64) {
    assert!((found - wanted).abs() <= tolerance, "{found} in place of {wanted}");
}

#[test]
fn wheels_turn_at_commanded_velocities_within_their_limits() {
    for (protocol, model) in
        [("dynamixel2", "XM430-W350"), ("dynamixel2", "XL330-M288"), ("feetech_sts", "STS3215")]
    {
        let mut run = Run::of(&base(protocol, model, WHEELS));
        let start = run.cycles(50).pop().unwrap();
        assert!(start.velocity.iter().all(|velocity| *velocity == 0.0), "{model}: nothing moves: {start:?}");
        run.command(&[("mast", 0.5)]);
        let state = run.driven(150, |run| run.velocities(&[("left", 1.5), ("right", -1.0)]));
        near(state.velocity[0], 1.5, 0.1);
        near(state.velocity[1], -1.0, 0.1);
        near(position(&state, "mast"), 0.5, 0.02);
        let state = run.driven(100, |run| run.velocities(&[("left", 9.0), ("right", f64::NAN)]));
        near(state.velocity[0], 2.0, 0.1);
        assert_eq!(state.velocity[1], 0.0, "{model}: without a valid command it stops");
        assert!(run.health_of("base: bus").1.ends_with(
            "joint_commands has NaN rad/s for right, whose largest is 2 rad/s; check unit and sender"
        ));
    }
}

#[test]
fn a_wheel_stops_half_a_second_after_its_last_command() {
    let mut run = Run::of(&base("dynamixel2", "XM430-W350", WHEELS));
    run.cycles(50);
    run.velocities(&[("left", 1.0)]);
    let states = run.cycles(100);
    near(states[45].velocity[0], 1.0, 0.1);
    assert_eq!(states[99].velocity[0], 0.0);
}

#[test]
fn a_command_that_is_older_or_newer_than_its_time_out_is_dropped_and_counted() {
    let mut run = Run::of(&base("dynamixel2", "XM430-W350", WHEELS));
    run.cycles(50);
    for offset in [-10, 10] {
        let state = run.driven(50, |run| {
            let mut command = message(&[("left", 1.0), ("mast", 0.5)], |message, values| {
                message.velocity.clone_from(&values);
                message.position = values;
            });
            command.header.stamp.sec = (run.clock.now().as_nanos() / 1_000_000_000) as i32 + offset;
            run.commands.publish(command.clone()).unwrap();
            run.torques.publish(JointState { effort: vec![1.0, 1.0], ..command }).unwrap();
        });
        assert_eq!(state.velocity[0], 0.0, "{offset}");
        assert!(position(&state, "mast").abs() < 0.1, "{offset}");
    }
    let (level, words) = run.health_of("base: bus");
    assert!(level == DiagnosticStatus::WARN && words.contains("its stamp is "), "{words}");
    run.cycles(120);
    assert_eq!(run.value_of("base: bus", "commands dropped for their stamps"), "200");
    let now = run.driven(50, |run| {
        let mut command = message(&[("left", 1.0)], |message, values| message.velocity = values);
        command.header.stamp.sec = (run.clock.now().as_nanos() / 1_000_000_000) as i32;
        command.header.stamp.nanosec = (run.clock.now().as_nanos() % 1_000_000_000) as u32;
        run.commands.publish(command).unwrap();
    });
    near(now.velocity[0], 1.0, 0.1);
    let off = JointState {
        header: downbeat_msgs::std_msgs::msg::Header {
            stamp: downbeat_msgs::builtin_interfaces::msg::Time { sec: 1, nanosec: 0 },
            ..Default::default()
        },
        ..message(&[("left", 0.0)], |message, values| message.effort = values)
    };
    run.torques.publish(off).unwrap();
    run.cycles(120);
    assert_eq!(run.health_of("servo 1 left").1, "OK, torque is off", "no command to let go is too late");
}

#[test]
fn motors_get_the_commanded_current_within_its_limit() {
    let mut run = Run::of(&base("dynamixel2", "XM430-W350", MOTORS));
    run.cycles(50);
    let state = run.driven(100, |run| run.efforts(&[("left", 0.2), ("right", -4.0)]));
    near(state.effort[0], 0.2, 0.005);
    near(state.effort[1], -0.5, 0.005);
    assert!(state.velocity[0] > 0.1 && state.velocity[1] < -0.1, "{state:?}");
    run.efforts(&[("left", 1e9)]);
    run.command(&[("right", 0.3)]);
    run.cycles(100);
    assert_eq!(run.value_of("base: bus", "commands refused"), "2");
}

#[test]
fn a_driven_joint_stops_at_its_limit_and_can_be_driven_back() {
    let mut run = Run::of(&base("dynamixel2", "XM430-W350", &format!("{WHEELS}\nlimits = [-0.5, 0.5]")));
    run.cycles(50);
    let state = run.driven(200, |run| run.velocities(&[("left", 1.0), ("right", -1.0)]));
    for (joint, limit) in [("left", 0.5), ("right", -0.5)] {
        near(position(&state, joint), limit, 0.08);
    }
    assert!(state.velocity[..2].iter().all(|velocity| *velocity == 0.0), "{state:?}");
    let state = run.driven(30, |run| run.velocities(&[("left", -1.0), ("right", 1.0)]));
    assert!(position(&state, "left") < 0.45 && position(&state, "right") > -0.45, "{state:?}");
}

#[test]
fn wheels_stop_when_the_robot_does() {
    let mut run = Run::of(&base("feetech_sts", "STS3215", WHEELS));
    run.cycles(50);
    run.driven(20, |run| run.velocities(&[("left", 1.0), ("right", 1.0)]));
    run.core.stop();
    let exchanges = run.exchanges.take();
    let [.., rest, close] = &exchanges[..] else { panic!("{exchanges:?}") };
    // A sync write of two bytes at 46, for the servos 1 and 2.
    assert_eq!(rest.instruction[4..13], [0x83, 46, 2, 1, 0, 0, 2, 0, 0]);
    assert_eq!(close.kind, BusExchange::CLOSE);
}

#[test]
fn wheels_stop_when_their_module_is_deactivated() {
    let mut run = Run::of(&base("feetech_sts", "STS3215", WHEELS));
    run.cycles(50);
    run.driven(20, |run| run.velocities(&[("left", 1.0), ("right", 1.0)]));
    drop(run.core.handle().transition("servos", downbeat_executor::Transition::Deactivate));
    run.cycles(3);
    let exchanges = run.exchanges.take();
    assert_eq!(exchanges.last().unwrap().instruction[4..13], [0x83, 46, 2, 1, 0, 0, 2, 0, 0]);
}

#[test]
fn servos_with_a_watchdog_stop_by_themselves_if_nobody_speaks() {
    let mut run = Run::of(&base("dynamixel2", "XM430-W350", WHEELS));
    run.cycles(50);
    let watchdogs: Vec<_> = run
        .exchanges
        .take()
        .into_iter()
        .filter(|e| e.instruction.get(7..10) == Some(&[3, 98, 0][..]))
        .map(|exchange| (exchange.instruction[4], exchange.instruction[10]))
        .collect();
    assert_eq!(watchdogs, [(1, 0), (2, 0), (1, 0), (1, 25), (2, 0), (2, 25)], "25 steps of 20 ms");

    // The cable is pulled for a second.
    run.driven(50, |run| run.velocities(&[("left", 1.0)]));
    let before = run.driven(20, |run| run.velocities(&[("left", 1.0)]));
    run.inject(Fault::lasting(FaultKind::ClosePort, Duration::from_secs(1)));
    run.cycles(300);
    let after = run.cycles(1).pop().unwrap();
    let turned = position(&after, "left") - position(&before, "left");
    assert!((0.4..0.65).contains(&turned), "it turns for half a second: {turned} rad");
    assert!(run.health.status.iter().all(|part| part.level == DiagnosticStatus::OK), "{:?}", run.health);
    near(run.driven(50, |run| run.velocities(&[("left", 1.0)])).velocity[0], 1.0, 0.1);

    // The program does nothing for a second.
    run.clock.advance(Duration::from_secs(1));
    let state = run.driven(60, |run| run.velocities(&[("left", 1.0)]));
    near(state.velocity[0], 1.0, 0.1);
    run.cycles(100);
    let rest = run.cycles(1).pop().unwrap();
    assert_eq!(rest.velocity[0], 0.0);
}

#[test]
fn the_forward_command_controller_drives_wheels() {
    let mut run = Run::of(&base("dynamixel2", "XM430-W350", WHEELS));
    let settings = [
        ("joints".to_owned(), vec!["left".to_owned(), "right".to_owned()].into()),
        ("interface_name".to_owned(), "velocity".to_owned().into()),
    ];
    let options = ModuleOptions { settings: settings.into(), ..ModuleOptions::default() };
    run.core.add_with("wheels", ForwardCommandController::default(), options).unwrap();
    let commands = run.core.inlet("wheels/commands").unwrap();
    run.cycles(50);
    let state = run.driven(100, |_| {
        commands.publish(Float64MultiArray { data: vec![0.5, 0.8], ..Float64MultiArray::default() }).unwrap();
    });
    near(state.velocity[0], 0.5, 0.1);
    near(state.velocity[1], 0.8, 0.1);
}

#[test]
fn a_mode_that_the_model_lacks_or_without_a_limit_is_refused() {
    let error = |model: &str, protocol: &str, wheels: &str| {
        Description::load(&base(protocol, model, wheels)).unwrap_err().to_string()
    };
    assert_eq!(
        error("MX-28", "dynamixel1", WHEELS),
        "description:10: joint \"left\" cannot be driven like this: MX-28 has no such mode; leave out \"mode\", or take another model"
    );
    assert_eq!(
        error("XM430-W350", "dynamixel2", "mode = \"velocity\""),
        "description:10: joint \"left\" needs \"max_velocity_rad_s\", the largest goal in either direction: above 0, up to 49.089"
    );
    assert!(
        error("XM430-W350", "dynamixel2", "mode = \"effort\"\nmax_current_a = 9.0").contains("up to 3.209")
    );
    assert!(
        error("XM430-W350", "dynamixel2", &format!("{WHEELS}\ncommand_timeout_s = 0.001"))
            .contains("has the command_timeout_s 0.001: 0.02 (two cycles) to 60")
    );
    assert!(
        error("XM430-W350", "dynamixel2", &format!("{WHEELS}\nregisters = {{ operating_mode = 4 }}"))
            .contains("\"operating_mode\" cannot be set by a description")
    );
}
