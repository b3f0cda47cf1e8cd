//! The permissions document that a policy amounts to, byte for byte as SROS2 makes it.
//!
//! # References
//! `policy/templates/dds/permissions.xsl` in the repository ros2/sros2.

use std::collections::BTreeSet;
use std::time::SystemTime;

use super::xml::Writer;
use super::{Kind, Policy, Profile, Profiles, Qualifier, Rule};
use crate::access::time;

const SCHEMA: [(&str, &str); 2] = [
    ("xmlns:xsi", "http://www.w3.org/2001/XMLSchema-instance"),
    (
        "xsi:noNamespaceSchemaLocation",
        "http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_permissions.xsd",
    ),
];

/// The parts of an action: a service, or a topic from its server.
const ACTION_SERVICES: [&str; 3] = ["cancel_goal", "get_result", "send_goal"];
const ACTION_TOPICS: [&str; 2] = ["feedback", "status"];

/// The topics that a rule lets a node publish and subscribe.
#[derive(Default)]
struct Expanded {
    publish: Vec<String>,
    subscribe: Vec<String>,
}

impl Policy {
    /// The permissions of an enclave in a domain, as XML; `None` if the policy has no such enclave.
    pub fn permissions(
        &self,
        enclave: &str,
        domain_id: u32,
        validity: (SystemTime, SystemTime),
    ) -> Option<String> {
        let enclave = self.enclaves.iter().find(|candidate| candidate.path == enclave)?;
        let mut xml = Writer::default();
        xml.open("dds", &SCHEMA);
        xml.open("permissions", &[]);
        for profiles in &enclave.profiles {
            xml.open("grant", &[("name", &enclave.path)]);
            xml.leaf("subject_name", &format!("CN={}", enclave.path));
            xml.open("validity", &[]);
            xml.leaf("not_before", &time::format(validity.0));
            xml.leaf("not_after", &time::format(validity.1));
            xml.close();
            for (rule, qualifier) in [("deny_rule", Qualifier::Deny), ("allow_rule", Qualifier::Allow)] {
                let expanded = profiles.expanded(qualifier);
                if !expanded.is_empty() {
                    write_rule(&mut xml, rule, domain_id, expanded);
                }
            }
            // Without it, nodes do not see each other.
            let graph = || vec!["ros_discovery_info".to_owned()];
            write_rule(
                &mut xml,
                "allow_rule",
                domain_id,
                vec![Expanded { publish: graph(), subscribe: graph() }],
            );
            xml.leaf("default", "DENY");
            xml.close();
        }
        Some(xml.finish())
    }
}

fn write_rule(xml: &mut Writer, name: &str, domain_id: u32, expanded: Vec<Expanded>) {
    xml.open(name, &[]);
    xml.open("domains", &[]);
    xml.leaf("id", &domain_id.to_string());
    xml.close();
    let (publish, subscribe) = expanded.into_iter().map(|rule| (rule.publish, rule.subscribe)).unzip();
    write_topics(xml, "publish", publish);
    write_topics(xml, "subscribe", subscribe);
    xml.close();
}

/// Rules are ordered by their first topics; a topic is written once.
fn write_topics(xml: &mut Writer, name: &str, mut rules: Vec<Vec<String>>) {
    rules.retain(|topics| !topics.is_empty());
    if rules.is_empty() {
        return;
    }
    rules.sort_by(|one, other| one.first().cmp(&other.first()));
    xml.open(name, &[]);
    xml.open("topics", &[]);
    let mut written = BTreeSet::new();
    for topic in rules.iter().flatten() {
        if written.insert(topic) {
            xml.leaf("topic", topic);
        }
    }
    xml.close();
    xml.close();
}

impl Profiles {
    /// The rules with a qualifier, in their order.
    fn expanded(&self, qualifier: Qualifier) -> Vec<Expanded> {
        let rules = self.nodes.iter().flat_map(|node| node.rules.iter().map(move |rule| (node, rule)));
        rules
            .flat_map(|(node, rule)| {
                let verbs = rule.kind.verbs().into_iter().zip(rule.qualifiers);
                let verbs = verbs.filter(|(_, given)| *given == Some(qualifier));
                verbs.map(|(verb, _)| rule.expanded(node, verb)).collect::<Vec<_>>()
            })
            .collect()
    }
}

impl Rule {
    /// What a verb permits a node.
    fn expanded(&self, node: &Profile, verb: &str) -> Expanded {
        let mut requests = Vec::new();
        let mut from_server = Vec::new();
        for name in self.names.iter().map(|name| node.resolved(name)) {
            match self.kind {
                Kind::Topics => from_server.push(format!("rt{name}")),
                Kind::Services => {
                    requests.push(format!("rq{name}Request"));
                    from_server.push(format!("rr{name}Reply"));
                }
                Kind::Actions => {
                    requests.extend(ACTION_SERVICES.map(|part| format!("rq{name}/_action/{part}Request")));
                    from_server.extend(ACTION_SERVICES.map(|part| format!("rr{name}/_action/{part}Reply")));
                    from_server.extend(ACTION_TOPICS.map(|part| format!("rt{name}/_action/{part}")));
                }
            }
        }
        match verb {
            "publish" | "reply" | "execute" => Expanded { publish: from_server, subscribe: requests },
            _ => Expanded { publish: requests, subscribe: from_server },
        }
    }
}

impl Profile {
    /// The absolute name for a name that is absolute, relative to the namespace, or private to the node.
    fn resolved(&self, name: &str) -> String {
        let separator = if self.namespace.ends_with('/') { "" } else { "/" };
        match name.strip_prefix('~') {
            _ if name.starts_with('/') => name.to_owned(),
            Some(private) => format!("{}{separator}{}{private}", self.namespace, self.node),
            None => format!("{}{separator}{name}", self.namespace),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::{Action, Permissions};

    /// Of the certificate for which sros2 made the files in `tests/data`.
    fn validity() -> (SystemTime, SystemTime) {
        (time::parse("2026-11-27T00:07:13").unwrap(), time::parse("2036-11-25T00:07:13").unwrap())
    }

    #[test]
    fn permissions_are_those_that_sros2_makes() {
        let policy = Policy::parse(include_str!("../../tests/data/policy.xml")).unwrap();
        let files = [
            ("/robot/walker", include_str!("../../tests/data/permissions_of_walker.xml")),
            ("/robot/idle", include_str!("../../tests/data/permissions_of_idle.xml")),
        ];
        for (enclave, expected) in files {
            assert_eq!(policy.permissions(enclave, 7, validity()).unwrap(), expected);
        }
        assert_eq!(policy.permissions("/robot", 7, validity()), None);
    }

    #[test]
    fn the_policy_for_everything_is_that_of_sros2() {
        let expected = include_str!(
            "../../tests/data/keystores/talker_listener/enclaves/talker_listener/listener/permissions.xml"
        );
        let path = "/talker_listener/listener";
        assert_eq!(Policy::everything(path).permissions(path, 0, validity()).unwrap(), expected);
    }

    #[test]
    fn names_are_escaped_so_that_permissions_are_read_as_they_were_meant() {
        let path = "/a<b>&\"c";
        let text = Policy::everything(path).permissions(path, 0, validity()).unwrap();
        let permissions = Permissions::parse(&text).unwrap();
        let grant = permissions.grant(&format!("CN={path}")).unwrap();
        assert_eq!(grant.name, path);
        assert!(grant.decide(Action::Subscribe, 0, "rt/chatter", &[]).is_allowed);
    }
}
