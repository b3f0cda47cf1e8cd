//! `downbeat match`, on the command line.
#![cfg(feature = "football")]
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::{downbeat, open_with_stock_readers, text_of};
use downbeat::bags::{Reader, Selection};
use downbeat::msgs::cdr;
use downbeat::msgs::geometry_msgs::msg::PoseWithCovarianceStamped;
use downbeat::msgs::nav_msgs::msg::Odometry;
use downbeat_football::football_interfaces::msg::TeamMessage;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::path::Path;
use test_machine::free_domain;

/// Plays a part of the match and returns its output.
fn play(bag: &Path, more: &[&str]) -> String {
    play_file("robots/match.toml", "3s", bag, more)
}

/// As `play`, for another file and duration. Nobody stands before the half, so that a short match has steps.
fn play_file(file: &str, duration: &str, bag: &Path, more: &[&str]) -> String {
    let line = ["match", file, "--fast", "--duration", duration, "-p", "match.initial_s:=0", "--record"];
    let mut command = downbeat(&line);
    let output = command.arg(bag).args(more).current_dir(env!("CARGO_MANIFEST_DIR")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// True if two bags have the same messages, except for the diagnostics of the process.
fn are_same(one: &Path, other: &Path) -> bool {
    let diff = ["bag", "diff", "--ignore", "diagnostics", one.to_str().unwrap(), other.to_str().unwrap()];
    downbeat(&diff).output().unwrap().status.success()
}

/// The SHA-256 of each picture in a bag.
fn pictures(bag: &Path) -> Vec<String> {
    let reader = Reader::open(bag).unwrap();
    let topic = reader.topic("/blue_2/camera/image_raw").unwrap();
    let messages = reader.messages(Selection::all().topics([topic])).unwrap();
    let hash = |data: &[u8]| Sha256::digest(data).iter().map(|byte| format!("{byte:02x}")).collect();
    messages.map(|message| hash(&message.unwrap().data)).collect()
}

#[test]
fn a_match_is_played_recorded_and_replayed_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let bags = ["first", "second", "other"].map(|name| folder.path().join(name));
    let printed = play(&bags[0], &[]);
    assert!(printed.contains("0.0 s  0:0  ready") && printed.contains("blue 0:0 red after 3 s"), "{printed}");
    play(&bags[1], &[]);
    play(&bags[2], &["-p", "match.seed:=2"]);
    assert!(are_same(&bags[0], &bags[1]) && !are_same(&bags[0], &bags[2]));
    open_with_stock_readers(&bags[0]);
    for launcher in ["linear", "pool:2"] {
        let bag = bags[0].to_str().unwrap();
        let replay = text_of(&["bag", "replay", "robots/match.toml", bag, "--launcher", launcher]);
        for topic in ["/blue_1/joint_goals", "/red_2/player/state", "/red_1/pose"] {
            assert!(replay.contains(topic), "{topic}: {replay}");
        }
    }
}

#[test]
fn a_match_runs_again_with_world_referee_and_camera_picture_for_picture() {
    let folder = tempfile::tempdir().unwrap();
    let robots = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/");
    let text = std::fs::read_to_string(format!("{robots}seeing_match.toml")).unwrap();
    let text = text.replace("\"football/", &format!("\"{robots}football/"));
    let of_launcher = |name: &str, launcher: &str| {
        let file = folder.path().join(name);
        let changed = text.replace("kind = \"pool\"\nthreads = 2\n", launcher);
        assert_eq!(changed.contains("threads"), launcher.contains("threads"), "{changed}");
        std::fs::write(&file, changed).unwrap();
        file.to_str().unwrap().to_owned()
    };
    let files = [
        of_launcher("linear.toml", "kind = \"linear\"\n"),
        of_launcher("pool.toml", "kind = \"pool\"\nthreads = 2\n"),
    ];
    let bags = ["linear", "pool", "other"].map(|name| folder.path().join(name));
    play_file(&files[0], "2s", &bags[0], &[]);
    play_file(&files[1], "2s", &bags[1], &[]);
    play_file(&files[1], "2s", &bags[2], &["-p", "match.seed:=2"]);
    let seen = bags.each_ref().map(|bag| pictures(bag));
    assert!(seen[0].len() > 15, "{seen:?}");
    assert_eq!(seen[0], seen[1]);
    assert_ne!(seen[0], seen[2]);
    assert!(are_same(&bags[0], &bags[1]) && !are_same(&bags[0], &bags[2]));
    open_with_stock_readers(&bags[0]);

    let replay = |bag: &Path, launcher: &str, more: &[&str]| {
        let line =
            ["bag", "replay", &files[0], bag.to_str().unwrap(), "--simulators", "--json", "--launcher"];
        let output = downbeat(&line).arg(launcher).args(more).output().unwrap();
        let printed = String::from_utf8_lossy(&output.stderr).into_owned();
        let report: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{printed}"));
        (output.status.success(), report)
    };
    for (bag, launcher) in
        [(&bags[0], "linear"), (&bags[0], "pool:2"), (&bags[1], "linear"), (&bags[1], "pool:2")]
    {
        let (is_same, report) = replay(bag, launcher, &["--strict"]);
        assert!(is_same && report["left_out"] == json!([]), "{launcher}: {report}");
        let compared = |topic: &str| {
            let topics = report["topics"].as_array().unwrap();
            topics.iter().find(|known| known["topic"] == topic).unwrap()["compared"].as_u64().unwrap()
        };
        assert!(compared("/blue_2/camera/image_raw") > 15, "{report}");
        assert!(compared("/match/state") > 15 && compared("/blue_2/bus/exchanges") > 200, "{report}");
    }
    let (is_same, report) = replay(&bags[0], "linear", &["-p", "match.seed:=2"]);
    assert!(!is_same && report["different"].as_u64().unwrap() > 0, "{report}");
}

#[test]
fn a_player_that_sees_is_replayed_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    play_file("robots/seeing_match.toml", "4s", &bag, &[]);
    let bag_name = bag.to_str().unwrap();
    for launcher in ["linear", "pool:2"] {
        let replay =
            text_of(&["bag", "replay", "robots/seeing_match.toml", bag_name, "--launcher", launcher]);
        for topic in ["/blue_2/vision/markings", "/blue_2/vision/annotated", "/blue_2/pose"] {
            assert!(replay.contains(topic), "{topic}: {replay}");
        }
    }
    // The player is localised, and stands still until play begins.
    let reader = Reader::open(&bag).unwrap();
    let topic = reader.topic("/blue_2/pose").unwrap();
    let last = reader.messages(Selection::all().topics([topic])).unwrap().last().unwrap().unwrap();
    let pose: PoseWithCovarianceStamped = cdr::from_slice(&last.data).unwrap();
    let at = pose.pose.pose.position;
    assert!((at.x + 0.9).abs() < 0.2 && at.y.abs() < 0.2, "{at:?}");

    // A picture of the bag is used to learn the colour of the carpet.
    let marks = folder.path().join("marks.toml");
    let text = "[[picture]]\nbag = \"bag\"\ntopic = \"blue_2/camera/image_raw\"\nat = 1.0\ngreen = [[160, 200, 6]]\n";
    std::fs::write(&marks, text).unwrap();
    let learned = folder.path().join("colours.toml");
    text_of(&["vision", "calibrate", marks.to_str().unwrap(), "-o", learned.to_str().unwrap()]);
    let colours = downbeat_vision::Colours::read(&learned).unwrap();
    assert_ne!(colours.green, downbeat_vision::Colours::default().green);
    assert_eq!(colours.white, downbeat_vision::Colours::default().white);
}

