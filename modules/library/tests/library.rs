//! Modules in C and C++ in a core, in its process and in child processes. Skipped on machines without a
//! compiler.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::{Log, Robot, SOURCES, build, cpp, generated, has_compiler, library};
use downbeat_edge::Interfaces;
use downbeat_edge::foreign::ForeignModule;
use downbeat_executor::{Core, LifecycleState, ManualClock, ModuleOptions, Restart, SettingValue, Time};
use downbeat_library_host::{LibraryOptions, load, set_child_command};
use downbeat_msgs::dynamic::DynamicMessage;
use downbeat_msgs::std_msgs::msg::Float64;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

fn use_own_children() {
    set_child_command([OsString::from(env!("CARGO_BIN_EXE_library-child"))]);
}

fn both(path: &Path) -> [LibraryOptions; 2] {
    use_own_children();
    let options = LibraryOptions { module: "module".into(), path: path.into(), ..LibraryOptions::default() };
    [options.clone(), LibraryOptions { is_isolated: true, ..options }]
}

#[test]
fn messages_and_settings_reach_a_module_in_c_and_leave_it() {
    let Some(path) = library("amplifier.c", &[]) else { return };
    for options in both(&path) {
        let mut robot = Robot::new();
        robot.add(&options, ModuleOptions::default()).unwrap();
        let out = robot.receive("out");
        let input = robot.core.inlet::<Float64>("in").unwrap();
        input.publish(Float64 { data: 1.5 }).unwrap();
        robot.cycles(3);
        drop(robot.core.handle().set("module", "gain", 4.0));
        input.publish(Float64 { data: 1.5 }).unwrap();
        robot.cycles(3);
        assert_eq!(out.try_iter().collect::<Vec<_>>(), [3.0, 6.0]);
    }
}

#[test]
fn a_module_in_cpp_serves_calls_schedules_and_refuses_settings() {
    let Some(path) = library("counter.cpp", &[]) else { return };
    for options in both(&path) {
        let mut robot = Robot::new();
        let remaps = BTreeMap::from([("other".to_owned(), "theirs".to_owned())]);
        let settings = BTreeMap::from([("step".to_owned(), SettingValue::Integer(2))]);
        robot.add(&options, ModuleOptions { remaps, settings, ..ModuleOptions::default() }).unwrap();
        // The same library twice: its objects are apart.
        let other = LibraryOptions { module: "other".into(), ..options.clone() };
        let remaps =
            ["count", "version", "answers", "ask"].map(|name| (name.to_owned(), format!("other/{name}")));
        let mut remaps = BTreeMap::from(remaps);
        remaps.insert("enable".into(), "theirs".into());
        robot.add(&other, ModuleOptions { remaps, ..ModuleOptions::default() }).unwrap();
        let (counts, answers) = (robot.receive("count"), robot.receive("answers"));
        robot.core.inlet::<Float64>("ask").unwrap().publish(Float64 { data: 0.0 }).unwrap();
        robot.cycles(10);
        assert_eq!(counts.try_iter().take(3).collect::<Vec<_>>(), [2.0, 4.0, 6.0]);
        assert_eq!(answers.try_iter().collect::<Vec<_>>(), [1.0, -1.0]);
        let handle = robot.core.handle();
        let refused = [handle.set("module", "label", String::new()), handle.set("module", "step", 101.0)];
        let taken = handle.set("module", "label", "front".to_owned());
        drop(handle.set("module", "flags", SettingValue::Bools(vec![false, true])));
        robot.cycles(2);
        let refused = refused.map(|receipt| receipt.try_take().unwrap().unwrap_err().to_string());
        assert!(refused[0].contains("a label has a letter"), "{refused:?}");
        assert!(refused[1].contains("out of range"), "{refused:?}");
        taken.try_take().unwrap().unwrap();
        counts.try_iter().for_each(drop);
        robot.cycles(5);
        assert_eq!(counts.try_iter().count(), 0, "the flag stops it");
    }
}

