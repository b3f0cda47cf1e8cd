//! The messages of the next transaction: the chunk of an SQLite file.

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
