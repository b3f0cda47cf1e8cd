//! The server: its addresses, and the threads of its connections.

use crate::assets::Assets;
use crate::bag::{self, BagPlayback, BagSource};
use crate::client::Client;
use crate::connection::{self, Ended, Proof};
use crate::options::{Access, Token, ViewOptions};
use crate::outbox::{Frame, Outbox};
use crate::page::{PAGE_PORT, http};
use crate::session::Session;
use crate::shared::{Connection, Door, Shared};
use crate::source::{CoreLink, CoreSource, Source};
use downbeat_bags::{PlayerError, Reader};
use downbeat_edge::{CoreAccess, Interfaces};
use downbeat_executor::{Core, SetupError};
use parking_lot::{Condvar, Mutex};
use std::io::{self, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use thiserror::Error;

/// The server cannot start.
#[derive(Debug, Error)]
pub enum ViewError {
    /// The address cannot be used.
    #[error(
        "cannot listen for viewers on {address}: {source}. Choose another port, or 0 for a free one, or end the program that \
         has it"
    )]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The error of the operating system.
        source: io::Error,
    },
    /// A thread cannot be started.
    #[error("cannot start a thread for viewers: {0}")]
    Thread(io::Error),
    /// A bag cannot be played.
    #[error(transparent)]
    Bag(#[from] PlayerError),
    /// A service cannot be shown.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// The core does not answer.
    #[error("the core does not answer: it has stopped, or a module does not return")]
    NoAnswer,
}

/// Shows a core, or recorded bags, to viewers until it is dropped.
///
/// It may be started before or while the core runs, and is dropped after the core has stopped, so that
/// viewers receive the last messages. Topics that appear later are shown within a second of a viewer being
/// connected; services are those that modules serve when the server starts.
pub struct ViewServer {
    shared: Arc<Shared>,
    foxglove: Option<SocketAddr>,
    page: Option<SocketAddr>,
    threads: Vec<JoinHandle<()>>,
}

/// How long the core may take to answer.
const PATIENCE: Duration = Duration::from_secs(5);

/// A viewer that sends nothing for this long, not even the answer to a ping, is disconnected.
const SILENCE: Duration = Duration::from_secs(35);

/// How long it may take to connect to a listener of the server itself.
const CONNECT: Duration = Duration::from_secs(1);

impl ViewServer {
    /// Starts the server for a core that does not run yet. The types of topics and services are looked up in
    /// `interfaces`.
    ///
    /// # Errors
    /// If the address is in use or not of this machine, or a thread cannot be started.
    pub fn start(core: &mut Core, interfaces: &Interfaces, options: ViewOptions) -> Result<Self, ViewError> {
        let link = CoreLink::of(core, interfaces)?;
        let topics: Vec<_> = core.topics().cloned().collect();
        let source = CoreSource::new(link, &mut CoreAccess::Idle(core), &topics, &options);
        Self::open(Source::Core(source), options)
    }

    /// Starts the server for a core that may run already, of which the link was taken before it ran.
    ///
    /// # Errors
    /// If the core does not answer, the address is in use or not of this machine, or a thread cannot be
    /// started.
    pub fn start_from(link: CoreLink, options: ViewOptions) -> Result<Self, ViewError> {
        let core = link.core.clone();
        let topics = core.topics().wait(PATIENCE).ok_or(ViewError::NoAnswer)?;
        let source = CoreSource::new(link, &mut CoreAccess::Running(&core), &topics, &options);
        Self::open(Source::Core(source), options)
    }

    /// Starts a server that shows recorded bags, merged by time, which viewers play, pause and seek. The
    /// definitions of types that the bags lack are looked up in `interfaces`.
    ///
    /// # Errors
    /// If the bags have a topic with different types or end before the start, the address is in use or not of
    /// this machine, or a thread cannot be started.
    pub fn show_bags(
        bags: impl Into<Arc<[Reader]>>,
        interfaces: &Interfaces,
        playback: BagPlayback,
        options: ViewOptions,
    ) -> Result<Self, ViewError> {
        let source = Source::Bag(BagSource::new(bags.into(), interfaces, playback, &options)?);
        let mut server = Self::open(source, options)?;
        let shared = Arc::clone(&server.shared);
        server.threads.push(spawn("view play", move || shared.play())?);
        Ok(server)
    }

    /// Serves a page for what is no core: all that it asks is answered by the [`Host`](crate::Host) of its
    /// options.
    ///
    /// # Errors
    /// If the address is in use or not of this machine, or a thread cannot be started.
    pub fn start_page(options: ViewOptions) -> Result<Self, ViewError> {
        Self::open(Source::Nothing, options)
    }

