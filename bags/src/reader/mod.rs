//! Reads bags: a directory or a single file, including those of interrupted recordings.

mod chunk;
mod error;
mod file;
mod message_index;
mod messages;
mod open;
mod records;
mod segment;
mod source;
#[cfg(feature = "sqlite")]
mod sqlite;
mod summary;
mod topics;
mod walk;

use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;

use crate::metadata::{self, FileMetadata, Metadata};
use crate::storage::Storage;
use crate::topic::{TopicDescription, TopicId};
pub use error::{ReaderError, Truncation, TruncationCause};
use file::BagFile;
pub use messages::{BagMessage, Messages, Selection};
use source::Source;

/// An opened bag: its topics, counts, and access to its messages.
#[derive(Debug)]
pub struct Reader {
    path: PathBuf,
    metadata: Option<Metadata>,
    files: Vec<BagFile>,
    topics: Vec<RecordedTopic>,
    by_name: HashMap<String, TopicId>,
    /// For each file, the topics of its channels.
    topics_of_channels: Vec<Arc<HashMap<u16, TopicId>>>,
    /// What could not be understood of the descriptions of topics, and was replaced by a default.
    oddities: Vec<String>,
}

/// A topic of a bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordedTopic {
    /// Name, type and other properties.
    pub info: TopicDescription,
    /// `cdr`, or another format.
    pub serialization_format: String,
    /// The number of messages in the bag.
    pub message_count: u64,
}

