//! Parameters in front of a sample (section 9.6.4).

use super::bytes::{Cursor, Encoder};
use super::parameters::{ParameterList, pid, write_end, write_parameter};
use super::{Guid, Malformed, Payload, SampleIdentity, SequenceNumber};

/// The parameters in front of a sample that ROS 2 uses. Others are skipped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InlineQos {
    /// Present in requests and replies. Sent as parameter 0x0083; received as 0x0083 or 0x800f, of which
    /// older versions of Fast DDS send the latter only.
    pub related_sample_identity: Option<SampleIdentity>,
    /// Identity of the instance. In discovery it is the guid of the entity.
    pub key_hash: Option<[u8; 16]>,
    pub status: Option<StatusInfo>,
}

/// The state of a sample's instance (section 9.6.4.9).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct StatusInfo(pub u8);

impl StatusInfo {
    /// Disposed and unregistered, as Fast DDS and Cyclone DDS announce the end of an entity.
    pub const REMOVED: Self = Self(3);

    /// Returns whether the instance is disposed, unregistered or both.
    pub fn is_removal(self) -> bool {
        self.0 & 3 != 0
    }
}

const IDENTITY_LEN: usize = 24;

impl InlineQos {
    /// The parameters of a discovery sample that announces the end of `removed`.
    pub fn removal(removed: Guid) -> Self {
        Self { key_hash: Some(removed.to_bytes()), status: Some(StatusInfo::REMOVED), ..Self::default() }
    }

    /// The entity whose end a discovery sample announces. Fast DDS identifies it by the key hash, Cyclone DDS
    /// by a payload that contains only the key. `None` if the sample announces no end, or does not identify
    /// the entity.
    pub fn removed(&self, payload: Payload<'_>) -> Option<Guid> {
        self.status.filter(|status| status.is_removal())?;
        if let Some(key_hash) = self.key_hash {
            return Some(Guid::from_bytes(key_hash));
        }
        let Payload::Key(key) = payload else { return None };
        let mut parameters = ParameterList::from_payload(key).ok()?.iter();
        let guid = parameters.find(|it| matches!(it.id, pid::PARTICIPANT_GUID | pid::ENDPOINT_GUID))?;
        guid.get(|value| value.array().ok()).ok().map(Guid::from_bytes)
    }

    /// Number of bytes on the wire; 0 if there are no parameters.
    pub fn encoded_len(&self) -> usize {
        if self.is_empty() {
            return 0;
        }
        let identity = self.related_sample_identity.map_or(0, |_| 2 * (4 + IDENTITY_LEN));
        let key_hash = self.key_hash.map_or(0, |_| 4 + 16);
        let status = self.status.map_or(0, |_| 4 + 4);
        identity + key_hash + status + 4
    }

