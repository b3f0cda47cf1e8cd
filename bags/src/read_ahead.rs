//! Reads messages in advance, so that a slow disk does not delay them.

use std::io;
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};

use crate::edit::Merged;
use crate::reader::{BagMessage, ReaderError};

type Item = Result<BagMessage, ReaderError>;

/// A thread that reads a number of messages ahead. It ends when this handle and the returned messages are
/// dropped.
pub(crate) struct ReadAhead {
    jobs: Sender<(Merged, SyncSender<Item>)>,
    messages_ahead: usize,
}

/// The messages read by the thread.
pub(crate) struct AheadOf(Receiver<Item>);

impl ReadAhead {
    pub(crate) fn start(messages_ahead: usize) -> io::Result<Self> {
        let (jobs, given) = channel::<(Merged, SyncSender<Item>)>();
        std::thread::Builder::new().name("bag-read-ahead".to_owned()).spawn(move || {
            for (messages, wanted) in given {
                for message in messages {
                    // Fails if the receiver was replaced.
                    if wanted.send(message).is_err() {
                        break;
                    }
                }
            }
        })?;
        Ok(Self { jobs, messages_ahead: messages_ahead.max(1) })
    }

    /// Reads these messages, as soon as the previously returned ones are dropped.
    pub(crate) fn read(&self, messages: Merged) -> AheadOf {
        let (sender, receiver) = sync_channel(self.messages_ahead);
        // The thread lives as long as this handle.
        let _ = self.jobs.send((messages, sender));
        AheadOf(receiver)
    }
}

impl Iterator for AheadOf {
    type Item = Item;

    fn next(&mut self) -> Option<Item> {
        self.0.recv().ok()
    }
}
