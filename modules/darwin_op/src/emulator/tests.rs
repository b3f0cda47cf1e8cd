//! The emulator, accessed like by the hardware module.
#![allow(clippy::unwrap_used)]

use super::{
    Button, Emulator, EmulatorOptions, Fault, FaultKind, Rate, Timing, in_memory, press_button, start,
};
use crate::hardware::bus::{Bus, Exchange, ExpectedStatus, Outcome, SerialBus};
use crate::hardware::protocol::{
    Id, Instruction, Packet, Protocol, ReadEntry, Receiver, Status, StatusError,
};
use crate::hardware::tables::{cm730, mx28, units};
use downbeat_executor::Time;
use std::path::Path;
use std::time::{Duration, Instant};

const HEAD_PAN: u8 = 19;

/// Enough for a machine that runs many tests in parallel.
const SLACK: Duration = Duration::from_secs(2);

fn id(raw: u8) -> Id {
    Id::new(raw).unwrap()
}

fn options() -> EmulatorOptions {
    EmulatorOptions { timing: Timing::Immediate, seed: 1, ..EmulatorOptions::default() }
}

/// The emulator and a bus connected to it.
struct Robot {
    emulator: Emulator,
    bus: Box<dyn Bus>,
}

impl Robot {
    fn start(options: EmulatorOptions) -> Self {
        let emulator = start(options).unwrap();
        let bus = Box::new(emulator.bus());
        Self { emulator, bus }.opened()
    }

    fn powered(options: EmulatorOptions) -> Self {
        Self::start(options).with_power()
    }

    fn powered_behind_its_port(options: EmulatorOptions) -> Self {
        let emulator = start(options).unwrap();
        let bus = Box::new(SerialBus::with_slack(SLACK));
        Self { emulator, bus }.opened().with_power()
    }

    fn opened(mut self) -> Self {
        let opened = self.bus.open(&self.emulator.port_path().to_string_lossy());
        assert_eq!(opened.outcome, Outcome::Ok, "{}", opened.error);
        self
    }

    fn with_power(mut self) -> Self {
        self.write(Id::CM730, cm730::DXL_POWER.address, &[1]);
        self
    }

    fn send(&mut self, instruction: Instruction, expected: &[ExpectedStatus]) -> Exchange {
        self.bus.exchange(&instruction.to_bytes(Protocol::Dynamixel1).unwrap(), expected)
    }

    /// Sends an instruction and returns the single answer.
    fn ask(&mut self, instruction: Instruction, parameters: u16) -> (StatusError, Vec<u8>) {
        let expected = [ExpectedStatus { id: instruction.id(), parameters }];
        let id = instruction.id();
        let exchange = self.send(instruction, &expected);
        let packet = Packet::new_checked(Protocol::Dynamixel1, &exchange.reply)
            .unwrap_or_else(|e| panic!("{e}: {exchange:?}"));
        let status = Status::parse(&packet).unwrap();
        assert_eq!(status.id, id);
        (status.error, status.parameters)
    }

    fn write(&mut self, id: Id, address: u8, data: &[u8]) -> StatusError {
        self.ask(Instruction::Write { id, address: address.into(), data: data.to_vec() }, 0).0
    }

    fn read(&mut self, id: Id, field: &crate::hardware::tables::Field) -> u16 {
        let read = Instruction::Read { id, address: field.address.into(), length: field.size.into() };
        let (error, bytes) = self.ask(read, field.size.into());
        assert!(error.is_none(), "{error}");
        field.value_in(&bytes, field.address).unwrap()
    }

    /// Returns whether a device answers a ping.
    fn hears(&mut self, id: Id) -> bool {
        let expected = [ExpectedStatus { id, parameters: 0 }];
        self.send(Instruction::Ping { id }, &expected).outcome == Outcome::Ok
    }

    /// Reads the positions of these devices at once; returns which ones answered.
    fn bulk_read(&mut self, ids: &[u8]) -> (Exchange, Vec<u8>) {
        let entries = ids.iter().map(|raw| ReadEntry { id: id(*raw), address: 36, length: 2 }).collect();
        let expected: Vec<_> = ids.iter().map(|raw| ExpectedStatus { id: id(*raw), parameters: 2 }).collect();
        let exchange = self.send(Instruction::BulkRead { entries }, &expected);
        let mut receiver = Receiver::new(Protocol::Dynamixel1);
        receiver.push(&exchange.reply);
        receiver.end();
        let mut answered = Vec::new();
        while let Some(packet) = receiver.next_packet() {
            answered.push(packet.id().raw());
        }
        (exchange, answered)
    }
}

