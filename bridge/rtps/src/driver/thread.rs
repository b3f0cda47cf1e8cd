//! The thread of a participant: receives, runs the timers and handlers, and sends what other threads leave to
//! it.

use super::engine::{Engine, now};
use super::interfaces::Interfaces;
use super::ports::Ports;
use super::sockets::{Buffers, Receivers};
use super::{Range, SENDER, TOKENS};
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
    /// Time between two reads of the interfaces.
    pub(super) period: Duration,
    /// Hosts to announce to that were given by address.
    pub(super) fixed: Vec<SocketAddrV4>,
    /// Hosts to announce to that were given by name.
    pub(super) named: Vec<SocketAddrV4>,
    /// The resolved names.
    pub(super) looked_up: Receiver<Vec<SocketAddrV4>>,
}

/// The state of the thread.
struct Turn {
    ready: Events,
    buffers: Buffers,
    events: Vec<Event>,
    /// Sockets that may have more datagrams.
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
            // The loopback interface does not change.
            looks_at_interfaces: (self.range == Range::Subnet).then(|| Instant::now() + self.period),
        };
        while !self.engine.is_stopping() {
            if catch_unwind(AssertUnwindSafe(|| self.take(&mut turn))).is_err() {
                tracing::error!("the RTPS engine panicked; it continues");
                // A panic that recurs immediately must not use the whole processor.
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
            // Interrupted by a signal; the next turn polls the sockets again.
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
        if turn.ready.iter().any(|event| event.token() == SENDER && event.is_error()) {
            self.engine.read_refusals();
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

    /// Receives some datagrams. Returns whether there may be more.
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
            // Also if nothing has changed, to retry what failed before.
            self.receivers.join(self.interfaces.used());
        }
        if has_changed {
            tracing::info!("now reachable at {:?}", self.interfaces.used());
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
