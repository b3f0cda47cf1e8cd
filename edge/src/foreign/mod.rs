//! Modules in other languages: their ports are known by names at run time, and what they exchange is CDR.
//!
//! A [`Foreign`] declares topics, services, settings and timers as data ([`Declarations`]) and takes each
//! [`Event`]; a [`ForeignModule`] joins it to a core, where it is a module like any other. The bindings for
//! Python and for libraries with a C interface implement [`Foreign`].
//!
//! Services are those of [`Interfaces`](crate::Interfaces); a topic may carry any message whose definition is
//! known.

mod contract;
mod declarations;
mod join;
mod module;
mod services;
mod versions;

pub use contract::{Event, Foreign, ForeignContext, ForeignError, MakeForeign, SavedState};
pub use declarations::{Declarations, SettingDeclaration};
pub use module::ForeignModule;
pub use versions::{Life, Made, Prepared, Versions, prepare};
