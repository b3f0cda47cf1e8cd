//! `downbeat new`
//!
//! The templates are whole projects named `my_robot` that depend on `/checkout`; both are replaced.

mod name;

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use toml::Value;

use name::Name;

#[derive(Args)]
pub(crate) struct NewArguments {
    /// The folder to create. Its last part is the name of the project: lower-case letters, digits and
    /// underscores, like names of ROS 2 packages.
    #[arg(value_name = "NAME")]
    pub(crate) folder: PathBuf,
    /// The kind of project.
    #[arg(long, value_enum, default_value_t = Template::Robot)]
    pub(crate) template: Template,
    /// Depend on downbeat in this git repository, instead of the version of this program, or of the checkout
    /// that it was built in.
    #[arg(long, value_name = "URL", requires = "rev")]
    pub(crate) git: Option<String>,
    /// The revision in that repository.
    #[arg(long, value_name = "REV", requires = "git")]
    pub(crate) rev: Option<String>,
    /// Write into a folder that is not empty: files of the template replace existing ones, others are kept.
    #[arg(long)]
    pub(crate) force: bool,
}

pub(crate) fn new(arguments: &NewArguments) -> anyhow::Result<()> {
    let folder = &arguments.folder;
    let name = Name::of_folder(folder)?;
    let origin = match (&arguments.git, &arguments.rev) {
        _ if !arguments.template.is_for_cargo() => None,
        (Some(url), Some(revision)) => Some(Origin::git(url, revision)),
        _ => Some(Origin::of_this_program()),
    };
    if !arguments.force {
        check_empty(folder)?;
    }
    for (path, content) in arguments.template.files() {
        let path = folder.join(name.put_into(path));
        match std::str::from_utf8(content) {
            Ok(text) => {
                let text = name.put_into(text);
                let text = origin.as_ref().map_or(text.clone(), |origin| origin.put_into(&text));
                write(&path, text.as_bytes())?;
            }
            Err(_) => write(&path, content)?, // a bag file
        }
    }
    for (path, content) in origin.iter().map(Origin::files).collect::<anyhow::Result<Vec<_>>>()?.concat() {
        write(&folder.join(path), content.as_bytes())?;
    }
    println!("{} is ready. Next:\n", folder.display());
    if let Some(Origin::Release) = origin {
        eprintln!(
            "it depends on version {} of downbeat; --git URL --rev REV takes another source",
            env!("CARGO_PKG_VERSION")
        );
    }
    println!("    cd {}", folder.display());
    arguments.template.commands().iter().for_each(|command| println!("    {command}"));
    Ok(())
}

fn check_empty(folder: &Path) -> anyhow::Result<()> {
    let shown = folder.display();
    match fs::read_dir(folder).map(|mut entries| entries.next()) {
        Ok(Some(_)) => {
            bail!(
                "{shown} exists already and is not empty; choose another name, or write into it with --force"
            )
        }
        Ok(None) => Ok(()),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        Err(error) => Err(error).with_context(|| format!("cannot create the folder {shown}")),
    }
}

