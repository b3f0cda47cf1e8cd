//! The features of `downbeat`: what each of them adds, and what a program without one says about it.

use crate::Catalog;

/// A feature of the package `downbeat` that adds more than commands.
struct Feature {
    /// Its name in Cargo.toml.
    name: &'static str,
    is_built_in: bool,
    /// The kinds of modules that it adds.
    kinds: &'static [&'static str],
    /// Whether the Python wheel can have it: the features of python/Cargo.toml.
    is_in_wheel: bool,
}

const NOTHING: Feature = Feature { name: "", is_built_in: false, kinds: &[], is_in_wheel: true };

const SENSORS: &[&str] = &[
    "camera",
    "camera_emulator",
    "can",
    "can_emulator",
    "gpio",
    "gpio_emulator",
    "gps",
    "gps_emulator",
    "imu",
    "imu_emulator",
    "joy_teleop",
    "joystick",
    "joystick_emulator",
    "lidar",
    "lidar_emulator",
];

const FEATURES: [Feature; 15] = [
    Feature {
        name: "football",
        is_built_in: cfg!(feature = "football"),
        kinds: &["football_match", "head", "localisation", "team", "truth_beliefs", "vision", "walk_to"],
        ..NOTHING
    },
    Feature {
        name: "leagues",
        is_built_in: cfg!(feature = "leagues"),
        kinds: &["game_controller", "game_controller_sender", "team_communication"],
        ..NOTHING
    },
    Feature { name: "mqtt", is_built_in: cfg!(feature = "mqtt"), kinds: &["mqtt"], ..NOTHING },
    Feature { name: "mujoco", is_built_in: cfg!(feature = "mujoco"), ..NOTHING },
    Feature {
        name: "network",
        is_built_in: cfg!(feature = "network"),
        kinds: &["tcp_lines", "udp_lines"],
        ..NOTHING
    },
    Feature {
        name: "physics",
        is_built_in: cfg!(feature = "physics"),
        kinds: &["darwin_op_simulator", "humanoid_simulator"],
        ..NOTHING
    },
    Feature { name: "policy", is_built_in: cfg!(feature = "policy"), kinds: &["policy"], ..NOTHING },
    Feature { name: "px4", is_built_in: cfg!(feature = "px4"), kinds: &["px4", "px4_emulator"], ..NOTHING },
    Feature { name: "security", is_built_in: cfg!(feature = "security"), ..NOTHING },
    Feature { name: "sensors", is_built_in: cfg!(feature = "sensors"), kinds: SENSORS, ..NOTHING },
    Feature { name: "sqlite", is_built_in: cfg!(feature = "sqlite"), is_in_wheel: false, ..NOTHING },
    Feature {
        name: "state_machine",
        is_built_in: cfg!(feature = "state_machine"),
        kinds: &["state_machine"],
        ..NOTHING
    },
    Feature { name: "tables", is_built_in: cfg!(feature = "tables"), ..NOTHING },
    Feature { name: "view", is_built_in: cfg!(feature = "view"), ..NOTHING },
    Feature { name: "zenoh", is_built_in: cfg!(feature = "zenoh"), ..NOTHING },
];

/// What a program without a feature says where it is needed: the end of a sentence.
pub fn built_without(feature: &str) -> String {
    let is_in_wheel = !FEATURES.iter().any(|known| known.name == feature && !known.is_in_wheel);
    let wheel = match is_in_wheel {
        true => {
            format!(", or install a wheel of a release, or that of `cargo xtask wheel --features {feature}`")
        }
        false => String::new(),
    };
    format!(
        "built without \"{feature}\": build or `cargo install downbeat` with --features {feature} (an app: as a feature of downbeat in its \
         Cargo.toml){wheel}"
    )
}

/// Why a program has no kind of this name, if it knows.
pub fn missing_kind(kind: &str) -> Option<String> {
    missing_kind_if(kind, |feature| feature.is_built_in)
}

fn missing_kind_if(kind: &str, is_built_in: impl Fn(&Feature) -> bool) -> Option<String> {
    if kind == "python" {
        return Some(
            "modules in Python are for the command `downbeat` of the wheel: build it with `cargo xtask wheel`, install it \
             with `pip install target/wheels/release/downbeat_robotics-*.whl`"
                .to_owned(),
        );
    }
    let feature = FEATURES.iter().find(|feature| feature.kinds.contains(&kind))?;
    match is_built_in(feature) {
        // An app without the built-in kinds.
        true => Some("the app lacks the built-in kinds: `App::with_built_in_kinds` has them".to_owned()),
        false => Some(built_without(feature.name)),
    }
}

