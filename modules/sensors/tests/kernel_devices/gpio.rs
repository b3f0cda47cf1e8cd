use std::fs;
use std::path::Path;

use downbeat_device::DeviceLink;
use downbeat_executor::{Heard, ModuleOptions, Probe};
use downbeat_msgs::diagnostic_msgs::msg::DiagnosticStatus;
use downbeat_msgs::std_msgs::msg::Bool;
use downbeat_sensors::gpio::{Edge, Gpio, GpioDevice, Pins};
use fuzzing::{Random, rounds};

use super::{Bench, bench_of, last_status, last_value, options, pass, text, texts};

struct Topics {
    button: Heard<Bool>,
    edges: Heard<Edge>,
}

fn bench(link: DeviceLink<GpioDevice>, options: ModuleOptions) -> Bench<Topics> {
    bench_of(("pins", Gpio::emulated(link)), options, "gpio/exchanges", |probe| Topics {
        button: probe.listen("gpio/button").unwrap(),
        edges: probe.listen("gpio/edges").unwrap(),
    })
}

fn emulated() -> DeviceLink<GpioDevice> {
    DeviceLink::new(GpioDevice::new(Pins::default()))
}

fn settings(chip: &Path) -> ModuleOptions {
    options([
        ("chip", text(chip.display())),
        ("inputs", texts(["button = 17, pull_up, active_low, debounce_ms=10"])),
        ("outputs", texts(["lamp = 27", "brake = GPIO4, safe=true"])),
        ("timeout_s", 0.5.into()),
    ])
}

fn level(chip: &Path, line: &str) -> String {
    fs::read_to_string(chip.join(line)).unwrap().trim().to_owned()
}

fn values(heard: &Heard<Bool>) -> Vec<bool> {
    heard.take().iter().map(|value| value.data).collect()
}

#[test]
fn inputs_are_published_at_each_change_and_a_recording_repeats_them_bit_for_bit() {
    let chip = tempfile::tempdir().unwrap();
    fs::write(chip.path().join("button"), "1\n").unwrap();
    let mut live = bench(emulated(), settings(chip.path()));
    pass(&mut live.probe, 50);
    assert_eq!(values(&live.button), [false], "not pressed, active low");
    for level in ["0", "0", "1"] {
        fs::write(chip.path().join("button"), level).unwrap();
        pass(&mut live.probe, 50);
    }
    let edges = live.edges.take();
    let told: Vec<_> = edges.iter().map(|edge| (&*edge.name, edge.value)).collect();
    assert_eq!(told, [("button", false), ("button", true), ("button", false)]);
    assert!(edges.windows(2).all(|pair| pair[0].header.stamp.as_nanos() < pair[1].header.stamp.as_nanos()));
    assert_eq!(values(&live.button), [true, false]);
    let mut again = bench(DeviceLink::recorded(live.exchanges.take()), settings(chip.path()));
    pass(&mut again.probe, 200);
    assert_eq!(again.edges.take(), edges);
}

#[test]
fn outputs_are_safe_before_a_command_after_silence_and_at_the_end() {
    let chip = tempfile::tempdir().unwrap();
    let levels = || [level(chip.path(), "lamp"), level(chip.path(), "brake")];
    let mut live = bench(emulated(), settings(chip.path()));
    pass(&mut live.probe, 20);
    assert_eq!(levels(), ["0", "1"]);
    live.probe.publish("gpio/lamp", Bool { data: true }).unwrap();
    live.probe.publish("gpio/brake", Bool { data: false }).unwrap();
    assert_eq!(levels(), ["1", "0"], "at once");
    pass(&mut live.probe, 400);
    live.probe.publish("gpio/brake", Bool { data: false }).unwrap();
    pass(&mut live.probe, 300);
    assert_eq!(levels(), ["0", "0"], "only the lamp fell silent");
    pass(&mut live.probe, 1_300);
    assert_eq!(levels(), ["0", "1"]);
    assert_eq!(last_value(&live.diagnostics, "times commands fell silent"), "2");
    live.probe.publish("gpio/lamp", Bool { data: true }).unwrap();
    live.probe.publish("gpio/brake", Bool { data: false }).unwrap();
    live.probe.core().stop();
    assert_eq!(levels(), ["0", "1"], "at the end");
}

#[test]
fn without_a_folder_inputs_follow_outputs_on_the_same_line() {
    let settings = options([("inputs", texts(["button = 5"])), ("outputs", texts(["lamp = 5, active_low"]))]);
    let mut live = bench(emulated(), settings);
    pass(&mut live.probe, 20);
    live.probe.publish("gpio/lamp", Bool { data: true }).unwrap();
    pass(&mut live.probe, 20);
    live.probe.publish("gpio/lamp", Bool { data: false }).unwrap();
    pass(&mut live.probe, 20);
    assert_eq!(values(&live.button), [true, false, true], "false is high on an output that is active low");
}

#[test]
fn a_chip_that_is_lost_or_has_garbage_is_told_and_opened_again() {
    let folder = tempfile::tempdir().unwrap();
    let (chip, away) = (folder.path().join("chip"), folder.path().join("away"));
    fs::create_dir(&chip).unwrap();
    let mut live = bench(emulated(), settings(&chip));
    pass(&mut live.probe, 20);
    live.probe.publish("gpio/brake", Bool { data: false }).unwrap();
    fs::rename(&chip, &away).unwrap();
    pass(&mut live.probe, 1_500);
    let (status, message) = last_status(&live.diagnostics);
    assert!(status == DiagnosticStatus::ERROR && message.contains("there is no folder"), "{message}");
    fs::rename(&away, &chip).unwrap();
    pass(&mut live.probe, 1_100);
    assert_eq!(last_status(&live.diagnostics), (DiagnosticStatus::OK, "running".to_owned()));
    assert_eq!(level(&chip, "brake"), "1", "the command is old");
    fs::write(chip.join("button"), "high").unwrap();
    pass(&mut live.probe, 20);
    let (_, message) = last_status(&live.diagnostics);
    assert!(message.ends_with("button has \"high\", expected 0 or 1"), "{message}");
}

#[test]
fn lines_that_contradict_each_other_are_refused() {
    let refusal = |inputs, outputs| {
        let settings = options([("inputs", inputs), ("outputs", outputs)]);
        Probe::new().add_with("pins", Gpio::emulated(emulated()), settings).unwrap_err().to_string()
    };
    assert!(refusal(texts(["a = 1"]), texts(["a = 2"])).contains("\"a\" is the name of an input also"));
    assert!(refusal(texts(["a = 1, safe=1"]), texts([])).contains("is none of active_low"));
    let many: Vec<String> = (0..65).map(|line| format!("line_{line} = {line}")).collect();
    assert!(refusal(texts([]), many.into()).contains("more than 64 lines"));
}

#[test]
fn a_damaged_recording_stops_nothing() {
    let chip = tempfile::tempdir().unwrap();
    let mut live = bench(emulated(), settings(chip.path()));
    for value in [true, false, true] {
        fs::write(chip.path().join("button"), if value { "1" } else { "0" }).unwrap();
        live.probe.publish("gpio/lamp", Bool { data: value }).unwrap();
        pass(&mut live.probe, 30);
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
        let mut again = bench(DeviceLink::recorded(damaged), settings(chip.path()));
        pass(&mut again.probe, 100);
    }
}
