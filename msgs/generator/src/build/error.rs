//! Why a build script could not turn interface files into Rust types.

use std::path::PathBuf;

use downbeat_msgs_definitions::{Place, TypeName};

use crate::Error;

/// Why no types were generated. Its `Debug` form is the text too, so that `main` can return it.
#[derive(thiserror::Error)]
#[non_exhaustive]
pub enum BuildError {
    /// A definition is not understood, or what it refers to is not found.
    #[error(transparent)]
    Definition(#[from] Error),
    /// A field refers to a package that is carried, but not enabled.
    #[error(
        "{place}: field `{field}` of {owner} has the type {wanted}: enable the feature `{}` of downbeat-msgs in \
         Cargo.toml", wanted.package
    )]
    Feature {
        /// Where the field is declared.
        place: Box<Place>,
        /// The message with the field.
        owner: Box<TypeName>,
        /// The field.
        field: String,
        /// Its type.
        wanted: Box<TypeName>,
    },
    /// A package is generated that the crate has already from `downbeat-msgs`.
    #[error(
        "{}: downbeat-msgs is built with a package `{package}` of its own: use `downbeat_msgs::{package}`, or give \
         this one another name", folder.display()
    )]
    Carried {
        /// The folder of the package.
        folder: PathBuf,
        /// The package.
        package: String,
    },
    /// Two types would have one name in Rust.
    #[error(
        "{second} and {first} would have the same name in Rust, where underscores are left out: rename one of them"
    )]
    NameClash {
        /// The one.
        first: TypeName,
        /// The other.
        second: TypeName,
    },
    /// A folder that was named has no interfaces.
    #[error(
        "{}: there is no interface here: the folder of a package holds `msg/*.msg`, `srv/*.srv` or `action/*.action`",
        folder.display()
    )]
    NoInterfaces {
        /// The folder.
        folder: PathBuf,
    },
    /// No prefix has the package.
    #[error(
        "no package `{package}` with interfaces is installed: {}",
        if searched.is_empty() { "AMENT_PREFIX_PATH is not set, source the setup file of ROS 2 first".into() }
        else { format!("looked for it in `share` below {}", list(searched)) }
    )]
    NotInstalled {
        /// The package.
        package: String,
        /// The folders of `AMENT_PREFIX_PATH`.
        searched: Vec<PathBuf>,
    },
    /// The process is no build script.
    #[error("OUT_DIR is not set: types are generated from a build script, which cargo runs")]
    NoBuildScript,
    /// The crate does not depend on `downbeat-msgs`.
    #[error(
        "the generated types need the crate downbeat-msgs, on which this one does not depend: add it to \
         [dependencies] in Cargo.toml (downbeat-msgs-generator belongs to [build-dependencies])"
    )]
    NoDependency,
    /// The generated file could not be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

impl std::fmt::Debug for BuildError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{self}")
    }
}

fn list(paths: &[PathBuf]) -> String {
    paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ")
}
