//! What a participant announces about itself (sections 8.5.3.2 and 9.6.3.1).

use std::net::SocketAddrV4;
use std::time::Duration;

use super::bytes::ByteOrder;
use super::parameters::{ParameterList, pid, write_parameter, write_payload};
use super::time::{read_duration, write_duration};
use super::values::{
    MAX_TEXT, read_bool, read_locator, read_octets, read_string, write_locators, write_octets, write_string,
};
use super::{EntityId, Guid, GuidPrefix, Malformed, VendorId};

/// Which builtin endpoints a participant has (section 9.3.2.12).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BuiltinEndpoints(pub u32);

#[allow(missing_docs)]
impl BuiltinEndpoints {
    pub const SPDP_WRITER: u32 = 1 << 0;
    pub const SPDP_READER: u32 = 1 << 1;
    pub const SEDP_PUBLICATIONS_WRITER: u32 = 1 << 2;
    pub const SEDP_PUBLICATIONS_READER: u32 = 1 << 3;
    pub const SEDP_SUBSCRIPTIONS_WRITER: u32 = 1 << 4;
    pub const SEDP_SUBSCRIPTIONS_READER: u32 = 1 << 5;
    pub const WLP_WRITER: u32 = 1 << 10;
    pub const WLP_READER: u32 = 1 << 11;
    /// All of the above: all that ROS 2 uses.
    pub const OURS: Self = Self(0xc3f);

    /// Whether all of `bits` are there.
    pub fn has(self, bits: u32) -> bool {
        self.0 & bits == bits
    }
}

/// The content of an SPDP sample.
///
/// Locators are those of UDP over IPv4 that can be sent to; others are skipped. At most 16 of each kind are kept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParticipantData {
    /// Its entity is [`EntityId::PARTICIPANT`].
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
    /// In ROS 2 `enclave=<enclave>;`. At most 1024 bytes are kept.
    pub user_data: Vec<u8>,
    /// Empty if it has none.
    pub name: String,
    /// `None` if it does not say.
    pub domain_id: Option<u32>,
    /// Participants with different tags ignore each other. Empty by default.
    pub domain_tag: String,
    /// Whether its readers want the QoS of the writer with each sample.
    pub expects_inline_qos: bool,
    /// Bytes of the receive buffer of its socket for user data; only participants of [`VendorId::OURS`] say it.
    pub receive_buffer: Option<u32>,
}

/// What holds if a participant announces no lease (section 9.6.4, table 9.21).
const DEFAULT_LEASE: Duration = Duration::from_secs(100);

