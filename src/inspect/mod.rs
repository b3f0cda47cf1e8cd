//! Looking at a running robot from another process, through a local socket.
//!
//! A robot that runs opens a Unix socket in a directory that only its user can enter: see [`InspectionServer`]. Each
//! line that comes is a [`Request`] in JSON, each line that goes is an answer, `{"ok": …}` or `{"error": "…"}`.
//! `downbeat top`, `downbeat trace` and `downbeat expose` are clients; so is this:
//!
//! ```text
//! $ echo '{"request":"snapshot"}' | nc -U $XDG_RUNTIME_DIR/downbeat/darwin_op-1234.sock
//! ```
//!
//! ```
//! use std::sync::Arc;
//! use downbeat::executor::{CycleTrace, Graph, Snapshot};
//! use downbeat::inspect::{Client, Inspected, InspectionServer, SocketDirectory, Unavailable};
//!
//! struct Robot;
//!
//! impl Inspected for Robot {
//!     fn snapshot(&self) -> Result<Snapshot, Unavailable> {
//!         Ok(Snapshot { cycle: 42, ..Snapshot::default() })
//!     }
//!     # fn trace(&self, _: u32) -> Result<CycleTrace, Unavailable> { Err(Unavailable::NoAnswer) }
//!     # fn graph(&self) -> Result<Graph, Unavailable> { Err(Unavailable::NoAnswer) }
//!     # fn pause(&self) {}
//!     # fn resume(&self) {}
//!     # fn step(&self) {}
//!     // and so on
//! }
//!
//! # let folder = tempfile::tempdir()?;
//! # let directory = SocketDirectory::open_at(folder.path().join("downbeat"))?;
//! // `SocketDirectory::open()?` is where the program looks.
//! let _server = InspectionServer::start(&directory, "darwin_op", Arc::new(Robot))?;
//! let robots = directory.running()?;
//! assert_eq!(Client::connect(&robots[0])?.snapshot()?.cycle, 42);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod client;
mod directory;
mod inspected;
mod protocol;
mod server;

pub use client::{Client, ClientError};
pub use directory::{ClaimError, DirectoryError, NodeClaim, RunningRobot, SocketDirectory};
pub use inspected::{Inspected, Unavailable};
pub use protocol::Request;
pub use server::{InspectionServer, ServerError};