#[test]
fn lines_of_the_log_are_limited_by_the_time_of_cycles() {
    let (Some(amplifier), Some(counter)) = (library("amplifier.c", &[]), library("counter.cpp", &[])) else {
        return;
    };
    for (in_process, child) in both(&amplifier).into_iter().zip(both(&counter)) {
        let log = Log::default();
        let _logging = tracing::subscriber::set_default(log.clone());
        let mut robot = Robot::new();
        robot
            .add(&LibraryOptions { module: "amplifier".into(), ..in_process }, ModuleOptions::default())
            .unwrap();
        robot.add(&child, ModuleOptions::default()).unwrap();
        let input = robot.core.inlet::<Float64>("in").unwrap();
        for _ in 0..3 {
            input.publish(Float64 { data: 1.0 }).unwrap();
            robot.cycles(7);
        }
        let text = log.text();
        let count = |line: &str| text.matches(line).count();
        assert_eq!([count("message=amplifies"), count("message=began")], [1, 1], "{text}");
        assert_eq!([count("message=counts "), count("message=counts suppressed=9")], [2, 1], "{text}");
    }
}

#[test]
fn an_error_an_exception_and_bad_bytes_end_the_module_alone_and_it_starts_again() {
    let (Some(amplifier), Some(counter)) = (library("amplifier.c", &[]), library("counter.cpp", &[])) else {
        return;
    };
    let cases = [
        (&amplifier, "in", -1.0, "a negative number"),
        (&amplifier, "in", 1234.0, "`handle` returned 7 without a reason"),
        (&amplifier, "in", 4321.0, "the bytes for \"out\" are no std_msgs/msg/Float64"),
        (&counter, "fail", 1.0, "there is no joint 21"),
        (&counter, "fail", 2.0, "an exception that is no std::exception"),
    ];
    for (path, topic, number, words) in cases {
        for options in both(path) {
            let failure = failure_of(&options, topic, number);
            assert!(failure.contains(words), "{failure}");
        }
    }
}

/// Ends a module, which starts again; returns the line of the log.
fn failure_of(options: &LibraryOptions, topic: &str, number: f64) -> String {
    let mut robot = Robot::new();
    let restart = Restart::Times { limit: 1, backoff: Duration::from_millis(10) };
    robot.add(options, ModuleOptions { restart, ..ModuleOptions::default() }).unwrap();
    let input = robot.core.inlet::<Float64>(topic).unwrap();
    input.publish(Float64 { data: number }).unwrap();
    let log = common::Log::default();
    tracing::subscriber::with_default(log.clone(), || robot.cycles(10));
    let module = &robot.core.modules()[0];
    assert_eq!((module.state, module.restarts), (LifecycleState::Active, 1), "{options:?}");
    log.text()
}

#[test]
fn a_crash_of_an_isolated_library_ends_the_module_alone_and_ten_times_a_new_child_starts() {
    let Some(path) = library("counter.cpp", &[]) else { return };
    let [_, options] = both(&path);
    for (number, words) in [(3.0, "signal: 9 (SIGKILL)"), (4.0, "signal: 6 (SIGABRT)")] {
        let failure = failure_of(&options, "fail", number);
        assert!(failure.contains(words) && failure.contains("ended in `handle`"), "{failure}");
    }
    let mut robot = Robot::new();
    let restart = Restart::Always { backoff: Duration::from_millis(10) };
    robot.add(&options, ModuleOptions { restart, ..ModuleOptions::default() }).unwrap();
    let (input, counts) = (robot.core.inlet::<Float64>("fail").unwrap(), robot.receive("count"));
    for round in 1..=10 {
        input.publish(Float64 { data: 3.0 }).unwrap();
        // The delay before a restart doubles up to 30 s; time is the test's.
        let restarted = |robot: &Robot| robot.core.modules()[0].restarts == round;
        let cycles = (0..10_000).take_while(|_| {
            robot.cycles(1);
            !restarted(&robot)
        });
        assert!(cycles.count() < 10_000, "round {round}");
        counts.try_iter().for_each(drop);
        robot.cycles(3);
        assert_eq!(counts.try_iter().next(), Some(1.0), "a new object counts from the start");
    }
}

