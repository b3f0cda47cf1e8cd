//! What participants tell about themselves, their endpoints and their liveliness (sections 8.5 and 9.6.3).

use std::net::SocketAddrV4;
use std::time::Duration;

use super::{Guid, GuidPrefix, Malformed, VendorId};
use crate::qos::Qos;

/// Ids of parameters (section 9.6.4, table 9.18).
#[allow(missing_docs)]
pub mod pid {
    pub const PAD: u16 = 0x0000;
    pub const SENTINEL: u16 = 0x0001;
}

/// Which builtin endpoints a participant has (section 9.3.2.12).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BuiltinEndpoints(pub u32);

impl BuiltinEndpoints {
    /// Announcement of participants, writers and readers, and assertion of liveliness: all that ROS 2 uses.
    pub const OURS: Self = Self(0xc3f);
    #[allow(missing_docs)]
    pub const SPDP_WRITER: u32 = 1 << 0;
    #[allow(missing_docs)]
    pub const SPDP_READER: u32 = 1 << 1;
    #[allow(missing_docs)]
    pub const SEDP_PUBLICATIONS_WRITER: u32 = 1 << 2;
    #[allow(missing_docs)]
    pub const SEDP_PUBLICATIONS_READER: u32 = 1 << 3;
    #[allow(missing_docs)]
    pub const SEDP_SUBSCRIPTIONS_WRITER: u32 = 1 << 4;
    #[allow(missing_docs)]
    pub const SEDP_SUBSCRIPTIONS_READER: u32 = 1 << 5;
    #[allow(missing_docs)]
    pub const WLP_WRITER: u32 = 1 << 10;
    #[allow(missing_docs)]
    pub const WLP_READER: u32 = 1 << 11;

    /// Whether all of `bits` are there.
    pub fn has(self, bits: u32) -> bool {
        self.0 & bits == bits
    }
}

/// What a participant announces about itself by SPDP.
///
/// Locators are those of UDP over IPv4 that can be sent to; others are skipped. A list has at most
/// [`ParticipantData::MAX_LOCATORS`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParticipantData {
    /// Its entity is [`EntityId::PARTICIPANT`](super::EntityId::PARTICIPANT).
    pub prefix: GuidPrefix,
    /// Major and minor version of the protocol.
    pub version: [u8; 2],
    #[allow(missing_docs)]
    pub vendor: VendorId,
    /// Where it listens for discovery.
    pub metatraffic_unicast: Vec<SocketAddrV4>,
    #[allow(missing_docs)]
    pub metatraffic_multicast: Vec<SocketAddrV4>,
    /// Where those of its endpoints listen that announce no locators of their own.
    pub default_unicast: Vec<SocketAddrV4>,
    #[allow(missing_docs)]
    pub default_multicast: Vec<SocketAddrV4>,
    /// After this time without a message it is taken for gone; `None` is infinite.
    pub lease: Option<Duration>,
    #[allow(missing_docs)]
    pub builtin_endpoints: BuiltinEndpoints,
    /// In ROS 2 `enclave=<enclave>;`.
    pub user_data: Vec<u8>,
    /// Empty if it has none.
    pub name: String,
    /// `None` if it does not say.
    pub domain_id: Option<u32>,
    /// Participants with another tag are none of its domain. Empty by default.
    pub domain_tag: String,
    /// Whether its readers want the QoS of the writer with each sample.
    pub expects_inline_qos: bool,
    /// Bytes of the receive buffer of its socket for user data; only participants of [`VendorId::OURS`] say it.
    pub receive_buffer: Option<u32>,
}

impl ParticipantData {
    /// Locators kept of each list. A host with more interfaces is reached by the first ones.
    pub const MAX_LOCATORS: usize = 16;

    /// Reads the payload of an SPDP sample.
    pub fn parse(payload: &[u8]) -> Result<Self, Malformed> {
        todo!()
    }

    /// Appends the payload of an SPDP sample.
    pub fn emit(&self, out: &mut Vec<u8>) {
        todo!()
    }
}

/// What a participant announces about one of its endpoints by SEDP.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EndpointData {
    /// Its entity is a writer or a reader.
    pub guid: Guid,
    /// As in DDS: `rt/chatter`.
    pub topic: String,
    /// As in DDS: `std_msgs::msg::dds_::String_`.
    pub type_name: String,
    #[allow(missing_docs)]
    pub qos: Qos,
    /// Empty if the participant's default locators hold.
    pub unicast: Vec<SocketAddrV4>,
    #[allow(missing_docs)]
    pub multicast: Vec<SocketAddrV4>,
    /// In ROS 2 `typehash=RIHS01_…;`.
    pub user_data: Vec<u8>,
    #[allow(missing_docs)]
    pub expects_inline_qos: bool,
}

impl EndpointData {
    /// Reads the payload of a SEDP sample. Whether it is a writer or a reader is told by its guid.
    pub fn parse(payload: &[u8]) -> Result<Self, Malformed> {
        todo!()
    }

    /// Appends the payload of a SEDP sample: every policy is explicit, since defaults differ between versions.
    pub fn emit(&self, out: &mut Vec<u8>) {
        todo!()
    }
}

/// The assertion that writers of a participant are alive (section 9.6.3.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ParticipantMessage {
    #[allow(missing_docs)]
    pub prefix: GuidPrefix,
    /// Which writers: 1 automatic, 2 manual by participant, others mean something else.
    pub kind: u32,
}

impl ParticipantMessage {
    /// Of writers with [`Liveliness::Automatic`](crate::qos::Liveliness::Automatic).
    pub const AUTOMATIC: u32 = 1;
    /// Of writers with [`Liveliness::ManualByParticipant`](crate::qos::Liveliness::ManualByParticipant).
    pub const MANUAL: u32 = 2;

    /// Reads the payload of a WLP sample.
    pub fn parse(payload: &[u8]) -> Result<Self, Malformed> {
        todo!()
    }

    /// Appends the payload of a WLP sample.
    pub fn emit(&self, out: &mut Vec<u8>) {
        todo!()
    }
}
