//! Liveliness tokens, by which nodes and endpoints are announced.

use super::key::NO_HASH;
use super::{Qos, QosError};
use std::fmt;
use std::str::FromStr;
use thiserror::Error;
use twox_hash::XxHash3_128;

/// The first part of every token.
const ADMIN_SPACE: &str = "@ros2_lv";

/// The longest token that is read. Names have at most 255 characters in ROS 2.
pub const MOST_TOKEN_LENGTH: usize = 2048;

/// Selects all tokens of a domain.
#[must_use]
pub fn tokens_of(domain_id: u16) -> String {
    format!("{ADMIN_SPACE}/{domain_id}/**")
}

/// The identity of an endpoint: the XXH3-128 hash of its token, the lower half first, little-endian.
#[must_use]
pub fn gid(token: &str) -> [u8; 16] {
    XxHash3_128::oneshot(token.as_bytes()).to_le_bytes()
}

/// Announces a node or an endpoint.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Token {
    /// The ROS domain.
    pub domain_id: u16,
    /// The Zenoh session, in hexadecimal digits.
    pub session: String,
    /// The number of the node in its session.
    pub node_id: u64,
    /// The number of the endpoint in its session; of a node the number of the node again.
    pub entity_id: u64,
    /// The SROS 2 enclave, `/` without security.
    pub enclave: String,
    /// The node, or that of the endpoint.
    pub node: NodeName,
    /// What is announced.
    pub announced: Announced,
}

/// The namespace and name of a node.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct NodeName {
    /// It begins with a slash; `/` is the root.
    pub namespace: String,
    /// Its name.
    pub name: String,
}

impl fmt::Display for NodeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.namespace.trim_end_matches('/'), self.name)
    }
}

/// What a token announces.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Announced {
    /// A node.
    Node,
    /// An endpoint of a node.
    Endpoint(EndpointToken),
}

/// An endpoint, as its token announces it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EndpointToken {
    /// Its role.
    pub role: Role,
    /// The absolute name of the topic or service.
    pub name: String,
    /// The type as on DDS; of a service without `_Request_`.
    pub type_name: String,
    /// The hash of the type; `None` where the peer knows none.
    pub hash: Option<String>,
    /// Its policies.
    pub qos: Qos,
}

/// The role of an endpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Role {
    /// Of a topic.
    Publisher,
    /// Of a topic.
    Subscription,
    /// Of a service.
    Server,
    /// Of a service.
    Client,
}

impl Role {
    const ALL: [(Self, &str); 4] =
        [(Self::Publisher, "MP"), (Self::Subscription, "MS"), (Self::Server, "SS"), (Self::Client, "SC")];

    fn text(self) -> &'static str {
        match self {
            Self::Publisher => "MP",
            Self::Subscription => "MS",
            Self::Server => "SS",
            Self::Client => "SC",
        }
    }

    /// The role of the endpoints that it communicates with.
    #[must_use]
    pub fn opposite(self) -> Self {
        match self {
            Self::Publisher => Self::Subscription,
            Self::Subscription => Self::Publisher,
            Self::Server => Self::Client,
            Self::Client => Self::Server,
        }
    }
}

/// A key is no token of ROS 2.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum TokenError {
    /// It is longer than [`MOST_TOKEN_LENGTH`].
    #[error("the token has {0} bytes, {MOST_TOKEN_LENGTH} are read")]
    Long(usize),
    /// It has another number of parts.
    #[error("the token has {0} parts; that of a node has 9, that of an endpoint 13")]
    Parts(usize),
    /// A part has no valid value.
    #[error("{part:?} is no {what} of a token")]
    Part {
        /// The part.
        what: &'static str,
        /// Its text.
        part: String,
    },
    /// Of an endpoint.
    #[error(transparent)]
    Qos(#[from] QosError),
}

/// A name in a part: slashes stand as `%`.
struct Mangled<'a>(&'a str);

impl fmt::Display for Mangled<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_empty() {
            return f.write_str("%");
        }
        self.0.split('/').enumerate().try_for_each(|(index, part)| {
            let slash = if index == 0 { "" } else { "%" };
            write!(f, "{slash}{part}")
        })
    }
}

fn demangled(part: &str) -> String {
    part.replace('%', "/")
}

impl fmt::Display for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { domain_id, session, node_id, entity_id, enclave, node, announced } = self;
        let role = match announced {
            Announced::Node => "NN",
            Announced::Endpoint(endpoint) => endpoint.role.text(),
        };
        let (enclave, namespace) = (Mangled(enclave), Mangled(&node.namespace));
        write!(
            f,
            "{ADMIN_SPACE}/{domain_id}/{session}/{node_id}/{entity_id}/{role}/{enclave}/{namespace}/{}",
            node.name
        )?;
        let Announced::Endpoint(EndpointToken { name, type_name, hash, qos, .. }) = announced else {
            return Ok(());
        };
        let (name, type_name, hash) = (Mangled(name), Mangled(type_name), hash.as_deref().unwrap_or(NO_HASH));
        write!(f, "/{name}/{type_name}/{hash}/{qos}")
    }
}