/// Repeats until the condition holds.
fn eventually(what: &str, mut is_so: impl FnMut() -> bool) {
    let watchdog = Instant::now() + Duration::from_secs(20);
    while !is_so() {
        assert!(Instant::now() < watchdog, "never: {what}");
        std::thread::yield_now();
    }
}

#[test]
fn a_ping_is_answered_by_its_device() {
    let mut robot = Robot::start(options());
    assert_eq!(robot.ask(Instruction::Ping { id: Id::CM730 }, 0), (StatusError::NONE, Vec::new()));
}

#[test]
fn servos_are_silent_until_the_board_gives_them_power() {
    let mut robot = Robot::start(options());
    assert!(!robot.hears(id(1)));
    robot.write(Id::CM730, cm730::DXL_POWER.address, &[1]);
    assert!(robot.hears(id(1)) && robot.hears(id(20)) && !robot.hears(id(21)));
    robot.write(Id::CM730, cm730::DXL_POWER.address, &[0]);
    assert!(!robot.hears(id(1)));
}

#[test]
fn written_values_are_read_again() {
    let mut robot = Robot::powered(options());
    assert_eq!(robot.read(id(3), &mx28::MODEL_NUMBER), mx28::MODEL);
    assert_eq!(robot.read(Id::CM730, &cm730::MODEL_NUMBER), cm730::MODEL);
    assert_eq!(robot.write(id(3), mx28::P_GAIN.address, &[8]), StatusError::NONE);
    assert_eq!(robot.read(id(3), &mx28::P_GAIN), 8);
}

#[test]
fn forbidden_writes_are_answered_with_an_error_bit() {
    let mut robot = Robot::powered(options());
    assert_eq!(robot.write(id(3), mx28::PRESENT_POSITION.address, &[0, 0]), StatusError::RANGE);
    assert_eq!(robot.write(id(3), mx28::TORQUE_ENABLE.address, &[7]), StatusError::RANGE);
    assert_eq!(robot.write(Id::CM730, cm730::VOLTAGE.address, &[1]), StatusError::RANGE);
    let too_far = Instruction::Read { id: id(3), address: 70, length: 10 };
    assert_eq!(robot.ask(too_far, 0).0, StatusError::RANGE);
    assert_eq!(robot.ask(Instruction::Action { id: id(3) }, 0).0, StatusError::INSTRUCTION);
}

#[test]
fn a_registered_write_waits_for_the_action() {
    let mut robot = Robot::powered(options());
    let later = Instruction::RegWrite { id: id(4), address: mx28::P_GAIN.address.into(), data: vec![9] };
    assert_eq!(robot.ask(later, 0).0, StatusError::NONE);
    assert_eq!(robot.read(id(4), &mx28::P_GAIN), 32);
    robot.send(Instruction::Action { id: Id::BROADCAST }, &[]);
    assert_eq!(robot.read(id(4), &mx28::P_GAIN), 9);
}

#[test]
fn the_status_return_level_decides_what_is_answered() {
    let mut robot = Robot::powered(options());
    robot.write(id(2), mx28::STATUS_RETURN_LEVEL.address, &[1]);
    let expected = [ExpectedStatus { id: id(2), parameters: 0 }];
    let write = Instruction::Write { id: id(2), address: mx28::LED.address.into(), data: vec![1] };
    assert_eq!(robot.send(write, &expected).outcome, Outcome::Timeout);
    assert_eq!(robot.read(id(2), &mx28::LED), 1, "it was executed anyway");
}

#[test]
fn all_devices_execute_a_broadcast_without_answers() {
    let mut robot = Robot::powered(options());
    let write =
        Instruction::Write { id: Id::BROADCAST, address: mx28::P_GAIN.address.into(), data: vec![16] };
    let expected = [ExpectedStatus { id: id(1), parameters: 0 }];
    assert_eq!(robot.send(write, &expected).reply, [0_u8; 0]);
    assert_eq!((robot.read(id(1), &mx28::P_GAIN), robot.read(id(20), &mx28::P_GAIN)), (16, 16));
}

#[test]
fn a_sync_write_moves_the_joints_it_names() {
    let mut robot = Robot::powered(options());
    let stays = robot.read(id(20), &mx28::PRESENT_POSITION);
    robot.write(id(HEAD_PAN), mx28::TORQUE_ENABLE.address, &[1]);
    let goal = 2500_u16.to_le_bytes();
    let entries = vec![(id(HEAD_PAN), vec![0, 0, 32, 0, goal[0], goal[1]])];
    robot.send(Instruction::SyncWrite { address: mx28::D_GAIN.address.into(), length: 6, entries }, &[]);
    eventually("the head looks to the left", || {
        (i32::from(robot.read(id(HEAD_PAN), &mx28::PRESENT_POSITION)) - 2500).abs() <= 3
    });
    assert_eq!(robot.read(id(20), &mx28::PRESENT_POSITION), stays);
}

