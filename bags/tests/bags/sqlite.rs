//! Bags written in SQLite: compared with the real recorder, read by others, killed, split, copied.

use std::collections::BTreeMap;
use std::fs;
use std::num::NonZeroUsize;
use std::path::Path;
use std::time::Duration;

use downbeat_bags::metadata::{FILE_NAME, Metadata};
use downbeat_bags::{
    BagMessage, Compression, Copy, MessageFormat, Problem, Reader, RecordedTopic, Recording, Selection,
    SplitLimits, SqliteOptions, SqlitePreset, Storage, SyncPolicy, TruncationCause, Writer, WriterError,
    WriterOptions, check, reindex,
};
use downbeat_msgs::encoding::Schema;
use rusqlite::types::Value;
use rusqlite::{Connection, OpenFlags};

use crate::interrupted::{BAG, child, kill, say, wait_for, write_flush_and_go_on};
use crate::python::read_with_python;
use crate::support::{fixture, messages, number, topic, value, write_numbers};

const PRESETS: [SqlitePreset; 2] = [SqlitePreset::None, SqlitePreset::Resilient];

fn options() -> WriterOptions {
    WriterOptions::new().storage(SqliteOptions::default())
}

fn open(file: &Path) -> Connection {
    Connection::open_with_flags(file, OpenFlags::SQLITE_OPEN_READ_ONLY).unwrap()
}

fn rows(database: &Connection, query: &str) -> Vec<Vec<Value>> {
    let mut statement = database.prepare(query).unwrap();
    let columns = statement.column_count();
    let row = |row: &rusqlite::Row<'_>| (0..columns).map(|column| row.get(column)).collect();
    statement.query_map([], row).unwrap().map(Result::unwrap).collect()
}

fn read(bag: &Path) -> Vec<i64> {
    messages(&Reader::open(bag).unwrap()).iter().map(value).collect()
}