impl FromStr for Token {
    type Err = TokenError;

    /// Reads what a stranger may have written: names are any text and must be checked before use.
    fn from_str(token: &str) -> Result<Self, TokenError> {
        if token.len() > MOST_TOKEN_LENGTH {
            return Err(TokenError::Long(token.len()));
        }
        let parts: Vec<&str> = token.split('/').collect();
        let wrong = |what, part: &str| TokenError::Part { what, part: part.to_owned() };
        let number =
            |what, part: &str| part.parse().map_err(|_| wrong(what, part)) as Result<u64, TokenError>;
        let (&[space, domain_id, session, node_id, entity_id, role, enclave, namespace, node], rest) =
            parts.split_first_chunk().ok_or(TokenError::Parts(parts.len()))?;
        if space != ADMIN_SPACE {
            return Err(wrong("first part", space));
        }
        let is_session = session.len() <= 32 && session.bytes().all(|digit| digit.is_ascii_hexdigit());
        if session.is_empty() || !is_session {
            return Err(wrong("session", session));
        }
        let announced = if role == "NN" {
            if !rest.is_empty() {
                return Err(TokenError::Parts(parts.len()));
            }
            Announced::Node
        } else {
            let &[name, type_name, hash, qos] = rest else { return Err(TokenError::Parts(parts.len())) };
            let found = Role::ALL.iter().find(|(_, text)| *text == role);
            Announced::Endpoint(EndpointToken {
                role: found.map(|(role, _)| *role).ok_or_else(|| wrong("role", role))?,
                name: demangled(name),
                type_name: demangled(type_name),
                hash: is_hash(hash).then(|| hash.to_owned()),
                qos: qos.parse()?,
            })
        };
        Ok(Self {
            domain_id: domain_id.parse().map_err(|_| wrong("domain", domain_id))?,
            session: session.to_owned(),
            node_id: number("number of a node", node_id)?,
            entity_id: number("number of an endpoint", entity_id)?,
            enclave: demangled(enclave),
            node: NodeName { namespace: demangled(namespace), name: node.to_owned() },
            announced,
        })
    }
}

fn is_hash(text: &str) -> bool {
    text.strip_prefix("RIHS01_")
        .is_some_and(|digits| digits.len() == 64 && digits.bytes().all(|digit| digit.is_ascii_hexdigit()))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const NODE: &str = "@ros2_lv/85/89358d841018189f4be60385f2d48452/0/0/NN/%/%ns1/golden";
    const REST: &str = "%chatter/std_msgs::msg::dds_::String_/RIHS01_\
                        df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18/::,10:,:,:,,";

    #[test]
    fn tokens_of_strangers_are_refused_with_the_reason() {
        let endpoint = format!("{}/{REST}", NODE.replace("NN", "MP"));
        assert!(endpoint.parse::<Token>().is_ok());
        for (token, reason) in [
            (String::new(), "1 parts"),
            (NODE.replace("/golden", ""), "8 parts"),
            (format!("{NODE}/{REST}"), "13 parts"),
            (NODE.replace("NN", "MP"), "9 parts"),
            (endpoint.replace("MP", "XX"), "no role"),
            (NODE.replace("@ros2_lv", "@other"), "first part"),
            (NODE.replace("/85/", "/65536/"), "no domain"),
            (NODE.replace("/0/0/", "/-1/0/"), "number of a node"),
            (NODE.replace("/0/0/", "/0/18446744073709551616/"), "number of an endpoint"),
            (NODE.replace("89358d84", "zz"), "no session"),
            (endpoint.replace("::,10", "::,ten"), "no number"),
            (format!("{NODE}{}", "x".repeat(MOST_TOKEN_LENGTH)), "are read"),
        ] {
            let error = token.parse::<Token>().unwrap_err().to_string();
            assert!(error.contains(reason), "{token}: {error}");
        }
    }

    #[test]
    fn a_hash_that_is_none_is_not_passed_on() {
        let of = |hash: &str| {
            let token = format!("{}/%t/T/{hash}/::,10:,:,:,,", NODE.replace("NN", "MS"));
            match token.parse::<Token>().unwrap().announced {
                Announced::Endpoint(endpoint) => endpoint.hash,
                Announced::Node => None,
            }
        };
        assert_eq!(of("TypeHashNotSupported"), None);
        assert_eq!(of("RIHS01_12"), None);
        assert_eq!(of("\x1b[2J"), None);
    }
}
