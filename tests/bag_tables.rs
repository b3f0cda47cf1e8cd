//! Tables and plots of the contents of bags, read by other programs.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::{Path, PathBuf};

use common::{output_of, python, text_of};
use downbeat::bags::metadata::Metadata;
use downbeat::bags::{Reader, RecordedTopic, Selection, TopicDescription, WriterOptions};

fn recording() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("bags/recordings/darwin_op_emulated")
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn duckdb_reads_the_values_that_rosbags_decodes() {
    let folder = tempfile::tempdir().unwrap();
    let (bag, tables) = (recording(), folder.path().join("tables"));
    std::fs::create_dir(&tables).unwrap();
    let reader = Reader::open(&bag).unwrap();
    let count = |topic: &str| reader.topics()[reader.topic(topic).unwrap().index()].message_count;
    for format in ["csv", "jsonl", "parquet"] {
        let output = folder.path().join(format);
        let topics = ["--topics", "joint_states", "bus/exchanges"];
        let printed = text_of(
            &[&["bag", "export", text(&bag), "-f", format, "-o", text(&output)], &topics[..]].concat(),
        );
        assert!(
            printed.contains(&format!("/joint_states: {} messages", count("/joint_states"))),
            "{printed}"
        );
        for file in std::fs::read_dir(&output).unwrap() {
            let file = file.unwrap();
            std::fs::rename(file.path(), tables.join(file.file_name())).unwrap();
        }
    }
    let Some(compared) = python("read_tables.py", &[&bag, &tables]) else { return };
    for (topic, stem) in [("/joint_states", "joint_states"), ("/bus/exchanges", "bus.exchanges")] {
        for extension in ["csv", "parquet"] {
            assert_eq!(compared[format!("{stem}.{extension}")], count(topic), "{compared}");
        }
    }
    assert_eq!(compared["joint_states.jsonl"], count("/joint_states"));
}

#[test]
fn fields_are_drawn_as_svg_and_png() {
    let folder = tempfile::tempdir().unwrap();
    let svg = folder.path().join("plot.svg");
    let fields = ["joint_states:position[3]", "/imu/data_raw:angular_velocity"];
    let line = |output: &Path| {
        text_of(&[&["bag", "plot", text(&recording()), "-o", text(output)], &fields[..]].concat())
    };
    assert!(line(&svg).starts_with("4 curves in "));
    let drawn = std::fs::read_to_string(&svg).unwrap();
    for name in ["/joint_states:position[3]", "/imu/data_raw:angular_velocity.z", "seconds since"] {
        assert!(drawn.contains(name), "{name}");
    }
    roxmltree::Document::parse(&drawn).unwrap();
    let image = folder.path().join("plot.png");
    line(&image);
    let mut reader =
        png::Decoder::new(std::io::BufReader::new(std::fs::File::open(&image).unwrap())).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!((info.width, info.height), (1200, 600));
    let white = pixels.iter().filter(|value| **value == 255).count();
    assert!(white > pixels.len() / 2 && white < pixels.len(), "lines on white");
}

#[test]
fn elements_of_an_array_are_named_by_the_name_field_next_to_it() {
    let folder = tempfile::tempdir().unwrap();
    let drawn = |field: &str| {
        let plot = folder.path().join("plot.svg");
        text_of(&["bag", "plot", text(&recording()), field, "--force", "-o", text(&plot)]);
        std::fs::read_to_string(plot).unwrap()
    };
    let all = drawn("joint_states:position");
    assert!(all.contains("/joint_states:position[head_tilt]") && !all.contains("position[3]"), "{all}");
    let one = drawn("joint_states:position[head_tilt]");
    assert!(one.contains("/joint_states:position[head_tilt]") && !one.contains("[head_pan]"));
    // Without a name field they are numbered.
    assert!(drawn("imu/data_raw:angular_velocity_covariance").contains("angular_velocity_covariance[0]"));
}

