//! Errors of generating Rust types in a build script.

use std::path::PathBuf;

use downbeat_msgs_definitions::{Place, TypeName};

use crate::Error;

/// Why no types were generated. `Debug` also prints the message, so that `main` can return it.
#[derive(thiserror::Error)]
#[non_exhaustive]
pub enum BuildError {
    /// A definition is invalid, or a type it refers to is not found.
    #[error(transparent)]
    Definition(#[from] Error),
    /// A field refers to a built-in package that is not enabled.
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
    /// A generated package is already provided by `downbeat-msgs`.
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
    /// Two types would have the same name in Rust.
    #[error(
        "{second} and {first} would have the same name in Rust, where underscores are left out: rename one of them"
    )]
    NameClash {
        /// The first type.
        first: TypeName,
        /// The second type.
        second: TypeName,
    },
    /// A folder has no interfaces.
    #[error(
        "{}: there is no interface here: the folder of a package holds `msg/*.msg`, `srv/*.srv` or `action/*.action`",
        folder.display()
    )]
    NoInterfaces {
        /// The folder.
        folder: PathBuf,
    },
    /// No prefix contains the package.
    #[error(
        "no package `{package}` with interfaces is installed: {}",
        if searched.is_empty() { "AMENT_PREFIX_PATH is not set, source the setup file of ROS 2 first".into() }
        else {
            format!(
                "searched `share` below {}; source the setup file of the workspace that has it, or, if colcon builds \
                 that package and this one, name it in a <depend> of package.xml",
                list(searched)
            )
        }
    )]
    NotInstalled {
        /// The package.
        package: String,
        /// The folders of `AMENT_PREFIX_PATH`.
        searched: Vec<PathBuf>,
    },
    /// The process is not a build script.
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
