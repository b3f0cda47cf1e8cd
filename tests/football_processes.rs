//! `downbeat match --processes`, on the command line. No assertion depends on the speed of the machine.
#![cfg(feature = "football")]
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::{Running, downbeat, output_of, text_of, wait_until};
use downbeat::bags::{Reader, Selection};
use downbeat::msgs::cdr;
use downbeat::msgs::geometry_msgs::msg::PoseWithCovarianceStamped;
use std::path::{Path, PathBuf};
use test_machine::{free_domain, free_domains};

/// A match of players with vision.
fn file(folder: &Path, robots: &[&str]) -> PathBuf {
    let player = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots/football/seeing_player.toml");
    let mut text = format!(
        "[robot]\nname = \"football\"\n[[module]]\nname = \"match\"\nkind = \"football_match\"\nsettings = {{ robots = {robots:?}, camera_hz = 4.0 }}\n\
         [expose]\nout = [\"match/state\"]\n"
    );
    for name in robots {
        let start = if name.ends_with('1') { -2.7 } else { -0.9 };
        text += &format!(
            "[[include]]\nrobot = {player:?}\nnamespace = \"{name}\"\nsettings = {{ localisation = {{ starts = [{start}, 0.0, 0.0] }} }}\n"
        );
    }
    let path = folder.join("match.toml");
    std::fs::write(&path, text).unwrap();
    path
}

/// The domain and the process of a robot, from the output of the match.
fn domain_and_process(game: &Running, robot: &str) -> (String, String) {
    game.wait_for_output(&format!("{robot}  domain "));
    let output = game.output();
    let line = output.lines().find(|line| line.starts_with(&format!("{robot}  domain "))).unwrap();
    let words: Vec<_> = line.split_whitespace().collect();
    (words[2].to_owned(), words[4].to_owned())
}

/// The process of a robot that was started again; `earlier` is the one before.
fn next_process(game: &Running, robot: &str, earlier: &str) -> String {
    let before = format!("started again: {robot}  domain ");
    let mut process = None;
    wait_until(&format!("{robot} is started again"), || {
        let output = game.output();
        let line = output.lines().filter_map(|line| line.split_once(&before)).next_back();
        process = line.and_then(|(_, rest)| Some(rest.split_whitespace().nth(2)?.to_owned()));
        process.is_some()
    });
    let process = process.unwrap();
    assert_ne!(process, earlier);
    process
}

fn kill(process: &str) {
    let killed = std::process::Command::new("kill").args(["-KILL", process]).status().unwrap();
    assert!(killed.success());
}

/// True if the process exists and has not ended.
fn is_running(process: &str) -> bool {
    let state = std::fs::read_to_string(Path::new("/proc").join(process).join("stat"));
    state.is_ok_and(|state| !state.contains(") Z "))
}

/// The next message of a topic.
fn message_of(topic: &str, domain: &str) -> String {
    let mut message = String::new();
    wait_until(&format!("{topic} has a message"), || {
        let output = output_of(&["topic", "echo", topic, "--once", "--timeout", "5", "--domain", domain]);
        message = String::from_utf8(output.stdout).unwrap();
        output.status.success() && !message.is_empty()
    });
    message
}

#[test]
fn robots_in_processes_meet_only_by_bus_pictures_and_datagrams() {
    // The match, and behind it each robot.
    let first_domain = free_domains(3);
    let domain = first_domain.to_string();
    let folder = tempfile::tempdir().unwrap();
    let (file, bags) = (file(folder.path(), &["blue_1", "blue_2"]), folder.path().join("bags"));
    let mut command = downbeat(&["match", "--processes", "--domain", &domain, "--record"]);
    command.arg(&bags).arg(&file);
    let mut game = Running::start_by(&mut command);
    let (first, first_process) = domain_and_process(&game, "blue_1");
    let (second, second_process) = domain_and_process(&game, "blue_2");
    assert_eq!([&*first, &*second], [first_domain + 1, first_domain + 2].map(|domain| domain.to_string()));

    // Players receive the referee's datagrams and answer them.
    game.wait_for_output("blue_1 answers the referee");
    game.wait_for_output("blue_2 answers the referee");
    let heard = message_of("/blue_2/game_state", &second);
    for line in ["own_team: 1\n", "player: 2\n", "is_goalkeeper: false\n", "is_first_half: true\n"] {
        assert!(heard.contains(line), "{line}: {heard}");
    }
    // Players receive pictures, and no other simulated data.
    assert!(message_of("/blue_1/pose", &first).contains("frame_id: map"));
    let topics = text_of(&["topic", "list", "--domain", &first]);
    assert!(topics.contains("/blue_1/camera/image_raw"), "{topics}");
    assert!(!topics.contains("ground_truth") && !topics.contains("blue_2"), "{topics}");

    // The messages of one player arrive at the other.
    let told = message_of("/blue_1/team_messages", &first);
    assert!(told.contains("player: 2\n"), "{told}");

    game.interrupt();
    assert!(!is_running(&first_process) && !is_running(&second_process));

    let reader = Reader::open(bags.join("blue_1")).unwrap();
    let topic = reader.topic("/blue_1/pose").unwrap();
    // The first belief, before another robot could push the player.
    let first = reader.messages(Selection::all().topics([topic])).unwrap().next().unwrap().unwrap();
    let at = cdr::from_slice::<PoseWithCovarianceStamped>(&first.data).unwrap().pose.pose.position;
    assert!((at.x + 2.7).abs() < 0.3 && at.y.abs() < 0.3, "{at:?}");
    let reader = Reader::open(bags.join("match")).unwrap();
    assert!(reader.topic("/match/state").is_some() && reader.topic("/blue_1/pose").is_none());
}

