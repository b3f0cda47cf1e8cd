//! What a participant announces about itself (sections 8.5.3.2 and 9.6.3.2).

use std::net::SocketAddrV4;
use std::time::Duration;

use super::bytes::{ByteOrder, Cursor, Encoder};
use super::parameters::{ParameterList, pid, write_parameter, write_payload};
use super::time::{read_duration, write_duration};
use super::values::{
    MAX_TEXT, read_bool, read_locator, read_octets, read_string, write_locators, write_octets, write_string,
};
use super::{EntityId, Guid, GuidPrefix, Malformed, VendorId};

/// Which builtin endpoints a participant has (section 9.3.2.12).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BuiltinEndpoints(pub u32);

impl BuiltinEndpoints {
    pub const SPDP_WRITER: u32 = 1 << 0;
    pub const SPDP_READER: u32 = 1 << 1;
    pub const SEDP_PUBLICATIONS_WRITER: u32 = 1 << 2;
    pub const SEDP_PUBLICATIONS_READER: u32 = 1 << 3;
    pub const SEDP_SUBSCRIPTIONS_WRITER: u32 = 1 << 4;
    pub const SEDP_SUBSCRIPTIONS_READER: u32 = 1 << 5;
    pub const WLP_WRITER: u32 = 1 << 10;
    pub const WLP_READER: u32 = 1 << 11;
    pub const SEDP_PUBLICATIONS_SECURE_WRITER: u32 = 1 << 16;
    pub const SEDP_PUBLICATIONS_SECURE_READER: u32 = 1 << 17;
    pub const SEDP_SUBSCRIPTIONS_SECURE_WRITER: u32 = 1 << 18;
    pub const SEDP_SUBSCRIPTIONS_SECURE_READER: u32 = 1 << 19;
    pub const WLP_SECURE_WRITER: u32 = 1 << 20;
    pub const WLP_SECURE_READER: u32 = 1 << 21;
    pub const STATELESS_WRITER: u32 = 1 << 22;
    pub const STATELESS_READER: u32 = 1 << 23;
    pub const VOLATILE_WRITER: u32 = 1 << 24;
    pub const VOLATILE_READER: u32 = 1 << 25;
    pub const SPDP_SECURE_WRITER: u32 = 1 << 26;
    pub const SPDP_SECURE_READER: u32 = 1 << 27;
    /// Those that ROS 2 uses without security.
    pub const OURS: Self = Self(0xc3f);
    /// Those that DDS Security adds.
    pub const OF_SECURITY: u32 = 0xfff << 16;

    /// Returns whether all of `bits` are set.
    pub fn has(self, bits: u32) -> bool {
        self.0 & bits == bits
    }
}

/// The content of an SPDP sample.
///
/// Only locators of UDP over IPv4 with a valid address are kept, at most 16 of each kind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParticipantData {
    /// Its entity is [`EntityId::PARTICIPANT`].
    pub prefix: GuidPrefix,
    /// Major and minor version of the protocol.
    pub version: [u8; 2],
    pub vendor: VendorId,
    /// Addresses for discovery traffic.
    pub metatraffic_unicast: Vec<SocketAddrV4>,
    pub metatraffic_multicast: Vec<SocketAddrV4>,
    /// Addresses of endpoints that do not announce their own locators.
    pub default_unicast: Vec<SocketAddrV4>,
    pub default_multicast: Vec<SocketAddrV4>,
    /// Time without a message after which the participant is considered lost; `None` is infinite.
    pub lease: Option<Duration>,
    pub builtin_endpoints: BuiltinEndpoints,
    /// In ROS 2 `enclave=<enclave>;`. At most 1024 bytes are kept.
    pub user_data: Vec<u8>,
    /// Empty if it is not announced.
    pub name: String,
    /// `None` if it is not announced.
    pub domain_id: Option<u32>,
    /// Participants with different tags ignore each other. Empty by default.
    pub domain_tag: String,
    /// Whether its readers expect the QoS of the writer with each sample.
    pub expects_inline_qos: bool,
    /// Size of its receive buffer for user data, in bytes. Only participants of [`VendorId::OURS`] announce
    /// it.
    pub receive_buffer: Option<u32>,
    /// What it announces with DDS Security; `None` without.
    pub security: Option<ParticipantSecurity>,
}

/// What a participant announces with DDS Security (DDS Security 1.1, section 7.4.1.4).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ParticipantSecurity {
    /// The CDR of its tokens in the byte order of the announcement, which is little-endian for own data.
    /// Empty if they are not announced.
    pub identity_token: Vec<u8>,
    pub permissions_token: Vec<u8>,
    /// Whether the tokens are big-endian.
    pub is_big_endian: bool,
    pub attributes: SecurityAttributes,
}