#[test]
fn the_legend_is_beside_the_data() {
    let folder = tempfile::tempdir().unwrap();
    let plot = folder.path().join("plot.svg");
    text_of(&["bag", "plot", text(&recording()), "joint_states:position", "-o", text(&plot)]);
    let drawn = std::fs::read_to_string(plot).unwrap();
    let document = roxmltree::Document::parse(&drawn).unwrap();
    let number = |node: roxmltree::Node<'_, '_>, name: &str| node.attribute(name)?.parse::<f64>().ok();
    let texts = document.descendants().filter(|node| node.has_tag_name("text"));
    let legend: Vec<_> =
        texts.filter(|node| node.text().is_some_and(|text| text.contains("position["))).collect();
    assert_eq!(legend.len(), 20);
    let leftmost = legend.iter().filter_map(|node| number(*node, "x")).fold(f64::MAX, f64::min);
    let lines = document.descendants().filter(|node| node.has_tag_name("polyline"));
    let points = lines.filter_map(|line| line.attribute("points")).flat_map(str::split_whitespace);
    let inside = points.filter_map(|point| point.split(',').next()?.parse::<f64>().ok());
    // In the file, the data come first, then the samples of the lines, then their texts.
    let (samples, data): (Vec<f64>, Vec<f64>) = inside.partition(|x| *x > leftmost - 45.0);
    let rightmost = data.iter().copied().fold(0.0, f64::max);
    assert!(
        !samples.is_empty() && rightmost < leftmost - 45.0 && rightmost > 600.0,
        "{rightmost} {leftmost}"
    );
    assert!(legend.iter().all(|node| number(*node, "y").unwrap() < 600.0));
}

#[test]
fn errors_of_plot_and_export_list_the_valid_choices() {
    let folder = tempfile::tempdir().unwrap();
    let bag = recording();
    let plot = folder.path().join("plot.svg");
    let refused = |arguments: &[&str]| {
        let output = output_of(arguments);
        assert!(!output.status.success());
        String::from_utf8(output.stderr).unwrap()
    };
    let field = |field: &str, output: &Path| refused(&["bag", "plot", text(&bag), field, "-o", text(output)]);
    assert!(
        field("joint_state:position", &plot)
            .contains("has no topic /joint_state, did you mean /joint_states?")
    );
    assert!(field("xyz:position", &plot).contains("has no topic /xyz; it has /"));
    assert!(
        field("joint_states:positions", &plot).contains("no number at positions, did you mean position?")
    );
    let element = field("joint_states:position[head_pna]", &plot);
    assert!(element.contains("did you mean position[head_pan]?"), "{element}");
    assert!(field("joint_states:xyz", &plot).contains("it has header.stamp.sec, "));
    assert!(field("joint_states:name", &plot).contains("no number at name"));
    assert!(field("joint_states", &plot).contains("TOPIC:FIELD"));
    assert!(field("joint_states:position", &folder.path().join("plot.pdf")).contains(".svg or .png"));
    let there = refused(&["bag", "export", text(&bag), "-o", text(folder.path())]);
    assert!(there.contains("exists already") && there.contains("--force"), "{there}");
}

/// A bag of another program; see `tests/data/bags/README.md`.
fn foreign(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/bags").join(name).with_extension("mcap")
}

/// The rows of the only topic, exported as JSON lines, and the log output.
fn exported(bag: &Path, folder: &Path) -> (Vec<serde_json::Value>, String) {
    let output = folder.join("exported");
    let done = output_of(&["bag", "export", text(bag), "--force", "-f", "jsonl", "-o", text(&output)]);
    let logged = String::from_utf8(done.stderr).unwrap();
    assert!(done.status.success(), "{logged}");
    let mut rows = Vec::new();
    for file in std::fs::read_dir(&output).unwrap() {
        let lines = std::fs::read_to_string(file.unwrap().path()).unwrap();
        rows.extend(lines.lines().map(|line| serde_json::from_str(line).unwrap()));
    }
    (rows, logged)
}

#[test]
fn types_that_are_defined_in_idl_are_read_by_every_command() {
    let folder = tempfile::tempdir().unwrap();
    let bag = foreign("idl_simple");
    assert!(text_of(&["bag", "check", text(&bag)]).contains("decoded 3 of them, found 0 problems"));
    let (rows, _) = exported(&bag, folder.path());
    assert_eq!(rows.len(), 3);
    assert_eq!(rows[2]["message"], serde_json::json!({ "a": 2, "b": 0.5 }));
    let plot = folder.path().join("plot.svg");
    assert!(text_of(&["bag", "plot", text(&bag), "simple:a", "-o", text(&plot)]).starts_with("1 curve in"));
    // The schema of a copy is the same.
    let copy = folder.path().join("copy");
    text_of(&["bag", "convert", text(&bag), "-o", text(&copy)]);
    assert_eq!(exported(&copy, folder.path()).0, rows);
    assert!(text_of(&["bag", "info", "--json", text(&bag)]).contains("my_msgs/msg/Simple"));
}

