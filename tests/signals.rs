//! The end of long-running commands: by signals, closed terminals and killed parents.
//!
//! For every command and every way to stop it, the tests check the exit code, the bag, the node in the graph
//! of a peer, child processes, and the link of the emulated bus.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::fs;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use common::program::{Program, Way, assert_is_whole, command};
use common::{QUIET_ROBOT, WATCHDOG, recorded_messages, robot_file, wait_until};
use downbeat::bridge::middleware::{DiscoveryRange, ParticipantOptions};
use downbeat::bridge::ros::{MessageType, NodeName, Participant};
use downbeat::msgs::qos::QosProfile;
use downbeat::msgs::{cdr, std_msgs};
use rustix::process::{Pid, Signal, kill_process};
use test_machine::{free_domain, has_compilers};

const WAYS: [Way; 8] = [
    Way::Signal(Signal::INT),
    Way::Signal(Signal::TERM),
    Way::Signal(Signal::HUP),
    Way::Signal(Signal::QUIT),
    Way::Twice(Duration::from_millis(1)),
    Way::Twice(Duration::from_millis(100)),
    Way::Twice(Duration::from_secs(2)),
    Way::Terminal,
];

/// The processes that a process started, and their descendants.
fn descendants(process: u32) -> Vec<u32> {
    let parent = |entry: fs::DirEntry| -> Option<(u32, u32)> {
        let id = entry.file_name().to_str()?.parse().ok()?;
        let stat = fs::read_to_string(entry.path().join("stat")).ok()?;
        let (_, after) = stat.rsplit_once(')')?;
        Some((id, after.split_whitespace().nth(1)?.parse().ok()?))
    };
    let parents: Vec<_> = fs::read_dir("/proc").unwrap().filter_map(|entry| parent(entry.ok()?)).collect();
    let mut found = vec![process];
    let mut next = 0;
    while let Some(&process) = found.get(next) {
        found.extend(parents.iter().filter(|(_, parent)| *parent == process).map(|(id, _)| *id));
        next += 1;
    }
    found.split_off(1)
}

/// True if a process exists and has not ended.
fn is_running(process: u32) -> bool {
    fs::read_to_string(format!("/proc/{process}/stat")).is_ok_and(|stat| !stat.contains(") Z "))
}

/// A participant of this process, limited to loopback.
fn peer(domain_id: u16) -> Participant {
    let options = ParticipantOptions {
        domain_id,
        discovery_range: DiscoveryRange::Localhost,
        ..ParticipantOptions::from_env().unwrap()
    };
    Participant::join(&options).unwrap()
}

fn sees(peer: &Participant, node: &str) -> bool {
    peer.remote_nodes().iter().any(|found| found.name == node)
}

/// Asserts that a peer notices the end of a process, which has just ended, within a second.
///
/// The last datagrams of the process are in the sockets of the peer. On a busy machine, the peer may be
/// delayed by more than a second. Therefore another node joins now, and the end must at least be noticed
/// before that node.
fn assert_gone(peer: &Participant, domain: u16, context: &str, is_gone: impl Fn(&Participant) -> bool) {
    let ended = Instant::now();
    let later = self::peer(domain);
    let _node = later.create_node(NodeName::new("/", "later").unwrap()).unwrap();
    let (mut gone, mut seen) = (None, None);
    wait_until("the node is gone, and a later one is there", || {
        // Checked in this order, because both may have happened since the last check.
        if seen.is_none() && sees(peer, "/later") {
            seen = Some(ended.elapsed());
        }
        if gone.is_none() && is_gone(peer) {
            gone = Some(ended.elapsed());
        }
        gone.is_some() && seen.is_some()
    });
    let (gone, seen) = (gone.unwrap(), seen.unwrap());
    eprintln!("{context}: gone after {gone:?}, a later node is seen after {seen:?}");
    assert!(gone < Duration::from_secs(1) || gone <= seen, "{context}: {gone:?}, {seen:?}");
}

