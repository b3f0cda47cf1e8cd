use std::fs;
use std::sync::{Arc, Mutex};

use downbeat_device::DeviceLink;
use downbeat_executor::{Heard, ModuleOptions, Probe, Time};
use downbeat_msgs::diagnostic_msgs::msg::DiagnosticStatus;
use downbeat_sensors::can::{CanBus, CanDevice, CandumpLog, Frame, LENGTH, Sent, SocketCan, Source, Wanted};
use fuzzing::{Random, rounds};

use super::{Bench, bench_of, last_status, last_value, options, pass, text, texts};

struct Topics {
    received: Heard<Frame>,
}

fn bench(link: DeviceLink<CanDevice>, options: ModuleOptions) -> Bench<Topics> {
    bench_of(("can", CanBus::emulated(link)), options, "can/exchanges", |probe| Topics {
        received: probe.listen("from_can_bus").unwrap(),
    })
}

fn emulated() -> DeviceLink<CanDevice> {
    DeviceLink::new(CanDevice::new(CandumpLog::default()))
}

fn frame(id: u32, byte: u8) -> Frame {
    Frame { id, dlc: 1, data: [byte, 0, 0, 0, 0, 0, 0, 0], ..Frame::default() }
}

#[test]
fn a_log_is_played_filtered_and_repeated_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("drive.log");
    let lines: String = (0..50)
        .map(|step| format!("(1436509052.{:06}) can0 {:03X}#{step:02X}\n", step * 10_000, 0x120 + step % 4))
        .collect();
    fs::write(&log, lines).unwrap();
    let settings =
        || options([("interface", text(log.display())), ("filters", texts(["121:7FF", "122:7FF"]))]);
    let mut live = bench(emulated(), settings());
    live.probe.publish("to_can_bus", frame(1, 1)).unwrap();
    pass(&mut live.probe, 300);
    live.probe.publish("to_can_bus", frame(2, 2)).unwrap();
    pass(&mut live.probe, 400);
    let received = live.received.take();
    assert_eq!(received.len(), 25);
    assert!(
        received.iter().all(|frame| [0x121, 0x122].contains(&frame.id) && frame.header.frame_id == "can")
    );
    assert!(received[0].header.stamp.as_nanos() < received[20].header.stamp.as_nanos());
    let exchanges = live.exchanges.take();
    let mut again = bench(DeviceLink::recorded(exchanges), settings());
    again.probe.publish("to_can_bus", frame(1, 1)).unwrap();
    pass(&mut again.probe, 300);
    again.probe.publish("to_can_bus", frame(2, 2)).unwrap();
    pass(&mut again.probe, 400);
    assert_eq!(again.received.take(), received);
    pass(&mut live.probe, 2_000);
    assert_eq!(last_status(&live.diagnostics), (DiagnosticStatus::OK, "running".to_owned()));
}

#[test]
fn sent_frames_come_back_if_that_is_asked_for_and_impossible_ones_are_refused() {
    let mut live = bench(emulated(), options([("receive_own", true.into())]));
    pass(&mut live.probe, 20);
    let refused = Frame { id: 0x800, ..Frame::default() };
    let extended = Frame { is_extended: true, is_rtr: true, ..frame(0x1234_5678, 0) };
    for frame in [frame(0x7ff, 9), refused, extended] {
        live.probe.publish("to_can_bus", frame).unwrap();
    }
    pass(&mut live.probe, 20);
    let received = live.received.take();
    assert_eq!(received.len(), 2);
    assert_eq!((received[0].id, received[0].data[0]), (0x7ff, 9));
    assert_eq!((received[1].id, received[1].is_extended, received[1].is_rtr), (0x1234_5678, true, true));
    let (level, message) = last_status(&live.diagnostics);
    assert_eq!(level, DiagnosticStatus::WARN);
    assert_eq!(message, "a frame was refused: id 0x800 has more than 11 bits; is_extended is not set");
}

/// A bus that is full, reports errors or is gone, as the test says.
#[derive(Clone, Default)]
struct Troubled(Arc<Mutex<Trouble>>);

#[derive(Default)]
struct Trouble {
    is_gone: bool,
    is_full: bool,
    sent: Vec<u8>,
    waiting: Vec<u8>,
}

impl Source for Troubled {
    fn open(&mut self, _: &Wanted) -> Result<(), String> {
        if self.0.lock().unwrap().is_gone { Err("there is no interface can0".to_owned()) } else { Ok(()) }
    }

    fn receive(&mut self, _: Time) -> Result<Vec<u8>, String> {
        let mut bus = self.0.lock().unwrap();
        if bus.is_gone {
            Err("can0 is gone; plug it in again".to_owned())
        } else {
            Ok(std::mem::take(&mut bus.waiting))
        }
    }

    fn send(&mut self, frame: &[u8; LENGTH]) -> Result<Sent, String> {
        let mut bus = self.0.lock().unwrap();
        if bus.is_full {
            return Ok(Sent::Full);
        }
        bus.sent.push(frame[8]);
        Ok(Sent::Yes)
    }

    fn close(&mut self) {}
}

fn troubled() -> (Troubled, Bench<Topics>) {
    let bus = Troubled::default();
    let mut live = bench(DeviceLink::new(CanDevice::new(bus.clone())), options([]));
    pass(&mut live.probe, 20);
    (bus, live)
}