#[test]
fn composite_types_that_are_defined_in_idl_are_read_by_every_command() {
    let folder = tempfile::tempdir().unwrap();
    let bag = foreign("idl_composite");
    let whole = "decoded 4 of them, found 0 problems";
    assert!(text_of(&["bag", "check", text(&bag)]).contains(whole));
    let (rows, _) = exported(&bag, folder.path());
    let plant = |kind: &str, height: f64| serde_json::json!({ "kind": kind, "height": height });
    let expected = serde_json::json!({
        "header": { "stamp": { "sec": 3, "nanosec": 5 }, "frame_id": "bed" },
        "first": plant("rose", 3.5),
        "plants": [plant("fern", 1.0), plant("moss", 0.75)],
        "corners": [plant("a", 1.0), plant("b", 2.0)],
        "size": [3.0, 4.0, 5.0],
        "rows": [0, 1, 2],
        "depth": 0.3,
        "is_wet": true,
    });
    assert_eq!((rows.len(), &rows[3]["message"]), (4, &expected));
    let plot = folder.path().join("plot.svg");
    let fields = ["bed:plants[1].height", "bed:size[2]"];
    let plotted = text_of(&["bag", "plot", text(&bag), fields[0], fields[1], "-o", text(&plot)]);
    assert!(plotted.starts_with("2 curves in"), "{plotted}");
    for command in ["convert", "repair"] {
        let copy = folder.path().join(command);
        text_of(&["bag", command, text(&bag), "-o", text(&copy)]);
        assert!(text_of(&["bag", "check", text(&copy)]).contains(whole), "{command}");
        assert!(text_of(&["bag", "diff", text(&bag), text(&copy)]).contains("are the same"), "{command}");
    }
    let part = folder.path().join("part");
    text_of(&["bag", "cut", text(&bag), "--from", "0.1s", "-o", text(&part)]);
    assert_eq!(exported(&part, folder.path()).0, rows[1..]);
}

#[test]
fn a_bag_of_types_in_idl_is_indexed_again() {
    let folder = tempfile::tempdir().unwrap();
    for (name, count) in [("idl_simple", 3), ("idl_composite", 4)] {
        let bag = folder.path().join(name);
        std::fs::create_dir(&bag).unwrap();
        std::fs::copy(foreign(name), bag.join(format!("{name}_0.mcap"))).unwrap();
        let printed = text_of(&["bag", "reindex", text(&bag)]);
        assert!(printed.contains(&format!("of {count} messages on 1 topics in 1 files")), "{printed}");
        let indexed = Metadata::read(&bag.join("metadata.yaml")).unwrap();
        let known = &Reader::open(foreign(name)).unwrap().topics()[0].info.clone();
        let found = &indexed.topics[0];
        assert_eq!((&found.type_name, &found.type_hash), (&known.type_name, &known.type_hash));
        assert!(text_of(&["bag", "check", text(&bag)]).contains("found 0 problems"));
        assert!(text_of(&["bag", "diff", text(&bag), text(&foreign(name))]).contains("are the same"));
    }
}

/// A topic that has each stamp of another one, 20 ms later.
#[test]
fn causes_are_guessed_from_the_stamps_of_types_in_idl() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("seen");
    let reader = Reader::open(foreign("idl_composite")).unwrap();
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    let bed = &reader.topics()[0].info;
    let seen = TopicDescription { name: "/seen".to_owned(), ..bed.clone() };
    let [bed, seen] = [bed.clone(), seen].map(|topic| writer.add_topic(topic).unwrap());
    for message in reader.messages(Selection::all()).unwrap().map(Result::unwrap) {
        writer.write(bed, message.log_time, message.publish_time, &message.data).unwrap();
        writer.write(seen, message.log_time + 20_000_000, message.publish_time, &message.data).unwrap();
    }
    writer.finish().unwrap();
    let schemas = Reader::open(&bag).unwrap();
    let is_idl =
        |topic: &RecordedTopic| topic.info.format.as_ref().is_some_and(|of| of.schema.encoding == "ros2idl");
    assert!(schemas.topics().iter().all(is_idl));
    let why = text_of(&["bag", "why", text(&bag), "seen#2"]);
    assert!(why.contains("/bed at 0.2") && why.contains("20.0 ms before: same header.stamp"), "{why}");
    let latency =
        output_of(&["bag", "latency", text(&bag), "--from", "bed", "--to", "seen", "--json"]).stdout;
    let latency: serde_json::Value = serde_json::from_slice(&latency).unwrap();
    assert_eq!((&latency["messages"], &latency["age_ns"]["max"]), (&4.into(), &20_000_000.into()));
    assert_eq!(latency["worst"]["passed"][0][0], "/bed");
    let latency = text_of(&["bag", "latency", text(&bag), "--from", "bed", "--to", "seen"]);
    assert!(
        latency.contains("waiting is not told from work") && latency.contains(", 20.0 ms until /seen"),
        "{latency}"
    );
}

