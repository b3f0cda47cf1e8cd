//! Robots of serial servos: the robot files in `robots/`, `downbeat servo`, and packets compared with
//! `dynamixel-sdk`.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::{Path, PathBuf};

use common::{Running, output_of, python, record_until, recorded_messages, text_of, wait_until};
use downbeat::modules::servo_bus::protocol::{Id, Instruction, Protocol, ReadEntry, WriteEntry};
use serde_json::{Value, json};

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Copies a robot file and its description, with this port.
fn robot(name: &str, folder: &Path, port: &str) -> PathBuf {
    let robots = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots");
    let path = folder.join("robot.toml");
    std::fs::create_dir(folder.join("servos")).unwrap();
    let description = format!("servos/{name}.toml");
    std::fs::copy(robots.join(&description), folder.join(&description)).unwrap();
    let robot = std::fs::read_to_string(robots.join(format!("{name}.toml"))).unwrap();
    std::fs::write(&path, robot.replace(&format!("memory:{name}"), port)).unwrap();
    path
}

#[test]
fn robots_run_from_their_files_alone_and_replay_bit_for_bit() {
    for name in ["so101", "op3"] {
        let folder = tempfile::tempdir().unwrap();
        let port = folder.path().join("port");
        let (robot, bag) = (robot(name, folder.path(), text(&port)), folder.path().join("bag"));
        let arguments = ["bag", "record", "--robot", text(&robot), "--output", text(&bag)];
        record_until(&arguments, &bag, "/joint_states", 100);
        let output = output_of(&["bag", "replay", text(&robot), text(&bag), "--json"]);
        let report = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success(), "{name}: {report} {}", String::from_utf8_lossy(&output.stderr));
        let report: Value = serde_json::from_str(&report).unwrap();
        let topics = report["topics"].as_array().unwrap();
        let states = topics.iter().find(|topic| topic["topic"] == "/joint_states").unwrap();
        assert!(states.to_string().contains("compared"), "{states}");
    }
}

#[test]
fn an_emulated_robot_in_simulated_time_gives_the_same_bag_in_every_run() {
    for (name, cycles) in [("so101", 2000), ("op3", 2500)] {
        let folder = tempfile::tempdir().unwrap();
        let robot = robot(name, folder.path(), &format!("memory:{name}"));
        let [one, two] = ["one", "two"].map(|bag| folder.path().join(bag));
        for bag in [&one, &two] {
            text_of(&["run", text(&robot), "--fast", "--duration", "20s", "--record", text(bag)]);
        }
        let states = recorded_messages(&one, "/joint_states");
        assert!((cycles - 100..cycles).contains(&states), "{name}: {states} states in 20 s");
        // `diagnostics` of the process contains times of this machine.
        text_of(&["bag", "diff", text(&one), text(&two), "--ignore", "diagnostics"]);
    }
}

#[test]
fn a_wrong_description_is_refused_with_both_files_and_lines() {
    let folder = tempfile::tempdir().unwrap();
    let robot = robot("so101", folder.path(), "memory:so101");
    let description = folder.path().join("servos/so101.toml");
    let good = std::fs::read_to_string(&description).unwrap();
    let refusal = |bad: String| {
        assert_ne!(bad, good);
        std::fs::write(&description, bad).unwrap();
        let output = output_of(&["check", text(&robot)]);
        assert!(!output.status.success());
        String::from_utf8(output.stderr).unwrap().replace(&format!("{}/", folder.path().display()), "")
    };
    let same_id = refusal(good.replace("id = 2\n", "id = 1\n"));
    assert!(
        same_id.contains("robot.toml:17: ")
            && same_id.contains(
                "servos/so101.toml:27: joint \"shoulder_lift\" has the id 1 of \"shoulder_pan\" (line 22) on the same bus; give one \
                 of the two another id, with `downbeat servo set-id`"
            ),
        "{same_id}"
    );
    let no_limits = refusal(good.replace("limits = [-1.69, 1.69]\n", ""));
    assert!(
        no_limits.contains(
            "servos/so101.toml:32: joint \"elbow_flex\" needs \"limits\", its smallest and largest angle in rad, such as limits = \
             [-1.5, 1.5]"
        ),
        "{no_limits}"
    );
}

/// The servos of a robot in `robots/`, emulated by the program.
struct Servos {
    _emulator: Running,
    _folder: tempfile::TempDir,
    port: PathBuf,
    options: Vec<String>,
}

