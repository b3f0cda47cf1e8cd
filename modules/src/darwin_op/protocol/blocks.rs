//! The parameter lists of SYNC_WRITE and BULK_READ.

use super::Id;

/// The data of SYNC_WRITE: for each device its id and the same number of bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SyncWriteBlock<'a> {
    data_length: u8,
    bytes: &'a [u8],
}

impl<'a> SyncWriteBlock<'a> {
    /// Creates a block from the bytes on the wire: `id, data_length bytes` for each device.
    ///
    /// `None` if the bytes are not a whole number of entries, or an id is 0xFF.
    #[must_use]
    pub fn new(data_length: u8, bytes: &'a [u8]) -> Option<Self> {
        let mut entries = bytes.chunks_exact(usize::from(data_length) + 1);
        let sound = entries.all(|entry| Id::new(entry[0]).is_some()) && entries.remainder().is_empty();
        sound.then_some(Self { data_length, bytes })
    }

    /// The number of bytes for each device.
    #[must_use]
    pub fn data_length(&self) -> u8 {
        self.data_length
    }

    /// The bytes on the wire.
    #[must_use]
    pub fn as_bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Each device and its bytes.
    pub fn entries(&self) -> impl Iterator<Item = (Id, &'a [u8])> + use<'a> {
        let chunks = self.bytes.chunks_exact(usize::from(self.data_length) + 1);
        chunks.filter_map(|entry| Some((Id::new(entry[0])?, &entry[1..])))
    }
}

/// One entry of a BULK_READ: what to read from whom.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BulkReadEntry {
    /// The number of bytes.
    pub length: u8,
    /// The device.
    pub id: Id,
    /// The address in its control table.
    pub address: u8,
}

impl BulkReadEntry {
    /// The bytes on the wire.
    #[must_use]
    pub fn to_bytes(self) -> [u8; 3] {
        [self.length, self.id.raw(), self.address]
    }
}

/// The data of BULK_READ: what each device answers, in the order of the answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BulkReadBlock<'a> {
    bytes: &'a [u8],
}

impl<'a> BulkReadBlock<'a> {
    /// Creates a block from the bytes on the wire: `length, id, address` for each device.
    ///
    /// `None` if the bytes are not a whole number of entries, or an id is 0xFF.
    #[must_use]
    pub fn new(bytes: &'a [u8]) -> Option<Self> {
        let mut entries = bytes.chunks_exact(3);
        let sound = entries.all(|entry| Id::new(entry[1]).is_some()) && entries.remainder().is_empty();
        sound.then_some(Self { bytes })
    }

    /// The bytes on the wire.
    #[must_use]
    pub fn as_bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// The entries, in the order in which the devices answer.
    pub fn entries(&self) -> impl Iterator<Item = BulkReadEntry> + use<'a> {
        self.bytes.chunks_exact(3).filter_map(|entry| {
            Some(BulkReadEntry { length: entry[0], id: Id::new(entry[1])?, address: entry[2] })
        })
    }
}
