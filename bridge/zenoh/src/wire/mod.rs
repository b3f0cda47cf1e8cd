//! Keys, tokens and attachments as `rmw_zenoh_cpp` 0.2.10 (Jazzy) writes them, without a session.
//!
//! A publisher or subscription of a topic and a service have one [`key()`]. Every node and endpoint is
//! announced by a liveliness [`Token`], whose hash is the identity of the endpoint ([`gid`]). Every sample,
//! request and reply carries an [`Attachment`].
//!
//! # References
//! `rmw_zenoh_cpp/src/detail/{liveliness_utils,qos,attachment_helpers}.cpp` and `docs/design.md` of
//! ros2/rmw_zenoh, branch jazzy.

mod attachment;
mod key;
mod qos;
mod token;

pub use attachment::{ATTACHMENT_LENGTH, Attachment};
pub use key::{NO_HASH, key, keys_of_any_hash};
pub use qos::{Period, Qos, QosError};
pub use token::{
    Announced, EndpointToken, MOST_TOKEN_LENGTH, NodeName, Role, Token, TokenError, gid, tokens_of,
};
