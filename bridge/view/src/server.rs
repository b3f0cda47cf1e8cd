//! The server: its threads, and what they share.

use crate::assets::Assets;
use crate::bag::{self, BagPlayback, BagSource};
use crate::channels::Changes;
use crate::connection::{self, Ended, Proof};
use crate::graph::Connections;
use crate::options::{Access, Token, ViewOptions, ViewTime};
use crate::outbox::{Frame, Outbox};
use crate::page::{self, PAGE_PORT, http};
use crate::parameters::{parameter, settings};
use crate::protocol::{Level, SUBPROTOCOLS, status, time, timestamp};
use crate::services::{ShownService, shown};
use crate::session::{Client, Session, Watched};
use crate::source::{CoreSource, Source};
use downbeat_bags::{PlayerError, Reader};
use downbeat_edge::{CoreAccess, Interfaces};
use downbeat_executor::{Clock, Core, CoreHandle, SetupError};
use parking_lot::{Condvar, Mutex};
use serde_json::json;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
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
/// It may be started before or while the core runs, and is dropped after the core has stopped, so that viewers receive the last
/// messages. Topics that appear later are shown within a second of a viewer being connected; services are those that modules serve
/// when the server starts.
pub struct ViewServer {
    shared: Arc<Shared>,
    foxglove: Option<SocketAddr>,
    page: Option<SocketAddr>,
    threads: Vec<JoinHandle<()>>,
}

/// What a server needs of a core that only a core that does not run yet can give.
#[derive(Clone)]
pub struct Seed {
    pub(crate) core: CoreHandle,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) interfaces: Interfaces,
    pub(crate) services: Arc<[ShownService]>,
}

impl Seed {
    /// Takes the seed of a core. Viewers can call the services that modules serve now.
    ///
    /// # Errors
    /// If the core has no caller for a service.
    pub fn of(core: &mut Core, interfaces: &Interfaces) -> Result<Self, SetupError> {
        let services = shown(core, interfaces)?.into();
        Ok(Self { core: core.handle(), clock: core.clock(), interfaces: interfaces.clone(), services })
    }
}

/// What the threads of the server share.
pub(crate) struct Shared {
    pub(crate) source: Source,
    pub(crate) assets: Assets,
    pub(crate) options: ViewOptions,
    session_id: String,
    /// Held while channels are announced, so that each viewer hears of each channel once.
    announcing: Mutex<()>,
    clients: Mutex<BTreeMap<u64, Arc<Client>>>,
    /// The open connections, those in their handshake too.
    connections: Mutex<BTreeMap<u64, Connection>>,
    last_connection: AtomicU64,
    is_stopping: AtomicBool,
    /// True if the thread that announces changes has something to do before its next look.
    pulse: Mutex<bool>,
    pulsed: Condvar,
}

struct Connection {
    stream: TcpStream,
    door: Door,
    thread: Option<JoinHandle<()>>,
}

/// How long the core may take to answer.
const PATIENCE: Duration = Duration::from_secs(5);

/// How often the core is compared with what viewers know.
const LOOK: Duration = Duration::from_secs(1);

/// How often viewers are sent the time of the core.
const TIME: Duration = Duration::from_millis(50);

/// The interval of reports to a viewer that messages of a topic are dropped.
const TELL: Duration = Duration::from_secs(10);

/// A viewer must answer one of these pings.
const PING: Duration = Duration::from_secs(10);
const SILENCE: Duration = Duration::from_secs(35);

impl ViewServer {
    /// Starts the server for a core that does not run yet. The types of topics and services are looked up in `interfaces`.
    ///
    /// # Errors
    /// If the address is in use or not of this machine, or a thread cannot be started.
    pub fn start(core: &mut Core, interfaces: &Interfaces, options: ViewOptions) -> Result<Self, ViewError> {
        let seed = Seed::of(core, interfaces)?;
        let topics: Vec<_> = core.topics().cloned().collect();
        let source = CoreSource::new(seed, &mut CoreAccess::Idle(core), &topics, &options);
        Self::open(Source::Core(source), options)
    }