#[test]
fn frames_wait_for_a_full_driver_and_no_longer_than_they_are_worth() {
    let (bus, mut live) = troubled();
    bus.0.lock().unwrap().is_full = true;
    live.probe.publish("to_can_bus", frame(1, 1)).unwrap();
    pass(&mut live.probe, 50);
    bus.0.lock().unwrap().is_full = false;
    pass(&mut live.probe, 20);
    assert_eq!(bus.0.lock().unwrap().sent, [1]);
    bus.0.lock().unwrap().is_full = true;
    live.probe.publish("to_can_bus", frame(1, 2)).unwrap();
    pass(&mut live.probe, 150);
    bus.0.lock().unwrap().is_full = false;
    live.probe.publish("to_can_bus", frame(1, 3)).unwrap();
    pass(&mut live.probe, 20);
    assert_eq!(bus.0.lock().unwrap().sent, [1, 3], "a late command is worse than none");
    pass(&mut live.probe, 1_000);
    assert_eq!(last_value(&live.diagnostics, "frames not sent"), "1");
}

#[test]
fn errors_of_the_controller_are_in_the_diagnostics_and_not_among_the_frames() {
    let (bus, mut live) = troubled();
    let mut error = |class: u32, detail: u8| {
        let mut bytes = [0; LENGTH];
        bytes[..4].copy_from_slice(&(0x2000_0000 | class).to_ne_bytes());
        (bytes[4], bytes[9], bytes[14]) = (8, detail, 130);
        bus.0.lock().unwrap().waiting = bytes.to_vec();
        pass(&mut live.probe, 20);
        last_status(&live.diagnostics)
    };
    let (level, message) = error(0x204, 0x20);
    assert!(level == DiagnosticStatus::WARN && message.starts_with("the controller is passive"), "{message}");
    let (level, message) = error(0x40, 0);
    assert!(
        level == DiagnosticStatus::ERROR && message.starts_with("the controller is off the bus"),
        "{message}"
    );
    let (level, message) = error(0x100, 0);
    assert_eq!((level, &*message), (DiagnosticStatus::WARN, "the controller was restarted"));
    assert!(live.received.take().is_empty());
    pass(&mut live.probe, 2_500);
    let last = live.diagnostics.take_last().unwrap();
    let value =
        |key: &str| last.status[0].values.iter().find(|value| value.key == key).unwrap().value.clone();
    assert_eq!(last.status[0].level, DiagnosticStatus::OK);
    assert_eq!(
        (value("error frames"), value("errors on sending, as the controller counts")),
        ("3".into(), "130".into())
    );
}

#[test]
fn a_bus_that_is_gone_is_opened_again_and_frames_for_it_are_counted() {
    let (bus, mut live) = troubled();
    bus.0.lock().unwrap().is_gone = true;
    pass(&mut live.probe, 1_500);
    live.probe.publish("to_can_bus", frame(1, 1)).unwrap();
    let (level, message) = last_status(&live.diagnostics);
    assert_eq!(
        (level, &*message),
        (DiagnosticStatus::ERROR, "there is no interface can0; this is tried again every second")
    );
    bus.0.lock().unwrap().is_gone = false;
    pass(&mut live.probe, 1_500);
    live.probe.publish("to_can_bus", frame(1, 2)).unwrap();
    pass(&mut live.probe, 2_500);
    assert_eq!(bus.0.lock().unwrap().sent, [2]);
    assert_eq!(last_value(&live.diagnostics, "frames not sent"), "1");
}

#[test]
fn filters_that_are_none_are_refused() {
    let settings = options([("filters", texts(["12G:7FF"]))]);
    let refused = Probe::new().add_with("can", CanBus::emulated(emulated()), settings).unwrap_err();
    assert!(refused.to_string().contains("\"12G:7FF\" is no filter"), "{refused}");
}

/// Runs only where an interface can be made: as root, with the kernel's driver `vcan`.
#[test]
fn frames_pass_through_a_virtual_interface_of_the_kernel() {
    let name = format!("dbt{}", std::process::id() % 100_000);
    let ip = |arguments: &[&str]| {
        let run = std::process::Command::new("ip").args(arguments).output();
        run.is_ok_and(|output| output.status.success())
    };
    if !ip(&["link", "add", "dev", &name, "type", "vcan"]) {
        test_machine::skipped("this kernel has no driver vcan, or the user may not use it");
        return;
    }
    let is_up = ip(&["link", "set", &name, "up"]);
    let settings = options([("interface", text(&name)), ("receive_own", true.into())]);
    let mut live = bench(DeviceLink::new(CanDevice::new(SocketCan::default())), settings);
    pass(&mut live.probe, 20);
    live.probe.publish("to_can_bus", frame(0x123, 7)).unwrap();
    pass(&mut live.probe, 40);
    let received = live.received.take();
    ip(&["link", "delete", &name]);
    pass(&mut live.probe, 40);
    assert!(
        is_up && received.len() == 1 && received[0].id == 0x123 && received[0].data[0] == 7,
        "{received:?}"
    );
    assert_eq!(last_status(&live.diagnostics).0, DiagnosticStatus::ERROR);
}

#[test]
fn a_damaged_recording_stops_nothing() {
    let mut live = bench(emulated(), options([("receive_own", true.into())]));
    for byte in 0..20 {
        live.probe.publish("to_can_bus", frame(5, byte)).unwrap();
        pass(&mut live.probe, 15);
    }
    let recorded = live.exchanges.take();
    for round in rounds(60) {
        let mut random = Random::new(round);
        let mut damaged = recorded.clone();
        for _ in 0..4 {
            let place = random.below(damaged.len());
            damaged[place].reply = (0..random.below(70)).map(|_| random.below(256) as u8).collect();
            damaged[place].outcome = random.below(4) as u8;
        }
        let mut again = bench(DeviceLink::recorded(damaged), options([("receive_own", true.into())]));
        pass(&mut again.probe, 300);
        assert!(again.received.take().iter().all(|frame| frame.dlc <= 8));
    }
}
