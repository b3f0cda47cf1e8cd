//! A ROS workspace: colcon builds the checkout and a project of `downbeat new --template ros`, which then
//! run, by hand and from launch files.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};

use super::{Arrival, Figures, Home};
use crate::crates::cargo_home;
use crate::skips::Run;
use crate::steps::workspace;
use crate::{files, python};

/// colcon, what it needs for cargo, its command `list`, and `--packages-select`.
const TOOLS: [&str; 7] = [
    "cargo-ament-build==0.1.11",
    "colcon-cargo==0.2.0",
    "colcon-core==0.21.3",
    "colcon-package-information==0.4.1",
    "colcon-package-selection==0.2.10",
    "colcon-ros==0.5.0",
    "colcon-ros-cargo==0.2.0",
];

/// A file of the checkout that cargo writes.
const LOCK: &str = "start/program/Cargo.lock";

/// Builds, runs and removes a workspace. What is compiled is shared with the checkout.
pub(crate) fn ros_workspace(skips: &Run) -> anyhow::Result<()> {
    let tools = match python::tools("target/venv_colcon", &TOOLS) {
        Ok(tools) => tools,
        Err(error) => return skips.missing("cargo xtask colcon", &format!("colcon is missing ({error:#})")),
    };
    let lock = workspace().join(LOCK);
    let lock_before = fs::read(&lock).context(LOCK)?;
    let ros = RosWorkspace::new(&tools)?;

    let listed = succeeds(&mut ros.colcon(&["list", "--names-only"]))?;
    ensure!(listed == "downbeat\n", "colcon finds other packages than downbeat: {listed}");
    println!("a development build, of compiled packages:");
    Figures::print_header();
    ros.install(&[])?.print("colcon");
    ensure!(fs::read(&lock)? == lock_before, "{LOCK} is stale: run `cargo run -- --version` and commit it");
    let launch = "launch downbeat darwin_op.launch.py namespace:=left";
    Arrival::at("/left/joint_states", 20, &mut ros.ros2(launch)?)?;

    succeeds(&mut ros.ros2("run downbeat downbeat new src/my_robot --template ros")?)?;
    ros.use_interfaces()?;
    let build = ros.build("my_robot", &[])?;
    println!("a project of the template: built in {:.1} s", build.as_secs_f64());
    let launch = "launch my_robot my_robot.launch.py namespace:=left gain:=0.5";
    Arrival::at("/left/head/joint_commands", 1, &mut ros.ros2(launch)?)?;
    let too_much = ros2_line("launch my_robot my_robot.launch.py gain:=7.5")?;
    let refused = fails(&mut ros.sourced(&format!("exec timeout 60 {too_much}")))?;
    ensure!(refused.contains("\"gain\": 7.5 is out of range"), "{refused}");
    // The robot was compiled with the interfaces; the program finds them in the other workspace.
    let show = ["interface", "show", "site_msgs/msg/Level"];
    let mut robot = ros.command(ros.path("install/my_robot/lib/my_robot/my_robot"));
    let mut program = ros.command(ros.path("install/downbeat/lib/downbeat/downbeat"));
    for command in [robot.env_remove("AMENT_PREFIX_PATH"), &mut program] {
        let shown = succeeds(command.args(show))?;
        ensure!(shown.contains("float64 height"), "{command:?}: {shown}");
    }

    let tests = ["test", "--packages-select", "my_robot", "--return-code-on-test-failure"];
    succeeds(&mut ros.colcon(&tests))?;

    // A workspace that is sourced offers its packages to all that colcon builds, and cargo notes them.
    let again = ros.sourced("exec colcon build").output();
    fs::write(&lock, lock_before)?;
    let again = again.context("cannot run sh")?;
    ensure!(again.status.success(), "built again: {}", String::from_utf8_lossy(&again.stderr));
    ros.remove()
}

/// Builds the checkout for release as a user does, with what is compiled already, runs it, and removes it.
pub(crate) fn ros_workspace_for_release() -> anyhow::Result<Figures> {
    let ros = RosWorkspace::new(&python::tools("target/venv_colcon", &TOOLS)?)?;
    let figures = ros.install(&["--cargo-args", "--release"])?;
    ros.remove()?;
    Ok(figures)
}

/// A workspace whose `src` has the checkout, on top of another one that has interfaces only.
struct RosWorkspace {
    home: Home,
    /// The folders of colcon and cargo, and others.
    search: String,
}

impl RosWorkspace {
    fn new(tools: &Path) -> anyhow::Result<Self> {
        let folder = |program: &Path| program.parent().unwrap_or(program).display().to_string();
        let others = std::env::var("PATH").context("PATH")?;
        let search = format!("{}:{}:{others}", folder(tools), folder(Path::new(env!("CARGO"))));
        let created = Self { home: Home::new()?, search };
        fs::create_dir(created.path("src"))?;
        fs::create_dir(created.path("tmp"))?;
        std::os::unix::fs::symlink(workspace(), created.path("src/downbeat"))?;
        // What colcon installs of a package of interfaces, as far as downbeat reads it: rosidl needs a ROS.
        let share = created.path("underlay/share");
        let index = share.join("ament_index/resource_index/packages");
        fs::create_dir_all(&index)?;
        fs::write(index.join("site_msgs"), "")?;
        fs::create_dir_all(share.join("site_msgs/msg"))?;
        fs::write(share.join("site_msgs/msg/Level.msg"), "float64 height  # [m]\n")?;
        Ok(created)
    }

    fn path(&self, path: &str) -> PathBuf {
        self.home.path().join(path)
    }

