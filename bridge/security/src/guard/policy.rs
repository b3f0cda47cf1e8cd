//! What the governance and the own permissions say about a domain, in the terms of the engine.

use downbeat_rtps::protocol::BUILTIN_OF_SECURITY;
use downbeat_rtps::wire::{EndpointData, EntityId, SecurityAttributes};

use crate::access::{Action, DataProtection, Decision, DomainRule, Grant, ProtectionKind, TopicRule};
use crate::cryptography::TransformKind;

/// The rules of one domain for this participant.
#[derive(Debug)]
pub(super) struct Policy {
    pub(super) domain_id: u32,
    pub(super) rule: DomainRule,
    /// What this participant may do.
    pub(super) grant: Grant,
}

/// How the messages of an endpoint are protected.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Protection {
    pub(super) submessage: Option<TransformKind>,
    pub(super) payload: Option<TransformKind>,
}

impl Protection {
    pub(super) fn is_any(self) -> bool {
        self.submessage.is_some() || self.payload.is_some()
    }
}

/// Bits of the attributes of a participant (DDS Security 1.1, sections 7.4.1.4.1 and 9.4.2.3).
mod participant {
    pub(super) const IS_RTPS_PROTECTED: u32 = 1;
    pub(super) const IS_DISCOVERY_PROTECTED: u32 = 1 << 1;
    pub(super) const IS_LIVELINESS_PROTECTED: u32 = 1 << 2;
    pub(super) const IS_RTPS_ENCRYPTED: u32 = 1;
    pub(super) const IS_DISCOVERY_ENCRYPTED: u32 = 1 << 1;
    pub(super) const IS_LIVELINESS_ENCRYPTED: u32 = 1 << 2;
    pub(super) const HAS_RTPS_ORIGIN: u32 = 1 << 3;
    pub(super) const HAS_DISCOVERY_ORIGIN: u32 = 1 << 4;
    pub(super) const HAS_LIVELINESS_ORIGIN: u32 = 1 << 5;
}

/// Bits of the attributes of an endpoint (sections 7.4.1.5.1 and 9.4.2.4).
mod endpoint {
    pub(super) const IS_READ_PROTECTED: u32 = 1;
    pub(super) const IS_WRITE_PROTECTED: u32 = 1 << 1;
    pub(super) const IS_DISCOVERY_PROTECTED: u32 = 1 << 2;
    pub(super) const IS_SUBMESSAGE_PROTECTED: u32 = 1 << 3;
    pub(super) const IS_PAYLOAD_PROTECTED: u32 = 1 << 4;
    pub(super) const IS_KEY_PROTECTED: u32 = 1 << 5;
    pub(super) const IS_LIVELINESS_PROTECTED: u32 = 1 << 6;
    pub(super) const IS_SUBMESSAGE_ENCRYPTED: u32 = 1;
    pub(super) const IS_PAYLOAD_ENCRYPTED: u32 = 1 << 1;
    pub(super) const HAS_SUBMESSAGE_ORIGIN: u32 = 1 << 2;
}

/// The bits that are set.
fn bits(all: &[(bool, u32)]) -> u32 {
    all.iter().filter(|(is_set, _)| *is_set).fold(SecurityAttributes::IS_VALID, |mask, (_, bit)| mask | bit)
}

/// The key for a kind of protection; the stronger one, as all others use it.
pub(super) fn transform(kind: ProtectionKind) -> Option<TransformKind> {
    kind.is_protected()
        .then(|| if kind.is_encrypted() { TransformKind::Aes256Gcm } else { TransformKind::Aes256Gmac })
}

/// Whether two announce different protection, as far as both announce it (the rule of Fast DDS and Cyclone).
pub(super) fn contradicts(a: SecurityAttributes, b: SecurityAttributes) -> bool {
    let differ = |a: u32, b: u32| a & b & SecurityAttributes::IS_VALID != 0 && a != b;
    differ(a.mask, b.mask) || differ(a.plugin_mask, b.plugin_mask)
}

