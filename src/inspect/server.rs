//! The robot's side of the socket.

use std::collections::BTreeMap;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::Shutdown;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use parking_lot::Mutex;
use serde::Serialize;
use serde_json::value::{RawValue, to_raw_value};

use super::{Answer, Inspected, LONGEST_REQUEST, Request, SocketDirectory};

/// How many clients may be connected at a time.
const MOST_CLIENTS: usize = 16;

/// How long a client may take to read an answer.
const PATIENCE: Duration = Duration::from_secs(5);

/// Why a robot cannot be looked at.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// The socket could not be made.
    #[error("cannot open the socket {}: {source}", path.display())]
    Socket {
        /// The socket.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The system gave no thread.
    #[error("cannot start a thread for the socket {}: {source}", path.display())]
    Thread {
        /// The socket.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

/// Answers requests about a running robot until it is dropped, on threads of its own.
pub struct InspectionServer {
    path: PathBuf,
    shared: Arc<Shared>,
    acceptor: Option<JoinHandle<()>>,
}

struct Shared {
    robot: Arc<dyn Inspected>,
    is_stopping: AtomicBool,
    /// The connections, to be shut down at the end.
    clients: Mutex<BTreeMap<u64, Client>>,
}

struct Client {
    stream: UnixStream,
    thread: Option<JoinHandle<()>>,
}

impl InspectionServer {
    /// Opens the socket of this process for a robot of that name.
    ///
    /// # Errors
    /// If the socket or its thread cannot be made.
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

    /// The socket.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for InspectionServer {
    /// Removes the socket, and waits for requests that are being answered.
    fn drop(&mut self) {
        self.shared.is_stopping.store(true, Ordering::SeqCst);
        // Wakes the thread that waits for clients. Where that fails nobody can connect any more: it is left alone.
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

/// A socket under its final name listens already, so that nobody takes it for one of a dead process.
fn listen(directory: &SocketDirectory, name: &str) -> Result<(PathBuf, UnixListener), ServerError> {
    /// Two robots of this process do not take the same name.
    static NAMING: Mutex<()> = Mutex::new(());
    let _naming = NAMING.lock();
    let mut number = 1;
    let mut path = directory.socket(name, number);
    // What nobody listens to is of a process of the same number that has ended.
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
            tracing::warn!("a client that wanted to look at the robot was turned away: {error}");
            // Too many open files, for example, are not fewer at once.
            std::thread::sleep(Duration::from_millis(100));
        }
    }
}

/// Starts a thread that answers one client.
fn attend(number: u64, stream: UnixStream, shared: &Arc<Shared>) -> io::Result<()> {
    stream.set_write_timeout(Some(PATIENCE))?;
    let mut clients = shared.clients.lock();
    if clients.len() >= MOST_CLIENTS {
        let refusal = format!("there are {MOST_CLIENTS} clients already");
        return write_line(&stream, &Answer::Error(refusal));
    }
    clients.insert(number, Client { stream: stream.try_clone()?, thread: None });
    let for_thread = Arc::clone(shared);
    let thread = std::thread::Builder::new().name("inspect".into()).spawn(move || {
        // A client that goes away, or does not read, is no fault of the robot.
        let _ = converse(&stream, &for_thread);
        for_thread.clients.lock().remove(&number);
    });
    match thread {
        // Where it has ended already, nobody will have to wait for it.
        Ok(thread) => clients.entry(number).and_modify(|client| client.thread = Some(thread)),
        Err(error) => {
            clients.remove(&number);
            return Err(error);
        }
    };
    Ok(())
}

/// Answers a client's requests until it goes away.
fn converse(stream: &UnixStream, shared: &Shared) -> io::Result<()> {
    let mut lines = BufReader::new(stream);
    loop {
        let mut line = Vec::new();
        if (&mut lines).take(LONGEST_REQUEST).read_until(b'\n', &mut line)? == 0 {
            return Ok(());
        }
        if line.last() != Some(&b'\n') && line.len() as u64 == LONGEST_REQUEST {
            let refusal = format!("a request is a line of less than {LONGEST_REQUEST} bytes");
            return write_line(stream, &Answer::Error(refusal));
        }
        write_line(stream, &answer(&line, &*shared.robot))?;
    }
}

fn answer(line: &[u8], robot: &dyn Inspected) -> Answer {
    let answered = match serde_json::from_slice(line) {
        Ok(request) => carry_out(request, robot),
        Err(error) => Err(format!("\"{}\" is no request: {error}", String::from_utf8_lossy(line).trim_end())),
    };
    answered.map_or_else(Answer::Error, Answer::Ok)
}

fn carry_out(request: Request, robot: &dyn Inspected) -> Result<Box<RawValue>, String> {
    match request {
        Request::Snapshot => json(&robot.snapshot().map_err(|error| error.to_string())?),
        Request::Graph => json(&robot.graph().map_err(|error| error.to_string())?),
        Request::Trace { cycles } => {
            let most = Request::MOST_CYCLES;
            if !(1..=most).contains(&cycles) {
                return Err(format!("a trace is of 1 to {most} cycles, not of {cycles}"));
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
        Request::Exposed => json(&robot.exposed()?),
        Request::Expose { entries } => json(&robot.expose(&entries)?),
        Request::TakeBack { topics } => json(&robot.take_back(&topics)?),
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
