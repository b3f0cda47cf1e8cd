//! Policies from what nodes are seen to do.

use std::collections::BTreeSet;

use super::xml::Writer;
use super::{Enclave, Kind, Policy, Profile, Profiles, Qualifier, Rule, VERSION};

/// What a node of the graph has, with absolute names.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct NodeEndpoints {
    /// The path of its enclave.
    pub enclave: String,
    /// Its namespace, such as `/` or `/robot`.
    pub namespace: String,
    /// Its name.
    pub node: String,
    /// Topics that it subscribes.
    pub subscribes: Vec<String>,
    /// Topics that it publishes.
    pub publishes: Vec<String>,
    /// Services that it has.
    pub replies: Vec<String>,
    /// Services of which it is a client.
    pub requests: Vec<String>,
    /// Actions that it has.
    pub executes: Vec<String>,
    /// Actions of which it is a client.
    pub calls: Vec<String>,
}

impl Policy {
    /// Permits a node what it has, in addition to what the policy says already.
    pub fn permit(&mut self, endpoints: &NodeEndpoints) {
        let profile = self.profile(endpoints);
        let lists = [
            (Kind::Topics, "subscribe", &endpoints.subscribes),
            (Kind::Topics, "publish", &endpoints.publishes),
            (Kind::Services, "reply", &endpoints.replies),
            (Kind::Services, "request", &endpoints.requests),
            (Kind::Actions, "execute", &endpoints.executes),
            (Kind::Actions, "call", &endpoints.calls),
        ];
        for (kind, verb, names) in lists.into_iter().filter(|(_, _, names)| !names.is_empty()) {
            let names: Vec<String> = names.iter().map(|name| endpoints.shortened(name)).collect();
            profile.allowing(kind, verb).names.extend(names);
        }
    }

    /// The policy as XML, in the order in which SROS2 writes it: by the alphabet, each name once.
    pub fn to_xml(&self) -> String {
        let mut xml = Writer::default();
        xml.open("policy", &[("version", VERSION)]);
        xml.open("enclaves", &[]);
        let mut enclaves: Vec<&Enclave> = self.enclaves.iter().collect();
        enclaves.sort_by_key(|enclave| &enclave.path);
        for enclave in enclaves {
            xml.open("enclave", &[("path", &enclave.path)]);
            enclave.profiles.iter().for_each(|profiles| profiles.write(&mut xml));
            xml.close();
        }
        xml.finish()
    }

    /// The profile of a node, which is added if there is none.
    fn profile(&mut self, of: &NodeEndpoints) -> &mut Profile {
        let enclave = find_or_add(
            &mut self.enclaves,
            |enclave| enclave.path == of.enclave,
            || Enclave { path: of.enclave.clone(), profiles: Vec::new() },
        );
        let is_node = |profile: &Profile| profile.namespace == of.namespace && profile.node == of.node;
        let has_node = |profiles: &Profiles| profiles.nodes.iter().any(is_node);
        let is_new = !enclave.profiles.iter().any(has_node);
        let profiles =
            find_or_add(&mut enclave.profiles, |profiles| is_new || has_node(profiles), Profiles::default);
        find_or_add(&mut profiles.nodes, is_node, || Profile {
            namespace: of.namespace.clone(),
            node: of.node.clone(),
            rules: Vec::new(),
        })
    }
}

impl NodeEndpoints {
    /// A name as relative to the node or its namespace, where it can be.
    fn shortened(&self, name: &str) -> String {
        let namespace = self.namespace.trim_end_matches('/');
        let in_namespace = name.strip_prefix(namespace).and_then(|rest| rest.strip_prefix('/'));
        let private =
            in_namespace.and_then(|rest| rest.strip_prefix(&self.node)).filter(|rest| rest.starts_with('/'));
        match (private, in_namespace) {
            (Some(private), _) => format!("~{private}"),
            // In the root namespace, only names without a namespace are relative.
            (None, Some(relative)) if !namespace.is_empty() || !relative.contains('/') => relative.to_owned(),
            _ => name.to_owned(),
        }
    }
}

impl Profile {
    /// The rule that allows the verb and nothing else.
    fn allowing(&mut self, kind: Kind, verb: &str) -> &mut Rule {
        let qualifiers = kind.verbs().map(|known| (known == verb).then_some(Qualifier::Allow));
        let is_same = |rule: &Rule| rule.kind == kind && rule.qualifiers == qualifiers;
        find_or_add(&mut self.rules, is_same, || Rule { kind, qualifiers, names: Vec::new() })
    }

