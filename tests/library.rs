//! Modules from libraries, loaded by robot files: on the network, recorded and replayed. Skipped on machines
//! without a compiler.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::Path;
use std::process::Command;
use std::time::Instant;

use common::new_user::NewUser;
use common::{Running, downbeat, text_of};
use test_machine::{free_domain, has_compilers};

const PAGE: &str = include_str!("../docs/libraries.md");

/// The block of the page in this language that contains a text.
fn block(language: &str, text: &str) -> &'static str {
    let start = format!("```{language}\n");
    let mut blocks = PAGE.split(&start).skip(1).map(|rest| rest.split("```").next().unwrap());
    blocks.find(|block| block.contains(text)).unwrap()
}

/// Types a command of the page in a folder.
fn shell(user: &mut NewUser, folder: &Path, line: &str) {
    let began = Instant::now();
    let mut command = Command::new("sh");
    user.settle(command.args(["-c", line]).current_dir(folder));
    let output = command.output().unwrap();
    assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    user.has_done("docs/libraries.md", line.trim(), began.elapsed().as_secs_f64(), Vec::new());
}

#[test]
fn the_page_leads_to_a_module_on_the_network() {
    if !has_compilers(&["cc", "c++"]) {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut user = NewUser::new("libraries", &folder.join("home"));
    std::fs::write(folder.join("doubler.cpp"), block("cpp", "DOWNBEAT_MODULE(Doubler)")).unwrap();
    std::fs::write(folder.join("robot.toml"), block("toml", "libdoubler.so")).unwrap();
    shell(&mut user, folder, block("sh", "interface generate"));
    shell(&mut user, folder, block("sh", "c++"));
    let command = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_downbeat"));
        user.settle(command.args(arguments).current_dir(folder));
        command
    };
    let mut robot = Running::start_by(&mut command(&["run", "robot.toml"]));
    robot.wait_for_output("exposed to ROS 2: /out");
    let mut words = block("sh", "topic echo").lines().map(|line| line.split('"').collect::<Vec<_>>());
    let [echo, publish] = [words.next().unwrap(), words.next().unwrap()];
    let echo: Vec<&str> = echo[0].split_whitespace().skip(1).collect();
    let mut echo = Running::start_by(&mut command(&echo));
    let data = publish[1];
    let mut publish: Vec<&str> = publish[0].split_whitespace().skip(1).collect();
    publish.push(data);
    // `echo` is started first, as on the page; numbers published before it is matched are lost.
    while echo.is_running() {
        assert!(command(&publish).output().unwrap().status.success(), "{}", robot.output());
    }
    assert!(echo.output().contains("data: 21.0"), "{}\n{}", echo.output(), robot.output());
    robot.interrupt();
}

