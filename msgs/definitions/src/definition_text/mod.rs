//! The text that rosbag2 stores as the schema of a topic (`ros2msg`): written here, read in `read.rs`.
//!
//! The root's own text comes first. Then each message it depends on follows once, depth first and sorted by
//! name, after a line of 80 `=` and a line `MSG: package/Type`. The texts of services and actions have such a
//! header themselves. For a message that rosidl derives from a service or an action, the text is the one its
//! author would have written, in the [portable](portable_definition_text) form: the real recorder has no text
//! for them.

mod idl;
mod portable;
mod read;

pub use portable::portable_definition_text;
pub use read::DefinitionEncoding;

use std::borrow::Cow;

use std::collections::BTreeSet;

use crate::{Catalog, Element, Error, Kind, MessageDefinition, TypeName};

impl Catalog {
    /// Returns the definition text of a message, a service or an action.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`] for the type itself or a message it depends on.
    pub fn definition_text(&self, name: &TypeName) -> Result<String, Error> {
        if let Some(action) = self.find_action(name) {
            let head = format!("{RULE}\nACTION: {name}\n{}", action.text);
            return self.with_dependencies(
                head,
                &[&action.goal, &action.result, &action.feedback],
                BTreeSet::new(),
            );
        }
        if self.find_service(name).is_some() {
            return self.service_definition_text(name);
        }
        let message = self.message(name)?;
        self.with_dependencies(own_text(message).into_owned(), &[message], BTreeSet::from([name.clone()]))
    }

    /// The text that a bag stores as the schema of a message, and its encoding: the portable form of its
    /// `ros2msg` text, and IDL for the messages of services, whose names some readers of `ros2msg` do not
    /// understand.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`] for the type itself or a message it depends on.
    pub fn schema_text(&self, name: &TypeName) -> Result<(DefinitionEncoding, String), Error> {
        if name.kind == Kind::Service {
            return Ok((DefinitionEncoding::Ros2Idl, self.idl_definition_text(name)?));
        }
        let text = self.definition_text(name)?;
        Ok((DefinitionEncoding::Ros2Msg, portable_definition_text(name, &text).into_owned()))
    }

    /// The definition text of a service.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`] for the service itself or a message it depends on.
    pub fn service_definition_text(&self, name: &TypeName) -> Result<String, Error> {
        let service = self.service(name)?;
        let head = format!("{RULE}\nSRV: {name}\n{}", service.text);
        self.with_dependencies(head, &[&service.request, &service.response], BTreeSet::new())
    }

    fn with_dependencies(
        &self,
        mut text: String,
        roots: &[&MessageDefinition],
        mut seen: BTreeSet<TypeName>,
    ) -> Result<String, Error> {
        // Types that are still to be written, the next one last.
        let mut waiting: Vec<&TypeName> = dependencies_backwards(roots);
        while let Some(name) = waiting.pop() {
            if seen.insert(name.clone()) {
                let message = self.message(name)?;
                text.push_str(&format!("\n{RULE}\nMSG: {}\n{}", name.in_texts(), own_text(message)));
                waiting.extend(dependencies_backwards(&[message]));
            }
        }
        Ok(text)
    }
}

/// The text of a message without its dependencies: of a file as it is, of a part of a service or an action in
/// portable form.
fn own_text(message: &MessageDefinition) -> Cow<'_, str> {
    match message.name.kind {
        Kind::Message => Cow::Borrowed(&message.text),
        Kind::Service | Kind::Action => portable_definition_text(&message.name, &message.text),
    }
}

/// The line before each header.
pub(crate) const RULE: &str =
    "================================================================================";

/// Returns whether the line consists of `=` only, usually 80 of them; no line of a definition does.
fn is_rule(line: &str) -> bool {
    let line = line.trim_end();
    line.len() >= 3 && line.bytes().all(|byte| byte == b'=')
}

fn dependencies_backwards<'a>(of: &[&'a MessageDefinition]) -> Vec<&'a TypeName> {
    let names: BTreeSet<&TypeName> = of
        .iter()
        .flat_map(|message| &message.fields)
        .filter_map(|field| match &field.field_type.element {
            Element::Message(name) => Some(name),
            _ => None,
        })
        .collect();
    names.into_iter().rev().collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use crate::Catalog;

    #[test]
    fn an_action_and_its_parts_have_texts() {
        let mut catalog = Catalog::new();
        catalog
            .add_message("unique_identifier_msgs/msg/UUID".parse().unwrap(), "uint8[16] uuid\n", "")
            .unwrap();
        let text = "int32 order\n---\nint32[] sequence\n---\nint32 left\n";
        catalog.add_action("a/action/Fibonacci".parse().unwrap(), text, "").unwrap();
        let text_of = |name: &str| catalog.definition_text(&name.parse().unwrap()).unwrap();
        let line = "=".repeat(80);
        assert_eq!(text_of("a/action/Fibonacci"), format!("{line}\nACTION: a/action/Fibonacci\n{text}"));
        assert_eq!(text_of("a/action/Fibonacci_Result"), "int32[] sequence\n");
        assert_eq!(
            text_of("a/action/Fibonacci_FeedbackMessage"),
            format!(
                "unique_identifier_msgs/UUID goal_id\na/action/Fibonacci_Feedback feedback\n\n{line}\nMSG: a/action/Fibonacci_Feedback\n\
                 int32 left\n\n{line}\nMSG: unique_identifier_msgs/UUID\nuint8[16] uuid\n"
            )
        );
    }

    #[test]
    fn each_dependency_follows_once_depth_first() {
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
