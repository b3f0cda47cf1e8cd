//! The destinations of datagrams, and the endpoints that have something to send there.

use std::collections::VecDeque;
use std::net::SocketAddrV4;
use std::time::Instant;

use crate::wire::{EntityId, GuidPrefix};

use super::pacer::{Load, Pacer, Permit};

/// Longest datagram to a peer of this host; UDP allows 65 507 bytes.
pub(super) const OWN_HOST_DATAGRAM: usize = 65_000;

/// Bytes of headers, inline QoS and a heartbeat in a datagram with a fragment.
const OVERHEAD: usize = 200;

/// Identifies one of the [`Links`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LinkId(u32);

/// The destination of a datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Destination {
    /// One socket.
    Unicast(SocketAddrV4),
    /// A multicast group, on every interface.
    Multicast(SocketAddrV4),
    /// This participant itself.
    Own,
}

/// Properties of a destination.
#[derive(Debug, Clone, Copy)]
pub struct LinkOptions {
    pub destination: Destination,
    /// The participant there; [`GuidPrefix::UNKNOWN`] for a group.
    pub peer: GuidPrefix,
    /// Bytes of UDP payload.
    pub max_datagram: usize,
    /// Payload bytes per DATA_FRAG; larger samples are sent in fragments. At most `max_datagram` less 200.
    pub fragment_size: u16,
    /// The receive buffer that the peer announced.
    pub receive_buffer: Option<u32>,
}

/// The result of letting an endpoint write to a datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Emitted {
    /// Everything is sent.
    Done,
    /// The datagram is full, and there is more to send.
    More,
    /// The rest waits for its time or for an acknowledgement. Others may fill the datagram.
    Blocked,
}

/// All destinations of a participant, each with a queue of the endpoints that have something to send there.
///
/// Endpoints [request](Links::request) to send. To send datagrams, take a link ([`Links::next`]), take its
/// senders ([`Links::pop`]), let them fill the datagram and [put them back](Links::put_back) with what they
/// returned. Links take turns, and so do the senders of a link.
#[derive(Debug, Default)]
pub struct Links {
    links: Vec<Option<Link>>,
    /// Links with ready senders, in the order of their turns.
    ready: VecDeque<LinkId>,
    /// Links with senders that wait for the pacer.
    paced: Vec<LinkId>,
}

#[derive(Debug)]
struct Link {
    options: LinkOptions,
    pacer: Pacer,
    ready: VecDeque<EntityId>,
    is_in_line: bool,
    /// Endpoints that wait for the pacer or for an acknowledgement.
    blocked: Vec<EntityId>,
    /// When the pacer permits sending.
    opens: Option<Instant>,
    /// Whether only what validates the address may be sent.
    is_restricted: bool,
    /// Added to the numbers of samples of builtin writers, see `validation`.
    offset: i64,
}

impl Links {
    /// Creates an empty collection.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a destination.
    pub fn open(&mut self, options: LinkOptions) -> LinkId {
        let pacer = match options.destination {
            Destination::Own => Pacer::Unlimited,
            Destination::Unicast(_) | Destination::Multicast(_) => Pacer::new(options.receive_buffer),
        };
        let mut link = Link {
            options,
            pacer,
            ready: VecDeque::new(),
            is_in_line: false,
            blocked: Vec::new(),
            opens: None,
            is_restricted: false,
            offset: 0,
        };
        link.limit_fragments();
        let free = self.links.iter().position(Option::is_none).unwrap_or(self.links.len());
        if free == self.links.len() {
            self.links.push(None);
        }
        self.links[free] = Some(link);
        LinkId(free as u32)
    }

    /// Changes the address of a link to another address of the same peer.
    pub fn redirect(&mut self, id: LinkId, destination: Destination, max_datagram: usize) {
        if let Some(link) = self.get_mut(id) {
            link.options.destination = destination;
            link.options.max_datagram = max_datagram;
            link.limit_fragments();
        }
    }

    /// Removes a destination. Its users must be unmatched before, because the id is reused.
    pub fn close(&mut self, id: LinkId) {
        if let Some(link) = self.links.get_mut(id.0 as usize) {
            *link = None;
        }
        self.ready.retain(|ready| *ready != id);
        self.paced.retain(|paced| *paced != id);
    }

    /// The destination of the link; `None` if it is closed.
    pub fn destination(&self, id: LinkId) -> Option<Destination> {
        Some(self.get(id)?.options.destination)
    }

    /// Sets whether only what validates the address may be sent.
    pub(super) fn restrict(&mut self, id: LinkId, is_restricted: bool) {
        if let Some(link) = self.get_mut(id) {
            link.is_restricted = is_restricted;
        }
    }

