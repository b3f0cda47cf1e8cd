//! Options and errors of joining a domain.

use crate::protocol::Guard;
use crate::wire::GuidPrefix;
use std::fmt;
use std::io;
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;

/// The range of discovery.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Range {
    /// No discovery: only endpoints of the participant itself reach each other. No socket is bound to a
    /// well-known port.
    Off,
    /// This machine only: every socket is bound to the loopback interface.
    Localhost,
    /// All hosts that multicast reaches, and this machine.
    Subnet,
}

/// How a participant joins a domain.
#[derive(Clone, Debug)]
pub struct Options {
    /// The domain, 0 to 232.
    pub domain_id: u16,
    /// The range of discovery.
    pub range: Range,
    /// Additional hosts to announce to, by address or name (`ROS_STATIC_PEERS`).
    pub static_peers: Vec<String>,
    /// How long other participants keep this one after its last message.
    pub lease: Duration,
    /// Time between two announcements.
    pub announcement_period: Duration,
    /// Name of the participant in announcements.
    pub name: String,
    /// User data of the participant; ROS 2 puts the enclave there.
    pub user_data: Vec<u8>,
    /// How it is protected; `None` for not at all.
    pub security: Option<Security>,
}

/// Makes the guard of a participant.
#[derive(Clone)]
pub struct Security(Arc<MakeGuard>);

/// Takes the prefix that the participant would have, and returns the one that belongs to its identity.
type MakeGuard = dyn Fn(GuidPrefix) -> (GuidPrefix, Box<dyn Guard>) + Send + Sync;

impl Security {
    /// With a function that takes the prefix that the participant would have without security, and returns
    /// the one that belongs to its identity.
    pub fn new(make: impl Fn(GuidPrefix) -> (GuidPrefix, Box<dyn Guard>) + Send + Sync + 'static) -> Self {
        Self(Arc::new(make))
    }

    pub(super) fn guard(&self, prefix: GuidPrefix) -> (GuidPrefix, Box<dyn Guard>) {
        (self.0)(prefix)
    }
}

impl fmt::Debug for Security {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Security")
    }
}

impl Options {
    /// Options for `domain_id` with the lease and announcement period of Fast DDS.
    #[must_use]
    pub fn new(domain_id: u16, range: Range) -> Self {
        Self {
            domain_id,
            range,
            static_peers: Vec::new(),
            lease: Duration::from_secs(20),
            announcement_period: Duration::from_secs(3),
            name: String::new(),
            user_data: Vec::new(),
            security: None,
        }
    }
}

/// Error while joining a domain.
#[derive(Debug, Error)]
pub enum JoinError {
    /// The domain does not exist.
    #[error("domain {0} has no UDP ports: the highest domain is 232")]
    Domain(u16),
    /// The ports of all participants of a host are in use.
    #[error(
        "no pair of UDP ports for a participant is free on {address}, from port {first} on; the last attempt: {source}"
    )]
    NoFreePort {
        /// The address to bind to.
        address: std::net::Ipv4Addr,
        /// The first port that was tried.
        first: u16,
        /// Why the last attempt failed.
        source: io::Error,
    },
    /// A socket could not be prepared.
    #[error("preparing a UDP socket failed: {0}")]
    Socket(io::Error),
    /// The addresses of this machine could not be read.
    #[error("reading the addresses of this machine failed: {0}")]
    Interfaces(io::Error),
    /// The thread could not be started.
    #[error("starting the thread of the participant failed: {0}")]
    Thread(io::Error),
}