    /// A command in the folder of the workspace, in an environment that has sourced the other workspace.
    fn command(&self, program: impl AsRef<OsStr>) -> Command {
        let mut command = self.home.command(program);
        command.env("PATH", &self.search).env("AMENT_PREFIX_PATH", self.path("underlay"));
        command.env("TMPDIR", self.path("tmp"));
        command.env("CARGO_BUILD_BUILD_DIR", workspace().join("target")).env("CARGO_NET_OFFLINE", "true");
        command.envs(cargo_home().ok().map(|folder| ("CARGO_HOME", folder)));
        // Other profiles would compile everything again.
        let is_shared = |name: &OsStr| {
            name.to_str()
                .is_some_and(|name| name.starts_with("CARGO_PROFILE_") || name == "CARGO_INCREMENTAL")
        };
        command.envs(std::env::vars_os().filter(|(name, _)| is_shared(name)));
        command
    }

    fn colcon(&self, arguments: &[&str]) -> Command {
        let mut command = self.command("colcon");
        command.args(arguments);
        command
    }

    /// Builds downbeat and runs it.
    fn install(&self, options: &[&str]) -> anyhow::Result<Figures> {
        let install = self.build("downbeat", options)?;
        let mut robot = self.ros2("run downbeat downbeat run darwin_op")?;
        let arrival = Arrival::at("/joint_states", 20, &mut robot)?;
        let size = files::size(&files::below(&self.path("install/downbeat"))?);
        Ok(Figures { install, size, arrival })
    }

    /// Builds a package and returns how long that took.
    fn build(&self, package: &str, options: &[&str]) -> anyhow::Result<Duration> {
        let started = Instant::now();
        succeeds(self.colcon(&["build", "--packages-select", package]).args(options))?;
        Ok(started.elapsed())
    }

    /// A line of a shell that has sourced this workspace.
    fn sourced(&self, line: &str) -> Command {
        let mut command = self.command("sh");
        command.args(["-c", &format!(". install/setup.sh && {line}")]);
        command
    }

    /// `ros2` with arguments, by `ros2.py`.
    fn ros2(&self, arguments: &str) -> anyhow::Result<Command> {
        Ok(self.sourced(&format!("exec {}", ros2_line(arguments)?)))
    }

    /// Lets the project use the interfaces of the other workspace, as `docs/messages.md` says.
    fn use_interfaces(&self) -> anyhow::Result<()> {
        let checkout = workspace();
        let project = self.path("src/my_robot");
        let change = |file: &str, old: &str, new: &str| {
            let path = project.join(file);
            let text = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
            ensure!(text.contains(old), "{} has no {old:?}", path.display());
            anyhow::Ok(fs::write(&path, text.replacen(old, new, 1))?)
        };
        let dependency = |package: &str| format!("{{ path = \"{}/{package}\" }}", checkout.display());
        let (messages, generator) = (dependency("msgs"), dependency("msgs/generator"));
        let dependencies = format!(
            "[build-dependencies]\ndownbeat-msgs-generator = {generator}\n\n[dependencies]\ndownbeat-msgs = {messages}\n"
        );
        change("Cargo.toml", "[dependencies]\n", &dependencies)?;
        fs::write(
            project.join("build.rs"),
            "fn main() {\n    downbeat_msgs_generator::Build::new().installed(\"site_msgs\").compile();\n}\n",
        )?;
        change("package.xml", "  <exec_depend>", "  <depend>site_msgs</depend>\n  <exec_depend>")?;
        change("src/main.rs", "fn app()", "downbeat_msgs::include_interfaces!();\n\nfn app()")?;
        change("src/main.rs", "App::new()\n", "App::new()\n        .interfaces(INTERFACES)\n")?;
        // Without the other workspace, the build says what to do.
        let mut lonely = self.colcon(&["build", "--packages-select", "my_robot"]);
        let refused = fails(lonely.env("AMENT_PREFIX_PATH", self.path("install/downbeat")))?;
        ensure!(refused.contains("no package `site_msgs`") && refused.contains("<depend>"), "{refused}");
        Ok(())
    }

    /// Removes what colcon wrote, and the project. Nothing else is left but what robots keep.
    fn remove(&self) -> anyhow::Result<()> {
        let written = ["build", "install", "log", ".cargo", "src", "underlay", "tmp"];
        succeeds(self.command("rm").arg("-r").args(written))?;
        let left = files::below(self.home.path())?.into_iter().map(|file| file.path);
        let left: Vec<_> = left.filter(|path| !path.starts_with(".cache/downbeat")).collect();
        ensure!(left.is_empty(), "after the workspace was removed, these are left: {left:?}");
        Ok(())
    }
}

fn ros2_line(arguments: &str) -> anyhow::Result<String> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/install/ros2.py");
    Ok(format!("{} {} {arguments}", python::interpreter()?.display(), script.display()))
}

/// Runs a command, which must succeed, and returns what it prints.
fn succeeds(command: &mut Command) -> anyhow::Result<String> {
    let (is_success, text) = text_of(command)?;
    ensure!(is_success, "{command:?} failed: {text}");
    Ok(text)
}

/// Runs a command, which must fail, and returns what it prints.
fn fails(command: &mut Command) -> anyhow::Result<String> {
    let (is_success, text) = text_of(command)?;
    ensure!(!is_success, "{command:?} did not fail: {text}");
    Ok(text)
}

fn text_of(command: &mut Command) -> anyhow::Result<(bool, String)> {
    let output = command.output().with_context(|| format!("cannot run {command:?}"))?;
    let text = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes));
    Ok((output.status.success(), text.concat()))
}
