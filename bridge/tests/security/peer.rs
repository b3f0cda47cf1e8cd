//! Secured participants of other vendors, as `bridge/security/peers` has them.

use crate::PEERS;
use crate::common::WATCHDOG;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Vendor {
    Cyclone,
    Fast,
}

/// A program that executes commands. Its process ends with the value.
pub struct Peer {
    vendor: Vendor,
    child: Child,
    input: Option<ChildStdin>,
    output: Receiver<String>,
    printed: Vec<String>,
    errors: Option<JoinHandle<String>>,
}

impl Peer {
    /// Starts a peer with an enclave of a keystore, or says why not and returns nothing.
    pub fn start(
        vendor: Vendor,
        domain_id: u16,
        keystore: &Path,
        enclave: &str,
        commands: &[&str],
    ) -> Option<Self> {
        let program = program(vendor)?;
        let folder = keystore.join("enclaves").join(enclave.trim_start_matches('/'));
        let mut child = Command::new(program)
            .arg(domain_id.to_string())
            .arg(folder)
            .args(commands.iter().flat_map(|command| command.split(' ')))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines().map_while(Result::ok);
        let (sender, output) = channel();
        std::thread::spawn(move || lines.map(|line| sender.send(line)).all(|sent| sent.is_ok()));
        let mut errors = child.stderr.take().unwrap();
        let errors = std::thread::spawn(move || {
            let mut text = Vec::new();
            let _ = errors.read_to_end(&mut text);
            String::from_utf8_lossy(&text).into_owned()
        });
        let mut peer = Self {
            vendor,
            input: child.stdin.take(),
            child,
            output,
            printed: Vec::new(),
            errors: Some(errors),
        };
        peer.wait_for("ready");
        Some(peer)
    }

    /// Waits until the peer has printed a line.
    pub fn wait_for(&mut self, line: &str) {
        self.wait_until(line, |printed| printed == line);
    }

    /// Waits for a line, and returns it.
    pub fn wait_until(&mut self, what: &str, mut is_it: impl FnMut(&str) -> bool) -> String {
        let mut seen = 0;
        let start = Instant::now();
        loop {
            if let Some(line) = self.printed[seen..].iter().find(|line| is_it(line)) {
                return line.clone();
            }
            seen = self.printed.len();
            match self.output.recv_timeout(WATCHDOG.saturating_sub(start.elapsed())) {
                Ok(line) => self.printed.push(line),
                Err(_) => {
                    let begin = |line: &String| line.chars().take(80).collect::<String>();
                    let printed: Vec<_> = self.printed.iter().map(begin).collect();
                    panic!("{:?} did not print {what:.80}, but {printed:#?}", self.vendor);
                }
            }
        }
    }

    /// What the peer has printed so far.
    pub fn printed(&mut self) -> &[String] {
        self.printed.extend(self.output.try_iter());
        &self.printed
    }

    /// Ends the process as a crash does.
    pub fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Lets the participant leave.
    pub fn leave(mut self) {
        drop(self.input.take());
        let start = Instant::now();
        while self.child.try_wait().unwrap().is_none() {
            assert!(start.elapsed() < WATCHDOG, "{:?} does not end", self.vendor);
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
        if std::thread::panicking() {
            let errors = self.errors.take().map(|thread| thread.join().unwrap_or_default());
            println!("{:?} printed as errors:\n{}", self.vendor, errors.unwrap_or_default());
        }
    }
}

/// The compiled program of a vendor. If the machine lacks what it needs, says so and returns nothing.
fn program(vendor: Vendor) -> Option<PathBuf> {
    let (name, source, compiler, header, package) = match vendor {
        Vendor::Cyclone => ("cyclone", "cyclone/peer.c", "cc", "dds/dds.h", "cyclonedds-dev"),
        Vendor::Fast => (
            "fastdds",
            "fastdds/peer.cpp",
            "g++",
            "fastdds/dds/log/Log.hpp",
            "libfastrtps-dev libfastcdr-dev",
        ),
    };
    if !test_machine::has_compilers(&[compiler]) {
        return None;
    }
    let mut includes = Command::new(compiler);
    includes.args(["-E", "-include", header, "-x", if vendor == Vendor::Fast { "c++" } else { "c" }]);
    let status = includes.args(["/dev/null", "-o", "/dev/null"]).stderr(Stdio::null()).status().unwrap();
    let mut command = Command::new(compiler);
    let source = Path::new(PEERS).join(source);
    let mut is_complete = status.success();
    match vendor {
        Vendor::Cyclone => {
            let output = Command::new(compiler).arg("-print-multiarch").output().unwrap();
            let plugins =
                format!("/usr/lib/{}/libddsc0debian", String::from_utf8(output.stdout).unwrap().trim());
            is_complete &= Path::new(&plugins).join("libdds_security_crypto.so").exists();
            command.args(["-std=gnu11", "-O1", &format!("-DPLUGINS=\"{plugins}\"")]);
            command.arg(&source).arg("-lddsc");
        }
        Vendor::Fast => {
            command.args(["-std=c++17", "-O1"]).arg(&source).args(["-lfastrtps", "-lfastcdr"]);
        }
    }
    if !is_complete {
        let remedy = format!("Debian: the packages {package}");
        test_machine::missing(&format!("a development package of {vendor:?} DDS with security"), &remedy);
        return None;
    }
    Some(compiled(name, &source, command))
}

/// Compiles a program, unless it is there and newer than its source.
fn compiled(name: &str, source: &Path, mut command: Command) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("security-peers");
    std::fs::create_dir_all(&folder).unwrap();
    // Other tests need it at the same time.
    let lock = File::create(folder.join(format!("{name}.lock"))).unwrap();
    lock.lock().unwrap();
    let program = folder.join(name);
    let changed = |path: &Path| path.metadata().and_then(|file| file.modified()).ok();
    if changed(&program) <= changed(source) {
        let made = folder.join(format!("{name}.new"));
        let output = command.arg("-o").arg(&made).output().unwrap();
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "cannot compile {}:\n{errors}", source.display());
        std::fs::rename(made, &program).unwrap();
    }
    program
}
