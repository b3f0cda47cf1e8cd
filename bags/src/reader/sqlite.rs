//! Reads bag files of rosbag2's storage `sqlite3`.
//!
//! The tables are those of `rosbag2_storage_sqlite3/src/rosbag2_storage_sqlite3/sqlite_storage.cpp`, branch
//! jazzy; older ones have fewer columns. Rows are read in the order in which they were written, several at a
//! time.

use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};

use mcap::records::Channel;
use rusqlite::types::ValueRef;
use rusqlite::{Connection, Error, OpenFlags, Row};

use super::error::{ReaderError, TruncationCause};
use super::file::{BagFile, Schema};
use super::segment::{Segment, SegmentKind};
use super::source::Source;
use crate::storage::{Storage, write_ahead_log};

/// The maximum number of rows read at a time, which bounds memory.
const MOST_ROWS: u64 = 512;
const MOST_BYTES: u64 = 8 * 1024 * 1024;

/// A message of the table.
pub(super) struct SqliteMessage<'a> {
    pub(super) channel: u16,
    /// A time before 1970 is a number that ROS 2 cannot represent, as it is in a chunk.
    pub(super) time: u64,
    pub(super) data: &'a [u8],
}

/// An SQLite file that is open.
pub(super) struct SqliteFile {
    connection: Connection,
    channels: HashMap<i64, u16>,
}

pub(super) fn open(path: &Path, source: Source) -> Result<BagFile, ReaderError> {
    let damaged =
        |error: Error| ReaderError::Damaged { path: path.to_owned(), offset: 0, found: error.to_string() };
    let read = |source| ReaderError::Read { path: path.to_owned(), source };
    let source = source.into_file().map_err(read)?;
    let length = source.length().map_err(read)?;
    let mut file = BagFile::empty(path, source, length);
    file.storage = Storage::Sqlite3;
    let input = SqliteFile::open(&file.source).map_err(damaged)?;
    input.read_topics(&mut file).map_err(damaged)?;
    input.read_definitions(&mut file);
    input.read_metadata(&mut file);
    input.find_segments(&mut file);
    // A finished file has no log.
    let log = file.source.path().map(write_ahead_log);
    if log.and_then(|log| std::fs::metadata(log).ok()).is_some_and(|log| log.len() > 0) {
        file.miss(0, 0, TruncationCause::NotEnded);
    }
    Ok(file)
}

impl SqliteFile {
    pub(super) fn open(source: &Source) -> Result<Self, Error> {
        let data = source.path().ok_or_else(|| Error::InvalidPath(PathBuf::new()))?;
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(data, flags)?;
        let mut channels = HashMap::new();
        let mut statement = connection.prepare("SELECT id FROM topics ORDER BY id")?;
        let mut rows = statement.query([])?;
        while let Some(row) = rows.next()? {
            let Ok(channel) = u16::try_from(channels.len()) else { break };
            channels.insert(row.get(0)?, channel);
        }
        drop(rows);
        drop(statement);
        Ok(Self { connection, channels })
    }