    fn write(&self, xml: &mut Writer) {
        let attributes = [("node", &*self.node), ("ns", &*self.namespace)];
        if self.rules.is_empty() {
            return xml.empty("profile", &attributes);
        }
        xml.open("profile", &attributes);
        let mut rules: Vec<&Rule> = self.rules.iter().collect();
        rules.sort_by_key(|rule| rule.kind);
        rules.into_iter().for_each(|rule| rule.write(xml));
        xml.close();
    }
}

impl Profiles {
    fn write(&self, xml: &mut Writer) {
        let kind: Vec<(&str, &str)> = self.kind.iter().map(|kind| ("type", kind.as_str())).collect();
        xml.open("profiles", &kind);
        let mut nodes: Vec<&Profile> = self.nodes.iter().collect();
        nodes.sort_by_key(|profile| format!("{}{}", profile.namespace, profile.node));
        nodes.into_iter().for_each(|profile| profile.write(xml));
        xml.close();
    }
}

impl Rule {
    fn write(&self, xml: &mut Writer) {
        let text = |qualifier| match qualifier {
            Qualifier::Allow => "ALLOW",
            Qualifier::Deny => "DENY",
        };
        let given = self.kind.verbs().into_iter().zip(self.qualifiers);
        let mut attributes: Vec<(&str, &str)> =
            given.filter_map(|(verb, qualifier)| Some((verb, text(qualifier?)))).collect();
        attributes.sort_unstable();
        let (list, name) = self.kind.elements();
        xml.open(list, &attributes);
        let names: BTreeSet<&String> = self.names.iter().collect();
        names.into_iter().for_each(|each| xml.leaf(name, each));
        xml.close();
    }
}

/// The first item that is wanted, which is added if there is none.
fn find_or_add<T>(items: &mut Vec<T>, is_wanted: impl Fn(&T) -> bool, new: impl FnOnce() -> T) -> &mut T {
    let index = items.iter().position(is_wanted).unwrap_or_else(|| {
        items.push(new());
        items.len() - 1
    });
    &mut items[index]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|&name| name.to_owned()).collect()
    }

    fn walker() -> NodeEndpoints {
        NodeEndpoints {
            enclave: "/robot/walker".to_owned(),
            namespace: "/robot".to_owned(),
            node: "walker".to_owned(),
            subscribes: names(&["/robot/cmd_vel", "/clock"]),
            publishes: names(&["/rosout", "/robot/joint_states", "/robot/walker/gait"]),
            replies: names(&["/robot/walker/get_parameters", "/reset"]),
            requests: names(&["/robot/camera/start"]),
            ..NodeEndpoints::default()
        }
    }

    fn logger() -> NodeEndpoints {
        NodeEndpoints {
            enclave: "/robot/walker".to_owned(),
            namespace: "/".to_owned(),
            node: "logger".to_owned(),
            subscribes: names(&["/rosout", "/robot/joint_states"]),
            replies: names(&["/logger/get_parameters"]),
            ..NodeEndpoints::default()
        }
    }

    #[test]
    fn a_policy_of_nodes_is_that_which_sros2_writes() {
        let expected = include_str!("../../tests/data/policy_generated.xml");
        let mut policy = Policy::default();
        policy.permit(&walker());
        policy.permit(&logger());
        assert_eq!(policy.to_xml(), expected);
        let mut again = Policy::parse(expected).unwrap();
        again.permit(&logger());
        again.permit(&walker());
        assert_eq!(again.to_xml(), expected);
    }

    #[test]
    fn actions_are_permitted_by_their_names() {
        let mut policy = Policy::default();
        let (executes, calls) = (names(&["/robot/walker/stand"]), names(&["/robot/dock"]));
        policy.permit(&NodeEndpoints { executes, calls, ..walker() });
        let written = policy.to_xml();
        for (verb, name) in [("execute", "~/stand"), ("call", "dock")] {
            let rule = format!("<actions {verb}=\"ALLOW\">\n            <action>{name}</action>");
            assert!(written.contains(&rule), "{written}");
        }
    }

    #[test]
    fn a_rule_that_also_says_something_else_is_not_extended() {
        let mut policy = Policy::parse(include_str!("../../tests/data/policy.xml")).unwrap();
        policy.permit(&walker());
        let written = policy.to_xml();
        let denied = "<topics publish=\"DENY\" subscribe=\"ALLOW\">\n            <topic>cmd_vel</topic>\n          </topics>";
        assert!(written.contains(denied), "{written}");
        let added = "<topics subscribe=\"ALLOW\">\n            <topic>/clock</topic>\n            <topic>cmd_vel</topic>";
        assert!(written.contains(added), "{written}");
        assert!(written.contains("<profile node=\"idle\" ns=\"/robot/\"/>"), "{written}");
        let read = Policy::parse(&written).unwrap();
        assert_eq!(read.to_xml(), written);
    }
}
