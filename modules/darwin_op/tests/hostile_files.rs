//! Files of motions and servos that nobody wrote in good faith: every text is read or refused, in bounded
//! memory and time.
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat_darwin_op::humanoid::Humanoid;
use downbeat_darwin_op::motions::{MotionFileError, Motions};
use downbeat_servos::servo_bus::Description;
use fuzzing::{Random, assert_refused, change_lines, most_in, rounds};

const MOTIONS: &str = r#"[wave]
about = "waves"
interpolation = "smooth"
stiffness = 1.5
balance = { tilt = 0.5, rate = 0.1 }
[[wave.frame]]
duration_s = 1.0
pause_s = 0.5
degrees = { r_sho_pitch = 30.0, r_el = -40.0 }
[[wave.frame]]
duration_s = 0.9
radians = { r_el = 0.35 }
[wave_left]
mirror_of = "wave"
"#;

const SERVOS: &str = r#"name = "arm"
[[bus]]
name = "bus"
port = "p"
baud = 1000000
protocol = "feetech_sts"
cycle_ms = 10
[defaults]
model = "STS3215"
approach_rad_s = 1.0
[[joint]]
name = "pan"
id = 1
limits = [-1.0, 1.0]
sign = -1
gear = 1.5
offset = 20
zero = 2048
max_torque = 0.5
guard = { shutdown_rest_s = 2.0 }
command_timeout_s = 0.5
"#;

fn parse(text: &str) -> Result<Motions, MotionFileError> {
    Motions::parse("x.toml", text, Humanoid::darwin_op().joints())
}

/// Degrees of a frame.
const MORE: [&str; 1] = ["{ r_el = nan }"];

#[test]
fn random_changes_of_files_are_read_or_refused_with_a_line() {
    parse(MOTIONS).unwrap();
    Description::parse("x.toml", SERVOS).unwrap();
    for round in rounds(2_000) {
        let mut random = Random::new(round);
        let text = change_lines(MOTIONS, &MORE, &mut random);
        let (most, result) = most_in(|| parse(&text));
        assert!(most < 4 << 20, "round {round}: {most} bytes");
        match result {
            Err(error) => assert!(error.to_string().starts_with("x.toml:"), "round {round}: {error}"),
            Ok(motions) => {
                let durations = motions.names().map(|name| motions.get(name).unwrap().duration());
                assert!(durations.into_iter().all(|seconds| (0.0..1e6).contains(&seconds)), "round {round}");
            }
        }
        let text = change_lines(SERVOS, &MORE, &mut random);
        let (most, result) = most_in(|| Description::parse("x.toml", &text));
        assert!(most < 4 << 20, "round {round}: {most} bytes");
        match result {
            Err(error) => assert!(error.to_string().starts_with("x.toml:"), "round {round}: {error}"),
            Ok(description) => {
                for joint in description.buses().iter().flat_map(|bus| &bus.joints) {
                    for raw in [i64::from(u32::MAX), -i64::from(u32::MAX), 0, 4095] {
                        assert!(!joint.angle(raw).is_nan(), "round {round}: {text}");
                    }
                    for angle in [f64::NAN, f64::MAX, f64::MIN, 0.0, 7.0, -1e9] {
                        let [low, high] = joint.goal_range();
                        assert!(
                            joint.goal(angle).is_none_or(|goal| (low..=high).contains(&goal)),
                            "round {round}: {text}"
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn motions_without_end_are_refused() {
    let frames = "[[a.frame]]\nduration_s = 1.0\n".repeat(10_000);
    let begin = "[a]\n[[a.frame]]\nduration_s = 1.0\ndegrees = { r_el = 1.0 }\n";
    let mirrors: String = (0..10_000).map(|index| format!("[m{index}]\nmirror_of = \"a\"\n")).collect();
    for (text, expected) in [
        (format!("a = {}", "[".repeat(300_000)), "x.toml:1: "),
        (
            format!("{begin}{frames}{mirrors}"),
            "the motions have more than 50000 frames with their mirror images",
        ),
        (
            "[a]\nmirror_of = \"b\"\n[b]\nmirror_of = \"a\"\n".to_owned(),
            "there is no motion \"b\" with frames to mirror",
        ),
        ("[a]\nmirror_of = \"a\"\n".to_owned(), "there is no motion \"a\" with frames to mirror"),
    ] {
        assert_refused(&text, expected, parse);
    }
}

#[cfg(unix)]
#[test]
fn what_is_no_regular_file_is_refused_before_it_is_opened() {
    for path in ["/dev/zero", "/"] {
        let error = Motions::read(path, Humanoid::darwin_op().joints()).unwrap_err().to_string();
        assert!(error.contains("only regular files are read"), "{error}");
        let error = Description::load(path).unwrap_err().to_string();
        assert!(error.contains("only regular files are read"), "{error}");
    }
}