#[test]
fn an_isolated_library_that_does_not_return_is_killed_and_starts_again() {
    let Some(path) = library("counter.cpp", &[]) else { return };
    let [_, options] = both(&path);
    let options = LibraryOptions { time_limit: Duration::from_millis(500), ..options };
    let begun = Instant::now();
    let failure = failure_of(&options, "fail", 5.0);
    let words = "did not return from `handle` for a message of \"fail\" within 500ms and was killed";
    assert!(failure.contains("module") && failure.contains(words), "{failure}");
    // Far above half a second on a busy machine, below the 20 s that `setup` may take.
    assert!(begun.elapsed() < Duration::from_secs(15), "killed after {:.1?}", begun.elapsed());
}

#[test]
fn a_changed_library_takes_over_with_state_and_settings_a_hundred_times() {
    if !has_compiler() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (built, path) = (folder.path().join("built.so"), folder.path().join("libcounter.so"));
    let include = generated();
    let make = |defines: &[&str]| {
        build(&mut cpp(), "counter.cpp", &include, defines, &built);
        // In place: what is loaded is a copy.
        std::fs::copy(&built, &path).unwrap();
    };
    make(&["-DVERSION=1"]);
    for options in both(&path) {
        let options = LibraryOptions { is_reloaded: true, ..options };
        let mut robot = Robot::new();
        robot.add(&options, ModuleOptions::default()).unwrap();
        let (counts, versions) = (robot.receive("count"), robot.receive("version"));
        robot.cycles(5);
        drop(robot.core.handle().set("module", "step", 2.0));
        robot.cycles(5);
        for defines in [["-DVERSION=2", "-DMISTAKE"], ["-DVERSION=3", "-DFINE"]] {
            make(&defines);
            robot.cycles(100);
            assert_eq!(robot.core.modules()[0].state, LifecycleState::Active);
        }
        assert_eq!(versions.try_iter().last(), Some(3.0), "the version with a mistake did not take over");
        // Each change of the file is a new version.
        let times = if options.is_isolated { 10 } else { 100 };
        for time in 0..times {
            let file = std::fs::File::options().append(true).open(&path).unwrap();
            file.set_modified(std::time::UNIX_EPOCH + Duration::from_secs(1000 + time)).unwrap();
            let log = common::Log::default();
            tracing::subscriber::with_default(log.clone(), || robot.cycles(60));
            assert!(log.text().contains("is reloaded"), "{time}: {}", log.text());
        }
        let counts: Vec<f64> = counts.try_iter().collect();
        let late = &counts[20..];
        assert!(late.windows(2).all(|pair| pair[1] == pair[0] + 2.0), "no version lost the count: {late:?}");
        make(&["-DVERSION=1"]);
    }
}

fn rust_library() -> LibraryOptions {
    // Cargo builds it for the crate that these tests depend on.
    let folder = std::env::current_exe().unwrap().parent().unwrap().to_owned();
    let path = folder.join("libdownbeat_library_example.so");
    LibraryOptions { module: "module".into(), path, ..LibraryOptions::default() }
}

