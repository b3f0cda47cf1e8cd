//! Interruption of commands: with unread output, while processing bags, and while a state chart computes.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::fs;
use std::io::{Read, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use common::program::{Program, assert_is_whole, collect, command};
use common::{WATCHDOG, downbeat, recorded_messages, text_of, wait_until};
use downbeat::bags::{Reader, TopicDescription, WriterOptions};
use downbeat::msgs::{cdr, std_msgs};
use rustix::process::Signal;
use test_machine::free_domain;

type Pipe = Box<dyn Read + Send>;

/// Starts a command with unread output, in pipes or on a terminal that was halted with Ctrl-S.
fn start_unread(mut command: Command, is_on_terminal: bool) -> (Program, Vec<Pipe>) {
    if is_on_terminal {
        let program = Program::start_on_terminal(&command);
        program.terminal.as_ref().unwrap().write_all(b"\x13").unwrap();
        return (program, Vec::new());
    }
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let pipes: Vec<Pipe> =
        vec![Box::new(child.stdout.take().unwrap()), Box::new(child.stderr.take().unwrap())];
    (Program { child, terminal: None, output: Arc::default() }, pipes)
}

/// Logs two lines in each step, and counts the steps on a topic.
const TALKATIVE: &str = r#"
<scxml xmlns="http://www.w3.org/2005/07/scxml" xmlns:downbeat="urn:downbeat:state_machine" version="1.0">
    <downbeat:publish topic="steps" type="std_msgs/msg/Int64"/>
    <downbeat:every period="2ms" event="tick"/>
    <datamodel><data id="count" expr="0"/></datamodel>
    <state id="on">
        <transition event="tick">
            <assign location="count" expr="count + 1"/>
            <log expr="`step ${count} with as many words as are needed to fill whatever keeps what nobody reads`"/>
            <log expr="'\u009b2J does not clear the terminal'"/>
            <send target="steps"><param name="data" expr="count"/></send>
        </transition>
    </state>
</scxml>
"#;

fn robot_with_chart(folder: &Path, chart: &str) -> String {
    fs::write(folder.join("chart.scxml"), chart.trim_start()).unwrap();
    let file = folder.join("robot.toml");
    let text = "[robot]\nname = \"talkative\"\n[[module]]\nname = \"chart\"\nkind = \"state_machine\"\n\
         file = \"chart.scxml\"\n[record]\ntopics = [\"steps\"]\n";
    fs::write(&file, text).unwrap();
    file.into_os_string().into_string().unwrap()
}

#[test]
#[cfg_attr(not(feature = "state_machine"), ignore = "needs the feature state_machine")]
fn output_that_nobody_reads_halts_neither_a_robot_nor_its_end() {
    for (is_on_terminal, is_read_later) in [(true, true), (true, false), (false, true), (false, false)] {
        let context = format!("on a terminal {is_on_terminal}, read later {is_read_later}");
        let folder = tempfile::tempdir().unwrap();
        let (folder, domain) = (folder.path(), free_domain());
        let (file, bag) = (robot_with_chart(folder, TALKATIVE), folder.join("bag"));
        let arguments = ["run", &file, "--record", bag.to_str().unwrap()];
        let (mut program, pipes) = start_unread(command(&arguments, domain, folder), is_on_terminal);
        // More lines than the program keeps, or more than a pipe takes.
        let enough = if is_read_later { 4000 } else { 1500 };
        let start = Instant::now();
        while recorded_messages(&bag, "/steps") < enough {
            assert!(start.elapsed() < 3 * WATCHDOG, "{context}: {}", recorded_messages(&bag, "/steps"));
            std::thread::sleep(Duration::from_millis(100));
        }
        if !is_read_later {
            program.signal(Signal::TERM);
            assert_eq!(program.wait().code(), Some(0), "{context}");
            assert_is_whole(&bag, "/steps", &context);
            continue;
        }
        if let Some(terminal) = &mut program.terminal {
            terminal.write_all(b"\x11").unwrap();
        }
        pipes.into_iter().for_each(|pipe| collect(pipe, &program.output));
        program.wait_for_output(" lines are missing here: ");
        program.signal(Signal::INT);
        assert_eq!(program.wait().code(), Some(0), "{context}");
        assert_is_whole(&bag, "/steps", &context);
        assert_all_are_there_or_counted(&program.output(), &context);
    }
}

#[test]
fn a_command_whose_output_is_halted_ends_at_the_first_request() {
    let folder = tempfile::tempdir().unwrap();
    let (folder, domain) = (folder.path(), free_domain());
    let text = format!("{{data: {}}}", "0123456789".repeat(200));
    let talker = ["topic", "pub", "-r", "200", "/chatter", "std_msgs/msg/String", &text];
    let _talker = Program::start(command(&talker, domain, folder));
    let echo = command(&["topic", "echo", "/chatter", "std_msgs/msg/String"], domain, folder);
    let (mut program, _pipes) = start_unread(echo, false);
    // The program writes nothing more.
    let (mut before, mut since) = (0, Instant::now());
    wait_until("it waits for its output", || {
        let written = written_by(program.child.id());
        if written != before {
            (before, since) = (written, Instant::now());
        }
        written > 0 && since.elapsed() > Duration::from_secs(1)
    });
    program.signal(Signal::TERM);
    assert_eq!(program.wait().code(), Some(143));
}

/// The bytes that the first thread of a process has written.
fn written_by(process: u32) -> u64 {
    let counts = fs::read_to_string(format!("/proc/{process}/task/{process}/io")).unwrap();
    let written = counts.lines().find_map(|line| line.strip_prefix("wchar: "));
    written.unwrap().parse().unwrap()
}

/// The time that a program has computed, in hundredths of a second.
fn processor_time(program: &Program) -> u64 {
    let status = fs::read_to_string(format!("/proc/{}/stat", program.child.id())).unwrap();
    // Field 14; the second one is the name, in parentheses.
    let after_name = status.rsplit(')').next().unwrap();
    after_name.split_whitespace().nth(11).unwrap().parse().unwrap()
}

fn assert_all_are_there_or_counted(output: &str, context: &str) {
    let (mut next, mut is_gap, mut gaps) = (1, false, 0);
    for line in output.lines() {
        if line.contains(" lines are missing here: ") {
            (is_gap, gaps) = (true, gaps + 1);
        } else if let Some((_, after)) = line.split_once("step ") {
            let number: u64 = after.split(' ').next().unwrap().parse().unwrap();
            assert!(number == next || (is_gap && number > next), "{context}: not {next}, but {line}");
            (next, is_gap) = (number + 1, false);
        }
    }
    assert!(gaps > 0 && next > 1000, "{context}: {gaps} gaps, {next}");
    assert!(output.contains("\\u009b2J does not clear") && !output.contains('\u{9b}'), "{context}");
}

const MESSAGES: u64 = 60_000;

/// A bag that takes a while to process.
fn long_bag(path: &Path) {
    let mut writer = WriterOptions::new().create(path).unwrap();
    let topic = writer
        .add_topic(TopicDescription {
            name: "/chatter".to_owned(),
            type_name: "std_msgs/msg/String".to_owned(),
            ..TopicDescription::default()
        })
        .unwrap();
    let bytes = cdr::to_vec(&std_msgs::msg::String { data: "seven of many words ".repeat(100) });
    for time in 0..MESSAGES {
        let time = i64::try_from(time).unwrap();
        writer.write(topic, time, time, &bytes).unwrap();
    }
    writer.finish().unwrap();
}

fn reads(process: u32, folder: &Path) -> bool {
    let files = fs::read_dir(format!("/proc/{process}/fd")).into_iter().flatten();
    let mut targets = files.filter_map(|file| fs::read_link(file.ok()?.path()).ok());
    targets.any(|target| target.starts_with(folder))
}

/// A signal never leaves half of an output under its name.
#[test]
fn an_interrupted_command_leaves_nothing_that_looks_whole() {
    let folder = tempfile::tempdir().unwrap();
    let folder = &folder.path().canonicalize().unwrap();
    let input = folder.join("long");
    long_bag(&input);
    let contents = || ["long_0.mcap", "metadata.yaml"].map(|name| fs::read(input.join(name)).unwrap());
    let before = contents();
    let (output, unfinished) = (folder.join("output"), folder.join("output.unfinished"));
    let (bag, out) = (input.to_str().unwrap(), output.to_str().unwrap());
    let commands: [&[&str]; 6] = [
        &["bag", "convert", bag, "-o", out, "--compression", "zstd"],
        &["bag", "cut", bag, "-o", out, "--from", "0s"],
        &["bag", "repair", bag, "-o", out],
        &["bag", "export", bag, "-o", out],
        &["bag", "export", bag, "-o", out, "--format", "jsonl"],
        &["bag", "check", bag],
    ];
    let begun = |arguments: &[&str]| {
        let program = Program::start(command(arguments, free_domain(), folder));
        let has_output = !arguments.contains(&"check");
        wait_until("it has begun", || {
            if has_output { unfinished.join("output").exists() } else { reads(program.child.id(), &input) }
        });
        program
    };
    for arguments in commands {
        for signal in [Signal::INT, Signal::TERM, Signal::HUP] {
            let mut program = begun(arguments);
            program.signal(signal);
            let code = program.wait().code();
            assert_eq!(code, Some(128 + signal.as_raw()), "{arguments:?}, {signal:?}: {}", program.output());
            let names = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
            assert_eq!(names.collect::<Vec<_>>(), ["long"], "{arguments:?}, {signal:?}");
        }
    }
    assert!(contents() == before);

    // The output of a killed command is named as unfinished.
    for arguments in &commands[1..5] {
        let mut program = begun(arguments);
        program.signal(Signal::KILL);
        program.wait();
        assert!(!output.exists() && unfinished.exists());
        let refused = downbeat(arguments).output().unwrap();
        let text = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(!refused.status.success() && text.contains("output.unfinished exists already"), "{text}");
        fs::remove_dir_all(&unfinished).unwrap();
    }
    let mut program = begun(commands[0]);
    program.signal(Signal::KILL);
    program.wait();
    let forced: Vec<&str> = commands[0].iter().copied().chain(["--force"]).collect();
    text_of(&forced);
    assert!(!unfinished.exists());
    assert_eq!(Reader::open(&output).unwrap().message_count(), MESSAGES);

    // A file to be replaced stays until it is replaced.
    let mut program = begun(&forced);
    program.signal(Signal::INT);
    assert_eq!(program.wait().code(), Some(130));
    assert_eq!(Reader::open(&output).unwrap().message_count(), MESSAGES);
    assert!(!unfinished.exists() && contents() == before);
}

#[test]
#[cfg_attr(not(feature = "state_machine"), ignore = "needs the feature state_machine")]
fn a_chart_that_computes_for_long_is_interrupted_by_a_stop() {
    let folder = tempfile::tempdir().unwrap();
    let chart = r#"
<scxml xmlns="http://www.w3.org/2005/07/scxml" xmlns:downbeat="urn:downbeat:state_machine" version="1.0">
    <downbeat:publish topic="steps" type="std_msgs/msg/Int64"/>
    <downbeat:every period="1ms" event="tick"/>
    <state id="on">
        <onentry><log expr="'begins'"/></onentry>
        <transition event="tick">
            <script>
                let a = [];
                for i in 0..4000 { a.push((i * 7919) % 4001); }
                loop { let b = a; b.sort(); }
            </script>
        </transition>
    </state>
</scxml>
"#;
    let file = robot_with_chart(folder.path(), chart);
    let mut program = Program::start(command(&["run", &file], free_domain(), folder.path()));
    // The chart computes nearly all the time: each event takes up to its time limit.
    program.wait_for_output("takes longer than 500ms");
    let before = processor_time(&program);
    wait_until("the chart computes the next event", || processor_time(&program) > before + 5);
    program.signal(Signal::INT);
    assert_eq!(program.wait().code(), Some(0), "{}", program.output());
    assert!(program.output().contains("interrupted, since the robot stops"), "{}", program.output());
}
