//! A recorded run that is walked through, replayed with changes, and bisected: `downbeat bag debug`,
//! `bag replay --with`, `bag bisect`.
#![cfg(all(unix, feature = "cli", feature = "football"))]
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "../common/mod.rs"]
mod common;
mod revisions;

use std::fmt::Write as _;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use common::{downbeat, open_with_stock_readers, output_of, text_of};
use downbeat::bags::{Copy, MessageFormat, Reader, Selection, WriterOptions};
use downbeat::msgs::encoding::Schema;

const WALK: &str = "bags/recordings/darwin_op_walk_simulated";
const WALKER: &str = "bags/recordings/darwin_op_walk_simulated.toml";

/// Gives lines to the debugger and returns what it prints.
fn debugged(robot: &str, bag: &str, lines: &str) -> String {
    let mut command = downbeat(&["bag", "debug", robot, bag]);
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut input = child.stdin.take().unwrap();
    let lines = lines.to_owned();
    let writing = std::thread::spawn(move || input.write_all(lines.as_bytes()).unwrap());
    let output = child.wait_with_output().unwrap();
    writing.join().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    let (printed, problems) = (text(output.stdout), text(output.stderr));
    assert!(output.status.success(), "{printed}\n{problems}");
    printed
}

/// Numbers that look random, the same each time.
fn random() -> impl Iterator<Item = u64> {
    std::iter::successors(Some(0x2545_F491_4F6C_DD1D_u64), |state| {
        let mut next = *state;
        next ^= next << 13;
        next ^= next >> 7;
        Some(next ^ (next << 17))
    })
}

/// What was printed at each cycle that was reached at once, from before and from behind, with marks between:
/// each time the same.
fn looks_of(printed: &str, cycles: usize) -> Vec<&str> {
    let mut parts = printed.split("unknown command \"mark\"; `help` lists them\n").skip(1);
    let mut looks = Vec::new();
    for _ in 0..cycles {
        let at_once = parts.next().unwrap();
        let _on_the_way = parts.next().unwrap();
        let from_before = parts.next().unwrap();
        let _on_the_way = parts.next().unwrap();
        let from_behind = parts.next().unwrap();
        assert!(at_once.starts_with("cycle #"), "{at_once}");
        for other in [from_before, from_behind] {
            assert_eq!(other, at_once);
        }
        looks.push(at_once);
        let _rest = parts.next();
    }
    looks
}

#[test]
fn a_cycle_is_the_same_from_before_from_behind_and_at_once() {
    let cycles = std::env::var("DOWNBEAT_DEBUG_CYCLES").map_or(40, |cycles| cycles.parse().unwrap());
    // In parts of cycles that are apart from each other.
    let mut lines = String::new();
    let look =
        "print joint_goals\nprint odom\nmodule gait\nmodule falls\nmodule mux\nmodule hardware\nmark\n";
    for cycle in random().map(|number| 200 + number % 4000).take(cycles) {
        let _ = write!(lines, "mark\ngo #{cycle}\n{look}");
        let _ = write!(lines, "go #{}\nstep 7\nmark\nstep\n{look}", cycle - 8);
        let _ = write!(lines, "go #{}\nback 11\nmark\nback\n{look}", cycle + 12);
    }
    let printed = debugged(WALKER, WALK, &lines);
    assert!(looks_of(&printed, cycles).iter().all(|look| look.contains("Gait {")), "{printed}");
}

