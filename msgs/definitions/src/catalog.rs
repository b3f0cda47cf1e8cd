//! A set of interfaces that refer to each other.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::{
    Element, Error, Field, FieldType, Kind, MessageDefinition, Place, ServiceDefinition, Shape, TypeName,
    parse_message, parse_service,
};

/// Definitions by name. Fill it, [check](Catalog::check) it, then derive from it what you need.
#[derive(Clone, Debug, Default)]
pub struct Catalog {
    messages: BTreeMap<TypeName, MessageDefinition>,
    services: BTreeMap<TypeName, ServiceDefinition>,
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
        let service = parse_service(name, text, origin)?;
        if let Some(first) = self.services.get(&service.name) {
            return if first.text == service.text {
                Ok(())
            } else {
                Err(Error::DefinedTwice {
                    name: service.name,
                    first: first.origin.clone(),
                    second: service.origin,
                })
            };
        }
        self.insert(service.request.clone())?;
        self.insert(service.response.clone())?;
        self.insert(event_of(&service))?;
        self.services.insert(service.name.clone(), service);
        Ok(())
    }

    /// Adds the interfaces of one package: `<folder>/msg/*.msg` and `<folder>/srv/*.srv`. The folder's name is the
    /// package's. Returns how many files were read.
    ///
    /// # Errors
    /// If a file cannot be read or parsed. A folder without interfaces is no error.
    pub fn add_package(&mut self, folder: &Path) -> Result<usize, Error> {
        let package = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let mut count = 0;
        for kind in [Kind::Message, Kind::Service] {
            for file in files_with_extension(&folder.join(kind.as_str()), kind.as_str())? {
                let stem = file.file_stem().unwrap_or_default().to_string_lossy();
                let name: TypeName = format!("{package}/{}/{stem}", kind.as_str()).parse()?;
                let text =
                    fs::read_to_string(&file).map_err(|source| Error::Read { path: file.clone(), source })?;
                let origin = file.display().to_string();
                match kind {
                    Kind::Message => self.add_message(name, &text, &origin)?,
                    Kind::Service => self.add_service(name, &text, &origin)?,
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

    /// The definition of a message, be it one of a service.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`].
    pub fn message(&self, name: &TypeName) -> Result<&MessageDefinition, Error> {
        self.messages.get(name).ok_or_else(|| Error::NotInCatalog(name.clone()))
    }

    /// The definition of a service.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`].
    pub fn service(&self, name: &TypeName) -> Result<&ServiceDefinition, Error> {
        self.services.get(name).ok_or_else(|| Error::NotInCatalog(name.clone()))
    }

    /// All messages in the order of their names, those of services (kind [`Kind::Service`]) among them.
    pub fn messages(&self) -> impl Iterator<Item = &MessageDefinition> {
        self.messages.values()
    }

    /// All services in the order of their names.
    pub fn services(&self) -> impl Iterator<Item = &ServiceDefinition> {
        self.services.values()
    }

    /// The packages that have an interface here, in order.
    #[must_use]
    pub fn packages(&self) -> Vec<&str> {
        let mut packages: Vec<&str> = self.messages.keys().map(|name| name.package.as_str()).collect();
        packages.dedup();
        packages
    }

    fn insert(&mut self, message: MessageDefinition) -> Result<(), Error> {
        match self.messages.get(&message.name) {
            Some(first) if first.text != message.text => Err(Error::DefinedTwice {
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

/// What service introspection publishes: who and when, and the request or response where contents are asked for.
fn event_of(service: &ServiceDefinition) -> MessageDefinition {
    let place = Place { origin: service.origin.clone(), line: 1, column: 1 };
    let field = |name: &str, message: TypeName, shape| Field {
        name: name.into(),
        field_type: FieldType { element: Element::Message(message), shape },
        default: None,
        comment: Vec::new(),
        place: place.clone(),
    };
    MessageDefinition {
        name: service.name.with_suffix("_Event"),
        comment: Vec::new(),
        fields: vec![
            field("info", TypeName::new("service_msgs", Kind::Message, "ServiceEventInfo"), Shape::Single),
            field("request", service.request.name.clone(), Shape::Bounded(1)),
            field("response", service.response.name.clone(), Shape::Bounded(1)),
        ],
        constants: Vec::new(),
        text: service.text.clone(),
        origin: service.origin.clone(),
    }
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
