//! What may stand in front of a sample (section 8.7.2 and 9.6.4).

use super::bytes::{Cursor, Encoder};
use super::parameters::{ParameterList, pid, write_end, write_parameter};
use super::{Guid, Malformed, Payload, SampleIdentity, SequenceNumber};

/// The parameters in front of a sample that mean something in ROS 2. Others are skipped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InlineQos {
    /// Of a request or its reply. Sent as parameter 0x0083, which every Fast DDS of Jazzy takes; accepted as 0x800f too,
    /// which older ones send.
    pub related_sample_identity: Option<SampleIdentity>,
    /// Identity of the instance; in discovery data the guid of the entity.
    pub key_hash: Option<[u8; 16]>,
    #[allow(missing_docs)]
    pub status: Option<StatusInfo>,
}

/// What became of a sample's instance (section 9.6.4.9).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct StatusInfo(pub u8);

impl StatusInfo {
    /// Disposed and unregistered: the end of an entity, as both Fast DDS and Cyclone DDS say it.
    pub const REMOVED: Self = Self(3);

    /// Whether the instance is disposed, unregistered or both.
    pub fn is_removal(self) -> bool {
        self.0 & 3 != 0
    }
}

const IDENTITY_LEN: usize = 24;

impl InlineQos {
    /// The guid of `removed` and that it has gone: the content of a removal in discovery.
    pub fn removal(removed: Guid) -> Self {
        Self { key_hash: Some(removed.to_bytes()), status: Some(StatusInfo::REMOVED), ..Self::default() }
    }

    /// The entity whose removal a sample of discovery announces: from the key hash, as Fast DDS sends it, or from a payload
    /// that is only the key, as Cyclone DDS does. `None` if this is no removal, or one of nobody.
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

    /// Bytes on the wire: 0 if there is nothing to say.
    pub fn encoded_len(&self) -> usize {
        if self.is_empty() {
            return 0;
        }
        let identity = self.related_sample_identity.map_or(0, |_| 4 + IDENTITY_LEN);
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
                // With another vendor the id may mean anything.
                pid::LEGACY_RELATED_SAMPLE_IDENTITY => {
                    let legacy = parameter.get(identity).ok();
                    inline_qos.related_sample_identity = inline_qos.related_sample_identity.or(legacy);
                }
                pid::KEY_HASH => inline_qos.key_hash = Some(parameter.get(|value| value.array().ok())?),
                pid::STATUS_INFO => {
                    let [.., flags] = parameter.get(|value| value.array::<4>().ok())?;
                    inline_qos.status = Some(StatusInfo(flags));
                }
                _ => {} // A sample is of use without what is not understood.
            }
        }
        Ok(inline_qos)
    }

    pub(super) fn write(&self, out: &mut Encoder<'_>) {
        if self.is_empty() {
            return;
        }
        if let Some(identity) = self.related_sample_identity {
            write_parameter(out, pid::RELATED_SAMPLE_IDENTITY, |out| {
                out.bytes(&identity.writer.to_bytes());
                identity.number.write(out);
            });
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
