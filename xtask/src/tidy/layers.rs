//! What may use what: the lists of the layout.

use std::collections::{BTreeMap, BTreeSet};

use super::Problems;

/// The packages, and those on which each may build; tests may use more. Those of the product stand from
/// bottom to top.
pub(super) const PACKAGES: &[(&str, &[&str])] = &[
    ("downbeat-executor", &[]),
    ("downbeat-files", &[]),
    ("downbeat-msgs-definitions", &["downbeat-files"]),
    ("downbeat-msgs-generator", &["downbeat-msgs-definitions"]),
    ("downbeat-msgs-derive", &["downbeat-msgs-definitions", "downbeat-msgs-generator"]),
    (
        "downbeat-msgs",
        &["downbeat-files", "downbeat-msgs-definitions", "downbeat-msgs-derive", "downbeat-msgs-generator"],
    ),
    ("downbeat-bags", &["downbeat-msgs"]),
    ("downbeat-rtps", &[]),
    ("downbeat-zenoh", &[]),
    ("downbeat-security", &["downbeat-rtps"]),
    ("downbeat-edge", &["downbeat-executor", "downbeat-msgs"]),
    (
        "downbeat-bridge",
        &[
            "downbeat-edge",
            "downbeat-executor",
            "downbeat-msgs",
            "downbeat-rtps",
            "downbeat-security",
            "downbeat-zenoh",
        ],
    ),
    ("downbeat-view", &["downbeat-bags", "downbeat-edge", "downbeat-executor", "downbeat-msgs"]),
    ("test-machine", &[]),
    ("downbeat-conformance", &["downbeat-bridge", "downbeat-msgs", "downbeat-zenoh", "test-machine"]),
    ("downbeat-device", &["downbeat-executor", "downbeat-files", "downbeat-msgs"]),
    ("downbeat-kind", &["downbeat-device", "downbeat-edge", "downbeat-executor", "downbeat-msgs"]),
    ("downbeat-imu-filter", &["downbeat-executor", "downbeat-kind", "downbeat-msgs"]),
    ("downbeat-actions", &["downbeat-executor", "downbeat-msgs"]),
    ("downbeat-transforms", &["downbeat-actions", "downbeat-executor", "downbeat-kind", "downbeat-msgs"]),
    (
        "downbeat-kinematics",
        &["downbeat-executor", "downbeat-files", "downbeat-kind", "downbeat-msgs", "downbeat-transforms"],
    ),
    (
        "downbeat-servos",
        &[
            "downbeat-actions",
            "downbeat-device",
            "downbeat-executor",
            "downbeat-files",
            "downbeat-kind",
            "downbeat-msgs",
            "downbeat-transforms",
        ],
    ),
    (
        "downbeat-darwin-op",
        &[
            "downbeat-actions",
            "downbeat-executor",
            "downbeat-files",
            "downbeat-kind",
            "downbeat-kinematics",
            "downbeat-msgs",
            "downbeat-servos",
            "downbeat-transforms",
        ],
    ),
    ("downbeat-pictures", &["downbeat-msgs"]),
    (
        "downbeat-sensors",
        &[
            "downbeat-device",
            "downbeat-executor",
            "downbeat-files",
            "downbeat-kind",
            "downbeat-msgs",
            "downbeat-pictures",
            "downbeat-servos",
        ],
    ),
    (
        "downbeat-network",
        &["downbeat-device", "downbeat-edge", "downbeat-executor", "downbeat-kind", "downbeat-msgs"],
    ),
    (
        "downbeat-physics",
        &[
            "downbeat-actions",
            "downbeat-darwin-op",
            "downbeat-executor",
            "downbeat-files",
            "downbeat-imu-filter",
            "downbeat-kind",
            "downbeat-kinematics",
            "downbeat-msgs",
            "downbeat-msgs-generator",
            "downbeat-servos",
            "downbeat-transforms",
        ],
    ),
    ("downbeat-football", &["downbeat-files", "downbeat-msgs", "downbeat-msgs-generator"]),
    (
        "downbeat-leagues",
        &[
            "downbeat-device",
            "downbeat-executor",
            "downbeat-football",
            "downbeat-kind",
            "downbeat-msgs",
            "downbeat-network",
        ],
    ),
    (
        "downbeat-vision",
        &[
            "downbeat-executor",
            "downbeat-files",
            "downbeat-football",
            "downbeat-kind",
            "downbeat-msgs",
            "downbeat-pictures",
            "downbeat-transforms",
        ],
    ),
    (
        "downbeat-localisation",
        &["downbeat-executor", "downbeat-football", "downbeat-kind", "downbeat-msgs", "downbeat-transforms"],
    ),
    (
        "downbeat-player",
        &[
            "downbeat-executor",
            "downbeat-football",
            "downbeat-kind",
            "downbeat-kinematics",
            "downbeat-msgs",
            "downbeat-servos",
        ],
    ),
    (
        "downbeat-match",
        &[
            "downbeat-darwin-op",
            "downbeat-executor",
            "downbeat-football",
            "downbeat-imu-filter",
            "downbeat-kind",
            "downbeat-msgs",
            "downbeat-physics",
            "downbeat-player",
            "downbeat-servos",
            "downbeat-transforms",
        ],
    ),
    (
        "downbeat-policy",
        &["downbeat-edge", "downbeat-executor", "downbeat-files", "downbeat-kind", "downbeat-msgs"],
    ),
    (
        "downbeat-px4",
        &[
            "downbeat-executor",
            "downbeat-kind",
            "downbeat-msgs",
            "downbeat-msgs-definitions",
            "downbeat-msgs-generator",
            "downbeat-servos",
            "downbeat-transforms",
        ],
    ),
    (
        "downbeat-state-machine",
        &[
            "downbeat-edge",
            "downbeat-executor",
            "downbeat-files",
            "downbeat-kind",
            "downbeat-msgs",
            "downbeat-msgs-generator",
        ],
    ),
    ("downbeat-library-abi", &["downbeat-executor"]),
    (
        "downbeat-library-host",
        &[
            "downbeat-edge",
            "downbeat-executor",
            "downbeat-files",
            "downbeat-kind",
            "downbeat-library-abi",
            "downbeat-msgs",
        ],
    ),
    (
        "downbeat-library",
        &["downbeat-actions", "downbeat-edge", "downbeat-executor", "downbeat-library-abi", "downbeat-msgs"],
    ),
    ("downbeat-robots", &[]),
    (
        "downbeat-robot",
        &[
            "downbeat-actions",
            "downbeat-bags",
            "downbeat-bridge",
            "downbeat-darwin-op",
            "downbeat-edge",
            "downbeat-executor",
            "downbeat-files",
            "downbeat-football",
            "downbeat-imu-filter",
            "downbeat-kind",
            "downbeat-kinematics",
            "downbeat-leagues",
            "downbeat-library-host",
            "downbeat-localisation",
            "downbeat-match",
            "downbeat-msgs",
            "downbeat-network",
            "downbeat-physics",
            "downbeat-pictures",
            "downbeat-player",
            "downbeat-policy",
            "downbeat-px4",
            "downbeat-robots",
            "downbeat-sensors",
            "downbeat-servos",
            "downbeat-state-machine",
            "downbeat-transforms",
            "downbeat-view",
            "downbeat-vision",
        ],
    ),
    (
        "downbeat-program",
        &[
            "downbeat-bags",
            "downbeat-bridge",
            "downbeat-darwin-op",
            "downbeat-edge",
            "downbeat-executor",
            "downbeat-files",
            "downbeat-football",
            "downbeat-kinematics",
            "downbeat-library-host",
            "downbeat-match",
            "downbeat-msgs",
            "downbeat-network",
            "downbeat-robot",
            "downbeat-robots",
            "downbeat-servos",
            "downbeat-state-machine",
            "downbeat-view",
            "downbeat-vision",
            "downbeat-security",
            "downbeat-zenoh",
        ],
    ),
    (
        "downbeat",
        &[
            "downbeat-actions",
            "downbeat-bags",
            "downbeat-bridge",
            "downbeat-darwin-op",
            "downbeat-device",
            "downbeat-edge",
            "downbeat-executor",
            "downbeat-football",
            "downbeat-imu-filter",
            "downbeat-kinematics",
            "downbeat-library-host",
            "downbeat-msgs",
            "downbeat-physics",
            "downbeat-program",
            "downbeat-px4",
            "downbeat-robot",
            "downbeat-servos",
            "downbeat-transforms",
            "downbeat-view",
            "downbeat-vision",
        ],
    ),
    ("downbeat-python", &["downbeat", "downbeat-bags", "downbeat-edge", "downbeat-msgs", "shared-build"]),
    // What builds, tests, measures and demonstrates it.
    ("benches", &["downbeat", "downbeat-executor", "downbeat-zenoh"]),
    ("benches-bags", &["downbeat", "downbeat-bags", "downbeat-executor", "downbeat-msgs"]),
    (
        "benches-ros2",
        &[
            "downbeat-bridge",
            "downbeat-executor",
            "downbeat-msgs",
            "downbeat-security",
            "downbeat-zenoh",
            "fuzzing",
        ],
    ),
    ("camera", &["downbeat"]),
    ("downbeat-library-example", &["downbeat-library", "user-msgs"]),
    ("downbeat-start", &[]),
    ("embedding", &["downbeat"]),
    ("executor_alone", &["downbeat-executor"]),
    ("fuzzing", &[]),
    ("own_device", &["downbeat", "downbeat-msgs"]),
    ("own_message", &["downbeat", "downbeat-msgs", "downbeat-msgs-generator"]),
    ("px4_offboard", &["downbeat"]),
    ("python-peer", &["test-machine"]),
    ("readme-runner", &["test-machine"]),
    ("service_and_action", &["downbeat", "downbeat-msgs", "downbeat-msgs-generator"]),
    ("shared-build", &["downbeat-msgs"]),
    ("swarm", &["downbeat"]),
    ("two_modules", &["downbeat"]),
    ("user-msgs", &["downbeat-msgs", "downbeat-msgs-generator"]),
    ("xtask", &["downbeat-start", "test-machine"]),
];

