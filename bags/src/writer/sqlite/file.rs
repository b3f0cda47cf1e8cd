//! One SQLite file, written in complete transactions.
//!
//! A transaction is collected in memory and written at once by [`SqliteFile::flush`]. With the preset
//! `resilient`, SQLite appends it to a write-ahead log beside the file (`-wal`), and moves the log into the
//! file about once a second: programs that open the file through SQLite see both, others only what has been
//! moved. A finished file contains everything, in the same form as with rosbag2, and has no log.

use std::fs::OpenOptions;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rusqlite::{CachedStatement, Connection, Error, ErrorCode, OpenFlags, Result, ffi};

use super::SqliteOptions;
use super::options::Pragma;
use crate::metadata;
use crate::topic::TopicDescription;
use crate::writer::SyncPolicy;

pub(in crate::writer) struct SqliteFile {
    path: PathBuf,
    /// `None` once it is finished.
    connection: Option<Connection>,
    sync: SyncPolicy,
    page_size: u64,
    /// Size of the database, including the log.
    kept: u64,
    /// Those before `topics_in_file` are in the file.
    topics: Vec<TopicRows>,
    topics_in_file: usize,
    transaction: OpenTransaction,
    /// When the log was last moved into the file.
    moved: Instant,
}

/// The minimum time between moving the log into the file.
const MOVE_INTERVAL: Duration = Duration::from_secs(1);
/// How long finishing a file waits for readers.
const READER_PATIENCE: Duration = Duration::from_millis(500);

impl SqliteFile {
    pub(in crate::writer) fn create(
        path: &Path,
        options: &SqliteOptions,
        sync: SyncPolicy,
        ros_distro: &str,
    ) -> io::Result<Self> {
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE
            | OpenFlags::SQLITE_OPEN_CREATE
            | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let mut connection = Connection::open_with_flags(path, flags).map_err(failure)?;
        for pragma in options.pragmas(sync) {
            set(&connection, &pragma)?;
        }
        let transaction = connection.transaction().map_err(failure)?;
        create(&transaction, ros_distro).and_then(|()| transaction.commit()).map_err(failure)?;
        let page_size = pragma_number(&connection, "page_size").map_err(failure)?;
        let mut file = Self {
            path: path.to_owned(),
            connection: Some(connection),
            sync,
            page_size,
            kept: 0,
            topics: Vec::new(),
            topics_in_file: 0,
            transaction: OpenTransaction::default(),
            moved: Instant::now(),
        };
        file.measure().map_err(failure)?;
        Ok(file)
    }

    pub(in crate::writer) fn path(&self) -> &Path {
        &self.path
    }

    /// Size of the database in bytes.
    pub(in crate::writer) fn kept(&self) -> u64 {
        self.kept
    }

    /// Size of the open transaction.
    pub(in crate::writer) fn open_bytes(&self) -> u64 {
        self.transaction.bytes()
    }

    /// Why the tables cannot represent a topic, if so.
    pub(in crate::writer) fn refusal(topic: &TopicDescription) -> Option<String> {
        refusal(topic)
    }

    /// Returns the number of the topic, counted from 1. It is written with the next transaction.
    pub(in crate::writer) fn add_topic(
        &mut self,
        topic: &TopicDescription,
        metadata_version: u32,
    ) -> io::Result<u16> {
        self.topics.push(TopicRows::of(topic, metadata_version));
        u16::try_from(self.topics.len()).map_err(|_| io::Error::other("too many topics"))
    }

    pub(in crate::writer) fn write(&mut self, topic: u16, log_time: u64, data: &[u8]) {
        // Times were converted from signed ones.
        let time = i64::try_from(log_time).unwrap_or(i64::MAX);
        self.transaction.add(Message { topic, time, data });
    }

    /// Commits the open transaction, and topics that are not in the file yet. If that fails, it is rolled
    /// back and still open.
    pub(in crate::writer) fn flush(&mut self) -> io::Result<()> {
        if self.transaction.is_empty() && self.topics_in_file == self.topics.len() {
            return Ok(());
        }
        self.commit(None)?;
        self.transaction.clear();
        if self.moved.elapsed() >= MOVE_INTERVAL {
            self.move_log();
        }
        Ok(())
    }

    /// Drops the open transaction after a failed flush.
    pub(in crate::writer) fn drop_chunk(&mut self) -> io::Result<()> {
        self.transaction.clear();
        Ok(())
    }

    /// Adds a row of metadata, like rosbag2 when it opens and finishes a file, and commits the open
    /// transaction.
    pub(in crate::writer) fn write_metadata(&mut self, text: String) -> io::Result<()> {
        self.commit(Some(&text))?;
        self.transaction.clear();
        // So that programs that do not read the log find the tables.
        self.move_log();
        Ok(())
    }

