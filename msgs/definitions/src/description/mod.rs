//! Type descriptions and the hashes computed from them.
//!
//! # References
//! `rosidl_generator_type_description/__init__.py` and `rcl/src/rcl/type_hash.c`, branch jazzy.

mod read;

use std::collections::BTreeSet;
use std::fmt::Write as _;

use sha2::{Digest, Sha256};

use crate::{Catalog, Element, Error, FieldType, Primitive, Shape, TypeName};

/// A type and all types it refers to, as `type_description_interfaces/msg/TypeDescription` without default
/// values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TypeDescription {
    /// The type itself.
    pub type_description: IndividualTypeDescription,
    /// The types it refers to, directly or indirectly, sorted by name.
    pub referenced_type_descriptions: Vec<IndividualTypeDescription>,
}

/// One type.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IndividualTypeDescription {
    /// Its full name.
    pub type_name: String,
    /// Its fields: name and type.
    pub fields: Vec<(String, FieldTypeDescription)>,
}

/// The type of a field.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FieldTypeDescription {
    /// One of the constants of `type_description_interfaces/msg/FieldType`.
    pub type_id: u8,
    /// The size of an array, the bound of a sequence, 0 otherwise.
    pub capacity: u64,
    /// The bound of a string, 0 otherwise.
    pub string_capacity: u64,
    /// The full name of a message, empty otherwise.
    pub nested_type_name: String,
}

impl TypeDescription {
    /// The JSON text the hash is computed from.
    #[must_use]
    pub fn to_json(&self) -> String {
        let mut json = String::from("{\"type_description\": ");
        write_individual(&mut json, &self.type_description);
        json.push_str(", \"referenced_type_descriptions\": [");
        for (index, referenced) in self.referenced_type_descriptions.iter().enumerate() {
            json.push_str(if index == 0 { "" } else { ", " });
            write_individual(&mut json, referenced);
        }
        json.push_str("]}");
        json
    }

    /// The hash: `RIHS01_` and 64 hexadecimal digits.
    #[must_use]
    pub fn hash(&self) -> String {
        let mut hash = String::from("RIHS01_");
        for byte in Sha256::digest(self.to_json()) {
            let _ = write!(hash, "{byte:02x}"); // Writing to a String cannot fail.
        }
        hash
    }
}

impl Catalog {
    /// The description of a message, a service or an action.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`] for the type itself or one it refers to.
    pub fn type_description(&self, name: &TypeName) -> Result<TypeDescription, Error> {
        let type_description = self.describe(name)?;
        let mut names = BTreeSet::new();
        self.collect_references(name, &mut names)?;
        let referenced = names.iter().map(|name| self.describe(name)).collect::<Result<_, _>>()?;
        Ok(TypeDescription { type_description, referenced_type_descriptions: referenced })
    }

    /// The hash of a message, a service or an action.
    ///
    /// # Errors
    /// See [`Catalog::type_description`].
    pub fn type_hash(&self, name: &TypeName) -> Result<String, Error> {
        Ok(self.type_description(name)?.hash())
    }

    fn describe(&self, name: &TypeName) -> Result<IndividualTypeDescription, Error> {
        let mut fields: Vec<(String, FieldTypeDescription)> = self
            .members(name)?
            .into_iter()
            .map(|(field, field_type)| (field, describe_type(&field_type)))
            .collect();
        if fields.is_empty() {
            fields.push((PLACEHOLDER.into(), placeholder_type()));
        }
        Ok(IndividualTypeDescription { type_name: name.to_string(), fields })
    }

    fn collect_references(&self, of: &TypeName, names: &mut BTreeSet<TypeName>) -> Result<(), Error> {
        let mut waiting = vec![of.clone()];
        while let Some(name) = waiting.pop() {
            for (_, field_type) in self.members(&name)? {
                if let Element::Message(name) = field_type.element
                    && names.insert(name.clone())
                {
                    waiting.push(name);
                }
            }
        }
        Ok(())
    }

    /// Name and type of each field; the parts of services and actions count as their fields.
    fn members(&self, name: &TypeName) -> Result<Vec<(String, FieldType)>, Error> {
        let member = |(field, suffix): &(&str, &str)| {
            let element = Element::Message(name.with_suffix(suffix));
            ((*field).to_owned(), FieldType { element, shape: Shape::Single })
        };
        if self.find_action(name).is_some() {
            return Ok(ACTION_MEMBERS.iter().map(member).collect());
        }
        if self.find_service(name).is_some() {
            return Ok(SERVICE_MEMBERS.iter().map(member).collect());
        }
        let fields = &self.message(name)?.fields;
        Ok(fields.iter().map(|field| (field.name.clone(), field.field_type.clone())).collect())
    }
}

/// Field and type name suffix of each part.
const SERVICE_MEMBERS: [(&str, &str); 3] =
    [("request_message", "_Request"), ("response_message", "_Response"), ("event_message", "_Event")];

const ACTION_MEMBERS: [(&str, &str); 6] = [
    ("goal", "_Goal"),
    ("result", "_Result"),
    ("feedback", "_Feedback"),
    ("send_goal_service", "_SendGoal"),
    ("get_result_service", "_GetResult"),
    ("feedback_message", "_FeedbackMessage"),
];

fn describe_type(field_type: &FieldType) -> FieldTypeDescription {
    FieldTypeDescription {
        type_id: field_type.type_id(),
        capacity: field_type.capacity(),
        string_capacity: field_type.string_capacity(),
        nested_type_name: match &field_type.element {
            Element::Message(name) => name.to_string(),
            _ => String::new(),
        },
    }
}

/// The field of empty messages.
const PLACEHOLDER: &str = "structure_needs_at_least_one_member";

