//! Modules whose files change while the robot runs, also after the modules have stopped; recorded and
//! replayed.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;

use common::{Running, downbeat, open_with_stock_readers, recorded_messages, wait_until};
use downbeat::bags::{Reader, Selection};
use downbeat::msgs::cdr;
use downbeat::msgs::downbeat_interfaces::msg::ModuleEvent;
use test_machine::{free_domain, has_compilers};

/// Publishes sums whose rounding differs between versions, and throws an exception at a given step.
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

/// A folder with a robot file and its modules.
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

    /// Builds the library `libsums.so`. Each version is compiled once.
    fn build(&self, step: &str, raises_at: i32) {
        static BUILT: Mutex<BTreeMap<(String, i32), Vec<u8>>> = Mutex::new(BTreeMap::new());
        let mut built = BUILT.lock().unwrap();
        let flags = [format!("-DSTEP={step}"), format!("-DRAISES_AT={raises_at}")];
        let library = built
            .entry((step.to_owned(), raises_at))
            .or_insert_with(|| self.compile("sums", SUMS, &flags.each_ref().map(String::as_str)));
        self.save("sums", library);
    }

    /// Saves a library as a linker does that writes it beside its place and renames it.
    fn save(&self, name: &str, library: &[u8]) {
        std::fs::write(self.path().join("new.so"), library).unwrap();
        std::fs::rename(self.path().join("new.so"), self.path().join(format!("lib{name}.so"))).unwrap();
    }

    fn compile(&self, name: &str, source: &str, flags: &[&str]) -> Vec<u8> {
        let interfaces = ["std_msgs/msg/Float64", "std_srvs/srv/Trigger", "test_msgs/action/Fibonacci"];
        if !self.path().join("include").exists() {
            let generate = [&["interface", "generate", "--lang", "cpp"], interfaces.as_slice()].concat();
            let generated = downbeat(&generate).current_dir(self.path()).output().unwrap();
            assert!(generated.status.success(), "{}", String::from_utf8_lossy(&generated.stderr));
        }
        let file = format!("{name}.cpp");
        self.write(&file, source);
        let mut compiler = Command::new("c++");
        compiler.args(["-std=c++17", "-shared", "-fPIC", "-fno-gnu-unique", "-Iinclude"]).args(flags);
        let built = compiler.args([&file, "-o", "new.so"]).current_dir(self.path()).output().unwrap();
        assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
        std::fs::read(self.path().join("new.so")).unwrap()
    }

    fn run(&self, options: &[&str], domain: &str) -> Running {
        let mut command = downbeat(&[&["run", "robot.toml"], options].concat());
        command.current_dir(self.path()).env("ROS_DOMAIN_ID", domain).env("XDG_RUNTIME_DIR", self.path());
        Running::start_by(&mut command)
    }

    /// What the program says in the folder of the robot, in its domain.
    fn ask(&self, domain: &str, arguments: &[&str]) -> String {
        let mut command = downbeat(arguments);
        command.current_dir(self.path()).env("ROS_DOMAIN_ID", domain).env("XDG_RUNTIME_DIR", self.path());
        let output = command.output().unwrap();
        [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).concat()
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
        self.wait_for_more_in("bag", topic);
    }

    fn wait_for_more_in(&self, bag: &str, topic: &str) {
        let bag = self.path().join(bag);
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
    let domain = free_domain().to_string();
    if !has_compilers(&["c++"]) {
        return;
    }
    for keys in ["", "isolate = true\n", "synchrony = \"detached\"\n"] {
        let site = Site::new(&format!("{LIBRARY}{keys}"));
        site.build("0.1", 20);
        let first = std::fs::read(site.path().join("libsums.so")).unwrap();
        let mut robot = site.run(&["--record", "bag"], &domain);
        robot.wait_for_output("panicked and was stopped; the other modules continue: as this test wants it");
        site.build("0.2", -1);
        robot.wait_for_output("libsums.so was saved: it starts again with it");
        site.wait_for_more("/sum");
        site.build("0.3", -1);
        robot.wait_for_output("libsums.so was saved and is reloaded");
        site.wait_for_more("/sum");
        robot.interrupt();

        open_with_stock_readers(&site.path().join("bag"));
        assert_eq!(site.events(ModuleEvent::MADE).len(), 2, "{keys}");
        let restarts = site.events(ModuleEvent::COMMAND);
        let restarts = restarts.iter().filter(|event| event.command == "restart" && event.module == "sums");
        assert_eq!(restarts.count(), 1, "{keys}");
        for launcher in ["linear", "pool:2", "threads"] {
            let text = site.assert_replays("bag", &["--launcher", launcher]);
            assert!(text.contains("libsums.so of sums was saved and taken 2 times"), "{text}");
            assert!(!text.contains("has changed since"), "{text}");
        }
        // The current file is the last version, unless the recorded one is requested.
        site.build("0.4", -1);
        let (is_same, text) = site.replay("bag", &[]);
        assert!(!is_same && text.contains("the source of sums has changed since the recording"), "{text}");
        site.assert_replays("bag", &["--recorded-sources"]);

        // Without the copies, a version found next to the bag is used, under another name.
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
    let domain = free_domain().to_string();
    if !has_compilers(&["c++"]) {
        return;
    }
    let number = SUMS.lines().position(|line| line.contains("is set up")).unwrap() + 1;
    for keys in ["", "isolate = true\n"] {
        let site = Site::new(&format!("{LIBRARY}{keys}"));
        site.build("0.1", -1);
        let mut command = downbeat(&["run", "robot.toml", "--duration", "1s"]);
        command.current_dir(site.path()).env("ROS_DOMAIN_ID", &domain).env("XDG_RUNTIME_DIR", site.path());
        command.env("RCUTILS_CONSOLE_OUTPUT_FORMAT", "{file_name}:{line_number} {function_name}: {message}");
        let mut robot = Running::start_by(&mut command);
        robot.wait();
        let line = format!("sums.cpp:{number} setup: is set up\n");
        assert!(robot.output().contains(&line), "{keys}{}", robot.output());
    }
}

#[test]
#[cfg_attr(not(feature = "state_machine"), ignore = "needs the feature state_machine")]
fn a_robot_starts_without_a_module_whose_file_has_an_error_until_it_is_saved() {
    let domain = free_domain().to_string();
    let site = Site::new(
        "[[module]]\nname = \"player\"\nkind = \"state_machine\"\nfile = \"player.scxml\"\nreload = true\n",
    );
    site.write("player.scxml", "<scxml");
    let mut robot = site.run(&["--record", "bag"], &domain);
    robot.wait_for_output("it starts when its file is saved");
    site.write("player.scxml", "<scxml version=");
    robot.wait_for_output("player.scxml was saved and still does not start");
    site.write("player.scxml", CHART);
    robot.wait_for_output("player.scxml was saved: it starts again with it");
    robot.interrupt();
    site.assert_replays("bag", &[]);
}

/// Serves, acts, publishes and has a setting.
const LATE: &str = r#"
#include "downbeat.hpp"
#include "std_msgs/msg/float64.hpp"
#include "std_srvs/srv/trigger.hpp"
#include "test_msgs/action/fibonacci.hpp"
using std_msgs::msg::Float64;
using std_srvs::srv::Trigger;
using test_msgs::action::Fibonacci;
class Late : public downbeat::Module {
    void setup() override {
        auto out = publish<Float64>("sum");
        auto asked = publish<Float64>("asked");
        auto gain = setting("gain", 0.25, "of the sum", 0.0, 1.0);
        serve<Trigger>("ask", [this, asked](const Trigger::Request &) {
            asked({static_cast<double>(++count_)});
            return Trigger::Response{true, "it is there"};
        });
        act<Fibonacci>("count", [](const downbeat::Goal<Fibonacci> &goal) {
            Fibonacci::Result result;
            result.sequence = {goal.request().order};
            goal.succeed(result);
        });
        subscribe<Float64>("in", [out, gain](const Float64 &message) { out({message.data * *gain}); });
        every(std::chrono::milliseconds(10), [this, out, gain] { out({*gain * ++count_}); });
    }
    int count_ = 0;
};
DOWNBEAT_MODULE(Late)
"#;

#[test]
fn what_a_module_brings_that_joins_late_is_exposed_recorded_and_replayed() {
    if !has_compilers(&["c++"]) {
        return;
    }
    for keys in ["", "synchrony = \"detached\"\n"] {
        let domain = &free_domain().to_string();
        let site = Site::new("");
        site.write(
            "robot.toml",
            &format!(
                "[robot]\nname = \"demo\"\n[[module]]\nname = \"late\"\nkind = \"library\"\npath = \"liblate.so\"\nreload = true\n\
                 {keys}[expose]\nout = [\"sum\"]\nin = [\"in\"]\nservices = [\"ask\"]\nactions = [\"count\"]\n\
                 parameters = [\"late.gain\"]\n[record]\n\
                 topics = [\"sum\", \"asked\", \"in\", \"module_*\", \"cycle_*\", \"count/_action/*\"]\n"
            ),
        );
        site.write("liblate.so", "no library");
        let mut robot = site.run(&["--record", "bag"], domain);
        robot.wait_for_output("it starts when its file is saved");
        robot.wait_for_output("until late can be made, this is neither exposed nor recorded: ");
        robot.wait_for_output("no module has a topic \"sum\" to expose; robot.toml:1");
        site.save("late", &site.compile("late", LATE, &[]));
        robot.wait_for_output("liblate.so was saved: it starts again with it");
        let asked = site.ask(domain, &["service", "call", "/ask", "std_srvs/srv/Trigger"]);
        assert!(asked.contains("it is there"), "{asked}\n{}", robot.output());
        let heard = site.ask(domain, &["topic", "echo", "--once", "/sum"]);
        assert!(heard.contains("data: "), "{heard}");
        let goal = ["action", "send_goal", "/count", "test_msgs/action/Fibonacci", "order: 3"];
        let counted = site.ask(domain, &goal);
        assert!(counted.contains("SUCCEEDED"), "{counted}");
        let gain = site.ask(domain, &["param", "get", "/demo", "late.gain"]);
        assert!(gain.contains("0.25"), "{gain}");
        site.ask(domain, &["topic", "pub", "--once", "/in", "std_msgs/msg/Float64", "data: 8.0"]);
        site.wait_for_more("/sum");
        robot.interrupt();
        let bag = site.path().join("bag");
        for topic in ["/asked", "/in"] {
            assert_eq!(recorded_messages(&bag, topic), 1, "{topic}{keys}");
        }
        for launcher in ["linear", "threads"] {
            let text = site.assert_replays("bag", &["--launcher", launcher, "--strict"]);
            assert!(text.contains("/sum") && text.contains("/asked"), "{text}");
        }
        // A name that means nothing is said once the module is there.
        let file = std::fs::read_to_string(site.path().join("robot.toml")).unwrap();
        site.write("robot.toml", &file.replace("out = [\"sum\"]", "out = [\"sum\", \"nothing\"]"));
        site.write("liblate.so", "no library");
        let mut robot = site.run(&[], domain);
        robot.wait_for_output("it starts when its file is saved");
        site.save("late", &site.compile("late", LATE, &[]));
        robot.wait_for_output("exposed service: ask");
        let line = if keys.is_empty() { 9 } else { 10 };
        robot.wait_for_output(&format!(
            "[demo]: robot.toml:{line}: no module has a topic \"nothing\" to expose"
        ));
        robot.interrupt();
    }
}

/// Scales numbers, without a state.
const SCALE: &str = r#"
#include "downbeat.hpp"
#include "std_msgs/msg/float64.hpp"
using std_msgs::msg::Float64;
class Scale : public downbeat::Module {
    void setup() override {
        auto out = publish<Float64>("scaled");
        auto gain = setting("gain", 1.0, "of all numbers");
        subscribe<Float64>("value", [out, gain](const Float64 &message) { out({message.data * STEP * *gain}); });
    }
};
DOWNBEAT_MODULE(Scale)
"#;

/// The page of a robot, as its server sees it.
struct Page(TcpStream);

impl Page {
    fn of(robot: &Running) -> Self {
        const BEFORE: &str = "open in a browser: http://";
        robot.wait_for_output(BEFORE);
        let output = robot.output();
        let url = output.lines().find_map(|line| Some(line.split_once(BEFORE)?.1.trim())).unwrap();
        let (address, token) = url.split_once("/#token=").unwrap();
        let mut stream = TcpStream::connect(address).unwrap();
        let request = format!(
            "GET /?token={token} HTTP/1.1\r\nHost: {address}\r\nOrigin: http://{address}\r\nConnection: Upgrade\r\n\
             Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
             Sec-WebSocket-Protocol: downbeat.view.v1\r\n\r\n"
        );
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = Vec::new();
        while !answer.ends_with(b"\r\n\r\n") {
            let mut byte = [0];
            stream.read_exact(&mut byte).unwrap();
            answer.push(byte[0]);
        }
        assert!(answer.starts_with(b"HTTP/1.1 101"), "{}", String::from_utf8_lossy(&answer));
        Self(stream)
    }

    /// Asks, and waits for the answer: a text frame with this number.
    fn ask(&mut self, number: u64, what: &str) {
        let text = format!("{{\"op\":\"ask\",\"id\":{number},{what}}}");
        let length = u8::try_from(text.len()).ok().filter(|length| *length < 126).unwrap();
        // A frame of a client is masked, here with zeros.
        let frame = [&[0x81, 0x80 | length, 0, 0, 0, 0], text.as_bytes()].concat();
        self.0.write_all(&frame).unwrap();
        loop {
            let mut head = [0; 2];
            self.0.read_exact(&mut head).unwrap();
            let mut length = [0; 8];
            let extended = match head[1] {
                126 => 2,
                127 => 8,
                short => {
                    length[7] = short;
                    0
                }
            };
            self.0.read_exact(&mut length[8 - extended..]).unwrap();
            let mut content = vec![0; usize::try_from(u64::from_be_bytes(length)).unwrap()];
            self.0.read_exact(&mut content).unwrap();
            let answer = String::from_utf8_lossy(&content);
            if head[0] == 0x81 && answer.contains(&format!("\"id\":{number}")) && !answer.contains("channels")
            {
                assert!(!answer.contains("\"error\""), "{answer}");
                return;
            }
        }
    }
}

#[test]
#[cfg_attr(not(feature = "state_machine"), ignore = "needs the feature state_machine")]
fn a_recording_that_begins_after_a_reload_and_bags_of_its_bag_replay() {
    let domain = free_domain().to_string();
    if !has_compilers(&["c++"]) {
        return;
    }
    let site = Site::new(
        "[[module]]\nname = \"player\"\nkind = \"state_machine\"\nfile = \"player.scxml\"\n\
         [[module]]\nname = \"scale\"\nkind = \"library\"\npath = \"libscale.so\"\nreload = true\n\
         [expose]\nparameters = [\"scale.gain\"]\n",
    );
    site.write("player.scxml", GAIN);
    let build = |step: &str| {
        let library = site.compile("scale", SCALE, &[&format!("-DSTEP={step}")]);
        site.save("scale", &library);
    };
    build("0.1");
    let mut robot = site.run(&["--view=0"], &domain);
    let mut page = Page::of(&robot);
    build("0.2");
    robot.wait_for_output("libscale.so was saved and is reloaded");
    let set = site.ask(&domain, &["param", "set", "/demo", "scale.gain", "0.3"]);
    assert!(set.to_lowercase().contains("success"), "{set}");
    page.ask(1, "\"ask\":\"record\",\"name\":\"late\"");
    site.wait_for_more_in("late", "/scaled");
    build("0.3");
    wait_until("it is reloaded again", || robot.output().matches("is reloaded").count() == 2);
    site.wait_for_more_in("late", "/scaled");
    page.ask(2, "\"ask\":\"stop_recording\"");
    robot.interrupt();

    let scale = ["--modules", "scale", "--strict"];
    let text = site.assert_replays("late", &scale);
    assert!(text.contains("libscale.so of scale was saved and taken once"), "{text}");
    let make = |arguments: &[&str]| site.ask(&domain, &[&["bag"], arguments].concat());
    make(&["convert", "late", "-o", "converted", "--compression", "zstd"]);
    make(&["repair", "late"]);
    make(&["cut", "late", "-o", "begin", "--until", "1s"]);
    std::fs::rename(site.path().join("late_repaired"), site.path().join("renamed")).unwrap();
    for bag in ["converted", "renamed", "begin", "begin/begin_0.mcap"] {
        site.assert_replays(bag, &scale);
    }
    // The part after the reload, with the version that is no longer there.
    let last = Reader::open(site.path().join("late")).unwrap().duration().as_secs_f64() - 0.5;
    make(&["cut", "late", "-o", "end", "--from", &format!("{last}s")]);
    build("0.4");
    let recorded = [scale.as_slice(), &["--recorded-sources"]].concat();
    site.assert_replays("end", &recorded);
    let (is_same, text) = site.replay("end", &scale);
    assert!(!is_same && text.contains("the source of scale has changed since"), "{text}");
    // A bag with versions is replaced like another.
    let replaced = make(&["convert", "end", "-o", "converted", "--force"]);
    assert!(replaced.contains("wrote"), "{replaced}");
    site.assert_replays("converted", &recorded);

    std::fs::remove_dir_all(site.path().join("late/module_sources")).unwrap();
    let (_, text) = site.replay("late", &recorded);
    assert_eq!(text.matches("a version of scale is missing: ").count(), 2, "{text}");
    assert!(text.contains("libscale.so of ") && text.contains("with the SHA-256 "), "{text}");
}

/// The library of the example, which Cargo builds for these tests.
fn rust_library() -> PathBuf {
    let deps = std::env::current_exe().unwrap().parent().unwrap().to_owned();
    deps.join("libdownbeat_library_example.so")
}

#[test]
fn a_library_in_rust_that_panicked_starts_again_when_it_is_saved() {
    let domain = free_domain().to_string();
    if !has_compilers(&["c++"]) {
        return;
    }
    let site = Site::new(&format!(
        "{LIBRARY}remap = {{ sum = \"in\" }}\n[[module]]\nname = \"amplifier\"\nkind = \"library\"\npath = \"libamplifier.so\"\n\
         reload = true\n"
    ));
    // Negative numbers make the amplifier panic.
    site.build("-0.1", -1);
    std::fs::copy(rust_library(), site.path().join("libamplifier.so")).unwrap();
    let mut robot = site.run(&["--record", "bag"], &domain);
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
#[cfg_attr(not(feature = "state_machine"), ignore = "needs the feature state_machine")]
fn a_replay_uses_the_recorded_settings_and_says_which_are_others_now() {
    let domain = free_domain().to_string();
    let player = "[[module]]\nname = \"player\"\nkind = \"state_machine\"\nfile = \"player.scxml\"\n";
    let site = Site::new(&format!("{player}settings = {{ gain = 0.1 }}\n"));
    site.write("player.scxml", GAIN);
    let mut robot = site.run(&["--record", "bag", "--duration", "2s"], &domain);
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

    // One setting is no longer in the file, and another one replaces a default.
    site.write("robot.toml", &robot.replace("gain = 0.1", "offset = 3.0"));
    let text = site.assert_replays("bag", &[]);
    let told = "player.gain: replayed with 0.1 as recorded; the robot file no longer gives it";
    assert!(text.contains(told), "{text}");
    assert!(text.contains("player.offset: replayed with 0 as recorded; it is 3 now"), "{text}");

    // A bag without settings is replayed with the settings of the robot file.
    let metadata = site.path().join("bag/metadata.yaml");
    let text = std::fs::read_to_string(&metadata).unwrap();
    assert!(text.contains("module_settings:"), "{text}");
    std::fs::write(&metadata, text.replace("module_settings:", "other_settings:")).unwrap();
    let (is_same, text) = site.replay("bag", &[]);
    assert!(!is_same && !text.contains("player.gain"), "{text}");
}
