//! Replays the recorded bag through the hardware module: every instruction on the bus equals the recorded one
//! byte for byte, and every published message equals the recorded one bit for bit.
#![allow(clippy::unwrap_used, missing_docs)]

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use bytes::Bytes;
use downbeat::bags::{Reader, Selection};
use downbeat::bridge::edge::{CoreAccess, Interfaces};
use downbeat::executor::{Core, Inbox, Launcher, Linear, ManualClock, OutletInbox, Pool, Time};
use downbeat::modules::darwin_op::DarwinOp;
use downbeat::modules::darwin_op::bus::{BusReport, Exchange, RecordedBus};
use downbeat::msgs::cdr;
use downbeat::msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use downbeat::msgs::downbeat_interfaces::msg::{BusExchange, ModuleStep};
use downbeat::playback::replay_module;
use downbeat::robot::RobotFile;

/// The topics that the hardware module publishes.
const OUTPUTS: [&str; 6] =
    ["joint_states", "imu/data_raw", "battery_state", "buttons", "diagnostics", "bus/exchanges"];

type Messages = Vec<Bytes>;

fn recordings() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("bags/recordings")
}

fn recording() -> Reader {
    Reader::open(recordings().join("darwin_op_emulated")).unwrap()
}

fn recorded(reader: &Reader, topic: &str) -> Messages {
    let id = reader.topic(&format!("/{topic}")).unwrap();
    let messages = reader.messages(Selection::all().topics([id])).unwrap();
    messages.map(|message| message.unwrap().data).collect()
}

fn recorded_as<T: downbeat::msgs::Message>(reader: &Reader, topic: &str) -> Vec<T> {
    recorded(reader, topic).iter().map(|bytes| cdr::from_slice(bytes).unwrap()).collect()
}

fn replay(
    reader: &Reader,
    launcher: impl Launcher + 'static,
    exchanges: Vec<Exchange>,
) -> (BTreeMap<&'static str, Messages>, BusReport) {
    let clock = ManualClock::new(Time::ZERO);
    let mut core = Core::new().with_launcher(launcher).with_clock(clock.clone());
    let (bus, report) = RecordedBus::new(exchanges);
    let robot = RobotFile::read(&recordings().join("darwin_op_emulated.toml")).unwrap();
    let hardware = robot.modules.iter().find(|module| module.name == "hardware").unwrap();
    core.add_with("hardware", DarwinOp::new(Box::new(bus)), hardware.options()).unwrap();
    let mut captured = Vec::new();
    for topic in OUTPUTS {
        let info = core.topics().find(|info| *info.name == *topic).unwrap();
        let message_type = Interfaces::carried().message_in(info).unwrap();
        let messages = Arc::<Mutex<Messages>>::default();
        captured.push((topic, Arc::clone(&messages)));
        let sink = move |_: Time, message: Bytes| messages.lock().unwrap().push(message);
        let inbox = OutletInbox::new("capture", Inbox::KeepAll);
        message_type.outlet(&mut CoreAccess::Idle(&mut core), topic, &inbox, sink).unwrap().keep();
    }
    replay_module(&mut core, &clock, reader, "hardware", &Interfaces::carried()).unwrap();
    let report = report.lock().clone();
    let captured = captured.into_iter().map(|(topic, messages)| (topic, messages.lock().unwrap().clone()));
    (captured.collect(), report)
}

fn recorded_exchanges(reader: &Reader) -> Vec<Exchange> {
    let messages = recorded_as::<BusExchange>(reader, "bus/exchanges").into_iter();
    messages.map(|message| Exchange::try_from(message).unwrap()).collect()
}

fn assert_replays_bit_for_bit(launcher: impl Launcher + 'static) {
    let reader = recording();
    let exchanges = recorded_exchanges(&reader);
    let count = exchanges.len() as u64;
    let (published, report) = replay(&reader, launcher, exchanges);
    assert_eq!(report.differences.first(), None, "{} instructions differ", report.differences.len());
    assert_eq!(report.replayed, count);
    for topic in OUTPUTS {
        let (expected, found) = (recorded(&reader, topic), &published[topic]);
        assert_eq!(found.len(), expected.len(), "messages on {topic}");
        let first_difference = expected.iter().zip(found).position(|(expected, found)| expected != found);
        assert_eq!(first_difference, None, "first message on {topic} that differs");
    }
}

#[test]
fn the_recorded_run_repeats_bit_for_bit_on_one_thread() {
    assert_replays_bit_for_bit(Linear);
}

#[test]
fn the_recorded_run_repeats_bit_for_bit_on_a_pool_of_threads() {
    for threads in [2, 4] {
        assert_replays_bit_for_bit(Pool::new(threads).unwrap());
    }
}

#[test]
fn a_recording_with_one_changed_bit_is_detected() {
    let reader = recording();
    let mut exchanges = recorded_exchanges(&reader);
    // Changes a bit of a position in the middle of the run. The checksum of the packet is then wrong, so the
    // answer of the servo is refused, which leads to other messages and, later, other instructions.
    let altered = exchanges.len() / 2;
    let reply = (altered..).find(|&index| exchanges[index].reply.len() > 300).unwrap();
    exchanges[reply].reply[60] ^= 1;
    let (published, _) = replay(&reader, Linear, exchanges);
    assert!(OUTPUTS.iter().any(|topic| published[topic] != recorded(&reader, topic)));
}

#[test]
fn the_recording_is_long_enough_and_contains_faults_and_a_whole_run() {
    let reader = recording();
    let seconds = (reader.end_time().unwrap() - reader.start_time().unwrap()) / 1_000_000_000;
    assert!(seconds >= 10, "{seconds} s");
    assert_eq!(reader.truncation().count(), 0);
    let metadata = reader.metadata().unwrap();
    assert_eq!(metadata.custom_data.get("emulated").map(String::as_str), Some("true"));
    let exchanges = recorded_as::<BusExchange>(&reader, "bus/exchanges");
    for outcome in [BusExchange::OK, BusExchange::TIMEOUT, BusExchange::FAILED] {
        assert!(exchanges.iter().any(|exchange| exchange.outcome == outcome), "outcome {outcome}");
    }
    let diagnostics = recorded_as::<DiagnosticArray>(&reader, "diagnostics");
    let statuses: Vec<DiagnosticStatus> = diagnostics.into_iter().flat_map(|array| array.status).collect();
    assert!(statuses.iter().any(|status| status.level == DiagnosticStatus::ERROR));
    assert!(statuses.iter().any(|status| status.level == DiagnosticStatus::OK));
    let steps = recorded_as::<ModuleStep>(&reader, "module_steps");
    assert!(steps.last().unwrap().is_stop);
    assert!(steps.iter().zip(0..).all(|(step, number)| step.step == number));
}