impl Reader {
    /// Opens a bag directory, with or without metadata.yaml, or a single file: MCAP, with the feature
    /// `sqlite` also SQLite (`.db3`), either of them optionally compressed as a whole (`.mcap.zstd`), which
    /// is decompressed into a temporary file.
    ///
    /// A bag whose recording was interrupted can also be opened: see [`Reader::truncation`].
    ///
    /// # Errors
    /// Returns an error if it is not a bag, is of an unsupported kind, or cannot be read.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, ReaderError> {
        let path = path.as_ref();
        let read = |source| ReaderError::Read { path: path.to_owned(), source };
        let (metadata, paths) = if fs::metadata(path).map_err(read)?.is_dir() {
            files_of_directory(path)?
        } else {
            (None, vec![path.to_owned()])
        };
        Self::open_files(path, metadata, &paths)
    }

    /// Opens a bag file in memory, for example one that was received over a network or is part of a program.
    /// Supports the same files as [`Reader::open`]. `name` replaces its path in errors and in
    /// [`Reader::files`].
    ///
    /// ```
    /// # use downbeat_bags::{Reader, WriterOptions};
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # let folder = tempfile::tempdir()?;
    /// # WriterOptions::new().create(folder.path().join("run"))?.finish()?;
    /// # let received = std::fs::read(folder.path().join("run/run_0.mcap"))?;
    /// let reader = Reader::from_bytes("robot_7/run_0.mcap", received)?;
    /// assert_eq!(reader.message_count(), 0);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// Returns an error if the bytes are not a bag file, or of an unsupported kind.
    pub fn from_bytes(name: impl AsRef<Path>, bytes: impl Into<Bytes>) -> Result<Self, ReaderError> {
        let name = name.as_ref();
        let file = BagFile::open(name, Source::Memory(bytes.into()))?;
        Ok(Self::of_files(name, None, vec![file]))
    }

    /// Opens the files of a bag directory, ignoring its metadata.yaml.
    pub(crate) fn open_files_of(directory: &Path) -> Result<Self, ReaderError> {
        Self::open_files(directory, None, &files_without_metadata(directory)?)
    }

    fn open_files(path: &Path, metadata: Option<Metadata>, paths: &[PathBuf]) -> Result<Self, ReaderError> {
        let files = paths.iter().map(|path| {
            regular(path)?;
            BagFile::open(path, Source::File(path.clone()))
        });
        Ok(Self::of_files(path, metadata, files.collect::<Result<_, _>>()?))
    }

    fn of_files(path: &Path, mut metadata: Option<Metadata>, files: Vec<BagFile>) -> Self {
        if metadata.is_none()
            && let Some(text) = files.last().and_then(|file| file.metadata.as_deref())
        {
            // Optional: a bag without metadata.yaml can be opened even if this record is invalid.
            metadata = Metadata::parse_record(text, path).ok();
        }
        let topics::Collected { topics, topics_of_channels, mut oddities } =
            topics::collect(&files, metadata.as_ref());
        let noted = metadata.as_ref().map(|metadata| metadata.oddities.as_slice()).unwrap_or_default();
        oddities.splice(0..0, noted.iter().cloned());
        // The first one of each name.
        let by_name = topics.iter().enumerate().rev();
        let by_name =
            by_name.filter_map(|(at, topic)| Some((topic.info.name.clone(), TopicId::from_index(at)?)));
        let by_name = by_name.collect();
        Self { path: path.to_owned(), metadata, files, topics, by_name, topics_of_channels, oddities }
    }

    /// The opened path.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The topics, including those without messages: [`TopicId`] is the position.
    #[must_use]
    pub fn topics(&self) -> &[RecordedTopic] {
        &self.topics
    }

    /// The topic of that name.
    #[must_use]
    pub fn topic(&self, name: &str) -> Option<TopicId> {
        self.by_name.get(name).copied()
    }

    /// The contents of metadata.yaml, or else of the metadata record in the bag's last file. After an
    /// interrupted recording its counts may be lower than those of [`Reader::topics`], which come from the
    /// files.
    #[must_use]
    pub fn metadata(&self) -> Option<&Metadata> {
        self.metadata.as_ref()
    }

    /// The bag files in their order.
    pub fn files(&self) -> impl ExactSizeIterator<Item = &Path> {
        self.files.iter().map(|file| file.path.as_path())
    }

    /// The files that have messages, with the receive time of the first one.
    pub(crate) fn starts_of_files(&self) -> impl Iterator<Item = (&Path, i64)> {
        let first = |file: &BagFile| file.segments.iter().map(|segment| segment.first).min();
        self.files.iter().filter_map(move |file| Some((&*file.path, messages::signed(first(file)?))))
    }

    /// The contents of each file, as for metadata.yaml.
    pub(crate) fn file_metadata(&self) -> impl Iterator<Item = FileMetadata> {
        self.files.iter().map(|file| {
            let name = file.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let first = file.segments.iter().map(|segment| segment.first).min();
            let last = file.segments.iter().map(|segment| segment.last).max();
            FileMetadata {
                path: name,
                starting_time: first.map_or(metadata::NEVER, messages::signed),
                duration: Duration::from_nanos(last.unwrap_or(0).saturating_sub(first.unwrap_or(0))),
                message_count: file.counts.values().sum(),
            }
        })
    }

    /// The number of readable messages.
    #[must_use]
    pub fn message_count(&self) -> u64 {
        self.topics.iter().map(|topic| topic.message_count).sum()
    }

    /// The receive time of the first message, in nanoseconds since the epoch; `None` without messages.
    #[must_use]
    pub fn start_time(&self) -> Option<i64> {
        self.segments().map(|segment| segment.first).min().map(messages::signed)
    }

    /// The receive time of the last message, in nanoseconds since the epoch; `None` without messages.
    #[must_use]
    pub fn end_time(&self) -> Option<i64> {
        self.segments().map(|segment| segment.last).max().map(messages::signed)
    }

    /// From the first message to the last.
    #[must_use]
    pub fn duration(&self) -> Duration {
        match (self.start_time(), self.end_time()) {
            (Some(start), Some(end)) => Duration::from_nanos(end.abs_diff(start)),
            _ => Duration::ZERO,
        }
    }

    /// The missing parts of the files because recording was interrupted or a file was damaged; empty for a
    /// complete bag.
    pub fn truncation(&self) -> impl Iterator<Item = &Truncation> {
        self.files.iter().flat_map(|file| &file.truncations)
    }

    /// What could not be understood of the descriptions of topics and files, and was replaced by a default or
    /// left out: a sentence for each, which names the topic.
    pub fn oddities(&self) -> impl ExactSizeIterator<Item = &str> {
        self.oddities.iter().map(String::as_str)
    }

    /// The messages sorted by receive time, read from the files on demand.
    ///
    /// # Errors
    /// Returns an error if a file can no longer be opened.
    pub fn messages(&self, selection: Selection) -> Result<Messages, ReaderError> {
        Messages::open(self, selection)
    }

    /// The last messages of topics at a time, in nanoseconds since the epoch: of each topic as many as
    /// `wanted` says. Reads only the parts of the files that may contain them, backwards.
    ///
    /// Returns the messages sorted by time, and the parts that could not be read.
    ///
    /// # Errors
    /// Returns an error if a file can no longer be opened.
    pub fn last_messages(
        &self,
        until: i64,
        wanted: &BTreeMap<TopicId, usize>,
    ) -> Result<(Vec<BagMessage>, Vec<ReaderError>), ReaderError> {
        let selection = Selection::all().topics(wanted.keys().copied()).until(until);
        Ok(Messages::open(self, selection)?.last(wanted))
    }

    /// The storage of its files.
    #[must_use]
    pub fn storage(&self) -> Storage {
        self.files.first().map_or(Storage::Mcap, |file| file.storage)
    }

    /// `mcap` or `sqlite3`.
    #[must_use]
    pub fn storage_identifier(&self) -> &'static str {
        self.storage().identifier()
    }

    /// Returns whether rosbag2 compressed messages individually; they are returned decompressed.
    pub(crate) fn has_packed_messages(&self) -> bool {
        self.metadata
            .as_ref()
            .is_some_and(|metadata| metadata.compression_mode.eq_ignore_ascii_case("message"))
    }

    /// The total size of the bag files in bytes.
    pub(crate) fn files_length(&self) -> u64 {
        self.files.iter().map(|file| file.length).sum()
    }

    fn segments(&self) -> impl Iterator<Item = &segment::Segment> {
        self.files.iter().flat_map(|file| &file.segments)
    }
}