#[test]
fn the_module_in_c_of_the_page_is_a_module() {
    if !has_compilers(&["cc", "c++"]) {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut user = NewUser::new("libraries_c", &folder.join("home"));
    std::fs::write(folder.join("doubler.c"), block("c", "downbeat_module")).unwrap();
    shell(&mut user, folder, "downbeat interface generate --lang c std_msgs");
    shell(
        &mut user,
        folder,
        "cc -std=c11 -Wall -Wextra -Werror -shared -fPIC -Iinclude doubler.c -o libdoubler.so",
    );
    let robot = "[robot]\nname = \"demo\"\n[[module]]\nkind = \"library\"\npath = \"libdoubler.so\"\n";
    for keys in ["", "isolate = true\n", "reload = true\n"] {
        std::fs::write(folder.join("robot.toml"), format!("{robot}{keys}")).unwrap();
        let checked = text_of(&["check", folder.join("robot.toml").to_str().unwrap()]);
        assert!(checked.contains("std_msgs/msg/Float64"), "{checked}");
    }
    std::fs::write(folder.join("robot.toml"), format!("{robot}isolate = 3\n")).unwrap();
    let refused = common::output_of(&["check", folder.join("robot.toml").to_str().unwrap()]);
    let refused = String::from_utf8(refused.stderr).unwrap();
    assert!(refused.contains("`isolate` is true or false, not 3"), "{refused}");
}

#[test]
fn the_action_in_c_of_the_page_is_an_action() {
    if !has_compilers(&["cc", "c++"]) {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut user = NewUser::new("libraries_actions", &folder.join("home"));
    std::fs::write(folder.join("counter.c"), block("c", "downbeat_action_take")).unwrap();
    shell(&mut user, folder, "downbeat interface generate --lang c example_interfaces");
    shell(
        &mut user,
        folder,
        "cc -std=c11 -Wall -Wextra -Werror -shared -fPIC -Iinclude counter.c -o libcounter.so",
    );
    let robot = "[robot]\nname = \"demo\"\n[[module]]\nkind = \"library\"\npath = \"libcounter.so\"\n[expose]\nactions = [\"count\"]\n";
    std::fs::write(folder.join("robot.toml"), robot).unwrap();
    let command = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_downbeat"));
        user.settle(command.args(arguments).current_dir(folder));
        command
    };
    let mut robot = Running::start_by(&mut command(&["run", "robot.toml"]));
    robot.wait_for_output("exposed service: /count/_action/get_result");
    for (order, words) in [("{order: 3}", "SUCCEEDED"), ("{order: 0}", "rejected")] {
        let goal = ["action", "send_goal", "/count", "example_interfaces/action/Fibonacci", order];
        let sent = command(&goal).output().unwrap();
        let sent = [sent.stdout, sent.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
        assert!(sent.contains(words), "{sent}\n{}", robot.output());
    }
    robot.interrupt();
}

/// Publishes a sum over time, whose rounding errors repeat only if all inputs and times do.
const SUMS: &str = r#"
#include "downbeat.hpp"
#include "std_msgs/msg/float64.hpp"
using std_msgs::msg::Float64;
class Sums : public downbeat::Module {
    void setup() override {
        auto out = publish<Float64>("sum");
        every(std::chrono::milliseconds(4), [this, out] {
            sum_ += STEP * static_cast<double>(now().count() % 1000003);
            out({sum_});
        });
        auto product = publish<Float64>("product");
        subscribe<Float64>("input", [product](const Float64 &sum, const downbeat::Received &received) {
            product({sum.data * static_cast<double>(received.time.count() % 1009)});
        });
    }
    double sum_ = 0;
};
DOWNBEAT_MODULE(Sums)
"#;

#[test]
fn a_recorded_run_replays_bit_for_bit_and_a_changed_library_is_reported() {
    let domain = free_domain().to_string();
    if !has_compilers(&["cc", "c++"]) {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut user = NewUser::new("libraries_replay", &folder.join("home"));
    std::fs::write(folder.join("sums.cpp"), SUMS).unwrap();
    shell(&mut user, folder, "downbeat interface generate --lang cpp std_msgs/msg/Float64");
    for (step, library) in [("0.1", "libfirst.so"), ("0.1000000001", "libsecond.so")] {
        let build = format!("c++ -std=c++17 -DSTEP={step} -shared -fPIC -Iinclude sums.cpp -o {library}");
        shell(&mut user, folder, &build);
    }
    let build = |library: &str| std::fs::copy(folder.join(library), folder.join("libsums.so")).unwrap();
    // A detached module is replayed apart from what it publishes itself.
    let modules = [
        ("remap = { input = \"sum\" }\n", "in"),
        ("remap = { input = \"sum\" }\nisolate = true\n", "isolated"),
        ("isolate = true\nsynchrony = \"detached\"\n", "apart"),
    ];
    for (keys, name) in modules {
        build("libfirst.so");
        let robot = format!(
            "[robot]\nname = \"demo\"\n[[module]]\nname = \"sums\"\nkind = \"library\"\npath = \"libsums.so\"\n{keys}\
             [record]\ntopics = \"all\"\n"
        );
        std::fs::write(folder.join("robot.toml"), robot).unwrap();
        let run = ["run", "robot.toml", "--duration", "1s", "--record", name];
        let output = downbeat(&run).current_dir(folder).env("ROS_DOMAIN_ID", &domain).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let replay = || {
            let output =
                downbeat(&["bag", "replay", "robot.toml", name]).current_dir(folder).output().unwrap();
            let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
            (output.status.success(), text)
        };
        let (is_same, text) = replay();
        assert!(is_same && !text.contains("has changed"), "{keys}{text}");
        build("libsecond.so");
        let (is_same, text) = replay();
        assert!(
            !is_same && text.contains("the source of sums has changed since the recording"),
            "{keys}{text}"
        );
    }
}