impl Servos {
    fn of(robot: &str, baud: u32) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let port = folder.path().join("port");
        let description = format!("robots/servos/{robot}.toml");
        let emulator = Running::start(&["emulate", "servos", &description, "--link", text(&port)]);
        wait_until("the emulated servos are there", || port.exists());
        // Answers may be late on a busy machine.
        let options = ["--timeout-ms", "200", "--baud", &baud.to_string()].map(str::to_owned).to_vec();
        Self { _emulator: emulator, _folder: folder, port, options }
    }

    /// Runs `downbeat servo`, which must succeed.
    fn servo(&self, command: &str, arguments: &[&str]) -> String {
        text_of(&self.line(command, arguments))
    }

    /// Runs `downbeat servo`, which must fail.
    fn refused(&self, command: &str, arguments: &[&str]) -> String {
        let output = output_of(&self.line(command, arguments));
        assert!(!output.status.success(), "{arguments:?}");
        String::from_utf8(output.stderr).unwrap()
    }

    fn line<'a>(&'a self, command: &'a str, arguments: &[&'a str]) -> Vec<&'a str> {
        let options = self.options.iter().map(String::as_str);
        ["servo", command, text(&self.port)]
            .into_iter()
            .chain(arguments.iter().copied())
            .chain(options)
            .collect()
    }
}

#[test]
fn a_scan_lists_the_devices_of_both_families() {
    let feetech = Servos::of("so101", 1_000_000);
    let found =
        feetech.servo("scan", &["--last-id", "7", "--protocol", "dynamixel1", "--protocol", "feetech_sts"]);
    let expected: String =
        (1..=6).map(|id| format!("id {id}: STS3215, firmware 3, feetech_sts at 1000000 bit/s\n")).collect();
    assert_eq!(found, expected);
    let dynamixel = Servos::of("op3", 2_000_000);
    let board = dynamixel.servo("scan", &["--last-id", "253", "--protocol", "dynamixel2"]);
    assert_eq!(
        board,
        "id 200: unknown model 0, dynamixel2 at 2000000 bit/s\n\
         id 200 seems to have switched off the power of the servos behind it, which cannot answer: a robot switches it on with \
         `power` of [[device]] (docs/servos.md)\n"
    );
}

#[test]
fn a_scan_says_that_a_board_has_switched_off_the_servos_behind_it() {
    let folder = tempfile::tempdir().unwrap();
    let port = folder.path().join("port");
    let _emulator = Running::start(&["emulate", "darwin_op", "--link", text(&port)]);
    wait_until("the emulated robot is there", || port.exists());
    let options = ["--timeout-ms", "200", "--baud", "1000000", "--protocol", "dynamixel1"];
    let servo = |command: &str, arguments: &[&str]| {
        text_of(&[&["servo", command, text(&port)][..], arguments, &options[..]].concat())
    };
    let board = servo("scan", &["--last-id", "200"]);
    let expected = format!(
        "id 200: CM-730, firmware 19, dynamixel1 at 1000000 bit/s\nid 200 has switched off the power of the servos behind it, \
         which cannot answer: `downbeat servo write {} 200 dynamixel_power 1 --baud 1000000 --protocol dynamixel1` switches it \
         on; then scan again\n",
        text(&port)
    );
    assert_eq!(board, expected);
    servo("write", &["200", "dynamixel_power", "1"]);
    wait_until("the servos answer", || servo("scan", &["--last-id", "2"]).lines().count() == 2);
}

#[test]
fn a_scan_at_another_speed_finds_nothing() {
    let servos = Servos::of("so101", 57_600);
    let error = servos.refused("scan", &["--last-id", "1", "--protocol", "feetech_sts"]);
    assert!(error.contains("no device answered; is the power on"), "{error}");
}

#[test]
fn registers_are_read_and_written_by_name() {
    let servos = Servos::of("so101", 1_000_000);
    assert_eq!(servos.servo("ping", &["3"]), "id 3: STS3215, firmware 3, feetech_sts at 1000000 bit/s\n");
    let all = servos.servo("read", &["3"]);
    assert!(all.lines().count() > 40 && all.contains("present_temperature"), "{all}");
    servos.servo("write", &["3", "torque_limit", "500"]);
    let read = servos.servo("read", &["3", "torque_limit"]);
    assert!(read.contains(" 500 ") && read.contains("0.5000 1"), "{read}");
    let error = servos.refused("read", &["3", "present_positoin"]);
    assert!(
        error.contains("STS3215 has no register \"present_positoin\", did you mean \"present_position\"?"),
        "{error}"
    );
    assert!(servos.refused("write", &["3", "torque_limit", "5000"]).contains("takes 0 to 1000, not 5000"));
    assert!(servos.refused("ping", &["99", "--protocol", "feetech_sts"]).contains("no answer from id 99"));
}

#[test]
fn a_dangerous_write_needs_force() {
    let servos = Servos::of("so101", 1_000_000);
    let force = |text: &str| text.contains("repeat with --force if that is intended");
    assert!(force(&servos.refused("write", &["3", "max_position_limit", "3000"])));
    assert!(force(&servos.refused("write", &["3", "baud_rate", "4"])));
    assert!(servos.refused("write", &["3", "id", "9"]).contains("use `downbeat servo set-id`"));
    servos.servo("write", &["3", "goal_position", "3000"]);
    let jump = servos.refused("write", &["3", "torque_enable", "1"]);
    assert!(jump.contains("rad from the position: it would jump; write goal_position first"), "{jump}");
    servos.servo("write", &["3", "torque_enable", "1", "--force"]);
    servos.servo("write", &["3", "max_position_limit", "3500", "--force"]);
    assert!(servos.servo("read", &["3", "max_position_limit"]).contains(" 3500 "));
}

