//! Modules in other languages: their ports are known by names at run time, and what they exchange is CDR.
//!
//! A [`Foreign`] declares topics, services, settings and timers as data ([`Declarations`]) and takes each
//! [`Event`]; a [`ForeignModule`] joins it to a core, where it is a module like any other. The bindings for
//! Python and for libraries with a C interface implement [`Foreign`].
//!
//! Services are those of [`Interfaces`](crate::Interfaces); a topic may carry any message whose definition is
//! known.

mod declarations;
mod join;
mod module;
mod versions;

pub use declarations::{Declarations, SettingDeclaration};
pub(crate) use module::{CallEncoded as CallEncodedIn, ReplyEncoded};
pub use module::{Event, Foreign, ForeignContext, ForeignError, ForeignModule, MakeForeign, SavedState};
pub use versions::{Life, Made, Prepared, Versions, prepare};
