//! The first hour of a new user: the commands of the README and of projects, taken from their text, in an
//! empty home directory. The packages that each step compiles are counted; the durations are kept in
//! `target/first_hour/steps`.
//!
//! Commands run without `--release`, whose first build takes minutes more of processor time; checkout and
//! projects share the same packages. Other commands of the pages are run by `tests/docs.rs` and
//! `tests/library.rs`, those for Python by `python/tests/`, all with such a home.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use common::new_user::NewUser;
use test_machine::{has_compilers, has_program};

/// The root of the repository.
const CHECKOUT: &str = env!("CARGO_MANIFEST_DIR");

/// How many packages the first command may compile that the tests have not compiled: those of downbeat, and
/// those of others that have other features there: the tests compile every feature of the program, and Zenoh
/// and SQLite ask more of the crates below them. Every later command compiles the project alone.
const FIRST_BUILD: usize = 98;

/// A new user with a checkout.
struct User {
    user: NewUser,
    home: PathBuf,
    /// The working directory.
    folder: PathBuf,
    /// The page whose commands are typed.
    page: String,
    /// Where cargo puts what others need while it compiles.
    build: PathBuf,
    /// The target folder of the programs. It differs from that of the tests, whose programs have other
    /// features.
    target: PathBuf,
}

impl User {
    fn new(name: &'static str) -> Self {
        let folder = Path::new(CHECKOUT).join("target/first_hour");
        let home = folder.join(name);
        let build = Path::new(env!("CARGO_BIN_EXE_downbeat")).parent().unwrap().parent().unwrap().to_owned();
        let (user, page) = (NewUser::new(name, &home), "README.md".to_owned());
        Self { user, home, folder: CHECKOUT.into(), page, build, target: folder.join("programs") }
    }

    /// Runs a line of a page in a shell, which must succeed. Returns its output, and the packages that were
    /// compiled.
    fn types(&mut self, line: &str) -> (String, Vec<String>) {
        let began = Instant::now();
        let typed = line
            .replace("--release ", "")
            .replace(" --release", "")
            .replace("../my_robot", &self.path("my_robot"));
        let mut shell = Command::new("sh");
        shell.args(["-c", &typed]).current_dir(&self.folder).stdin(Stdio::null());
        self.user.settle(&mut shell);
        shell.env("CARGO_TARGET_DIR", &self.target).env("CARGO_BUILD_BUILD_DIR", &self.build);
        let [own, of_tests] = [&self.target, &self.build].map(|folder| folder.join("debug"));
        let path = format!("{}:{}:{}", own.display(), of_tests.display(), std::env::var("PATH").unwrap());
        shell.env("PATH", path);
        let output = shell.output().unwrap();
        let text =
            [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).concat();
        assert!(output.status.success(), "{line}: {text}");
        let lines = text.lines().filter_map(|line| line.trim().strip_prefix("Compiling "));
        let compiled: Vec<_> = lines.filter_map(|line| line.split(' ').next()).map(str::to_owned).collect();
        self.user.has_done(&self.page, line, began.elapsed().as_secs_f64(), compiled.clone());
        (text, compiled)
    }

    fn path(&self, name: &str) -> String {
        self.home.join(name).to_str().unwrap().to_owned()
    }

    fn cd(&mut self, name: &str) {
        self.folder = self.home.join(name);
    }

    /// Creates a project and makes it the working directory.
    fn begins(&mut self, name: &str, template: &str) {
        self.folder = self.home.clone();
        self.page = format!("the template {template}");
        let (next, _) = self.types(&format!("downbeat new {name} --template {template}"));
        assert!(next.contains("is ready"), "{next}");
        self.cd(name);
    }
}

/// The lines of the first `sh` block of the README below a heading.
fn readme(heading: &str) -> Vec<String> {
    let text = std::fs::read_to_string(Path::new(CHECKOUT).join("README.md")).unwrap();
    let (_, section) = text.split_once(&format!("## {heading}\n")).unwrap();
    let (_, block) = section.split_once("```sh\n").unwrap();
    block.split("```").next().unwrap().lines().map(str::to_owned).collect()
}

/// The elements of a manifest of ROS, with their texts.
fn package_xml(path: &Path) -> Vec<[String; 2]> {
    let text = std::fs::read_to_string(path).unwrap().replace("<?xml-model", "<?other");
    let package = roxmltree::Document::parse(&text).unwrap();
    let elements = package.descendants().filter(roxmltree::Node::is_element);
    elements.filter_map(|node| Some([node.tag_name().name(), node.text()?].map(str::to_owned))).collect()
}

