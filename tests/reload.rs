//! Write, save, see: modules whose files change while the robot runs, also after they have stopped; recorded and replayed.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;

use common::{Running, downbeat, recorded_messages, wait_until};
use downbeat::bags::{Reader, Selection};
use downbeat::msgs::cdr;
use downbeat::msgs::downbeat_interfaces::msg::ModuleEvent;

/// Publishes sums whose rounding tells versions apart, and raises an exception where it is built to.
const SUMS: &str = r#"
#include "downbeat.hpp"
#include "std_msgs/msg/float64.hpp"
#include <stdexcept>
using std_msgs::msg::Float64;
class Sums : public downbeat::Module {
    void setup() override {
        auto out = publish<Float64>("sum");
        info("is set up");
        every(std::chrono::milliseconds(10), [this, out] {
            sum_ += STEP * static_cast<double>(now().count() % 1000003);
            out({sum_});
            if (++count_ == RAISES_AT) {
                throw std::runtime_error("as this test wants it");
            }
        });
    }
    std::vector<std::uint8_t> save() override { return {static_cast<std::uint8_t>(count_ % 100)}; }
    void restore(const std::vector<std::uint8_t> &state) override { sum_ = state.at(0); }
    double sum_ = 0;
    int count_ = 0;
};
DOWNBEAT_MODULE(Sums)
"#;

fn has_compiler() -> bool {
    let found = Command::new("c++").arg("--version").output().is_ok();
    if !found {
        eprintln!("skipped: this machine has no c++");
    }
    found
}

/// A folder with a robot.
struct Site {
    folder: tempfile::TempDir,
}

impl Site {
    fn new(robot: &str) -> Self {
        let site = Self { folder: tempfile::tempdir().unwrap() };
        site.write("robot.toml", &format!("[robot]\nname = \"demo\"\n{robot}\n[record]\ntopics = \"all\"\n"));
        site
    }

    fn path(&self) -> &Path {
        self.folder.path()
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path().join(name), text).unwrap();
    }

    /// Builds the library `libsums.so`, as a linker that writes it beside its place and renames it. Each version is compiled once.
    fn build(&self, step: &str, raises_at: i32) {
        static BUILT: Mutex<BTreeMap<(String, i32), Vec<u8>>> = Mutex::new(BTreeMap::new());
        let mut built = BUILT.lock().unwrap();
        let version = (step.to_owned(), raises_at);
        let library = built.entry(version).or_insert_with(|| self.compile(step, raises_at));
        std::fs::write(self.path().join("new.so"), library).unwrap();
        std::fs::rename(self.path().join("new.so"), self.path().join("libsums.so")).unwrap();
    }

    fn compile(&self, step: &str, raises_at: i32) -> Vec<u8> {
        if !self.path().join("include").exists() {
            self.write("sums.cpp", SUMS);
            let mut generate = downbeat(&["interface", "generate", "--lang", "cpp", "std_msgs/msg/Float64"]);
            assert!(generate.current_dir(self.path()).output().unwrap().status.success());
        }
        let (step, raises_at) = (format!("-DSTEP={step}"), format!("-DRAISES_AT={raises_at}"));
        let flags = ["-std=c++17", &step, &raises_at, "-shared", "-fPIC", "-fno-gnu-unique", "-Iinclude"];
        let mut compiler = Command::new("c++");
        compiler.args(flags).args(["sums.cpp", "-o", "new.so"]).current_dir(self.path());
        let built = compiler.output().unwrap();
        assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
        std::fs::read(self.path().join("new.so")).unwrap()
    }

    fn run(&self, options: &[&str], domain: &str) -> Running {
        let mut command = downbeat(&[&["run", "robot.toml"], options].concat());
        command.current_dir(self.path()).env("ROS_DOMAIN_ID", domain).env("XDG_RUNTIME_DIR", self.path());
        Running::start_by(&mut command)
    }

    fn replay(&self, bag: &str, options: &[&str]) -> (bool, String) {
        let mut command = downbeat(&[&["bag", "replay", "robot.toml", bag], options].concat());
        let output = command.current_dir(self.path()).output().unwrap();
        let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
        (output.status.success(), text)
    }

    fn assert_replays(&self, bag: &str, options: &[&str]) -> String {
        let (is_same, text) = self.replay(bag, options);
        assert!(is_same, "{options:?}\n{text}");
        text
    }

    /// Waits until the bag has more messages of a topic.
    fn wait_for_more(&self, topic: &str) {
        let bag = self.path().join("bag");
        let before = recorded_messages(&bag, topic);
        wait_until("more is recorded", || recorded_messages(&bag, topic) > before + 30);
    }

    fn events(&self, kind: u8) -> Vec<ModuleEvent> {
        let reader = Reader::open(self.path().join("bag")).unwrap();
        let id = reader.topic("/module_events").unwrap();
        let events = reader.messages(Selection::all().topics([id])).unwrap();
        let events = events.map(|event| cdr::from_slice::<ModuleEvent>(&event.unwrap().data).unwrap());
        events.filter(|event| event.kind == kind).collect()
    }
}