impl ParticipantData {
    /// Reads the payload of an SPDP sample.
    pub fn parse(payload: &[u8]) -> Result<Self, Malformed> {
        let mut data = Self {
            prefix: GuidPrefix::UNKNOWN,
            version: [2, 0],
            vendor: VendorId([0, 0]),
            metatraffic_unicast: Vec::new(),
            metatraffic_multicast: Vec::new(),
            default_unicast: Vec::new(),
            default_multicast: Vec::new(),
            lease: Some(DEFAULT_LEASE),
            builtin_endpoints: BuiltinEndpoints(0),
            user_data: Vec::new(),
            name: String::new(),
            domain_id: None,
            domain_tag: String::new(),
            expects_inline_qos: false,
            receive_buffer: None,
        };
        let mut guid = None;
        for parameter in ParameterList::from_payload(payload)?.iter() {
            match parameter.id {
                pid::PARTICIPANT_GUID => guid = Some(parameter.get(|value| value.array().ok())?),
                pid::PROTOCOL_VERSION => data.version = parameter.get(|value| value.array().ok())?,
                pid::VENDOR_ID => data.vendor = VendorId(parameter.get(|value| value.array().ok())?),
                pid::METATRAFFIC_UNICAST_LOCATOR => {
                    parameter.get(|value| read_locator(value, &mut data.metatraffic_unicast))?;
                }
                pid::METATRAFFIC_MULTICAST_LOCATOR => {
                    parameter.get(|value| read_locator(value, &mut data.metatraffic_multicast))?;
                }
                pid::DEFAULT_UNICAST_LOCATOR => {
                    parameter.get(|value| read_locator(value, &mut data.default_unicast))?;
                }
                pid::DEFAULT_MULTICAST_LOCATOR => {
                    parameter.get(|value| read_locator(value, &mut data.default_multicast))?;
                }
                pid::PARTICIPANT_LEASE_DURATION => data.lease = parameter.get(read_duration)?,
                pid::BUILTIN_ENDPOINT_SET => {
                    data.builtin_endpoints = BuiltinEndpoints(parameter.get(|value| value.u32().ok())?);
                }
                pid::USER_DATA => data.user_data = parameter.get(read_octets)?,
                pid::ENTITY_NAME => data.name = parameter.get(|value| read_string(value, MAX_TEXT))?,
                pid::DOMAIN_ID => data.domain_id = Some(parameter.get(|value| value.u32().ok())?),
                pid::DOMAIN_TAG => data.domain_tag = parameter.get(|value| read_string(value, MAX_TEXT))?,
                pid::EXPECTS_INLINE_QOS => data.expects_inline_qos = parameter.get(read_bool)?,
                // With other vendors the id may mean anything, so that a value of no use is no error.
                pid::OUR_RECEIVE_BUFFER => {
                    data.receive_buffer = parameter.get(|value| value.u32().ok()).ok();
                }
                _ => parameter.skip()?,
            }
        }
        data.receive_buffer = data.receive_buffer.filter(|_| data.vendor == VendorId::OURS);
        let guid = Guid::from_bytes(guid.ok_or(Malformed::Lacks(pid::PARTICIPANT_GUID))?);
        if guid.entity != EntityId::PARTICIPANT {
            return Err(Malformed::Parameter(pid::PARTICIPANT_GUID));
        }
        data.prefix = guid.prefix;
        Ok(data)
    }

    /// Appends the payload of an SPDP sample.
    pub fn emit(&self, out: &mut Vec<u8>) {
        self.emit_in(ByteOrder::Little, out);
    }

    fn emit_in(&self, order: ByteOrder, out: &mut Vec<u8>) {
        write_payload(out, order, |out| {
            write_parameter(out, pid::PROTOCOL_VERSION, |out| out.bytes(&self.version));
            write_parameter(out, pid::VENDOR_ID, |out| out.bytes(&self.vendor.0));
            let guid = Guid::new(self.prefix, EntityId::PARTICIPANT);
            write_parameter(out, pid::PARTICIPANT_GUID, |out| out.bytes(&guid.to_bytes()));
            write_locators(out, pid::METATRAFFIC_UNICAST_LOCATOR, &self.metatraffic_unicast);
            write_locators(out, pid::METATRAFFIC_MULTICAST_LOCATOR, &self.metatraffic_multicast);
            write_locators(out, pid::DEFAULT_UNICAST_LOCATOR, &self.default_unicast);
            write_locators(out, pid::DEFAULT_MULTICAST_LOCATOR, &self.default_multicast);
            write_parameter(out, pid::PARTICIPANT_LEASE_DURATION, |out| write_duration(self.lease, out));
            write_parameter(out, pid::BUILTIN_ENDPOINT_SET, |out| out.u32(self.builtin_endpoints.0));
            if let Some(domain_id) = self.domain_id {
                write_parameter(out, pid::DOMAIN_ID, |out| out.u32(domain_id));
            }
            if !self.domain_tag.is_empty() {
                write_parameter(out, pid::DOMAIN_TAG, |out| write_string(&self.domain_tag, out));
            }
            if self.expects_inline_qos {
                write_parameter(out, pid::EXPECTS_INLINE_QOS, |out| out.bytes(&[1]));
            }
            if !self.name.is_empty() {
                write_parameter(out, pid::ENTITY_NAME, |out| write_string(&self.name, out));
            }
            if !self.user_data.is_empty() {
                write_parameter(out, pid::USER_DATA, |out| write_octets(&self.user_data, out));
            }
            if let Some(receive_buffer) = self.receive_buffer {
                write_parameter(out, pid::OUR_RECEIVE_BUFFER, |out| out.u32(receive_buffer));
            }
        });
    }
}
