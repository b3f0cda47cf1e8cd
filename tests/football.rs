//! `downbeat match`, on the command line.
#![cfg(feature = "football")]
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::{downbeat, text_of};
use downbeat::bags::Selection;
use downbeat::msgs::cdr;
use downbeat::msgs::geometry_msgs::msg::PoseWithCovarianceStamped;
use downbeat_football::football_interfaces::msg::TeamMessage;
use std::path::Path;

/// Plays a part of the match and returns what was printed.
fn play(bag: &Path, more: &[&str]) -> String {
    let line = ["match", "robots/match.toml", "--fast", "--duration", "3s", "--domain", "219", "--record"];
    let mut command = downbeat(&line);
    let output = command.arg(bag).args(more).current_dir(env!("CARGO_MANIFEST_DIR")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn a_match_is_played_recorded_and_replayed_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let bags = ["first", "second", "other"].map(|name| folder.path().join(name));
    let printed = play(&bags[0], &[]);
    assert!(printed.contains("0.0 s  0:0  ready") && printed.contains("blue 0:0 red after 3 s"), "{printed}");
    play(&bags[1], &[]);
    play(&bags[2], &["-p", "match.seed:=2"]);
    let same = |one: &Path, other: &Path| {
        // Of the process.
        let diff = ["bag", "diff", "--ignore", "diagnostics", one.to_str().unwrap(), other.to_str().unwrap()];
        downbeat(&diff).output().unwrap().status.success()
    };
    assert!(same(&bags[0], &bags[1]) && !same(&bags[0], &bags[2]));
    for launcher in ["linear", "pool:2"] {
        let bag = bags[0].to_str().unwrap();
        let replay = text_of(&["bag", "replay", "robots/match.toml", bag, "--launcher", launcher]);
        for topic in ["/blue_1/joint_goals", "/red_2/player/state", "/red_1/pose"] {
            assert!(replay.contains(topic), "{topic}: {replay}");
        }
    }
}

#[test]
fn a_player_that_sees_is_replayed_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let line =
        ["match", "robots/seeing_match.toml", "--fast", "--duration", "4s", "--domain", "219", "--record"];
    let output = downbeat(&line).arg(&bag).current_dir(env!("CARGO_MANIFEST_DIR")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let bag_name = bag.to_str().unwrap();
    for launcher in ["linear", "pool:2"] {
        let replay =
            text_of(&["bag", "replay", "robots/seeing_match.toml", bag_name, "--launcher", launcher]);
        for topic in ["/blue_2/vision/markings", "/blue_2/vision/annotated", "/blue_2/pose"] {
            assert!(replay.contains(topic), "{topic}: {replay}");
        }
    }
    // It knows where it is, and it stands still until play begins.
    let reader = downbeat::bags::Reader::open(&bag).unwrap();
    let topic = reader.topic("/blue_2/pose").unwrap();
    let last = reader.messages(Selection::all().topics([topic])).unwrap().last().unwrap().unwrap();
    let pose: PoseWithCovarianceStamped = cdr::from_slice(&last.data).unwrap();
    let at = pose.pose.pose.position;
    assert!((at.x + 0.9).abs() < 0.2 && at.y.abs() < 0.2, "{at:?}");

    // A picture of the bag teaches the carpet's colour.
    let marks = folder.path().join("marks.toml");
    let text = "[[picture]]\nbag = \"bag\"\ntopic = \"blue_2/camera/image_raw\"\nat = 1.0\ngreen = [[160, 200, 6]]\n";
    std::fs::write(&marks, text).unwrap();
    let learned = folder.path().join("colours.toml");
    text_of(&["vision", "calibrate", marks.to_str().unwrap(), "-o", learned.to_str().unwrap()]);
    let colours = downbeat_vision::Colours::read(&learned).unwrap();
    assert_ne!(colours.green, downbeat_vision::Colours::default().green);
    assert_eq!(colours.white, downbeat_vision::Colours::default().white);
}

#[test]
fn teams_that_see_are_replayed_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let line =
        ["match", "robots/seeing_teams.toml", "--fast", "--duration", "3s", "--domain", "219", "--record"];
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
    // Each hears its mate, under its number.
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
    const FRAME: &str = "modules/vision/tests/data/darwin_op_frame.png";
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
    // Of the carpet, and of the ball.
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
    let Some(mut script) = common::browser::script("football.mjs") else { return };
    let folder = tempfile::tempdir().unwrap();
    let line = ["match", "robots/match.toml", "--domain", "218", "--view=0"];
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