fn file_names(bag: &Path) -> Vec<String> {
    let entries = fs::read_dir(bag).unwrap();
    let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// Records the real recorder's bag again with our writer, with topics and messages in the same order.
fn record_again(directory: &Path, preset: SqlitePreset) {
    let real = fixture("jazzy_sqlite3");
    let reader = Reader::open(&real).unwrap();
    let database = open(&real.join("jazzy_sqlite3_0.db3"));
    let mut writer = WriterOptions::new().storage(preset.options()).create(directory).unwrap();
    let mut ids = BTreeMap::new();
    for row in rows(&database, "SELECT id, name FROM topics ORDER BY id") {
        let [Value::Integer(row), Value::Text(name)] = row.as_slice() else { panic!("{row:?}") };
        let id = reader.topic(name).unwrap();
        ids.insert(*row, writer.add_topic(reader.topics()[id.index()].info.clone()).unwrap());
    }
    for row in rows(&database, "SELECT topic_id, timestamp, data FROM messages ORDER BY id") {
        let [Value::Integer(topic), Value::Integer(time), Value::Blob(data)] = row.as_slice() else {
            panic!("{row:?}")
        };
        writer.write(ids[topic], *time, *time, data).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn the_database_equals_that_of_the_real_recorder() {
    let real = open(&fixture("jazzy_sqlite3").join("jazzy_sqlite3_0.db3"));
    for preset in PRESETS {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("jazzy_sqlite3");
        record_again(&bag, preset);
        assert_eq!(file_names(&bag), ["jazzy_sqlite3_0.db3", FILE_NAME], "there is no other file");
        let ours = open(&bag.join("jazzy_sqlite3_0.db3"));
        for query in [
            "SELECT type, name, tbl_name, rootpage, sql FROM sqlite_master",
            "SELECT * FROM schema",
            "SELECT * FROM topics ORDER BY id",
            "SELECT * FROM message_definitions ORDER BY id",
            "SELECT * FROM messages ORDER BY id",
            "SELECT * FROM metadata WHERE id = 1",
            "SELECT id, metadata_version FROM metadata",
            "PRAGMA user_version",
            "PRAGMA application_id",
            "PRAGMA schema_version",
            "PRAGMA journal_mode",
            "PRAGMA page_size",
            "PRAGMA encoding",
            "PRAGMA auto_vacuum",
            "PRAGMA integrity_check",
        ] {
            // Not `assert_eq`, which would print all messages.
            assert!(rows(&ours, query) == rows(&real, query), "{preset:?}: {query}");
        }
        // The real recorder's order of topics is that of a hash table.
        let by_name = |mut metadata: Metadata| {
            metadata.topics.sort_by(|one, other| one.name.cmp(&other.name));
            metadata
        };
        let yaml = |bag: &Path| by_name(Metadata::read(&bag.join(FILE_NAME)).unwrap());
        assert_eq!(yaml(&bag), yaml(&fixture("jazzy_sqlite3")), "{preset:?}");
        let last = |database: &Connection| {
            let query = "SELECT metadata FROM metadata WHERE id = 2";
            let text: String = database.query_row(query, [], |row| row.get(0)).unwrap();
            by_name(Metadata::parse_record(&text, &bag).unwrap())
        };
        assert_eq!(last(&ours), last(&real), "{preset:?}");
    }
}

#[test]
fn other_software_reads_every_message_and_every_byte() {
    let expected = messages(&Reader::open(fixture("jazzy_sqlite3")).unwrap());
    let Some(of_real) = read_with_python("read_sqlite.py", &fixture("jazzy_sqlite3")) else { return };
    for preset in PRESETS {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("jazzy_sqlite3");
        record_again(&bag, preset);
        let found = read_with_python("read_sqlite.py", &bag).unwrap();
        assert_eq!(found, of_real, "{preset:?}: types, counts, hashes and all bytes");
        assert_eq!(found["decoded"], expected.len());
        assert_eq!(
            found["sqlite3"],
            serde_json::json!({
                "messages": found["rosbags"]["messages"],
                "digest": found["rosbags"]["digest"],
            })
        );
    }
}

#[test]
fn a_bag_split_by_size_is_read_by_others_and_by_us() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let limits = SplitLimits { max_bytes: Some(100_000), ..SplitLimits::NONE };
    let mut writer = options().split(limits).chunk_size(5000).create(&bag).unwrap();
    write_numbers(&mut writer, 10_000);
    let summary = writer.finish().unwrap();

    let metadata = Metadata::read(&bag.join(FILE_NAME)).unwrap();
    assert!(metadata.files.len() > 3, "{}", metadata.files.len());
    let names: Vec<_> = (0..metadata.files.len()).map(|number| format!("bag_{number}.db3")).collect();
    assert_eq!(metadata.relative_file_paths, names);
    assert_eq!(file_names(&bag), [names.as_slice(), &[FILE_NAME.to_owned()]].concat());
    assert_eq!(metadata.storage_identifier, "sqlite3");
    let (mut next, mut bytes) = (0, 0);
    for file in &metadata.files {
        let size = fs::metadata(bag.join(&file.path)).unwrap().len();
        assert!((90_000..125_000).contains(&size) || next + file.message_count == 10_000, "{size}");
        assert_eq!(file.starting_time, next as i64 * 1_000_000, "{}", file.path);
        assert_eq!(read(&bag.join(&file.path)).len() as u64, file.message_count);
        next += file.message_count;
        bytes += size;
    }
    assert_eq!(summary.bytes, bytes);
    assert_eq!(read(&bag), (0..10_000).collect::<Vec<_>>());
    let Some(found) = read_with_python("read_sqlite.py", &bag) else { return };
    assert_eq!(found["rosbags"]["counts"]["/numbers"], 10_000);
    assert_eq!((&found["decoded"], &found["sqlite3"]["messages"]), (&10_000.into(), &10_000.into()));
    assert_eq!(found["rosbags"]["digest"], found["sqlite3"]["digest"]);
}

#[test]
fn the_oldest_file_is_deleted_when_there_would_be_too_many() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = options().max_bag_files(NonZeroUsize::new(2).unwrap()).create(&bag).unwrap();
    let id = writer.add_topic(topic("/numbers")).unwrap();
    for file in 0..4 {
        for n in file * 10..file * 10 + 10 {
            writer.write(id, 1_000_000 * n, 1_000_000 * n, &number(n)).unwrap();
        }
        if file < 3 {
            writer.split().unwrap();
        }
    }
    assert_eq!(writer.finish().unwrap().deleted, 20);
    assert_eq!(file_names(&bag), ["bag_2.db3", "bag_3.db3", FILE_NAME]);
    assert_eq!(read(&bag), (20..40).collect::<Vec<_>>());
}

#[test]
fn child_commits_and_goes_on() {
    let Some(bag) = std::env::var_os(BAG) else { return };
    write_flush_and_go_on(options(), bag.as_ref());
}

#[test]
fn a_killed_recording_is_readable_up_to_the_last_transaction() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut child = child("sqlite::child_commits_and_goes_on", &bag, None).spawn().unwrap();
    wait_for(&mut child, "1100 written");
    kill(child);

    let reader = Reader::open(&bag).unwrap();
    assert_eq!(messages(&reader).iter().map(value).collect::<Vec<_>>(), (0..1000).collect::<Vec<_>>());
    let causes: Vec<_> = reader.truncation().map(|truncation| truncation.cause.clone()).collect();
    assert_eq!(causes, [TruncationCause::NotEnded]);
    let report = check(&reader, |_| {}).unwrap();
    assert!(matches!(report.problems[0], Problem::Truncated(_)), "{:?}", report.problems);
    assert_eq!(Metadata::read(&bag.join(FILE_NAME)).unwrap().topics[0].name, "/numbers");
    drop(reader);

    // Copying the bag, or opening the database for writing, completes it.
    let bags = [Reader::open(&bag).unwrap()];
    let target = options().create(folder.path().join("repaired")).unwrap();
    Copy::of(&bags, |_| true).unwrap().into_writer(target, |_| {}).unwrap();
    let repaired = Reader::open(folder.path().join("repaired")).unwrap();
    assert_eq!(messages(&repaired), messages(&bags[0]));
    assert_eq!(check(&repaired, |_| {}).unwrap().problems, []);
    drop(bags);
    Connection::open(bag.join("bag_0.db3")).unwrap().execute_batch("PRAGMA journal_mode=DELETE").unwrap();
    assert_eq!(file_names(&bag), ["bag_0.db3", FILE_NAME]);
    assert_eq!(reindex(&bag).unwrap().message_count, 1000);
    assert_eq!(Reader::open(&bag).unwrap().truncation().count(), 0);
}

