//! Demonstrations as data sets of LeRobot, read by pyarrow, and back. `cargo xtask neighbours` reads them
//! with LeRobot itself.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::{Path, PathBuf};
use std::time::Instant;

use common::{open_with_stock_readers, output_of, python, text_of};
use downbeat::bags::{Reader, Selection, TopicDescription, Writer, WriterOptions};
use downbeat::msgs::builtin_interfaces::msg::Time;
use downbeat::msgs::downbeat_interfaces::msg::Episode;
use downbeat::msgs::sensor_msgs::msg::{CompressedImage, Image, JointState};
use downbeat::msgs::{Message, cdr};
use serde_json::{Value, json};

const SECOND: i64 = 1_000_000_000;

/// A bag that is being made.
struct Recording {
    writer: Writer,
    path: PathBuf,
}

impl Recording {
    fn new(path: PathBuf) -> Self {
        Self { writer: WriterOptions::new().create(&path).unwrap(), path }
    }

    fn say<M: Message>(&mut self, topic: &str, at: i64, message: &M) {
        let topic = self.writer.add_topic(TopicDescription {
            name: topic.to_owned(),
            type_name: M::TYPE_NAME.to_owned(),
            definition: M::DEFINITION.to_owned(),
            type_hash: M::TYPE_HASH.to_owned(),
            ..TopicDescription::default()
        });
        self.writer.write(topic.unwrap(), at, at, &cdr::to_vec(message)).unwrap();
    }

    fn joints(&mut self, topic: &str, at: i64, angles: &[(&str, f64)]) {
        let (name, position) = angles.iter().map(|(name, angle)| ((*name).to_owned(), *angle)).unzip();
        self.say(topic, at, &JointState { name, position, ..JointState::default() });
    }

    fn episode(&mut self, at: i64, state: u8, task: &str) {
        let message = Episode { stamp: Time::default(), number: 0, state, task: task.to_owned() };
        self.say("/episodes", at, &message);
    }

    fn finish(self) -> PathBuf {
        self.writer.finish().unwrap();
        self.path
    }
}

/// A grey picture.
fn picture(level: u8) -> Image {
    let (width, height) = (32, 24);
    Image {
        width,
        height,
        encoding: "rgb8".to_owned(),
        step: 96,
        data: vec![level; 96 * 24],
        ..Image::default()
    }
}