const LIBRARY: &str =
    "[[module]]\nname = \"sums\"\nkind = \"library\"\npath = \"libsums.so\"\nreload = true\n";

#[test]
fn a_library_that_raised_starts_again_when_it_is_saved_and_all_versions_replay() {
    if !has_compiler() {
        return;
    }
    for keys in ["", "isolate = true\n", "synchrony = \"detached\"\n"] {
        let site = Site::new(&format!("{LIBRARY}{keys}"));
        site.build("0.1", 20);
        let first = std::fs::read(site.path().join("libsums.so")).unwrap();
        let mut robot = site.run(&["--record", "bag"], "32");
        robot.wait_for_output("panicked and is stopped, the others go on: as this test wants it");
        site.build("0.2", -1);
        robot.wait_for_output("libsums.so was saved: it starts again with it");
        site.wait_for_more("/sum");
        site.build("0.3", -1);
        robot.wait_for_output("libsums.so was saved and is reloaded");
        site.wait_for_more("/sum");
        robot.interrupt();

        assert_eq!(site.events(ModuleEvent::MADE).len(), 2, "{keys}");
        let restarts = site.events(ModuleEvent::COMMAND);
        let restarts = restarts.iter().filter(|event| event.command == "restart" && event.module == "sums");
        assert_eq!(restarts.count(), 1, "{keys}");
        for launcher in ["linear", "pool:2", "threads"] {
            let text = site.assert_replays("bag", &["--launcher", launcher]);
            assert!(text.contains("libsums.so of sums was saved and taken 2 times"), "{text}");
            assert!(!text.contains("has changed since"), "{text}");
        }
        // The last version is the file as it is now, unless the recorded one is asked for.
        site.build("0.4", -1);
        let (is_same, text) = site.replay("bag", &[]);
        assert!(!is_same && text.contains("the source of sums has changed since the recording"), "{text}");
        site.assert_replays("bag", &["--recorded-sources"]);

        // Without the copies, a version that is found beside the bag does, under another name.
        site.build("0.3", -1);
        std::fs::remove_dir_all(site.path().join("bag/module_sources")).unwrap();
        let (is_same, text) = site.replay("bag", &[]);
        let missing = text.matches("a version of sums is missing: ").count();
        assert!(!is_same && missing == 2 && text.contains("with the SHA-256 "), "{keys}{text}");
        std::fs::write(site.path().join("libsums.so.first"), first).unwrap();
        site.build("0.2", -1);
        std::fs::rename(site.path().join("libsums.so"), site.path().join("libsums.so.second")).unwrap();
        site.build("0.3", -1);
        site.assert_replays("bag", &[]);
    }
}

const CHART: &str = r#"<scxml xmlns="http://www.w3.org/2005/07/scxml" xmlns:downbeat="urn:downbeat:state_machine" version="1.0">
    <downbeat:every period="100ms" event="tick"/>
    <state id="first"><transition event="tick" target="second"/></state>
    <state id="second"><transition event="tick" target="first"/></state>
</scxml>
"#;

#[test]
fn lines_of_libraries_have_their_place_in_the_source() {
    if !has_compiler() {
        return;
    }
    let number = SUMS.lines().position(|line| line.contains("is set up")).unwrap() + 1;
    for keys in ["", "isolate = true\n"] {
        let site = Site::new(&format!("{LIBRARY}{keys}"));
        site.build("0.1", -1);
        let mut command = downbeat(&["run", "robot.toml", "--duration", "1s"]);
        command.current_dir(site.path()).env("ROS_DOMAIN_ID", "35").env("XDG_RUNTIME_DIR", site.path());
        command.env("RCUTILS_CONSOLE_OUTPUT_FORMAT", "{file_name}:{line_number} {function_name}: {message}");
        let mut robot = Running::start_by(&mut command);
        robot.wait();
        let line = format!("sums.cpp:{number} setup: is set up\n");
        assert!(robot.output().contains(&line), "{keys}{}", robot.output());
    }
}

#[test]
fn a_robot_starts_without_a_module_whose_file_has_an_error_until_it_is_saved() {
    let site = Site::new(
        "[[module]]\nname = \"player\"\nkind = \"state_machine\"\nfile = \"player.scxml\"\nreload = true\n",
    );
    site.write("player.scxml", "<scxml");
    let mut robot = site.run(&["--record", "bag"], "33");
    robot.wait_for_output("it starts when its file is saved");
    site.write("player.scxml", "<scxml version=");
    robot.wait_for_output("player.scxml was saved and still does not start");
    site.write("player.scxml", CHART);
    robot.wait_for_output("player.scxml was saved: it starts again with it");
    robot.interrupt();

    // What the file needs of the module is missing: the error of the module is the reason.
    site.write("player.scxml", "<scxml");
    site.write(
        "robot.toml",
        "[robot]\nname = \"demo\"\n[[module]]\nname = \"player\"\nkind = \"state_machine\"\nfile = \"player.scxml\"\n\
         reload = true\n[record]\ntopics = [\"player/state\"]\n",
    );
    let mut refused = site.run(&["--duration", "1s"], "33");
    refused.wait();
    let output = refused.output();
    assert!(output.contains("downbeat: robot.toml:4: module \"player\": player.scxml:1: "), "{output}");
}