/// What a robot with this module publishes in a scenario of messages, calls, tasks and settings, and what the
/// module shows a debugger afterwards.
fn scenario(add: impl Fn(&mut Robot, &str, ModuleOptions)) -> (Vec<Vec<f64>>, Option<String>) {
    let mut robot = Robot::new();
    let action = |from: &str, to: &str| {
        let name = |action: &str, part: &str| format!("{action}/_action/{part}");
        ["send_goal", "get_result", "cancel_goal", "feedback", "status"]
            .map(|part| (name(from, part), name(to, part)))
    };
    let mut remaps = BTreeMap::from([("other".to_owned(), "theirs".to_owned())]);
    remaps.extend(action("lean_on", "other/lean"));
    let settings = BTreeMap::from([("gain".to_owned(), SettingValue::Double(3.0))]);
    add(&mut robot, "module", ModuleOptions { remaps, settings, ..ModuleOptions::default() });
    let remaps =
        ["in", "out", "ticks", "answers", "ask", "lean_by", "level", "refuse", "fail", "hold", "leave"]
            .map(|name| (name.to_owned(), format!("other/{name}")));
    let mut remaps = BTreeMap::from(remaps);
    remaps.insert("enable".into(), "theirs".into());
    remaps.extend(action("lean", "other/lean"));
    add(&mut robot, "server", ModuleOptions { remaps, ..ModuleOptions::default() });
    let taken = ["out", "ticks", "answers"].map(|topic| robot.receive(topic));
    let input = robot.core.inlet::<Float64>("in").unwrap();
    for data in [1.0, 2.0, 3.0] {
        input.publish(Float64 { data }).unwrap();
    }
    robot.core.inlet::<Float64>("ask").unwrap().publish(Float64 { data: 0.0 }).unwrap();
    robot.cycles(8);
    let handle = robot.core.handle();
    let refused = [handle.set("module", "gain", 7.0), handle.set("module", "gain", 11.0)];
    drop(handle.set("module", "gain", 5.0));
    robot.cycles(2);
    let refused = refused.map(|receipt| receipt.try_take().unwrap().unwrap_err().to_string());
    assert!(refused[0].contains("not seven") && refused[1].contains("out of range"), "{refused:?}");
    input.publish(Float64 { data: 1.0 }).unwrap();
    let lean = robot.core.inlet::<Float64>("lean_by").unwrap();
    for data in [2.0, 0.5] {
        lean.publish(Float64 { data }).unwrap();
    }
    robot.cycles(12);
    (taken.map(|taken| taken.try_iter().collect()).into(), robot.core.debug("module"))
}

#[test]
fn a_module_in_rust_does_in_a_library_what_it_does_compiled_in() {
    use_own_children();
    let library = |is_isolated| {
        move |robot: &mut Robot, name: &str, options| {
            let library = LibraryOptions { module: name.into(), is_isolated, ..rust_library() };
            robot.add(&library, options).unwrap();
        }
    };
    let compiled_in = scenario(|robot, name, options| {
        robot.core.add_with(name, downbeat_library_example::Amplifier::default(), options).unwrap();
    });
    let (published, shown) = &compiled_in;
    assert_eq!(published[0], [3.0, 6.0, 9.0, 5.0]);
    // Two answers, a goal that was refused, and one that was reached.
    assert_eq!(published[2], [1.0, -1.0, -2.0, 0.5]);
    assert!(shown.as_ref().unwrap().starts_with("Amplifier {\n    ticks: "), "{shown:?}");
    assert_eq!(scenario(library(false)), compiled_in);
    assert_eq!(scenario(library(true)), compiled_in);
}

#[test]
fn a_library_in_rust_brings_the_definitions_of_its_own_services() {
    use_own_children();
    for is_isolated in [false, true] {
        let library = LibraryOptions { is_isolated, ..rust_library() };
        let interfaces = Interfaces::carried();
        let make = Arc::new(move || load(&library));
        let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
        core.add("module", ForeignModule::new(make, interfaces.clone(), ModuleOptions::default())).unwrap();
        let level = interfaces.service_of(core.service("level").unwrap()).unwrap();
        assert_eq!(level.name(), "my_msgs/srv/Level");
        assert!(level.definition().contains("# Brings the body upright."), "{}", level.definition());
        let of = |part: &str| interfaces.definitions().find(&format!("my_msgs/srv/Level_{part}")).unwrap();
        let caller = level.caller(&mut core, "level").unwrap();
        let (sender, answers) = std::sync::mpsc::channel();
        let request = DynamicMessage::new(&of("Request")).to_cdr();
        caller.call(&request, Duration::from_secs(60), move |answer| {
            sender.send(answer.unwrap().into_cdr()).unwrap();
        });
        (0..4).for_each(|_| core.cycle().unwrap());
        let answer = DynamicMessage::from_cdr(&of("Response"), &answers.try_recv().unwrap()).unwrap();
        assert_eq!(answer.get("is_level").unwrap().as_bool(), Some(true), "the default speed is 0.5");
    }
}