/// Ten seconds of an arm of two joints at 100 Hz, with pictures at 10 Hz and two kept episodes: from 1 s to 3
/// s and from 7 s to 8 s.
fn demonstrations(folder: &Path) -> PathBuf {
    let mut bag = Recording::new(folder.join("demonstrations"));
    for number in 0..1000 {
        let at = SECOND + number * SECOND / 100;
        let seconds = number as f64 / 100.0;
        // The shoulder is not measured at first.
        let pan = if number == 0 { f64::NAN } else { seconds };
        bag.joints("/joint_states", at, &[("pan", pan), ("gripper", -seconds)]);
        // The gripper is not commanded before 7.5 s.
        match number {
            ..750 => bag.joints("/joint_commands", at, &[("pan", seconds + 0.5)]),
            _ => bag.joints("/joint_commands", at, &[("gripper", 1.0), ("pan", seconds + 0.5)]),
        }
        if number % 10 == 0 {
            bag.say("/camera/image_raw", at, &picture((number / 10) as u8));
        }
        match number {
            100 => bag.episode(at, Episode::STARTED, "wave"),
            300 => bag.episode(at, Episode::KEPT, "wave"),
            400 => bag.episode(at, Episode::STARTED, "wave"),
            500 => bag.episode(at, Episode::DISCARDED, "wave"),
            700 => bag.episode(at, Episode::STARTED, "grip"),
            800 => bag.episode(at, Episode::KEPT, "grip"),
            900 => bag.episode(at, Episode::STARTED, "not ended"),
            _ => {}
        }
    }
    bag.finish()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn export(bags: &[&Path], output: &Path, arguments: &[&str]) -> String {
    let bags = bags.iter().map(|bag| text(bag));
    let command = ["bag", "export"].into_iter().chain(bags);
    let format = ["-f", "lerobot", "-o", text(output)];
    text_of(&command.chain(format).chain(arguments.iter().copied()).collect::<Vec<_>>())
}

fn is_near(found: &Value, wanted: f64) -> bool {
    (found.as_f64().unwrap() - wanted).abs() < 1e-5
}

#[test]
fn kept_episodes_become_a_data_set_and_a_bag_again() {
    let folder = tempfile::tempdir().unwrap();
    let bag = demonstrations(folder.path());
    let dataset = folder.path().join("dataset");
    let printed = export(&[&bag], &dataset, &["--fps", "20", "--images", "front=camera/image_raw"]);
    assert!(printed.contains("wrote 2 episodes with 62 frames into"), "{printed}");
    assert!(printed.contains("its last episode was neither kept nor discarded"), "{printed}");
    if let Some(found) = python("read_dataset.py", &[&dataset]) {
        let episodes =
            [json!({ "tasks": ["wave"], "length": 41 }), json!({ "tasks": ["grip"], "length": 21 })];
        assert_eq!(found["episodes"], json!(episodes));
        assert_eq!(found["names"]["observation.state"], json!(["pan.pos", "gripper.pos"]));
        assert_eq!(found["names"]["action"], json!(["pan.pos", "gripper.pos"]));
        for frame in 0..62_usize {
            // What had been received by then, at 100 Hz.
            let seconds =
                if frame < 41 { 1.0 + frame as f64 / 20.0 } else { 7.0 + (frame - 41) as f64 / 20.0 };
            let (state, action) = (&found["state"][frame], &found["action"][frame]);
            assert!(is_near(&state[0], seconds) && is_near(&state[1], -seconds), "{frame}: {state}");
            // A joint that was not commanded is to be where it is.
            let gripper = if seconds < 7.5 { -seconds } else { 1.0 };
            assert!(is_near(&action[0], seconds + 0.5) && is_near(&action[1], gripper), "{frame}: {action}");
        }
        // One for two frames.
        let [count, mean] = &found["pictures"]["observation.images.front"].as_array().unwrap()[..] else {
            panic!()
        };
        assert_eq!(*count, 21 + 11);
        let levels = (0..41).map(|frame| 10 + frame / 2).chain((0..21).map(|frame| 70 + frame / 2));
        let wanted = levels.map(f64::from).sum::<f64>() / 62.0 / 255.0;
        assert!(is_near(&mean[0][0][0], wanted), "{mean} {wanted}");
    }

    let again = folder.path().join("again");
    let printed = text_of(&["bag", "import", text(&dataset), "-o", text(&again)]);
    assert!(printed.contains("wrote 2 episodes with 62 frames"), "{printed}");
    open_with_stock_readers(&again);
    let reader = Reader::open(&again).unwrap();
    let pictures = reader.topic("/front/image_raw/compressed").unwrap();
    let mut messages = reader.messages(Selection::all().topics([pictures])).unwrap();
    let first: CompressedImage = cdr::from_slice(&messages.next().unwrap().unwrap().data).unwrap();
    assert_eq!((first.format.as_str(), &first.data[..4]), ("png", &b"\x89PNG"[..]));
    // And the data set of that bag has the same frames.
    let second = folder.path().join("second");
    let camera = "front=front/image_raw/compressed";
    let printed = export(&[&again], &second, &["--fps", "20", "--images", camera]);
    assert!(printed.contains("wrote 2 episodes with 62 frames"), "{printed}");
    for file in ["data/chunk-000/file-000.parquet", "meta/info.json", "meta/stats.json", "meta/tasks.parquet"]
    {
        let [before, after] = [&dataset, &second].map(|folder| std::fs::read(folder.join(file)).unwrap());
        assert!(before == after, "{file} differs");
    }
}

#[test]
fn a_bag_without_episodes_is_one_and_several_bags_are_one_data_set() {
    let folder = tempfile::tempdir().unwrap();
    let bags = ["one", "two"].map(|name| {
        let mut bag = Recording::new(folder.path().join(name));
        for number in 0..=100 {
            let at = SECOND + number * SECOND / 100;
            // Commands begin after 0.2 s: frames do not wait for them.
            bag.joints("/joint_states", at, &[("pan", number as f64 / 100.0)]);
            if number >= 20 {
                bag.joints("/joint_commands", at, &[("pan", 1.0)]);
            }
        }
        bag.finish()
    });
    let dataset = folder.path().join("dataset");
    let arguments = ["--fps", "10", "--task", "stay", "--robot-type", "my_arm"];
    let printed = export(&bags.each_ref().map(PathBuf::as_path), &dataset, &arguments);
    assert!(printed.contains("wrote 2 episodes with 22 frames"), "{printed}");
    if let Some(found) = python("read_dataset.py", &[&dataset]) {
        assert_eq!(found["episodes"], json!(vec![json!({ "tasks": ["stay"], "length": 11 }); 2]));
        let actions: Vec<f64> =
            found["action"].as_array().unwrap()[..11].iter().map(|row| row[0].as_f64().unwrap()).collect();
        assert!(
            is_near(&json!(actions[1]), 0.1) && actions[0] == 0.0 && actions[2..] == [1.0; 9],
            "{actions:?}"
        );
    }
    let info: Value =
        serde_json::from_slice(&std::fs::read(dataset.join("meta/info.json")).unwrap()).unwrap();
    assert_eq!((&info["robot_type"], &info["splits"]["train"]), (&json!("my_arm"), &json!("0:2")));
    // At 30 Hz, times of frames are no whole numbers of ns: they are rounded both ways in the same manner.
    let [thirty, bag, again] = ["thirty", "bag", "again"].map(|name| folder.path().join(name));
    export(&[&bags[0]], &thirty, &[]);
    text_of(&["bag", "import", text(&thirty), "-o", text(&bag)]);
    export(&[&bag], &again, &[]);
    let [before, after] = [&thirty, &again]
        .map(|folder| std::fs::read(folder.join("data/chunk-000/file-000.parquet")).unwrap());
    assert!(before == after);
    // It is replaced on request only, and never with something else in it.
    let refused = |arguments: &[&str]| {
        let command = ["bag", "export", text(&bags[0]), "-f", "lerobot", "-o", text(&dataset)];
        let output = output_of(&[&command, arguments].concat());
        assert!(!output.status.success());
        String::from_utf8(output.stderr).unwrap()
    };
    assert!(refused(&[]).contains("--force"));
    export(&[&bags[0]], &dataset, &["--force"]);
    std::fs::write(dataset.join("data/chunk-000/mine.txt"), "mine").unwrap();
    assert!(refused(&["--force"]).contains("it contains data, which is not part of a data set"));
    std::fs::remove_file(dataset.join("data/chunk-000/mine.txt")).unwrap();
    std::fs::write(dataset.join("README.md"), "mine").unwrap();
    assert!(refused(&["--force"]).contains("it contains README.md"));
}

#[test]
fn what_cannot_become_a_data_set_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let mut bag = Recording::new(folder.path().join("bag"));
    for number in 0..20 {
        bag.joints("/joint_states", SECOND + number, &[("pan", 0.0)]);
    }
    bag.say("/camera/image_raw", SECOND, &picture(1));
    bag.say("/camera/image_raw", SECOND + 5, &Image { height: 20, ..picture(1) });
    bag.say("/other/image_raw", SECOND, &Image { encoding: "16UC1".to_owned(), ..picture(1) });
    let bag = bag.finish();
    let output = folder.path().join("dataset");
    let refused = |arguments: &[&str]| {
        let command =
            ["bag", "export", text(&bag), "-f", "lerobot", "-o", text(&output), "--fps", "1000000000"];
        let failed = output_of(&[&command, arguments].concat());
        assert!(!failed.status.success() && !output.exists());
        String::from_utf8(failed.stderr).unwrap()
    };
    let text = refused(&[]);
    assert!(text.contains("has no topic /joint_commands; it has /joint_states, "), "{text}");
    let action = ["--action", "joint_states"];
    let text = refused(&["--action", "joint_states:name"]);
    assert!(text.contains("/joint_states: name is an array of something else than numbers"), "{text}");
    let text = refused(&["--action", "joint_states:velocity"]);
    assert!(text.contains("/joint_states has no numbers in any message"), "{text}");
    let text = refused(&[&action[..], &["--images", "front"]].concat());
    assert!(text.contains("write NAME=TOPIC"), "{text}");
    let text = refused(&[&action[..], &["--images", "front=joint_states"]].concat());
    assert!(
        text.contains("/joint_states has messages of sensor_msgs/msg/JointState, not sensor_msgs/msg/Image"),
        "{text}"
    );
    let text = refused(&[&action[..], &["--images", "front=camera/image_raw"]].concat());
    assert!(text.contains("a picture of 32 x 20 pixels after those of 32 x 24"), "{text}");
    let text = refused(&[&action[..], &["--images", "front=other/image_raw"]].concat());
    assert!(text.contains("/other/image_raw: the encoding \"16UC1\" is not supported"), "{text}");
    let two = ["--images", "front=camera/image_raw", "front=other/image_raw"];
    let text = refused(&[&action[..], &two].concat());
    assert!(text.contains("two cameras are called front"), "{text}");
    let text = refused(&["--topics", "joint_states"]);
    assert!(text.contains("--state, --action and --images say which topics"), "{text}");

    let import = |path: &Path| {
        let failed = output_of(&[
            "bag",
            "import",
            path.to_str().unwrap(),
            "-o",
            folder.path().join("b").to_str().unwrap(),
        ]);
        assert!(!failed.status.success());
        String::from_utf8(failed.stderr).unwrap()
    };
    let text = import(&bag);
    assert!(text.contains("meta/info.json: it is no data set of LeRobot"), "{text}");
    let old = folder.path().join("old/meta");
    std::fs::create_dir_all(&old).unwrap();
    let info = json!({ "codebase_version": "v2.1", "fps": 30, "features": {} });
    std::fs::write(old.join("info.json"), info.to_string()).unwrap();
    let text = import(old.parent().unwrap());
    assert!(text.contains("the version of the format is v2.1, not v3.0"), "{text}");
}

