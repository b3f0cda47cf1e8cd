//! World files that nobody wrote in good faith: every text is read or refused, in bounded memory and time.
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat_physics::WorldFile;
use fuzzing::{Random, assert_refused, change_lines, most_in, rounds};
use std::path::Path;

const WORLD: &str = r#"name = "room"
[floor]
friction = 0.8
colour = [1, 2, 3]
[field]
length = 9.0
goal_area = [0.6, 3.45]
[ball]
position = [0.5, 0.0]
mass = 0.05
[[box]]
name = "crate"
position = [2.0, 1.0, 0.2]
size = [0.4, 0.4, 0.4]
yaw_deg = 30.0
mass = 1.0
[[wall]]
from = [-4.0, -3.0]
to = [4.0, -3.0]
"#;

#[test]
fn random_changes_of_a_world_are_read_or_refused_with_a_line() {
    WorldFile::parse(WORLD, "x.toml").unwrap();
    for round in rounds(2_000) {
        let mut random = Random::new(round);
        let text = change_lines(WORLD, &[], &mut random);
        let (most, result) = most_in(|| WorldFile::parse(&text, "x.toml"));
        assert!(most < 1 << 20, "round {round}: {most} bytes");
        match result {
            Err(error) => assert!(error.to_string().starts_with("x.toml:"), "round {round}: {error}"),
            Ok(world) => {
                let numbers = world
                    .boxes
                    .iter()
                    .flat_map(|block| block.position.into_iter().chain(block.size).chain([block.yaw]));
                assert!(
                    numbers.chain(world.ball.map(|ball| ball.mass)).all(f64::is_finite),
                    "round {round}: {text}"
                );
            }
        }
    }
}

#[test]
fn worlds_without_end_are_refused() {
    let walls = "[[wall]]\nfrom = [0.0, 0.0]\nto = [1.0, 0.0]\n";
    for (text, expected) in [
        (format!("a = {}", "[".repeat(300_000)), "x.toml:1: "),
        (format!("a{} = 1", ".a".repeat(300_000)), "x.toml:1: "),
        (walls.repeat(1001), "1001 boxes and walls; at most 1000"),
        (format!("name = \"{}\"\nb = 1", "a".repeat(1 << 20)), "x.toml:2: unknown field `b`"),
    ] {
        assert_refused(&text, expected, |text| WorldFile::parse(text, "x.toml"));
    }
}

#[cfg(unix)]
#[test]
fn what_is_no_regular_file_is_refused_before_it_is_opened() {
    for path in ["/dev/zero", "/"] {
        let error = WorldFile::read(Path::new(path)).unwrap_err().to_string();
        assert!(error.contains("only regular files are read"), "{error}");
    }
}
