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

use rusqlite::{Connection, Error, ErrorCode, OpenFlags, ffi};

use super::SqliteOptions;
use super::config::Pragma;
use super::tables::{self, InsertMessage, TopicRows};
use super::transaction::{Message, OpenTransaction};
use crate::topic::TopicInfo;
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
    ) -> io::Result<Self> {
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE
            | OpenFlags::SQLITE_OPEN_CREATE
            | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let mut connection = Connection::open_with_flags(path, flags).map_err(failure)?;
        for pragma in options.pragmas(sync) {
            set(&connection, &pragma)?;
        }
        let transaction = connection.transaction().map_err(failure)?;
        tables::create(&transaction).and_then(|()| transaction.commit()).map_err(failure)?;
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
    pub(in crate::writer) fn refusal(topic: &TopicInfo) -> Option<String> {
        tables::refusal(topic)
    }

    /// Returns the number of the topic, counted from 1. It is written with the next transaction.
    pub(in crate::writer) fn add_topic(&mut self, topic: &TopicInfo) -> io::Result<u16> {
        self.topics.push(TopicRows::of(topic));
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
                tables::insert_topic(&transaction, u16::try_from(index + 1).unwrap_or(u16::MAX), topic)?;
            }
            if !self.transaction.is_empty() {
                let mut insert = InsertMessage::prepare(&transaction)?;
                self.transaction.messages().try_for_each(|message| insert.insert(message))?;
            }
            if let Some(text) = metadata {
                tables::insert_metadata(&transaction, text)?;
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
