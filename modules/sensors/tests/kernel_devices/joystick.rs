use std::fs;
use std::io::Write;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use downbeat_device::DeviceLink;
use downbeat_executor::{Heard, ModuleOptions, Time};
use downbeat_msgs::diagnostic_msgs::msg::DiagnosticStatus;
use downbeat_msgs::sensor_msgs::msg::Joy;
use downbeat_sensors::joystick::{
    Axis, Button, Event, InputDevice, Joystick, Layout, RecordedEvents, Source,
};
use fuzzing::{Random, rounds};
use rustix::fs::{CWD, FileType, Mode, mknodat};

use super::{Bench, bench_of, last_status, last_value, options, pass, text};

const KEY: u16 = 1;
const ABSOLUTE: u16 = 3;

struct Topics {
    joy: Heard<Joy>,
}

fn bench(link: DeviceLink<InputDevice>, options: ModuleOptions) -> Bench<Topics> {
    bench_of(("pad", Joystick::new(link)), options, "joystick/exchanges", |probe| Topics {
        joy: probe.listen("joy").unwrap(),
    })
}

fn emulated() -> DeviceLink<InputDevice> {
    DeviceLink::new(InputDevice::new(RecordedEvents::default()))
}

/// Bytes of events at this time, and the report that ends them.
fn events(time_us: u64, events: &[(u16, u16, i32)]) -> Vec<u8> {
    let report = (0, 0, 0);
    let event = |(kind, code, value): &(u16, u16, i32)| {
        Event { time_us, kind: *kind, code: *code, value: *value }.emit()
    };
    events.iter().chain([&report]).flat_map(event).collect()
}

#[test]
fn events_of_a_pipe_become_joy_in_any_pieces() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pad");
    mknodat(CWD, &pipe, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
    let settings = options([("device", text(pipe.display())), ("autorepeat_rate", 0.0.into())]);
    let mut live = bench(emulated(), settings);
    pass(&mut live.probe, 10);
    let at_rest = live.joy.take();
    assert_eq!(at_rest.len(), 1, "the state is known from the start");
    assert_eq!((at_rest[0].axes.as_slice().len(), at_rest[0].buttons.as_slice().len()), (8, 11));
    assert_eq!(at_rest[0].axes.as_slice()[2], 1.0, "a trigger at rest");
    assert_eq!((at_rest[0].axes.as_slice()[0], &*at_rest[0].header.frame_id), (0.0, "joy"));

    let mut writer = fs::OpenOptions::new().read(true).write(true).open(&pipe).unwrap();
    let bytes = events(5, &[(ABSOLUTE, 0, -32_768), (ABSOLUTE, 1, 16_384), (KEY, 0x130, 1), (KEY, 0x130, 0)]);
    let (first, second) = bytes.split_at(61);
    writer.write_all(first).unwrap();
    pass(&mut live.probe, 10);
    writer.write_all(second).unwrap();
    pass(&mut live.probe, 10);
    let moved = live.joy.take();
    assert_eq!(moved.len(), 3, "axes, pressed, released: {moved:?}");
    let last = moved.last().unwrap();
    assert_eq!(last.axes.as_slice()[0], 1.0, "left is positive");
    let half = (0.5 - 0.05) / 0.95;
    assert!(
        (f64::from(last.axes.as_slice()[1]) + half).abs() < 1e-3,
        "down is negative: {}",
        last.axes.as_slice()[1]
    );
    let pressed: Vec<i32> = moved.iter().map(|joy| joy.buttons.as_slice()[0]).collect();
    assert_eq!(pressed, [0, 1, 0], "a short press is not lost");
    writer.write_all(&[0xa5; 333]).unwrap();
    pass(&mut live.probe, 10);
    assert!(live.joy.take().is_empty(), "events of no known kind change nothing");
}

#[test]
fn a_recorded_drive_is_played_in_its_time_and_repeated_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("drive.events");
    let drive: Vec<u8> = (0..50_u64)
        .flat_map(|step| {
            events(
                7_000_000 + step * 10_000,
                &[(ABSOLUTE, 1, (step * 600) as i32), (KEY, 0x136, (step % 2) as i32)],
            )
        })
        .collect();
    fs::write(&file, &drive).unwrap();
    let settings = || options([("device", text(file.display())), ("sticky_buttons", true.into())]);
    let mut live = bench(emulated(), settings());
    pass(&mut live.probe, 1_000);
    let joy = live.joy.take();
    assert!(joy.windows(2).all(|pair| pair[0].header.stamp.as_nanos() <= pair[1].header.stamp.as_nanos()));
    let end = joy.last().unwrap();
    assert!(end.axes.as_slice()[1] < -0.85, "{end:?}");
    let switches = joy.windows(2).filter(|pair| pair[0].buttons != pair[1].buttons).count();
    assert_eq!(switches, 25, "a sticky button switches at each press");
    assert_eq!(last_status(&live.diagnostics).0, DiagnosticStatus::OK);
    let mut again = bench(DeviceLink::recorded(live.exchanges.take()), settings());
    pass(&mut again.probe, 1_000);
    assert_eq!(again.joy.take(), joy);
}

