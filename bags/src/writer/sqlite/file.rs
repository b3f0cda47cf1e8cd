//! One SQLite file that is written in whole transactions.
//!
//! A transaction is collected in memory and written at once, exactly when [`SqliteFile::flush`] says. With the preset
//! `resilient` SQLite appends it to a write-ahead log beside the file (`-wal`), from which it moves what is there into the file
//! about once a second: whoever opens the file by SQLite sees both, others what has been moved. A file that is ended has
//! everything in itself, in the form in which rosbag2 leaves it, and nothing beside it.

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
    /// None once it is ended.
    connection: Option<Connection>,
    sync: SyncPolicy,
    page_size: u64,
    /// Size of the database, what is still in the log included.
    kept: u64,
    /// Those with a number lower than `topics_in_file` are in the file.
    topics: Vec<TopicRows>,
    topics_in_file: usize,
    transaction: OpenTransaction,
    /// When the log was last moved into the file.
    moved: Instant,
}

/// The shortest time after which the log is moved into the file.
const MOVE_INTERVAL: Duration = Duration::from_secs(1);
/// How long the end of a file waits for others who read it.
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

    /// Bytes of the database.
    pub(in crate::writer) fn kept(&self) -> u64 {
        self.kept
    }

    /// Size of the open transaction.
    pub(in crate::writer) fn open_bytes(&self) -> u64 {
        self.transaction.bytes()
    }

    /// Why there is no place for what describes the messages of a topic, if there is none.
    pub(in crate::writer) fn refusal(topic: &TopicInfo) -> Option<String> {
        tables::refusal(topic)
    }

    /// Returns the number of the topic, counted from 1. It is in the file with the next transaction.
    pub(in crate::writer) fn add_topic(&mut self, topic: &TopicInfo) -> io::Result<u16> {
        self.topics.push(TopicRows::of(topic));
        u16::try_from(self.topics.len()).map_err(|_| io::Error::other("there is no place for more topics"))
    }

    pub(in crate::writer) fn write(&mut self, topic: u16, log_time: u64, data: &[u8]) {
        // Times come from signed ones.
        let time = i64::try_from(log_time).unwrap_or(i64::MAX);
        self.transaction.add(Message { topic, time, data });
    }

    /// Commits the open transaction, and topics that are not in the file yet. If that fails it is rolled back, and still open.
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

    /// After a flush that failed: gives the open transaction up.
    pub(in crate::writer) fn drop_chunk(&mut self) -> io::Result<()> {
        self.transaction.clear();
        Ok(())
    }

    /// Adds a row of metadata, as rosbag2 does when it opens a file and when it ends it, and what is open with it.
    pub(in crate::writer) fn write_metadata(&mut self, text: String) -> io::Result<()> {
        self.commit(Some(&text))?;
        self.transaction.clear();
        // So that also who does not look into the log finds the tables.
        self.move_log();
        Ok(())
    }

    /// Ends the file, and waits until the medium has it unless the policy is not to.
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

    /// After a failed write: closes the file after its last transaction. Without the room to move the log into the file, it
    /// stays beside it, and the file is read with it.
    pub(in crate::writer) fn give_up(&mut self) -> io::Result<()> {
        self.transaction.clear();
        // It fails for the reason that is being reported.
        let _ = self.end();
        Ok(())
    }

    fn commit(&mut self, metadata: Option<&str>) -> io::Result<()> {
        let connection = open(&mut self.connection)?;
        let mut insert_all = || -> Result<(), Error> {
            // Rolled back where something fails.
            let transaction = connection.transaction()?;
            for (index, topic) in self.topics.iter().enumerate().skip(self.topics_in_file) {
                // `add_topic` has seen that there are not more.
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

    /// Moves what is in the log into the file, as far as others read it already. Without a log it does nothing.
    fn move_log(&mut self) {
        self.moved = Instant::now();
        if let Some(connection) = &self.connection {
            // What is not moved stays in the log, which is as good.
            let _ = connection.query_row("PRAGMA wal_checkpoint(PASSIVE)", [], |_| Ok(()));
        }
    }

    /// Moves all of the log into the file, marks the file as one without, and closes it.
    fn end(&mut self) -> io::Result<()> {
        self.move_log();
        let Some(connection) = self.connection.take() else { return Ok(()) };
        let without_log = connection
            .busy_timeout(READER_PATIENCE)
            .and_then(|()| connection.query_row("PRAGMA journal_mode=DELETE", [], |_| Ok(())));
        let closed = connection.close().map_err(|(_, error)| error);
        match without_log.and(closed) {
            // Who reads it needs the log; it stays beside the file.
            Err(error) if is_busy(&error) => Ok(()),
            ended => ended.map_err(failure),
        }
    }
}

fn open(connection: &mut Option<Connection>) -> io::Result<&mut Connection> {
    connection.as_mut().ok_or_else(|| io::Error::other("the file is ended"))
}

/// Makes a setting, and sees whether SQLite knows it, as rosbag2 does.
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
        Ok(false) => Err(wrong(format!("SQLite has no {name}"))),
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
    // The index of the log is mapped into memory, and has an error of its own where there is no room for it.
    let has_no_room = match error.sqlite_error() {
        Some(error) => error.code == ErrorCode::DiskFull || error.extended_code == ffi::SQLITE_IOERR_SHMSIZE,
        None => false,
    };
    let kind = if has_no_room { io::ErrorKind::StorageFull } else { io::ErrorKind::Other };
    io::Error::new(kind, error)
}