#[test]
fn a_condition_is_met_in_the_same_cycle_whichever_launcher_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let lines = "until norm(imu_data_raw.angular_velocity) > 0.2\ngo end\n\
                 back until norm(imu_data_raw.angular_velocity) > 0.2\n";
    let stops = ["linear", "pool", "threads"].map(|launcher| {
        let [robot, bag] = ["toml", "bag"].map(|end| folder.path().join(format!("{launcher}.{end}")));
        let [robot, bag] = [&robot, &bag].map(|path| path.to_str().unwrap());
        let text = fs::read_to_string(WALKER).unwrap();
        fs::write(robot, format!("{text}\n[launcher]\nkind = \"{launcher}\"\n")).unwrap();
        text_of(&["run", robot, "--fast", "--duration", "4s", "--record", bag]);
        let printed = debugged(WALKER, bag, lines);
        assert!(printed.contains("no difference from the bag"), "{launcher}: {printed}");
        let cycles: Vec<_> = printed.lines().filter(|line| line.starts_with("cycle #")).collect();
        assert_eq!(cycles.len(), 4, "{launcher}: {printed}");
        cycles.join("\n")
    });
    assert!(stops.iter().all(|others| *others == stops[0]), "{stops:#?}");
}

/// A match with a camera, whose pictures are looked at as well.
#[test]
fn a_cycle_of_a_match_is_the_same_from_before_and_from_behind() {
    let cycles = std::env::var("DOWNBEAT_DEBUG_CYCLES").map_or(12, |cycles| cycles.parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let robot = "robots/seeing_match.toml";
    text_of(&["match", robot, "--fast", "--duration", "4s", "--record", bag.to_str().unwrap()]);
    let last = debugged(robot, bag.to_str().unwrap(), "go end\n");
    let last = last.lines().rev().find_map(|line| line.strip_prefix("cycle #")).unwrap();
    let last: u64 = last.split(',').next().unwrap().parse().unwrap();
    let look = "print blue_2/camera/image_raw\nprint blue_2/pose\nprint blue_2/joint_goals\nmodule blue_2/player\n\
                module blue_2/localisation\nmodule blue_2/gait\nmark\n";
    let mut lines = String::new();
    for cycle in random().map(|number| 100 + number % (last - 200)).take(cycles) {
        let _ = write!(lines, "mark\ngo #{cycle}\n{look}");
        let _ = write!(lines, "go #{}\nstep 7\nmark\nstep\n{look}", cycle - 8);
        let _ = write!(lines, "go #{}\nback 11\nmark\nback\n{look}", cycle + 12);
    }
    let printed = debugged(robot, bag.to_str().unwrap(), &lines);
    let looks: Vec<_> = looks_of(&printed, cycles);
    assert!(
        // The checksum is that of the whole picture.
        looks.iter().any(|look| look.contains("sensor_msgs/msg/Image") && look.contains("CRC-32 "))
            && looks.iter().any(|look| look.contains("\"play")),
        "{printed}"
    );
}

#[test]
fn it_goes_to_times_messages_runs_and_conditions_and_says_why() {
    let lines = "go 4s\nnext falls\nlast falls\ngo robot_state#5\nwhy robot_state\n\
                 back until robot_state.data == 'upright'\nuntil robot_state.data == 'falling'\ngo end\nstep\n";
    let printed = debugged(WALKER, WALK, lines);
    let cycles: Vec<&str> = printed.lines().filter_map(|line| line.strip_prefix("cycle #")).collect();
    let [_, at_four, next, last, fall, upright, falls, ..] = cycles[..] else { panic!("{printed}") };
    assert!(at_four.contains(", 4.0"), "{at_four}");
    let number = |line: &str| line.split(',').next().unwrap().parse::<u64>().unwrap();
    assert!(number(next) > number(at_four) && number(last) < number(next), "{printed}");
    assert!(number(upright) < number(fall) && fall == falls, "{printed}");
    let chain = printed.split_once("robot_state #5 in cycle").unwrap().1;
    let order = [
        "published by falls",
        "published by imu_filter",
        "published by hardware (timer)",
        "it knew joint_goals",
    ];
    let places: Vec<_> = order.iter().map(|part| chain.find(part).unwrap()).collect();
    assert!(places.is_sorted(), "{chain}");
    assert!(printed.contains("the bag ends 0 cycles from here"), "{printed}");
}

#[test]
fn it_prints_what_the_page_shows() {
    let page = fs::read_to_string("docs/time_travel.md").unwrap();
    let session = page.split_once(&format!("$ downbeat bag debug {WALKER} {WALK}\n")).unwrap().1;
    let session = session.split_once("```").unwrap().0;
    let (typed, shown): (Vec<_>, Vec<_>) = session.lines().partition(|line| line.starts_with("> "));
    let lines: Vec<_> = typed.iter().map(|line| line.trim_start_matches("> ")).collect();
    let printed = debugged(WALKER, WALK, &(lines.join("\n") + "\n"));
    let mut rest = &printed[..];
    for line in shown.into_iter().filter(|line| line.trim() != "…") {
        let after = rest.split_once(line).map(|(_, after)| after);
        rest = after.unwrap_or_else(|| panic!("{line:?} is not printed there:\n{printed}"));
    }
}

#[test]
fn what_is_wrong_is_said_and_the_debugger_goes_on() {
    let lines = "fly\ngo joint_goals#100000\nprint joint_goal\nmodule simulator\nnext gai\nuntil walking < 1\n\
                 until robot_state.date == 'x'\nuntil robot_state.data == 'asleep'\nback\ngo #99999\ngo difference\nstep\n";
    let printed = debugged(WALKER, WALK, lines);
    for sentence in [
        "unknown command \"fly\"",
        " messages, counted from 0",
        "there is no module or topic \"joint_goal\", did you mean \"joint_goals\"?",
        "simulator: it drives a device",
        "there is no module or topic \"gai\", did you mean \"gait\"?",
        "has no field \"date\", did you mean \"data\"?",
        "robot_state.data == 'asleep' does not become true after this cycle",
        "the bag begins 0 cycles before this one",
        "the bag has the cycles #0 to #",
        "the replay does not differ from the bag",
        "cycle #1,",
    ] {
        assert!(printed.contains(sentence), "{sentence}\n{printed}");
    }
    let missing = output_of(&["bag", "debug", "missing.toml", WALK]);
    assert!(String::from_utf8_lossy(&missing.stderr).contains("missing.toml"));
}

#[test]
fn what_differs_from_the_recorded_robot_is_noted_and_the_rest_is_shown() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = talker(folder.path());
    let bag = bag.to_str().unwrap();
    let text = fs::read_to_string(&robot).unwrap();
    let changed = |name: &str, text: String| {
        let file = folder.path().join(name);
        fs::write(&file, text).unwrap();
        file.to_str().unwrap().to_owned()
    };
    // Another version of the robot: a module has another name, one is new.
    let renamed = changed("renamed.toml", text.replace("\"mouth\"", "\"voice\""));
    let printed = debugged(&renamed, bag, "notes\ngo 1s\nmodule voice\nmodule mouth\nprint said\n");
    for sentence in [
        "the recorded robot had a module \"mouth\", which the robot file lacks",
        "\"talks\"",
        "there is no module or topic \"mouth\"",
        "data: tick ",
    ] {
        assert!(printed.contains(sentence), "{sentence}\n{printed}");
    }
    let more = text.replace("[record]", "[[module]]\nname = \"gait\"\nkind = \"gait\"\n[record]");
    let more_settings = changed("more.toml", more);
    let printed = debugged(&more_settings, bag, "notes\ngo 1s\nmodule mouth\n");
    assert!(
        printed.contains("the recorded robot had no module \"gait\"") && printed.contains("\"talks\""),
        "{printed}"
    );

    // A bag without cycles and journals, only with messages.
    let parts = folder.path().join("parts");
    let parts = parts.to_str().unwrap();
    text_of(&["bag", "cut", bag, "-o", parts, "--topics", "/said"]);
    let printed = debugged(robot.to_str().unwrap(), parts, "notes\nlist\ngo end\nprint said\nback\n");
    assert!(printed.contains("the bag lacks") && printed.contains("data: tick "), "{printed}");

    // A bag that says nothing of its robot.
    let plain = folder.path().join("plain");
    let writer = WriterOptions::new().create(&plain).unwrap();
    let recorded = [Reader::open(bag).unwrap()];
    Copy::of(&recorded, |_| true).unwrap().into_writer(writer, |_| ()).unwrap();
    let printed = debugged(&more_settings, plain.to_str().unwrap(), "notes\ngo 1s\nprint said\n");
    for sentence in ["does not say with which settings its robot ran", "data: tick "] {
        assert!(printed.contains(sentence), "{sentence}\n{printed}");
    }

    // An expression that cannot be evaluated at some message says so and stays there.
    let lines = "until said.data.x == 1\nstep\nuntil said.data > 3\nuntil 1/0 > 2\n";
    let printed = debugged(robot.to_str().unwrap(), bag, lines);
    for sentence in
        ["`said.data.x == 1`: Unknown property 'x'", "cycle #", "it names no topic", "does not become true"]
    {
        assert!(printed.contains(sentence), "{sentence}\n{printed}");
    }
}

