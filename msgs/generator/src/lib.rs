//! Writes the Rust types of ROS 2 interfaces: structs with CDR, their definitions and their hashes.
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

mod rust;

pub use downbeat_msgs_definitions::{Catalog, Error, TypeName};
pub use rust::{Modules, RustSource};
