//! `downbeat match`, on the command line.
#![cfg(feature = "football")]
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::{downbeat, text_of};
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
