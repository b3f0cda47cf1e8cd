//! The robot that runs while its file is edited: a process of its own.

use downbeat_library_host::parent;
use parking_lot::Mutex;
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Lines of its output that are kept.
const MOST_LINES: usize = 2000;

/// Longer lines are cut.
const LONGEST_LINE: u64 = 16 << 10;

/// What `downbeat run` prints before the address of its page.
const PAGE: &str = "open in a browser: ";

/// How long the robot may take to stop before it is killed.
const PATIENCE: Duration = Duration::from_secs(20);

const LOOK: Duration = Duration::from_millis(20);

/// A program that runs robot files, as its command line begins.
#[derive(Clone, Debug)]
pub struct Runner {
    /// The program.
    pub program: PathBuf,
    /// Its first arguments, before `run`.
    pub arguments: Vec<String>,
}

/// A robot in a process of its own, which is stopped when it is dropped.
pub(super) struct RobotProcess {
    child: Child,
    readers: Vec<JoinHandle<()>>,
    output: Arc<Mutex<Output>>,
    bag: Option<PathBuf>,
    ended: Option<ExitStatus>,
}

#[derive(Default)]
struct Output {
    lines: VecDeque<String>,
    /// Lines that were dropped from the front.
    dropped: u64,
    url: Option<String>,
}

impl RobotProcess {
    /// Starts a robot with its page on a free port.
    ///
    /// # Errors
    /// In words for the user.
    pub(super) fn start(runner: &Runner, robot: &Path, bag: Option<PathBuf>) -> Result<Self, String> {
        let mut command = Command::new(&runner.program);
        command.args(&runner.arguments).arg("run").arg(robot).arg("--view=0");
        if let Some(bag) = &bag {
            command.arg("--record").arg(bag);
        }
        // Standard input is kept open: the robot ends with this process, however that ends.
        command.arg("--with-parent").stdin(Stdio::piped());
        // In a group of its own: Ctrl-C is for this process, which stops its robot.
        parent::in_own_group(&mut command).stdout(Stdio::piped()).stderr(Stdio::piped());
        let failed = |error: std::io::Error| format!("cannot start {}: {error}", runner.program.display());
        let mut child = parent::spawn(command).map_err(failed)?;
        let output = Arc::new(Mutex::new(Output::default()));
        let pipes = [
            child.stdout.take().map(|pipe| Box::new(pipe) as Box<dyn Read + Send>),
            child.stderr.take().map(|pipe| Box::new(pipe) as Box<dyn Read + Send>),
        ];
        let mut process = Self { child, readers: Vec::new(), output, bag, ended: None };
        for pipe in pipes.into_iter().flatten() {
            let output = Arc::clone(&process.output);
            let reader = std::thread::Builder::new().name("output".to_owned());
            let reader = reader.spawn(move || read(pipe, &output));
            process.readers.push(reader.map_err(|error| format!("cannot start a thread: {error}"))?);
        }
        Ok(process)
    }

    pub(super) fn is_running(&mut self) -> bool {
        if self.ended.is_none() {
            self.ended = self.child.try_wait().ok().flatten();
        }
        self.ended.is_none()
    }

    /// The lines of its output from number `after` on, and what is known of it.
    pub(super) fn report(&mut self, after: u64) -> Value {
        let is_running = self.is_running();
        let output = self.output.lock();
        let skipped = usize::try_from(after.saturating_sub(output.dropped)).unwrap_or(usize::MAX);
        let lines: Vec<&str> = output.lines.iter().skip(skipped).map(String::as_str).collect();
        json!({
            "is_running": is_running,
            "lines": lines,
            "next": output.dropped + output.lines.len() as u64,
            "url": output.url.as_ref().filter(|_| is_running),
            "bag": self.bag,
            "exit_code": self.ended.map(|status| status.code()),
        })
    }

    /// The address of its page, once it has printed it.
    pub(super) fn url(&self) -> Option<String> {
        self.output.lock().url.clone()
    }

