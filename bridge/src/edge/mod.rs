//! The edge of the executor: where messages become bytes, and bytes messages.
//!
//! Inside the executor messages are Rust values of types known when it was compiled. At its edge, a bridge, recorder or
//! player knows topics and types by names read from a file. A [`KnownType`] joins the two: it is found in [`Interfaces`] by the
//! name of the ROS 2 type or by the Rust type of a topic, and opens
//! - an outlet that hands out serialized messages ([`KnownType::outlet`]),
//! - an inlet that takes serialized messages ([`KnownType::inlet`]).
//!
//! A [`KnownService`] does the same for services: it calls those of modules with serialized requests, and lets modules call
//! what is outside. A [`KnownAction`] names the services and topics of an action.
//!
//! Nothing here knows DDS.

mod call;
mod core_access;
mod event;
mod inlet;
mod interfaces;
mod known_action;
mod known_service;
mod known_type;
mod outlet;
mod raw;

pub use call::{Callees, EncodedAnswer, EncodedCallError, EncodedCaller, EncodedStandIn, Outlet, RemoteCall};
pub use core_access::CoreAccess;
pub use event::{EncodeEvent, EventContent, encode_event};
pub use inlet::{EncodedInlet, EncodedInletError, Waiting};
pub use interfaces::{InterfaceConflict, Interfaces};
pub use known_action::{KnownAction, UnknownAction};
pub use known_service::{KnownService, UnknownService};
pub use known_type::{KnownType, UnknownType};
pub use outlet::{Offered, Sink};
pub use raw::{RawError, RawMessage, RawTypeError};
