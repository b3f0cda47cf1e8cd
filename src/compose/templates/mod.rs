//! Robot files to begin with.

use serde::Serialize;

use crate::robot::Catalog;

/// A robot file to begin with.
#[derive(Serialize)]
pub(crate) struct Template {
    pub(crate) name: &'static str,
    pub(crate) title: &'static str,
    pub(crate) about: &'static str,
    #[serde(skip)]
    pub(crate) text: &'static str,
    /// The kinds that it needs.
    pub(crate) kinds: &'static [&'static str],
}

pub(crate) static ALL: [Template; 3] = [
    Template {
        name: "empty",
        title: "Empty robot",
        about: "A name and no modules: add them from the list of kinds.",
        text: include_str!("empty.toml"),
        kinds: &[],
    },
    Template {
        name: "darwin_op",
        title: "Darwin OP emulated",
        about: "A humanoid with 20 emulated servos that stands up, nods and waves. Runs on every machine.",
        text: include_str!("darwin_op.toml"),
        kinds: &["darwin_op_emulator", "darwin_op", "stand_nod_wave", "joint_command_mux"],
    },
    Template {
        name: "darwin_op_walks",
        title: "Darwin OP walks",
        about: "The humanoid in a simulated world: it walks by the topic cmd_vel, and gets up when it falls.",
        text: include_str!("darwin_op_walks.toml"),
        kinds: &[
            "darwin_op_simulator",
            "darwin_op",
            "imu_filter",
            "gait",
            "falls",
            "motions",
            "joint_command_mux",
        ],
    },
];

/// The templates whose kinds there are.
pub(crate) fn usable(catalog: &Catalog) -> impl Iterator<Item = &'static Template> {
    ALL.iter().filter(|template| template.kinds.iter().all(|kind| catalog.kind(kind).is_some()))
}
