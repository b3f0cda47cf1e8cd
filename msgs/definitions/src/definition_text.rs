//! The text rosbag2 stores as the schema of a topic (`ros2msg`).
//!
//! The root's own text comes first; then, depth first and in the order of their names, each message it depends on,
//! once, after a line of 80 `=` and a line `MSG: package/Type`. A service's text stands below such a head itself.

use std::collections::BTreeSet;

use crate::{Catalog, Element, Error, MessageDefinition, TypeName};

impl Catalog {
    /// The definition text of a message. That of a service's event is the text of the service, as in rosbag2.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`] for the message itself or one it depends on.
    pub fn definition_text(&self, name: &TypeName) -> Result<String, Error> {
        let message = self.message(name)?;
        if let Some(service) = name.name.strip_suffix("_Event") {
            return self.service_definition_text(&TypeName::new(&name.package, name.kind, service));
        }
        let mut text = message.text.clone();
        self.append_dependencies(&[message], &mut text, &mut BTreeSet::from([name.clone()]))?;
        Ok(text)
    }

    /// The definition text of a service.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`] for the service itself or a message it depends on.
    pub fn service_definition_text(&self, name: &TypeName) -> Result<String, Error> {
        let service = self.service(name)?;
        let mut text = format!("{}\nSRV: {name}\n{}", "=".repeat(80), service.text);
        self.append_dependencies(&[&service.request, &service.response], &mut text, &mut BTreeSet::new())?;
        Ok(text)
    }

    fn append_dependencies(
        &self,
        of: &[&MessageDefinition],
        text: &mut String,
        seen: &mut BTreeSet<TypeName>,
    ) -> Result<(), Error> {
        let names: BTreeSet<&TypeName> = of
            .iter()
            .flat_map(|message| &message.fields)
            .filter_map(|field| match &field.field_type.element {
                Element::Message(name) => Some(name),
                _ => None,
            })
            .collect();
        for name in names {
            if seen.insert(name.clone()) {
                let message = self.message(name)?;
                text.push_str(&format!("\n{}\nMSG: {}\n{}", "=".repeat(80), name.short(), message.text));
                self.append_dependencies(&[message], text, seen)?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use crate::Catalog;

    #[test]
    fn dependencies_follow_once_each_depth_first() {
        let mut catalog = Catalog::new();
        for (name, text) in
            [("b/msg/Root", "b/Z z\na/A[] a\nZ again\n"), ("b/msg/Z", "int8 z\n"), ("a/msg/A", "b/Z z\n")]
        {
            catalog.add_message(name.parse().unwrap(), text, name).unwrap();
        }
        let line = "=".repeat(80);
        assert_eq!(
            catalog.definition_text(&"b/msg/Root".parse().unwrap()).unwrap(),
            format!("b/Z z\na/A[] a\nZ again\n\n{line}\nMSG: a/A\nb/Z z\n\n{line}\nMSG: b/Z\nint8 z\n")
        );
    }
}
