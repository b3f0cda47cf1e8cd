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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn documents_with_changed_bytes_are_read_or_refused() {
        let mut random = fuzzing::Random::new(1);
        let documents = [
            include_str!("../../tests/data/governance.xml"),
            include_str!("../../tests/data/permissions.xml"),
        ];
        let mut refused = 0;
        for round in 0..4000 {
            let mut bytes = documents[round % 2].as_bytes().to_vec();
            for _ in 0..=random.below(3) {
                let at = random.below(bytes.len());
                bytes[at] = *random.choose(b"<>/&;:*[]!-?\"' 09azA\\\x00\xff");
            }
            let text = String::from_utf8_lossy(&bytes);
            refused += usize::from(Governance::parse(&text).is_err() && Permissions::parse(&text).is_err());
        }
        assert!((1000..4000).contains(&refused), "{refused}");
    }
}