    pub(super) fn is_restricted(&self, id: LinkId) -> bool {
        self.get(id).is_some_and(|link| link.is_restricted)
    }

    /// Sets what is added to the numbers of samples of builtin writers.
    pub(super) fn set_offset(&mut self, id: LinkId, offset: i64) {
        if let Some(link) = self.get_mut(id) {
            link.offset = offset;
        }
    }

    pub(super) fn offset(&self, id: LinkId) -> i64 {
        self.get(id).map_or(0, |link| link.offset)
    }

    /// The participant at the destination.
    pub fn peer(&self, id: LinkId) -> GuidPrefix {
        self.get(id).map_or(GuidPrefix::UNKNOWN, |link| link.options.peer)
    }

    /// Bytes of UDP payload.
    pub fn max_datagram(&self, id: LinkId) -> usize {
        self.get(id).map_or(0, |link| link.options.max_datagram)
    }

    /// Payload bytes per fragment.
    pub(super) fn fragment_size(&self, id: LinkId) -> u16 {
        self.get(id).map_or(1, |link| link.options.fragment_size)
    }

    /// Records that `sender` has something to send.
    pub fn request(&mut self, id: LinkId, sender: EntityId) {
        let Some(link) = self.links.get_mut(id.0 as usize).and_then(Option::as_mut) else { return };
        if !link.ready.contains(&sender) {
            link.ready.push_back(sender);
        }
        if !link.is_in_line {
            link.is_in_line = true;
            self.ready.push_back(id);
        }
    }

    /// A link on which an endpoint may send now.
    pub fn next(&mut self, now: Instant) -> Option<LinkId> {
        for index in (0..self.paced.len()).rev() {
            let id = self.paced[index];
            if self.get(id).and_then(|link| link.opens).is_none_or(|opens| opens <= now) {
                self.wake(id);
            }
        }
        let id = self.ready.pop_front()?;
        self.ready.push_back(id);
        Some(id)
    }

    /// The next sender of a link; `None` if no other has something to send now.
    pub fn pop(&mut self, id: LinkId) -> Option<EntityId> {
        let link = self.links.get_mut(id.0 as usize)?.as_mut()?;
        let sender = link.ready.pop_front();
        if link.ready.is_empty() {
            link.is_in_line = false;
            self.ready.retain(|ready| *ready != id);
        }
        sender
    }

    /// Takes a sender back, with what it returned from sending.
    pub fn put_back(&mut self, id: LinkId, sender: EntityId, emitted: Emitted) {
        match emitted {
            Emitted::Done => {}
            Emitted::More => self.request(id, sender),
            Emitted::Blocked => {
                if let Some(link) = self.get_mut(id)
                    && !link.blocked.contains(&sender)
                {
                    link.blocked.push(sender);
                }
            }
        }
    }

    /// When the next pacer permits sending.
    pub fn next_timeout(&self) -> Option<Instant> {
        self.paced.iter().filter_map(|id| self.get(*id)?.opens).min()
    }

    /// Drops the requests of an endpoint.
    pub fn forget_endpoint(&mut self, sender: EntityId) {
        for link in self.links.iter_mut().flatten() {
            link.ready.retain(|ready| *ready != sender);
            link.blocked.retain(|blocked| *blocked != sender);
        }
    }

    /// The most unacknowledged bytes in flight to the peer, if acknowledgements pace the link.
    pub(super) fn window_size(&self, id: LinkId) -> Option<u64> {
        self.get(id)?.pacer.window_size()
    }

    /// Returns whether at least half of the window of the link is in flight.
    pub(super) fn is_half_full(&self, id: LinkId) -> bool {
        self.get(id).is_some_and(|link| link.pacer.is_half_full())
    }

    /// Returns whether `bytes` that will be acknowledged may be sent for the first time. If not, the sender
    /// is woken when they may be sent.
    pub(super) fn may_send_reliable(&mut self, id: LinkId, now: Instant, load: Load, bytes: usize) -> bool {
        self.ask(id, |pacer| pacer.ask_window(now, load, bytes))
    }

    /// Returns whether `bytes` may be sent that are not acknowledged or are sent again. If not, the sender is
    /// woken when they may be sent.
    pub(super) fn may_send(&mut self, id: LinkId, now: Instant, load: Load, bytes: usize) -> bool {
        self.ask(id, |pacer| pacer.ask_bucket(now, load, bytes))
    }