#[test]
fn child_commits_without_end() {
    let Some(bag) = std::env::var_os(BAG) else { return };
    let recording = Recording::start(options().chunk_size(4096).create(bag).unwrap(), 100_000).unwrap();
    let sender = recording.sender();
    let id = sender.add_topic(topic("/numbers")).unwrap();
    for n in 0.. {
        sender.record_blocking(id, n, n, number(n).into()).unwrap();
        // Queued messages and the open transaction are not in the file yet.
        if n % 1000 == 0 && recording.statistics().summary.message_count() >= 20_000 {
            say("20000 in the file");
        }
    }
}

#[test]
fn a_recording_killed_during_a_commit_is_intact_for_every_reader() {
    for _ in 0..5 {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("bag");
        let mut child = child("sqlite::child_commits_without_end", &bag, None).spawn().unwrap();
        wait_for(&mut child, "20000 in the file");
        kill(child);
        let found = read(&bag);
        assert!(found.len() >= 20_000, "{}", found.len());
        assert_eq!(found, (0..found.len() as i64).collect::<Vec<_>>(), "without gaps");
        // Opened like any SQLite database.
        let database = Connection::open(bag.join("bag_0.db3")).unwrap();
        assert_eq!(rows(&database, "PRAGMA integrity_check"), [[Value::Text("ok".to_owned())]]);
        let count = Value::Integer(found.len() as i64);
        assert_eq!(rows(&database, "SELECT count(*) FROM messages"), [[count]]);
    }
}

/// `rosbags` opens only the file, as immutable.
#[test]
fn the_file_without_its_log_has_the_tables_at_once_and_messages_a_second_later() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = options().create(&bag).unwrap();
    let alone = folder.path().join("alone.db3");
    let count = || {
        fs::copy(bag.join("bag_0.db3"), &alone).unwrap();
        Reader::open(&alone).unwrap().message_count()
    };
    assert_eq!(count(), 0);
    let id = writer.add_topic(topic("/numbers")).unwrap();
    let start = std::time::Instant::now();
    let mut n = 0;
    while count() == 0 {
        assert!(start.elapsed() < Duration::from_secs(60), "the log is not moved");
        writer.write(id, n, n, &number(n)).unwrap();
        writer.flush().unwrap();
        n += 1;
    }
    assert_eq!(count(), n as u64, "everything written so far");
    writer.finish().unwrap();
}