/// A robot with vision in a world without a referee; its pictures come from a job of the simulator.
const EYES: &str = r#"
[robot]
name = "eyes"
[[module]]
name = "simulator"
kind = "darwin_op_simulator"
settings = { link = "memory:eyes", world = "ROBOTS/worlds/field.toml", camera_hz = 10.0 }
[[module]]
name = "hardware"
kind = "darwin_op"
settings = { port = "memory:eyes" }
remap = { joint_commands = "motion/joint_commands" }
[[module]]
name = "motion"
kind = "stand_nod_wave"
[[module]]
name = "robot_state_publisher"
kind = "robot_state_publisher"
settings = { robot_description = "ROBOTS/darwin_op.urdf", publish_frequency = 50.0 }
[[module]]
name = "vision"
kind = "vision"
[expose]
diagnostics = false
"#;

#[test]
fn vision_is_replayed_bit_for_bit_on_the_pictures_of_a_simulator_that_is_left_out() {
    let domain = free_domain().to_string();
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = (folder.path().join("robot.toml"), folder.path().join("bag"));
    let text = EYES.replace("ROBOTS", concat!(env!("CARGO_MANIFEST_DIR"), "/robots"));
    std::fs::write(&robot, text).unwrap();
    let (robot, bag) = (robot.to_str().unwrap(), bag.to_str().unwrap());
    let run = ["run", robot, "--fast", "--duration", "2s", "--domain", &domain, "--record", bag];
    let output = downbeat(&run).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    for launcher in ["linear", "pool:2"] {
        let replay = text_of(&["bag", "replay", robot, bag, "--launcher", launcher]);
        assert!(replay.contains("not simulator") && replay.contains("/vision/markings"), "{replay}");
    }
}

