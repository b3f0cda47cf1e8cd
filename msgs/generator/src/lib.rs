//! Writes the Rust types of ROS 2 interfaces: structs with CDR, their definitions and their hashes.
//!
//! A crate with its own interface files calls [`compile`] in the `main` function of its `build.rs`:
//!
//! ```no_run
//! downbeat_msgs_generator::compile("my_msgs"); // the folder with msg/*.msg, srv/*.srv, action/*.action
//! ```
//!
//! and includes the types, and the set of them to register, with `downbeat_msgs::include_interfaces!();`.
//! [`Build`] compiles several packages, and those of an ament prefix path. It uses [`RustSource`], which
//! generates source from a catalog:
//!
//! ```
//! use downbeat_msgs_generator::{Catalog, Modules, RustSource};
//!
//! let mut catalog = Catalog::new();
//! catalog.add_message("my_msgs/msg/Leg".parse()?, "float64[] angles\n", "my_msgs/msg/Leg.msg")?;
//! catalog.check()?;
//! let modules = Modules::new("::downbeat_msgs", "crate");
//! let source = RustSource::new(&catalog, &modules).package("my_msgs")?;
//! assert!(source.contains("pub struct Leg"));
//! # Ok::<(), downbeat_msgs_generator::Error>(())
//! ```

mod build;
mod rust;

pub use build::{Build, BuildError, compile};
pub use downbeat_msgs_definitions::{Catalog, Error, TypeName};
#[doc(hidden)]
pub use rust::generated;
pub use rust::{Modules, RustSource};
