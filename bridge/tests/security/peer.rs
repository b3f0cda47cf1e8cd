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
    Rustdds,
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
        let program = vendor.program()?;
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

impl Vendor {
    /// The compiled program. If the machine lacks what it needs, says so and returns nothing.
    pub fn program(self) -> Option<PathBuf> {
        match self {
            Self::Cyclone => cyclone(),
            Self::Fast => fast(),
            Self::Rustdds => rustdds(),
        }
    }
}

fn cyclone() -> Option<PathBuf> {
    let compiler = "cc";
    if !test_machine::has_compilers(&[compiler]) {
        return None;
    }
    let output = Command::new(compiler).arg("-print-multiarch").output().unwrap();
    let plugins = format!("/usr/lib/{}/libddsc0debian", String::from_utf8(output.stdout).unwrap().trim());
    let has_plugins = Path::new(&plugins).join("libdds_security_crypto.so").exists();
    if !(has_plugins && has_header(compiler, "c", "dds/dds.h")) {
        test_machine::missing("Cyclone DDS with security", "Debian: the package cyclonedds-dev");
        return None;
    }
    let mut command = Command::new(compiler);
    command.args(["-std=gnu11", "-O1", &format!("-DPLUGINS=\"{plugins}\"")]);
    Some(compiled("cyclone/peer.c", command, &["-lddsc"]))
}

fn fast() -> Option<PathBuf> {
    let compiler = "g++";
    if !test_machine::has_compilers(&[compiler]) {
        return None;
    }
    if !has_header(compiler, "c++", "fastdds/dds/log/Log.hpp") {
        test_machine::missing("Fast DDS", "Debian: the packages libfastcdr-dev and libfastrtps-dev");
        return None;
    }
    let mut command = Command::new(compiler);
    command.args(["-std=c++17", "-O1"]);
    Some(compiled("fastdds/peer.cpp", command, &["-lfastrtps", "-lfastcdr"]))
}

/// It has OpenSSL in C, which programs of this workspace do not.
fn rustdds() -> Option<PathBuf> {
    let status = Command::new("pkg-config").args(["--exists", "openssl"]).status();
    if !status.is_ok_and(|status| status.success()) {
        test_machine::missing("OpenSSL for rustdds", "Debian: the packages libssl-dev and pkg-config");
        return None;
    }
    let target = folder().join("rustdds");
    let mut command = Command::new(env!("CARGO"));
    command.args(["build", "--locked", "--manifest-path"]).arg(Path::new(PEERS).join("rustdds/Cargo.toml"));
    assert!(command.arg("--target-dir").arg(&target).status().unwrap().success());
    Some(target.join("debug/secured-rustdds"))
}

fn has_header(compiler: &str, language: &str, header: &str) -> bool {
    let mut command = Command::new(compiler);
    command.args(["-E", "-include", header, "-x", language, "/dev/null", "-o", "/dev/null"]);
    command.stderr(Stdio::null()).status().unwrap().success()
}

fn folder() -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("security-peers");
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

/// Compiles a program, unless it is there and newer than its source.
fn compiled(source: &str, mut command: Command, libraries: &[&str]) -> PathBuf {
    let source = Path::new(PEERS).join(source);
    let program = folder().join(source.parent().and_then(Path::file_name).unwrap());
    // Other tests need it at the same time.
    let lock = File::create(program.with_extension("lock")).unwrap();
    lock.lock().unwrap();
    let changed = |path: &Path| path.metadata().and_then(|file| file.modified()).ok();
    if changed(&program) <= changed(&source) {
        let made = program.with_extension("new");
        let output = command.arg(&source).args(libraries).arg("-o").arg(&made).output().unwrap();
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "cannot compile {}:\n{errors}", source.display());
        std::fs::rename(made, &program).unwrap();
    }
    program
}