    /// Starts the server for a core that may run already, of which the seed was taken before it ran.
    ///
    /// # Errors
    /// If the core does not answer, the address is in use or not of this machine, or a thread cannot be started.
    pub fn start_from(seed: Seed, options: ViewOptions) -> Result<Self, ViewError> {
        let core = seed.core.clone();
        let topics = core.topics().wait(PATIENCE).ok_or(ViewError::NoAnswer)?;
        let source = CoreSource::new(seed, &mut CoreAccess::Running(&core), &topics, &options);
        Self::open(Source::Core(source), options)
    }

    /// Starts a server that shows recorded bags, merged by time, which viewers play, pause and seek. The definitions of types that
    /// the bags lack are looked up in `interfaces`.
    ///
    /// # Errors
    /// If the bags have a topic with different types or end before the start, the address is in use or not of this machine, or
    /// a thread cannot be started.
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

    /// Serves a page for what is no core: all that it asks is answered by the [`Host`](crate::Host) of its options.
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
        let is_awake = doors.all(|door| TcpStream::connect_timeout(&reachable(*door), LOOK).is_ok());
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
    /// Announces changes now instead of within a second.
    pub(crate) fn look_now(&self) {
        *self.pulse.lock() = true;
        self.pulsed.notify_all();
    }

    /// The thread that plays a bag, until the server stops.
    fn play(&self) {
        if let Some(bag) = self.source.bag()
            && let Err(error) = bag::play(self, bag)
        {
            tracing::error!("the bag is not played: {error}");
        }
    }

    /// The thread that announces what changes in the core, until the server stops.
    fn announce_changes(&self) {
        let (mut last_look, mut last_ping) = (Instant::now(), Instant::now());
        let mut last_time = None;
        loop {
            let is_asked = self.wait();
            if self.is_stopping.load(Ordering::SeqCst) {
                return;
            }
            if self.options.time == ViewTime::Core
                && let Ok(core) = self.source.core()
            {
                let now = core.time_ns();
                if last_time.replace(now) != Some(now) {
                    let frame = time(now);
                    self.for_each_client(|_| Some(Frame::Binary(frame.clone())));
                }
            }
            if is_asked || last_look.elapsed() >= LOOK {
                last_look = Instant::now();
                self.announce_channels();
                self.announce_connections();
                self.announce_parameters();
                self.report_losses();
            }
            if last_ping.elapsed() >= PING {
                last_ping = Instant::now();
                self.for_each_client(|_| Some(Frame::Ping));
            }
        }
    }

