//! The edge of the executor: where messages, requests and responses become bytes, and bytes become values
//! again.
//!
//! Inside the executor messages are Rust values of types known at compile time. At its edge, a bridge,
//! recorder or player knows topics and types by names read from a file. A [`KnownType`] joins the two: it is
//! found in [`Interfaces`] by the name of the ROS 2 type or by the Rust type of a topic, and opens
//! - an outlet that hands out serialized messages ([`KnownType::outlet`]),
//! - an inlet that takes serialized messages ([`KnownType::inlet`]).
//!
//! A [`KnownService`] does the same for services: it calls those of modules with serialized requests, and
//! lets modules call servers outside the core; [`Refusals`] makes a response of a refusal. A [`KnownAction`]
//! names the services and topics of an action. [`parameter_value`] converts the value of a setting.
//!
//! In [`foreign`], modules in other languages join a core: their ports are known by names, their messages are
//! bytes.
//!
//! Nothing here knows DDS, nodes or files.

mod action;
mod core_access;
pub mod foreign;
mod interfaces;
mod learned;
mod message;
mod parameter;
mod refusal;
mod service;

pub use action::KnownAction;
pub use core_access::CoreAccess;
pub use interfaces::{Described, InterfaceConflict, Interfaces, UnknownType};
pub use learned::LearnError;
pub use message::{
    EncodedInlet, EncodedInletError, KnownType, Offered, RawError, RawMessage, RawTypeError, Sink, Waiting,
};
pub use parameter::{parameter_type, parameter_value, setting_value};
pub use refusal::Refusals;
pub use service::{
    EncodedAnswer, EncodedCallError, EncodedCaller, EncodedStandIn, EventContent, EventError, KnownService,
    RemoteCall, RemoteService, RemoteServices,
};
