//! Runs the program on pipes or on a terminal, and stops it in several ways.

use std::fs::{File, OpenOptions};
use std::io::Read;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use downbeat::bags::Reader;
use rustix::fs::{OFlags, fcntl_setfl};
use rustix::process::{Pid, Signal, kill_process};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Winsize, tcsetwinsize};

use super::{WATCHDOG, downbeat, recorded_messages, text_of};

/// A way to stop a command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Way {
    Signal(Signal),
    /// SIGINT twice, with this interval.
    Twice(Duration),
    /// The controlling terminal is closed.
    Terminal,
}

/// A command with its output, on pipes or on a terminal.
pub struct Program {
    pub child: Child,
    /// The other end of its terminal; `None` on pipes.
    pub terminal: Option<File>,
    pub output: Arc<Mutex<String>>,
}

impl Program {
    pub fn start(mut command: Command) -> Self {
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let output = Arc::default();
        collect(child.stdout.take().unwrap(), &output);
        collect(child.stderr.take().unwrap(), &output);
        Self { child, terminal: None, output }
    }

    /// Starts a command as the leader of a session, on a terminal of unknown size.
    pub fn start_on_terminal(command: &Command) -> Self {
        Self::start_on_terminal_of(command, (0, 0))
    }

    /// Starts a command on a terminal with this number of columns and rows.
    pub fn start_on_terminal_of(command: &Command, (columns, rows): (u16, u16)) -> Self {
        let terminal = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        fcntl_setfl(&terminal, OFlags::NONBLOCK).unwrap();
        grantpt(&terminal).unwrap();
        unlockpt(&terminal).unwrap();
        let size = Winsize { ws_row: rows, ws_col: columns, ws_xpixel: 0, ws_ypixel: 0 };
        tcsetwinsize(&terminal, size).unwrap();
        let name = ptsname(&terminal, Vec::new()).unwrap().into_string().unwrap();
        let open = || {
            let flags = OFlags::NOCTTY.bits().cast_signed();
            let options = &mut OpenOptions::new();
            Stdio::from(options.read(true).write(true).custom_flags(flags).open(&name).unwrap())
        };
        let mut leader = Command::new("setsid");
        leader.arg("--ctty").arg(command.get_program()).args(command.get_args());
        leader.current_dir(command.get_current_dir().unwrap());
        for (name, value) in command.get_envs() {
            match value {
                Some(value) => leader.env(name, value),
                None => leader.env_remove(name),
            };
        }
        let child = leader.stdin(open()).stdout(open()).stderr(open()).spawn().unwrap();
        Self { child, terminal: Some(terminal.into()), output: Arc::default() }
    }

    pub fn pid(&self) -> Pid {
        Pid::from_child(&self.child)
    }

    pub fn output(&self) -> String {
        let mut output = self.output.lock().unwrap();
        let mut bytes = [0; 4096];
        while let Some(mut terminal) = self.terminal.as_ref()
            && let Ok(count @ 1..) = terminal.read(&mut bytes)
        {
            output.push_str(&String::from_utf8_lossy(&bytes[..count]));
        }
        output.clone()
    }

    pub fn wait_for_output(&self, text: &str) {
        let start = Instant::now();
        while !self.output().contains(text) {
            assert!(start.elapsed() < WATCHDOG, "{text:?} is not printed, but\n{}", self.output());
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    pub fn signal(&self, signal: Signal) {
        // Fails if the process has already ended.
        let _ = kill_process(self.pid(), signal);
    }

    pub fn ask(&mut self, way: Way) {
        match way {
            Way::Signal(signal) => self.signal(signal),
            Way::Twice(apart) => {
                self.signal(Signal::INT);
                std::thread::sleep(apart);
                self.signal(Signal::INT);
            }
            Way::Terminal => drop(self.terminal.take().unwrap()),
        }
    }

    pub fn wait(&mut self) -> ExitStatus {
        let mut status = None;
        let start = Instant::now();
        while status.is_none() {
            assert!(start.elapsed() < WATCHDOG, "the program does not end:\n{}", self.output());
            std::thread::sleep(Duration::from_millis(2));
            status = self.child.try_wait().unwrap();
        }
        status.unwrap()
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

pub fn collect(mut stream: impl Read + Send + 'static, output: &Arc<Mutex<String>>) {
    let output = Arc::clone(output);
    std::thread::spawn(move || {
        let mut bytes = [0; 4096];
        while let Ok(count @ 1..) = stream.read(&mut bytes) {
            output.lock().unwrap().push_str(&String::from_utf8_lossy(&bytes[..count]));
        }
    });
}

pub fn assert_is_whole(bag: &Path, topic: &str, context: &str) {
    assert!(recorded_messages(bag, topic) > 0, "{context}");
    let reader = Reader::open(bag).unwrap();
    assert!(bag.join("metadata.yaml").exists() && reader.truncation().next().is_none(), "{context}");
    let checked = text_of(&["bag", "check", bag.to_str().unwrap()]);
    assert!(checked.contains("0 problems"), "{context}: {checked}");
}

pub fn command(arguments: &[&str], domain: u16, folder: &Path) -> Command {
    let mut command = downbeat(arguments);
    command.env("ROS_DOMAIN_ID", domain.to_string()).env("XDG_RUNTIME_DIR", folder);
    command
}