#[test]
fn teams_that_see_are_replayed_bit_for_bit() {
    let domain = free_domain().to_string();
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let line =
        ["match", "robots/seeing_teams.toml", "--fast", "--duration", "3s", "--domain", &domain, "--record"];
    let output = downbeat(&line).arg(&bag).current_dir(env!("CARGO_MANIFEST_DIR")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let bag_name = bag.to_str().unwrap();
    for launcher in ["linear", "pool:2"] {
        let replay =
            text_of(&["bag", "replay", "robots/seeing_teams.toml", bag_name, "--launcher", launcher]);
        for topic in ["/blue_1/vision/robots", "/blue_2/robots", "/red_1/team/robots", "/red_2/team_status"] {
            assert!(replay.contains(topic), "{topic}: {replay}");
        }
    }
    // Each player receives the messages of its mate, under the mate's number.
    let reader = downbeat::bags::Reader::open(&bag).unwrap();
    for (name, mate) in [("blue_1", 2), ("blue_2", 1), ("red_1", 2), ("red_2", 1)] {
        let topic = reader.topic(&format!("/{name}/team_messages")).unwrap();
        let messages = reader.messages(Selection::all().topics([topic])).unwrap();
        let players: Vec<u8> = messages
            .map(|message| cdr::from_slice::<TeamMessage>(&message.unwrap().data).unwrap().player)
            .collect();
        assert!(players.len() > 8 && players.iter().all(|player| *player == mate), "{name}: {players:?}");
    }
}

#[test]
fn colours_are_learned_from_the_marks_of_the_page() {
    let folder = tempfile::tempdir().unwrap();
    let page = include_str!("../docs/vision.md");
    let start = page.find("# marks.toml").unwrap();
    let marks = &page[start..start + page[start..].find("```").unwrap()];
    const FRAME: &str = "modules/football/vision/tests/data/darwin_op_frame.png";
    let frame = Path::new(env!("CARGO_MANIFEST_DIR")).join(FRAME);
    std::fs::copy(frame, folder.path().join("darwin_op_frame.png")).unwrap();
    let calibrate = |marks: &str, more: &[&str]| {
        std::fs::write(folder.path().join("marks.toml"), marks).unwrap();
        let mut command = downbeat(&["vision", "calibrate", "marks.toml", "--output", "colours.toml"]);
        command.args(more).current_dir(folder.path()).output().unwrap()
    };
    let output = calibrate(marks, &["--pictures", "seen"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let colours = downbeat_vision::Colours::read(&folder.path().join("colours.toml")).unwrap();
    // The colours of the carpet and of the ball.
    assert_eq!(colours.class_of([20, 140, 80]), downbeat_vision::Class::Green);
    assert!(std::fs::read(folder.path().join("seen/classes_1.png")).unwrap().starts_with(b"\x89PNG"));
    for (changed, problem) in [
        (marks.to_owned(), "exists already"),
        (marks.replace("[338, 160, 6]", "[900, 160, 6]"), "picture 1: orange at [900, 160, 6]"),
        (marks.replace("[338, 160, 6]", "[320, 300, 6]"), "same hue"),
        (marks.replace("orange", "pink"), "marks.toml:4: unknown field `pink`"),
        (marks.replace("frame.png", "other.png"), "darwin_op_other.png"),
        ("picture = []".to_owned(), "no [[picture]]"),
    ] {
        let more: &[&str] = if problem == "exists already" { &[] } else { &["--force"] };
        let output = calibrate(&changed, more);
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && error.contains(problem), "{problem}: {error}");
    }
}

#[test]
fn the_match_without_an_argument_needs_no_files_and_no_player_in_it_knows_the_truth() {
    let folder = tempfile::tempdir().unwrap();
    let elsewhere = |line: &[&str]| {
        let mut command = downbeat(line);
        let domain = free_domain().to_string();
        let command = command.current_dir(folder.path()).env("XDG_CACHE_HOME", folder.path().join("cache"));
        let output = command.env("ROS_DOMAIN_ID", domain).output().unwrap();
        assert!(output.status.success(), "{line:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    let played =
        elsewhere(&["match", "--fast", "--duration", "1s", "--record", "bag", "--summary", "match.svg"]);
    assert!(played.contains("blue 0:0 red after 1 s"), "{played}");
    let rows: Vec<_> = played.lines().filter_map(|line| line.split_whitespace().next()).collect();
    let table = ["goals", "blue", "blue_1", "blue_2", "red", "red_1", "red_2"];
    assert!(rows.ends_with(&table), "{played}");
    let picture = std::fs::read_to_string(folder.path().join("match.svg")).unwrap();
    assert!(picture.starts_with("<svg") && picture.contains(">red_2</text>"), "{picture}");
    let reader = Reader::open(folder.path().join("bag")).unwrap();
    let players = ["blue_1", "blue_2", "red_1", "red_2"];
    for name in players {
        for topic in ["vision/markings", "pose", "team_messages"] {
            assert!(reader.topic(&format!("/{name}/{topic}")).is_some(), "{name}/{topic}");
        }
    }
    // The file that is played by default.
    let graph: Value = serde_json::from_str(&elsewhere(&["graph", "seeing_teams", "--json"])).unwrap();
    let name = |list: &str, index: &Value| {
        graph[list][index.as_u64().unwrap() as usize]["name"].as_str().unwrap().to_owned()
    };
    let received = graph["edges"].as_array().unwrap().iter().filter_map(|edge| edge.get("subscribes"));
    let received: Vec<_> =
        received.map(|edge| (name("modules", &edge["module"]), name("topics", &edge["topic"]))).collect();
    assert!(received.contains(&("blue_1/vision".to_owned(), "blue_1/camera/image_raw".to_owned())));
    for (module, topic) in received {
        assert!(!topic.contains("ground_truth"), "{module} receives {topic}");
        let (of_module, of_topic) = (module.split('/').next().unwrap(), topic.split('/').next().unwrap());
        assert!(!players.contains(&of_module) || of_module == of_topic, "{module} receives {topic}");
    }
}

#[test]
fn a_summary_is_an_svg_picture_and_replaces_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("match.svg");
    std::fs::write(&picture, "mine").unwrap();
    for (name, problem) in [("match.png", "let its name end in .svg"), ("match.svg", "exists already")] {
        let line = ["match", "--fast", "--duration", "1s", "--summary", name];
        let output = downbeat(&line).current_dir(folder.path()).output().unwrap();
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && error.contains(problem), "{problem}: {error}");
    }
    assert_eq!(std::fs::read_to_string(&picture).unwrap(), "mine");
}

#[test]
fn five_against_five_play_on_the_field_of_nine_metres() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let printed =
        play_file("robots/five_against_five.toml", "1s", &bag, &["--domain", &free_domain().to_string()]);
    assert!(printed.contains("blue 0:0 red after 1 s"), "{printed}");
    let reader = Reader::open(&bag).unwrap();
    let last = |topic: &str| {
        let topic = reader.topic(topic).unwrap();
        reader.messages(Selection::all().topics([topic])).unwrap().last().unwrap().unwrap().data.to_vec()
    };
    // Everybody enters where its localisation begins.
    let places = [[-4.2, 0.0], [-1.05, 0.0], [-1.35, -0.375], [-1.65, 0.75], [-1.95, -1.125]];
    for (number, [x, y]) in (1..).zip(places) {
        for team in ["blue", "red"] {
            let name = format!("{team}_{number}");
            let believed: PoseWithCovarianceStamped =
                cdr::from_slice(&last(&format!("/{name}/pose"))).unwrap();
            let truth: Odometry = cdr::from_slice(&last(&format!("/{name}/ground_truth/odom"))).unwrap();
            let places = [(believed.pose.pose.position, 0.5), (truth.pose.pose.position, 0.1)];
            for (at, tolerance) in places {
                let off = (at.x - x).abs().max((at.y - y).abs());
                assert!(off < tolerance, "{name}: {at:?}");
            }
        }
    }
}

#[test]
fn a_file_without_a_match_is_refused_with_the_remedy() {
    let output =
        downbeat(&["match", "robots/darwin_op.toml"]).current_dir(env!("CARGO_MANIFEST_DIR")).output();
    let output = output.unwrap();
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && error.contains("football_match"), "{error}");
}

#[test]
#[cfg(feature = "view")]
fn a_match_is_seen_in_a_browser() {
    let domain = free_domain().to_string();
    let Some(mut script) = common::browser::script("football.mjs") else { return };
    let folder = tempfile::tempdir().unwrap();
    let line = ["match", "robots/match.toml", "--domain", &domain, "--view=0"];
    let mut command = downbeat(&line);
    command.current_dir(env!("CARGO_MANIFEST_DIR")).env("XDG_RUNTIME_DIR", folder.path());
    let game = common::Running::start_by(&mut command);
    const BEFORE: &str = "open in a browser: ";
    game.wait_for_output(BEFORE);
    let url = game.output().lines().find_map(|line| line.strip_prefix(BEFORE).map(str::to_owned)).unwrap();
    let output = script.env("DOWNBEAT_PAGE", url).output().unwrap();
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{printed}\n{}", String::from_utf8_lossy(&output.stderr));
}
