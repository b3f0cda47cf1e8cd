//! The keys.

/// A key with a function in some command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Key {
    Space,
    Right,
    Up,
    Down,
}
