//! Emulators: emulated devices behind a pseudo terminal, or in memory for as long as a module runs.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use downbeat_executor::{Module, Setting, Setup, SetupError};
use downbeat_servos::servo_emulator::{EmulatorError, Fault, PseudoTerminal};

use super::emulated::{Emulated, EmulatedDevice, EmulatedPorts, Offered};

/// How long the thread of an emulator waits for bytes before it looks what the device sends.
const LOOK: Duration = Duration::from_millis(2);

/// An emulated device on a pseudo terminal. It stops when it is dropped.
///
/// ```
/// use std::time::Duration;
/// use downbeat_sensors::serial::{EmulatedDevice, Emulator};
///
/// /// Sends a line each second.
/// struct Clock(u64);
///
/// impl EmulatedDevice for Clock {
///     fn advance_to(&mut self, now: Duration, send: &mut dyn FnMut(Vec<u8>)) {
///         while self.0 <= now.as_secs() {
///             send(format!("{}\n", self.0).into_bytes());
///             self.0 += 1;
///         }
///     }
/// }
///
/// let emulator = Emulator::start(Box::new(Clock(0)), None, Vec::new(), 1)?;
/// assert!(emulator.port().exists());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Emulator {
    port: PathBuf,
    is_stopping: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Emulator {
    /// Opens a pseudo terminal, links it if `link` is given, and serves it. Times of faults are relative to
    /// the start.
    ///
    /// # Errors
    /// If there is no pseudo terminal, or the link cannot be created.
    pub fn start(
        device: Box<dyn EmulatedDevice>,
        link: Option<&Path>,
        faults: Vec<Fault>,
        seed: u64,
    ) -> Result<Self, EmulatorError> {
        let terminal = PseudoTerminal::open(link)?;
        let port = link.unwrap_or(terminal.path()).to_owned();
        let is_stopping = Arc::new(AtomicBool::new(false));
        let (stop, link) = (Arc::clone(&is_stopping), link.map(Path::to_owned));
        let emulated = Emulated::new(device, faults, seed);
        let thread = thread::Builder::new()
            .name("sensor_emulator".to_owned())
            .spawn(move || serve(emulated, terminal, link.as_deref(), &stop))
            .map_err(|source| EmulatorError::Thread { source })?;
        Ok(Self { port, is_stopping, thread: Some(thread) })
    }

    /// The path to open: the link, or the device file, which changes if a fault closes the port.
    #[must_use]
    pub fn port(&self) -> &Path {
        &self.port
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        self.is_stopping.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the emulator's thread panicked");
        }
    }
}

fn serve(mut emulated: Emulated, terminal: PseudoTerminal, link: Option<&Path>, is_stopping: &AtomicBool) {
    let started = Instant::now();
    let mut terminal = Some(terminal);
    let mut buffer = [0; 1024];
    while !is_stopping.load(Ordering::Acquire) {
        let is_open = emulated.advance_to(started.elapsed());
        match &mut terminal {
            Some(_) if !is_open => terminal = None,
            Some(open) => {
                let sent = emulated.take(usize::MAX);
                let served = open.send(&sent).and_then(|()| open.receive(&mut buffer, LOOK));
                match served {
                    Ok((bytes, _)) => emulated.send(bytes),
                    Err(error) => {
                        tracing::warn!("the emulator's port broke, opening another: {error}");
                        terminal = None;
                    }
                }
            }
            None if is_open => match PseudoTerminal::open(link) {
                Ok(opened) => terminal = Some(opened),
                Err(error) => {
                    tracing::warn!("the emulator cannot reopen its port, retrying: {error}");
                    thread::sleep(Duration::from_millis(100));
                }
            },
            None => thread::sleep(LOOK),
        }
    }
}

/// The emulated device of a module: behind a pseudo terminal while the module is active, or in memory from
/// the setup on.
#[derive(Default)]
pub(crate) struct Served {
    ports: EmulatedPorts,
    link: String,
    seed: u64,
    faults: Vec<Fault>,
    in_memory: Option<Offered>,
    emulator: Option<Emulator>,
}

impl Served {
    pub(crate) fn new(ports: EmulatedPorts) -> Self {
        Self { ports, ..Self::default() }
    }

    /// Declares the settings `link`, `seed` and `faults`; the default of the first is a port in memory. One
    /// in memory is offered at once, with the device that `make` returns.
    pub(crate) fn declare<M: Module>(
        &mut self,
        setup: &mut Setup<'_, M>,
        link: &str,
        make: impl FnOnce(u64) -> Box<dyn EmulatedDevice>,
    ) -> Result<(), SetupError> {
        let about = "path of the port, or memory:NAME; the sensor module's setting \"port\" is the same";
        let link = setup.read_only_setting("link", link.to_owned(), about)?;
        let seed = setup.read_only_setting("seed", 1_i64, "same seed, same noise and faults")?;
        let about = "what goes wrong, such as drop:0.01, flip:0.001, close-port@8s..9s";
        let faults = setup.read_only_setting("faults", Vec::<String>::new(), about)?;
        self.link = setup.value(link).cloned().unwrap_or_default();
        // Negative seeds are valid.
        self.seed = setup.value(seed).copied().unwrap_or_default().cast_unsigned();
        self.faults = parsed(setup, faults)?;
        if EmulatedPorts::is_memory(&self.link) {
            let emulated = Emulated::new(make(self.seed), self.faults.clone(), self.seed);
            let offered = self.ports.offer(&self.link, emulated);
            self.in_memory = Some(offered.map_err(|error| setup.refuse_value(link, error.to_string()))?);
        }
        Ok(())
    }

    /// Opens the pseudo terminal, if that is the port.
    pub(crate) fn open(
        &mut self,
        make: impl FnOnce(u64) -> Box<dyn EmulatedDevice>,
    ) -> Result<(), EmulatorError> {
        if self.in_memory.is_none() {
            let link = Some(Path::new(&self.link)).filter(|link| !link.as_os_str().is_empty());
            self.emulator = Some(Emulator::start(make(self.seed), link, self.faults.clone(), self.seed)?);
        }
        Ok(())
    }

    /// Closes the pseudo terminal. A port in memory stays: it is no more than the robot itself.
    pub(crate) fn close(&mut self) {
        self.emulator = None;
    }
}

fn parsed<M: Module>(setup: &Setup<'_, M>, faults: Setting<Vec<String>>) -> Result<Vec<Fault>, SetupError> {
    let texts = setup.value(faults).map_or(&[][..], Vec::as_slice);
    let parsed: Result<Vec<Fault>, _> =
        texts.iter().map(|text| text.parse::<Fault>()?.check(|_| false)).collect();
    parsed.map_err(|error| setup.refuse_value(faults, error.to_string()))
}
