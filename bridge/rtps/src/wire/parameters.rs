//! Lists of parameters, in front of samples and in discovery data (section 9.4.2.11).

use super::bytes::{Cursor, Encoder};
use super::{ByteOrder, Malformed, SampleIdentity};

/// A checked list: pairs of an id and the bytes of a value, which may be padded to a multiple of four.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ParameterList<'a> {
    /// Without the end mark.
    bytes: &'a [u8],
    order: ByteOrder,
}

impl<'a> ParameterList<'a> {
    /// Byte order of the values.
    pub fn order(&self) -> ByteOrder {
        self.order
    }

    /// Ids and values in their order, without padding parameters.
    pub fn iter(&self) -> impl Iterator<Item = (u16, &'a [u8])> + use<'a> {
        let mut cursor = Cursor::new(self.bytes, self.order);
        std::iter::from_fn(move || todo!())
    }
}

/// What became of a sample's instance (section 9.6.4.9).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct StatusInfo(pub u8);

impl StatusInfo {
    /// Disposed and unregistered: the end of an entity, in the form both Fast DDS and Cyclone DDS take for it.
    pub const REMOVED: Self = Self(3);

    /// Whether the instance is disposed, unregistered or both.
    pub fn is_removal(self) -> bool {
        self.0 & 3 != 0
    }
}

/// The parameters in front of a sample that mean something in ROS 2.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InlineQos {
    /// Of a request or its reply. Parsed from ids 0x0083 and 0x800f, sent as 0x0083.
    pub related_sample_identity: Option<SampleIdentity>,
    /// Identity of the instance; in discovery data the guid of the entity.
    pub key_hash: Option<[u8; 16]>,
    #[allow(missing_docs)]
    pub status: Option<StatusInfo>,
}

impl InlineQos {
    /// Bytes on the wire, 0 if there is nothing to say.
    pub fn encoded_len(&self) -> usize {
        todo!()
    }
}