fn files_of_directory(directory: &Path) -> Result<(Option<Metadata>, Vec<PathBuf>), ReaderError> {
    let yaml = directory.join(metadata::FILE_NAME);
    if !yaml.exists() {
        return Ok((None, files_without_metadata(directory)?));
    }
    regular(&yaml)?;
    let metadata = Metadata::read(&yaml)?;
    let unsupported = |found: String| ReaderError::Unsupported { path: directory.to_owned(), found };
    if !["mcap", "sqlite3"].contains(&metadata.storage_identifier.as_str()) {
        return Err(unsupported(format!(
            "its storage is {}; supported are mcap and sqlite3",
            metadata.storage_identifier
        )));
    }
    let is_packed = !["", "none"].contains(&metadata.compression_mode.to_ascii_lowercase().as_str());
    if is_packed && !metadata.compression_format.eq_ignore_ascii_case("zstd") {
        return Err(unsupported(format!(
            "it is compressed with {:?}, but only zstd is supported",
            metadata.compression_format
        )));
    }
    let mut paths = Vec::new();
    for relative in &metadata.relative_file_paths {
        let path = directory.join(relative);
        // Before version 4, the paths started with the name of the directory.
        let beside = Path::new(relative).file_name().map(|name| directory.join(name));
        let path = beside.filter(|beside| !path.exists() && beside.exists()).unwrap_or(path);
        in_bag(directory, &path)?;
        paths.push(path);
    }
    Ok((Some(metadata), paths))
}

/// Rejects non-regular files: opening a pipe could block forever.
fn regular(path: &Path) -> Result<(), ReaderError> {
    let read = |source| ReaderError::Read { path: path.to_owned(), source };
    if fs::metadata(path).map_err(read)?.is_file() {
        Ok(())
    } else {
        Err(ReaderError::NotAFile { path: path.to_owned() })
    }
}

/// Rejects paths outside of the bag, through `..`, an absolute path or a link: an untrusted bag must not give
/// access to other files.
fn in_bag(directory: &Path, path: &Path) -> Result<(), ReaderError> {
    let read = |source| ReaderError::Read { path: path.to_owned(), source };
    let bag = fs::canonicalize(directory).map_err(read)?;
    let is_inside = |path: &Path| fs::canonicalize(path).map(|path| path.starts_with(&bag));
    // A missing file cannot be resolved; but paths that start outside are never opened.
    let leaves = path.strip_prefix(directory).map_or(true, |relative| {
        relative.components().any(|part| !matches!(part, Component::Normal(_) | Component::CurDir))
    });
    if leaves || !is_inside(path).map_err(read)? {
        return Err(ReaderError::Outside { path: path.to_owned(), bag: directory.to_owned() });
    }
    Ok(())
}

/// Extensions of bag files; in a directory, files with the first extension that exists are read.
const ENDINGS: [&str; 4] = [".mcap", ".mcap.zstd", ".db3", ".db3.zstd"];

fn files_without_metadata(directory: &Path) -> Result<Vec<PathBuf>, ReaderError> {
    let read = |source| ReaderError::Read { path: directory.to_owned(), source };
    let mut paths = Vec::new();
    for entry in fs::read_dir(directory).map_err(read)? {
        let path = entry.map_err(read)?.path();
        if path.is_file() {
            paths.push(path);
        }
    }
    let ends_with = |path: &Path, ending: &str| path.to_string_lossy().ends_with(ending);
    let ending = ENDINGS.into_iter().find(|ending| paths.iter().any(|path| ends_with(path, ending)));
    let Some(ending) = ending else {
        return Err(ReaderError::NotABag {
            path: directory.to_owned(),
            found: format!(
                "the directory has neither {} nor a file *{}",
                metadata::FILE_NAME,
                ENDINGS.join(", *")
            ),
        });
    };
    paths.retain(|path| ends_with(path, ending));
    paths.sort_by_key(|path| split_number(path, ending));
    Ok(paths)
}

/// rosbag2 numbers the files of a split bag, `run_9.mcap` before `run_10.mcap`.
fn split_number(path: &Path, ending: &str) -> (u64, PathBuf) {
    let name = path.to_string_lossy();
    let stem = name.strip_suffix(ending).unwrap_or(&name);
    let number = stem.rsplit('_').next().and_then(|number| number.parse().ok());
    (number.unwrap_or(u64::MAX), path.to_owned())
}
