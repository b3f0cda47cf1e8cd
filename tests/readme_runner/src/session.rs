//! One block of commands in a shell.

use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use test_machine::Domains;

use crate::page::{Block, Step, is_like};

/// Long enough for a busy machine.
const WATCHDOG: Duration = Duration::from_secs(120);

/// Shell code before the commands. It replaces cargo, and lets Ctrl-C reach the program but not the shell.
const PRELUDE: &str = r#"
exec 2>&1
trap : INT
cargo() {
    command=$1 program=$README_PROGRAM
    shift
    case "$command $#" in
        run*) ;;
        "test 0") return 0 ;;
        *) echo "README runner: cargo $command is not known here"; return 2 ;;
    esac
    while [ $# -gt 0 ]; do
        case $1 in
            -q | --quiet | --release) shift ;;
            --bin) program=$2; shift 2 ;;
            --) shift; break ;;
            *) echo "README runner: cargo run $1 is not known here"; return 2 ;;
        esac
    done
    "$README_PROGRAMS/$program" "$@"
}
"#;

/// Runs a block until it ends and checks its output.
pub(crate) fn run(block: &Block, place: &str, folder: &Path, programs: &Path, program: &str) {
    let mut shell = Command::new("sh");
    shell.args(["-eu", "-c", &format!("{PRELUDE}{}", block.commands)]).current_dir(folder);
    shell.env("README_PROGRAMS", programs).env("README_PROGRAM", program);
    let domains = Domains::take(1);
    shell.env("ROS_DOMAIN_ID", domains.first().to_string());
    shell.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST").env_remove("DOWNBEAT_LOG");
    shell.stdin(Stdio::null()).stdout(Stdio::piped()).process_group(0);
    let child = shell.spawn().unwrap_or_else(|error| panic!("{place}: {error}"));
    let mut session = Session::new(child, place);
    for step in &block.steps {
        match step {
            Step::Line(pattern) => session.wait_for(pattern),
            Step::Interrupt => session.signal("-INT"),
        }
    }
    session.finish();
}

struct Session<'a> {
    place: &'a str,
    shell: Child,
    lines: Receiver<String>,
    printed: Vec<String>,
    until: Instant,
    has_ended: bool,
}

impl<'a> Session<'a> {
    fn new(mut shell: Child, place: &'a str) -> Self {
        let (sender, lines) = channel();
        if let Some(output) = shell.stdout.take() {
            let mut read = BufReader::new(output).lines().map_while(Result::ok);
            std::thread::spawn(move || read.try_for_each(|line| sender.send(line)));
        }
        Self { place, shell, lines, printed: Vec::new(), until: Instant::now() + WATCHDOG, has_ended: false }
    }

    /// The next line; `None` at the end of the output.
    fn next(&mut self) -> Option<&str> {
        match self.lines.recv_timeout(self.until.saturating_duration_since(Instant::now())) {
            Ok(line) => self.printed.push(line),
            Err(RecvTimeoutError::Disconnected) => return None,
            Err(RecvTimeoutError::Timeout) => self.fail("the commands do not end"),
        }
        self.printed.last().map(String::as_str)
    }

    fn wait_for(&mut self, pattern: &str) {
        loop {
            match self.next() {
                Some(line) if is_like(line, pattern) => return,
                Some(_) => {}
                None => self.fail(&format!("the following expected line was not printed:\n{pattern}\n")),
            }
        }
    }

    /// Sends a signal to all processes that the block started.
    fn signal(&self, signal: &str) {
        let group = format!("-{}", self.shell.id());
        let sent = Command::new("kill").args([signal, "--", &group]).status();
        assert!(sent.is_ok_and(|status| status.success()), "{}: kill {signal} fails", self.place);
    }

    fn finish(mut self) {
        while self.next().is_some() {}
        let status = self.shell.wait().unwrap_or_else(|error| panic!("{}: {error}", self.place));
        self.has_ended = true;
        if !status.success() {
            self.fail(&format!("the commands end with {status}"));
        }
    }

    fn fail(&self, problem: &str) -> ! {
        panic!("{}: {problem}\nprinted so far:\n{}\n", self.place, self.printed.join("\n"));
    }
}

impl Drop for Session<'_> {
    fn drop(&mut self) {
        if !self.has_ended {
            // Ends processes that a failed test leaves running.
            let group = format!("-{}", self.shell.id());
            let _ = Command::new("kill").args(["-KILL", "--", &group]).status();
            let _ = self.shell.wait();
        }
    }
}
