//! A governance in words.

use downbeat_security::access::{DataProtection, DomainRule, ProtectionKind, TopicRule};

/// What the rule of a domain means, a sentence for each part.
pub(super) fn sentences(rule: &DomainRule) -> Vec<String> {
    let outsiders = match rule.allow_unauthenticated {
        true => "participants without a certificate may join and use what is not protected",
        false => "participants without a certificate are refused",
    };
    let joining = match rule.join_access_control {
        true => "a participant needs permissions for the domain",
        false => "a participant needs no permissions for the domain",
    };
    let mut sentences = vec![
        outsiders.to_owned(),
        joining.to_owned(),
        format!("whole messages are {}", kind(rule.rtps)),
        format!("the announcements of protected topics are {}", kind(rule.discovery)),
        format!("their signs of life are {}", kind(rule.liveliness)),
    ];
    sentences.extend(rule.topics.iter().map(topic));
    sentences
}

fn topic(rule: &TopicRule) -> String {
    let permission = match (rule.write, rule.read) {
        (true, true) => "publishing and subscribing need permission",
        (true, false) => "publishing needs permission",
        (false, true) => "subscribing needs permission",
        (false, false) => "everybody may publish and subscribe",
    };
    let announced = if rule.discovery { "to certified participants only" } else { "to everybody" };
    let data = match rule.data {
        DataProtection::None => "in clear",
        DataProtection::Sign => "signed",
        DataProtection::Encrypt => "encrypted",
    };
    format!(
        "topics {:?}: {permission}; announced {announced}; submessages are {}, their data {data}",
        rule.expression,
        kind(rule.metadata)
    )
}

fn kind(kind: ProtectionKind) -> &'static str {
    match kind {
        ProtectionKind::None => "in clear",
        ProtectionKind::Sign => "signed",
        ProtectionKind::Encrypt => "encrypted",
        ProtectionKind::SignWithOrigin => "signed for each receiver",
        ProtectionKind::EncryptWithOrigin => "encrypted for each receiver",
    }
}