#[test]
fn a_servo_gets_another_id_if_that_is_free() {
    let servos = Servos::of("so101", 1_000_000);
    assert!(servos.refused("set-id", &["3", "4"]).contains("id 4 is taken"));
    assert_eq!(servos.servo("set-id", &["3", "9"]), "id 3 is now id 9\n");
    assert!(servos.servo("ping", &["9"]).starts_with("id 9: STS3215"));
    assert!(servos.refused("ping", &["3", "--protocol", "feetech_sts"]).contains("no answer from id 3"));
}

fn id(raw: u8) -> Id {
    Id::new(raw).unwrap()
}

/// Instructions, with the corresponding calls of `dynamixel-sdk`.
fn instructions() -> Vec<(Protocol, Instruction, Value)> {
    let mut all = Vec::new();
    let stuffed = vec![0xFF, 0xFF, 0xFD, 0xFD, 0x00];
    for (protocol, number) in [(Protocol::Dynamixel1, 1), (Protocol::Dynamixel2, 2)] {
        let (write, id_7) = (stuffed.clone(), id(7));
        all.extend([
            (protocol, Instruction::Ping { id: id_7 }, json!([number, "ping", 7])),
            (
                protocol,
                Instruction::Read { id: id_7, address: 36, length: 8 },
                json!([number, "read", 7, 36, 8]),
            ),
            (
                protocol,
                Instruction::Write { id: id_7, address: 30, data: write.clone() },
                json!([number, "write", 7, 30, write]),
            ),
            (
                protocol,
                Instruction::RegWrite { id: id_7, address: 30, data: write.clone() },
                json!([number, "reg_write", 7, 30, write]),
            ),
            (protocol, Instruction::Action { id: id_7 }, json!([number, "action", 7])),
        ]);
        let entries = vec![(id(1), vec![0xFF, 0xFF]), (id(2), vec![0xFD, 3])];
        let raw = [1, 0xFF, 0xFF, 2, 0xFD, 3];
        let sync_write = Instruction::SyncWrite { address: 30, length: 2, entries };
        all.push((protocol, sync_write, json!([number, "sync_write", 30, 2, raw])));
    }
    let bulk = |protocol, raw: Vec<u8>, number| {
        let entries = vec![
            ReadEntry { id: id(200), address: 24, length: 27 },
            ReadEntry { id: id(1), address: 36, length: 8 },
        ];
        (protocol, Instruction::BulkRead { entries }, json!([number, "bulk_read", raw]))
    };
    all.push(bulk(Protocol::Dynamixel1, vec![27, 200, 24, 8, 1, 36], 1));
    all.push(bulk(Protocol::Dynamixel2, vec![200, 24, 0, 27, 0, 1, 36, 0, 8, 0], 2));
    let two = Protocol::Dynamixel2;
    all.push((two, Instruction::Reboot { id: id(7) }, json!([2, "reboot", 7])));
    let ids = vec![id(1), id(2), id(20)];
    all.push((
        two,
        Instruction::SyncRead { address: 126, length: 21, ids: ids.clone() },
        json!([2, "sync_read", 126, 21, [1, 2, 20]]),
    ));
    let fast = Instruction::FastSyncRead { address: 126, length: 21, ids };
    all.push((two, fast, json!([2, "fast_sync_read", 126, 21, [1, 2, 20]])));
    let entries = vec![ReadEntry { id: id(9), address: 144, length: 3 }];
    all.push((two, Instruction::FastBulkRead { entries }, json!([2, "fast_bulk_read", [9, 144, 0, 3, 0]])));
    let entries = vec![WriteEntry { id: id(3), address: 600, data: stuffed.clone() }];
    let raw = [&[3, 600_u16.to_le_bytes()[0], 600_u16.to_le_bytes()[1], 5, 0][..], &stuffed].concat();
    all.push((two, Instruction::BulkWrite { entries }, json!([2, "bulk_write", raw])));
    all
}

#[test]
fn packets_are_those_of_dynamixel_sdk() {
    let instructions = instructions();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("instructions.json");
    let asked: Vec<&Value> = instructions.iter().map(|(_, _, asked)| asked).collect();
    std::fs::write(&file, serde_json::to_string(&asked).unwrap()).unwrap();
    let Some(packets) = python("dynamixel_packets.py", &[&file]) else { return };
    let Some(packets) = packets.as_array() else {
        test_machine::missing("the Python package dynamixel-sdk", "`cargo xtask python` installs it");
        return;
    };
    assert_eq!(packets.len(), instructions.len());
    for ((protocol, instruction, _), packet) in instructions.iter().zip(packets) {
        let ours: String =
            instruction.to_bytes(*protocol).unwrap().iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(ours, packet.as_str().unwrap(), "{protocol} {instruction:?}");
    }
}