impl Policy {
    /// What this participant announces about itself.
    pub(super) fn attributes(&self) -> SecurityAttributes {
        let DomainRule { rtps, discovery, liveliness, .. } = self.rule;
        SecurityAttributes {
            mask: bits(&[
                (rtps.is_protected(), participant::IS_RTPS_PROTECTED),
                (discovery.is_protected(), participant::IS_DISCOVERY_PROTECTED),
                (liveliness.is_protected(), participant::IS_LIVELINESS_PROTECTED),
            ]),
            plugin_mask: bits(&[
                (rtps.is_encrypted(), participant::IS_RTPS_ENCRYPTED),
                (discovery.is_encrypted(), participant::IS_DISCOVERY_ENCRYPTED),
                (liveliness.is_encrypted(), participant::IS_LIVELINESS_ENCRYPTED),
                (rtps.has_origin(), participant::HAS_RTPS_ORIGIN),
                (discovery.has_origin(), participant::HAS_DISCOVERY_ORIGIN),
                (liveliness.has_origin(), participant::HAS_LIVELINESS_ORIGIN),
            ]),
        }
    }

    /// The rule of a topic; `None` if the governance has none, so that the topic may not be used.
    pub(super) fn topic(&self, name: &str) -> Option<&TopicRule> {
        self.rule.topic(name)
    }

    /// What is announced about an endpoint of a topic.
    pub(super) fn endpoint_attributes(rule: &TopicRule) -> SecurityAttributes {
        let is_payload_encrypted = rule.data == DataProtection::Encrypt;
        SecurityAttributes {
            mask: bits(&[
                (rule.read, endpoint::IS_READ_PROTECTED),
                (rule.write, endpoint::IS_WRITE_PROTECTED),
                (rule.discovery, endpoint::IS_DISCOVERY_PROTECTED),
                (rule.metadata.is_protected(), endpoint::IS_SUBMESSAGE_PROTECTED),
                (rule.data != DataProtection::None, endpoint::IS_PAYLOAD_PROTECTED),
                (is_payload_encrypted, endpoint::IS_KEY_PROTECTED),
                (rule.liveliness, endpoint::IS_LIVELINESS_PROTECTED),
            ]),
            plugin_mask: bits(&[
                (rule.metadata.is_encrypted(), endpoint::IS_SUBMESSAGE_ENCRYPTED),
                (is_payload_encrypted, endpoint::IS_PAYLOAD_ENCRYPTED),
                (rule.metadata.has_origin(), endpoint::HAS_SUBMESSAGE_ORIGIN),
            ]),
        }
    }

    /// How the endpoints of a topic are protected.
    pub(super) fn protection(rule: &TopicRule) -> Protection {
        Protection {
            submessage: transform(rule.metadata),
            payload: match rule.data {
                DataProtection::None => None,
                DataProtection::Sign => Some(TransformKind::Aes256Gmac),
                DataProtection::Encrypt => Some(TransformKind::Aes256Gcm),
            },
        }
    }

    /// How a builtin endpoint is protected.
    pub(super) fn builtin_protection(&self, entity: EntityId) -> Protection {
        let submessage = match entity {
            EntityId::WLP_SECURE_WRITER | EntityId::WLP_SECURE_READER => transform(self.rule.liveliness),
            entity if is_secure_builtin(entity) => transform(self.rule.discovery),
            _ => None,
        };
        Protection { submessage, payload: None }
    }

    /// Whether a participant with `grant` may have an endpoint.
    pub(super) fn decide(&self, grant: &Grant, rule: &TopicRule, data: &EndpointData) -> Decision {
        let action = if data.guid.entity.is_writer() { Action::Publish } else { Action::Subscribe };
        rule.decide(grant, action, self.domain_id, &data.topic, &data.qos.partition)
    }
}

/// Whether an endpoint is one of those that DDS Security adds for authenticated participants, without the
/// channel for keys.
pub(super) fn is_secure_builtin(entity: EntityId) -> bool {
    BUILTIN_OF_SECURITY.iter().any(|builtin| builtin.writer == entity || builtin.reader == entity)
}
