//! How much of a bag survives a power failure.

/// When to sync written data to disk. A killed process loses nothing either way; a power failure loses what
/// the operating system has not written yet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SyncPolicy {
    /// Never: the operating system decides, as with rosbag2. A power failure may then damage an SQLite file
    /// completely.
    Never,
    /// At the end of each file, since robots are switched off after recordings. SQLite files also when the
    /// log is moved into them, unless the preset is `none`.
    #[default]
    Files,
    /// Also after each chunk: only the open chunk can be lost, and writing is as slow as the disk.
    Chunks,
}
