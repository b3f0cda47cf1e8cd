//! Joints that a hand turns, as their servos count them: emulated ones, which are turned by this test.

use super::tool::ServoPort;
use super::*;
use std::f64::consts::{PI, TAU};

/// How often the joints are read while one is turned, at most.
const LOOKS: usize = 100_000;

/// A described bus with servos that are put together as `real` says.
struct Bench {
    emulator: Emulator,
    calibrator: Calibrator,
    described: BusPlan,
}

/// One joint at `id` 1.
fn described(protocol: &str, model: &str, joint: &str) -> String {
    format!(
        "name = \"arm\"\n[[bus]]\nname = \"bus\"\nport = \"p\"\nbaud = 1000000\nprotocol = \"{protocol}\"\ncycle_ms = 10\n\
         [[joint]]\nname = \"pan\"\nid = 1\nmodel = \"{model}\"\n{joint}\n"
    )
}

fn begin(emulator: &Emulator, described: &BusPlan) -> Calibrator {
    let port = ServoPort::on(Box::new(emulator.bus()), "p", Vec::new()).unwrap();
    Calibrator::on(port, described).unwrap()
}

impl Bench {
    fn of(protocol: &str, model: &str, described_as: &str, real: &str) -> Self {
        let plan = |joint: &str| {
            let text = described(protocol, model, joint);
            Description::load(&text).unwrap().bus("").unwrap().clone()
        };
        let options = EmulatorOptions { timing: Timing::Immediate, seed: 4, ..Default::default() };
        let emulator = Emulator::servos_in_memory(&plan(real), &options);
        let described = plan(described_as);
        Self { calibrator: begin(&emulator, &described), emulator, described }
    }

    /// Turns the joint to these angles, one after the other.
    fn turn(&mut self, angles: &[f64]) {
        for angle in angles {
            assert!(self.emulator.turn_by_hand("pan", *angle));
            let looks = (0..LOOKS).take_while(|_| {
                self.calibrator.look().unwrap();
                self.emulator.is_in_hand("pan")
            });
            assert!(looks.count() < LOOKS, "the hand does not get to {angle}");
        }
        self.calibrator.look().unwrap();
    }

    fn raw(&self, register: &str) -> i64 {
        let mut port = ServoPort::on(Box::new(self.emulator.bus()), "p", Vec::new()).unwrap();
        port.speak(self.described.line).unwrap();
        let (found, model) = port.known(protocol::Id::new(1).unwrap()).unwrap();
        port.read(found.id, &ServoPort::register(&model, register).unwrap()).unwrap()
    }

    /// What is found with stops at the extremes so far, and 0 rad and a nudge of 0.3 rad as the joint is
    /// `real`.
    fn finish(&mut self) -> (Vec<String>, Vec<JointCalibration>) {
        let notes = self.calibrator.take_stops().unwrap();
        self.turn(&[0.0]);
        self.calibrator.take_zeros(ZeroPose::Here);
        if self.calibrator.is_calibrated(0) {
            self.calibrator.begin_nudge(0);
            self.turn(&[0.3]);
            assert!(self.calibrator.take_sign(0));
        }
        (notes, self.calibrator.results(0.1))
    }
}

const WHEELS: [(&str, &str, &str); 3] = [
    ("feetech_sts", "STS3215", "mode = \"velocity\"\nmax_velocity_rad_s = 3.0"),
    ("dynamixel2", "XM430-W350", "mode = \"velocity\"\nmax_velocity_rad_s = 3.0"),
    ("dynamixel2", "XM430-W350", "mode = \"effort\"\nmax_current_a = 1.0"),
];

#[test]
fn a_wheel_gets_no_limits_however_far_it_is_turned() {
    for (protocol, model, wheel) in WHEELS {
        for furthest in [1.0, 3.0 * TAU] {
            let real = format!("{wheel}\nsign = -1\nzero = 700");
            let mut bench = Bench::of(protocol, model, wheel, &real);
            bench.turn(&[furthest, 0.0]);
            let (notes, found) = bench.finish();
            assert_eq!(notes, ["pan has no limits, as it is described, and gets none"], "{model}");
            let [found] = &found[..] else { panic!("{found:?}") };
            assert_eq!((found.limits, found.sign), (None, -1), "{model}");
            assert!((found.zero - 700).abs() < 3, "{model}: the zero is within a turn: {}", found.zero);
        }
    }
}

#[test]
fn a_joint_without_stops_keeps_its_limits_and_gets_zero_and_sign() {
    for (protocol, model) in [("feetech_sts", "STS3215"), ("dynamixel2", "XM430-W350")] {
        let real = "limits = [-1.0, 1.0]\nsign = -1\nzero = 1900";
        let mut bench = Bench::of(protocol, model, "limits = [-1.0, 1.0]", real);
        bench.turn(&[4.0, -2.5, 0.0]);
        let (notes, found) = bench.finish();
        assert_eq!(notes, ["pan turns all the way round: its limits stay as they are described"], "{model}");
        let [found] = &found[..] else { panic!("{found:?}") };
        assert_eq!((found.limits, found.sign), (None, -1), "{model}");
        assert!((found.zero - 1900).abs() < 3, "{model}: {}", found.zero);
    }
}

