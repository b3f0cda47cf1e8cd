//! What participants may do, and how a domain is protected: the two signed documents.

mod domains;
mod governance;
mod pattern;
mod permissions;
pub mod smime;
mod subject;
pub(crate) mod time;

pub use domains::Domains;
pub use governance::{DataProtection, DomainRule, Governance, ProtectionKind, TopicRule};
pub use permissions::{Action, Decision, Grant, Permissions};