#[test]
fn a_bag_can_be_read_while_it_is_written_and_readers_do_not_prevent_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = options().create(&bag).unwrap();
    write_numbers(&mut writer, 100);
    writer.flush().unwrap();
    assert_eq!(read(&bag), (0..100).collect::<Vec<_>>());
    let reading = open(&bag.join("bag_0.db3"));
    reading.execute_batch("BEGIN").unwrap();
    assert_eq!(rows(&reading, "SELECT count(*) FROM messages"), [[Value::Integer(100)]]);
    let id = writer.add_topic(topic("/numbers")).unwrap();
    for n in 100..200 {
        writer.write(id, 1_000_000 * n, 1_000_000 * n, &number(n)).unwrap();
    }
    writer.finish().unwrap();
    assert_eq!(rows(&reading, "SELECT count(*) FROM messages"), [[Value::Integer(100)]], "as it began");
    assert_eq!(read(&bag), (0..200).collect::<Vec<_>>());
    drop(reading);
    assert_eq!(read(&bag), (0..200).collect::<Vec<_>>());
}

#[test]
fn nothing_but_publish_times_is_lost_from_mcap_to_sqlite_and_back() {
    let folder = tempfile::tempdir().unwrap();
    let first = [Reader::open(fixture("jazzy_mcap")).unwrap()];
    let copy = |bags: &[Reader], name: &str, options: WriterOptions| {
        let target = options.create(folder.path().join(name)).unwrap();
        let copied = Copy::of(bags, |_| true).unwrap().into_writer(target, |_| {}).unwrap();
        assert_eq!(copied.unreadable.len(), 0);
        (Reader::open(folder.path().join(name)).unwrap(), copied.without_publish_time)
    };
    let (database, lost) = copy(&first, "database", options());
    let differ = |message: &&BagMessage| message.log_time != message.publish_time;
    assert_eq!(lost, messages(&first[0]).iter().filter(differ).count() as u64);
    assert!(lost > 100, "{lost}");
    assert_eq!((database.storage(), database.storage_identifier()), (Storage::Sqlite3, "sqlite3"));
    let database = [database];
    let (again, lost) = copy(&database, "again", WriterOptions::new());
    assert_eq!(lost, 0);
    let mut expected = messages(&first[0]);
    for message in &mut expected {
        message.publish_time = message.log_time;
    }
    for reader in [&database[0], &again] {
        assert_eq!(messages(reader), expected);
        assert_eq!(portable(reader), portable(&first[0]));
    }
}

/// The topics of a bag, without the definitions of service events: they are written as IDL, without comments.
/// The hash says that they mean the same.
fn portable(reader: &Reader) -> Vec<RecordedTopic> {
    let mut topics = reader.topics().to_vec();
    for topic in topics.iter_mut().filter(|topic| topic.info.type_name.contains("/srv/")) {
        assert!(!topic.info.definition.is_empty() && !topic.info.type_hash.is_empty());
        topic.info.definition.clear();
    }
    topics
}

#[test]
fn unsupported_schemas_are_refused_and_supported_ones_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = options().create(folder.path().join("bag")).unwrap();
    let with = |name: &str, message_encoding: &str, encoding: &str, schema: &str, data: &[u8]| {
        let schema = Schema { name: schema.to_owned(), encoding: encoding.to_owned(), data: data.to_vec() };
        let message_encoding = message_encoding.to_owned();
        let mut info = topic(name);
        info.definition = String::new();
        info.format = Some(MessageFormat { message_encoding, schema });
        info
    };
    let named = with("/a", "protobuf", "protobuf", "std_msgs.msg.Int64", b"");
    let error = writer.add_topic(named).unwrap_err();
    assert!(matches!(&error, WriterError::NoPlace { storage: Storage::Sqlite3, .. }), "{error}");
    assert!(error.to_string().contains("record it in the storage mcap"), "{error}");
    let binary = with("/a", "flatbuffer", "flatbuffer", "std_msgs/msg/Int64", &[0xff, 0xfe]);
    assert!(writer.add_topic(binary).unwrap_err().to_string().contains("is not text"));

    let mut kept = [
        with("/json", "json", "jsonschema", "std_msgs/msg/Int64", b"{}"),
        topic("/plain"),
        topic("/unknown"),
    ];
    kept[1].type_name = "std_msgs/msg/UInt64".to_owned();
    (kept[2].type_name, kept[2].definition) = ("my_msgs/msg/Odd".to_owned(), String::new());
    for info in &kept {
        writer.add_topic(info.clone()).unwrap();
    }
    writer.finish().unwrap();
    let reader = Reader::open(folder.path().join("bag")).unwrap();
    assert_eq!(reader.topics().iter().map(|topic| &topic.info).collect::<Vec<_>>(), kept.each_ref());
}