/// The travel of a servo that was turned once round before, or has an offset with which it counts too far.
#[test]
fn a_travel_of_a_dynamixel_is_brought_into_the_turn_that_it_keeps() {
    let real = "limits = [-1.2, 1.5]\nzero = 2000\nsign = -1";
    let ends = |found: &[JointCalibration]| {
        let [found] = found else { panic!("{found:?}") };
        let limits = found.limits.unwrap();
        assert!((limits[0] + 1.1).abs() < 0.01 && (limits[1] - 1.4).abs() < 0.01, "{limits:?}");
        assert_eq!(found.sign, -1);
        found.clone()
    };
    // Once round, then between its stops: it counts whole turns, which it forgets without power.
    let mut bench = Bench::of("dynamixel2", "XM430-W350", "limits = [-3.0, 3.0]", real);
    bench.turn(&[-TAU]);
    bench.calibrator = begin(&bench.emulator, &bench.described);
    bench.turn(&[-TAU - 1.2, -TAU + 1.5, -TAU]);
    let notes = bench.calibrator.take_stops().unwrap();
    assert!(notes.len() == 1 && notes[0].contains("switch it off and on before the robot runs"), "{notes:?}");
    bench.calibrator.take_zeros(ZeroPose::Here);
    bench.calibrator.begin_nudge(0);
    bench.turn(&[-TAU + 0.3]);
    assert!(bench.calibrator.take_sign(0));
    let found = ends(&bench.calibrator.results(0.1));
    assert!((found.zero - 2000).abs() < 3, "{}", found.zero);

    // With its offset it counts beyond its turn: another one is found, and the description says so.
    let with = |offset: i64| format!("registers = {{ homing_offset = {offset} }}\nlimits = [-1.2, 1.5]");
    let real = format!("{}\nzero = 2900\nsign = -1", with(1000));
    let mut bench =
        Bench::of("dynamixel2", "XM430-W350", &with(1000).replace("[-1.2, 1.5]", "[-1.0, 1.0]"), &real);
    bench.turn(&[-1.2, 1.5]);
    let (notes, found) = bench.finish();
    assert!(notes.len() == 1 && notes[0].contains("its homing_offset is -"), "{notes:?}");
    let found = ends(&found);
    let offset = bench.raw("homing_offset");
    assert!((-1024..0).contains(&offset), "{offset}");
    assert_eq!(found.homing_offset, Some(offset));
    assert!((found.zero - (2900 + offset)).abs() < 3, "{} with {offset}", found.zero);
}

#[test]
fn what_an_offset_cannot_solve_is_said_and_nothing_is_written() {
    // At the end of its turn; the other way round it would go all the way.
    let real = "limits = [-1.2, 1.5]\nzero = 2048\nregisters = { homing_offset = 500 }";
    let mut bench = Bench::of("dynamixel2", "XM430-W350", "limits = [-1.0, 1.0]", real);
    bench.turn(&[PI - 0.5, PI + 0.5]);
    let (notes, found) = bench.finish();
    assert!(notes.len() == 1 && notes[0].contains("which its homing_offset does not move"), "{notes:?}");
    assert_eq!((found.len(), bench.raw("homing_offset")), (0, 500));

    let real = "limits = [-1.2, 1.5]\nregisters = { homing_offset = 1500 }";
    let mut bench = Bench::of("dynamixel2", "XM430-W350", "limits = [-1.0, 1.0]", real);
    bench.turn(&[-1.2, 1.5]);
    let (notes, found) = bench.finish();
    assert!(
        notes.len() == 1 && notes[0].contains("`downbeat servo write p 1 homing_offset 0 --force`"),
        "{notes:?}"
    );
    assert_eq!((found.len(), bench.raw("homing_offset")), (0, 1500));
}

/// An offset of the description would be written again at the start of the next run.
#[test]
fn an_offset_that_the_description_sets_is_found_anew_with_the_servo() {
    let with = |offset: i64| format!("registers = {{ homing_offset = {offset} }}\nlimits = [-1.0, 1.0]");
    let mut bench = Bench::of("feetech_sts", "STS3215", &with(-1852), &with(-1852));
    bench.turn(&[-1.2, 1.5]);
    let (notes, found) = bench.finish();
    assert!(notes.len() == 1 && notes[0].contains("pan passed the end"), "{notes:?}");
    let offset = bench.raw("homing_offset");
    assert!(offset != -1852 && found[0].homing_offset == Some(offset), "{found:?}, {offset}");
}