/// A running command, and the expectations for its end.
struct Case {
    program: Program,
    domain: u16,
    node: Option<&'static str>,
    /// A bag, and a topic that must have messages in it.
    bag: Option<(PathBuf, &'static str)>,
    link: Option<PathBuf>,
    /// True if the command has child processes.
    has_children: bool,
}

fn start(command: Command, way: Way) -> Program {
    if way == Way::Terminal { Program::start_on_terminal(&command) } else { Program::start(command) }
}

/// Waits until the command runs, stops it and checks its end.
fn check(mut case: Case, way: Way, context: &str) {
    let program = &mut case.program;
    let context = format!("{context}, {way:?}");
    let waiting = |program: &Program, what: &str, is_there: &mut dyn FnMut() -> bool| {
        let start = Instant::now();
        while !is_there() {
            assert!(start.elapsed() < WATCHDOG, "{context}: no {what}:\n{}", program.output());
            std::thread::sleep(Duration::from_millis(50));
        }
    };
    let peer = case.node.map(|_| peer(case.domain));
    if let (Some(peer), Some(node)) = (&peer, case.node) {
        waiting(program, "node", &mut || sees(peer, node));
    }
    if let Some((bag, topic)) = &case.bag {
        waiting(program, "messages", &mut || recorded_messages(bag, topic) > 0);
    }
    if let Some(link) = &case.link {
        waiting(program, "link", &mut || fs::symlink_metadata(link).is_ok());
    }
    let children = descendants(program.child.id());
    assert_eq!(children.is_empty(), !case.has_children, "{context}: {children:?}");

    program.ask(way);
    let status = program.wait();
    // If the machine is slow, the second signal arrives while the command is stopping.
    let is_impatient = way == Way::Twice(Duration::from_secs(2)) && status.code() == Some(130);
    assert!(status.code() == Some(0) || is_impatient, "{context}: {status}\n{}", program.output());
    if let (Some(peer), Some(node)) = (&peer, case.node) {
        assert_gone(peer, case.domain, &context, |peer| !sees(peer, node));
    }
    if let Some((bag, topic)) = &case.bag {
        assert_is_whole(bag, topic, &context);
    }
    if let Some(link) = &case.link {
        assert!(fs::symlink_metadata(link).is_err(), "{context}: its link is left");
    }
    for child in children {
        wait_until("no child is left", || !is_running(child));
    }
    let prints = way == Way::Signal(Signal::QUIT);
    let output = program.output();
    assert_eq!(output.contains("modules whose callbacks run"), prints, "{context}: {output}");
}

#[test]
fn a_robot_stops_in_order() {
    let robot = |folder: &Path| robot_file(folder, |text| text);
    for way in WAYS {
        let folder = tempfile::tempdir().unwrap();
        let (folder, domain) = (folder.path(), free_domain());
        let file = robot(folder);
        let program = start(command(&["run", file.to_str().unwrap()], domain, folder), way);
        let link = Some(folder.join("port"));
        check(
            Case { program, domain, node: Some("/darwin_op"), bag: None, link, has_children: false },
            way,
            "run",
        );
    }
}

/// What `sd_notify(3)` and `sd_watchdog_enabled(3)` say between a service and its manager.
#[cfg(target_os = "linux")]
#[test]
fn a_robot_tells_its_service_manager_how_it_is_from_start_to_end() {
    let folder = tempfile::tempdir().unwrap();
    let (folder, domain) = (folder.path(), free_domain());
    let socket = folder.join("notify");
    let manager = std::os::unix::net::UnixDatagram::bind(&socket).unwrap();
    manager.set_read_timeout(Some(WATCHDOG)).unwrap();
    let mut told: Vec<String> = Vec::new();
    let mut wait_for = |expected: &str| {
        let mut buffer = [0; 4096];
        let begins = |text: &String| text.starts_with(expected);
        while !told.last().is_some_and(begins) {
            let length = manager.recv(&mut buffer);
            let length = length.unwrap_or_else(|error| panic!("no {expected}: {error}; {told:?}"));
            told.push(String::from_utf8(buffer[..length].to_vec()).unwrap());
        }
        told.clone()
    };
    let robot = folder.join("robot.toml");
    fs::write(&robot, QUIET_ROBOT).unwrap();
    let mut run = command(&["run", robot.to_str().unwrap()], domain, folder);
    // Fed four times in a second.
    run.env("NOTIFY_SOCKET", &socket).env("WATCHDOG_USEC", "1000000").env_remove("WATCHDOG_PID");
    let mut program = Program::start(run);
    assert_eq!(wait_for("READY=1"), ["READY=1"], "it is ready before it tells anything else");
    wait_for("WATCHDOG=1");
    let status = wait_for("STATUS=").pop().unwrap();
    assert!(status.contains("joint_goals "), "it has the rates of topics: {status}");
    wait_for("WATCHDOG=1");
    program.ask(Way::Signal(Signal::TERM));
    let told = wait_for("STOPPING=1");
    assert_eq!(told.iter().filter(|text| *text == "READY=1").count(), 1, "{told:?}");
    assert_eq!(program.wait().code(), Some(0), "{}", program.output());
}

#[test]
fn a_recorded_robot_closes_its_bag() {
    for way in WAYS {
        let folder = tempfile::tempdir().unwrap();
        let (folder, domain) = (folder.path(), free_domain());
        let (file, bag) = (robot_file(folder, |text| text), folder.join("bag"));
        let arguments = ["run", file.to_str().unwrap(), "--record", bag.to_str().unwrap()];
        let program = start(command(&arguments, domain, folder), way);
        let (bag, link) = (Some((bag, "/joint_states")), Some(folder.join("port")));
        check(
            Case { program, domain, node: Some("/darwin_op"), bag, link, has_children: false },
            way,
            "run --record",
        );
    }
}

#[test]
fn a_recorder_closes_its_bag() {
    for way in WAYS {
        let folder = tempfile::tempdir().unwrap();
        let (folder, domain) = (folder.path(), free_domain());
        let talker = Talker::start(domain);
        let bag = folder.join("bag");
        let arguments = ["bag", "record", "--topics", "/chatter", "-o", bag.to_str().unwrap()];
        let program = start(command(&arguments, domain, folder), way);
        let (node, bag) = (Some("/rosbag2_recorder"), Some((bag, "/chatter")));
        check(Case { program, domain, node, bag, link: None, has_children: false }, way, "bag record");
        drop(talker);
    }
}

/// Publishes on `/chatter` until it is dropped.
struct Talker {
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Talker {
    fn start(domain: u16) -> Self {
        let ends = Arc::<AtomicBool>::default();
        let of_thread = Arc::clone(&ends);
        let thread = std::thread::spawn(move || {
            let node = peer(domain).create_node(NodeName::new("/", "talker").unwrap()).unwrap();
            let text = MessageType::new("std_msgs/msg/String").unwrap();
            let publisher = node.publish("/chatter", &text, QosProfile::DEFAULT).unwrap();
            while !of_thread.load(Ordering::Relaxed) {
                let message = std_msgs::msg::String { data: "hello".to_owned() };
                let _ = publisher.publish(cdr::to_vec(&message).into());
                std::thread::sleep(Duration::from_millis(10));
            }
        });
        Self { ends, thread: Some(thread) }
    }
}

impl Drop for Talker {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        let _ = self.thread.take().unwrap().join();
    }
}

#[test]
fn a_viewed_bag_ends() {
    let bag = Path::new(env!("CARGO_MANIFEST_DIR")).join("bags/recordings/darwin_op_emulated");
    for way in WAYS {
        let folder = tempfile::tempdir().unwrap();
        let arguments = ["bag", "view", bag.to_str().unwrap(), "--port", "0", "--page", "0"];
        let domain = free_domain();
        let program = start(command(&arguments, domain, folder.path()), way);
        program.wait_for_output("open in a browser");
        check(Case { program, domain, node: None, bag: None, link: None, has_children: false }, way, "view");
    }
}

#[test]
fn a_command_that_looks_leaves_the_network() {
    let domain = free_domain();
    for way in WAYS {
        let folder = tempfile::tempdir().unwrap();
        let arguments = ["topic", "echo", "/chatter", "std_msgs/msg/String", "--domain", &domain.to_string()];
        let (program, peer) = (start(command(&arguments, domain, folder.path()), way), peer(domain));
        let looks = |peer: &Participant| {
            peer.remote_nodes().iter().any(|node| node.name.starts_with("/_downbeat_topic"))
        };
        wait_until("the command is seen", || looks(&peer));
        check(Case { program, domain, node: None, bag: None, link: None, has_children: false }, way, "echo");
        assert_gone(&peer, domain, &format!("echo, {way:?}"), |peer| !looks(peer));
    }
}

#[test]
fn a_command_whose_output_nobody_reads_leaves_the_network() {
    let folder = tempfile::tempdir().unwrap();
    let domain = free_domain();
    let (talker, peer) = (Talker::start(domain), peer(domain));
    let arguments = ["topic", "echo", "/chatter", "std_msgs/msg/String"];
    let mut echo = command(&arguments, domain, folder.path());
    let mut child = echo.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let mut first = [0];
    child.stdout.take().unwrap().read_exact(&mut first).unwrap();
    let mut program = Program { child, terminal: None, output: Arc::default() };
    assert_eq!(program.wait().code(), Some(0));
    assert_gone(&peer, domain, "unread", |peer| {
        !peer.remote_nodes().iter().any(|node| node.name.starts_with("/_downbeat_topic"))
    });
    drop(talker);
}

/// Starts `compose` in its line mode, and in it a robot that records.
fn compose(folder: &Path, domain: u16, way: Way) -> (Program, PathBuf) {
    let file = robot_file(folder, |text| text);
    let mut program = start(command(&["compose", "--stdio", file.to_str().unwrap()], domain, folder), way);
    let question = "{\"id\": 1, \"ask\": \"run\", \"record\": true}\n".as_bytes();
    match &mut program.terminal {
        Some(terminal) => terminal.write_all(question).unwrap(),
        None => program.child.stdin.as_mut().unwrap().write_all(question).unwrap(),
    }
    let bag = || {
        let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        entries.into_iter().find(|path| path.join("metadata.yaml").exists())
    };
    let mut found = None;
    wait_until("the robot records", || {
        program.output();
        found = bag();
        found.is_some()
    });
    (program, found.unwrap())
}

#[test]
fn compose_takes_its_robot_with_it() {
    for way in WAYS {
        let folder = tempfile::tempdir().unwrap();
        let (folder, domain) = (folder.path(), free_domain());
        let (program, bag) = compose(folder, domain, way);
        let (bag, link) = (Some((bag, "/joint_states")), Some(folder.join("port")));
        check(
            Case { program, domain, node: Some("/darwin_op"), bag, link, has_children: true },
            way,
            "compose",
        );
    }
}

#[test]
fn a_composed_robot_stops_in_order_when_compose_is_killed() {
    let folder = tempfile::tempdir().unwrap();
    let (folder, domain) = (folder.path(), free_domain());
    let (mut program, bag) = compose(folder, domain, Way::Signal(Signal::KILL));
    let peer = peer(domain);
    wait_until("the robot is there", || {
        sees(&peer, "/darwin_op") && recorded_messages(&bag, "/joint_states") > 0
    });
    let children = descendants(program.child.id());
    assert!(!children.is_empty());
    program.signal(Signal::KILL);
    program.wait();
    for child in children {
        wait_until("no child is left", || !is_running(child));
    }
    assert_gone(&peer, domain, "compose is killed", |peer| !sees(peer, "/darwin_op"));
    assert_is_whole(&bag, "/joint_states", "killed");
    assert!(fs::symlink_metadata(folder.join("port")).is_err());
}

#[cfg(feature = "football")]
#[test]
fn a_match_closes_its_bag() {
    let player = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots/football/seeing_player.toml");
    for (number, way) in WAYS.into_iter().enumerate() {
        // Robots with child processes take long to start.
        let has_children = number % 4 == 0;
        let folder = tempfile::tempdir().unwrap();
        let (folder, domain) = (folder.path(), free_domain());
        let file = folder.join("match.toml");
        let text = format!(
            "[robot]\nname = \"football\"\n[[module]]\nname = \"match\"\nkind = \"football_match\"\n\
             settings = {{ robots = [\"blue_1\"], camera_hz = 1.0 }}\n[expose]\nout = [\"match/state\"]\n\
             [[include]]\nrobot = {player:?}\nnamespace = \"blue_1\"\nsettings = {{ localisation = {{ starts = [-2.7, 0.0, 0.0] }} }}\n"
        );
        fs::write(&file, text).unwrap();
        let bags = folder.join("bags");
        let mut arguments = vec!["match", file.to_str().unwrap(), "--record", bags.to_str().unwrap()];
        let of_robot = free_domain().to_string();
        if has_children {
            arguments.extend(["--processes", "--robot-domains", &of_robot]);
        }
        let program = start(command(&arguments, domain, folder), way);
        let bag = if has_children { bags.join("match") } else { bags.clone() };
        let bag = Some((bag, "/match/state"));
        check(Case { program, domain, node: Some("/football"), bag, link: None, has_children }, way, "match");
    }
}

/// Builds a library in C whose callbacks never return.
fn endless_library(folder: &Path, after: Duration) {
    let include = Path::new(env!("CARGO_MANIFEST_DIR")).join("modules/library/include");
    let source = r#"
        #include <stdio.h>
        #include <stdlib.h>
        #include "downbeat.h"
        static int32_t setup(void *self, const downbeat_host_v1 *host) {
            (void)self;
            return host->timer(host, PERIOD_NS, NULL);
        }
        static int32_t handle(void *self, const downbeat_host_v1 *host, const downbeat_event_v1 *event) {
            (void)self; (void)host; (void)event;
            fputs("spins\n", stderr);
            for (volatile int endless = 1; endless;) {}
            return 0;
        }
        static void *create(const downbeat_host_v1 *host) { (void)host; return malloc(1); }
        static void destroy(void *self) { free(self); }
        const downbeat_module_v1 *downbeat_module(void) {
            static const downbeat_module_v1 module = {
                .abi_version = DOWNBEAT_ABI_VERSION, .struct_size = sizeof module, .name = "endless",
                .create = create, .setup = setup, .handle = handle, .destroy = destroy};
            return &module;
        }
    "#;
    fs::write(folder.join("endless.c"), source).unwrap();
    let mut compiler = Command::new("cc");
    compiler
        .arg(format!("-DPERIOD_NS={}", after.as_nanos()))
        .args(["-std=c11", "-shared", "-fPIC", "endless.c", "-o", "endless.so", "-I"])
        .arg(include);
    assert!(compiler.current_dir(folder).status().unwrap().success());
}

fn with_endless_library(folder: &Path, keys: &str) -> PathBuf {
    robot_file(folder, |text| {
        format!(
            "{text}{}",
            format_args!(
                "\n[[module]]\nname = \"endless\"\nkind = \"library\"\npath = \"endless.so\"\n{keys}"
            )
        )
    })
}

#[test]
fn a_robot_that_does_not_stop_ends_at_the_second_request_with_a_whole_bag() {
    let folder = tempfile::tempdir().unwrap();
    let (folder, domain) = (folder.path(), free_domain());
    if !has_compilers(&["cc"]) {
        return;
    }
    endless_library(folder, Duration::from_secs(5));
    let (file, bag) = (with_endless_library(folder, ""), folder.join("bag"));
    let arguments = ["run", file.to_str().unwrap(), "--record", bag.to_str().unwrap()];
    let (mut program, peer) = (Program::start(command(&arguments, domain, folder)), peer(domain));
    wait_until("the robot runs", || {
        sees(&peer, "/darwin_op") && recorded_messages(&bag, "/joint_states") > 0
    });
    program.wait_for_output("spins");
    program.signal(Signal::QUIT);
    let names_it = |line: &str| line.contains("modules whose callbacks run") && line.contains("endless");
    wait_until("the module is named", || program.output().lines().any(names_it));
    program.signal(Signal::TERM);
    std::thread::sleep(Duration::from_millis(1500));
    assert!(program.child.try_wait().unwrap().is_none(), "{}", program.output());
    program.signal(Signal::TERM);
    assert_eq!(program.wait().code(), Some(128 + 15), "{}", program.output());
    assert_gone(&peer, domain, "impatient", |peer| !sees(peer, "/darwin_op"));
    // The program measures its own time and ends after its limit, regardless of unfinished work.
    let is_about_end = |line: &&str| line.contains("ends without waiting for modules");
    let output = program.output();
    let line = output.lines().find(is_about_end).unwrap_or_else(|| panic!("{output}"));
    let took = line.split("after ").nth(1).unwrap().split(" ms:").next().unwrap();
    assert!(took.parse::<f64>().unwrap() <= 200.0, "{line}");
    for closed in ["ROS 2", "links of emulated devices"] {
        assert!(line.contains(closed), "{line}");
    }
    // A busy disk may take longer, which the output reports.
    if line.contains("bags") {
        assert_is_whole(&bag, "/joint_states", "impatient");
    } else {
        assert!(output.contains("could not be finished in time: `downbeat bag repair"), "{output}");
    }
    assert!(fs::symlink_metadata(folder.join("port")).is_err());
}

#[test]
fn a_library_that_does_not_return_stops_neither_its_robot_nor_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let (folder, domain) = (folder.path(), free_domain());
    if !has_compilers(&["cc"]) {
        return;
    }
    endless_library(folder, Duration::from_millis(300));
    let keys = "isolate = true\ntime_limit = \"500ms\"\nrestart = { times = 1000, backoff = \"1ms\" }\n";
    for signal in [Signal::TERM, Signal::KILL] {
        let file = with_endless_library(folder, keys);
        let mut program = Program::start(command(&["run", file.to_str().unwrap()], domain, folder));
        program.wait_for_output("did not return from `handle` for timer 0 within 500ms and was killed");
        let mut children = Vec::new();
        wait_until("it has another child", || {
            children = descendants(program.child.id());
            !children.is_empty()
        });
        program.signal(signal);
        let status = program.wait();
        assert!(status.success() || signal == Signal::KILL, "{status}\n{}", program.output());
        for child in children {
            wait_until("no child is left", || !is_running(child));
        }
    }
}

