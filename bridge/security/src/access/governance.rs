//! The governance document: how a domain and its topics are protected.

use super::domains::Domains;
use super::pattern;
use super::permissions::{Action, Decision, Grant};
use crate::document::{self, DocumentError, Element};

/// A parsed governance document.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Governance {
    rules: Vec<DomainRule>,
}

/// How the messages of some domains are protected.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DomainRule {
    /// The domains of this rule.
    pub domains: Domains,
    /// Whether participants without a certificate may join, and use what is not protected.
    pub allow_unauthenticated: bool,
    /// Whether a participant needs permissions to join.
    pub join_access_control: bool,
    /// The protection of the secure discovery of endpoints.
    pub discovery: ProtectionKind,
    /// The protection of liveliness messages.
    pub liveliness: ProtectionKind,
    /// The protection of whole messages.
    pub rtps: ProtectionKind,
    /// The rules of topics, of which the first that matches applies.
    pub topics: Vec<TopicRule>,
}

/// How some topics are protected.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TopicRule {
    /// A pattern of names of topics.
    pub expression: String,
    /// Whether only the secure discovery announces endpoints.
    pub discovery: bool,
    /// Whether liveliness is only asserted by protected messages.
    pub liveliness: bool,
    /// Whether a reader needs permission.
    pub read: bool,
    /// Whether a writer needs permission.
    pub write: bool,
    /// The protection of submessages.
    pub metadata: ProtectionKind,
    /// The protection of payloads.
    pub data: DataProtection,
}

/// How messages or submessages are protected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProtectionKind {
    /// Not at all.
    None,
    /// By a code of the group of receivers.
    Sign,
    /// By encryption with a key of the group of receivers.
    Encrypt,
    /// As `Sign`, and by a code for each receiver.
    SignWithOrigin,
    /// As `Encrypt`, and by a code for each receiver.
    EncryptWithOrigin,
}

impl ProtectionKind {
    /// Whether there is any protection.
    pub fn is_protected(self) -> bool {
        self != Self::None
    }

    /// Whether others cannot read what is sent.
    pub fn is_encrypted(self) -> bool {
        matches!(self, Self::Encrypt | Self::EncryptWithOrigin)
    }

    /// Whether each receiver can tell the sender from other members of the group.
    pub fn has_origin(self) -> bool {
        matches!(self, Self::SignWithOrigin | Self::EncryptWithOrigin)
    }

    fn read(element: Element) -> Result<Self, DocumentError> {
        let expected = "NONE, SIGN, ENCRYPT, SIGN_WITH_ORIGIN_AUTHENTICATION or \
                        ENCRYPT_WITH_ORIGIN_AUTHENTICATION";
        element.value(expected, |text| match text {
            "NONE" => Some(Self::None),
            "SIGN" => Some(Self::Sign),
            "ENCRYPT" => Some(Self::Encrypt),
            "SIGN_WITH_ORIGIN_AUTHENTICATION" => Some(Self::SignWithOrigin),
            "ENCRYPT_WITH_ORIGIN_AUTHENTICATION" => Some(Self::EncryptWithOrigin),
            _ => None,
        })
    }
}

/// How payloads are protected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DataProtection {
    /// Not at all.
    None,
    /// By a code.
    Sign,
    /// By encryption.
    Encrypt,
}

impl DataProtection {
    fn read(element: Element) -> Result<Self, DocumentError> {
        element.value("NONE, SIGN or ENCRYPT", |text| match text {
            "NONE" => Some(Self::None),
            "SIGN" => Some(Self::Sign),
            "ENCRYPT" => Some(Self::Encrypt),
            _ => None,
        })
    }
}

impl Governance {
    /// Parses the XML of a governance document.
    ///
    /// # Errors
    /// If the text is not a document as the OMG's schema has it, except that the order of elements within a
    /// rule is free.
    pub fn parse(xml: &str) -> Result<Self, DocumentError> {
        document::read(xml, "dds", |dds| {
            let rules = dds.children(&["domain_access_rules"])?.one("domain_access_rules")?;
            let rules = rules.children(&["domain_rule"])?;
            let rules = rules.some("domain_rule")?.iter().map(|rule| DomainRule::read(*rule));
            rules.collect::<Result<_, _>>().map(|rules| Self { rules })
        })
    }

    /// The first rule for a domain.
    pub fn domain(&self, domain_id: u32) -> Option<&DomainRule> {
        self.rules.iter().find(|rule| rule.domains.contains(domain_id))
    }
}

impl DomainRule {
    /// The first rule for a topic, by its name in DDS, such as `rt/chatter`.
    pub fn topic(&self, name: &str) -> Option<&TopicRule> {
        self.topics.iter().find(|rule| pattern::matches(&rule.expression, name))
    }

    fn read(element: Element) -> Result<Self, DocumentError> {
        let children = element.children(&[
            "domains",
            "allow_unauthenticated_participants",
            "enable_join_access_control",
            "discovery_protection_kind",
            "liveliness_protection_kind",
            "rtps_protection_kind",
            "topic_access_rules",
        ])?;
        let topics = children.one("topic_access_rules")?.children(&["topic_rule"])?;
        Ok(Self {
            domains: Domains::read(children.one("domains")?)?,
            allow_unauthenticated: boolean(children.one("allow_unauthenticated_participants")?)?,
            join_access_control: boolean(children.one("enable_join_access_control")?)?,
            discovery: ProtectionKind::read(children.one("discovery_protection_kind")?)?,
            liveliness: ProtectionKind::read(children.one("liveliness_protection_kind")?)?,
            rtps: ProtectionKind::read(children.one("rtps_protection_kind")?)?,
            topics: topics
                .some("topic_rule")?
                .iter()
                .map(|rule| TopicRule::read(*rule))
                .collect::<Result<_, _>>()?,
        })
    }
}