#[test]
fn a_replay_with_a_change_says_where_the_runs_part() {
    let folder = tempfile::tempdir().unwrap();
    let report = folder.path().join("report");
    let line =
        ["bag", "replay", WALKER, WALK, "--with", "gait.period=0.62", "--report", report.to_str().unwrap()];
    let printed = text_of(&line);
    assert!(
        printed.contains("they part 2.0") && printed.contains("from gait: in /gait/joint_commands"),
        "{printed}"
    );
    let text = fs::read_to_string(report.join("report.md")).unwrap();
    assert!(text.starts_with("# What if: gait.period=0.62\n"), "{text}");
    let pictures: Vec<&str> = text.lines().filter(|line| line.starts_with("![/")).collect();
    assert!(!pictures.is_empty(), "{text}");
    for picture in pictures {
        let file = picture.rsplit_once('(').unwrap().1.trim_end_matches(')');
        let svg = fs::read_to_string(report.join(file)).unwrap();
        assert!(svg.contains("without") && svg.contains("<svg"), "{file}");
    }
    // The bag of the run with the change is a bag.
    assert!(text_of(&["bag", "check", report.join("after").to_str().unwrap()]).contains("0 problems"));
    open_with_stock_readers(&report.join("after"));

    let same = text_of(&["bag", "replay", WALKER, WALK, "--with", "gait.period=0.6"]);
    assert!(same.contains("the two runs are the same"), "{same}");
    for (change, problem) in [
        ("gait", "expected module.setting=value"),
        ("gate.period=1", "did you mean \"gait\"?"),
        ("perriod=1", "no module is named \"perriod\" or has such a setting"),
        ("gait=other.so", "\"gait\" is compiled into the program"),
        ("robot=missing.toml", "missing.toml"),
    ] {
        let output = output_of(&["bag", "replay", WALKER, WALK, "--with", change]);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && said.contains(problem), "{change}: {said}");
    }
}

