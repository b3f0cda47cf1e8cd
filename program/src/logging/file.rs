//! The log file, written on a separate thread, so that a slow disk does not delay logging.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, TrySendError, sync_channel};
use std::thread::JoinHandle;

use parking_lot::Mutex;

/// The maximum number of queued lines; further lines are dropped, and counted in the file.
const WAITING: usize = 4096;

/// Writes lines until it is closed. Clones write to the same file.
#[derive(Clone)]
pub(super) struct LogFile {
    shared: Arc<Shared>,
}

struct Shared {
    lines: Mutex<Option<SyncSender<String>>>,
    dropped: Arc<AtomicU64>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

/// The file cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write the log file {} (from ROS_LOG_DIR or ROS_HOME): {source}", path.display())]
pub(super) struct LogFileError {
    path: PathBuf,
    source: std::io::Error,
}

impl LogFile {
    /// Creates the file, and its folder if missing.
    pub(super) fn create(path: &Path) -> Result<Self, LogFileError> {
        let failed = |source| LogFileError { path: path.to_owned(), source };
        path.parent().map_or(Ok(()), std::fs::create_dir_all).map_err(failed)?;
        let file = BufWriter::new(File::create(path).map_err(failed)?);
        let (sender, lines) = sync_channel(WAITING);
        let dropped = Arc::<AtomicU64>::default();
        let thread = std::thread::Builder::new().name("log file".into()).spawn({
            let dropped = Arc::clone(&dropped);
            move || write_all(file, &lines, &dropped)
        });
        let thread = Mutex::new(Some(thread.map_err(failed)?));
        Ok(Self { shared: Arc::new(Shared { lines: Mutex::new(Some(sender)), dropped, thread }) })
    }

    /// Queues a line without waiting for the disk.
    pub(super) fn write(&self, line: String) {
        let lines = self.shared.lines.lock();
        if let Some(lines) = &*lines
            && let Err(TrySendError::Full(_)) = lines.try_send(line)
        {
            self.shared.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Writes queued lines and closes the file.
    pub(super) fn close(&self) {
        drop(self.shared.lines.lock().take());
        let thread = self.shared.thread.lock().take();
        if let Some(thread) = thread {
            // It does not panic; if it did, standard error shows it.
            let _ = thread.join();
        }
    }
}

/// Writes until all senders are dropped. A failing disk ends the file, not the program.
fn write_all(mut file: impl Write, lines: &Receiver<String>, dropped: &AtomicU64) {
    let mut reported = 0;
    let mut write = |line: &str, file: &mut dyn Write| -> std::io::Result<()> {
        let missing = dropped.load(Ordering::Relaxed) - reported;
        if missing > 0 {
            reported += missing;
            writeln!(file, "({missing} lines are missing here: the disk was too slow)")?;
        }
        file.write_all(line.as_bytes())
    };
    while let Ok(first) = lines.recv() {
        let mut next = Ok(first);
        while let Ok(line) = next {
            if write(&line, &mut file).is_err() {
                return;
            }
            next = lines.try_recv();
        }
        // Flushes when the queue is empty, so that the file can be read.
        if file.flush().is_err() || matches!(next, Err(TryRecvError::Disconnected)) {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn lines_before_the_close_are_in_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/folder/downbeat.log");
        let file = LogFile::create(&path).unwrap();
        (0..100).for_each(|number| file.write(format!("line {number}\n")));
        file.close();
        file.write("too late\n".into());
        let text = std::fs::read_to_string(path).unwrap();
        assert_eq!(text.lines().count(), 100);
        assert!(text.ends_with("line 99\n"));
    }

    #[test]
    fn dropped_lines_are_counted_in_the_file() {
        let dropped = AtomicU64::new(3);
        let (sender, lines) = sync_channel(2);
        sender.send("after\n".to_owned()).unwrap();
        drop(sender);
        let mut written = Vec::new();
        write_all(&mut written, &lines, &dropped);
        let text = String::from_utf8(written).unwrap();
        assert_eq!(text, "(3 lines are missing here: the disk was too slow)\nafter\n");
    }

    #[test]
    fn a_file_that_cannot_be_created_is_reported_with_the_variables() {
        let folder = tempfile::tempdir().unwrap();
        let blocked = folder.path().join("file");
        std::fs::write(&blocked, "").unwrap();
        let error = LogFile::create(&blocked.join("log/x.log")).err().unwrap().to_string();
        assert!(error.contains("ROS_LOG_DIR") && error.contains("x.log"), "{error}");
    }
}
