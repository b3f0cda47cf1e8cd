//! What the threads of the server share.

use crate::assets::Assets;
use crate::client::Client;
use crate::options::ViewOptions;
use crate::outbox::Frame;
use crate::page;
use crate::protocol::SUBPROTOCOLS;
use crate::source::Source;
use parking_lot::{Condvar, Mutex};
use std::collections::BTreeMap;
use std::net::{Shutdown, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};
use std::thread::JoinHandle;

/// What the threads of the server share.
pub(crate) struct Shared {
    pub(crate) source: Source,
    pub(crate) assets: Assets,
    pub(crate) options: ViewOptions,
    pub(crate) session_id: String,
    /// Held while channels are announced, so that each viewer hears of each channel once.
    pub(crate) announcing: Mutex<()>,
    pub(crate) clients: Mutex<BTreeMap<u64, Arc<Client>>>,
    /// The open connections, those in their handshake too.
    pub(crate) connections: Mutex<BTreeMap<u64, Connection>>,
    pub(crate) last_connection: AtomicU64,
    pub(crate) is_stopping: AtomicBool,
    /// True if the thread that announces changes has something to do before its next look.
    pub(crate) pulse: Mutex<bool>,
    pub(crate) pulsed: Condvar,
}

/// An open connection.
pub(crate) struct Connection {
    pub(crate) stream: TcpStream,
    pub(crate) door: Door,
    pub(crate) thread: Option<JoinHandle<()>>,
}

/// Where a connection came in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Door {
    Foxglove,
    Page,
}

impl Door {
    pub(crate) fn subprotocols(self) -> &'static [&'static str] {
        match self {
            Self::Foxglove => &SUBPROTOCOLS,
            Self::Page => &[page::SUBPROTOCOL],
        }
    }
}

impl Shared {
    /// Announces changes now instead of within a second.
    pub(crate) fn look_now(&self) {
        *self.pulse.lock() = true;
        self.pulsed.notify_all();
    }

    /// Sends each viewer what `frame` returns for it. A viewer that takes nothing more is disconnected.
    pub(crate) fn for_each_client(&self, mut frame: impl FnMut(&Client) -> Option<Frame>) {
        let clients: Vec<_> = self.clients.lock().values().cloned().collect();
        for client in clients {
            if let Some(frame) = frame(&client)
                && client.outbox.announce(frame).is_err()
            {
                self.disconnect(client.id);
            }
        }
    }

    pub(crate) fn has_room_for_viewer(&self) -> bool {
        self.clients.lock().len() < self.options.limits.clients
    }

    pub(crate) fn disconnect(&self, id: u64) {
        if let Some(connection) = self.connections.lock().get(&id) {
            let _ = connection.stream.shutdown(Shutdown::Both);
        }
    }
}