/// The folders of `executor/src` from top to bottom; each uses only those below it.
const EXECUTOR: &[&str] = &[
    "tutorial",
    "probe",
    "api",
    "log",
    "exchange",
    "launchers",
    "cycle",
    "module",
    "topics",
    "observe",
    "queue",
    "threads",
    "time",
    "error",
];

/// The problem of a file that uses one of a higher folder, by `names`.
pub(super) fn upward(from: &str, to: &str, names: &BTreeSet<String>) -> Option<String> {
    let (above, below) = (rank(to)?, rank(from)?);
    let names = names.iter().cloned().collect::<Vec<_>>().join(", ");
    (above < below)
        .then(|| format!("{from}: uses {names} of {to}, which is above it (xtask/src/tidy/layers.rs)"))
}

fn rank(file: &str) -> Option<usize> {
    let inside = file.strip_prefix("executor/src/")?;
    let folder = inside.split(['/', '.']).next()?;
    EXECUTOR.iter().position(|known| *known == folder)
}

/// For which names a file uses another.
pub(super) type Tied = BTreeMap<(String, String), BTreeSet<String>>;

/// Each circle of files, with the names that tie it.
pub(super) fn circles(found: &BTreeSet<Vec<String>>, tied: &Tied) -> Problems {
    let ties = |circle: &[String]| {
        let ties = tied.iter().filter(|((from, to), _)| circle.contains(from) && circle.contains(to));
        let line = |((from, to), names): (&(String, String), &BTreeSet<String>)| {
            let names: Vec<_> = names.iter().map(String::as_str).collect();
            format!("\n    {from} uses {} of {to}", names.join(", "))
        };
        ties.map(line).collect::<String>()
    };
    let problem = |circle: &Vec<String>| {
        format!("{}: files that use each other in a circle{}", circle.join(" "), ties(circle))
    };
    found.iter().map(problem).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packages_stand_above_those_on_which_they_build() {
        for (index, (name, uses)) in
            PACKAGES.iter().enumerate().take_while(|(_, (name, _))| *name != "benches")
        {
            let is_below = |used: &&str| PACKAGES[..index].iter().any(|(below, _)| below == used);
            let above: Vec<_> = uses.iter().filter(|used| !is_below(used)).collect();
            assert!(above.is_empty() || *name == "downbeat-python", "{name} stands below {above:?}");
        }
    }

    #[test]
    fn a_folder_uses_those_below_it() {
        let names = BTreeSet::from(["Core".to_owned()]);
        assert_eq!(upward("executor/src/cycle/core.rs", "executor/src/time/mod.rs", &names), None);
        let problem = upward("executor/src/topics/topic.rs", "executor/src/cycle/core.rs", &names);
        assert!(problem.is_some_and(|text| text.starts_with("executor/src/topics/topic.rs: uses Core of")));
    }

    #[test]
    fn a_circle_is_a_problem_with_the_names_that_tie_it() {
        let circle = BTreeSet::from([vec!["a.rs".to_owned(), "d.rs".to_owned()]]);
        let tie = ("d.rs".to_owned(), "a.rs".to_owned());
        let tied = Tied::from([(tie, BTreeSet::from(["Thing".to_owned()]))]);
        assert_eq!(circles(&BTreeSet::new(), &tied), Problems::new());
        let problems = circles(&circle, &tied);
        let expected = "a.rs d.rs: files that use each other in a circle\n    d.rs uses Thing of a.rs";
        assert!(problems.iter().eq([expected]), "{problems:?}");
    }
}
