//! The bags of all tests, which `cargo xtask readers` keeps.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use downbeat_bags::metadata::Metadata;
use downbeat_bags::{Problem, Reader, Storage, TopicDescription, check};

use crate::stock_readers;

/// What a stock reader does not read in the bags of some tests: its name, a part of the test's, a part of
/// what it says, and the reason.
const BEYOND_A_READER: &[(&str, &str, &str, &str)] = &[
    ("rosbags", "types::", "wstring", "strings of wide characters"),
    ("mcap-ros2-support", "types::", "wstring", "strings of wide characters"),
    ("@mcap/core", "types::", "no root MessageDefinition", "definitions with nothing in them"),
    ("rosbags", "in_idl", "Could not parse", "IDL that includes other files"),
    ("rosbags", "splits::", "size mismatch", "messages with bytes behind their end"),
    ("rosbags", "", "KeyError('unknown')", "a type whose definition the real recorder did not find"),
    ("@mcap/core", "", "File is not indexed", "files without an index"),
    ("@mcap/core", "storage::", "", "files without chunks or without indexes of messages"),
    ("@mcap/core", "fastwrite", "", "files without chunks or without indexes of messages"),
    ("@mcap/core", "fuzz::", "{}", "files without chunks or without indexes of messages"),
    ("rosbags", "storage::", "{}", "files without indexes of messages"),
    ("rosbags", "fuzz::", "not in timestamp order", "files without an index whose messages are not in order"),
];

/// The reason why a stock reader cannot read a bag. `None` if it should.
fn beyond(reader: &str, test: &str, folder: &Path, bag: &Reader, difference: &str) -> Option<&'static str> {
    let (reads_files, is_of_ros) = (reader != "rosbags", reader != "@mcap/core");
    let has_other_files = |named: &Metadata| {
        let files = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        let bags = files.filter(|file| file.extension().is_some_and(|extension| extension == "mcap"));
        bags.count() > named.relative_file_paths.len()
    };
    let has_topic =
        |is_so: fn(&TopicDescription) -> bool| bag.topics().iter().any(|topic| is_so(&topic.info));
    let is_idl = |topic: &TopicDescription| {
        topic.format.as_ref().is_some_and(|format| format.schema.encoding == "ros2idl")
    };
    let metadata = bag.metadata();
    if reads_files && bag.storage() != Storage::Mcap {
        Some("SQLite")
    } else if reads_files && metadata.is_some_and(|metadata| !metadata.compression_format.is_empty()) {
        Some("files or messages that rosbag2 compressed one by one")
    } else if reads_files && metadata.is_some_and(has_other_files) {
        Some("files that are not of the bag, beside it")
    } else if is_of_ros && has_topic(|topic| !topic.is_cdr()) {
        Some("messages other than CDR")
    } else if is_of_ros && has_topic(|topic| topic.definition.is_empty() && topic.format.is_none()) {
        Some("topics without a definition")
    } else if reader == "mcap-ros2-support" && has_topic(is_idl) {
        Some("definitions in IDL")
    } else {
        let is_known = |(of, tests, says, _): &&(&str, &str, &str, &str)| {
            *of == reader && test.contains(tests) && difference.contains(says)
        };
        BEYOND_A_READER.iter().find(is_known).map(|(.., reason)| *reason)
    }
}

/// Bags, of which those without a metadata.yaml are single files, in the folder of a test.
fn bags(folder: &Path) -> Vec<PathBuf> {
    let entries = |folder: &Path| fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut bags = Vec::new();
    for test in entries(folder) {
        for place in entries(&test) {
            if place.join("metadata.yaml").exists() {
                bags.push(place);
            } else {
                bags.extend(entries(&place));
            }
        }
    }
    bags.sort();
    bags
}

/// Whether a check finds nothing but what others do not mind.
fn is_whole(bag: &Reader) -> bool {
    check(bag, |_| ()).is_ok_and(|check| {
        let matters = |problem: &Problem| !matches!(problem, Problem::NoMetadata | Problem::Lost(_));
        !check.problems.iter().any(matters)
    })
}

#[test]
#[ignore = "an hour: cargo xtask readers"]
fn others_open_every_kept_bag() {
    let kept = std::env::var_os("KEPT_BAGS").expect("KEPT_BAGS: the folder of the kept bags");
    let kept = Path::new(&kept);
    let folder = tempfile::tempdir().unwrap();
    let mut whole = Vec::new();
    let all = bags(kept);
    for (number, bag) in all.iter().enumerate() {
        let Ok(reader) = Reader::open(bag) else { continue };
        if is_whole(&reader) {
            let extension = bag.extension().filter(|_| bag.is_file()).unwrap_or_default();
            let link = folder.path().join(number.to_string()).with_extension(extension);
            symlink(bag, &link).unwrap();
            whole.push((bag, link, reader));
        }
    }
    let readers = stock_readers::read(folder.path());
    let mut known = BTreeMap::new();
    let mut unknown = 0;
    let mut refused_by_any = 0;
    for (bag, link, ours) in &whole {
        let name = bag.strip_prefix(kept).unwrap().display().to_string();
        let differences: Vec<_> =
            readers.iter().filter_map(|reader| Some((reader.name, reader.difference(link, ours)?))).collect();
        refused_by_any += usize::from(!differences.is_empty());
        for (reader, difference) in differences {
            if let Some(reason) = beyond(reader, &name, bag, ours, &difference) {
                *known.entry((reader, reason)).or_insert(0) += 1;
            } else {
                unknown += 1;
                println!("{reader}: {name}: {difference:.300}");
            }
        }
    }
    let damaged = all.len() - whole.len();
    println!(
        "{} bags; {damaged} are damaged, as we find too; of the others, {} are read by {} readers",
        all.len(),
        whole.len() - refused_by_any,
        readers.len()
    );
    for ((reader, reason), count) in known {
        println!("{count:>5} refused by {reader}: {reason}");
    }
    assert_eq!(unknown, 0, "bags that a stock reader reads otherwise, without a reason that is known");
}
