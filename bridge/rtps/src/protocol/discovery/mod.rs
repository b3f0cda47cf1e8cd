//! Discovery of participants and their endpoints (RTPS section 8.5).
//!
//! Participants announce themselves with a stateless writer. Endpoints and liveliness are announced by
//! ordinary reliable writers on predefined topics.

mod announced;
mod announcer;
mod announcing;
mod builtin;
mod endpoints;
mod liveliness;
mod participants;

pub(super) use announced::Announced;
pub(super) use announcer::Announcer;
pub(super) use builtin::BUILTIN;
pub use builtin::{BUILTIN_OF_SECURITY, Builtin};