#[test]
fn unsupported_options_are_refused_before_anything_is_created() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let error = options().compression(Compression::Zstd).create(&bag).err().unwrap().to_string();
    assert!(error.starts_with("the storage sqlite3 does not support compression"), "{error}");
    let limits = SplitLimits { max_bytes: Some(86_015), ..SplitLimits::NONE };
    let error = options().split(limits).create(&bag).err().unwrap();
    assert!(matches!(error, WriterError::SplitSize { bytes: 86_015, least: 86_016 }), "{error}");
    assert!(!bag.exists());
    options().compression(Compression::None).create(&bag).unwrap();
}

#[test]
fn pragmas_of_a_config_file_take_effect_and_unknown_ones_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let create = |name: &str, text: &str| -> Result<Writer, WriterError> {
        let storage = SqliteOptions::default().with_config(text, "s.yaml".as_ref()).unwrap();
        WriterOptions::new().storage(storage).sync(SyncPolicy::Chunks).create(folder.path().join(name))
    };
    let mut writer = create("large", "write:\n  pragmas: [\"page_size = 16384\"]\n").unwrap();
    write_numbers(&mut writer, 10);
    writer.finish().unwrap();
    let database = open(&folder.path().join("large/large_0.db3"));
    assert_eq!(rows(&database, "PRAGMA page_size"), [[Value::Integer(16384)]]);
    assert_eq!(read(&folder.path().join("large")), (0..10).collect::<Vec<_>>());
    for wrong in ["no_such_pragma = 1", "schema.cache_size = 1000"] {
        let text = format!("write:\n  pragmas: [\"{wrong}\"]\n");
        let error = create(&wrong.replace(['.', ' ', '='], "_"), &text).err().unwrap().to_string();
        assert!(error.contains("_0.db3") && error.contains(wrong), "{error}");
    }
}

#[test]
fn messages_before_1970_are_left_out_and_reported() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = options().create(&bag).unwrap();
    let id = writer.add_topic(topic("/numbers")).unwrap();
    for n in 0..10 {
        writer.write(id, 1000 + n, 1000 + n, &number(n)).unwrap();
    }
    writer.finish().unwrap();
    let database = Connection::open(bag.join("bag_0.db3")).unwrap();
    // One between others, and the first of all.
    database.execute("UPDATE messages SET timestamp = -5 WHERE id IN (1, 4)", []).unwrap();
    drop(database);
    let reader = Reader::open(&bag).unwrap();
    assert_eq!(reader.start_time(), Some(1001));
    for from in [i64::MIN, 1000, 1005] {
        let (mut read, mut problems) = (Vec::new(), Vec::new());
        for item in reader.messages(Selection::all().from(from)).unwrap() {
            match item {
                Ok(message) => read.push((message.log_time, value(&message))),
                Err(error) => problems.push(error.to_string()),
            }
        }
        let expected = (0..10).filter(|n| ![0, 3].contains(n) && 1000 + n >= from);
        assert_eq!(read, expected.map(|n| (1000 + n, n)).collect::<Vec<_>>());
        assert_eq!(problems.len(), 1, "{problems:?}");
        assert!(problems[0].contains("times before 1970"), "{problems:?}");
        assert!(problems[0].ends_with("the log time -5 and the publish time -5"), "{problems:?}");
    }
    let target = WriterOptions::new().create(folder.path().join("copy")).unwrap();
    let copied = Copy::of(&[reader], |_| true).unwrap().into_writer(target, |_| {}).unwrap();
    assert_eq!((copied.summary.message_count(), copied.unreadable.len()), (8, 1));
}
