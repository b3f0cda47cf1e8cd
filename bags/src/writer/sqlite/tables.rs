//! The tables of schema version 4: the SQL is that of rosbag2, since SQLite stores it literally.

use rusqlite::{CachedStatement, Connection, Result};

use super::transaction::Message;
use crate::metadata;
use crate::topic::TopicInfo;

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
    pub(super) fn of(topic: &TopicInfo) -> Self {
        let schema = topic.schema();
        Self {
            name: topic.name.clone(),
            type_name: topic.type_name.clone(),
            serialization_format: topic.message_encoding().to_owned(),
            offered_qos: metadata::recorded_qos_to_yaml(&topic.offered_qos),
            type_hash: topic.type_hash.clone(),
            encoding: schema.encoding,
            // Schemas that are not text were rejected.
            definition: String::from_utf8_lossy(&schema.data).into_owned(),
        }
    }
}

/// Why the tables cannot represent a topic, if so.
pub(super) fn refusal(topic: &TopicInfo) -> Option<String> {
    let schema = topic.schema();
    if schema.name != topic.type_name {
        let (name, type_name) = (&schema.name, &topic.type_name);
        return Some(format!("the name of its schema, \"{name}\", is not that of its type {type_name}"));
    }
    std::str::from_utf8(&schema.data)
        .is_err()
        .then(|| format!("its schema, {}, is not text", schema.encoding))
}

pub(super) fn create(connection: &Connection) -> Result<()> {
    connection.execute_batch(CREATE)?;
    let insert = "INSERT INTO schema (schema_version, ros_distro) VALUES (?, ?)";
    connection.execute(insert, (SCHEMA_VERSION, metadata::ROS_DISTRO)).map(drop)
}

/// The topic's number is the one that SQLite would assign. Each type is described once.
pub(super) fn insert_topic(connection: &Connection, id: u16, topic: &TopicRows) -> Result<()> {
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

pub(super) fn insert_metadata(connection: &Connection, text: &str) -> Result<()> {
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