    /// Calls `each` with every message of a run of rows.
    pub(super) fn read(
        &self,
        segment: &Segment,
        mut each: impl FnMut(SqliteMessage<'_>),
    ) -> Result<(), String> {
        let query = "SELECT topic_id, timestamp, data FROM messages WHERE id BETWEEN ?1 AND ?2 ORDER BY id";
        let mut read = || -> Result<(), Error> {
            let mut statement = self.connection.prepare_cached(query)?;
            let first = row_of(segment.offset);
            let last = row_of(segment.offset.saturating_add(segment.length).saturating_sub(1));
            let mut rows = statement.query([first, last])?;
            while let Some(row) = rows.next()? {
                let Some(&channel) = self.channels.get(&row.get::<_, i64>(0)?) else { continue };
                // Values other than bytes are not messages.
                if let ValueRef::Blob(data) = row.get_ref(2)? {
                    each(SqliteMessage { channel, time: row.get::<_, i64>(1)?.cast_unsigned(), data });
                }
            }
            Ok(())
        };
        read().map_err(|error| error.to_string())
    }

    fn read_topics(&self, file: &mut BagFile) -> Result<(), Error> {
        let mut statement = self.connection.prepare("SELECT * FROM topics ORDER BY id")?;
        let mut rows = statement.query([])?;
        while let Some(row) = rows.next()? {
            let Some(&channel) = self.channels.get(&row.get::<_, i64>("id")?) else { continue };
            // Schemas are numbered from 1; 0 means none.
            let schema_id = channel.saturating_add(1);
            let name = text(row, "type");
            let metadata = [
                ("offered_qos_profiles", text(row, "offered_qos_profiles")),
                ("topic_type_hash", text(row, "type_description_hash")),
            ];
            std::sync::Arc::make_mut(&mut file.channels).insert(
                channel,
                Channel {
                    id: channel,
                    schema_id,
                    topic: text(row, "name"),
                    message_encoding: text(row, "serialization_format"),
                    metadata: metadata.into_iter().map(|(key, value)| (key.to_owned(), value)).collect(),
                },
            );
            file.schemas.insert(schema_id, Schema { name, encoding: String::new(), data: Vec::new() });
        }
        Ok(())
    }

    /// Older files have no such table.
    fn read_definitions(&self, file: &mut BagFile) {
        let query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions";
        let read = || -> Result<Vec<(String, String, String)>, Error> {
            let mut statement = self.connection.prepare(query)?;
            let rows = statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))?;
            rows.collect()
        };
        for (name, encoding, text) in read().unwrap_or_default() {
            for schema in file.schemas.values_mut().filter(|schema| schema.name == name) {
                schema.encoding.clone_from(&encoding);
                schema.data = text.clone().into_bytes();
            }
        }
    }

    fn read_metadata(&self, file: &mut BagFile) {
        let query = "SELECT metadata FROM metadata ORDER BY id DESC LIMIT 1";
        file.metadata = self.connection.query_row(query, [], |row| row.get(0)).ok();
    }

    /// Reads all rows without their data. Skips damaged rows.
    fn find_segments(&self, file: &mut BagFile) {
        let mut next = i64::MIN;
        let mut step = 1_i64;
        loop {
            let found = file.segments.len();
            match self.find_segments_from(&mut next, file) {
                Ok(()) => return,
                Err(error) => {
                    if step == 1 || file.segments.len() > found {
                        let offset = u64::try_from(next).unwrap_or(0);
                        file.miss(offset, 0, TruncationCause::DamagedRows(error.to_string()));
                        step = 1;
                    }
                    // Doubles the step each time, so that it ends soon.
                    let Some(behind) = next.max(0).checked_add(step) else { return };
                    (next, step) = (behind, step.saturating_mul(2));
                }
            }
        }
    }

    fn find_segments_from(&self, next: &mut i64, file: &mut BagFile) -> Result<(), Error> {
        let query = "SELECT id, topic_id, timestamp, length(data) FROM messages NOT INDEXED WHERE id >= ?1 ORDER BY id";
        let mut statement = self.connection.prepare(query)?;
        let mut rows = statement.query([*next])?;
        let (mut run, mut bytes) = (None::<(Segment, BTreeSet<u16>)>, 0);
        let finished = |(segment, channels): (Segment, BTreeSet<u16>)| Segment {
            channels: Some(channels.into_iter().collect()),
            first: segment.first.min(segment.last),
            ..segment
        };
        let result = loop {
            let row = match rows.next() {
                Ok(Some(row)) => row,
                Ok(None) => break Ok(()),
                Err(error) => break Err(error),
            };
            let (id, topic, timestamp): (i64, i64, i64) = (row.get(0)?, row.get(1)?, row.get(2)?);
            let length = row.get::<_, Option<i64>>(3)?.and_then(|length| u64::try_from(length).ok());
            *next = id.saturating_add(1);
            let (Some(length), Some(channel)) = (length, self.channels.get(&topic)) else { continue };
            // SQLite numbers rows from 1.
            let Ok(place) = u64::try_from(id) else { continue };
            *file.counts.entry(*channel).or_default() += 1;
            // Messages before 1970 are left out, and so are their times.
            let (first, last) = u64::try_from(timestamp).map_or((u64::MAX, 0), |time| (time, time));
            let (segment, channels) = run.get_or_insert_with(|| {
                let segment = Segment {
                    offset: place,
                    length: 0,
                    first,
                    last,
                    channels: None,
                    kind: SegmentKind::Run,
                    declared: None,
                    is_reported: false,
                };
                (segment, BTreeSet::new())
            });
            channels.insert(*channel);
            segment.length = place - segment.offset + 1;
            segment.first = segment.first.min(first);
            segment.last = segment.last.max(last);
            bytes += length;
            if segment.length >= MOST_ROWS || bytes >= MOST_BYTES {
                file.segments.extend(run.take().map(finished));
                bytes = 0;
            }
        };
        file.segments.extend(run.map(finished));
        result
    }
}

fn row_of(place: u64) -> i64 {
    i64::try_from(place).unwrap_or(i64::MAX)
}

/// Empty if there is no such column.
fn text(row: &Row<'_>, column: &str) -> String {
    row.get(column).unwrap_or_default()
}