fn placeholder_type() -> FieldTypeDescription {
    FieldTypeDescription { type_id: 3, ..FieldTypeDescription::default() }
}

/// The primitive type with that id.
fn primitive_of(id: u8) -> Option<Primitive> {
    let is_it = |primitive: &Primitive| *primitive != Primitive::Char && primitive.type_id() == id;
    Primitive::ALL.into_iter().find(is_it)
}

// The parser ensures that names are ASCII without quotes or backslashes, so JSON needs no escapes here.
fn write_individual(json: &mut String, description: &IndividualTypeDescription) {
    json.push_str(&format!("{{\"type_name\": \"{}\", \"fields\": [", description.type_name));
    for (index, (name, field)) in description.fields.iter().enumerate() {
        json.push_str(if index == 0 { "" } else { ", " });
        json.push_str(&format!(
            "{{\"name\": \"{name}\", \"type\": {{\"type_id\": {}, \"capacity\": {}, \"string_capacity\": {}, \
             \"nested_type_name\": \"{}\"}}}}",
            field.type_id, field.capacity, field.string_capacity, field.nested_type_name
        ));
    }
    json.push_str("]}");
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use crate::Catalog;

    /// `example_interfaces/srv/AddTwoInts` and all types it refers to.
    fn add_two_ints() -> Catalog {
        let mut catalog = Catalog::new();
        let time = "int32 sec\nuint32 nanosec\n";
        let info =
            "uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\nint64 sequence_number\n";
        catalog.add_message("builtin_interfaces/msg/Time".parse().unwrap(), time, "").unwrap();
        catalog.add_message("service_msgs/msg/ServiceEventInfo".parse().unwrap(), info, "").unwrap();
        let service = "int64 a\nint64 b\n---\nint64 sum\n";
        catalog.add_service("example_interfaces/srv/AddTwoInts".parse().unwrap(), service, "").unwrap();
        catalog
    }

    #[test]
    fn the_hash_of_a_service_is_the_published_one() {
        let hash = add_two_ints().type_hash(&"example_interfaces/srv/AddTwoInts".parse().unwrap()).unwrap();
        assert_eq!(hash, "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a");
    }

    #[test]
    fn the_hashes_of_an_action_and_its_parts_are_the_published_ones() {
        let mut catalog = add_two_ints();
        catalog
            .add_message("unique_identifier_msgs/msg/UUID".parse().unwrap(), "uint8[16] uuid\n", "")
            .unwrap();
        let text = "int32 order\n---\nint32[] sequence\n---\nint32[] sequence\n";
        catalog.add_action("test_msgs/action/Fibonacci".parse().unwrap(), text, "").unwrap();
        catalog.check().unwrap();
        // From `test_msgs/action/Fibonacci.json` of the wheel ros-test-msgs 2.0.3.
        for (name, hash) in [
            (
                "test_msgs/action/Fibonacci",
                "be9273e3557225044b4a040811112491f7079326e3a573f83258b0b4c30bd069",
            ),
            (
                "test_msgs/action/Fibonacci_Goal",
                "e58ef5a8f4f039ab522a740823547c460b1d5aed8031c8b7825d33d345d90df8",
            ),
            (
                "test_msgs/action/Fibonacci_FeedbackMessage",
                "37487bae8cea358366b97003c1ef1ca7ce7c08df36f9e8cca496624226aee64e",
            ),
            (
                "test_msgs/action/Fibonacci_SendGoal",
                "d807633803e38e164276573cd97e9fbd71e109c290bbf4cc312a0a1c9da7bbd9",
            ),
            (
                "test_msgs/action/Fibonacci_GetResult_Response",
                "ef88159d47a3d21d9bf4bec690cf668939d9542db28a9cfd77dbcd97eaf1add2",
            ),
            (
                "test_msgs/action/Fibonacci_SendGoal_Event",
                "a20e708c6aae7a99d1eb0e930a0916f596bb5bae93a342a61752e13135be2c44",
            ),
        ] {
            assert_eq!(
                catalog.type_hash(&name.parse().unwrap()).unwrap(),
                format!("RIHS01_{hash}"),
                "{name}"
            );
        }
    }

    #[test]
    fn the_hash_of_a_message_is_the_published_one_whatever_its_constants_comments_and_defaults() {
        for text in ["string data\n", "# c\nint8 A=1\nstring data \"x\" # c\n"] {
            let mut catalog = Catalog::new();
            catalog.add_message("std_msgs/msg/String".parse().unwrap(), text, "").unwrap();
            assert_eq!(
                catalog.type_hash(&"std_msgs/msg/String".parse().unwrap()).unwrap(),
                "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
            );
        }
    }

    #[test]
    fn the_json_has_the_spacing_the_hash_depends_on() {
        let mut catalog = Catalog::new();
        catalog.add_message("a/msg/A".parse().unwrap(), "B[<=3] b\n", "").unwrap();
        catalog.add_message("a/msg/B".parse().unwrap(), "", "").unwrap();
        assert_eq!(
            catalog.type_description(&"a/msg/A".parse().unwrap()).unwrap().to_json(),
            "{\"type_description\": {\"type_name\": \"a/msg/A\", \"fields\": [{\"name\": \"b\", \"type\": \
             {\"type_id\": 97, \"capacity\": 3, \"string_capacity\": 0, \"nested_type_name\": \"a/msg/B\"}}]}, \
             \"referenced_type_descriptions\": [{\"type_name\": \"a/msg/B\", \"fields\": [{\"name\": \
             \"structure_needs_at_least_one_member\", \"type\": {\"type_id\": 3, \"capacity\": 0, \
             \"string_capacity\": 0, \"nested_type_name\": \"\"}}]}]}"
        );
    }
}