impl TopicRule {
    /// Whether the holder of a grant may have an endpoint of a topic for which this rule is.
    pub fn decide(
        &self,
        grant: &Grant,
        action: Action,
        domain_id: u32,
        topic: &str,
        partitions: &[String],
    ) -> Decision {
        let is_checked = match action {
            Action::Publish => self.write,
            Action::Subscribe => self.read,
        };
        if !is_checked {
            let rule = format!("the governance leaves {:?} to everybody", self.expression);
            return Decision { is_allowed: true, rule };
        }
        grant.decide(action, domain_id, topic, partitions)
    }

    fn read(element: Element) -> Result<Self, DocumentError> {
        let children = element.children(&[
            "topic_expression",
            "enable_discovery_protection",
            "enable_liveliness_protection",
            "enable_read_access_control",
            "enable_write_access_control",
            "metadata_protection_kind",
            "data_protection_kind",
        ])?;
        Ok(Self {
            expression: children.one("topic_expression")?.text()?,
            discovery: boolean(children.one("enable_discovery_protection")?)?,
            liveliness: boolean(children.one("enable_liveliness_protection")?)?,
            read: boolean(children.one("enable_read_access_control")?)?,
            write: boolean(children.one("enable_write_access_control")?)?,
            metadata: ProtectionKind::read(children.one("metadata_protection_kind")?)?,
            data: DataProtection::read(children.one("data_protection_kind")?)?,
        })
    }
}

/// XML Schema has `true`, `false`, `1` and `0`; the first version of DDS Security had them in capitals.
fn boolean(element: Element) -> Result<bool, DocumentError> {
    element.value("true or false", |text| match text {
        "1" => Some(true),
        "0" => Some(false),
        _ if text.eq_ignore_ascii_case("true") => Some(true),
        _ if text.eq_ignore_ascii_case("false") => Some(false),
        _ => None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::Problem;

    const TWO_RULES: &str = include_str!("../../tests/data/governance.xml");

    #[test]
    fn the_first_rule_of_a_domain_and_of_a_topic_applies() {
        let governance = Governance::parse(TWO_RULES).unwrap();
        let rule = governance.domain(5).unwrap();
        assert!(!rule.allow_unauthenticated && rule.join_access_control);
        assert_eq!(rule.discovery, ProtectionKind::SignWithOrigin);
        assert_eq!(rule.liveliness, ProtectionKind::Encrypt);
        assert_eq!(rule.rtps, ProtectionKind::EncryptWithOrigin);
        let topic = rule.topic("OwnShipData").unwrap();
        assert!(!topic.discovery && !topic.liveliness && !topic.read && topic.write);
        assert_eq!((topic.metadata, topic.data), (ProtectionKind::Sign, DataProtection::Encrypt));
        assert_eq!(rule.topic("rt/chatter").unwrap().expression, "*");
        let open = governance.domain(100).unwrap();
        assert!(open.allow_unauthenticated && !open.join_access_control);
        assert_eq!(open.topic("rt/chatter"), None);
        assert_eq!(open.topic("rt/own").unwrap().data, DataProtection::None);
    }

    #[test]
    fn ranges_of_domains_may_be_open_at_one_end() {
        let governance = Governance::parse(TWO_RULES).unwrap();
        for domain_id in [0, 9, 20] {
            assert!(!governance.domain(domain_id).unwrap().allow_unauthenticated, "{domain_id}");
        }
        assert_eq!(governance.domain(10), None);
        assert!(governance.domain(99).is_none());
        assert!(governance.domain(u32::MAX).unwrap().allow_unauthenticated);
    }

    #[test]
    fn a_document_that_the_schema_refuses_is_refused() {
        let cases = [
            (
                "<rtps_protection_kind>NONE</rtps_protection_kind>",
                "",
                "<domain_rule> lacks <rtps_protection_kind>",
            ),
            ("<id>20</id>", "<id>-1</id>", "\"-1\" is no value of <id>"),
            ("<id>20</id>", "<id>4294967296</id>", "is no value of <id>"),
            ("<id>20</id>", "<id_range></id_range>", "<id_range> lacks <min>"),
            ("<id>20</id>", "<id_range><min>2</min><max>1</max></id_range>", "begins at 2 and ends at 1"),
            (
                "<id>20</id>",
                "<domain>20</domain>",
                "<domain> is unknown in <domains>, which takes <id>, <id_range>",
            ),
            (
                ">TRUE<",
                ">yes<",
                "\"yes\" is no value of <enable_join_access_control>, which is true or false",
            ),
            (">NONE</data", ">ENCRYPT_WITH_ORIGIN_AUTHENTICATION</data", "which is NONE, SIGN or ENCRYPT"),
            ("<id>20</id>", "<id>20</id>20", "<domains> holds text"),
            ("<dds", "<ddss", "this is not XML"),
            ("<id>20</id>", "<id unit=\"one\">20</id>", "attribute \"unit\" is unknown"),
        ];
        for (good, bad, expected) in cases {
            assert!(TWO_RULES.contains(good), "{good}");
            let error = Governance::parse(&TWO_RULES.replace(good, bad)).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        let twice = TWO_RULES.replace("<id>20</id>", "</domains><domains><id>20</id>");
        let error = Governance::parse(&twice).unwrap_err();
        assert_eq!(error.problem, Problem::Repeated("domains".to_owned()));
        assert!(error.to_string().starts_with("line 13: "), "{error}");
    }
}
