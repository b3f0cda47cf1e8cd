//! Proof of identities between two participants (`DDS:Auth:PKI-DH:1.0`, section 9.3 of DDS Security 1.1).
//!
//! A [`Handshake`] is the state with one remote participant, without sockets, clocks and randomness of its
//! own. The participant with the smaller GUID is the initiator:
//!
//! 1. The initiator sends a request: its certificate, permissions and data, a public key for this handshake
//!    only and a challenge, which is a random number.
//! 2. The replier sends the same of its own, and signs both keys and challenges.
//! 3. The initiator signs them, too, and both derive a shared secret from the keys.
//!
//! The initiator chooses how to agree on the key: we offer the curve P-256, Fast DDS the group of `modp`.
//!
//! Only signatures prove something. All else in these messages is public or freely chosen, so that a message
//! without a valid signature may cost time, but never ends or changes a handshake.

mod agreement;
mod context;
mod credentials;
mod fields;
mod guid;
mod handshake;
mod identity;
mod initiator;
mod messages;
mod modp;
mod refusal;
mod replier;
mod resend;

pub use context::{Context, Output};
pub use guid::derive_prefix;
pub use handshake::Handshake;
pub use identity::{Identity, RemoteIdentity, SharedSecret, identity_token, permissions_token};
pub use refusal::Refusal;

#[cfg(test)]
mod tests;