    /// Waits for the next look, without end while there are no viewers. Returns true if the look was asked for.
    fn wait(&self) -> bool {
        let period = if self.options.time == ViewTime::Core { TIME } else { LOOK };
        let mut pulse = self.pulse.lock();
        while !*pulse {
            if self.clients.lock().is_empty() {
                self.pulsed.wait(&mut pulse);
            } else if self.pulsed.wait_for(&mut pulse, period).timed_out() {
                break;
            }
        }
        std::mem::take(&mut *pulse)
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

    fn has_room_for_viewer(&self) -> bool {
        self.clients.lock().len() < self.options.limits.clients
    }

    fn disconnect(&self, id: u64) {
        if let Some(connection) = self.connections.lock().get(&id) {
            let _ = connection.stream.shutdown(Shutdown::Both);
        }
    }

    fn announce_channels(&self) {
        let Ok(core) = self.source.core() else { return };
        let _announcing = self.announcing.lock();
        let Some(Changes { added, removed }) = core.refresh(&self.options, LOOK) else { return };
        if !removed.is_empty() {
            let text = json!({ "op": "unadvertise", "channelIds": removed }).to_string();
            self.for_each_client(|_| Some(Frame::Text(text.clone())));
        }
        if !added.is_empty() {
            let channels: Vec<_> = added.iter().map(|channel| channel.announcement()).collect();
            let text = json!({ "op": "advertise", "channels": channels }).to_string();
            self.for_each_client(|_| Some(Frame::Text(text.clone())));
        }
    }

    fn announce_connections(&self) {
        if !self.clients.lock().values().any(|client| client.watched.lock().connections.is_some()) {
            return;
        }
        let Ok(core) = self.source.core() else { return };
        let Some(graph) = core.handle.graph().wait(LOOK) else { return };
        let connections = Connections::of(&graph);
        self.for_each_client(|client| {
            let mut watched = client.watched.lock();
            let known = watched.connections.as_mut()?;
            let update = connections.update(known)?;
            known.clone_from(&connections);
            Some(Frame::Text(update))
        });
    }

    fn announce_parameters(&self) {
        if !self.clients.lock().values().any(|client| !client.watched.lock().parameters.is_empty()) {
            return;
        }
        let Ok(core) = self.source.core() else { return };
        let Some(settings) = settings(&core.handle, LOOK) else { return };
        self.for_each_client(|client| {
            let mut changed = Vec::new();
            for (name, known) in &mut client.watched.lock().parameters {
                let Some((_, info)) = settings.get(name) else { continue };
                let value = parameter(name, &info.value);
                if known.as_ref() != Some(&value) {
                    changed.push(value.clone());
                    *known = Some(value);
                }
            }
            let text = json!({ "op": "parameterValues", "parameters": changed }).to_string();
            (!changed.is_empty()).then_some(Frame::Text(text))
        });
    }

    fn report_losses(&self) {
        let clients: Vec<_> = self.clients.lock().values().cloned().collect();
        for client in clients {
            let dropped = client.outbox.take_dropped();
            let mut watched = client.watched.lock();
            let Watched { topics, told, .. } = &mut *watched;
            told.retain(|_, told| told.elapsed() < TELL);
            for topic in dropped.keys().filter_map(|subscription| topics.get(subscription)) {
                if told.contains_key(topic) {
                    continue;
                }
                told.insert(Arc::clone(topic), Instant::now());
                // Without a number: viewers show each different text once.
                let text = format!(
                    "messages of /{topic} are dropped: the connection or the viewer is too slow for what it subscribed to"
                );
                // If there is no room the viewer is disconnected with the next announcement.
                let _ = client.outbox.announce(Frame::Text(status(Level::Warning, &text)));
            }
            let lost: u64 = dropped.values().sum();
            if lost > 0 {
                tracing::debug!("{lost} messages to viewer {} were dropped", client.id);
            }
        }
    }

    /// Tells a new viewer what there is, and every change from now on.
    fn welcome(&self, client: &Arc<Client>, proof: Proof) -> Result<(), crate::outbox::Closed> {
        let mut capabilities = self.source.capabilities(&self.options);
        if proof == Proof::Full && self.source.core().is_ok() {
            capabilities.extend(["clientPublish", "services"]);
        }
        let mut info = json!({
            "op": "serverInfo",
            "name": self.options.name,
            "capabilities": capabilities,
            "supportedEncodings": ["cdr", "json"],
            "metadata": { "ROS_DISTRO": "jazzy" },
            "sessionId": self.session_id,
        });
        if let Some(bag) = self.source.bag() {
            info["dataStartTime"] = timestamp(u64::try_from(bag.start).unwrap_or(0));
            info["dataEndTime"] = timestamp(u64::try_from(bag.end).unwrap_or(0));
        }
        let _announcing = self.announcing.lock();
        client.outbox.announce(Frame::Text(info.to_string()))?;
        let channels = json!({ "op": "advertise", "channels": self.source.channels() });
        client.outbox.announce(Frame::Text(channels.to_string()))?;
        if proof == Proof::Full && self.source.core().is_ok() {
            let services: Vec<_> = self.source.services().iter().map(ShownService::announcement).collect();
            let services = json!({ "op": "advertiseServices", "services": services });
            client.outbox.announce(Frame::Text(services.to_string()))?;
        }
        self.clients.lock().insert(client.id, Arc::clone(client));
        if let Some(bag) = self.source.bag() {
            bag.greet(client.id);
        }
        Ok(())
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
        // The client class of `@foxglove/ws-protocol`, which knows only this one, takes the state of playback for a fault.
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

/// Where a connection came in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Door {
    Foxglove,
    Page,
}

impl Door {
    fn subprotocols(self) -> &'static [&'static str] {
        match self {
            Self::Foxglove => &SUBPROTOCOLS,
            Self::Page => &[page::SUBPROTOCOL],
        }
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