#[test]
fn packages_with_idl_files_alone_are_found() {
    let package = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/my_idl");
    let shown = text_of(&["interface", "show", "my_idl/msg/Simple", "--from", text(&package)]);
    assert_eq!(shown.trim(), "int32 a\nfloat64 b");
}

#[test]
fn incomplete_definitions_are_completed_and_empty_ones_are_definitions() {
    let folder = tempfile::tempdir().unwrap();
    let (rows, logged) = exported(&foreign("nested"), folder.path());
    assert_eq!(rows[0]["message"], serde_json::json!({ "where": { "x": 1.0, "y": 2.0, "z": 3.0 } }));
    assert!(logged.contains("geometry_msgs/msg/Point from the built-in interfaces"), "{logged}");
    let checked = text_of(&["bag", "check", text(&foreign("nested"))]);
    assert!(checked.contains("note: /spot: the definition of my_msgs/msg/Spot lacks types"), "{checked}");
    // A copy has the whole definition.
    let copy = folder.path().join("copy");
    let logged = text_of(&["bag", "convert", text(&foreign("nested")), "-o", text(&copy)]);
    assert!(logged.contains("/spot: the definition of my_msgs/msg/Spot lacks types"), "{logged}");
    let checked = text_of(&["bag", "check", text(&copy)]);
    assert!(checked.contains("found 0 problems") && !checked.contains("note:"), "{checked}");
    assert_eq!(exported(&copy, folder.path()).0, rows);
    let (rows, logged) = exported(&foreign("custom_nothing"), folder.path());
    assert_eq!(rows.len(), 3);
    assert!(rows.iter().all(|row| row["message"] == serde_json::json!({})) && logged.is_empty(), "{logged}");
    let checked = text_of(&["bag", "check", text(&foreign("custom_nothing"))]);
    assert!(checked.contains("decoded 3 of them, found 0 problems"), "{checked}");
}

#[test]
fn json_of_other_schemas_is_exported_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let (rows, _) = exported(&foreign("foxlog"), folder.path());
    let hello = rows.iter().find(|row| row["message"]["message"] == "hi 0").unwrap();
    assert_eq!(hello["message"]["timestamp"], serde_json::json!({ "sec": 5, "nsec": 6 }));
    assert!(rows.iter().any(|row| row["message"]["nested"]["x"] == serde_json::json!([1, 2])));
    assert!(rows.iter().any(|row| row["message"]["frame_id"] == "map"));
    let csv = folder.path().join("csv");
    text_of(&["bag", "export", text(&foreign("foxlog")), "-o", text(&csv)]);
    assert!(csv.join("log.jsonl").exists());
}

#[test]
fn a_topic_with_a_long_name_has_a_file_with_a_shorter_one() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    for end in ["a", "b"] {
        let topic = TopicDescription {
            name: format!("/{}/{end}", "long".repeat(300)),
            type_name: "std_msgs/msg/Empty".into(),
            ..TopicDescription::default()
        };
        let topic = writer.add_topic(topic).unwrap();
        writer.write(topic, 1, 1, &[0, 1, 0, 0, 0]).unwrap();
    }
    writer.finish().unwrap();
    let (rows, logged) = exported(&bag, folder.path());
    assert_eq!(rows.len(), 2);
    assert!(logged.contains("is shortened to"), "{logged}");
}

#[test]
fn every_topic_of_hundreds_has_its_own_messages() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    // More than may be open at the same time.
    let topics: Vec<_> = (0..600)
        .map(|number| {
            let info = TopicDescription {
                name: format!("/topic_{number}"),
                type_name: "std_msgs/msg/UInt32MultiArray".into(),
                ..TopicDescription::default()
            };
            writer.add_topic(info).unwrap()
        })
        .collect();
    for time in 0..2 {
        for (number, topic) in (0_u32..).zip(&topics) {
            let message = downbeat::msgs::std_msgs::msg::UInt32MultiArray {
                data: vec![number; 1 + time as usize],
                ..Default::default()
            };
            writer.write(*topic, time, time, &downbeat::msgs::cdr::to_vec(&message)).unwrap();
        }
    }
    writer.finish().unwrap();
    for format in ["csv", "jsonl"] {
        let output = folder.path().join(format);
        text_of(&["bag", "export", text(&bag), "-f", format, "-o", text(&output)]);
        for number in [0, 255, 256, 599] {
            let rows = std::fs::read_to_string(output.join(format!("topic_{number}.{format}"))).unwrap();
            assert_eq!(rows.lines().count(), if format == "csv" { 3 } else { 2 }, "{rows}");
            assert!(rows.lines().last().unwrap().contains(&format!("{number},{number}")), "{rows}");
        }
    }
}
