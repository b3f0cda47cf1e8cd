//! The permissions document: what each participant may do.

use std::time::SystemTime;

use super::domains::Domains;
use super::subject::Subject;
use super::{pattern, time};
use crate::document::{self, DocumentError, Element, Problem};

/// A parsed permissions document.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Permissions {
    grants: Vec<Grant>,
}

/// What the holder of a certificate may do, and for how long.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Grant {
    /// The name of the grant, for messages only.
    pub name: String,
    /// The subject of the certificate, as the document writes it.
    pub subject: String,
    /// The grant is valid from the first to the last of these times.
    pub validity: (SystemTime, SystemTime),
    parsed_subject: Subject,
    rules: Vec<Rule>,
    is_allowed_by_default: bool,
}

/// What an endpoint does with a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Writes samples.
    Publish,
    /// Reads samples.
    Subscribe,
}

/// What a grant says about an endpoint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Decision {
    /// Whether the endpoint is permitted.
    pub is_allowed: bool,
    /// The rule that decided, for example `grant "/talker", rule 1 (allow): publish "rt/*"`.
    pub rule: String,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Rule {
    is_allowed: bool,
    domains: Domains,
    publish: Vec<Criterion>,
    subscribe: Vec<Criterion>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Criterion {
    topics: Vec<String>,
    /// `None` if the document says nothing.
    partitions: Option<Vec<String>>,
    /// No endpoint of ours has tags, so no such criterion applies.
    has_tags: bool,
}

impl Permissions {
    /// Parses the XML of a permissions document.
    ///
    /// # Errors
    /// If the text is not a document as the OMG's schema has it, except that the order of elements is free
    /// where it says nothing.
    pub fn parse(xml: &str) -> Result<Self, DocumentError> {
        document::read(xml, "dds", |dds| {
            let grants = dds.children(&["permissions"])?.one("permissions")?.children(&["grant"])?;
            let grants = grants.some("grant")?.iter().map(|grant| Grant::read(*grant));
            grants.collect::<Result<_, _>>().map(|grants| Self { grants })
        })
    }

    /// The first grant for the subject of a certificate.
    pub fn grant(&self, subject: &str) -> Option<&Grant> {
        self.of(subject).next()
    }

    /// The first grant for the subject of a certificate that is valid at a time.
    pub fn valid_grant(&self, subject: &str, now: SystemTime) -> Option<&Grant> {
        self.of(subject).find(|grant| grant.valid(now))
    }

    /// The subjects of all grants.
    pub fn subjects(&self) -> impl Iterator<Item = &str> {
        self.grants.iter().map(|grant| grant.subject.as_str())
    }

    fn of(&self, subject: &str) -> impl Iterator<Item = &Grant> {
        let subject = Subject::parse(subject);
        self.grants.iter().filter(move |grant| Some(&grant.parsed_subject) == subject.as_ref())
    }
}

impl Grant {
    /// Whether the grant is valid at a time.
    pub fn valid(&self, now: SystemTime) -> bool {
        let (from, to) = self.validity;
        (from..=to).contains(&now)
    }

    /// Whether a participant may join the domain: something may be permitted there.
    pub fn may_join(&self, domain_id: u32) -> bool {
        let mut here = self.rules.iter().filter(|rule| rule.domains.contains(domain_id));
        self.is_allowed_by_default || here.any(|rule| rule.is_allowed)
    }

    /// Whether an endpoint may exist, by the first rule that applies to its domain, topic and partitions.
    /// `topic` is the name in DDS, such as `rt/chatter`; no partitions is the default partition.
    pub fn decide(&self, action: Action, domain_id: u32, topic: &str, partitions: &[String]) -> Decision {
        let default = [String::new()];
        let partitions = if partitions.is_empty() { &default } else { partitions };
        for (rule, number) in self.rules.iter().zip(1..) {
            if !rule.domains.contains(domain_id) {
                continue;
            }
            let (criteria, verb) = match action {
                Action::Publish => (&rule.publish, "publish"),
                Action::Subscribe => (&rule.subscribe, "subscribe"),
            };
            let mut topics =
                criteria.iter().filter_map(|one| one.applies(rule.is_allowed, topic, partitions));
            if let Some(expression) = topics.next() {
                let kind = if rule.is_allowed { "allow" } else { "deny" };
                let rule_name =
                    format!("grant {:?}, rule {number} ({kind}): {verb} {expression:?}", self.name);
                return Decision { is_allowed: rule.is_allowed, rule: rule_name };
            }
        }
        let default = if self.is_allowed_by_default { "ALLOW" } else { "DENY" };
        let rule = format!("grant {:?}, default {default}: no rule applies", self.name);
        Decision { is_allowed: self.is_allowed_by_default, rule }
    }

    fn read(element: Element) -> Result<Self, DocumentError> {
        element.expect_attributes(&["name"])?;
        let children =
            element.children(&["subject_name", "validity", "allow_rule", "deny_rule", "default"])?;
        let subject = children.one("subject_name")?;
        let is_rule = |child: &Element| child.name().ends_with("_rule");
        let rules: Vec<Rule> = children.iter().filter(is_rule).map(Rule::read).collect::<Result<_, _>>()?;
        Ok(Self {
            name: element.required("name")?.to_owned(),
            subject: subject.text()?,
            parsed_subject: subject.value("a name such as CN=/talker", Subject::parse)?,
            validity: validity(children.one("validity")?)?,
            rules,
            is_allowed_by_default: children.one("default")?.value("ALLOW or DENY", |text| match text {
                "ALLOW" => Some(true),
                "DENY" => Some(false),
                _ => None,
            })?,
        })
    }
}

fn validity(element: Element) -> Result<(SystemTime, SystemTime), DocumentError> {
    let children = element.children(&["not_before", "not_after"])?;
    let read = |name| children.one(name)?.value("a time such as 2030-05-01T00:00:00", time::parse);
    let (from, to) = (read("not_before")?, read("not_after")?);
    if to < from {
        let (found, of) = (time::format(to), "<not_after>".to_owned());
        return Err(element.error(Problem::Value { found, of, expected: "a time after <not_before>" }));
    }
    Ok((from, to))
}

impl Rule {
    fn read(element: Element) -> Result<Self, DocumentError> {
        let children = element.children(&["domains", "publish", "subscribe", "relay"])?;
        let criteria = |name: &str| -> Result<Vec<Criterion>, DocumentError> {
            children.iter().filter(|child| child.name() == name).map(Criterion::read).collect()
        };
        // Relays are checked like the rest, and granted to nobody.
        criteria("relay")?;
        Ok(Self {
            is_allowed: element.name() == "allow_rule",
            domains: Domains::read(children.one("domains")?)?,
            publish: criteria("publish")?,
            subscribe: criteria("subscribe")?,
        })
    }
}

impl Criterion {
    /// The expression of the topic, if topic and partitions match. To be allowed, all partitions must be
    /// named; a rule that denies one of them denies the endpoint. A rule that names none allows only the
    /// default partition, but denies every one.
    fn applies(&self, is_allowed: bool, topic: &str, partitions: &[String]) -> Option<&str> {
        if self.has_tags {
            return None;
        }
        let expression = self.topics.iter().find(|expression| pattern::matches(expression, topic))?;
        let named = self.partitions.as_deref();
        let is_match = if is_allowed {
            let is_named = |partition: &String| match named {
                None => partition.is_empty(),
                Some(named) => named.iter().any(|expression| pattern::contains(expression, partition)),
            };
            partitions.iter().all(is_named)
        } else {
            let is_named = |partition: &String| {
                named.is_none_or(|named| named.iter().any(|expression| pattern::meets(expression, partition)))
            };
            partitions.iter().any(is_named)
        };
        is_match.then_some(expression)
    }

    fn read(element: Element) -> Result<Self, DocumentError> {
        let children = element.children(&["topics", "partitions", "data_tags"])?;
        let tags = children.optional("data_tags")?;
        tags.map_or(Ok(()), check_tags)?;
        let partitions = children.optional("partitions")?;
        Ok(Self {
            topics: texts(children.one("topics")?, "topic")?,
            partitions: partitions.map(|list| texts(list, "partition")).transpose()?,
            has_tags: tags.is_some(),
        })
    }
}

fn texts(list: Element, name: &'static str) -> Result<Vec<String>, DocumentError> {
    list.children(&[name])?.some(name)?.iter().map(|element| element.text()).collect()
}

fn check_tags(list: Element) -> Result<(), DocumentError> {
    for tag in list.children(&["tag"])?.some("tag")? {
        for part in tag.children(&["name", "value"])?.some("name")? {
            part.text()?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    const DOCUMENT: &str = include_str!("../../tests/data/permissions.xml");

    fn talker() -> Grant {
        Permissions::parse(DOCUMENT).unwrap().grant("CN=/talker,O=robots").unwrap().clone()
    }

    #[track_caller]
    fn expect(grant: &Grant, endpoint: (Action, u32, &str, &[&str]), is_allowed: bool, rule: &str) {
        let (action, domain_id, topic, partitions) = endpoint;
        let partitions: Vec<String> = partitions.iter().map(|&partition| partition.to_owned()).collect();
        let rule = format!("grant \"talker\", {rule}");
        assert_eq!(grant.decide(action, domain_id, topic, &partitions), Decision { is_allowed, rule });
    }

    #[test]
    fn the_first_rule_that_applies_decides_and_is_named() {
        use Action::{Publish, Subscribe};
        let grant = talker();
        expect(&grant, (Publish, 0, "rt/chatter", &[]), true, "rule 2 (allow): publish \"rt/c*\"");
        expect(&grant, (Publish, 0, "rt/cmd_vel", &[]), false, "rule 1 (deny): publish \"rt/cmd_*\"");
        expect(&grant, (Publish, 2, "rt/cmd_vel", &[]), true, "rule 2 (allow): publish \"rt/c*\"");
        expect(&grant, (Publish, 6, "rt/chatter", &[]), false, "default DENY: no rule applies");
        expect(&grant, (Subscribe, 0, "rt/chatter", &[]), false, "default DENY: no rule applies");
        expect(&grant, (Subscribe, 0, "rt/odom", &[]), true, "rule 2 (allow): subscribe \"rt/odom\"");
    }

    #[test]
    fn a_rule_allows_only_partitions_that_it_names_and_denies_all_that_it_does_not() {
        use Action::{Publish, Subscribe};
        let grant = talker();
        let default = "default DENY: no rule applies";
        expect(&grant, (Publish, 0, "rt/chatter", &["a"]), false, default);
        expect(&grant, (Publish, 0, "rt/chatter", &["", "a"]), false, default);
        expect(&grant, (Publish, 0, "rt/cmd_vel", &["a"]), false, "rule 1 (deny): publish \"rt/cmd_*\"");
        let part = "rule 3 (allow): subscribe \"rt/part\"";
        expect(&grant, (Subscribe, 0, "rt/part", &["left"]), true, part);
        expect(&grant, (Subscribe, 0, "rt/part", &["left", "arm/1"]), true, part);
        expect(&grant, (Subscribe, 0, "rt/part", &["left", "right"]), false, default);
        expect(&grant, (Subscribe, 0, "rt/part", &["*"]), false, default);
        expect(&grant, (Subscribe, 0, "rt/part", &[]), false, default);
    }

    #[test]
    fn a_criterion_with_tags_applies_to_no_endpoint_and_relays_are_not_granted() {
        let grant = talker();
        expect(&grant, (Action::Publish, 0, "rt/tagged", &[]), false, "default DENY: no rule applies");
        expect(&grant, (Action::Subscribe, 0, "rt/relayed", &[]), false, "default DENY: no rule applies");
    }

    #[test]
    fn a_grant_is_found_by_its_subject_and_valid_between_its_times() {
        let permissions = Permissions::parse(DOCUMENT).unwrap();
        assert_eq!(permissions.grant("CN=/talker"), None);
        assert_eq!(permissions.grant("CN=/talker, O=robots").unwrap().name, "talker");
        let grant = permissions.grant("CN=/listener").unwrap();
        let (from, to) = grant.validity;
        assert_eq!(to, SystemTime::UNIX_EPOCH + Duration::from_secs(1_903_824_000));
        assert!(grant.valid(from) && grant.valid(to));
        assert!(!grant.valid(from - Duration::from_secs(1)) && !grant.valid(to + Duration::from_secs(1)));
        let later = to + Duration::from_secs(3600);
        assert_eq!(permissions.valid_grant("CN=/listener", later).unwrap().name, "listener renewed");
        assert_eq!(permissions.valid_grant("CN=/listener", from - Duration::from_secs(1)), None);
    }

    #[test]
    fn a_participant_may_join_where_something_may_be_allowed() {
        let grant = talker();
        assert!(grant.may_join(0) && grant.may_join(5));
        assert!(!grant.may_join(6));
        let permissions = Permissions::parse(DOCUMENT).unwrap();
        let open = permissions.grant("CN=/listener").unwrap();
        assert!(open.may_join(6));
        assert!(open.decide(Action::Publish, 6, "rt/any", &["any".to_owned()]).is_allowed);
    }

    #[test]
    fn a_document_that_the_schema_refuses_is_refused() {
        let cases = [
            ("<grant name=\"talker\">", "<grant>", "<grant> lacks attribute \"name\""),
            (
                "<grant name=\"talker\">",
                "<grant name=\"talker\" level=\"2\">",
                "attribute \"level\" is unknown in <grant>",
            ),
            ("CN=/talker, O=robots", "/talker", "\"/talker\" is no value of <subject_name>"),
            ("2030-05-01T00:00:00", "tomorrow", "\"tomorrow\" is no value of <not_"),
            ("<not_after>2030-05-01T02:00:00+02:00</not_after>", "", "<validity> lacks <not_after>"),
            ("2030-05-01T02:00:00+02:00", "2010-05-01T02:00:00+02:00", "a time after <not_before>"),
            ("<deny_rule>", "<forbid_rule>", "this is not XML"),
            ("<topic>rt/odom</topic>", "<ufo>rt/odom</ufo>", "<ufo> is unknown in <topics>"),
            ("<topic>rt/odom</topic>", "", "<topics> lacks <topic>"),
            ("<default>DENY</default>", "", "<grant> lacks <default>"),
            ("<default>DENY</default>", "<default>deny</default>", "which is ALLOW or DENY"),
            ("<name>level</name>", "<key>level</key>", "<key> is unknown in <tag>"),
        ];
        for (good, bad, expected) in cases {
            assert!(DOCUMENT.contains(good), "{good}");
            let error = Permissions::parse(&DOCUMENT.replace(good, bad)).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