/// The kinds that this program lacks, with the features that have them, by name.
pub fn missing_kinds(catalog: &Catalog) -> Vec<(&'static str, &'static str)> {
    let kinds = FEATURES.iter().filter(|feature| !feature.is_built_in).flat_map(|feature| {
        let missing = feature.kinds.iter().filter(|kind| catalog.kind(kind).is_none());
        missing.map(|kind| (*kind, feature.name))
    });
    let mut kinds: Vec<_> = kinds.collect();
    kinds.sort_unstable();
    kinds
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::collections::BTreeSet;
    use std::path::Path;

    fn workspace() -> &'static Path {
        Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
    }

    fn read(path: &str) -> String {
        std::fs::read_to_string(workspace().join(path)).unwrap()
    }

    #[test]
    fn a_kind_that_is_not_built_in_names_its_feature_and_the_ways_to_have_it() {
        let without = |kind| missing_kind_if(kind, |_| false);
        let expected = "built without \"physics\": build or `cargo install downbeat` with --features physics (an app: as a feature of \
                        downbeat in its Cargo.toml), or install a wheel of a release, or that of `cargo xtask wheel --features physics`";
        assert_eq!(without("darwin_op_simulator").unwrap(), expected);
        assert!(without("walk_to").unwrap().starts_with("built without \"football\": "));
        assert!(without("game_controller").unwrap().starts_with("built without \"leagues\": "));
        assert!(without("udp_lines").unwrap().starts_with("built without \"network\": "));
        assert!(without("mqtt").unwrap().starts_with("built without \"mqtt\": "));
        assert!(without("state_machine").unwrap().starts_with("built without \"state_machine\": "));
        assert_eq!(without("darwin"), None);
        let app = missing_kind_if("mqtt", |_| true).unwrap();
        assert!(app.contains("App::with_built_in_kinds"), "{app}");
        assert!(!built_without("sqlite").contains("wheel"), "it compiles C");
    }

    #[test]
    fn every_kind_of_a_feature_is_listed_and_no_other() {
        let listed = FEATURES.iter().filter(|feature| feature.is_built_in).flat_map(|feature| feature.kinds);
        let listed: BTreeSet<&str> = listed.copied().collect();
        let of_features = crate::kinds_of_features();
        assert_eq!(listed, of_features.iter().map(String::as_str).collect());
        assert!(missing_kinds(&Catalog::built_in()).iter().all(|(kind, _)| !listed.contains(kind)));
    }

    #[test]
    fn the_wheel_is_built_with_every_feature_that_this_says() {
        let manifest = read("python/Cargo.toml");
        let full = manifest.lines().find(|line| line.starts_with("full = ")).unwrap();
        for feature in FEATURES.iter().filter(|feature| feature.name != "view") {
            let is_named = full.contains(&format!("\"{}\"", feature.name));
            assert_eq!(is_named, feature.is_in_wheel, "{}", feature.name);
            let itself = format!("\n{0} = [\"downbeat/{0}\"]\n", feature.name);
            // Others may be added to a wheel: SQLite is in those of releases.
            assert!(manifest.contains(&itself) || !feature.is_in_wheel, "{}", feature.name);
        }
    }

    #[test]
    fn a_program_that_talks_to_a_broker_contains_no_football() {
        let packages = |feature| {
            let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
            let mut command = std::process::Command::new(cargo);
            command.args(["tree", "--locked", "--offline", "--edges", "normal", "--prefix", "none"]);
            command.args(["--package", "downbeat", "--features", feature]);
            let output = command.current_dir(workspace()).output().unwrap();
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            String::from_utf8(output.stdout).unwrap()
        };
        for feature in ["network", "mqtt"] {
            let packages = packages(feature);
            assert!(packages.contains("downbeat-network v"), "{packages}");
            let football = packages.lines().find(|package| package.contains("/modules/football/"));
            assert_eq!(football, None, "{feature}");
        }
        assert!(packages("leagues").contains("/modules/football/leagues)"));
    }

    #[test]
    fn every_feature_of_the_package_is_known() {
        let manifest = read("Cargo.toml");
        let features = manifest.split("[features]\n").nth(1).unwrap().split("\n[").next().unwrap();
        let names = features.lines().filter_map(|line| line.split_once(" = ["));
        let names: BTreeSet<&str> = names
            .map(|(name, _)| name)
            .filter(|name| !["default", "cli", "plots", "rustdds", "top"].contains(name))
            .collect();
        assert_eq!(names, FEATURES.iter().map(|feature| feature.name).collect());
    }
}