    /// Asks it to stop, as Ctrl-C does, and waits until it has.
    pub(super) fn stop(&mut self) {
        let deadline = Instant::now() + PATIENCE;
        if self.is_running() {
            parent::ask_to_stop(&mut self.child);
        }
        while self.is_running() && Instant::now() < deadline {
            std::thread::sleep(LOOK);
        }
        if self.is_running() {
            let _ = self.child.kill();
            self.ended = self.child.wait().ok();
        }
        for reader in self.readers.drain(..) {
            let _ = reader.join();
        }
    }
}

impl Drop for RobotProcess {
    fn drop(&mut self) {
        self.stop();
    }
}

/// Collects what a pipe brings until it ends.
fn read(pipe: impl Read, output: &Mutex<Output>) {
    let mut pipe = BufReader::new(pipe);
    let mut bytes = Vec::new();
    loop {
        bytes.clear();
        match (&mut pipe).take(LONGEST_LINE).read_until(b'\n', &mut bytes) {
            Ok(0) | Err(_) => return,
            Ok(_) => {}
        }
        let line = plain(&String::from_utf8_lossy(&bytes));
        let mut output = output.lock();
        if output.url.is_none() {
            output.url = line.split_once(PAGE).map(|(_, url)| url.trim().to_owned());
        }
        // The token of the page is no part of a log.
        output.lines.push_back(match line.split_once("#token=") {
            Some((before, _)) => before.to_owned(),
            None => line,
        });
        if output.lines.len() > MOST_LINES {
            output.lines.pop_front();
            output.dropped += 1;
        }
    }
}

/// A line without its end and without the colours of a terminal.
fn plain(line: &str) -> String {
    let mut text = String::with_capacity(line.len());
    let mut characters = line.trim_end().chars();
    while let Some(character) = characters.next() {
        match character {
            '\u{1b}' => {
                // As far as the letter that ends the sequence.
                let _ = characters.by_ref().find(char::is_ascii_alphabetic);
            }
            '\t' => text.push(' '),
            character if character.is_control() => {}
            character => text.push(character),
        }
    }
    text
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    fn program(folder: &Path, script: &str) -> Runner {
        let program = folder.join("robot");
        std::fs::write(&program, format!("#!/bin/sh\n{script}\n")).unwrap();
        std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
        Runner { program, arguments: Vec::new() }
    }

    fn wait(mut condition: impl FnMut() -> bool) {
        let deadline = Instant::now() + Duration::from_secs(30);
        while !condition() {
            assert!(Instant::now() < deadline, "gave up waiting");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    #[test]
    fn the_output_has_the_address_without_its_token() {
        let folder = tempfile::tempdir().unwrap();
        let runner = program(
            folder.path(),
            "trap 'echo bye; exit 0' INT; echo \"$@\"; echo 'the page is http://127.0.0.1:7/'; echo 'open in a browser: http://127.0.0.1:7/#token=abc' >&2; while :; do sleep 0.05; done",
        );
        let mut robot = RobotProcess::start(&runner, Path::new("r.toml"), Some("bag".into())).unwrap();
        wait(|| robot.url().is_some());
        assert_eq!(robot.url().unwrap(), "http://127.0.0.1:7/#token=abc");
        wait(|| robot.report(0)["next"] == 3);
        let report = robot.report(0);
        assert_eq!(report["is_running"], true);
        let text = report["lines"].to_string();
        assert!(text.contains("run r.toml --view=0 --record bag") && !text.contains("abc"), "{text}");
        robot.stop();
        let report = robot.report(3);
        assert_eq!((&report["is_running"], &report["exit_code"]), (&json!(false), &json!(0)));
        assert_eq!(report["lines"], json!(["bye"]));
    }

    #[test]
    fn a_program_that_is_missing_is_reported() {
        let runner = Runner { program: "/nowhere/robot".into(), arguments: Vec::new() };
        let error = RobotProcess::start(&runner, Path::new("r.toml"), None).err().unwrap();
        assert!(error.contains("/nowhere/robot"), "{error}");
    }

    #[test]
    fn lines_have_no_colours() {
        assert_eq!(plain("\u{1b}[32m INFO\u{1b}[0m a\tb\r\n"), " INFO a b");
    }
}