/// How a participant or an endpoint is protected: the bits of the specification, and those of the builtin
/// plug-ins (DDS Security 1.1, sections 7.4.1.4.1, 7.4.1.5.1 and 9.4.2). Zero without the highest bit means
/// that nothing is announced.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct SecurityAttributes {
    pub mask: u32,
    pub plugin_mask: u32,
}

impl SecurityAttributes {
    /// Set in each mask that is announced.
    pub const IS_VALID: u32 = 1 << 31;
    /// In the mask of a participant: its messages are protected.
    pub const RTPS_PROTECTED: u32 = 1;
    /// In the mask of an endpoint: its submessages are protected.
    pub const SUBMESSAGE_PROTECTED: u32 = 1 << 3;

    pub(super) fn read(value: &mut Cursor<'_>) -> Option<Self> {
        Some(Self { mask: value.u32().ok()?, plugin_mask: value.u32().ok()? })
    }

    pub(super) fn write(self, out: &mut Encoder<'_>) {
        out.u32(self.mask);
        out.u32(self.plugin_mask);
    }
}

/// The lease of a participant that announces none (section 9.6.3.2).
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
            security: None,
        };
        let mut guid = None;
        let mut security = ParticipantSecurity::default();
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
                pid::IDENTITY_TOKEN => {
                    security.is_big_endian = parameter.order() == ByteOrder::Big;
                    security.identity_token = parameter.bytes().to_vec();
                }
                pid::PERMISSIONS_TOKEN => security.permissions_token = parameter.bytes().to_vec(),
                pid::PARTICIPANT_SECURITY_INFO => {
                    security.attributes = parameter.get(SecurityAttributes::read)?;
                }
                // Other vendors may use the id for something else, so an unexpected value is not an error.
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
        data.security = (security != ParticipantSecurity::default()).then_some(security);
        Ok(data)
    }

    /// Appends the payload of an SPDP sample.
    ///
    /// # Panics
    /// Panics if a text or the user data is longer than 64 kB.
    pub fn emit(&self, out: &mut Vec<u8>) {
        self.emit_in(ByteOrder::Little, out);
    }

    /// Appends the same in big-endian order, as handshakes contain it. The tokens have to be big-endian.
    ///
    /// # Panics
    /// As [`ParticipantData::emit`].
    pub fn emit_big_endian(&self, out: &mut Vec<u8>) {
        self.emit_in(ByteOrder::Big, out);
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
            if let Some(security) = &self.security {
                write_parameter(out, pid::IDENTITY_TOKEN, |out| out.bytes(&security.identity_token));
                write_parameter(out, pid::PERMISSIONS_TOKEN, |out| out.bytes(&security.permissions_token));
                write_parameter(out, pid::PARTICIPANT_SECURITY_INFO, |out| security.attributes.write(out));
            }
        });
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use std::net::Ipv4Addr;

    fn data() -> ParticipantData {
        let socket = |port| SocketAddrV4::new(Ipv4Addr::LOCALHOST, port);
        ParticipantData {
            prefix: GuidPrefix([1, 0x44, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]),
            version: [2, 3],
            vendor: VendorId::OURS,
            metatraffic_unicast: vec![socket(7410), SocketAddrV4::new(Ipv4Addr::new(10, 0, 0, 1), 7410)],
            metatraffic_multicast: vec![SocketAddrV4::new(Ipv4Addr::new(239, 255, 0, 1), 7400)],
            default_unicast: vec![socket(7411)],
            default_multicast: vec![socket(7401)],
            lease: Some(Duration::from_millis(20_500)),
            builtin_endpoints: BuiltinEndpoints::OURS,
            user_data: b"enclave=/;".to_vec(),
            name: "robot".to_owned(),
            domain_id: Some(42),
            domain_tag: "tag".to_owned(),
            expects_inline_qos: true,
            receive_buffer: Some(4 << 20),
            security: Some(ParticipantSecurity {
                identity_token: vec![1; 24],
                permissions_token: vec![2; 12],
                is_big_endian: false,
                attributes: SecurityAttributes { mask: SecurityAttributes::IS_VALID | 7, plugin_mask: 6 },
            }),
        }
    }

    /// Parses the parameters that `write` appends to a guid.
    fn parse_with(write: impl FnOnce(&mut Encoder<'_>)) -> Result<ParticipantData, Malformed> {
        let guid = Guid::new(data().prefix, EntityId::PARTICIPANT);
        let mut payload = Vec::new();
        write_payload(&mut payload, ByteOrder::Big, |out| {
            write_parameter(out, pid::PARTICIPANT_GUID, |out| out.bytes(&guid.to_bytes()));
            write(out);
        });
        ParticipantData::parse(&payload)
    }

    #[test]
    fn all_data_round_trips_in_both_byte_orders() {
        for order in [ByteOrder::Big, ByteOrder::Little] {
            let mut payload = Vec::new();
            let mut data = data();
            data.security.as_mut().unwrap().is_big_endian = order == ByteOrder::Big;
            data.emit_in(order, &mut payload);
            assert_eq!(ParticipantData::parse(&payload), Ok(data));
        }
    }

    #[test]
    fn missing_parameters_have_defaults() {
        let data = parse_with(|_| {}).unwrap();
        assert_eq!(data.lease, Some(Duration::from_secs(100)));
        assert_eq!((data.domain_id, data.domain_tag.as_str()), (None, ""));
        assert!(data.metatraffic_unicast.is_empty() && !data.expects_inline_qos);
    }

    #[test]
    fn only_this_engine_announces_its_receive_buffer() {
        let parse = |vendor: VendorId, length: usize| {
            parse_with(|out| {
                write_parameter(out, pid::OUR_RECEIVE_BUFFER, |out| out.bytes(&[0, 0, 1, 0][..length]));
                write_parameter(out, pid::VENDOR_ID, |out| out.bytes(&vendor.0));
            })
        };
        assert_eq!(parse(VendorId::OURS, 4).unwrap().receive_buffer, Some(256));
        assert_eq!(parse(VendorId::CYCLONE, 4).unwrap().receive_buffer, None);
        assert_eq!(parse(VendorId::CYCLONE, 0).unwrap().receive_buffer, None);
    }

    #[test]
    fn locators_that_cannot_be_used_are_skipped_and_no_more_than_16_kept() {
        let data = parse_with(|out| {
            for kind in [16, 2, 1, -7] {
                let locator = super::super::Locator { kind, port: 7410, address: [1; 16] };
                write_parameter(out, pid::DEFAULT_UNICAST_LOCATOR, |out| locator.write(out));
            }
            let many: Vec<_> = (1..1000).map(|port| SocketAddrV4::new(Ipv4Addr::LOCALHOST, port)).collect();
            write_locators(out, pid::METATRAFFIC_UNICAST_LOCATOR, &many);
        })
        .unwrap();
        assert_eq!(data.default_unicast, [SocketAddrV4::new(Ipv4Addr::new(1, 1, 1, 1), 7410)]);
        assert_eq!(data.metatraffic_unicast.len(), 16);
        assert_eq!(data.metatraffic_unicast[15].port(), 16);
    }

    #[test]
    fn data_without_the_guid_of_a_participant_is_malformed() {
        let mut payload = Vec::new();
        write_payload(&mut payload, ByteOrder::Big, |_| {});
        assert_eq!(ParticipantData::parse(&payload), Err(Malformed::Lacks(pid::PARTICIPANT_GUID)));
        let of_endpoint = parse_with(|out| {
            write_parameter(out, pid::PARTICIPANT_GUID, |out| out.bytes(&[3; 16]));
        });
        assert_eq!(of_endpoint, Err(Malformed::Parameter(pid::PARTICIPANT_GUID)));
    }

    #[test]
    fn a_value_that_is_too_short_or_negative_is_malformed() {
        for id in [
            pid::PARTICIPANT_GUID,
            pid::PROTOCOL_VERSION,
            pid::VENDOR_ID,
            pid::METATRAFFIC_UNICAST_LOCATOR,
            pid::METATRAFFIC_MULTICAST_LOCATOR,
            pid::DEFAULT_UNICAST_LOCATOR,
            pid::DEFAULT_MULTICAST_LOCATOR,
            pid::PARTICIPANT_LEASE_DURATION,
            pid::BUILTIN_ENDPOINT_SET,
            pid::USER_DATA,
            pid::ENTITY_NAME,
            pid::DOMAIN_ID,
            pid::DOMAIN_TAG,
            pid::EXPECTS_INLINE_QOS,
        ] {
            assert_eq!(parse_with(|out| write_parameter(out, id, |_| {})), Err(Malformed::Parameter(id)));
        }
        let id = pid::PARTICIPANT_LEASE_DURATION;
        let negative = parse_with(|out| write_parameter(out, id, |out| out.bytes(&[0xff; 8])));
        assert_eq!(negative, Err(Malformed::Parameter(id)));
    }

    #[test]
    fn every_truncation_is_malformed() {
        let mut payload = Vec::new();
        data().emit(&mut payload);
        for length in 0..payload.len() - 4 {
            assert!(ParticipantData::parse(&payload[..length]).is_err(), "{length}");
        }
    }
}