/// The library of the example, which Cargo builds for these tests.
fn rust_library() -> PathBuf {
    let deps = std::env::current_exe().unwrap().parent().unwrap().to_owned();
    deps.join("libdownbeat_library_example.so")
}

#[test]
fn a_library_in_rust_that_panicked_starts_again_when_it_is_saved() {
    if !has_compiler() {
        return;
    }
    let site = Site::new(&format!(
        "{LIBRARY}remap = {{ sum = \"in\" }}\n[[module]]\nname = \"amplifier\"\nkind = \"library\"\npath = \"libamplifier.so\"\n\
         reload = true\n"
    ));
    // Its numbers are negative, for which the amplifier panics.
    site.build("-0.1", -1);
    std::fs::copy(rust_library(), site.path().join("libamplifier.so")).unwrap();
    let mut robot = site.run(&["--record", "bag"], "34");
    robot.wait_for_output("a negative number");
    site.build("0.1", -1);
    robot.wait_for_output("libsums.so was saved and is reloaded");
    // Another file with the same code: a byte after its end.
    let mut bytes = std::fs::read(rust_library()).unwrap();
    bytes.push(0);
    std::fs::write(site.path().join("new.so"), bytes).unwrap();
    std::fs::rename(site.path().join("new.so"), site.path().join("libamplifier.so")).unwrap();
    robot.wait_for_output("libamplifier.so was saved: it starts again with it");
    site.wait_for_more("/ticks");
    robot.interrupt();
    site.assert_replays("bag", &["--launcher", "threads"]);
}

const GAIN: &str = r#"<scxml xmlns="http://www.w3.org/2005/07/scxml" xmlns:downbeat="urn:downbeat:state_machine" version="1.0">
    <downbeat:publish topic="value" type="std_msgs/msg/Float64"/>
    <downbeat:every period="50ms" event="tick"/>
    <datamodel>
        <downbeat:setting name="gain" default="0.2" about="what it publishes"/>
        <downbeat:setting name="offset" default="0.0" about="what it adds"/>
    </datamodel>
    <state id="only">
        <transition event="tick">
            <send target="value"><param name="data" expr="setting.gain + setting.offset"/></send>
        </transition>
    </state>
</scxml>
"#;

#[test]
fn a_replay_uses_the_recorded_settings_and_says_which_are_others_now() {
    let player = "[[module]]\nname = \"player\"\nkind = \"state_machine\"\nfile = \"player.scxml\"\n";
    let site = Site::new(&format!("{player}settings = {{ gain = 0.1 }}\n"));
    site.write("player.scxml", GAIN);
    let mut robot = site.run(&["--record", "bag", "--duration", "2s"], "36");
    robot.wait();
    assert!(!site.assert_replays("bag", &[]).contains("player.gain"));
    let robot = std::fs::read_to_string(site.path().join("robot.toml")).unwrap();

    site.write("robot.toml", &robot.replace("gain = 0.1", "gain = 0.5"));
    let text = site.assert_replays("bag", &[]);
    assert!(text.contains("player.gain: replayed with 0.1 as recorded; it is 0.5 now"), "{text}");
    let (is_same, text) = site.replay("bag", &["-p", "player.gain:=0.5"]);
    let told = "player.gain: recorded with 0.1, replayed with 0.5 as given for the replay";
    assert!(!is_same && text.contains(told), "{text}");
    let text = site.assert_replays("bag", &["-p", "player.gain:=0.1"]);
    assert!(!text.contains("player.gain"), "{text}");

    // No longer in the file; and one more, which was a default.
    site.write("robot.toml", &robot.replace("gain = 0.1", "offset = 3.0"));
    let text = site.assert_replays("bag", &[]);
    let told = "player.gain: replayed with 0.1 as recorded; the robot file no longer gives it";
    assert!(text.contains(told), "{text}");
    assert!(text.contains("player.offset: replayed with 0 as recorded; it is 3 now"), "{text}");

    // A bag without settings is replayed with those of the file.
    let metadata = site.path().join("bag/metadata.yaml");
    let text = std::fs::read_to_string(&metadata).unwrap();
    assert!(text.contains("module_settings:"), "{text}");
    std::fs::write(&metadata, text.replace("module_settings:", "other_settings:")).unwrap();
    let (is_same, text) = site.replay("bag", &[]);
    assert!(!is_same && !text.contains("player.gain"), "{text}");
}
