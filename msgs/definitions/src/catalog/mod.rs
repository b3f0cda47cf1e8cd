//! A set of interfaces that refer to each other.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::derived::{event_of, parts_of};
use crate::{
    ActionDefinition, Element, Error, Kind, MessageDefinition, ServiceDefinition, TypeName, parse_action,
    parse_message, parse_service,
};

/// Definitions by name. Fill it, [check](Catalog::check) it, then derive from it what you need.
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

    /// Adds one message from its text; `origin` names the text in errors. The same text again changes nothing.
    ///
    /// # Errors
    /// If the text is no message definition, or the name has another definition already.
    pub fn add_message(&mut self, name: TypeName, text: &str, origin: &str) -> Result<(), Error> {
        let message = parse_message(name, text, origin)?;
        self.insert(message)
    }

    /// Adds one service, and the request, response and event messages that belong to it.
    ///
    /// # Errors
    /// If the text is no service definition, or the name has another definition already.
    pub fn add_service(&mut self, name: TypeName, text: &str, origin: &str) -> Result<(), Error> {
        self.insert_service(parse_service(name, text, origin)?)
    }

    /// Adds one action, and the services and messages that belong to it: `_Goal`, `_Result`, `_Feedback`,
    /// `_FeedbackMessage`, `_SendGoal`, `_GetResult` and the messages of these two.
    ///
    /// # Errors
    /// If the text is no action definition, or the name has another definition already.
    pub fn add_action(&mut self, name: TypeName, text: &str, origin: &str) -> Result<(), Error> {
        self.insert_action(parse_action(name, text, origin)?)
    }

    /// Adds the interfaces of one package: `<folder>/msg/*.msg`, `<folder>/srv/*.srv` and `<folder>/action/*.action`. The
    /// folder's name is the package's. Returns how many files were read.
    ///
    /// # Errors
    /// If a file cannot be read or parsed. A folder without interfaces is no error.
    pub fn add_package(&mut self, folder: &Path) -> Result<usize, Error> {
        let package = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let mut count = 0;
        for kind in Kind::ALL {
            for file in files_with_extension(&folder.join(kind.as_str()), kind.as_str())? {
                let stem = file.file_stem().unwrap_or_default().to_string_lossy();
                let name: TypeName = format!("{package}/{}/{stem}", kind.as_str()).parse()?;
                let text =
                    fs::read_to_string(&file).map_err(|source| Error::Read { path: file.clone(), source })?;
                let origin = file.display().to_string();
                match kind {
                    Kind::Message => self.add_message(name, &text, &origin)?,
                    Kind::Service => self.add_service(name, &text, &origin)?,
                    Kind::Action => self.add_action(name, &text, &origin)?,
                }
                count += 1;
            }
        }
        Ok(count)
    }

    /// Adds every package below a folder: an interfaces folder, or the `share` folder of an ament prefix.
    /// Returns how many files were read.
    ///
    /// # Errors
    /// As [`Catalog::add_package`].
    pub fn add_packages(&mut self, folder: &Path) -> Result<usize, Error> {
        let mut count = 0;
        for entry in sorted_entries(folder)? {
            if entry.is_dir() {
                count += self.add_package(&entry)?;
            }
        }
        Ok(count)
    }

    /// Checks that every type a field names is there, and that no message contains itself.
    ///
    /// # Errors
    /// [`Error::UnknownType`] or [`Error::Cycle`], the first one found.
    pub fn check(&self) -> Result<(), Error> {
        for message in self.messages.values() {
            for field in &message.fields {
                if let Element::Message(wanted) = &field.field_type.element
                    && !self.messages.contains_key(wanted)
                {
                    return Err(Error::UnknownType {
                        place: Box::new(field.place.clone()),
                        owner: Box::new(message.name.clone()),
                        field: field.name.clone(),
                        wanted: Box::new(wanted.clone()),
                        hint: self.hint_for(wanted),
                    });
                }
            }
        }
        let mut finished = std::collections::BTreeSet::new();
        self.messages
            .values()
            .try_for_each(|message| self.check_cycles(message, &mut Vec::new(), &mut finished))
    }

    /// The definition of a message, be it one of a service or an action.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`].
    pub fn message(&self, name: &TypeName) -> Result<&MessageDefinition, Error> {
        self.messages.get(name).ok_or_else(|| Error::NotInCatalog(name.clone()))
    }

    /// The definition of a service, be it one of an action.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`].
    pub fn service(&self, name: &TypeName) -> Result<&ServiceDefinition, Error> {
        self.services.get(name).ok_or_else(|| Error::NotInCatalog(name.clone()))
    }

    /// The definition of an action.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`].
    pub fn action(&self, name: &TypeName) -> Result<&ActionDefinition, Error> {
        self.actions.get(name).ok_or_else(|| Error::NotInCatalog(name.clone()))
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

    fn insert(&mut self, message: MessageDefinition) -> Result<(), Error> {
        if let Some(first) = self.messages.get(&message.name) {
            return same(&message.name, [&first.text, &first.origin], [&message.text, &message.origin]);
        }
        self.messages.insert(message.name.clone(), message);
        Ok(())
    }

    fn insert_service(&mut self, service: ServiceDefinition) -> Result<(), Error> {
        if let Some(first) = self.services.get(&service.name) {
            return same(&service.name, [&first.text, &first.origin], [&service.text, &service.origin]);
        }
        let mut event = event_of(&service);
        if service.name.kind == Kind::Service {
            // As in rosbag2, which knows no text of events.
            event.text.clone_from(&service.text);
        }
        self.insert(event)?;
        self.insert(service.request.clone())?;
        self.insert(service.response.clone())?;
        self.services.insert(service.name.clone(), service);
        Ok(())
    }

    fn insert_action(&mut self, action: ActionDefinition) -> Result<(), Error> {
        if let Some(first) = self.actions.get(&action.name) {
            return same(&action.name, [&first.text, &first.origin], [&action.text, &action.origin]);
        }
        let parts = parts_of(&action);
        for message in [&action.goal, &action.result, &action.feedback] {
            self.insert(message.clone())?;
        }
        self.insert(parts.feedback_message)?;
        self.insert_service(parts.send_goal)?;
        self.insert_service(parts.get_result)?;
        self.actions.insert(action.name.clone(), action);
        Ok(())
    }

    fn hint_for(&self, wanted: &TypeName) -> String {
        match self.messages.keys().find(|name| name.name == wanted.name && name.kind == Kind::Message) {
            Some(other) => format!(", did you mean `{}`?", other.short()),
            None if self.messages.keys().any(|name| name.package == wanted.package) => String::new(),
            None => format!(": no interface of the package {} is known, add its folder", wanted.package),
        }
    }

    fn check_cycles<'a>(
        &'a self,
        message: &'a MessageDefinition,
        path: &mut Vec<&'a TypeName>,
        finished: &mut std::collections::BTreeSet<&'a TypeName>,
    ) -> Result<(), Error> {
        if finished.contains(&message.name) {
            return Ok(());
        }
        if let Some(first) = path.iter().position(|name| **name == message.name) {
            let mut cycle: Vec<TypeName> = path[first..].iter().map(|name| (*name).clone()).collect();
            cycle.push(message.name.clone());
            return Err(Error::Cycle { origin: message.origin.clone(), cycle });
        }
        path.push(&message.name);
        for field in &message.fields {
            if let Element::Message(name) = &field.field_type.element {
                self.check_cycles(self.message(name)?, path, finished)?;
            }
        }
        path.pop();
        finished.insert(&message.name);
        Ok(())
    }
}

