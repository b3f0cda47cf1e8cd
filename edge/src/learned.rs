//! Interfaces of which a program knows the definition only: from folders, from the libraries and modules that
//! carry them, and from ament prefixes.

use downbeat_msgs::definitions::{Error, Kind, TypeName};
use downbeat_msgs::dynamic::{Definitions, InterfaceDefinition, InterfaceFolders, Schemas, TypeLookupError};
use parking_lot::Mutex;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use std::sync::Arc;
use thiserror::Error;

/// A definition cannot be added.
#[derive(Debug, Error)]
pub enum LearnError {
    /// The text is no definition.
    #[error("the definition of {name} that it carries cannot be used: {problem}")]
    Text {
        /// The message, service or action.
        name: String,
        /// What is wrong.
        problem: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The name has another definition.
    #[error(
        "it carries another definition of {name} than this robot knows: {carried}, but {place} has {known}. A name has one \
         definition: build it again with that one, or remove the other"
    )]
    Other {
        /// The message, service or action.
        name: String,
        /// The hash of the refused definition.
        carried: String,
        /// The hash of the known one.
        known: String,
        /// Where it is from.
        place: String,
    },
}

/// What a program learns while it runs. Clones of [`Interfaces`](crate::Interfaces) share it.
#[derive(Default)]
pub(crate) struct Learned(Mutex<State>);

#[derive(Clone, Default)]
struct State {
    folders: Option<Arc<InterfaceFolders>>,
    carried: Option<Arc<Schemas>>,
    /// What was looked up, by the name of the whole interface: the first definition stays.
    used: HashMap<TypeName, Arc<InterfaceDefinition>>,
    /// What these describe, by hash.
    described: BTreeMap<String, (TypeName, Arc<InterfaceDefinition>)>,
}

/// The message, service or action that a name is of or a part of.
pub(crate) fn whole(name: &TypeName) -> TypeName {
    let stem = match name.kind {
        Kind::Message => name.name.as_str(),
        Kind::Service | Kind::Action => name.name.split('_').next().unwrap_or_default(),
    };
    TypeName::new(&name.package, name.kind, stem)
}

impl Clone for Learned {
    fn clone(&self) -> Self {
        Self(Mutex::new(self.0.lock().clone()))
    }
}

impl Learned {
    pub(crate) fn add_folder(&self, folder: &Path) -> Result<(), Error> {
        Arc::make_mut(self.0.lock().folders.get_or_insert_default()).add(folder)
    }

    /// Adds the definition text of a message, service or action.
    pub(crate) fn add_text(&self, name: &str, text: &str) -> Result<(), Error> {
        let mut state = self.0.lock();
        let carried =
            state.carried.get_or_insert_with(|| Arc::new(Schemas::new("what modules and libraries carry")));
        Arc::make_mut(carried).add(name, "ros2msg", text)
    }

    /// Adds these definitions to `definitions`.
    pub(crate) fn sources(&self, mut definitions: Definitions) -> Definitions {
        let state = self.0.lock();
        if let Some(folders) = &state.folders {
            definitions = definitions.with(Arc::clone(folders));
        }
        match &state.carried {
            Some(carried) => definitions.with(Arc::clone(carried)),
            None => definitions,
        }
    }

    /// The definition of the whole that the name is a part of. It is looked up once.
    pub(crate) fn definition(
        &self,
        name: &TypeName,
        definitions: impl FnOnce() -> Definitions,
    ) -> Result<Arc<InterfaceDefinition>, TypeLookupError> {
        let whole = whole(name);
        if let Some(found) = self.0.lock().used.get(&whole) {
            return Ok(Arc::clone(found));
        }
        let found = Arc::new(definitions().find_interface(&whole.to_string())?);
        let mut state = self.0.lock();
        for part in parts(&found) {
            if let Ok((hash, _)) = found.described(&part.to_string()) {
                state.described.insert(hash, (part, Arc::clone(&found)));
            }
        }
        Ok(Arc::clone(state.used.entry(whole).or_insert(found)))
    }

    /// The type with that hash, if it was looked up, and the definition of the whole.
    pub(crate) fn described(&self, hash: &str) -> Option<(TypeName, Arc<InterfaceDefinition>)> {
        self.0.lock().described.get(hash).cloned()
    }
}

/// The names of an interface, its services and its messages.
fn parts(of: &InterfaceDefinition) -> Vec<TypeName> {
    let messages = of.catalog.messages().map(|message| &message.name);
    let services = of.catalog.services().map(|service| &service.name);
    let is_part = |name: &&TypeName| **name != of.name && whole(name) == of.name;
    std::iter::once(&of.name).chain(messages.chain(services).filter(is_part)).cloned().collect()
}
