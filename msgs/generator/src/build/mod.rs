//! The builder with which a build script generates Rust types from interface files.

mod environment;
mod error;
mod packages;

use std::fs;
use std::path::PathBuf;

pub use error::BuildError;

use crate::{Modules, RustSource};
use environment::Environment;

/// The file in `OUT_DIR` that `downbeat_msgs::include_interfaces!()` includes.
const FILE: &str = "downbeat_msgs.rs";

/// Generates Rust types from the interface files of one package: short for
/// [`Build::new().package(folder).compile()`](Build).
///
/// ```no_run
/// // build.rs, in `fn main()`
/// downbeat_msgs_generator::compile("my_msgs");
/// ```
pub fn compile(folder: impl Into<PathBuf>) {
    Build::new().package(folder).compile();
}

/// Generates Rust types from the interface files of packages, in the `build.rs` of a crate that depends on
/// `downbeat-msgs`.
///
/// ```no_run
/// // build.rs, in `fn main()`
/// downbeat_msgs_generator::Build::new()
///     .package("my_msgs")        // my_msgs/msg/*.msg, my_msgs/srv/*.srv, my_msgs/action/*.action
///     .packages("vendor")        // every package below vendor/
///     .installed("nav2_msgs")    // from an ament prefix path
///     .compile();
/// ```
///
/// The line `downbeat_msgs::include_interfaces!();` in the crate then declares the modules of these packages
/// and `INTERFACES`, the set of all interfaces in them, which a program registers. It may be in any module of
/// the crate.
///
/// References are resolved in this order: the packages named here; those in `downbeat-msgs`, if their
/// features are enabled, so that `std_msgs/Header` is always `downbeat_msgs::std_msgs::msg::Header`; those in
/// the environment variable `AMENT_PREFIX_PATH`, whose types are also generated.
///
/// Paths are relative to the folder of the crate's `Cargo.toml`. Cargo runs the script again when one of
/// these files changes, appears or disappears.
#[derive(Clone, Debug, Default)]
#[must_use = "nothing is generated before `compile`"]
pub struct Build {
    requests: Vec<Request>,
    runtime: Option<String>,
}

/// A package or folder to generate.
#[derive(Clone, Debug)]
enum Request {
    /// One package, by its folder.
    Folder(PathBuf),
    /// Every package below this folder.
    Below(PathBuf),
    /// One package of an ament prefix, by its name.
    Installed(String),
    /// One package of which `downbeat-msgs` has another version, by its folder.
    OtherVersion(PathBuf),
}

impl Build {
    /// A builder without packages.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a package: a folder with the package's name that contains some of the folders `msg`, `srv` and
    /// `action`.
    pub fn package(mut self, folder: impl Into<PathBuf>) -> Self {
        self.requests.push(Request::Folder(folder.into()));
        self
    }

    /// Adds a package of which `downbeat-msgs` carries another version: as [`package`](Self::package). Its
    /// folder has all of its own types that those refer to. A program registers them beside the carried ones
    /// (`Interfaces::with_other_version`), and a module uses them by their Rust types.
    pub fn other_version(mut self, folder: impl Into<PathBuf>) -> Self {
        self.requests.push(Request::OtherVersion(folder.into()));
        self
    }

    /// Adds every package below a folder: each folder in it that contains interfaces.
    pub fn packages(mut self, folder: impl Into<PathBuf>) -> Self {
        self.requests.push(Request::Below(folder.into()));
        self
    }

    /// Adds a package that is installed below one of the folders of `AMENT_PREFIX_PATH`.
    pub fn installed(mut self, package: &str) -> Self {
        self.requests.push(Request::Installed(package.into()));
        self
    }

    /// Sets the path of `downbeat-msgs` in the crate, if it is not `::downbeat_msgs`.
    pub fn runtime(mut self, path: &str) -> Self {
        self.runtime = Some(path.into());
        self
    }

    /// Generates the types.
    ///
    /// On failure, the build fails with the [error](BuildError) as its only message, and the process exits.
    pub fn compile(self) {
        if let Err(error) = self.try_compile() {
            // Cargo treats each line as a separate error.
            for line in error.to_string().lines() {
                println!("cargo::error={line}");
            }
            std::process::exit(0); // Cargo fails the build because of the errors above; another status would print more text.
        }
    }

    /// Like [`Build::compile`], for build scripts that handle errors themselves.
    ///
    /// # Errors
    /// Returns an error if a file cannot be read, parsed or written, or a type that is referred to is not
    /// found.
    pub fn try_compile(self) -> Result<(), BuildError> {
        let environment = Environment::of_build_script()?;
        let source = self.source(&environment, &mut |watch| println!("cargo::{watch}"))?;
        let path = environment.out.join(FILE);
        fs::write(&path, source).map_err(|source| BuildError::Write { path, source })
    }

    /// Returns the generated source; calls `watch` with what cargo has to watch.
    fn source(&self, environment: &Environment, watch: &mut dyn FnMut(String)) -> Result<String, BuildError> {
        let found = packages::collect(&self.requests, environment, watch)?;
        found.catalog.check()?;
        let runtime = self.runtime.as_deref().unwrap_or("::downbeat_msgs");
        let modules = Modules::new(runtime, "super::super")
            .with_packages(runtime, found.carried.iter().map(String::as_str));
        let source = RustSource::new(&found.catalog, &modules);
        let mut text = String::new();
        for package in &found.generated {
            if let Some([first, second]) = source.name_clash(package) {
                return Err(BuildError::NameClash { first: first.clone(), second: second.clone() });
            }
            text.push_str(&source.module(package)?);
        }
        let packages: Vec<&str> = found.generated.iter().map(String::as_str).collect();
        Ok(text + &source.interface_set(&packages))
    }
}

#[cfg(test)]
mod tests;