    fn open(source: Source, options: ViewOptions) -> Result<Self, ViewError> {
        let foxglove = options.foxglove.map(|port| listen(options.address, port)).transpose()?;
        let page =
            options.page.as_ref().map(|page| listen_for_page(options.address, page.port)).transpose()?;
        let packages = options.packages.clone();
        let assets = Assets::new(packages, Assets::ament_prefixes(), options.limits.asset_bytes);
        let started = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let shared = Arc::new(Shared {
            source,
            assets,
            options,
            session_id: format!("{}-{}", started.as_nanos(), std::process::id()),
            announcing: Mutex::default(),
            clients: Mutex::default(),
            connections: Mutex::default(),
            last_connection: AtomicU64::new(0),
            is_stopping: AtomicBool::new(false),
            pulse: Mutex::default(),
            pulsed: Condvar::new(),
        });
        let mut server =
            Self { shared: Arc::clone(&shared), foxglove: None, page: None, threads: Vec::new() };
        let announcer = Arc::clone(&shared);
        server.threads.push(spawn("view", move || announcer.announce_changes())?);
        if let Some((listener, address)) = foxglove {
            server.foxglove = Some(address);
            let shared = Arc::clone(&shared);
            server.threads.push(spawn("view accept", move || accept(&listener, &shared, Door::Foxglove))?);
        }
        if let Some((listener, address)) = page {
            server.page = Some(address);
            server.threads.push(spawn("page accept", move || accept(&listener, &shared, Door::Page))?);
        }
        Ok(server)
    }

    /// The address for Foxglove, Lichtblick and PlotJuggler, if they are served.
    #[must_use]
    pub fn foxglove_address(&self) -> Option<SocketAddr> {
        self.foxglove
    }

    /// The address of the page, if it is served.
    #[must_use]
    pub fn page_address(&self) -> Option<SocketAddr> {
        self.page
    }

    /// The token with which a viewer may change the robot, if there is one.
    #[must_use]
    pub fn token(&self) -> Option<&Token> {
        match &self.shared.options.access {
            Access::Token(token) => Some(token),
            Access::ReadOnly | Access::Open => None,
        }
    }

    /// The URL for Foxglove, Lichtblick and PlotJuggler on this machine, with the token. Keep it secret.
    #[must_use]
    pub fn foxglove_url(&self) -> Option<String> {
        let address = reachable(self.foxglove?);
        Some(match self.token() {
            Some(token) => format!("ws://{address}/?token={}", token.as_str()),
            None => format!("ws://{address}/"),
        })
    }

    /// The URL of the page for a browser on this machine, with the token. Keep it secret.
    #[must_use]
    pub fn page_url(&self) -> Option<String> {
        let address = reachable(self.page?);
        Some(match self.token() {
            // Behind the #, where neither servers nor logs see it.
            Some(token) => format!("http://{address}/#token={}", token.as_str()),
            None => format!("http://{address}/"),
        })
    }

    /// How many viewers are connected.
    #[must_use]
    pub fn viewers(&self) -> usize {
        self.shared.clients.lock().len()
    }
}

impl Drop for ViewServer {
    /// Disconnects all viewers, after they have been sent what waits for them.
    fn drop(&mut self) {
        self.shared.is_stopping.store(true, Ordering::SeqCst);
        self.shared.look_now();
        self.shared.source.stop();
        // Wakes the threads that accept. If that fails nobody can connect, and the threads are not joined.
        let mut doors = self.foxglove.iter().chain(&self.page);
        let is_awake = doors.all(|door| TcpStream::connect_timeout(&reachable(*door), CONNECT).is_ok());
        for thread in self.threads.drain(..).filter(|_| is_awake) {
            let _ = thread.join();
        }
        for client in self.shared.clients.lock().values() {
            client.outbox.end(Some(Frame::Close { code: 1001, reason: "the robot stops" }));
        }
        let connections = std::mem::take(&mut *self.shared.connections.lock());
        for Connection { stream, .. } in connections.values() {
            // No more requests; the writing thread sends what waits.
            let _ = stream.shutdown(Shutdown::Read);
        }
        for thread in connections.into_values().filter_map(|connection| connection.thread) {
            let _ = thread.join();
        }
        self.shared.source.close();
    }
}

impl Shared {
    /// The thread that plays a bag, until the server stops.
    fn play(&self) {
        if let Some(bag) = self.source.bag()
            && let Err(error) = bag::play(self, bag)
        {
            tracing::error!("the bag is not played: {error}");
        }
    }