#[test]
fn a_robot_whose_process_dies_is_picked_up_started_again_and_rejoins() {
    let first_domain = free_domains(3);
    let domain = first_domain.to_string();
    let folder = tempfile::tempdir().unwrap();
    let (file, bags) = (file(folder.path(), &["blue_1", "blue_2"]), folder.path().join("bags"));
    let mut command = downbeat(&["match", "--processes", "--domain", &domain, "--record"]);
    command.arg(&bags).arg(&file);
    let mut game = Running::start_by(&mut command);
    let (_, first_process) = domain_and_process(&game, "blue_1");
    let (second, second_process) = domain_and_process(&game, "blue_2");
    game.wait_for_output("blue_2 answers the referee");
    kill(&second_process);
    game.wait_for_output("the process of blue_2 has ended: signal: 9");
    game.wait_for_output("it is started again in 1s");
    game.wait_for_output("blue 2 is picked up as its team asked");
    let next = next_process(&game, "blue_2", &second_process);
    // It hears the referee, and speaks to its servos: where it is follows from their answers.
    assert!(message_of("/blue_2/game_state", &second).contains("player: 2\n"));
    assert!(message_of("/blue_2/pose", &second).contains("frame_id: map"));
    message_of("/match/state", &domain);
    assert!(is_running(&first_process) && is_running(&next) && game.is_running(), "{}", game.output());
    game.interrupt();
    assert!(!is_running(&first_process) && !is_running(&next));
    // The bag of the process that was killed is kept.
    assert!(Reader::open(bags.join("blue_2_2")).unwrap().topic("/blue_2/game_state").is_some());
    assert!(bags.join("blue_2").is_dir());
}

#[test]
fn no_robot_is_left_when_the_match_is_killed_not_even_one_that_was_started_again() {
    let folder = tempfile::tempdir().unwrap();
    let file = file(folder.path(), &["red_1"]);
    let [of_match, of_robot] = [free_domain(), free_domain()].map(|domain| domain.to_string());
    let line = ["match", "--processes", "--domain", &of_match, "--robot-domains", &of_robot];
    let mut game = Running::start_by(downbeat(&line).arg(&file));
    let (domain, process) = domain_and_process(&game, "red_1");
    assert_eq!(domain, of_robot);
    game.wait_for_output("red_1 answers the referee");
    assert!(is_running(&process));
    kill(&process);
    let next = next_process(&game, "red_1", &process);
    assert!(is_running(&next));
    game.signal("-KILL");
    assert!(!game.wait().success());
    wait_until("the robot has ended", || !is_running(&next));
}

#[test]
fn what_cannot_be_played_in_processes_is_refused_with_the_remedy() {
    let domain = free_domain().to_string();
    let folder = tempfile::tempdir().unwrap();
    let seeing = file(folder.path(), &["blue_1"]);
    let text = std::fs::read_to_string(&seeing).unwrap();
    let blind = folder.path().join("blind.toml");
    std::fs::write(&blind, text.replace("camera_hz = 4.0", "camera_hz = 0.0")).unwrap();
    let nobody = folder.path().join("nobody.toml");
    std::fs::write(&nobody, text.replace("namespace = \"blue_1\"", "namespace = \"blue_7\"")).unwrap();
    let [seeing, blind, nobody] = [&seeing, &blind, &nobody].map(|path| path.to_str().unwrap());
    for (line, problem) in [
        (&["robots/match.toml"][..], "player.toml:33: \"blue_1/beliefs\" believes the ground truth"),
        (&["robots/match.toml"], "football/seeing_player.toml"),
        (&[blind], "blind.toml:4: robots in processes of their own know the field only from pictures"),
        (&[nobody], "no [[include]] with namespace = \"blue_1\""),
        (&[seeing, "--robot-domains", "233"], "domains end at 232"),
        (&[seeing, "--fast"], "cannot be used with"),
    ] {
        let output = output_of(&[&["match", "--processes", "--domain", &domain], line].concat());
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && error.contains(problem), "{problem}: {error}");
    }
}