/// Runs a script with LeRobot itself, and returns what it prints.
fn lerobot(script: &str, arguments: &[&Path]) -> Value {
    let python = std::env::var("DOWNBEAT_LEROBOT_PYTHON").expect("`cargo xtask neighbours` runs this test");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python").join(script);
    let mut command = std::process::Command::new(python);
    // Nothing is asked of the hub.
    command
        .arg(script)
        .args(arguments)
        .env("HF_HUB_OFFLINE", "1")
        .env("HF_LEROBOT_HOME", arguments[0].join("home"));
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
#[ignore = "needs LeRobot, 4 GB: run by `cargo xtask neighbours`"]
fn lerobot_itself_reads_a_data_set_and_writes_one_that_becomes_a_bag() {
    let folder = tempfile::tempdir().unwrap();
    let bag = demonstrations(folder.path());
    let dataset = folder.path().join("dataset");
    export(
        &[&bag],
        &dataset,
        &["--fps", "20", "--images", "front=camera/image_raw", "--robot-type", "my_arm"],
    );
    let found = lerobot("read_with_lerobot.py", &[folder.path(), &dataset]);
    println!("LeRobot {} reads it: {found}", found["version"]);
    assert_eq!((&found["frames"], &found["episodes"], &found["fps"]), (&json!(62), &json!(2), &json!(20)));
    assert_eq!(found["tasks"], json!(["wave", "grip"]));
    assert_eq!(found["picture"], json!([3, 24, 32]));
    assert_eq!(found["batch"], json!([8, 2]));
    assert!(is_near(&found["state"][0], 7.0) && is_near(&found["level"], 70.0 / 255.0), "{found}");
    // Two actions before and after: the first frame of an episode has none before it.
    assert_eq!(found["is_pad"], json!([true, false, false]));

    let written = folder.path().join("written");
    let made = lerobot("write_with_lerobot.py", &[folder.path(), &written]);
    let bag = folder.path().join("bag");
    let printed = text_of(&["bag", "import", text(&written), "-o", text(&bag)]);
    assert!(printed.contains("wrote 2 episodes with 15 frames"), "{printed}");
    open_with_stock_readers(&bag);
    let reader = Reader::open(&bag).unwrap();
    let states = reader.topic("/joint_states").unwrap();
    let messages = reader.messages(Selection::all().topics([states])).unwrap();
    let states: Vec<JointState> =
        messages.map(|message| cdr::from_slice(&message.unwrap().data).unwrap()).collect();
    assert_eq!((states.len(), &states[0].name), (15, &vec!["pan".to_owned(), "gripper".to_owned()]));
    assert_eq!(json!(states[14].position), made["last"]);
}

/// Pictures of 320 x 240 at 30 Hz, a tenth of the 100 000 frames that are spoken of.
#[test]
#[ignore = "measures: run by `cargo xtask neighbours`"]
fn frames_are_written_faster_than_they_were_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let mut bag = Recording::new(folder.path().join("bag"));
    let (frames, fps) = (10_000, 30);
    let mut data = vec![0; 320 * 240 * 3];
    for number in 0..frames {
        let at = SECOND + number * SECOND / fps;
        bag.joints("/joint_states", at, &[("pan", number as f64)]);
        // A gradient with noise, as a camera sees a wall, that moves.
        let mut random = number as u32 + 1;
        for (index, level) in data.iter_mut().enumerate() {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            *level = ((index as i64 / 12 + number) % 200) as u8 + (random >> 29) as u8;
        }
        let picture = Image { width: 320, height: 240, step: 960, data: data.clone(), ..picture(0) };
        bag.say("/camera/image_raw", at, &picture);
    }
    let bag = bag.finish();
    let dataset = folder.path().join("dataset");
    let started = Instant::now();
    export(&[&bag], &dataset, &["--action", "joint_states", "--images", "front=camera/image_raw"]);
    let (took, lasted) = (started.elapsed().as_secs_f64(), frames as f64 / fps as f64);
    println!(
        "{frames} frames of {lasted:.0} s in {took:.1} s: {:.1} times real time (goal 5)",
        lasted / took
    );
    assert!(took < lasted, "slower than it was recorded");
}