fn write(path: &Path, content: &[u8]) -> anyhow::Result<()> {
    let folder = path.parent().unwrap_or(path);
    fs::create_dir_all(folder).with_context(|| format!("cannot create the folder {}", folder.display()))?;
    fs::write(path, content).with_context(|| format!("cannot write {}", path.display()))
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Template {
    /// A robot: a module with a message and a test, a robot file that runs without hardware, a recorded run.
    Robot,
    /// A rover: differential drive with emulated servos, odometry, a module that patrols.
    Rover,
    /// An arm of emulated servos, with a trajectory controller and a module for poses.
    Arm,
    /// A camera and a module that looks at its pictures, in Python with NumPy.
    Camera,
    /// A robot with modules in Python.
    Python,
    /// A robot with modules in C++.
    Cpp,
    /// Messages, services and actions from .msg, .srv and .action files, for ROS 2 (colcon) too.
    Messages,
    /// A library with a module, for several robots.
    Module,
    /// A robot as a package of a ROS workspace, for colcon and `ros2 launch`.
    Ros,
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

/// The robot file of a project, which begins as that of the robot that `downbeat compose` offers.
macro_rules! robot_file {
    ($template:literal, $more:literal) => {
        (
            "robot.toml",
            concat!(
                include_str!(concat!("templates/", $template, "/robot.toml")),
                include_str!(concat!("templates/", $template, "/", $more))
            )
            .as_bytes(),
        )
    };
}

const ROVER: &[File] = &[
    file!("Cargo.toml", "rover/Cargo.toml.template"),
    file!("README.md", "rover/README.md"),
    file!(".gitignore", "shared/gitignore"),
    robot_file!("rover", "patrol.toml"),
    file!("rover_servos.toml", "rover/rover_servos.toml"),
    file!("rover.urdf", "rover/rover.urdf"),
    file!("src/main.rs", "rover/src/main.rs"),
    file!("src/patrol.rs", "rover/src/patrol.rs"),
    file!("tests/field_run/metadata.yaml", "rover/tests/field_run/metadata.yaml"),
    file!("tests/field_run/field_run_0.mcap", "rover/tests/field_run/field_run_0.mcap"),
];

const ARM: &[File] = &[
    file!("Cargo.toml", "arm/Cargo.toml.template"),
    file!("README.md", "arm/README.md"),
    file!(".gitignore", "shared/gitignore"),
    robot_file!("arm", "poses.toml"),
    file!("arm_servos.toml", "arm/arm_servos.toml"),
    file!("arm.urdf", "arm/arm.urdf"),
    file!("src/main.rs", "arm/src/main.rs"),
    file!("src/poses.rs", "arm/src/poses.rs"),
    file!("tests/field_run/metadata.yaml", "arm/tests/field_run/metadata.yaml"),
    file!("tests/field_run/field_run_0.mcap", "arm/tests/field_run/field_run_0.mcap"),
];

const CAMERA: &[File] = &[
    file!("README.md", "camera/README.md"),
    file!("robot.toml", "camera/robot.toml"),
    file!("camera.py", "camera/camera.py"),
    file!("spot.py", "camera/spot.py"),
    file!("test_spot.py", "camera/test_spot.py"),
    file!("tests/field_run/metadata.yaml", "camera/tests/field_run/metadata.yaml"),
    file!("tests/field_run/field_run_0.mcap", "camera/tests/field_run/field_run_0.mcap"),
];

const PYTHON: &[File] = &[
    file!("README.md", "python/README.md"),
    file!("robot.toml", "python/robot.toml"),
    file!("level_head.py", "python/level_head.py"),
    file!("simulated_imu.py", "python/simulated_imu.py"),
    file!("test_level_head.py", "python/test_level_head.py"),
    file!("tests/field_run/metadata.yaml", "python/tests/field_run/metadata.yaml"),
    file!("tests/field_run/field_run_0.mcap", "python/tests/field_run/field_run_0.mcap"),
];

const CPP: &[File] = &[
    file!("README.md", "cpp/README.md"),
    file!(".gitignore", "cpp/gitignore"),
    file!("CMakeLists.txt", "cpp/CMakeLists.txt"),
    file!("robot.toml", "cpp/robot.toml"),
    file!("level_head.cpp", "cpp/level_head.cpp"),
    file!("simulated_imu.cpp", "cpp/simulated_imu.cpp"),
    file!("tests/field_run/metadata.yaml", "cpp/tests/field_run/metadata.yaml"),
    file!("tests/field_run/field_run_0.mcap", "cpp/tests/field_run/field_run_0.mcap"),
];

const MESSAGES: &[File] = &[
    file!("Cargo.toml", "messages/Cargo.toml.template"),
    file!("README.md", "messages/README.md"),
    file!(".gitignore", "shared/gitignore"),
    file!("build.rs", "messages/build.rs"),
    file!("src/lib.rs", "messages/src/lib.rs"),
    file!("my_robot/package.xml", "messages/my_robot/package.xml"),
    file!("my_robot/CMakeLists.txt", "messages/my_robot/CMakeLists.txt"),
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

const ROS: &[File] = &[
    file!("Cargo.toml", "ros/Cargo.toml.template"),
    file!("package.xml", "ros/package.xml"),
    file!("README.md", "ros/README.md"),
    file!(".gitignore", "shared/gitignore"),
    file!("rustfmt.toml", "shared/rustfmt.toml"), // `colcon test` checks the format
    file!("launch/my_robot.launch.py", "ros/launch/my_robot.launch.py"),
    file!("robot.toml", "robot/robot.toml"),
    file!("src/main.rs", "robot/src/main.rs"),
    file!("src/level_head.rs", "robot/src/level_head.rs"),
    file!("src/simulated_imu.rs", "robot/src/simulated_imu.rs"),
    file!("tests/field_run/metadata.yaml", "robot/tests/field_run/metadata.yaml"),
    file!("tests/field_run/field_run_0.mcap", "robot/tests/field_run/field_run_0.mcap"),
];

impl Template {
    /// Its files.
    fn files(self) -> &'static [File] {
        match self {
            Self::Robot => ROBOT,
            Self::Rover => ROVER,
            Self::Arm => ARM,
            Self::Camera => CAMERA,
            Self::Python => PYTHON,
            Self::Cpp => CPP,
            Self::Messages => MESSAGES,
            Self::Module => MODULE,
            Self::Ros => ROS,
        }
    }

    /// Whether cargo builds it, from the source of downbeat.
    fn is_for_cargo(self) -> bool {
        self.files().iter().any(|(path, _)| *path == "Cargo.toml")
    }

    /// The first commands to run in the project.
    fn commands(self) -> &'static [&'static str] {
        match self {
            Self::Robot | Self::Rover | Self::Arm | Self::Ros => {
                &["cargo run --release -- run robot.toml", "cargo test --release"]
            }
            Self::Camera | Self::Python => &["downbeat run robot.toml", "python -m pytest"],
            Self::Cpp => &[
                "cmake -B build && cmake --build build",
                "downbeat run robot.toml",
                "ctest --test-dir build",
            ],
            Self::Messages | Self::Module => &["cargo test --release"],
        }
    }
}

/// Where a project has downbeat from.
#[derive(Debug)]
enum Origin {
    /// The folder that this program was built from.
    Checkout(PathBuf),
    /// The version of this program, from the registry.
    Release,
    Git {
        url: String,
        revision: String,
    },
}

/// The folder of the templates' dependencies.
const TEMPLATE: &str = "/checkout";

const CONFIG: &str = include_str!("templates/shared/cargo_config.toml");

impl Origin {
    fn git(url: &str, revision: &str) -> Self {
        Self::Git { url: url.to_owned(), revision: revision.to_owned() }
    }

    /// The checkout that this program was built in, or this version of the crates if it was installed.
    fn of_this_program() -> Self {
        // A program that is given away names no folder of the machine that built it.
        let built_in = match option_env!("DOWNBEAT_RELEASE") {
            Some(_) => None,
            None => Path::new(env!("CARGO_MANIFEST_DIR")).parent(),
        };
        built_in.map_or(Self::Release, Self::of_folder)
    }

    fn of_folder(folder: &Path) -> Self {
        // Not the folder of packages that cargo downloaded, and not one that this machine does not have.
        let is_checkout = folder.join("start/program/Cargo.toml").is_file() && folder.to_str().is_some();
        if is_checkout { Self::Checkout(folder.to_owned()) } else { Self::Release }
    }

    /// Replaces the template's `path = "/checkout…"`.
    fn put_into(&self, text: &str) -> String {
        let begin = format!("path = \"{TEMPLATE}");
        let line = |line: &str| match line.split_once(&begin) {
            Some((before, rest)) => {
                let (package, after) = rest.split_once('"').unwrap_or((rest, ""));
                format!("{before}{}{after}", self.dependency(package))
            }
            None => line.to_owned(),
        };
        text.split('\n').map(line).collect::<Vec<_>>().join("\n")
    }

    /// `package` is a path within the repository.
    fn dependency(&self, package: &str) -> String {
        match self {
            Self::Checkout(folder) => format!("path = {}", quoted(format!("{}{package}", folder.display()))),
            Self::Release => format!("version = {}", quoted(env!("CARGO_PKG_VERSION").to_owned())),
            Self::Git { url, revision } => {
                format!("git = {}, rev = {}", quoted(url.clone()), quoted(revision.clone()))
            }
        }
    }

    /// Files that let a project reuse the crates compiled by a checkout: its lock file, and cargo's
    /// configuration.
    fn files(&self) -> anyhow::Result<Vec<(&'static str, String)>> {
        let Self::Checkout(folder) = self else {
            return Ok(Vec::new());
        };
        let lock = folder.join("Cargo.lock");
        let lock =
            std::fs::read_to_string(&lock).with_context(|| format!("cannot read {}", lock.display()))?;
        let target = quoted(format!("{}/target", folder.display()));
        let config = CONFIG.replace(&format!("\"{TEMPLATE}/target\""), &target);
        Ok(vec![("Cargo.lock", lock), (".cargo/config.toml", config)])
    }
}

/// Quotes a TOML string.
fn quoted(text: String) -> String {
    Value::String(text).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINE: &str = "a = { path = \"/checkout/msgs\" } # b";

    #[test]
    fn a_dependency_is_a_path_or_a_revision() {
        let path = Origin::Checkout("/opt/down \"beat\"".into()).put_into(LINE);
        let table: toml::Table = path.parse().expect(&path);
        assert_eq!(table["a"]["path"].as_str(), Some("/opt/down \"beat\"/msgs"));
        let git = Origin::git("https://example.org/downbeat.git", "1f2e").put_into(LINE);
        assert_eq!(git, "a = { git = \"https://example.org/downbeat.git\", rev = \"1f2e\" } # b");
    }

    #[test]
    fn an_installed_program_depends_on_its_version() {
        let release = Origin::of_folder("/no/such/checkout".as_ref());
        assert_eq!(
            release.put_into(LINE),
            concat!("a = { version = \"", env!("CARGO_PKG_VERSION"), "\" } # b")
        );
        assert!(release.files().is_ok_and(|files| files.is_empty()), "nothing of a checkout");
    }
}