#[test]
fn a_joystick_that_does_not_move_is_repeated_and_one_that_is_lost_lets_go() {
    let folder = tempfile::tempdir().unwrap();
    let (file, away) = (folder.path().join("pad"), folder.path().join("away"));
    fs::write(&file, events(0, &[(KEY, 0x136, 1)])).unwrap();
    let mut live = bench(emulated(), options([("device", text(file.display()))]));
    pass(&mut live.probe, 1_010);
    let joy = live.joy.take();
    assert!((19..=24).contains(&joy.len()), "{} in a second at 20 Hz", joy.len());
    assert_eq!(joy.last().unwrap().buttons.as_slice()[4], 1);
    fs::rename(&file, &away).unwrap();
    pass(&mut live.probe, 2_500);
    let after = live.joy.take();
    let last = after.last().unwrap();
    assert!(last.buttons.iter().all(|button| *button == 0) && last.axes.iter().all(|axis| *axis == 0.0));
    let (level, message) = last_status(&live.diagnostics);
    assert!(level == DiagnosticStatus::ERROR && message.contains("tried again every second"), "{message}");
    fs::rename(&away, &file).unwrap();
    pass(&mut live.probe, 1_500);
    assert!(!live.joy.take().is_empty());
    assert_eq!(last_status(&live.diagnostics).0, DiagnosticStatus::OK);
}

/// A joystick whose kernel has lost events.
#[derive(Clone)]
struct Overrun(Arc<Mutex<(Layout, Vec<u8>)>>);

impl Source for Overrun {
    fn open(&mut self, _: &str) -> Result<(), String> {
        Ok(())
    }

    fn layout(&mut self) -> Result<Layout, String> {
        Ok(self.0.lock().unwrap().0.clone())
    }

    fn read(&mut self, _: Time, most: Duration) -> Result<Vec<u8>, String> {
        assert!(most <= Duration::from_millis(40));
        Ok(std::mem::take(&mut self.0.lock().unwrap().1))
    }

    fn close(&mut self) {}
}

#[test]
fn after_lost_events_the_state_is_asked_for() {
    let mut layout = Layout {
        name: "Pad".into(),
        axes: vec![Axis { code: 0, minimum: -100, maximum: 100, value: 0 }],
        buttons: vec![Button { code: 0x130, is_pressed: false }],
    };
    let source = Overrun(Arc::new(Mutex::new((layout.clone(), Vec::new()))));
    let link = DeviceLink::new(InputDevice::new(source.clone()));
    let mut live = bench(link, options([("autorepeat_rate", 0.0.into())]));
    pass(&mut live.probe, 10);
    assert_eq!(live.joy.take().len(), 1);
    layout.axes[0].value = -100;
    layout.buttons[0].is_pressed = true;
    // SYN_DROPPED: what comes before the next report is not believed.
    *source.0.lock().unwrap() = (layout, events(1, &[(0, 3, 0), (ABSOLUTE, 0, 7), (KEY, 0x130, 0)]));
    pass(&mut live.probe, 10);
    let joy = live.joy.take();
    assert_eq!(joy.len(), 1);
    assert_eq!((joy[0].axes.as_slice(), joy[0].buttons.as_slice()), (&[1.0][..], &[1][..]));
    pass(&mut live.probe, 1_000);
    assert_eq!(last_value(&live.diagnostics, "times events were lost"), "1");
}

#[test]
fn a_damaged_recording_stops_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("drive.events");
    let drive: Vec<u8> =
        (0..20).flat_map(|step| events(step * 10_000, &[(ABSOLUTE, 1, step as i32 * 600)])).collect();
    fs::write(&file, &drive).unwrap();
    let settings = || options([("device", text(file.display()))]);
    let mut live = bench(emulated(), settings());
    pass(&mut live.probe, 300);
    let recorded = live.exchanges.take();
    for round in rounds(60) {
        let mut random = Random::new(round);
        let mut damaged = recorded.clone();
        for _ in 0..3 {
            let place = random.below(damaged.len());
            let mut reply = damaged[place].reply.to_vec();
            let at = random.below(reply.len());
            if let Some(byte) = reply.get_mut(at) {
                *byte = random.below(256) as u8;
            }
            reply.truncate(reply.len().saturating_sub(random.below(2) * random.below(30)));
            damaged[place].reply = reply;
            damaged[place].outcome = random.below(4) as u8;
        }
        let mut again = bench(DeviceLink::recorded(damaged), settings());
        pass(&mut again.probe, 300);
        for joy in again.joy.take() {
            assert!(joy.axes.iter().all(|axis| (-1.0..=1.0).contains(axis)));
        }
    }
}
