//! Recordings that are killed, or run into a full disk.
//!
//! The recorder runs in a child process: this test program, controlled by an environment variable.

use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use bytes::Bytes;
use downbeat_bags::metadata::{FILE_NAME, Metadata};
use downbeat_bags::{Reader, Recording, TruncationCause, WriterError, WriterOptions};

use crate::support::{messages, number, topic, value, write_numbers};

pub const BAG: &str = "DOWNBEAT_TEST_BAG";

pub fn child(test: &str, bag: &Path, launcher: Option<&str>) -> Command {
    let program = std::env::current_exe().unwrap();
    let mut command = match launcher {
        None => Command::new(program),
        Some(script) => {
            let mut shell = Command::new("sh");
            shell.arg("-c").arg(format!("{script} exec \"$0\" \"$@\"")).arg(program);
            shell
        }
    };
    command.args(["--exact", test, "--nocapture", "--test-threads=1"]).env(BAG, bag);
    command.stdin(Stdio::piped()).stdout(Stdio::piped());
    command
}

/// Reads the child's output until a line contains `mark`.
pub fn wait_for(child: &mut Child, mark: &str) {
    let output = BufReader::new(child.stdout.as_mut().unwrap());
    let found = output.lines().any(|line| line.unwrap().contains(mark));
    assert!(found, "the child ended before it printed {mark}");
}

/// In the child: prints a progress mark for the parent.
pub fn say(mark: &str) {
    let mut output = std::io::stdout().lock();
    writeln!(output, "{mark}").unwrap();
    output.flush().unwrap();
}

/// In the child: waits until it is killed, or its parent has exited.
pub fn stay() {
    let _ = std::io::stdin().read_to_end(&mut Vec::new());
}

pub fn kill(mut child: Child) {
    child.kill().unwrap(); // SIGKILL
    let status = child.wait().unwrap();
    assert!(!status.success());
}

#[test]
fn child_records_flushes_and_goes_on() {
    let Some(bag) = std::env::var_os(BAG) else { return };
    write_flush_and_go_on(WriterOptions::new(), bag.as_ref());
}

/// Writes 1000 flushed messages and 100 that are not, prints a mark, and waits to be killed.
pub fn write_flush_and_go_on(options: WriterOptions, bag: &Path) {
    let mut writer = options.flush_interval(std::time::Duration::MAX).create(bag).unwrap();
    write_numbers(&mut writer, 1000);
    writer.flush().unwrap();
    let id = writer.add_topic(topic("/numbers")).unwrap();
    for n in 1000..1100 {
        writer.write(id, 1_000_000 * n, 1_000_000 * n, &number(n)).unwrap();
    }
    say("1100 written");
    stay();
}

#[test]
fn a_killed_recording_is_readable_up_to_the_last_written_chunk() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut child = child("interrupted::child_records_flushes_and_goes_on", &bag, None).spawn().unwrap();
    wait_for(&mut child, "1100 written");
    kill(child);

    let reader = Reader::open(&bag).unwrap();
    let read: Vec<i64> = messages(&reader).iter().map(value).collect();
    assert_eq!(read, (0..1000).collect::<Vec<_>>());
    let causes: Vec<_> = reader.truncation().map(|truncation| truncation.cause.clone()).collect();
    assert_eq!(causes, [TruncationCause::NoEnd]);
    let metadata = Metadata::read(&bag.join(FILE_NAME)).unwrap();
    assert_eq!(metadata.topics[0].name, "/numbers", "other programs find the topic in metadata.yaml");
}

#[test]
fn child_records_without_end() {
    let Some(bag) = std::env::var_os(BAG) else { return };
    let writer = WriterOptions::new().chunk_size(4096).create(bag).unwrap();
    let recording = Recording::start(writer, 100_000).unwrap();
    let sender = recording.sender();
    let id = sender.add_topic(topic("/numbers")).unwrap();
    for n in 0.. {
        sender.record_blocking(id, n, n, Bytes::from(number(n))).unwrap();
        // Queued messages and the open chunk are not in the file yet.
        if n % 1000 == 0 && recording.statistics().summary.message_count() >= 5000 {
            say("5000 in the file");
        }
    }
}

#[test]
fn a_recording_killed_while_writing_keeps_every_complete_chunk() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut child = child("interrupted::child_records_without_end", &bag, None).spawn().unwrap();
    wait_for(&mut child, "5000 in the file");
    kill(child);

    let reader = Reader::open(&bag).unwrap();
    let read: Vec<i64> = messages(&reader).iter().map(value).collect();
    assert!(read.len() >= 5000, "{}", read.len());
    assert_eq!(read, (0..read.len() as i64).collect::<Vec<_>>(), "without gaps");
    assert_eq!(reader.truncation().count(), 1);
}

#[test]
fn child_fills_the_disk() {
    let Some(bag) = std::env::var_os(BAG) else { return };
    let writer = WriterOptions::new().chunk_size(4096).create(&bag).unwrap();
    let recording = Recording::start(writer, 100_000).unwrap();
    let sender = recording.sender();
    let id = sender.add_topic(topic("/numbers")).unwrap();
    let mut offered = 0;
    while sender.record_blocking(id, offered, offered, Bytes::from(number(offered))).is_ok() {
        offered += 1;
    }
    let failed = recording.finish().unwrap_err();
    assert!(matches!(failed.error, WriterError::Write { .. }), "{failed}");
    let text = failed.to_string();
    assert!(text.contains("bag_0.mcap") && text.contains("messages written before are kept"), "{text}");
    // The last message, which was refused, was offered too.
    let total = failed.summary.message_count() + failed.summary.lost_count();
    assert_eq!(total, offered as u64 + 1, "every message is either written or counted as lost");
    say(&format!("kept {}", failed.summary.message_count()));
}

/// A limit on the file size simulates a full disk: the write fails in the operating system.
#[cfg(unix)]
#[test]
fn a_full_disk_is_reported_once_and_written_messages_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let limit = "trap '' XFSZ; ulimit -f 100;"; // 100 blocks of 512 bytes
    let mut child = child("interrupted::child_fills_the_disk", &bag, Some(limit));
    let output = child.output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    let kept: i64 = text.lines().find_map(|line| line.split_once("kept ")).unwrap().1.trim().parse().unwrap();
    assert!(kept > 100);

    let reader = Reader::open(&bag).unwrap();
    let read: Vec<i64> = messages(&reader).iter().map(value).collect();
    assert_eq!(read, (0..kept).collect::<Vec<_>>());
    assert_eq!(reader.truncation().count(), 0, "the file was finished after its last complete chunk");
    assert_eq!(Metadata::read(&bag.join(FILE_NAME)).unwrap().message_count, kept as u64);
}