    pub(super) fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    pub(super) fn from_list(list: ParameterList<'_>) -> Result<Self, Malformed> {
        let mut inline_qos = Self::default();
        for parameter in list.iter() {
            let identity = |cursor: &mut Cursor<'_>| {
                let writer = Guid::from_bytes(cursor.array().ok()?);
                Some(SampleIdentity { writer, number: SequenceNumber::read_any(cursor).ok()? })
            };
            match parameter.id {
                pid::RELATED_SAMPLE_IDENTITY => {
                    inline_qos.related_sample_identity = Some(parameter.get(identity)?);
                }
                // Other vendors may use the id for something else.
                pid::LEGACY_RELATED_SAMPLE_IDENTITY => {
                    let legacy = parameter.get(identity).ok();
                    inline_qos.related_sample_identity = inline_qos.related_sample_identity.or(legacy);
                }
                pid::KEY_HASH => inline_qos.key_hash = Some(parameter.get(|value| value.array().ok())?),
                pid::STATUS_INFO => {
                    let [.., flags] = parameter.get(|value| value.array::<4>().ok())?;
                    inline_qos.status = Some(StatusInfo(flags));
                }
                _ => {} // Unknown parameters are ignored.
            }
        }
        Ok(inline_qos)
    }

    pub(super) fn write(&self, out: &mut Encoder<'_>) {
        if self.is_empty() {
            return;
        }
        if let Some(identity) = self.related_sample_identity {
            // Fast DDS of ROS 2 Humble and of Debian 12 knows only the older one.
            for id in [pid::RELATED_SAMPLE_IDENTITY, pid::LEGACY_RELATED_SAMPLE_IDENTITY] {
                write_parameter(out, id, |out| {
                    out.bytes(&identity.writer.to_bytes());
                    identity.number.write(out);
                });
            }
        }
        if let Some(key_hash) = self.key_hash {
            write_parameter(out, pid::KEY_HASH, |out| out.bytes(&key_hash));
        }
        if let Some(StatusInfo(flags)) = self.status {
            write_parameter(out, pid::STATUS_INFO, |out| out.bytes(&[0, 0, 0, flags]));
        }
        write_end(out);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::wire::{ByteOrder, EntityId, GuidPrefix};

    const GUID: Guid =
        Guid::new(GuidPrefix([1, 0x44, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]), EntityId::user_writer(5));

    fn read(bytes: &[u8]) -> Result<InlineQos, Malformed> {
        InlineQos::from_list(ParameterList::read(&mut Cursor::new(bytes, ByteOrder::Big))?)
    }

    #[test]
    fn all_parameters_round_trip_in_both_byte_orders() {
        let number = SequenceNumber(0x1_0000_0002);
        let identity = SampleIdentity { writer: GUID, number };
        let full = InlineQos { related_sample_identity: Some(identity), ..InlineQos::removal(GUID) };
        let unknown = SampleIdentity { number: SequenceNumber::UNKNOWN, ..identity };
        let request = InlineQos { related_sample_identity: Some(unknown), ..InlineQos::default() };
        for inline_qos in [full, request, InlineQos::removal(GUID)] {
            for order in [ByteOrder::Big, ByteOrder::Little] {
                let mut bytes = Vec::new();
                inline_qos.write(&mut Encoder::new(&mut bytes, order));
                assert_eq!(bytes.len(), inline_qos.encoded_len());
                let list = ParameterList::read(&mut Cursor::new(&bytes, order)).unwrap();
                assert_eq!(InlineQos::from_list(list), Ok(inline_qos));
            }
        }
    }

    #[test]
    fn empty_inline_qos_has_no_bytes() {
        let mut bytes = Vec::new();
        InlineQos::default().write(&mut Encoder::new(&mut bytes, ByteOrder::Big));
        assert!(bytes.is_empty());
        assert_eq!(InlineQos::default().encoded_len(), 0);
    }

    #[test]
    fn the_identity_of_older_fast_dds_is_used_if_there_is_no_other() {
        let old = [&[0x80, 0x0f, 0, 24][..], &[9; 24]].concat();
        let new = [&[0x00, 0x83, 0, 24][..], &[1; 24]].concat();
        let end = &[0, 1, 0, 0][..];
        let writer = |bytes: &[u8]| read(bytes).unwrap().related_sample_identity.unwrap().writer;
        assert_eq!(writer(&[&old, end].concat()).to_bytes(), [9; 16]);
        assert_eq!(writer(&[&old, &new, end].concat()).to_bytes(), [1; 16]);
        assert_eq!(writer(&[&new, &old, end].concat()).to_bytes(), [1; 16]);
        assert_eq!(
            read(&[0x80, 0x0f, 0, 4, 1, 2, 3, 4, 0, 1, 0, 0]),
            Ok(InlineQos::default()),
            "of another vendor"
        );
    }

    #[test]
    fn a_parameter_that_is_too_short_is_malformed() {
        for id in [pid::RELATED_SAMPLE_IDENTITY, pid::KEY_HASH] {
            let [high, low] = id.to_be_bytes();
            assert_eq!(read(&[high, low, 0, 4, 0, 0, 0, 0, 0, 1, 0, 0]), Err(Malformed::Parameter(id)));
        }
        assert_eq!(read(&[0, 0x71, 0, 0, 0, 1, 0, 0]), Err(Malformed::Parameter(pid::STATUS_INFO)));
    }

    #[test]
    fn a_removal_identifies_the_entity_by_key_hash_or_key() {
        assert_eq!(InlineQos::removal(GUID).removed(Payload::None), Some(GUID));
        let without_hash = InlineQos { key_hash: None, ..InlineQos::removal(GUID) };
        let [mut key, end] = [vec![0, 2, 0, 0, 0, 0x5a, 0, 16], vec![0, 1, 0, 0]];
        key.extend(GUID.to_bytes());
        key.extend(end);
        assert_eq!(without_hash.removed(Payload::Key(&key)), Some(GUID));
        assert_eq!(without_hash.removed(Payload::Data(&key)), None);
        assert_eq!(without_hash.removed(Payload::Key(&key[..20])), None);
        assert_eq!(without_hash.removed(Payload::None), None);
        let alive = InlineQos { status: Some(StatusInfo(0)), ..InlineQos::removal(GUID) };
        assert_eq!(alive.removed(Payload::None), None);
        assert_eq!(InlineQos { status: None, ..alive }.removed(Payload::None), None);
    }
}
