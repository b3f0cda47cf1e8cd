//! The socket of a service manager on Linux. On other systems, `notify_elsewhere.rs`.

use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};

pub(super) struct NotifySocket {
    socket: UnixDatagram,
    address: SocketAddr,
}

impl NotifySocket {
    /// An address is a path, or after `@` a name without a file.
    pub(super) fn open(address: &str) -> io::Result<Self> {
        let address = match address.strip_prefix('@') {
            Some(name) => SocketAddr::from_abstract_name(name)?,
            None => SocketAddr::from_pathname(address)?,
        };
        let socket = UnixDatagram::unbound()?;
        // A manager that does not read must not stop the robot.
        socket.set_nonblocking(true)?;
        // Found missing here, and not once per message.
        socket.connect_addr(&address)?;
        Ok(Self { socket, address })
    }

    pub(super) fn send(&self, text: &str) -> io::Result<()> {
        self.socket.send_to_addr(text.as_bytes(), &self.address).map(drop)
    }
}
