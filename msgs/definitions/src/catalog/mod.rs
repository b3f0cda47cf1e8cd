//! A set of interfaces that refer to each other.

mod check;
mod files;

pub use files::AmentPrefix;

use std::collections::{BTreeMap, BTreeSet};

use crate::derived::{event_of, parts_of};
use crate::{
    ActionDefinition, Definition, Element, Error, Kind, MessageDefinition, ServiceDefinition, TypeName,
    nearest, parse_action, parse_idl, parse_message, parse_service,
};

/// Definitions by name. Add definitions, [check](Catalog::check) the catalog, then derive descriptions, texts
/// and hashes from it.
#[derive(Clone, Debug, Default)]
pub struct Catalog {
    messages: BTreeMap<TypeName, MessageDefinition>,
    services: BTreeMap<TypeName, ServiceDefinition>,
    actions: BTreeMap<TypeName, ActionDefinition>,
}

impl Catalog {
    /// An empty catalog.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds one message from its text; `origin` names the text in errors. Adding the same definition again
    /// has no effect; comments may differ.
    ///
    /// # Errors
    /// Returns an error if the text is not a message definition, or the name already has a different
    /// definition.
    pub fn add_message(&mut self, name: TypeName, text: &str, origin: &str) -> Result<(), Error> {
        let message = parse_message(name, text, origin)?;
        self.insert(message)
    }

    /// Adds one service, and the request, response and event messages that belong to it.
    ///
    /// # Errors
    /// Returns an error if the text is not a service definition, or the name already has a different
    /// definition.
    pub fn add_service(&mut self, name: TypeName, text: &str, origin: &str) -> Result<(), Error> {
        self.insert_service(parse_service(name, text, origin)?)
    }

    /// Adds one action, and the services and messages that belong to it: `_Goal`, `_Result`, `_Feedback`,
    /// `_FeedbackMessage`, `_SendGoal`, `_GetResult` and the messages of these two.
    ///
    /// # Errors
    /// Returns an error if the text is not an action definition, or the name already has a different
    /// definition.
    pub fn add_action(&mut self, name: TypeName, text: &str, origin: &str) -> Result<(), Error> {
        self.insert_action(parse_action(name, text, origin)?)
    }

    /// Adds the definitions of an `.idl` file, and returns their names. See [`parse_idl`].
    ///
    /// # Errors
    /// Returns an error if the text is not IDL that ROS 2 supports, or a name already has a different
    /// definition.
    pub fn add_idl(&mut self, text: &str, origin: &str) -> Result<Vec<TypeName>, Error> {
        let definitions = parse_idl(text, origin)?;
        let names = definitions.iter().map(|definition| definition.name().clone()).collect();
        definitions.into_iter().try_for_each(|definition| self.insert_definition(definition))?;
        Ok(names)
    }

    /// Adds a message of another catalog, and all types that it refers to. Types that the other catalog lacks
    /// are left out.
    ///
    /// # Errors
    /// Returns an error if a name already has a different definition.
    pub fn add_message_from(&mut self, other: &Self, name: &TypeName) -> Result<(), Error> {
        let mut wanted = vec![name];
        let mut seen = BTreeSet::from([name]);
        while let Some(message) = wanted.pop().and_then(|name| other.messages.get(name)) {
            self.insert(message.clone())?;
            for field in &message.fields {
                if let Element::Message(inner) = &field.field_type.element
                    && other.messages.contains_key(inner)
                    && seen.insert(inner)
                {
                    wanted.push(inner);
                }
            }
        }
        Ok(())
    }

    /// Adds a message, service or action of another catalog, without the types that it refers to.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`]; also if a name already has a different definition.
    pub fn add_alone_from(&mut self, other: &Self, name: &TypeName) -> Result<(), Error> {
        if let Some(action) = other.find_action(name) {
            return self.insert_action(action.clone());
        }
        match other.find_service(name) {
            Some(service) => self.insert_service(service.clone()),
            None => self.insert(other.message(name)?.clone()),
        }
    }

    /// Like [`Catalog::add_message_from`], but definitions that are here already stay, also where they
    /// differ.
    pub fn add_missing_from(&mut self, other: &Self, name: &TypeName) {
        let mut wanted = vec![name];
        let mut seen = BTreeSet::from([name]);
        while let Some(message) = wanted.pop().and_then(|name| other.messages.get(name)) {
            self.messages.entry(message.name.clone()).or_insert_with(|| message.clone());
            for field in &message.fields {
                if let Element::Message(inner) = &field.field_type.element
                    && other.messages.contains_key(inner)
                    && seen.insert(inner)
                {
                    wanted.push(inner);
                }
            }
        }
    }

    /// The types that a message refers to, directly or indirectly, and that have no definition here; the
    /// message itself if it has none.
    #[must_use]
    pub fn missing_for(&self, name: &TypeName) -> BTreeSet<TypeName> {
        let mut missing = BTreeSet::new();
        let mut wanted = vec![name];
        let mut seen = BTreeSet::from([name]);
        while let Some(name) = wanted.pop() {
            let Some(message) = self.messages.get(name) else {
                missing.insert(name.clone());
                continue;
            };
            for field in &message.fields {
                if let Element::Message(inner) = &field.field_type.element
                    && seen.insert(inner)
                {
                    wanted.push(inner);
                }
            }
        }
        missing
    }

