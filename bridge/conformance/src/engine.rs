//! An engine as the suite sees it.

use crate::peer_process::{PeerProcess, Role};
use downbeat_bridge::middleware::{DiscoveryRange, Middleware, MiddlewareError, ParticipantOptions};
use std::path::PathBuf;

/// Makes a participant.
pub type Join =
    dyn Fn(&ParticipantOptions) -> Result<Box<dyn Middleware>, MiddlewareError> + Send + Sync + 'static;

/// An engine to hold against the suite.
pub struct Engine {
    /// What reports call it.
    pub name: &'static str,
    /// Makes a participant. Those of one domain hear each other.
    pub join: Box<Join>,
    /// Whether participants of other processes are reached.
    pub has_network: bool,
    /// A program whose `main` is [`peer::main`](crate::peer::main) with this engine; cases with processes
    /// need it.
    pub peer: Option<PathBuf>,
    /// The variables of the environment of that program.
    pub environment: Vec<(&'static str, String)>,
    /// The cases that it is known to fail.
    pub known_failures: &'static [KnownFailure],
}

/// A case that an engine is known to fail.
#[derive(Clone, Copy, Debug)]
pub struct KnownFailure {
    /// The name of the case.
    pub case: &'static str,
    /// What the engine cannot do.
    pub limit: &'static str,
    /// Why.
    pub cause: &'static str,
    /// What a user notices.
    pub effect: &'static str,
    /// What a user can do.
    pub remedy: &'static str,
}

/// Where the participants of one case meet.
pub struct Domain<'a> {
    pub(crate) engine: &'a Engine,
    pub(crate) domain_id: u16,
}

impl Domain<'_> {
    /// A new participant on this machine.
    ///
    /// # Panics
    /// If the engine makes none: no case can pass then.
    #[must_use]
    pub fn join(&self) -> Box<dyn Middleware> {
        self.join_with(|_| ())
    }

    /// The same with other options.
    ///
    /// # Panics
    /// As [`Domain::join`].
    #[must_use]
    pub fn join_with(&self, change: impl FnOnce(&mut ParticipantOptions)) -> Box<dyn Middleware> {
        let mut options = on_loopback(self.domain_id);
        change(&mut options);
        match (self.engine.join)(&options) {
            Ok(participant) => participant,
            Err(error) => panic!("no participant: {error}"),
        }
    }

    /// A participant in a process of its own, or why there is none.
    pub(crate) fn start_peer(&self, role: Role) -> Result<PeerProcess, &'static str> {
        let program = self.engine.peer.as_ref().ok_or("it has no other processes")?;
        Ok(PeerProcess::start(program, &self.engine.environment, self.domain_id, role))
    }
}

/// A domain on this machine alone.
pub(crate) fn on_loopback(domain_id: u16) -> ParticipantOptions {
    ParticipantOptions { discovery_range: DiscoveryRange::Localhost, ..ParticipantOptions::new(domain_id) }
}