#[test]
fn a_robot_whose_hang_ups_are_ignored_outlives_its_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let (folder, domain) = (folder.path(), free_domain());
    let (file, bag) = (robot_file(folder, |text| text), folder.join("bag"));
    let robot = command(&["run", file.to_str().unwrap(), "--record", bag.to_str().unwrap()], domain, folder);
    let mut nohup = Command::new("sh");
    nohup.args(["-c", "trap '' HUP; exec \"$@\"", "sh"]).arg(robot.get_program()).args(robot.get_args());
    nohup.current_dir(robot.get_current_dir().unwrap());
    for (name, value) in robot.get_envs() {
        match value {
            Some(value) => nohup.env(name, value),
            None => nohup.env_remove(name),
        };
    }
    let mut program = Program::start_on_terminal(&nohup);
    wait_until("it records", || {
        program.output();
        recorded_messages(&bag, "/joint_states") > 0
    });
    program.ask(Way::Terminal);
    let before = recorded_messages(&bag, "/joint_states");
    wait_until("it goes on", || recorded_messages(&bag, "/joint_states") > before + 300);
    assert!(program.child.try_wait().unwrap().is_none());
    program.signal(Signal::INT);
    assert_eq!(program.wait().code(), Some(0));
    assert_is_whole(&bag, "/joint_states", "without a terminal");
}