#[test]
fn projects_compile_only_their_own_crates_and_work_as_the_readme_says() {
    let mut user = User::new("rust");

    let first = readme("Run it").remove(0);
    let (text, compiled) = user.types(&format!("{first} --duration 2s"));
    assert!(text.contains("joint_states"), "{text}");
    assert!(compiled.len() <= FIRST_BUILD, "{} packages: {compiled:?}", compiled.len());

    let lines = readme("Your own robot");
    let [new, cd, run, test] = &*lines else { panic!("{lines:?}") };
    assert!(new.contains("-- new ../my_robot") && cd == "cd ../my_robot", "{lines:?}");
    let (text, compiled) = user.types(new);
    assert!(compiled.is_empty(), "`new` copies, but compiled {compiled:?}: {text}");
    user.cd("my_robot");
    let (text, compiled) = user.types(&format!("{run} --duration 1s"));
    assert_eq!(compiled, ["my_robot"], "{text}");
    assert!(text.contains("/head_tilt"), "{text}");
    let (text, compiled) = user.types(test);
    assert_eq!(compiled, ["my_robot"], "{text}");
    assert!(text.contains("2 passed"), "{text}");
    // From the project's README.
    let (text, _) = user.types("cargo run -- check robot.toml -p level_head.gain:=1");
    assert!(text.contains("level_head_msgs/msg/HeadTilt") && text.contains("gain = 1"), "{text}");
    let (text, _) = user
        .types("cargo run -- run robot.toml --duration 2s --record my_run && cargo run -- bag info my_run");
    assert!(text.contains("level_head_msgs/msg/HeadTilt"), "{text}");
    user.types("cargo run -- bag replay robot.toml my_run --strict");
    let (text, _) =
        user.types("! cargo run -- bag replay robot.toml my_run --strict -p level_head.gain:=0.5");
    assert!(text.contains("head_tilt"), "{text}");

    for (template, tests, topics) in
        [("rover", "3 passed", ["/odom", "/joint_states"]), ("arm", "2 passed", ["/tf", "/joint_states"])]
    {
        let name = format!("my_{template}");
        user.begins(&name, template);
        let (text, compiled) = user.types("cargo test --release");
        assert_eq!(compiled, [&*name], "{text}");
        assert!(text.contains(tests), "{text}");
        let (text, compiled) = user.types("cargo run --release -- run robot.toml --fast --duration 4s");
        assert_eq!(compiled, [name], "{text}");
        assert!(topics.iter().all(|topic| text.contains(topic)) && !text.contains("WARN"), "{text}");
    }

    user.begins("my_msgs", "messages");
    let (text, compiled) = user.types("cargo test --release");
    assert!(compiled == ["my_msgs"] && text.contains("2 passed"), "{compiled:?}: {text}");
    let (text, _) = user.types("downbeat interface show my_msgs/msg/HeadTilt --from my_msgs");
    assert!(text.contains("is_at_limit"), "{text}");
    let package = package_xml(&user.folder.join("my_msgs/package.xml"));
    assert!(package.contains(&["name", "my_msgs"].map(str::to_owned)), "{package:?}");
    let group = ["member_of_group", "rosidl_interface_packages"].map(str::to_owned);
    assert!(package.contains(&group), "{package:?}");

    // `cargo xtask colcon` builds it as a package of ROS.
    user.begins("my_ros", "ros");
    let (text, compiled) = user.types("cargo test --release");
    assert!(compiled == ["my_ros"] && text.contains("2 passed"), "{compiled:?}: {text}");
    let package = package_xml(&user.folder.join("package.xml"));
    for line in [["name", "my_ros"], ["build_type", "ament_cargo"]] {
        assert!(package.contains(&line.map(str::to_owned)), "{package:?}");
    }

    user.begins("my_module", "module");
    let (text, compiled) = user.types("cargo test --release");
    assert_eq!(compiled, ["my_module"], "{text}");
    assert_eq!(text.matches("1 passed").count(), 2, "its test and its doc test: {text}");
}

#[test]
fn modules_in_cpp_are_built_run_and_replayed() {
    if !has_compilers(&["c++"]) {
        return;
    }
    let mut user = User::new("cpp");
    user.begins("my_cpp", "cpp");
    if has_program("cmake") {
        user.types("cmake -B build && cmake --build build && ctest --test-dir build --output-on-failure");
    } else {
        test_machine::skipped("cmake is missing: the commands of CMakeLists.txt are typed instead");
        user.types("downbeat interface generate --lang cpp --out build/include sensor_msgs/msg/Imu sensor_msgs/msg/JointState");
        for module in ["level_head", "simulated_imu"] {
            let flags = "-std=c++17 -O2 -shared -fPIC -Wall -Wextra -Werror -isystem build/include";
            user.types(&format!("c++ {flags} {module}.cpp -o build/lib{module}.so"));
        }
        user.types("downbeat bag replay robot.toml tests/field_run --strict");
    }
    let (text, _) = user.types("downbeat run robot.toml --fast --duration 4s");
    assert!(text.contains("joint_commands") && !text.contains("WARN"), "{text}");
}