/// A type may be defined again by the same text; text and origin of both are given.
fn same(name: &TypeName, first: [&String; 2], second: [&String; 2]) -> Result<(), Error> {
    if first[0] == second[0] {
        return Ok(());
    }
    Err(Error::DefinedTwice { name: name.clone(), first: first[1].clone(), second: second[1].clone() })
}

fn files_with_extension(folder: &Path, extension: &str) -> Result<Vec<PathBuf>, Error> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let mut files = sorted_entries(folder)?;
    files.retain(|file| file.extension().is_some_and(|found| found == extension));
    Ok(files)
}

/// Sorted, so that the same folder gives the same output everywhere.
fn sorted_entries(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let failed = |source| Error::Read { path: folder.into(), source };
    let mut entries = fs::read_dir(folder)
        .map_err(failed)?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<Result<Vec<_>, _>>()
        .map_err(failed)?;
    entries.sort();
    Ok(entries)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::Catalog;

    fn catalog(messages: &[(&str, &str)]) -> Catalog {
        let mut catalog = Catalog::new();
        for (name, text) in messages {
            catalog.add_message(name.parse().unwrap(), text, name).unwrap();
        }
        catalog
    }

    #[test]
    fn an_unknown_type_is_told_with_its_place_and_the_likely_name() {
        let error =
            catalog(&[("a/msg/A", "int8 x\nHeader header"), ("std_msgs/msg/Header", "string frame_id")])
                .check()
                .unwrap_err();
        assert_eq!(
            error.to_string(),
            "a/msg/A:2:1: field `header` of a/msg/A has the unknown type `a/msg/Header`, \
             did you mean `std_msgs/Header`?"
        );
    }

    #[test]
    fn a_message_that_contains_itself_is_refused() {
        let error =
            catalog(&[("a/msg/A", "B b"), ("a/msg/B", "C[] c"), ("a/msg/C", "B b")]).check().unwrap_err();
        assert_eq!(error.to_string(), "a/msg/B: a/msg/B contains itself: a/msg/B -> a/msg/C -> a/msg/B");
    }

    #[test]
    fn the_same_definition_twice_is_fine_and_another_one_is_not() {
        let mut catalog = catalog(&[("a/msg/A", "int8 x")]);
        catalog.add_message("a/msg/A".parse().unwrap(), "int8 x", "copy").unwrap();
        let error = catalog.add_message("a/msg/A".parse().unwrap(), "int16 x", "other").unwrap_err();
        assert_eq!(error.to_string(), "other: a/msg/A is already defined, differently, in a/msg/A");
    }
}
