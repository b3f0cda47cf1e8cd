//! The module without faults.

use super::*;
use crate::emulator::{self, Button, Fault};
use crate::hardware::tables::{cm730, mx28};
use downbeat_executor::{Inbox, Synchrony};
use downbeat_msgs::std_msgs::msg::Float64MultiArray;

#[test]
fn a_running_robot_publishes_everything_in_every_cycle() {
    let emulator = emulator();
    let mut run = Run::on(&emulator);
    run.until_running();
    run.imu.take();
    run.battery.take();
    run.buttons.take();
    let states = run.cycles(250);
    assert_eq!((states.len(), run.imu.take().len()), (250, 250));
    assert_eq!((run.battery.take().len(), run.buttons.take().len()), (2, 2), "once a second");
    let state = &states[249];
    assert_eq!(state.name, JOINTS.map(|joint| joint.name));
    for values in [&state.position, &state.velocity, &state.effort] {
        assert!(values.len() == 20 && values.iter().all(|value| value.is_finite()), "{values:?}");
    }
    assert!(run.is_healthy(), "{:?}", run.health);
}

#[test]
fn imu_and_battery_are_in_si_units_and_the_frames_of_the_settings() {
    let emulator = emulator();
    let mut run = Run::on_with(&emulator, &[("imu_frame", "here".to_owned().into())]);
    run.until_running();
    run.cycles(10);
    let imu = run.imu.take().pop().unwrap();
    assert_eq!((imu.header.frame_id.as_str(), imu.orientation_covariance[0]), ("here", -1.0));
    assert!((imu.linear_acceleration.z - 9.81).abs() < 0.5, "{imu:?}");
    assert!(imu.angular_velocity.x.abs() < 0.4 && imu.angular_velocity_covariance[0] > 0.0, "{imu:?}");
    let battery = run.battery.take().pop().unwrap();
    assert!((11.0..12.7).contains(&battery.voltage) && battery.percentage.is_nan(), "{battery:?}");
}

#[test]
fn nothing_moves_before_it_is_commanded() {
    let emulator = emulator();
    let mut run = Run::on(&emulator);
    run.until_running();
    let (first, last) = (run.cycles(1).remove(0), run.cycles(200).remove(199));
    for joint in &JOINTS {
        let moved = (position(&last, joint.name) - position(&first, joint.name)).abs();
        assert!(moved < 0.01, "{} moved by {moved}", joint.name);
    }
}

#[test]
fn a_command_moves_the_joints_it_names_inside_their_limits() {
    let emulator = emulator();
    let mut run = Run::on(&emulator);
    run.until_running();
    let before = run.cycles(1).remove(0);
    run.command(&[("head_pan", 0.6), ("head_tilt", 6.0), ("r_el", f64::NAN), ("tail", 1.0)]);
    run.until("the head is where it is wanted", |_, states| {
        let state = &states[states.len() - 1];
        let tilt = JOINTS[index_of("head_tilt").unwrap()].max_rad();
        (position(state, "head_pan") - 0.6).abs() < 0.02 && (position(state, "head_tilt") - tilt).abs() < 0.02
    });
    let after = run.cycles(1).remove(0);
    assert!((position(&after, "r_el") - position(&before, "r_el")).abs() < 0.01);
    run.cycles(130);
    let bus = &run.health.status[0];
    let unknown = bus.values.iter().find(|value| value.key.contains("unknown")).unwrap();
    assert_eq!(unknown.value, "1");
}

#[test]
fn a_first_command_is_approached_slowly() {
    let emulator = emulator();
    let mut run = Run::on(&emulator);
    run.until_running();
    run.command(&[("head_pan", 1.5)]);
    let fastest = run.cycles(80).iter().map(|state| state.velocity[18]).fold(0.0, f64::max);
    // 10 ticks per cycle, of which this emulator lets only the 6 ms elapse during which the bus is busy: 2.6
    // rad/s. Without the approach it would be twice as much.
    assert!((2.0..3.0).contains(&fastest), "{fastest} rad/s");
}

#[test]
fn an_offset_shifts_goal_and_position_alike() {
    let emulator = emulator();
    let mut offsets = vec![0_i64; 20];
    offsets[18] = 100;
    let mut run = Run::on_with(&emulator, &[("offset_ticks", offsets.into())]);
    run.until_running();
    run.command(&[("head_pan", 0.2)]);
    run.until("the head turns", |_, states| (position(&states[0], "head_pan") - 0.2).abs() < 0.01);
    run.exchanges.take();
    run.cycles(1);
    let written = run.exchanges.take().into_iter().find(|exchange| exchange.instruction[4] == 0x83).unwrap();
    let goal = u16::from_le_bytes([written.instruction[7 + 18 * 3 + 1], written.instruction[7 + 18 * 3 + 2]]);
    assert_eq!(goal, 2048 + 130 + 100);
}