#[test]
fn a_panic_in_a_library_in_rust_ends_its_module_alone() {
    use_own_children();
    for is_isolated in [false, true] {
        let failure = failure_of(&LibraryOptions { is_isolated, ..rust_library() }, "in", -1.0);
        assert!(failure.contains("a negative number") && failure.contains("src/lib.rs"), "{failure}");
    }
}

#[test]
fn what_is_no_library_of_this_interface_is_refused_with_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, content: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, content).unwrap();
        path
    };
    let mut elf = std::fs::read(std::env::current_exe().unwrap()).unwrap();
    elf[18] = if elf[18] == 243 { 62 } else { 243 };
    let mut cases = vec![
        (folder.path().join("libmissing.so"), vec!["libmissing.so", "No such file", "build the library"]),
        (file("text.so", b"hello"), vec!["text.so is no library", "cc -shared -fPIC"]),
        (file("empty.so", b""), vec!["is an empty file"]),
        (file("foo.dll", b"MZ\0\0"), vec!["of Windows"]),
        (file("other.so", &elf), vec!["a library for"]),
        (std::env::current_exe().unwrap(), vec![""]),
    ];
    if has_compiler() {
        let own = |defines: &[&str]| library("amplifier.c", defines).unwrap();
        let whole = own(&["-DWHOLE"]);
        let content = std::fs::read(whole).unwrap();
        cases.extend([
            (
                file("half.so", &content[..content.len() / 2]),
                vec!["ends in the middle", "build the library again"],
            ),
            (own(&["-DSYMBOL=other"]), vec!["does not export `downbeat_module`", "DOWNBEAT_MODULE(Class)"]),
            (own(&["-DVERSION=7"]), vec!["version 7", "this program has version 1", "interface generate"]),
            (own(&["-DSIZE=12"]), vec!["declares 12 bytes", "are needed"]),
            (own(&["-DNO_TABLE"]), vec!["returned NULL"]),
            (
                own(&["-DWRONG_HASH"]),
                vec!["another definition of std_msgs/msg/Float64: RIHS01_00", "compile it again"],
            ),
            (own(&["-DERROR_IN_SETUP"]), vec!["no camera"]),
        ]);
    }
    for (path, words) in cases {
        for options in both(&path) {
            let mut robot = Robot::new();
            let refusal = robot.add(&options, ModuleOptions::default()).unwrap_err();
            assert!(words.iter().all(|word| refusal.contains(word)), "{options:?}: {refusal}");
        }
    }
}

#[test]
fn structs_of_rust_and_of_a_c_compiler_have_the_same_layout() {
    if !has_compiler() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("layout");
    let status = Command::new("cc")
        .args(["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I"])
        .arg(generated())
        .arg(Path::new(SOURCES).join("layout.c"))
        .arg("-o")
        .arg(&program)
        .status();
    assert!(status.unwrap().success());
    let found = String::from_utf8(Command::new(program).output().unwrap().stdout).unwrap();
    use downbeat_library_abi::{EventV1, HostV1, ModuleV1, SettingV1, ValueV1};
    use std::mem::offset_of;
    let own = [
        size_of::<ValueV1>(),
        offset_of!(ValueV1, count),
        size_of::<SettingV1>(),
        offset_of!(SettingV1, is_read_only),
        size_of::<EventV1>(),
        offset_of!(EventV1, is_error),
        size_of::<HostV1>(),
        offset_of!(HostV1, publish),
        offset_of!(HostV1, saved),
        size_of::<ModuleV1>(),
        offset_of!(ModuleV1, restore),
        offset_of!(HostV1, variable),
        offset_of!(ModuleV1, variables),
    ];
    assert_eq!(found.split_whitespace().map(|number| number.parse().unwrap()).collect::<Vec<usize>>(), own);
}

#[test]
fn a_missing_library_is_an_error_of_load() {
    let options = LibraryOptions { path: "nowhere/libfoo.so".into(), ..LibraryOptions::default() };
    let error = load(&options).map(drop).unwrap_err();
    assert!(error.contains("nowhere/libfoo.so"), "{error}");
}
