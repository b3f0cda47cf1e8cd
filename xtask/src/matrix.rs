//! Generates the table of features that were tested with each peer from the notes of the tests
//! (`bridge/tests/common/matrix.rs`).

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use serde::Deserialize;

use crate::steps::workspace;

/// The order of the headings; all others follow by name.
const HEADINGS: [&str; 16] = [
    "Selection",
    "Topics",
    "Quality of service",
    "Services",
    "Actions",
    "Parameters",
    "Node services",
    "Graph",
    "Discovery",
    "Command line",
    "Environment",
    "Faults",
    "Several hosts",
    SECURITY,
    "Bags",
    BAG_FILES,
];

/// The heading for DDS Security, which the wheels of rclpy are built without.
const SECURITY: &str = "Security";

/// The heading for bags, which have other readers and writers.
const BAG_FILES: &str = "Bag files";

const PAGE: &str = "docs/ros2_matrix.md";

/// Returns the peers of a table with their titles.
fn columns(heading: &str) -> &'static [(&'static str, &'static str)] {
    match heading {
        BAG_FILES => &[
            ("rosbag2", "rosbag2 of Jazzy"),
            ("rclpy", "rclpy of Jazzy"),
            ("mcap", "mcap, Python"),
            ("mcap_ros2", "mcap-ros2-support"),
            ("rosbags", "rosbags"),
            ("mcap_core", "@mcap/core"),
        ],
        SECURITY => &[
            ("secured_cyclonedds", "Cyclone DDS 0.10.2, C"),
            ("secured_fastdds", "Fast DDS 2.9.1, C++"),
            ("rclpy", "rclpy of Jazzy, without security"),
        ],
        _ => &[
            ("rclpy", "rclpy of Jazzy"),
            ("kilted", "rclpy of Kilted"),
            ("cyclonedds", "Cyclone DDS, Python"),
            ("ros2_client", "ros2-client, Rust"),
            ("eclipse_zenoh", "eclipse-zenoh, Python"),
        ],
    }
}

/// A note of a test.
#[derive(Deserialize)]
struct Check {
    heading: String,
    feature: String,
    with: String,
    way: String,
    passed: bool,
    /// The reason, if the test shows that it is not possible.
    limit: Option<String>,
    /// True if this machine does not support the check.
    #[serde(default)]
    is_skipped: bool,
}

/// The place in which tests store their notes.
pub(crate) struct Notes {
    folder: PathBuf,
}

impl Notes {
    /// Creates an empty place for notes.
    pub(crate) fn new() -> anyhow::Result<Self> {
        let folder = workspace().join("target/matrix");
        if folder.exists() {
            std::fs::remove_dir_all(&folder).with_context(|| folder.display().to_string())?;
        }
        std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        Ok(Self { folder })
    }

    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Prints the matrix and compares it with the page in the documentation.
    ///
    /// # Errors
    /// Returns an error if it differs from the page in the documentation.
    pub(crate) fn compare(&self) -> anyhow::Result<()> {
        let checks = self.read()?;
        let skipped = checks.iter().filter(|check| check.is_skipped).count();
        let found = page(&checks);
        println!("{found}");
        let made = self.folder.join("ros2_matrix.md");
        std::fs::write(&made, &found).with_context(|| made.display().to_string())?;
        if skipped > 0 {
            println!("{PAGE} was not compared: {skipped} checks were skipped on this machine");
            return Ok(());
        }
        let kept = std::fs::read_to_string(workspace().join(PAGE)).unwrap_or_default();
        if kept != found {
            bail!(
                "{PAGE} differs from the results of the tests; if the results are correct, copy {} there",
                made.display()
            );
        }
        Ok(())
    }

    fn read(&self) -> anyhow::Result<Vec<Check>> {
        let mut checks = Vec::new();
        for entry in std::fs::read_dir(&self.folder)? {
            let path = entry?.path();
            let text = std::fs::read_to_string(&path)?;
            for line in text.lines() {
                checks
                    .push(serde_json::from_str(line).with_context(|| format!("{}: {line}", path.display()))?);
            }
        }
        Ok(checks)
    }
}

/// The row of a feature: its checks by peer and direction.
type Row<'a> = BTreeMap<(&'a str, &'a str), &'a Check>;

fn page(checks: &[Check]) -> String {
    let mut tables: BTreeMap<(usize, &str), BTreeMap<&str, Row<'_>>> = BTreeMap::new();
    for check in checks.iter().filter(|check| !check.is_skipped) {
        let order = HEADINGS.iter().position(|heading| *heading == check.heading).unwrap_or(HEADINGS.len());
        let row = tables.entry((order, &check.heading)).or_default().entry(&check.feature).or_default();
        let cell = row.entry((&check.with, &check.way)).or_insert(check);
        // If there are several tests of a feature, one that failed takes precedence.
        if !check.passed {
            *cell = check;
        }
    }
    let cells: Vec<&Check> =
        tables.values().flat_map(BTreeMap::values).flat_map(BTreeMap::values).copied().collect();
    let count = |holds: fn(&Check) -> bool| cells.iter().filter(|check| holds(check)).count();
    let mut page = format!(
        "# What works with ROS 2\n\nAfter this page you know which parts of ROS 2 work between a robot of downbeat and other nodes.\n\n\
         Generated by `cargo xtask test` from the results of its tests with real peers on this machine: {} checks \
         passed, {} failed, {} are known to be impossible. *out*: from downbeat to the peer; *in*: from the peer to downbeat; \
         *both*: in both directions. With bags, *out* means that the peer reads what downbeat wrote.\n\n\
         rclpy runs on rmw_fastrtps_cpp: with Fast DDS 2.14 in Jazzy, with Fast DDS 3.2 in Kilted. The other peers \
         belong to no distribution.\n",
        count(|check| check.passed && check.limit.is_none()),
        count(|check| !check.passed),
        count(|check| check.passed && check.limit.is_some()),
    );
    for ((_, heading), rows) in &tables {
        let columns = columns(heading);
        let _ = write!(page, "\n## {heading}\n\n| |");
        columns.iter().for_each(|(_, title)| page.push_str(&format!(" {title} |")));
        let _ = writeln!(page, "\n| --- |{}", " --- |".repeat(columns.len()));
        for (feature, row) in rows {
            let _ = write!(page, "| {feature} |");
            for (peer, _) in columns {
                let cell: Vec<String> = row
                    .iter()
                    .filter(|((with, _), _)| *with == *peer)
                    .map(|(_, check)| check.verdict())
                    .collect();
                let _ = write!(page, " {} |", cell.join("; "));
            }
            page.push('\n');
        }
    }
    page
}

impl Check {
    fn verdict(&self) -> String {
        match (&self.limit, self.passed) {
            (_, false) => format!("{}: **FAILED**", self.way),
            (None, true) => format!("{}: pass", self.way),
            (Some(reason), true) => format!("{}: not possible, {reason}", self.way),
        }
    }
}
