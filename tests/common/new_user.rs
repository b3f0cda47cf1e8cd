//! A new user: an empty home directory, nothing of ROS in the environment, and what she types with the
//! seconds that it takes.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use test_machine::free_domain;

/// Where the steps of all pages are collected. `cargo xtask test` prints them as one list.
const STEPS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/target/first_hour/steps");

/// Variables that would let a program find what a new user does not have: ROS 2, settings of this program,
/// the cargo that runs the test.
const FOREIGN: [&str; 10] = [
    "AMENT_",
    "CARGO_MANIFEST_",
    "CARGO_PKG_",
    "CMAKE_PREFIX_PATH",
    "COLCON_",
    "DOWNBEAT_",
    "LD_LIBRARY_PATH",
    "PYTHON",
    "RMW_",
    "ROS_",
];

/// What a user types, for a page or a project.
pub struct NewUser {
    home: PathBuf,
    name: &'static str,
    domain: u16,
    steps: Vec<Step>,
}

/// A command.
struct Step {
    place: String,
    command: String,
    seconds: f64,
    /// The packages that cargo compiled for it.
    compiled: Vec<String>,
}

impl NewUser {
    /// A user whose home is this folder, which is emptied. `name` is that of her list of steps.
    #[must_use]
    pub fn new(name: &'static str, home: &Path) -> Self {
        if home.exists() {
            std::fs::remove_dir_all(home).unwrap();
        }
        std::fs::create_dir_all(home).unwrap();
        Self { home: home.to_owned(), name, domain: free_domain(), steps: Vec::new() }
    }

    /// Gives a command the environment of this user, on the network of this machine alone and in a domain of
    /// this user. The programs of the tests come before others.
    pub fn settle(&self, command: &mut Command) {
        for (variable, _) in std::env::vars_os() {
            let name = variable.to_string_lossy();
            if FOREIGN.iter().any(|foreign| name.starts_with(foreign)) || name == "CARGO" {
                command.env_remove(&variable);
            }
        }
        // Cargo and its crates are installed already; nothing is downloaded.
        let own_home = PathBuf::from(std::env::var_os("HOME").unwrap_or_default());
        for (variable, folder) in [("CARGO_HOME", ".cargo"), ("RUSTUP_HOME", ".rustup")] {
            let installed = std::env::var_os(variable).map_or_else(|| own_home.join(folder), PathBuf::from);
            command.env(variable, installed);
        }
        command.env("CARGO_NET_OFFLINE", "true").env("CARGO_TERM_COLOR", "never");
        command.env("HOME", &self.home);
        for (variable, folder) in [
            ("XDG_CACHE_HOME", ".cache"),
            ("XDG_CONFIG_HOME", ".config"),
            ("XDG_DATA_HOME", ".local/share"),
            ("XDG_STATE_HOME", ".local/state"),
        ] {
            command.env(variable, self.home.join(folder));
        }
        // It exists in every session.
        command.env("XDG_RUNTIME_DIR", &self.home);
        let programs = Path::new(env!("CARGO_BIN_EXE_downbeat")).parent().unwrap();
        command.env("PATH", format!("{}:{}", programs.display(), std::env::var("PATH").unwrap()));
        command
            .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            .env("ROS_DOMAIN_ID", self.domain.to_string());
    }

    /// Keeps a step for the list.
    pub fn has_done(&mut self, place: &str, command: &str, seconds: f64, compiled: Vec<String>) {
        let (place, command) = (place.to_owned(), command.to_owned());
        self.steps.push(Step { place, command, seconds, compiled });
    }

    fn list(&self) -> String {
        let mut list = String::new();
        for Step { place, command, seconds, compiled } in &self.steps {
            let compiled = match compiled.len() {
                0 => String::new(),
                1..4 => format!("   [compiles {}]", compiled.join(", ")),
                many => format!("   [compiles {many} packages]"),
            };
            writeln!(list, "{seconds:>7.1} s  {place}: {command}{compiled}").unwrap();
        }
        list
    }
}

impl Drop for NewUser {
    fn drop(&mut self) {
        let list = self.list();
        println!("{list}");
        // What was done before a failure is of interest too.
        let _ = std::fs::create_dir_all(STEPS);
        let _ = std::fs::write(Path::new(STEPS).join(self.name).with_extension("txt"), list);
    }
}
