//! A program that reads lines, and somebody who types them and waits for what it says.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{self, Receiver};

use super::{WATCHDOG, downbeat};

/// A running program, which is killed when dropped.
pub struct Typed {
    pub child: Child,
    input: ChildStdin,
    output: Receiver<String>,
    seen: String,
}

impl Typed {
    pub fn start(arguments: &[&str]) -> Self {
        Self::start_by(&mut downbeat(arguments))
    }

    pub fn start_by(command: &mut Command) -> Self {
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::inherit());
        let mut child = command.spawn().unwrap();
        let (input, output) = (child.stdin.take().unwrap(), child.stdout.take().unwrap());
        let (sender, lines) = mpsc::channel();
        std::thread::spawn(move || {
            BufReader::new(output).lines().map_while(Result::ok).try_for_each(|line| sender.send(line))
        });
        Self { child, input, output: lines, seen: String::new() }
    }

    pub fn types(&mut self, line: &str) {
        writeln!(self.input, "{line}").unwrap();
    }

    /// Waits for a line of output with this text.
    pub fn says(&mut self, text: &str) {
        loop {
            let line = self.output.recv_timeout(WATCHDOG);
            let line = line.unwrap_or_else(|_| panic!("no {text:?} after\n{}", self.seen));
            self.seen.push_str(&line);
            self.seen.push('\n');
            if line.contains(text) {
                return;
            }
        }
    }
}

impl Drop for Typed {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
