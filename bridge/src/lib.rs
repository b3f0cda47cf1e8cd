//! The ROS 2 bridge of downbeat: a node of ROS 2 Jazzy that shows chosen topics of an executor over DDS, and
//! takes chosen topics in.
//!
//! From the outside in:
//! - [`expose`] joins the two worlds: topics of a core become topics of a node;
//! - [`ros`] is ROS 2 on top of raw topics: names, nodes, and the graph that tools show;
//! - [`middleware`] is raw topics: a narrow trait, and the engines behind it (DDS by rustdds, and one in
//!   memory);
//! - [`edge`], a separate crate, converts messages of the executor to bytes and back, by the names of their
//!   types.

pub mod clock;
pub mod controller_manager;
pub mod diagnostics;
pub mod expose;
pub mod lifecycle;
pub mod limiter;
pub mod middleware;
pub mod network;
pub mod ros;
pub mod rosout;
pub mod worker;

pub use downbeat_edge as edge;