#[test]
fn wrong_settings_are_refused() {
    let (mut core, _clock) = core_at_zero();
    let settings = [("offset_ticks".to_owned(), SettingValue::Integers(vec![1, 2]))].into();
    let options = ModuleOptions { settings, ..ModuleOptions::default() };
    let error = core.add_with("darwin_op", DarwinOp::serial(), options).err().unwrap();
    assert!(error.to_string().contains("has 2 numbers"), "{error}");
}

#[test]
fn buttons_are_published_when_they_change() {
    let emulator = emulator();
    let mut run = Run::on(&emulator);
    run.until_running();
    emulator::press_button(&emulator, Button::Mode, Duration::from_millis(50));
    run.until("mode is pressed", |run, _| run.buttons.take().iter().any(|joy| joy.buttons == [1, 0]));
    run.until("mode is let go", |run, _| run.buttons.take().iter().any(|joy| joy.buttons == [0, 0]));
}

#[test]
fn persistent_settings_are_written_only_if_they_differ() {
    let emulator = emulator();
    let writes_delay = |exchange: &BusExchange| {
        exchange.instruction.get(4..6) == Some(&[0x03, mx28::RETURN_DELAY.address][..])
    };
    let mut counts = Vec::new();
    for _ in 0..2 {
        let mut run = Run::on(&emulator);
        run.until_running();
        run.core.stop();
        counts.push(run.exchanges.take().iter().filter(|exchange| writes_delay(exchange)).count());
    }
    assert_eq!(counts, [20, 0]);
}

#[test]
fn new_gains_are_written_once() {
    let emulator = emulator();
    let mut run = Run::on(&emulator);
    run.until_running();
    run.exchanges.take();
    run.core.handle().set("darwin_op", "p_gain", 16_i64);
    run.cycles(20);
    let gains = run
        .exchanges
        .take()
        .into_iter()
        .filter(|exchange| exchange.instruction.get(4..6) == Some(&[0x83, mx28::D_GAIN.address][..]));
    let gains: Vec<Vec<u8>> = gains.map(|exchange| exchange.instruction[7..11].to_vec()).collect();
    assert_eq!(gains, [[1, 0, 0, 16]]);
}

#[test]
fn on_shutdown_the_port_is_closed_and_the_torque_is_kept() {
    let emulator = emulator();
    let mut run = Run::on(&emulator);
    run.until_running();
    run.core.stop();
    let exchanges = run.exchanges.take();
    let [.., bulk_read, light, close] = &exchanges[..] else { panic!("{exchanges:?}") };
    assert_eq!(bulk_read.instruction[4], 0x92, "the last cycle");
    assert_eq!(light.instruction, [0xFF, 0xFF, 0xC8, 0x05, 0x03, cm730::LED_HEAD.address, 0xE0, 0x03, 0x32]);
    assert_eq!(close.kind, BusExchange::CLOSE);
}

#[test]
fn detached_on_a_bus_with_measured_timing_a_joint_arrives() {
    let emulator = emulator::start(EmulatorOptions { seed: 5, ..Default::default() }).unwrap();
    let mut core = Core::new();
    let port = emulator.port_path().to_string_lossy().into_owned();
    let options = ModuleOptions {
        synchrony: Synchrony::Detached(Inbox::KeepAll),
        settings: [("port".to_owned(), SettingValue::Text(port))].into(),
        ..ModuleOptions::default()
    };
    core.add_with("darwin_op", DarwinOp::serial(), options).unwrap();
    let states = Collector::<JointState>::add(&mut core, "joint_states");
    let commands = core.inlet("joint_commands").unwrap();
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run());
    let watchdog = Instant::now() + Duration::from_secs(60);
    let mut has_arrived = false;
    while !has_arrived && Instant::now() < watchdog {
        let command =
            JointState { name: vec!["head_pan".into()], position: vec![0.4], ..JointState::default() };
        commands.publish(command).unwrap();
        std::thread::park_timeout(Duration::from_millis(20));
        has_arrived = states.take().iter().any(|state| (position(state, "head_pan") - 0.4).abs() < 0.02);
    }
    handle.stop();
    running.join().unwrap().unwrap();
    assert!(has_arrived);
}

#[test]
fn a_calibrated_gyroscope_reads_zero_at_rest() {
    let emulator = emulator();
    let mut run = Run::on_with(&emulator, &[("calibrate_gyro", true.into())]);
    run.until_running();
    run.cycles(110);
    run.imu.take();
    run.cycles(200);
    let rates: Vec<f64> = run.imu.take().iter().map(|imu| imu.angular_velocity.z).collect();
    let mean = rates.iter().sum::<f64>() / rates.len() as f64;
    assert!(mean.to_degrees().abs() < 0.5, "{} degrees/s", mean.to_degrees());
}