const CHART: &str = r#"<scxml xmlns="http://www.w3.org/2005/07/scxml" xmlns:downbeat="urn:downbeat:state_machine" version="1.0">
    <downbeat:publish topic="said" type="std_msgs/msg/String"/>
    <downbeat:every period="100ms" event="tick"/>
    <datamodel><data id="count" expr="0"/></datamodel>
    <state id="talks">
        <transition event="tick">
            <assign location="count" expr="count + 1"/>
            <send target="said"><content expr="'tick ' + count"/></send>
        </transition>
    </state>
</scxml>
"#;

/// A robot that talks, and a recorded run of it.
fn talker(folder: &Path) -> (PathBuf, PathBuf) {
    let (robot, bag) = (folder.join("talker.toml"), folder.join("bag"));
    let file = "[robot]\nname = \"talker\"\n[[module]]\nname = \"mouth\"\nkind = \"state_machine\"\nfile = \"mouth.scxml\"\n[record]\ntopics = \"all\"\n";
    fs::write(&robot, file).unwrap();
    fs::write(folder.join("mouth.scxml"), CHART).unwrap();
    let line =
        ["run", robot.to_str().unwrap(), "--fast", "--duration", "2s", "--record", bag.to_str().unwrap()];
    text_of(&line);
    open_with_stock_readers(&bag);
    (robot, bag)
}

