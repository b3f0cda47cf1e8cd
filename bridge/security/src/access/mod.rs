//! Governance and permissions: signed files that say how a domain is protected and who may do what.