    /// The definition of a message, including those of services and actions.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`].
    pub fn message(&self, name: &TypeName) -> Result<&MessageDefinition, Error> {
        self.messages.get(name).ok_or_else(|| self.not_in_catalog(name))
    }

    /// The definition of a service, including those of actions.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`].
    pub fn service(&self, name: &TypeName) -> Result<&ServiceDefinition, Error> {
        self.services.get(name).ok_or_else(|| self.not_in_catalog(name))
    }

    /// The definition of an action.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`].
    pub fn action(&self, name: &TypeName) -> Result<&ActionDefinition, Error> {
        self.actions.get(name).ok_or_else(|| self.not_in_catalog(name))
    }

    /// All messages in the order of their names, those of services (kind [`Kind::Service`]) and actions
    /// ([`Kind::Action`]) among them.
    pub fn messages(&self) -> impl Iterator<Item = &MessageDefinition> {
        self.messages.values()
    }

    /// All services in the order of their names, those of actions ([`Kind::Action`]) among them.
    pub fn services(&self) -> impl Iterator<Item = &ServiceDefinition> {
        self.services.values()
    }

    /// All actions in the order of their names.
    pub fn actions(&self) -> impl Iterator<Item = &ActionDefinition> {
        self.actions.values()
    }

    /// The packages that have an interface here, in order.
    #[must_use]
    pub fn packages(&self) -> Vec<&str> {
        let mut packages: Vec<&str> = self.messages.keys().map(|name| name.package.as_str()).collect();
        packages.dedup();
        packages
    }

    /// Like [`Catalog::message`], but a missing message is not an error.
    pub(crate) fn find_message(&self, name: &TypeName) -> Option<&MessageDefinition> {
        self.messages.get(name)
    }

    /// Like [`Catalog::service`], but a missing service is not an error.
    pub(crate) fn find_service(&self, name: &TypeName) -> Option<&ServiceDefinition> {
        self.services.get(name)
    }

    pub(crate) fn find_action(&self, name: &TypeName) -> Option<&ActionDefinition> {
        self.actions.get(name)
    }

    pub(crate) fn insert_definition(&mut self, definition: Definition) -> Result<(), Error> {
        match definition {
            Definition::Message(message) => self.insert(message),
            Definition::Service(service) => self.insert_service(service),
            Definition::Action(action) => self.insert_action(action),
        }
    }

    pub(crate) fn insert(&mut self, message: MessageDefinition) -> Result<(), Error> {
        match self.messages.get(&message.name) {
            Some(first) if !first.means_the_same_as(&message) => Err(Error::DefinedTwice {
                name: message.name,
                first: first.origin.clone(),
                second: message.origin,
            }),
            Some(_) => Ok(()),
            None => {
                self.messages.insert(message.name.clone(), message);
                Ok(())
            }
        }
    }

    pub(crate) fn insert_service(&mut self, service: ServiceDefinition) -> Result<(), Error> {
        self.insert(service.request.clone())?;
        self.insert(service.response.clone())?;
        self.insert(event_of(&service))?;
        self.services.entry(service.name.clone()).or_insert(service);
        Ok(())
    }

    pub(crate) fn insert_action(&mut self, action: ActionDefinition) -> Result<(), Error> {
        for message in [&action.goal, &action.result, &action.feedback] {
            self.insert(message.clone())?;
        }
        let parts = parts_of(&action);
        self.insert(parts.feedback_message)?;
        self.insert_service(parts.send_goal)?;
        self.insert_service(parts.get_result)?;
        self.actions.entry(action.name.clone()).or_insert(action);
        Ok(())
    }

    fn not_in_catalog(&self, name: &TypeName) -> Error {
        let hint = if self.messages.contains_key(name) {
            ": it is a message, no service or action".into()
        } else if self.services.contains_key(name) {
            ": it is a service, not a message".into()
        } else if self.actions.contains_key(name) {
            ": it is an action, no message or service".into()
        } else {
            let others = self.messages.keys().chain(self.services.keys()).chain(self.actions.keys());
            match nearest_type(name, others) {
                Some(other) => format!(", did you mean {other}?"),
                None => self.hint_for_package(name),
            }
        };
        Error::NotInCatalog { name: Box::new(name.clone()), hint }
    }

    /// The hint for a field of that type.
    fn hint_for_field(&self, wanted: &TypeName) -> String {
        match nearest_type(wanted, self.messages.keys().filter(|name| name.kind == Kind::Message)) {
            Some(other) => format!(", did you mean `{}`?", other.short()),
            None => self.hint_for_package(wanted),
        }
    }

    fn hint_for_package(&self, wanted: &TypeName) -> String {
        if self.messages.keys().any(|name| name.package == wanted.package) {
            return String::new();
        }
        format!(": no interface of the package {} is known, add its folder", wanted.package)
    }
}

/// One of the same package or of the same name in another package.
fn nearest_type<'a>(wanted: &TypeName, names: impl Iterator<Item = &'a TypeName>) -> Option<&'a TypeName> {
    let related = names.filter(|name| name.package == wanted.package || name.name == wanted.name);
    nearest(&wanted.to_string(), related)
}

#[cfg(test)]
mod tests;