#[test]
fn a_chart_shows_its_states_and_another_version_of_it_is_tried() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = talker(folder.path());
    let [robot, bag] = [&robot, &bag].map(|path| path.to_str().unwrap());
    let printed = debugged(robot, bag, "go 1.05s\nmodule mouth\n");
    assert!(printed.contains("\"talks\"") && printed.contains("\"count\""), "{printed}");
    let other = folder.path().join("other.scxml");
    fs::write(&other, CHART.replace("'tick '", "'tock '")).unwrap();
    let printed = text_of(&["bag", "replay", robot, bag, "--with", &format!("mouth={}", other.display())]);
    let parting = "they part 0.000000 s into the bag, in cycle #0 from mouth: in /mouth/dot #0";
    assert!(printed.contains(parting), "{printed}");
    assert!(printed.lines().any(|line| line.split_whitespace().eq(["/said", "20", "20", "+0"])), "{printed}");
}

const STARTER: &str = r#"<scxml xmlns="http://www.w3.org/2005/07/scxml" xmlns:downbeat="urn:downbeat:state_machine" version="1.0">
    <downbeat:service name="gait/start" type="std_srvs/srv/Trigger"/>
    <downbeat:publish topic="said" type="std_msgs/msg/String"/>
    <downbeat:every period="500ms" event="tick"/>
    <state id="waits">
        <transition event="tick"><send target="start"/></transition>
        <transition event="done.call.start"><send target="said"><content expr="'started'"/></send></transition>
    </state>
</scxml>
"#;

#[test]
fn why_follows_the_answer_of_a_service_to_its_request() {
    let folder = tempfile::tempdir().unwrap();
    let [robot, bag] = ["robot.toml", "bag"].map(|name| folder.path().join(name));
    let file = "[robot]\nname = \"starter\"\n[[module]]\nname = \"mouth\"\nkind = \"state_machine\"\nfile = \"mouth.scxml\"\n\
                [[module]]\nname = \"gait\"\nkind = \"gait\"\n[record]\ntopics = \"all\"\n";
    fs::write(&robot, file).unwrap();
    fs::write(folder.path().join("mouth.scxml"), STARTER).unwrap();
    let [robot, bag] = [&robot, &bag].map(|path| path.to_str().unwrap());
    text_of(&["run", robot, "--fast", "--duration", "2s", "--record", bag]);
    let printed = debugged(robot, bag, "go said#1\nwhy said\n");
    let chain = printed.split_once("said #1 in cycle #").unwrap_or_else(|| panic!("{printed}")).1;
    let steps: Vec<_> = chain.lines().take(3).collect();
    for (step, parts) in steps.iter().zip([
        [": published by mouth", ""],
        ["  gait answers mouth about gait/start: ", "made by gait"],
        ["    mouth asks gait for gait/start: ", "made by mouth"],
    ]) {
        assert!(parts.iter().all(|part| step.contains(part)), "{step}\n{printed}");
    }
    // Each one cycle earlier.
    let cycle = |line: &str| -> u64 {
        let number = line.rsplit_once('#').map_or(line, |(_, number)| number);
        number[..number.find([',', ':']).unwrap()].parse().unwrap()
    };
    let cycles: Vec<_> = steps.iter().map(|line| cycle(line)).collect();
    assert_eq!(cycles, [cycles[0], cycles[0] - 1, cycles[0] - 2], "{printed}");
}