    /// Finishes the file and syncs it to disk, unless the policy is not to.
    pub(in crate::writer) fn finish(&mut self) -> io::Result<()> {
        self.flush()?;
        self.end()?;
        match self.sync {
            SyncPolicy::Never => Ok(()),
            SyncPolicy::Files | SyncPolicy::Chunks => {
                OpenOptions::new().write(true).open(&self.path)?.sync_all()
            }
        }
    }

    /// After a failed write: closes the file after its last transaction. If there is no room to move the log
    /// into the file, the log is kept and read with it.
    pub(in crate::writer) fn give_up(&mut self) -> io::Result<()> {
        self.transaction.clear();
        // Fails for the same reason, which is being reported.
        let _ = self.end();
        Ok(())
    }

    fn commit(&mut self, metadata: Option<&str>) -> io::Result<()> {
        let connection = open(&mut self.connection)?;
        let mut insert_all = || -> Result<(), Error> {
            // Rolled back if something fails.
            let transaction = connection.transaction()?;
            for (index, topic) in self.topics.iter().enumerate().skip(self.topics_in_file) {
                // `add_topic` has checked the number.
                insert_topic(&transaction, u16::try_from(index + 1).unwrap_or(u16::MAX), topic)?;
            }
            if !self.transaction.is_empty() {
                let mut insert = InsertMessage::prepare(&transaction)?;
                self.transaction.messages().try_for_each(|message| insert.insert(message))?;
            }
            if let Some(text) = metadata {
                insert_metadata(&transaction, text)?;
            }
            transaction.commit()
        };
        insert_all().map_err(failure)?;
        self.topics_in_file = self.topics.len();
        self.measure().map_err(failure)
    }

    fn measure(&mut self) -> Result<(), Error> {
        if let Some(connection) = &self.connection {
            self.kept = pragma_number(connection, "page_count")?.saturating_mul(self.page_size);
        }
        Ok(())
    }

    /// Moves the log into the file, as far as readers permit. Does nothing without a log.
    fn move_log(&mut self) {
        self.moved = Instant::now();
        if let Some(connection) = &self.connection {
            // The rest stays in the log.
            let _ = connection.query_row("PRAGMA wal_checkpoint(PASSIVE)", [], |_| Ok(()));
        }
    }

    /// Moves the log into the file, disables it, and closes the file.
    fn end(&mut self) -> io::Result<()> {
        self.move_log();
        let Some(connection) = self.connection.take() else { return Ok(()) };
        let without_log = connection
            .busy_timeout(READER_PATIENCE)
            .and_then(|()| connection.query_row("PRAGMA journal_mode=DELETE", [], |_| Ok(())));
        let closed = connection.close().map_err(|(_, error)| error);
        match without_log.and(closed) {
            // Readers need the log, so it is kept.
            Err(error) if is_busy(&error) => Ok(()),
            ended => ended.map_err(failure),
        }
    }
}

fn open(connection: &mut Option<Connection>) -> io::Result<&mut Connection> {
    connection.as_mut().ok_or_else(|| io::Error::other("the file is finished"))
}

/// Applies a setting, and checks that SQLite knows it, like rosbag2.
fn set(connection: &Connection, pragma: &Pragma) -> io::Result<()> {
    let Pragma { name, statement } = pragma;
    let wrong =
        |found: String| io::Error::other(format!("the pragma \"{statement}\" cannot be set: {found}"));
    let run = |text: &str| -> Result<bool, Error> {
        let mut prepared = connection.prepare(&format!("PRAGMA {text};"))?;
        let mut rows = prepared.query([])?;
        Ok(rows.next()?.is_some())
    };
    run(statement).map_err(|error| wrong(error.to_string()))?;
    match run(name) {
        Ok(true) => Ok(()),
        Ok(false) => Err(wrong(format!("SQLite does not know {name}"))),
        Err(error) => Err(wrong(error.to_string())),
    }
}

fn pragma_number(connection: &Connection, name: &str) -> Result<u64, Error> {
    connection.pragma_query_value(None, name, |row| row.get(0))
}

fn is_busy(error: &Error) -> bool {
    matches!(error.sqlite_error_code(), Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked))
}

fn failure(error: Error) -> io::Error {
    // The index of the log is memory-mapped, and has a separate error if the disk is full.
    let has_no_room = match error.sqlite_error() {
        Some(error) => error.code == ErrorCode::DiskFull || error.extended_code == ffi::SQLITE_IOERR_SHMSIZE,
        None => false,
    };
    let kind = if has_no_room { io::ErrorKind::StorageFull } else { io::ErrorKind::Other };
    io::Error::new(kind, error)
}

const SCHEMA_VERSION: i64 = 4;

const CREATE: &str = "\
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY,ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY,metadata_version INTEGER NOT NULL,metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT NOT NULL,type TEXT NOT NULL,serialization_format TEXT NOT NULL,\
offered_qos_profiles TEXT NOT NULL,type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY,topic_type TEXT NOT NULL,encoding TEXT NOT NULL,\
encoded_message_definition TEXT NOT NULL,type_description_hash TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);";