#[test]
fn a_bulk_read_is_answered_in_the_order_of_the_request() {
    let mut robot = Robot::powered(options());
    let (exchange, answered) = robot.bulk_read(&[200, 5, 3, 20]);
    assert_eq!((exchange.outcome, answered), (Outcome::Ok, vec![200, 5, 3, 20]));
    assert_eq!(robot.bulk_read(&[200]).1, [200]);
}

#[test]
fn a_dead_servo_blocks_those_after_it_and_loses_its_settings() {
    let mut robot = Robot::powered(options());
    robot.write(id(3), mx28::TORQUE_ENABLE.address, &[1]);
    let time = Duration::from_millis(400);
    robot.emulator.inject(Fault::lasting(FaultKind::DeadServo(id(3)), time));
    let (exchange, answered) = robot.bulk_read(&[200, 1, 2, 3, 4]);
    assert_eq!((exchange.outcome, answered), (Outcome::Timeout, vec![200, 1, 2]));
    assert_eq!(robot.bulk_read(&[200, 1, 2, 4]).1, [200, 1, 2, 4]);
    // Time advances only with instructions.
    eventually("the time of the fault is over", || robot.hears(id(1)) && robot.emulator.elapsed() > time * 2);
    assert_eq!(robot.bulk_read(&[200, 1, 2, 3, 4]).1, [200, 1, 2, 3, 4]);
    assert_eq!(robot.read(id(3), &mx28::TORQUE_ENABLE), 0);
}

#[test]
fn a_dropped_answer_breaks_the_chain_once() {
    let mut robot = Robot::powered(options());
    robot.emulator.inject(Fault::always(FaultKind::Drop(Rate::Next(1))));
    assert_eq!(robot.bulk_read(&[200, 1]).1, [0_u8; 0]);
    assert_eq!(robot.bulk_read(&[200, 1]).1, [200, 1]);
}

#[test]
fn a_flipped_bit_spoils_one_answer_only() {
    let mut robot = Robot::powered(options());
    robot.emulator.inject(Fault::always(FaultKind::Flip(Rate::Next(1))));
    let (exchange, answered) = robot.bulk_read(&[200, 1, 2]);
    assert_eq!((exchange.outcome, answered), (Outcome::Timeout, vec![1, 2]));
    assert_eq!(robot.bulk_read(&[200, 1, 2]).1, [200, 1, 2]);
}

#[test]
fn a_closed_port_fails_and_another_one_appears_under_the_same_link() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("port");
    let mut robot = Robot::powered_behind_its_port(EmulatorOptions { link: Some(link.clone()), ..options() });
    assert_eq!(robot.emulator.port_path(), link);
    robot.emulator.inject(Fault::lasting(FaultKind::ClosePort, Duration::from_millis(300)));
    eventually("the port is closed", || !robot.emulator.is_port_open());
    let ping = Instruction::Ping { id: Id::CM730 };
    let expected = [ExpectedStatus { id: Id::CM730, parameters: 0 }];
    let failed = robot.send(ping, &expected);
    assert_eq!(failed.outcome, Outcome::Failed, "{failed:?}");
    assert_eq!(robot.bus.open(&link.to_string_lossy()).outcome, Outcome::Failed);
    eventually("the port is back", || robot.bus.open(&link.to_string_lossy()).outcome == Outcome::Ok);
    assert!(robot.hears(Id::CM730) && robot.hears(id(1)), "only the cable was unplugged, not the power");
    robot.emulator.stop();
    assert!(std::fs::symlink_metadata(&link).is_err(), "the link is removed");
}

#[test]
fn a_link_left_behind_is_replaced_but_a_file_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("port");
    // No system has that many. Emulators write the path with a dot.
    std::os::unix::fs::symlink("/dev/./pts/4000000000", &link).unwrap();
    start(EmulatorOptions { link: Some(link.clone()), ..options() }).unwrap().stop();
    std::fs::write(&link, "precious").unwrap();
    let refused = start(EmulatorOptions { link: Some(link.clone()), ..options() });
    assert!(refused.err().unwrap().to_string().contains("choose an unused path"));
    assert_eq!(std::fs::read_to_string(&link).unwrap(), "precious");
}

