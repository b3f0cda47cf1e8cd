//! Hears whether participants whose lease ran out are there again.
//!
//! rustdds 0.15.1 does not: a participant of Fast DDS announces itself by one sample with one number again and again, and
//! what rustdds has seen before the lease ran out it takes for a repetition afterwards. So a socket of our own hears the
//! announcements too, once a lease has run out, and looks at the sender in the header of each (RTPS 2.5, 8.3.3.2 and 9.4.4).

use super::rtps::{multicast_port, sender_of};
use crate::middleware::Gid;
use crate::middleware::rejoining::{Trouble, TroubleSink};
use socket2::{Domain, Protocol, Socket, Type};
use std::collections::HashSet;
use std::io;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// How many lost participants are remembered.
const MOST_LOST: usize = 1000;

/// How often the thread looks whether it is to stop.
const TURN: Duration = Duration::from_millis(200);

/// See the module. It has a thread from the first loss on.
pub(super) struct ReturnWatch {
    domain_id: u16,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

struct Shared {
    lost: Mutex<HashSet<[u8; 12]>>,
    sink: TroubleSink,
    is_stopping: AtomicBool,
}

impl ReturnWatch {
    pub(super) fn new(domain_id: u16, sink: TroubleSink) -> Self {
        let shared = Shared { lost: Mutex::default(), sink, is_stopping: AtomicBool::new(false) };
        Self { domain_id, shared: Arc::new(shared), thread: None }
    }

    /// Tells trouble of the engine itself.
    pub(super) fn tell(&self, trouble: Trouble) {
        self.shared.sink.tell(trouble);
    }

    /// The lease of a participant ran out.
    pub(super) fn lost(&mut self, participant: [u8; 12]) {
        let mut lost = self.shared.lost();
        if lost.len() < MOST_LOST {
            lost.insert(participant);
        }
        drop(lost);
        if self.thread.is_none() {
            match self.start() {
                Ok(thread) => self.thread = Some(thread),
                Err(error) => tracing::warn!(
                    %error,
                    "a peer that was out of reach for more than 20 s will not be found when it is there again"
                ),
            }
        }
    }

    fn start(&self) -> io::Result<JoinHandle<()>> {
        let socket = listen(self.domain_id)?;
        let shared = Arc::clone(&self.shared);
        std::thread::Builder::new().name("downbeat-lost".to_owned()).spawn(move || shared.hear(&socket))
    }
}

impl Drop for ReturnWatch {
    fn drop(&mut self) {
        self.shared.is_stopping.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl Shared {
    fn lost(&self) -> MutexGuard<'_, HashSet<[u8; 12]>> {
        self.lost.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn hear(&self, socket: &UdpSocket) {
        let mut packet = [0; 64];
        while !self.is_stopping.load(Ordering::Relaxed) {
            // What is longer is cut off; a turn without any is an error of kind `WouldBlock`.
            let Ok(length) = socket.recv(&mut packet) else { continue };
            let Some(sender) = sender_of(&packet[..length]) else { continue };
            if self.lost().remove(&sender) {
                let mut participant = Gid::default();
                participant.0[..12].copy_from_slice(&sender);
                self.sink.tell(Trouble::PeerReturned(participant));
            }
        }
    }
}

/// The port of a domain to which announcements are multicast (RTPS 2.5, 9.6.2.4.1). The groups are those that the sockets
/// of rustdds have joined, on the interfaces they have chosen: Linux gives their packets to every socket of the port.
pub(super) fn listen(domain_id: u16) -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    socket.set_reuse_address(true)?;
    socket.set_reuse_port(true)?;
    socket.set_read_timeout(Some(TURN))?;
    socket.bind(&SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, multicast_port(domain_id)).into())?;
    Ok(socket.into())
}