/// A row of `topics`, and the row of `message_definitions` for its type.
pub(super) struct TopicRows {
    name: String,
    type_name: String,
    serialization_format: String,
    offered_qos: String,
    type_hash: String,
    encoding: String,
    definition: String,
}

impl TopicRows {
    pub(super) fn of(topic: &TopicDescription, metadata_version: u32) -> Self {
        let schema = topic.schema();
        Self {
            name: topic.name.clone(),
            type_name: topic.type_name.clone(),
            serialization_format: topic.message_encoding().to_owned(),
            offered_qos: metadata::recorded_qos_to_yaml(&topic.offered_qos, metadata_version),
            type_hash: topic.type_hash.clone(),
            encoding: schema.encoding,
            // Schemas that are not text were rejected.
            definition: String::from_utf8_lossy(&schema.data).into_owned(),
        }
    }
}

/// Why the tables cannot represent a topic, if so.
fn refusal(topic: &TopicDescription) -> Option<String> {
    let schema = topic.schema();
    if schema.name != topic.type_name {
        let (name, type_name) = (&schema.name, &topic.type_name);
        return Some(format!("the name of its schema, \"{name}\", is not that of its type {type_name}"));
    }
    std::str::from_utf8(&schema.data)
        .is_err()
        .then(|| format!("its schema, {}, is not text", schema.encoding))
}

fn create(connection: &Connection, ros_distro: &str) -> Result<()> {
    connection.execute_batch(CREATE)?;
    let insert = "INSERT INTO schema (schema_version, ros_distro) VALUES (?, ?)";
    connection.execute(insert, (SCHEMA_VERSION, ros_distro)).map(drop)
}

/// The topic's number is the one that SQLite would assign. Each type is described once.
fn insert_topic(connection: &Connection, id: u16, topic: &TopicRows) -> Result<()> {
    let insert = "INSERT INTO topics (id, name, type, serialization_format, offered_qos_profiles, type_description_hash) \
                  VALUES (?, ?, ?, ?, ?, ?)";
    connection.prepare_cached(insert)?.execute((
        id,
        &topic.name,
        &topic.type_name,
        &topic.serialization_format,
        &topic.offered_qos,
        &topic.type_hash,
    ))?;
    let known = "SELECT 1 FROM message_definitions WHERE topic_type = ?";
    if connection.prepare_cached(known)?.exists([&topic.type_name])? {
        return Ok(());
    }
    let insert = "INSERT INTO message_definitions (topic_type, encoding, encoded_message_definition, \
                  type_description_hash) VALUES (?, ?, ?, ?)";
    let row = (&topic.type_name, &topic.encoding, &topic.definition, &topic.type_hash);
    connection.prepare_cached(insert)?.execute(row).map(drop)
}

fn insert_metadata(connection: &Connection, text: &str) -> Result<()> {
    let insert = "INSERT INTO metadata (metadata_version, metadata) VALUES (?, ?)";
    connection.execute(insert, (metadata::FORMAT_VERSION, text)).map(drop)
}

/// The statement that inserts messages.
pub(super) struct InsertMessage<'a>(CachedStatement<'a>);

impl<'a> InsertMessage<'a> {
    pub(super) fn prepare(connection: &'a Connection) -> Result<Self> {
        let insert = "INSERT INTO messages (timestamp, topic_id, data) VALUES (?, ?, ?);";
        connection.prepare_cached(insert).map(Self)
    }

    pub(super) fn insert(&mut self, message: Message<'_>) -> Result<()> {
        self.0.execute((message.time, message.topic, message.data)).map(drop)
    }
}

/// A message in the open transaction.
pub(super) struct Message<'a> {
    pub(super) topic: u16,
    pub(super) time: i64,
    pub(super) data: &'a [u8],
}

/// Messages are collected in memory, so that the database is locked, and errors occur, only when they are
/// written.
#[derive(Default)]
pub(super) struct OpenTransaction {
    /// Topic, time, and end of the data.
    entries: Vec<(u16, i64, usize)>,
    data: Vec<u8>,
}

/// The size of a row besides its data, as estimated by rosbag2: three numbers.
const ROW_BYTES: usize = 3 * size_of::<i64>();

impl OpenTransaction {
    pub(super) fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// The approximate size of its rows.
    pub(super) fn bytes(&self) -> u64 {
        (self.data.len() + self.entries.len() * ROW_BYTES) as u64
    }

    pub(super) fn add(&mut self, message: Message<'_>) {
        self.data.extend_from_slice(message.data);
        self.entries.push((message.topic, message.time, self.data.len()));
    }

    pub(super) fn messages(&self) -> impl Iterator<Item = Message<'_>> {
        let mut start = 0;
        self.entries.iter().map(move |&(topic, time, end)| {
            let data = &self.data[start..end];
            start = end;
            Message { topic, time, data }
        })
    }

    /// Clears it and keeps its memory.
    pub(super) fn clear(&mut self) {
        self.entries.clear();
        self.data.clear();
    }
}
