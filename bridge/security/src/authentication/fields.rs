//! The binary properties of a handshake token, by name.

use super::refusal::{Refusal, shown};
use crate::tokens::Token;

/// The properties of one token, none of which occurs twice.
#[derive(Clone, Copy)]
pub(super) struct Fields<'a>(&'a Token);

impl<'a> Fields<'a> {
    pub(super) fn new(token: &'a Token) -> Result<Self, Refusal> {
        for (index, (name, _)) in token.binary.iter().enumerate() {
            if token.binary.iter().take(index).any(|(before, _)| before == name) {
                return Err(Refusal::Twice { field: shown(name.as_bytes()) });
            }
        }
        Ok(Self(token))
    }

    pub(super) fn get(self, field: &'static str) -> Result<&'a [u8], Refusal> {
        self.0.binary(field).ok_or(Refusal::Missing { field })
    }

    pub(super) fn array<const LENGTH: usize>(self, field: &'static str) -> Result<[u8; LENGTH], Refusal> {
        let value = self.get(field)?;
        let length = Refusal::Length { field, found: value.len(), expected: LENGTH };
        value.try_into().map_err(|_| length)
    }

    /// Checks a field that must not differ.
    pub(super) fn check(self, field: &'static str, expected: &[u8]) -> Result<(), Refusal> {
        match self.get(field)? {
            value if value == expected => Ok(()),
            _ => Err(Refusal::Mismatch { field }),
        }
    }

    /// Checks a field that the sender may leave out, but must not change.
    pub(super) fn check_optional(self, field: &'static str, expected: &[u8]) -> Result<(), Refusal> {
        match self.check(field, expected) {
            Err(Refusal::Missing { .. }) => Ok(()),
            result => result,
        }
    }
}
