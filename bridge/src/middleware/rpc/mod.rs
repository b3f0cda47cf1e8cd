//! Raw requests and replies. An engine may have [`Services`](super::Services); on the others they are made of
//! two topics: clients write requests, servers write replies, and every client reads all replies and keeps
//! its own.
//!
//! Implementations differ in how a reply names its request. `rmw_fastrtps` puts it beside the payload (the
//! *related sample identity* of DDS-RPC, as inline quality of service), `rmw_cyclonedds` into the first 16
//! bytes of the payload. A server answers each request the way its client speaks, and a client uses the form
//! of the matched server. The vendor in the identity of the peer determines its form.
//!
//! As in `rmw_fastrtps`, a reply waits until the client that asked is matched, for at most [`REPLY_HOLD`]:
//! discovery of a new client may have found one half of it only, and its first reply would be lost. And a
//! client counts those servers only that have found it too, so that its first request is not lost either.
//!
//! Handlers run on a [`Worker`](crate::worker::Worker), one after the other: never on a thread of the engine,
//! so that they may call and answer whatever they like.

mod client;
mod mapping;
mod server;

pub use client::{Answer, CallError, CallNumber, RequestClient};
pub use server::{IncomingRequest, RefusalHandler, ReplyError, RequestHandler, RequestServer, Responder};

pub use super::ServiceEndpoint;

use super::{Endpoint, Gid};
use downbeat_msgs::qos::History;
use std::time::Duration;

/// How long a reply waits for the reader of the client that asked, and a server that leaves for the
/// acknowledgement of its replies.
pub const REPLY_HOLD: Duration = Duration::from_secs(1);

/// The most requests that a server has accepted and not answered, and the most calls of a client without an
/// answer. More are refused.
pub const MAX_IN_FLIGHT: usize = 1024;

impl ServiceEndpoint {
    fn requests(&self) -> Endpoint {
        let [type_hash, _] = self.type_hashes.clone();
        Endpoint { type_hash, ..Endpoint::new(&self.request_topic, &self.request_type, self.qos) }
    }

    fn replies(&self) -> Endpoint {
        let [_, type_hash] = self.type_hashes.clone();
        Endpoint { type_hash, ..Endpoint::new(&self.reply_topic, &self.reply_type, self.qos) }
    }
}

/// An endpoint for reading: with a history for all that may be in flight, since a burst of requests must not
/// push out those that were not taken yet. The depth is not part of matching.
fn reading(endpoint: Endpoint) -> Endpoint {
    let depth = match endpoint.qos.history {
        History::KeepLast(depth) => depth.max(MAX_IN_FLIGHT as u32),
        History::KeepAll => return endpoint,
    };
    Endpoint { qos: endpoint.qos.keep_last(depth), ..endpoint }
}

fn of_participant(gids: &[Gid], participant: [u8; 12]) -> Option<Gid> {
    gids.iter().copied().find(|gid| gid.participant() == participant)
}