/// systemd sends SIGTERM to all processes of a service, and after a while SIGKILL to those that remain.
#[test]
fn a_service_manager_need_not_kill() {
    let folder = tempfile::tempdir().unwrap();
    let (folder, domain) = (folder.path(), free_domain());
    let (mut program, bag) = compose(folder, domain, Way::Signal(Signal::TERM));
    wait_until("it records", || recorded_messages(&bag, "/joint_states") > 0);
    let children = descendants(program.child.id());
    for process in children.iter().copied().chain([program.child.id()]) {
        let _ = kill_process(Pid::from_raw(process.cast_signed()).unwrap(), Signal::TERM);
    }
    let asked = Instant::now();
    assert_eq!(program.wait().code(), Some(0));
    assert!(asked.elapsed() < Duration::from_secs(10), "{:?}", asked.elapsed());
    assert!(children.into_iter().all(|child| !is_running(child)));
    assert_is_whole(&bag, "/joint_states", "systemd");
}

/// The robot's block and the screen of `top` fit small terminals, and a signal restores the terminal.
#[test]
fn small_terminals_are_drawn_on_and_restored() {
    let folder = tempfile::tempdir().unwrap();
    let (folder, domain) = (folder.path(), free_domain());
    let file = folder.join("robot.toml");
    fs::write(&file, QUIET_ROBOT).unwrap();
    for (size, signal) in [((20, 5), Signal::TERM), ((0, 0), Signal::HUP), ((1, 1), Signal::INT)] {
        let run = command(&["run", file.to_str().unwrap()], domain, folder);
        let mut robot = Program::start_on_terminal_of(&run, size);
        if size != (1, 1) {
            robot.wait_for_output("/quiet");
        }
        let mut top = None;
        wait_until("top sees the robot", || {
            robot.output();
            let mut started = Program::start_on_terminal_of(&command(&["top"], domain, folder), size);
            let start = Instant::now();
            while !started.output().contains("\u{1b}[?1049h") && started.child.try_wait().unwrap().is_none() {
                assert!(start.elapsed() < WATCHDOG, "{}", started.output());
                std::thread::sleep(Duration::from_millis(5));
            }
            let is_there = started.child.try_wait().unwrap().is_none();
            top = is_there.then_some(started);
            is_there
        });
        let mut top = top.unwrap();
        // The cursor is hidden after each drawing.
        wait_until("top has drawn several times", || top.output().matches("\u{1b}[?25l").count() > 3);
        top.signal(signal);
        assert_eq!(top.wait().code(), Some(0), "{size:?}: {}", top.output());
        assert!(top.output().contains("\u{1b}[?1049l"), "{size:?}: {:?}", top.output());
        robot.signal(signal);
        assert_eq!(robot.wait().code(), Some(0), "{size:?}: {}", robot.output());
    }
}
