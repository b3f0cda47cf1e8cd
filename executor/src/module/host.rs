//! The core's side of a module's setup.

use std::any::{Any, TypeId};

use crate::Version;

/// The core as seen by a module's setup.
pub(crate) trait Host {
    /// The mechanism with this number.
    fn mechanism(&mut self, number: usize) -> Option<&mut dyn Any>;
    /// The view of the mechanism with this number.
    fn view(&mut self, number: usize) -> Option<&mut dyn Any>;
    /// As [`view`](Self::view), for reading.
    fn look(&self, number: usize) -> Option<&dyn Any>;
    /// All mechanisms, by their numbers.
    fn offers(&self) -> &[Offer];
}

/// A mechanism that modules can use.
pub(crate) struct Offer {
    pub(crate) name: &'static str,
    pub(crate) version: Version,
    pub(crate) mechanism: TypeId,
}