#[test]
fn lights_are_set_by_one_write_each() {
    let emulator = emulator();
    let mut run = Run::on(&emulator);
    let eyes = run.core.inlet("led/eyes").unwrap();
    run.until_running();
    run.exchanges.take();
    let colour = downbeat_msgs::std_msgs::msg::ColorRGBA { r: 1.0, g: 0.5, b: f32::NAN, a: 1.0 };
    eyes.publish(colour).unwrap();
    run.cycles(10);
    let exchanges = run.exchanges.take();
    let written: Vec<_> = exchanges
        .iter()
        .filter(|e| e.instruction.get(4..6) == Some(&[0x03, cm730::LED_EYE.address][..]))
        .collect();
    let value = 0x1F | 16 << 5_u16;
    assert_eq!(written.len(), 1);
    assert_eq!(written[0].instruction[6..8], u16::to_le_bytes(value));
}

#[test]
fn feet_measure_the_weight_and_where_it_is() {
    let emulator = emulator();
    let mut run = Run::on_with(&emulator, &[("foot_sensors", true.into())]);
    let feet = ["foot_pressure/right", "foot_pressure/left"]
        .map(|topic| Collector::<Float64MultiArray>::add(&mut run.core, topic));
    run.until_running();
    run.cycles(10);
    let feet = feet.map(|foot| foot.take().pop().unwrap().data);
    let weight: f64 = feet.iter().flat_map(|foot| &foot[..4]).sum();
    assert!((weight / 9.806_65 - 2.925).abs() < 0.01, "{weight} N on {feet:?}");
    assert!(feet.iter().all(|foot| foot[4..] == [0.0, 0.0]), "in the middle: {feet:?}");
    assert_eq!(run.health_of("right foot"), (DiagnosticStatus::OK, "OK".into()));
}

#[test]
fn the_lights_on_the_back_are_switched_one_by_one() {
    let emulator = emulator();
    let mut run = Run::on(&emulator);
    let panel = run.core.inlet("led/panel").unwrap();
    run.until_running();
    run.exchanges.take();
    let colour = downbeat_msgs::std_msgs::msg::ColorRGBA { r: f32::NAN, g: 0.5, b: 1.0, a: 1.0 };
    panel.publish(colour).unwrap();
    run.cycles(10);
    let is_panel = |e: &BusExchange| e.instruction.get(4..6) == Some(&[0x03, cm730::LED_PANEL.address][..]);
    let written: Vec<_> = run.exchanges.take().into_iter().filter(is_panel).collect();
    assert_eq!(written.iter().map(|exchange| exchange.instruction[6]).collect::<Vec<_>>(), [0b110]);
}

#[test]
fn feet_that_do_not_answer_disturb_nobody() {
    let emulator = emulator();
    for (_, id) in crate::hardware::FEET {
        emulator.inject(Fault::always(FaultKind::DeadServo(id)));
    }
    let mut run = Run::on_with(&emulator, &[("foot_sensors", true.into())]);
    run.until_running();
    run.cycles(150);
    assert_eq!(run.health_of("right foot"), (DiagnosticStatus::ERROR, "no answer".into()));
    assert_eq!(run.health_of("head_tilt"), (DiagnosticStatus::OK, "OK".into()));
    assert_eq!(run.cycles(100).len(), 100);
}

#[test]
fn limits_and_alarms_are_written_if_they_differ() {
    let emulator = emulator();
    let writes = |exchange: &BusExchange| {
        let address = mx28::CW_ANGLE_LIMIT.address;
        exchange.instruction.get(2..6).is_some_and(|bytes| bytes[0] == 20 && bytes[2..] == [0x03, address])
    };
    let mut counts = Vec::new();
    for _ in 0..2 {
        let mut run = Run::on_with(&emulator, &[("check_eeprom", true.into())]);
        run.until_running();
        run.core.stop();
        let written: Vec<_> = run.exchanges.take().into_iter().filter(writes).collect();
        counts.push(written.len());
        if let Some(written) = written.first() {
            // -25 degrees.
            assert_eq!(written.instruction[6..8], (2048_u16 - 284).to_le_bytes());
        }
    }
    assert_eq!(counts, [1, 0]);
}

#[test]
fn an_unknown_board_or_axis_is_refused() {
    let refused = |name: &str, value: SettingValue| {
        let (mut core, _clock) = core_at_zero();
        let options =
            ModuleOptions { settings: [(name.to_owned(), value)].into(), ..ModuleOptions::default() };
        core.add_with("darwin_op", DarwinOp::serial(), options).err().unwrap().to_string()
    };
    assert!(refused("board", "cm750".to_owned().into()).contains("\"cm750\" is none of cm730, cm740"));
    assert!(refused("gyro_axes", "x up".to_owned().into()).contains("forward, left, up"));
}
