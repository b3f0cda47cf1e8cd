//! The Python environment with the ROS 2 wheels.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A Python interpreter and the ROS 2 packages of its environment.
pub struct Peer {
    python: PathBuf,
}

/// A file of a package.
pub struct File {
    pub package: String,
    pub path: PathBuf,
    pub text: String,
}

impl Peer {
    /// The interpreter named by `DOWNBEAT_PYTHON`; prints a note if it is not set.
    pub fn find() -> Option<Self> {
        match std::env::var_os("DOWNBEAT_PYTHON") {
            Some(python) => Some(Self { python: python.into() }),
            None => {
                // Bypasses the capture of test output, which hides the output of passing tests.
                let line = "skipped: DOWNBEAT_PYTHON is not set (cargo xtask test sets it)\n";
                let _ = std::io::Write::write_all(&mut std::io::stderr(), line.as_bytes());
                None
            }
        }
    }

    /// The prefix of the environment, laid out as an ament prefix.
    pub fn prefix(&self) -> PathBuf {
        // <environment>/bin/python
        self.python.parent().and_then(Path::parent).unwrap().to_owned()
    }

    /// Runs a command of `peer.py` with `input` in a file; returns its output.
    pub fn ask(&self, command: &str, input: &str) -> String {
        // Tests run in parallel.
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let unique = format!("{}_{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("wheels_{command}_{unique}.txt"));
        std::fs::write(&file, input).unwrap();
        let output = Command::new(&self.python)
            .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/wheels/peer.py"))
            .arg(command)
            .arg(&file)
            .output()
            .unwrap_or_else(|error| panic!("cannot run {}: {error}", self.python.display()));
        std::fs::remove_file(&file).unwrap();
        assert!(output.status.success(), "peer.py {command}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }

    /// The interface files with that extension, of all packages.
    pub fn files(&self, extension: &str) -> Vec<File> {
        let name = |path: &Path| path.file_name().unwrap().to_string_lossy().into_owned();
        let mut files = Vec::new();
        for package in entries(&self.prefix().join("share")) {
            for folder in ["msg", "srv", "action"].map(|folder| package.join(folder)) {
                for file in entries(&folder)
                    .into_iter()
                    .filter(|file| file.extension().is_some_and(|of| of == extension))
                {
                    files.push(File {
                        package: name(&package),
                        path: file.clone(),
                        text: std::fs::read_to_string(&file).unwrap(),
                    });
                }
            }
        }
        files
    }
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut entries: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    entries
}
