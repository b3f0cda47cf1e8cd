//! The parameter lists of SYNC_WRITE and BULK_READ.

use super::Id;

/// What SYNC_WRITE carries: for each device its id and the same number of bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SyncWriteBlock<'a> {
    data_length: u8,
    bytes: &'a [u8],
}

impl<'a> SyncWriteBlock<'a> {
    /// A block as it goes over the wire: `id, data_length bytes` for each device.
    ///
    /// `None` if the bytes are no whole number of entries, or an id is 0xFF.
    #[must_use]
    pub fn new(data_length: u8, bytes: &'a [u8]) -> Option<Self> {
        let mut entries = bytes.chunks_exact(usize::from(data_length) + 1);
        let sound = entries.all(|entry| Id::new(entry[0]).is_some()) && entries.remainder().is_empty();
        sound.then_some(Self { data_length, bytes })
    }

    /// How many bytes each device is given.
    #[must_use]
    pub fn data_length(&self) -> u8 {
        self.data_length
    }

    /// The block as it goes over the wire.
    #[must_use]
    pub fn as_bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Each device and the bytes it is given.
    pub fn entries(&self) -> impl Iterator<Item = (Id, &'a [u8])> + use<'a> {
        let chunks = self.bytes.chunks_exact(usize::from(self.data_length) + 1);
        chunks.filter_map(|entry| Some((Id::new(entry[0])?, &entry[1..])))
    }
}

/// One entry of a BULK_READ: what to read from whom.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BulkReadEntry {
    /// How many bytes.
    pub length: u8,
    /// From which device.
    pub id: Id,
    /// From which address of its control table.
    pub address: u8,
}

impl BulkReadEntry {
    /// The entry as it goes over the wire.
    #[must_use]
    pub fn to_bytes(self) -> [u8; 3] {
        [self.length, self.id.raw(), self.address]
    }
}

/// What BULK_READ carries: who answers what, in the order of the answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BulkReadBlock<'a> {
    bytes: &'a [u8],
}

impl<'a> BulkReadBlock<'a> {
    /// A block as it goes over the wire: `length, id, address` for each device.
    ///
    /// `None` if the bytes are no whole number of entries, or an id is 0xFF.
    #[must_use]
    pub fn new(bytes: &'a [u8]) -> Option<Self> {
        let mut entries = bytes.chunks_exact(3);
        let sound = entries.all(|entry| Id::new(entry[1]).is_some()) && entries.remainder().is_empty();
        sound.then_some(Self { bytes })
    }

    /// The block as it goes over the wire.
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
