//! Policies of SROS2: which topics, services and actions each node of an enclave may use, in the names of
//! ROS. Permissions are made of them.

mod generate;
mod permissions;
mod xml;

pub use generate::NodeEndpoints;

use crate::document::{self, DocumentError, Element, Problem};

const VERSION: &str = "0.2.0";

/// A policy file.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Policy {
    enclaves: Vec<Enclave>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Enclave {
    path: String,
    profiles: Vec<Profiles>,
}

/// Nodes whose rules become one grant.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
struct Profiles {
    /// Without a meaning for SROS2.
    kind: Option<String>,
    nodes: Vec<Profile>,
}

/// What a node may do.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Profile {
    namespace: String,
    node: String,
    rules: Vec<Rule>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Rule {
    kind: Kind,
    /// For the verbs of the kind.
    qualifiers: [Option<Qualifier>; 2],
    /// Absolute, relative or private names, perhaps patterns.
    names: Vec<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Qualifier {
    Allow,
    Deny,
}

/// What a rule is about. The order is that of their names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    Actions,
    Services,
    Topics,
}

impl Kind {
    const ALL: [Self; 3] = [Self::Actions, Self::Services, Self::Topics];

    /// The names of the elements for a list and for one of it.
    const fn elements(self) -> (&'static str, &'static str) {
        match self {
            Self::Actions => ("actions", "action"),
            Self::Services => ("services", "service"),
            Self::Topics => ("topics", "topic"),
        }
    }

    /// The attributes, in the order in which their rules are expanded.
    const fn verbs(self) -> [&'static str; 2] {
        match self {
            Self::Actions => ["call", "execute"],
            Self::Services => ["request", "reply"],
            Self::Topics => ["publish", "subscribe"],
        }
    }
}

impl Policy {
    /// Parses the XML of a policy file.
    ///
    /// # Errors
    /// If the text is not a policy of version 0.2.0 as SROS2's schema has it, or includes other files.
    pub fn parse(xml: &str) -> Result<Self, DocumentError> {
        document::read(xml, "policy", |policy| {
            let children = policy.children_with(&["version"], &["enclaves"])?;
            let version = policy.required("version")?;
            if version != VERSION {
                let (found, of) = (version.to_owned(), "version".to_owned());
                return Err(policy.error(Problem::Value { found, of, expected: VERSION }));
            }
            let enclaves = children.one("enclaves")?.children(&["enclave"])?;
            let enclaves = enclaves.some("enclave")?.iter().map(|enclave| Enclave::read(*enclave));
            enclaves.collect::<Result<_, _>>().map(|enclaves| Self { enclaves })
        })
    }

    /// The policy that permits everything to an enclave.
    pub fn everything(enclave: &str) -> Self {
        let rules = [Kind::Topics, Kind::Services, Kind::Actions].map(|kind| Rule {
            kind,
            qualifiers: [Some(Qualifier::Allow); 2],
            names: vec!["/*".to_owned()],
        });
        let node = Profile { namespace: "/".to_owned(), node: "default".to_owned(), rules: rules.to_vec() };
        let profiles = vec![Profiles { kind: None, nodes: vec![node] }];
        Self { enclaves: vec![Enclave { path: enclave.to_owned(), profiles }] }
    }

    /// The paths of the enclaves, such as `/talker_listener/talker`.
    pub fn enclaves(&self) -> impl Iterator<Item = &str> {
        self.enclaves.iter().map(|enclave| enclave.path.as_str())
    }
}

impl Enclave {
    fn read(element: Element) -> Result<Self, DocumentError> {
        let profiles = element.children_with(&["path"], &["profiles"])?;
        let profiles = profiles.some("profiles")?.iter().map(|profiles| Profiles::read(*profiles));
        Ok(Self { path: element.required("path")?.to_owned(), profiles: profiles.collect::<Result<_, _>>()? })
    }
}

impl Profiles {
    fn read(element: Element) -> Result<Self, DocumentError> {
        let children = element.children_with(&["type"], &["profile", "metadata"])?;
        children.optional("metadata")?;
        let nodes: Vec<Profile> = children
            .iter()
            .filter(|child| child.name() == "profile")
            .map(Profile::read)
            .collect::<Result<_, _>>()?;
        if nodes.is_empty() {
            return Err(element.error(Problem::Missing(element.name().to_owned(), "profile")));
        }
        Ok(Self { kind: element.attribute("type").map(ToOwned::to_owned), nodes })
    }
}

