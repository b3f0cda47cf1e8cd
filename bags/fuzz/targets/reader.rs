//! A bag file of any bytes is read to its end: there may be errors, but no panic and no end
//! of memory.

use std::cell::RefCell;
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;

use downbeat_bags::metadata::{Metadata, qos_from_yaml};
use downbeat_bags::{BagInfo, Reader, Selection, check};
use tempfile::NamedTempFile;

thread_local! {
    // One file that is written anew costs less than one for each run.
    static FILE: RefCell<NamedTempFile> =
        RefCell::new(tempfile::Builder::new().suffix(".mcap").tempfile().expect("a temporary file"));
}

/// One run.
pub fn run(bytes: &[u8]) {
    FILE.with_borrow_mut(|file| {
        let written = file
            .as_file_mut()
            .set_len(0)
            .and_then(|()| file.seek(SeekFrom::Start(0)))
            .and_then(|_| file.write_all(bytes));
        written.expect("a temporary file is written");
        read(file.path());
    });
    if let Ok(text) = std::str::from_utf8(bytes) {
        let path = Path::new("metadata.yaml");
        if let Ok(metadata) = Metadata::parse(text, path) {
            let again = Metadata::parse(&metadata.to_yaml(), path);
            assert_eq!(again.map(|again| again.topics.len()).ok(), Some(metadata.topics.len()));
        }
        let _ = qos_from_yaml(text, path);
    }
}

fn read(path: &Path) {
    let Ok(reader) = Reader::open(path) else { return };
    if let Ok(messages) = reader.messages(Selection::all()) {
        // By time, whatever the file tells of its chunks.
        let topics = reader.topics().len();
        assert!(messages.flatten().all(|message| message.topic.index() < topics));
    }
    let middle = reader.start_time().unwrap_or(0) / 2 + reader.end_time().unwrap_or(0) / 2;
    if let Ok(messages) = reader.messages(Selection::all().from(middle)) {
        assert!(messages.flatten().all(|message| message.log_time >= middle));
    }
    let _ = BagInfo::of(&reader).map(|info| info.to_string());
    let _ = check(&reader, |_| {});
}
