//! What a build script calls to turn interface files into Rust types.

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

/// Turns the interface files of one package into Rust types: the short form of
/// [`Build::new().package(folder).compile()`](Build).
///
/// ```no_run
/// // build.rs, in `fn main()`
/// downbeat_msgs_generator::compile("my_msgs");
/// ```
pub fn compile(folder: impl Into<PathBuf>) {
    Build::new().package(folder).compile();
}

/// Turns the interface files of packages into Rust types, from the `build.rs` of a crate that depends on `downbeat-msgs`.
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
/// The line `downbeat_msgs::include_interfaces!();` in the crate then stands for the modules of these packages and for
/// `INTERFACES`, the set of all that is in them, which a program registers. Where in the crate it stands makes no difference to
/// them.
///
/// What the definitions refer to is found in this order: the packages named here; those that `downbeat-msgs` carries, if
/// their features are enabled, so that a `std_msgs/Header` is everyone's `downbeat_msgs::std_msgs::msg::Header`; those in
/// the environment variable `AMENT_PREFIX_PATH`, of which types are generated beside the others.
///
/// Paths are relative to the folder of the crate's `Cargo.toml`. Cargo runs the script again when one of these files
/// changes, comes or goes.
#[derive(Clone, Debug, Default)]
#[must_use = "nothing is generated before `compile`"]
pub struct Build {
    requests: Vec<Request>,
    runtime: Option<String>,
}

/// What a build script asked for.
#[derive(Clone, Debug)]
enum Request {
    /// One package, by its folder.
    Folder(PathBuf),
    /// Each folder below this one.
    Below(PathBuf),
    /// One package of an ament prefix, by its name.
    Installed(String),
}

impl Build {
    /// Without any package.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a package: a folder of the package's name, with the folders `msg`, `srv` and `action` in it, or some of them.
    pub fn package(mut self, folder: impl Into<PathBuf>) -> Self {
        self.requests.push(Request::Folder(folder.into()));
        self
    }

    /// Adds every package below a folder: each folder in it that holds interfaces.
    pub fn packages(mut self, folder: impl Into<PathBuf>) -> Self {
        self.requests.push(Request::Below(folder.into()));
        self
    }

    /// Adds a package that is installed below one of the folders of `AMENT_PREFIX_PATH`.
    pub fn installed(mut self, package: &str) -> Self {
        self.requests.push(Request::Installed(package.into()));
        self
    }

    /// The path of `downbeat-msgs` in the crate, where that is not `::downbeat_msgs`.
    pub fn runtime(mut self, path: &str) -> Self {
        self.runtime = Some(path.into());
        self
    }

    /// Generates the types.
    ///
    /// If that fails, the build fails with the [error](BuildError) as its only text, and the process ends here.
    pub fn compile(self) {
        if let Err(error) = self.try_compile() {
            // Each line is an error of its own to cargo.
            for line in error.to_string().lines() {
                println!("cargo::error={line}");
            }
            std::process::exit(0); // Cargo fails the build for the errors above, and would tell of another status at length.
        }
    }

    /// As [`Build::compile`], for a build script that treats errors itself.
    ///
    /// # Errors
    /// If a file cannot be read, parsed or written, or a type that is referred to is not found.
    pub fn try_compile(self) -> Result<(), BuildError> {
        let environment = Environment::of_build_script()?;
        let source = self.source(&environment, &mut |watch| println!("cargo::{watch}"))?;
        let path = environment.out.join(FILE);
        fs::write(&path, source).map_err(|source| BuildError::Write { path, source })
    }

    /// The generated source; `watch` is told what cargo has to watch.
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