impl Profile {
    fn read(element: Element) -> Result<Self, DocumentError> {
        let known = Kind::ALL.map(|kind| kind.elements().0);
        let rules = element.children_with(&["ns", "node"], &known)?;
        Ok(Self {
            namespace: element.required("ns")?.to_owned(),
            node: element.required("node")?.to_owned(),
            rules: rules.iter().filter_map(Rule::read).collect::<Result<_, _>>()?,
        })
    }
}

impl Rule {
    /// `None` if the element is of no kind, which its parent refuses.
    fn read(element: Element) -> Option<Result<Self, DocumentError>> {
        let kind = Kind::ALL.into_iter().find(|kind| kind.elements().0 == element.name())?;
        Some(Self::read_as(kind, element))
    }

    fn read_as(kind: Kind, element: Element) -> Result<Self, DocumentError> {
        let verbs = kind.verbs();
        let qualifier = |verb| match element.attribute(verb) {
            None => Ok(None),
            Some("ALLOW") => Ok(Some(Qualifier::Allow)),
            Some("DENY") => Ok(Some(Qualifier::Deny)),
            Some(found) => {
                let (found, of) = (found.to_owned(), format!("attribute {verb:?}"));
                Err(element.error(Problem::Value { found, of, expected: "ALLOW or DENY" }))
            }
        };
        let [first, second] = verbs;
        let name = kind.elements().1;
        let names = element.children_with(&verbs, &[name])?;
        let names = names.some(name)?.iter().map(|name| name.text());
        Ok(Self {
            kind,
            qualifiers: [qualifier(first)?, qualifier(second)?],
            names: names.collect::<Result<_, _>>()?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const POLICY: &str = include_str!("../../tests/data/policy.xml");

    #[test]
    fn a_policy_names_its_enclaves() {
        let policy = Policy::parse(POLICY).unwrap();
        assert_eq!(policy.enclaves().collect::<Vec<_>>(), ["/robot/walker", "/robot/idle"]);
        assert_eq!(Policy::everything("/a").enclaves().collect::<Vec<_>>(), ["/a"]);
    }

    #[test]
    fn a_policy_that_the_schema_refuses_is_refused_with_its_line() {
        let cases = [
            (
                "version=\"0.2.0\"",
                "version=\"0.1.0\"",
                "line 2: \"0.1.0\" is no value of version, which is 0.2.0",
            ),
            ("version=\"0.2.0\"", "", "line 2: <policy> lacks attribute \"version\""),
            ("<enclave path=\"/robot/walker\">", "<enclave>", "line 5: <enclave> lacks attribute \"path\""),
            (
                "ns=\"/robot\" node",
                "namespace=\"/robot\" node",
                "line 7: attribute \"namespace\" is unknown in <profile>",
            ),
            (
                "<topics publish=\"ALLOW\">",
                "<topics publish=\"YES\">",
                "\"YES\" is no value of attribute \"publish\"",
            ),
            (
                "<topics publish=\"ALLOW\">",
                "<topics reply=\"ALLOW\">",
                "attribute \"reply\" is unknown in <topics>",
            ),
            (
                "<topic>/tf</topic>",
                "<service>/tf</service>",
                "line 9: <service> is unknown in <topics>, which takes <topic>",
            ),
            ("<action>/dock</action>", "", "<actions> lacks <action>"),
            ("<profile ns=\"/robot/\" node=\"idle\"/>", "", "<profiles> lacks <profile>"),
        ];
        for (good, bad, expected) in cases {
            assert!(POLICY.contains(good), "{good}");
            let error = Policy::parse(&POLICY.replacen(good, bad, 1)).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn an_include_is_refused_with_what_to_do() {
        let include = "<policy version=\"0.2.0\" xmlns:xi=\"http://www.w3.org/2001/XInclude\"><enclaves>\n\
                       <xi:include href=\"talker.xml\"/></enclaves></policy>";
        let error = Policy::parse(include).unwrap_err();
        assert_eq!(
            error.to_string(),
            "line 2: <include> includes another file, which is not supported; insert its content, for example by \
             `xmllint --xinclude`"
        );
    }
}
