//! How participants find each other and their endpoints (RTPS section 8.5).
//!
//! Participants announce themselves without being asked, by a stateless writer. Endpoints and liveliness are announced by
//! ordinary reliable writers, whose topics are known in advance.

mod announcing;
mod endpoints;
mod liveliness;
mod participants;

pub(super) use announcing::Announcer;
pub(super) use endpoints::Endpoints;
pub(super) use liveliness::Liveliness;
