//! Addresses of endpoints (section 9.3.2).

use std::net::{Ipv4Addr, SocketAddrV4};

use super::Malformed;
use super::bytes::{Cursor, Encoder};

/// An address of any transport, including unsupported ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Locator {
    pub kind: i32,
    pub port: u32,
    pub address: [u8; 16],
}

impl Locator {
    /// UDP over IPv4: the address is in the last four bytes.
    pub const UDP_V4: i32 = 1;

    /// The socket address; `None` for other transports, port 0 and the unspecified address.
    pub fn udp_v4(self) -> Option<SocketAddrV4> {
        let [.., a, b, c, d] = self.address;
        let address = SocketAddrV4::new(Ipv4Addr::new(a, b, c, d), u16::try_from(self.port).ok()?);
        let can_be_sent_to = address.port() != 0 && !address.ip().is_unspecified();
        (self.kind == Self::UDP_V4 && can_be_sent_to).then_some(address)
    }

    pub(super) fn read(cursor: &mut Cursor<'_>) -> Result<Self, Malformed> {
        Ok(Self { kind: cursor.i32()?, port: cursor.u32()?, address: cursor.array()? })
    }

    pub(super) fn write(self, out: &mut Encoder<'_>) {
        out.i32(self.kind);
        out.u32(self.port);
        out.bytes(&self.address);
    }
}

impl From<SocketAddrV4> for Locator {
    fn from(socket: SocketAddrV4) -> Self {
        let mut address = [0; 16];
        address[12..].copy_from_slice(&socket.ip().octets());
        Self { kind: Self::UDP_V4, port: socket.port().into(), address }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_socket_address_round_trips() {
        let socket = SocketAddrV4::new(Ipv4Addr::new(192, 168, 1, 2), 7410);
        assert_eq!(Locator::from(socket).udp_v4(), Some(socket));
    }

    #[test]
    fn other_locators_are_not_socket_addresses() {
        let good = Locator::from(SocketAddrV4::new(Ipv4Addr::LOCALHOST, 7410));
        for kind in [-1, 0, 2, 4, 16] {
            assert_eq!(Locator { kind, ..good }.udp_v4(), None);
        }
        for port in [0, 65_536, u32::MAX] {
            assert_eq!(Locator { port, ..good }.udp_v4(), None);
        }
        assert_eq!(Locator { address: [0; 16], ..good }.udp_v4(), None);
    }
}