const PLANTER: &str = r#"<scxml xmlns="http://www.w3.org/2005/07/scxml" xmlns:downbeat="urn:downbeat:state_machine" version="1.0">
    <downbeat:publish topic="simple" type="my_idl/msg/Simple"/>
    <downbeat:every period="100ms" event="tick"/>
    <datamodel><data id="count" expr="0"/></datamodel>
    <state id="plants">
        <transition event="tick">
            <assign location="count" expr="count + 1"/>
            <send target="simple"><param name="a" expr="count"/><param name="b" expr="count / 2.0"/></send>
        </transition>
    </state>
</scxml>
"#;

const WEIGHER: &str = r#"<scxml xmlns="http://www.w3.org/2005/07/scxml" xmlns:downbeat="urn:downbeat:state_machine" version="1.0">
    <downbeat:subscribe topic="simple" type="my_idl/msg/Simple" event="planted"/>
    <downbeat:publish topic="weight" type="my_idl/msg/Simple"/>
    <state id="weighs">
        <transition event="planted">
            <send target="weight"><param name="b" expr="_event.data.b * 10"/></send>
        </transition>
    </state>
</scxml>
"#;

/// Copies a bag. The schema of its topics of type `my_idl/msg/Simple` is IDL, as `mcap` and others write it.
fn in_idl(bag: &Path, into: &Path) {
    let reader = Reader::open(bag).unwrap();
    let mut options = WriterOptions::new();
    for (key, value) in &reader.metadata().unwrap().custom_data {
        options = options.custom_data(key, value);
    }
    let mut writer = options.create(into).unwrap();
    let name = "my_idl/msg/Simple";
    let text = format!("{}\nIDL: {name}\n{}", "=".repeat(80), include_str!("../data/my_idl/msg/Simple.idl"));
    for topic in reader.topics() {
        let mut info = topic.info.clone();
        if info.type_name == name {
            let schema =
                Schema { name: name.to_owned(), encoding: "ros2idl".to_owned(), data: text.clone().into() };
            info.format = Some(MessageFormat { message_encoding: "cdr".to_owned(), schema });
        }
        writer.add_topic(info).unwrap();
    }
    for message in reader.messages(Selection::all()).unwrap().map(Result::unwrap) {
        writer.write(message.topic, message.log_time, message.publish_time, &message.data).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn a_robot_whose_types_are_defined_in_idl_is_explained_measured_walked_through_and_replayed() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::create_dir_all(folder.join("my_idl/msg")).unwrap();
    fs::copy("tests/data/my_idl/msg/Simple.idl", folder.join("my_idl/msg/Simple.idl")).unwrap();
    let module = |name: &str| {
        format!("[[module]]\nname = \"{name}\"\nkind = \"state_machine\"\nfile = \"{name}.scxml\"\n")
    };
    let file = format!(
        "[robot]\nname = \"garden\"\ninterfaces = [\"my_idl\"]\n{}{}[record]\ntopics = \"all\"\n",
        module("planter"),
        module("weigher")
    );
    for (name, text) in [("robot.toml", &*file), ("planter.scxml", PLANTER), ("weigher.scxml", WEIGHER)] {
        fs::write(folder.join(name), text).unwrap();
    }
    let [robot, bag, copy] = ["robot.toml", "bag", "copy"].map(|name| folder.join(name));
    let [robot_text, bag_text] = [&robot, &bag].map(|path| path.to_str().unwrap());
    text_of(&["run", robot_text, "--fast", "--duration", "2s", "--record", bag_text]);
    open_with_stock_readers(&bag);
    in_idl(&bag, &copy);
    for bag in [&bag, &copy].map(|path| path.to_str().unwrap()) {
        let why = text_of(&["bag", "why", bag, "weight#5"]);
        assert!(why.contains("weigher in cycle") && why.contains("/simple#5"), "{why}");
        let latency = text_of(&["bag", "latency", bag, "--from", "simple", "--to", "weight"]);
        assert!(latency.contains("20 messages on /weight, 0 of which come from none"), "{latency}");
        let lines = "go 1.05s\nprint simple\nuntil weight.b > 70\nprint weight\nwhy weight\n";
        let printed = debugged(robot_text, bag, lines);
        for sentence in ["a: 10\nb: 5.0", "b: 75.0", "earlier: published by planter (timer)"] {
            assert!(printed.contains(sentence), "{sentence}\n{printed}");
        }
        let report = output_of(&["bag", "replay", robot_text, bag, "--json"]).stdout;
        let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
        assert_eq!(report["different"], 0, "{report}");
        let compared = |name: &str| {
            report["topics"].as_array().unwrap().iter().find(|of| of["topic"] == name).unwrap()["compared"]
                .clone()
        };
        // The last ones are of the cycle in which the robot stopped.
        assert_eq!([compared("/simple"), compared("/weight")], [19, 19]);
    }
    // Definitions of another meaning are other types.
    let idl = fs::read_to_string(folder.join("my_idl/msg/Simple.idl")).unwrap();
    fs::write(folder.join("my_idl/msg/Simple.idl"), idl.replace("int32", "int64")).unwrap();
    let output = output_of(&["bag", "replay", robot_text, copy.to_str().unwrap()]);
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("with another definition of my_idl/msg/Simple than the registered one"), "{said}");
}

