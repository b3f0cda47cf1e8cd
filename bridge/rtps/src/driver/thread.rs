//! The thread of a participant: receives, runs the timers and the handlers, and sends what others have left to it.

use super::engine::{Engine, now};
use super::interfaces::Interfaces;
use super::sockets::{Buffers, Ports, Receivers};
use super::{Range, TOKENS};
use crate::protocol::Event;
use mio::{Events, Poll, Token};
use std::io;
use std::net::SocketAddrV4;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

pub(super) struct Thread {
    pub(super) engine: Arc<Engine>,
    pub(super) poll: Poll,
    pub(super) receivers: Receivers,
    pub(super) range: Range,
    pub(super) ports: Ports,
    pub(super) interfaces: Interfaces,
    /// Between two looks at the interfaces.
    pub(super) period: Duration,
    /// To announce to, by address.
    pub(super) fixed: Vec<SocketAddrV4>,
    /// To announce to, by name.
    pub(super) named: Vec<SocketAddrV4>,
    /// What the names are found to be.
    pub(super) looked_up: Receiver<Vec<SocketAddrV4>>,
}

/// What the thread works with.
struct Turn {
    ready: Events,
    buffers: Buffers,
    events: Vec<Event>,
    /// Sockets that may hold more than was received.
    may_hold_more: [bool; TOKENS],
    looks_at_interfaces: Option<Instant>,
}

impl Thread {
    pub(super) fn run(mut self) {
        self.engine.run_on_this_thread();
        let mut turn = Turn {
            ready: Events::with_capacity(8),
            buffers: Buffers::new(),
            events: Vec::new(),
            may_hold_more: [false; TOKENS],
            // Loopback neither comes nor goes.
            looks_at_interfaces: (self.range == Range::Subnet).then(|| Instant::now() + self.period),
        };
        while !self.engine.is_stopping() {
            if catch_unwind(AssertUnwindSafe(|| self.take(&mut turn))).is_err() {
                tracing::error!("the RTPS engine panicked; it goes on");
                // A panic that comes again at once must not take the whole processor.
                std::thread::sleep(Duration::from_millis(10));
            }
        }
        self.engine.transmit_all();
    }

    fn take(&mut self, turn: &mut Turn) {
        let timeout = if turn.may_hold_more.contains(&true) {
            Some(Duration::ZERO)
        } else {
            self.engine.sleep(turn.looks_at_interfaces)
        };
        match self.poll.poll(&mut turn.ready, timeout) {
            Ok(()) => {}
            // A signal; sockets are asked again in the next turn.
            Err(error) if error.kind() == io::ErrorKind::Interrupted => return,
            Err(error) => {
                tracing::error!("waiting for the network failed: {error}");
                std::thread::sleep(Duration::from_millis(10));
            }
        }
        self.engine.is_awake();
        for event in turn.ready.iter().filter(|event| event.is_readable()) {
            if let Some(is_ready) = turn.may_hold_more.get_mut(event.token().0) {
                *is_ready = true;
            }
        }
        for token in 0..TOKENS {
            if turn.may_hold_more[token] {
                turn.may_hold_more[token] = self.receive(Token(token), &mut turn.buffers);
                self.engine.deliver(&mut turn.events);
            }
        }
        self.engine.handle_timeout();
        self.look_at_interfaces(turn);
        self.engine.deliver(&mut turn.events);
        self.engine.transmit_all();
    }

    /// Receives some datagrams; true if there may be more.
    fn receive(&mut self, token: Token, buffers: &mut Buffers) -> bool {
        let engine = &self.engine;
        let mut locked = None;
        self.receivers.receive(token, buffers, |from, datagram| {
            let (now, protocol) = locked.get_or_insert_with(|| (now(), engine.lock()));
            protocol.handle_datagram(*now, from, datagram);
        })
    }

    fn look_at_interfaces(&mut self, turn: &mut Turn) {
        let mut has_changed = false;
        if let Some(named) = self.looked_up.try_iter().last() {
            has_changed = named != self.named;
            self.named = named;
        }
        let now = Instant::now();
        if turn.looks_at_interfaces.is_some_and(|at| at <= now) {
            turn.looks_at_interfaces = Some(now + self.period);
            match Interfaces::read(self.range, &self.interfaces) {
                Ok(interfaces) => {
                    has_changed |= interfaces != self.interfaces;
                    self.interfaces = interfaces;
                }
                Err(error) => tracing::warn!("reading the addresses of this machine failed: {error}"),
            }
            // Also where nothing has changed: what failed before is tried again.
            self.receivers.join(self.interfaces.used());
        }
        if has_changed {
            tracing::info!("reached at {:?} from now on", self.interfaces.used());
            let receivers = &self.receivers;
            let announce_to = self.fixed.iter().chain(&self.named).copied();
            let addresses = self.interfaces.addresses(
                self.ports,
                (receivers.meta_port, receivers.user_port),
                announce_to,
            );
            self.engine.set_addresses(&self.interfaces, addresses);
        }
    }
}