    /// The thread of a connection.
    fn serve(self: &Arc<Self>, id: u64, mut stream: TcpStream, door: Door) {
        let limits = &self.options.limits;
        let peer = stream.peer_addr().map_or_else(|_| "?".to_owned(), |peer| peer.to_string());
        let mut received = Vec::new();
        if door == Door::Page {
            let Some(page) = &self.options.page else { return };
            match http::serve(&mut stream, page) {
                Ok(Some(handshake)) => received = handshake,
                Ok(None) | Err(_) => return,
            }
            if !self.has_room_for_viewer() {
                return refuse(stream);
            }
        }
        let access = &self.options.access;
        let (mut reader, proof, protocol) =
            match connection::accept(stream, received, door.subprotocols(), access, limits) {
                Ok(accepted) => accepted,
                Err(error) => {
                    tracing::debug!("a connection from {peer} is no viewer: {error}");
                    return;
                }
            };
        let outbox = Arc::new(Outbox::new(limits.backlog_messages, limits.backlog_bytes));
        let writer = reader.split(&outbox, SILENCE).and_then(|stream| {
            let (outbox, stall) = (Arc::clone(&outbox), limits.stall);
            let builder = std::thread::Builder::new().name("view write".into());
            builder.spawn(move || connection::write(stream, &outbox, stall))
        });
        let writer = match writer {
            Ok(writer) => writer,
            Err(error) => {
                tracing::warn!("the viewer {peer} is not served: {error}");
                return;
            }
        };
        // The client class of `@foxglove/ws-protocol`, which knows only this one, takes the state of playback
        // for a fault.
        let knows_playback = protocol != "foxglove.websocket.v1";
        let client = Client { id, outbox: Arc::clone(&outbox), knows_playback, watched: Mutex::default() };
        let client = Arc::new(client);
        if self.welcome(&client, proof).is_ok() {
            tracing::info!(
                "viewer {peer} is connected{}",
                if proof == Proof::Full { " and may change the robot" } else { "" }
            );
            self.look_now();
            let ended = Session::new(self, &client, proof).run(&mut reader);
            self.clients.lock().remove(&id);
            match ended {
                Ended::Left => {
                    tracing::info!("viewer {peer} has left");
                    outbox.end(None);
                }
                Ended::Refused(code, reason) => {
                    tracing::warn!("viewer {peer} is disconnected: {reason}");
                    outbox.end(Some(Frame::Close { code, reason }));
                }
            }
        } else {
            outbox.close();
        }
        let _ = writer.join();
    }
}

/// The thread that accepts connections, until the server stops.
fn accept(listener: &TcpListener, shared: &Arc<Shared>, door: Door) {
    loop {
        let id = shared.last_connection.fetch_add(1, Ordering::Relaxed) + 1;
        let accepted = listener.accept();
        if shared.is_stopping.load(Ordering::SeqCst) {
            return;
        }
        let stream = match accepted {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::warn!("a viewer could not connect: {error}");
                // Out of files, mostly: others end meanwhile.
                std::thread::sleep(Duration::from_millis(100));
                continue;
            }
        };
        let mut connections = shared.connections.lock();
        // Files of the page are fetched over connections beside those of viewers.
        let most = match door {
            Door::Foxglove => shared.options.limits.clients,
            Door::Page => shared.options.limits.clients.saturating_mul(4),
        };
        if connections.values().filter(|connection| connection.door == door).count() >= most {
            drop(connections);
            refuse(stream);
            continue;
        }
        let Ok(other) = stream.try_clone() else { continue };
        // It waits for the lock at its end, so the entry is there before it is removed.
        let thread = spawn("view read", {
            let shared = Arc::clone(shared);
            move || {
                shared.serve(id, stream, door);
                shared.connections.lock().remove(&id);
            }
        });
        match thread {
            Ok(thread) => {
                drop(connections.insert(id, Connection { stream: other, thread: Some(thread), door }))
            }
            Err(error) => tracing::warn!("a viewer could not connect: {error}"),
        }
    }
}

fn refuse(mut stream: TcpStream) {
    let text = "too many viewers are connected";
    let length = text.len();
    let _ = stream.set_nonblocking(true);
    let _ = write!(
        stream,
        "HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nContent-Length: {length}\r\n\r\n{text}"
    );
}

fn listen(address: IpAddr, port: u16) -> Result<(TcpListener, SocketAddr), ViewError> {
    let address = SocketAddr::new(address, port);
    let refused = |source| ViewError::Listen { address, source };
    let listener = TcpListener::bind(address).map_err(refused)?;
    let address = listener.local_addr().map_err(refused)?;
    Ok((listener, address))
}

fn listen_for_page(address: IpAddr, port: Option<u16>) -> Result<(TcpListener, SocketAddr), ViewError> {
    match port {
        Some(port) => listen(address, port),
        None => listen(address, PAGE_PORT).or_else(|_| listen(address, 0)),
    }
}

/// The address under which this machine reaches the server.
fn reachable(mut address: SocketAddr) -> SocketAddr {
    if address.ip().is_unspecified() {
        let loopback =
            if address.is_ipv4() { IpAddr::V4(Ipv4Addr::LOCALHOST) } else { IpAddr::V6(Ipv6Addr::LOCALHOST) };
        address.set_ip(loopback);
    }
    address
}

fn spawn(name: &str, run: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, ViewError> {
    std::thread::Builder::new().name(name.into()).spawn(run).map_err(ViewError::Thread)
}