#[test]
fn a_link_not_created_by_an_emulator_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let (link, precious) = (folder.path().join("port"), folder.path().join("precious"));
    // The third is of another program, socat for example, which may be about to come back.
    let others = ["/nowhere", "/dev/null", "/dev/pts/4000000000", "/dev/./ptsx/7", "/dev/./pts/../shm/x"];
    for target in others.map(Path::new).into_iter().chain([precious.as_path()]) {
        std::os::unix::fs::symlink(target, &link).unwrap();
        let refused = start(EmulatorOptions { link: Some(link.clone()), ..options() });
        let error = refused.err().unwrap().to_string();
        assert!(error.contains("choose an unused path"), "{error}");
        assert_eq!(std::fs::read_link(&link).unwrap(), target);
        std::fs::remove_file(&link).unwrap();
    }
}

#[test]
fn the_link_of_a_running_emulator_is_not_taken_over() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("port");
    let start = || start(EmulatorOptions { link: Some(link.clone()), ..options() });
    let first = start().unwrap();
    let target = std::fs::read_link(&link).unwrap();
    let error = start().err().unwrap().to_string();
    assert!(error.contains("in use by another emulator"), "{error}");
    assert_eq!(std::fs::read_link(&link).unwrap(), target);
    first.stop();
    start().unwrap().stop();
}

#[test]
fn buttons_are_seen_while_they_are_held() {
    let mut robot = Robot::powered(options());
    press_button(&robot.emulator, Button::Start, Duration::from_millis(20));
    eventually("start is pressed", || robot.read(Id::CM730, &cm730::BUTTON) == 0b10);
    eventually("start is let go", || robot.read(Id::CM730, &cm730::BUTTON) == 0);
}

#[test]
fn the_imu_feels_gravity_and_some_noise() {
    let mut robot = Robot::powered(options());
    let up: Vec<u16> = (0..50).map(|_| robot.read(Id::CM730, &cm730::ACC_Z)).collect();
    assert!(up.iter().all(|raw| (635..=645).contains(raw)), "{up:?}");
    assert!(up.iter().any(|raw| *raw != up[0]), "no noise: {up:?}");
    let volts = units::volts_from_raw(robot.read(Id::CM730, &cm730::VOLTAGE));
    assert!((11.0..12.6).contains(&volts), "{volts} V");
}

#[test]
fn the_same_seed_and_instructions_give_the_same_bytes() {
    let run = |seed| {
        let mut robot = Robot::powered(EmulatorOptions { seed, ..options() });
        (0..40).map(|_| robot.bulk_read(&[200, 1, 2, 20]).0.reply).collect::<Vec<_>>()
    };
    let imu = |seed| {
        let mut robot = Robot::powered(EmulatorOptions { seed, ..options() });
        (0..40).map(|_| robot.read(Id::CM730, &cm730::GYRO_X)).collect::<Vec<_>>()
    };
    assert_eq!(run(7), run(7));
    assert_eq!(imu(7), imu(7));
    assert_ne!(imu(7), imu(8));
}

#[test]
fn measured_timing_lets_a_bulk_read_take_its_time() {
    let options = EmulatorOptions { timing: Timing::Measured, seed: 1, ..Default::default() };
    let mut robot = Robot::powered_behind_its_port(options);
    eventually("the servos have booted", || robot.hears(id(20)));
    // 2 answers of 8 bytes with the factory's return delay of 0.5 ms cannot take less than this.
    let exchange = robot.bulk_read(&[1, 2]).0;
    assert!(exchange.duration_us >= 1_000 + 160, "{} us", exchange.duration_us);
}

#[test]
fn a_stepped_robot_follows_the_time_of_the_steps() {
    let options = EmulatorOptions { timing: Timing::Stepped, seed: 1, ..Default::default() };
    let emulator = in_memory(&options, None);
    let mut bus = emulator.bus();
    let start = Time::from_nanos(1_000_000_000_000);
    for (at_ms, elapsed_ms) in [(0, 0), (8, 8), (8, 8), (5, 8), (24, 24)] {
        bus.begin_step(start + Duration::from_millis(at_ms));
        assert_eq!(emulator.elapsed(), Duration::from_millis(elapsed_ms));
    }
    emulator.inject(Fault::lasting(FaultKind::ClosePort, Duration::from_millis(10)));
    assert_eq!(bus.open("").outcome, Outcome::Failed);
    bus.begin_step(start + Duration::from_millis(40));
    assert_eq!(bus.open("").outcome, Outcome::Ok);
}
