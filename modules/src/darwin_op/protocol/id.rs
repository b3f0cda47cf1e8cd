//! Addresses of devices on the bus.

use std::fmt;

/// The address of a device on the bus, or of all of them.
///
/// 0xFF is not an address: it would be mistaken for a header byte.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Id(u8);

impl Id {
    /// All devices. They execute the instruction and do not answer, except to a bulk read.
    pub const BROADCAST: Self = Self(254);
    /// The sub controller, which sits between the computer and the servo bus.
    pub const CM730: Self = Self(200);

    /// The address with this number, unless it is 0xFF.
    #[must_use]
    pub const fn new(raw: u8) -> Option<Self> {
        if raw == 0xFF { None } else { Some(Self(raw)) }
    }

    /// The number on the wire.
    #[must_use]
    pub const fn raw(self) -> u8 {
        self.0
    }

    /// Whether it stands for all devices.
    #[must_use]
    pub const fn is_broadcast(self) -> bool {
        self.0 == Self::BROADCAST.0
    }
}

impl fmt::Debug for Id {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Id({})", self.0)
    }
}

impl fmt::Display for Id {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(formatter)
    }
}