    /// Updates the bytes that a writer has in flight over this link.
    pub(super) fn change_in_flight(&mut self, id: LinkId, before: u64, after: u64) {
        let Some(link) = self.get_mut(id) else { return };
        link.pacer.change_in_flight(before, after);
        if after < before && link.pacer.window_size().is_some() && !link.blocked.is_empty() {
            self.wake(id);
        }
    }

    /// Records that sent data was requested again.
    pub(super) fn lose(&mut self, id: LinkId, now: Instant) {
        if let Some(link) = self.get_mut(id) {
            link.pacer.lose(now);
        }
    }

    fn ask(&mut self, id: LinkId, ask: impl FnOnce(&mut Pacer) -> Permit) -> bool {
        let Some(link) = self.links.get_mut(id.0 as usize).and_then(Option::as_mut) else { return false };
        match ask(&mut link.pacer) {
            Permit::Granted => return true,
            Permit::OnAcknowledgement => {}
            Permit::At(at) => {
                link.opens = Some(link.opens.map_or(at, |opens| opens.min(at)));
                if !self.paced.contains(&id) {
                    self.paced.push(id);
                }
            }
        }
        false
    }

    /// Makes blocked senders ready.
    fn wake(&mut self, id: LinkId) {
        self.paced.retain(|paced| *paced != id);
        let Some(link) = self.get_mut(id) else { return };
        link.opens = None;
        for sender in std::mem::take(&mut link.blocked) {
            self.request(id, sender);
        }
    }

    fn get(&self, id: LinkId) -> Option<&Link> {
        self.links.get(id.0 as usize)?.as_ref()
    }

    fn get_mut(&mut self, id: LinkId) -> Option<&mut Link> {
        self.links.get_mut(id.0 as usize)?.as_mut()
    }
}

impl Link {
    fn limit_fragments(&mut self) {
        let limit = self.options.max_datagram.saturating_sub(OVERHEAD).max(1);
        self.options.fragment_size =
            self.options.fragment_size.clamp(1, limit.min(usize::from(u16::MAX)) as u16);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)] // a test may fail

    use std::net::Ipv4Addr;
    use std::time::Duration;

    use super::*;

    fn options(port: u16) -> LinkOptions {
        LinkOptions {
            destination: Destination::Unicast(SocketAddrV4::new(Ipv4Addr::LOCALHOST, port)),
            peer: GuidPrefix([port as u8; 12]),
            max_datagram: 1472,
            fragment_size: 1344,
            receive_buffer: None,
        }
    }

    fn sender(key: u32) -> EntityId {
        EntityId::user_writer(key)
    }

    #[test]
    fn links_and_senders_take_turns() {
        let (mut links, now) = (Links::new(), Instant::now());
        let (a, b) = (links.open(options(1)), links.open(options(2)));
        for request in [(a, 1), (a, 2), (b, 3), (a, 1)] {
            links.request(request.0, sender(request.1));
        }
        let mut order = Vec::new();
        for _ in 0..5 {
            let link = links.next(now).unwrap();
            let sender = links.pop(link).unwrap();
            links.put_back(link, sender, Emitted::More);
            order.push((link, sender));
        }
        assert_eq!(order, [(a, 1), (b, 3), (a, 2), (b, 3), (a, 1)].map(|(link, key)| (link, sender(key))));
    }

    #[test]
    fn a_blocked_sender_is_woken_when_the_pacer_permits() {
        let (mut links, now) = (Links::new(), Instant::now());
        let link = links.open(options(1));
        links.request(link, sender(1));
        assert_eq!(links.next(now), Some(link));
        assert_eq!(links.pop(link), Some(sender(1)));
        while links.may_send(link, now, Load::Bulk, 1344) {}
        links.put_back(link, sender(1), Emitted::Blocked);
        assert_eq!(links.next(now), None);
        let opens = links.next_timeout().unwrap();
        assert!(opens > now && opens < now + Duration::from_millis(1));
        assert_eq!(links.next(opens), Some(link));
        assert_eq!((links.pop(link), links.next_timeout()), (Some(sender(1)), None));
    }

    #[test]
    fn a_blocked_sender_is_woken_by_acknowledgements_of_another() {
        let (mut links, now) = (Links::new(), Instant::now());
        let link = links.open(LinkOptions { receive_buffer: Some(1 << 20), ..options(1) });
        links.change_in_flight(link, 0, 1 << 20);
        assert!(!links.may_send_reliable(link, now, Load::Bulk, 1344));
        links.put_back(link, sender(1), Emitted::Blocked);
        assert_eq!((links.next(now), links.next_timeout()), (None, None));
        links.change_in_flight(link, 1 << 20, 1000);
        assert_eq!(links.next(now), Some(link));
    }
}
