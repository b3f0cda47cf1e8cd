//! The server side of the inspection socket.

use std::collections::BTreeMap;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::Shutdown;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use parking_lot::Mutex;
use serde::Serialize;
use serde_json::value::{RawValue, to_raw_value};

use super::sockets::{UnixListener, UnixStream};
use super::{Answer, Inspected, LONGEST_REQUEST, Request, SocketDirectory, Watch};

/// How many clients may be connected at a time.
const MOST_CLIENTS: usize = 16;

/// How long a client may take to read an answer.
const PATIENCE: Duration = Duration::from_secs(5);

/// Error while starting the inspection server.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// The socket could not be opened.
    #[error("cannot open the socket {}: {source}", path.display())]
    Socket {
        /// The path of the socket.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The thread could not be started.
    #[error("cannot start a thread for the socket {}: {source}", path.display())]
    Thread {
        /// The path of the socket.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
}

/// Answers requests about a running robot on its own threads until it is dropped.
pub struct InspectionServer {
    path: PathBuf,
    shared: Arc<Shared>,
    acceptor: Option<JoinHandle<()>>,
}

struct Shared {
    robot: Arc<dyn Inspected>,
    is_stopping: AtomicBool,
    /// The open connections, which the drop shuts down.
    clients: Mutex<BTreeMap<u64, Client>>,
}

struct Client {
    stream: UnixStream,
    thread: Option<JoinHandle<()>>,
}

impl InspectionServer {
    /// Opens the socket for a robot of that name in this process.
    ///
    /// # Errors
    /// Returns an error if the socket cannot be opened or its thread cannot be started.
    pub fn start(
        directory: &SocketDirectory,
        name: &str,
        robot: Arc<dyn Inspected>,
    ) -> Result<Self, ServerError> {
        let (path, listener) = listen(directory, name)?;
        let (is_stopping, clients) = (AtomicBool::new(false), Mutex::default());
        let shared = Arc::new(Shared { robot, is_stopping, clients });
        let builder = std::thread::Builder::new().name("inspect".into());
        let acceptor = builder.spawn({
            let shared = Arc::clone(&shared);
            move || accept(&listener, &shared)
        });
        match acceptor {
            Ok(acceptor) => Ok(Self { path, shared, acceptor: Some(acceptor) }),
            Err(source) => {
                let _ = std::fs::remove_file(&path);
                Err(ServerError::Thread { path, source })
            }
        }
    }

    /// The path of the socket.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for InspectionServer {
    /// Removes the socket and waits for requests that are being answered.
    fn drop(&mut self) {
        self.shared.is_stopping.store(true, Ordering::SeqCst);
        // Wakes the thread that waits for clients. If this fails no client can connect any more, and the
        // thread is not joined.
        let is_awake = UnixStream::connect(&self.path).is_ok();
        let _ = std::fs::remove_file(&self.path);
        if let Some(acceptor) = self.acceptor.take().filter(|_| is_awake) {
            let _ = acceptor.join();
        }
        let clients = std::mem::take(&mut *self.shared.clients.lock());
        for client in clients.values() {
            let _ = client.stream.shutdown(Shutdown::Both);
        }
        for thread in clients.into_values().filter_map(|client| client.thread) {
            let _ = thread.join();
        }
    }
}

/// Opens the socket under a temporary name and renames it once it listens, so that clients do not take it for
/// the socket of a dead process.
fn listen(directory: &SocketDirectory, name: &str) -> Result<(PathBuf, UnixListener), ServerError> {
    /// Prevents two robots of this process from taking the same name.
    static NAMING: Mutex<()> = Mutex::new(());
    let _naming = NAMING.lock();
    let mut number = 1;
    let mut path = directory.socket(name, number);
    // A socket without a listener belongs to an ended process with the same id.
    while UnixStream::connect(&path).is_ok() {
        number += 1;
        path = directory.socket(name, number);
    }
    let unfinished = path.with_extension("new");
    let _ = std::fs::remove_file(&unfinished);
    let listener = UnixListener::bind(&unfinished)
        .and_then(|listener| std::fs::rename(&unfinished, &path).map(|()| listener));
    match listener {
        Ok(listener) => Ok((path, listener)),
        Err(source) => Err(ServerError::Socket { path, source }),
    }
}

fn accept(listener: &UnixListener, shared: &Arc<Shared>) {
    for number in 0.. {
        let stream = listener.accept();
        if shared.is_stopping.load(Ordering::SeqCst) {
            return;
        }
        let outcome = stream.and_then(|(stream, _)| attend(number, stream, shared));
        if let Err(error) = outcome {
            tracing::warn!("rejected an inspection client: {error}");
            // Errors such as too many open files do not clear immediately.
            std::thread::sleep(Duration::from_millis(100));
        }
    }
}

/// Starts a thread that answers one client.
fn attend(number: u64, stream: UnixStream, shared: &Arc<Shared>) -> io::Result<()> {
    stream.set_write_timeout(Some(PATIENCE))?;
    let mut clients = shared.clients.lock();
    if clients.len() >= MOST_CLIENTS {
        let refusal = format!("there are already {MOST_CLIENTS} clients");
        return write_line(&stream, &Answer::Error(refusal));
    }
    clients.insert(number, Client { stream: stream.try_clone()?, thread: None });
    let for_thread = Arc::clone(shared);
    let thread = std::thread::Builder::new().name("inspect".into()).spawn(move || {
        // Errors of a client that disconnects or does not read are ignored.
        let _ = converse(&stream, &for_thread);
        for_thread.clients.lock().remove(&number);
    });
    match thread {
        // If the client has already ended there is no thread to join.
        Ok(thread) => clients.entry(number).and_modify(|client| client.thread = Some(thread)),
        Err(error) => {
            clients.remove(&number);
            return Err(error);
        }
    };
    Ok(())
}

/// Answers the requests of a client until it disconnects.
fn converse(stream: &UnixStream, shared: &Shared) -> io::Result<()> {
    let mut lines = BufReader::new(stream);
    // Ends with the connection.
    let mut watch = None;
    loop {
        let mut line = Vec::new();
        if (&mut lines).take(LONGEST_REQUEST).read_until(b'\n', &mut line)? == 0 {
            return Ok(());
        }
        if line.last() != Some(&b'\n') && line.len() as u64 == LONGEST_REQUEST {
            let refusal = format!("a request must be a line of fewer than {LONGEST_REQUEST} bytes");
            return write_line(stream, &Answer::Error(refusal));
        }
        write_line(stream, &answer(&line, &*shared.robot, &mut watch))?;
    }
}

fn answer(line: &[u8], robot: &dyn Inspected, watch: &mut Option<Watch>) -> Answer {
    let answered = match serde_json::from_slice(line) {
        Ok(request) => carry_out(request, robot, watch),
        Err(error) => {
            Err(format!("\"{}\" is not a request: {error}", String::from_utf8_lossy(line).trim_end()))
        }
    };
    answered.map_or_else(Answer::Error, Answer::Ok)
}

fn carry_out(
    request: Request,
    robot: &dyn Inspected,
    watch: &mut Option<Watch>,
) -> Result<Box<RawValue>, String> {
    match request {
        Request::Snapshot => json(&robot.snapshot().map_err(|error| error.to_string())?),
        Request::Graph => json(&robot.graph().map_err(|error| error.to_string())?),
        Request::Trace { cycles } => {
            let most = Request::MOST_CYCLES;
            if !(1..=most).contains(&cycles) {
                return Err(format!("a trace has 1 to {most} cycles, not {cycles}"));
            }
            let trace = robot.trace(cycles).map_err(|error| error.to_string())?;
            let mut text = Vec::new();
            trace.write_chrome_json(&mut text).map_err(|error| error.to_string())?;
            let text = String::from_utf8(text).map_err(|error| error.to_string())?;
            RawValue::from_string(text).map_err(|error| error.to_string())
        }
        Request::Pause => {
            robot.pause();
            json(&())
        }
        Request::Resume => {
            robot.resume();
            json(&())
        }
        Request::Step => {
            robot.step();
            json(&())
        }
        Request::View => json(&robot.view()?),
        Request::Latencies => json(&robot.latencies()),
        Request::Exposed => json(&robot.exposed()?),
        Request::Expose { entries } => json(&robot.expose(&entries)?),
        Request::TakeBack { topics } => json(&robot.take_back(&topics)?),
        Request::Watch { topic, fields } => {
            let watch = match watch {
                Some(watch) => watch,
                None => watch.insert(robot.watch()?),
            };
            json(&watch.watch(&topic, &fields)?)
        }
        Request::Unwatch { topic } => {
            if let Some(watch) = watch {
                watch.unwatch(&topic);
            }
            json(&())
        }
        Request::Numbers { topic } => match watch {
            Some(watch) => json(&watch.numbers(&topic)?),
            None => Err(format!("{topic} is not watched")),
        },
        Request::Values => json(&watch.as_ref().map_or_else(Vec::new, Watch::values)),
    }
}

fn json(value: &impl Serialize) -> Result<Box<RawValue>, String> {
    to_raw_value(value).map_err(|error| error.to_string())
}

fn write_line(mut stream: &UnixStream, answer: &Answer) -> io::Result<()> {
    let mut line = serde_json::to_vec(answer)?;
    line.push(b'\n');
    stream.write_all(&line)
}

impl Shared {}
