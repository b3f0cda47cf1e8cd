//! Identities of vendors, participants, endpoints and samples (section 9.3.1).

use std::fmt;

use super::SequenceNumber;

/// The vendor of an RTPS implementation, assigned by the OMG.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct VendorId(pub [u8; 2]);

impl VendorId {
    /// eProsima Fast DDS.
    pub const FAST_DDS: Self = Self([0x01, 0x0f]);
    /// Eclipse Cyclone DDS.
    pub const CYCLONE: Self = Self([0x01, 0x10]);
    /// RustDDS.
    pub const RUSTDDS: Self = Self([0x01, 0x12]);
    /// This engine. The id is not registered with the OMG; no other implementation is known to use it.
    pub const OURS: Self = Self([0x01, 0x44]);
}

/// Identity of a participant.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct GuidPrefix(pub [u8; 12]);

impl GuidPrefix {
    /// No participant; as a destination, every participant.
    pub const UNKNOWN: Self = Self([0; 12]);
}

impl fmt::Display for GuidPrefix {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for GuidPrefix {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// Identity of an endpoint within its participant: a key of three bytes and a kind (section 9.3.1.2).
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct EntityId(pub [u8; 4]);

impl EntityId {
    /// No endpoint; as a destination, every matched endpoint.
    pub const UNKNOWN: Self = Self([0; 4]);
    /// The participant itself.
    pub const PARTICIPANT: Self = Self([0x00, 0x00, 0x01, 0xc1]);
    /// Announces participants.
    pub const SPDP_WRITER: Self = Self([0x00, 0x01, 0x00, 0xc2]);
    /// Receives announcements of participants.
    pub const SPDP_READER: Self = Self([0x00, 0x01, 0x00, 0xc7]);
    /// Announces writers.
    pub const SEDP_PUBLICATIONS_WRITER: Self = Self([0x00, 0x00, 0x03, 0xc2]);
    /// Receives announcements of writers.
    pub const SEDP_PUBLICATIONS_READER: Self = Self([0x00, 0x00, 0x03, 0xc7]);
    /// Announces readers.
    pub const SEDP_SUBSCRIPTIONS_WRITER: Self = Self([0x00, 0x00, 0x04, 0xc2]);
    /// Receives announcements of readers.
    pub const SEDP_SUBSCRIPTIONS_READER: Self = Self([0x00, 0x00, 0x04, 0xc7]);
    /// Asserts the liveliness of writers.
    pub const WLP_WRITER: Self = Self([0x00, 0x02, 0x00, 0xc2]);
    /// Receives assertions of liveliness.
    pub const WLP_READER: Self = Self([0x00, 0x02, 0x00, 0xc7]);
    /// The same for topics whose discovery is protected (DDS Security 1.1, section 7.4.7.1).
    pub const SEDP_PUBLICATIONS_SECURE_WRITER: Self = Self([0xff, 0x00, 0x03, 0xc2]);
    pub const SEDP_PUBLICATIONS_SECURE_READER: Self = Self([0xff, 0x00, 0x03, 0xc7]);
    pub const SEDP_SUBSCRIPTIONS_SECURE_WRITER: Self = Self([0xff, 0x00, 0x04, 0xc2]);
    pub const SEDP_SUBSCRIPTIONS_SECURE_READER: Self = Self([0xff, 0x00, 0x04, 0xc7]);
    /// The same for topics whose liveliness is protected.
    pub const WLP_SECURE_WRITER: Self = Self([0xff, 0x02, 0x00, 0xc2]);
    pub const WLP_SECURE_READER: Self = Self([0xff, 0x02, 0x00, 0xc7]);
    /// Announces changes of an authenticated participant.
    pub const SPDP_SECURE_WRITER: Self = Self([0xff, 0x01, 0x01, 0xc2]);
    pub const SPDP_SECURE_READER: Self = Self([0xff, 0x01, 0x01, 0xc7]);
    /// Carries handshakes, in clear.
    pub const STATELESS_WRITER: Self = Self([0x00, 0x02, 0x01, 0xc3]);
    pub const STATELESS_READER: Self = Self([0x00, 0x02, 0x01, 0xc4]);
    /// Carries keys, protected by the secret of the handshake.
    pub const VOLATILE_WRITER: Self = Self([0xff, 0x02, 0x02, 0xc3]);
    pub const VOLATILE_READER: Self = Self([0xff, 0x02, 0x02, 0xc4]);

    /// A user-defined writer without key, the only kind in ROS 2. Only the low 24 bits of `key` are used.
    pub const fn user_writer(key: u32) -> Self {
        Self::with_kind(key, 0x03)
    }

    /// A user-defined reader without key, the only kind in ROS 2. Only the low 24 bits of `key` are used.
    pub const fn user_reader(key: u32) -> Self {
        Self::with_kind(key, 0x04)
    }

    const fn with_kind(key: u32, kind: u8) -> Self {
        let [_, a, b, c] = key.to_be_bytes();
        Self([a, b, c, kind])
    }

    /// Returns whether the specification defines this endpoint.
    pub const fn is_builtin(self) -> bool {
        self.0[3] & 0xc0 == 0xc0
    }

    /// Returns whether its messages establish protection, so that they are never in protected messages.
    pub const fn establishes_protection(self) -> bool {
        matches!(
            self,
            Self::SPDP_WRITER
                | Self::SPDP_READER
                | Self::STATELESS_WRITER
                | Self::STATELESS_READER
                | Self::VOLATILE_WRITER
                | Self::VOLATILE_READER
        )
    }

    /// Returns whether this is a writer, keyed or not, builtin or user-defined.
    pub const fn is_writer(self) -> bool {
        matches!(self.0[3] & 0x3f, 0x02 | 0x03)
    }

    /// Returns whether this is a reader, keyed or not, builtin or user-defined.
    pub const fn is_reader(self) -> bool {
        matches!(self.0[3] & 0x3f, 0x04 | 0x07)
    }
}

impl fmt::Display for EntityId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:08x}", u32::from_be_bytes(self.0))
    }
}

impl fmt::Debug for EntityId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// Globally unique identity of an endpoint.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Guid {
    pub prefix: GuidPrefix,
    pub entity: EntityId,
}

impl Guid {
    /// No endpoint.
    pub const UNKNOWN: Self = Self::new(GuidPrefix::UNKNOWN, EntityId::UNKNOWN);

    pub const fn new(prefix: GuidPrefix, entity: EntityId) -> Self {
        Self { prefix, entity }
    }

    /// The bytes as they are on the wire and in a `Gid` of ROS 2.
    pub fn to_bytes(self) -> [u8; 16] {
        let mut bytes = [0; 16];
        bytes[..12].copy_from_slice(&self.prefix.0);
        bytes[12..].copy_from_slice(&self.entity.0);
        bytes
    }

    /// The inverse of [`Guid::to_bytes`].
    pub fn from_bytes(bytes: [u8; 16]) -> Self {
        let [prefix @ .., a, b, c, d] = bytes;
        Self::new(GuidPrefix(prefix), EntityId([a, b, c, d]))
    }
}

impl fmt::Display for Guid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.prefix, self.entity)
    }
}

impl fmt::Debug for Guid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// Identity of a sample. A reply carries the identity of its request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SampleIdentity {
    /// The writer of the sample. Clients of Fast DDS put the guid of their reply reader here.
    pub writer: Guid,
    /// In a request it may be [`SequenceNumber::UNKNOWN`]: the number of the request applies then.
    pub number: SequenceNumber,
}
