//! The templates of projects.

use clap::ValueEnum;

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Template {
    /// A robot: a module with a message and a test, a robot file that runs without hardware, a recorded run.
    Robot,
    /// Messages, services and actions from .msg, .srv and .action files.
    Messages,
    /// A library with a module, for several robots.
    Module,
}

/// A path within the project, and its content.
type File = (&'static str, &'static [u8]);

macro_rules! file {
    ($path:literal, $template:literal) => {
        ($path, include_bytes!(concat!("templates/", $template)))
    };
}

const ROBOT: &[File] = &[
    file!("Cargo.toml", "robot/Cargo.toml.template"),
    file!("README.md", "robot/README.md"),
    file!(".gitignore", "shared/gitignore"),
    file!("robot.toml", "robot/robot.toml"),
    file!("src/main.rs", "robot/src/main.rs"),
    file!("src/level_head.rs", "robot/src/level_head.rs"),
    file!("src/simulated_imu.rs", "robot/src/simulated_imu.rs"),
    file!("tests/field_run/metadata.yaml", "robot/tests/field_run/metadata.yaml"),
    file!("tests/field_run/field_run_0.mcap", "robot/tests/field_run/field_run_0.mcap"),
];

const MESSAGES: &[File] = &[
    file!("Cargo.toml", "messages/Cargo.toml.template"),
    file!("README.md", "messages/README.md"),
    file!(".gitignore", "shared/gitignore"),
    file!("build.rs", "messages/build.rs"),
    file!("src/lib.rs", "messages/src/lib.rs"),
    file!("my_robot/msg/HeadTilt.msg", "messages/my_robot/msg/HeadTilt.msg"),
    file!("my_robot/srv/LevelHead.srv", "messages/my_robot/srv/LevelHead.srv"),
    file!("my_robot/action/Look.action", "messages/my_robot/action/Look.action"),
];

const MODULE: &[File] = &[
    file!("Cargo.toml", "module/Cargo.toml.template"),
    file!("README.md", "module/README.md"),
    file!(".gitignore", "shared/gitignore"),
    file!("src/lib.rs", "module/src/lib.rs"),
    file!("src/level_head.rs", "robot/src/level_head.rs"),
];

impl Template {
    /// Its files.
    pub(super) fn files(self) -> &'static [File] {
        match self {
            Self::Robot => ROBOT,
            Self::Messages => MESSAGES,
            Self::Module => MODULE,
        }
    }

    /// The first commands to run in the project.
    pub(super) fn commands(self) -> &'static [&'static str] {
        match self {
            Self::Robot => &["cargo run -- run robot.toml", "cargo test"],
            Self::Messages | Self::Module => &["cargo test"],
        }
    }
}