/// The module of docs/libraries.md for the debugger.
fn smoother() -> String {
    let page = include_str!("../../docs/libraries.md");
    let mut blocks = page.split("```cpp\n").skip(1).map(|rest| rest.split("```").next().unwrap());
    let class = blocks.find(|block| block.contains("class Smoother")).unwrap();
    format!("{CPP}{class}DOWNBEAT_MODULE(Smoother)\n")
}

const CPP: &str =
    "#include \"downbeat.hpp\"\n#include \"std_msgs/msg/float64.hpp\"\nusing std_msgs::msg::Float64;\n";

const SOURCE: &str = r#"
class Source : public downbeat::Module {
    void setup() override {
        auto out = publish<Float64>("in");
        every(std::chrono::milliseconds(100), [out] { out({1.0}); });
    }
};
DOWNBEAT_MODULE(Source)
"#;

/// Compiles C++ to `libNAME.so` in the folder; `None` without a compiler.
fn compile(folder: &Path, sources: &[(&str, String)]) -> Option<()> {
    if !test_machine::has_compilers(&["c++"]) {
        return None;
    }
    let run = |command: &mut Command| {
        let output = command.current_dir(folder).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    run(&mut downbeat(&["interface", "generate", "--lang", "cpp", "std_msgs/msg/Float64"]));
    for (name, source) in sources {
        fs::write(folder.join(format!("{name}.cpp")), source).unwrap();
        let mut compiler = Command::new("c++");
        compiler.args(["-std=c++17", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-Iinclude"]);
        run(compiler.args([&format!("{name}.cpp"), "-o", &format!("lib{name}.so")]));
    }
    Some(())
}

/// The robot file of a source and a smoother, with further keys of both.
fn smooth_robot(keys: &str) -> String {
    let module = |name: &str| {
        format!("[[module]]\nname = \"{name}\"\nkind = \"library\"\npath = \"lib{name}.so\"\n{keys}")
    };
    let (source, smoother) = (module("source"), module("smoother"));
    format!("[robot]\nname = \"smooth\"\n{source}{smoother}[record]\ntopics = \"all\"\n")
}

#[test]
fn a_module_in_cpp_shows_its_variables_at_any_cycle() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let sources = [("source", format!("{CPP}{SOURCE}")), ("smoother", smoother())];
    let Some(()) = compile(folder, &sources) else { return };
    for keys in ["", "isolate = true\n"] {
        fs::write(folder.join("robot.toml"), smooth_robot(keys)).unwrap();
        let bag = folder.join(format!("bag{}", keys.len()));
        let [robot, bag] = [folder.join("robot.toml"), bag].map(|path| path.to_str().unwrap().to_owned());
        text_of(&["run", &robot, "--fast", "--duration", "1s", "--record", &bag]);
        let lines = "go in#3\nnext smoother\nmodule smoother\ngo in#0\nnext smoother\nmodule smoother\nmodule source\n";
        let printed = debugged(&robot, &bag, lines);
        let (late, early) = printed.split_once("count: 4,\n}\n").unwrap_or_else(|| panic!("{printed}"));
        assert!(late.ends_with("Smoother {\n    last: 0.9375,\n    "), "{late}");
        assert!(early.contains("Smoother {\n    last: 0.5,\n    count: 1,\n}\n"), "{early}");
        assert!(early.contains("it shows nothing of itself: `debug` of the trait Module does"), "{early}");
    }
}

#[test]
fn another_version_of_a_library_is_tried() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let other =
        smoother().replace("0.5 * (last_ + message.data)", "count_ < 3 ? 0.5 * (last_ + message.data) : 0.0");
    let same = smoother().replace("0.5 * (last_", "(1.0 / 2) * (last_");
    let source = format!("{CPP}{SOURCE}");
    let sources = [("source", source), ("smoother", smoother()), ("other", other), ("same", same)];
    let Some(()) = compile(folder, &sources) else { return };
    let with = |library: &str| format!("smoother={}", folder.join(library).display());
    let in_cycle = smooth_robot("");
    let path = "path = \"libsmoother.so\"\n";
    let detached = in_cycle.replace(path, &format!("{path}synchrony = \"detached\"\n"));
    for (number, file) in [in_cycle, detached].into_iter().enumerate() {
        fs::write(folder.join("robot.toml"), file).unwrap();
        let [robot, bag] = [folder.join("robot.toml"), folder.join(format!("bag{number}"))];
        let [robot, bag] = [robot, bag].map(|path| path.to_str().unwrap().to_owned());
        text_of(&["run", &robot, "--fast", "--duration", "1s", "--record", &bag]);
        let printed = text_of(&["bag", "replay", &robot, &bag, "--with", &with("libother.so")]);
        // After three numbers it has 0.875, so the fourth differs.
        let parting = "from smoother: in /out #3, data is 0.0, and 0.9375 without the change";
        assert!(printed.contains(parting), "{printed}");
        let printed = text_of(&["bag", "replay", &robot, &bag, "--with", &with("libsame.so")]);
        assert!(printed.contains("the two runs are the same"), "{printed}");
        let refused = output_of(&["bag", "replay", &robot, &bag, "--with", &with("missing.so")]);
        let said = String::from_utf8_lossy(&refused.stderr);
        assert!(!refused.status.success() && said.contains("missing.so"), "{said}");
    }
}

#[test]
fn it_goes_to_the_first_difference() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = talker(folder.path());
    // Not the picture of the chart, which shows what is changed in it.
    let text = fs::read_to_string(&robot).unwrap() + "[replay]\nexcept = [\"mouth/dot\"]\n";
    fs::write(&robot, text).unwrap();
    let late = CHART.replace("'tick ' + count", "if count > 5 { 'tock ' + count } else { 'tick ' + count }");
    fs::write(folder.path().join("mouth.scxml"), late.replace("> 5", "&gt; 5")).unwrap();
    let [robot, bag] = [&robot, &bag].map(|path| path.to_str().unwrap());
    let printed = debugged(robot, bag, "go end\ngo difference\nprint said\nback\nprint said\ngo said#5\n");
    assert!(
        printed.contains("first difference: ") && printed.contains("`go difference` goes there"),
        "{printed}"
    );
    let (_, after) = printed.split_once("data: tock 6").unwrap_or_else(|| panic!("{printed}"));
    assert!(after.contains("data: tick 5"), "{printed}");
    let cycles: Vec<_> = printed.lines().filter(|line| line.starts_with("cycle #")).collect();
    let [_, _, difference, before, message] = cycles[..] else { panic!("{printed}") };
    assert!(difference == message && difference != before, "{printed}");
    assert!(after.contains("differs from the bag since"), "{printed}");
}
