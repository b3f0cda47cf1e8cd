//! Type descriptions, known at compile time.
//!
//! Every message, service and action has a description, in the form that ROS 2 nodes request from each other
//! (`~/get_type_description`):
//!
//! ```
//! use downbeat_msgs::{Message, std_msgs::msg::Header};
//!
//! let description = Header::type_description();
//! assert_eq!(description.type_description.type_name, "std_msgs/msg/Header");
//! assert_eq!(description.referenced_type_descriptions[0].type_name, "builtin_interfaces/msg/Time");
//! ```
//!
//! It is derived from a constant, [`Message::FIELDS`](crate::Message::FIELDS), from which the derive macro
//! also computes, at compile time, the hash and the definition text of a message that has no definition file.
//!
//! # References
//! `type_description_interfaces` of `ros2/rcl_interfaces` and `rosidl_generator_type_description` of
//! `ros2/rosidl`, branch jazzy.

mod const_text;
mod field;
mod hash;
mod text;

use std::collections::BTreeMap;

use crate::type_description_interfaces::msg;

pub use downbeat_msgs_definitions::{Element, Shape};
#[doc(hidden)]
pub use field::check;
pub use field::{Description, Field, FieldType, FieldValue};
pub use hash::{Hash, hash};
pub use text::{OwnText, Text, definition};

impl Description {
    /// The description of the type and of all types it refers to, sorted by name, as a node returns it from
    /// `~/get_type_description`.
    #[must_use]
    pub fn to_message(&self) -> msg::TypeDescription {
        let mut references = BTreeMap::new();
        collect(self, &mut references);
        msg::TypeDescription {
            type_description: individual(self),
            referenced_type_descriptions: references.into_values().map(individual).collect(),
        }
    }
}

/// Recurses as deep as the types are nested, which the compiler bounds.
fn collect(of: &Description, references: &mut BTreeMap<&'static str, &'static Description>) {
    for nested in of.fields.iter().filter_map(Field::nested) {
        if references.insert(nested.type_name, nested).is_none() {
            collect(nested, references);
        }
    }
}

fn individual(description: &Description) -> msg::IndividualTypeDescription {
    let mut fields: Vec<msg::Field> = description.fields.iter().map(field).collect();
    if fields.is_empty() {
        // rosidl adds this field to an empty message, since C structs must not be empty.
        let r#type = msg::FieldType { type_id: msg::FieldType::FIELD_TYPE_UINT8, ..Default::default() };
        let name = "structure_needs_at_least_one_member".into();
        fields.push(msg::Field { name, r#type, ..Default::default() });
    }
    msg::IndividualTypeDescription { type_name: description.type_name.into(), fields }
}

fn field(field: &Field) -> msg::Field {
    msg::Field {
        name: field.name.into(),
        r#type: msg::FieldType {
            type_id: field.field_type.type_id(),
            capacity: field.field_type.capacity(),
            string_capacity: field.field_type.string_capacity(),
            nested_type_name: field.nested().map_or_else(String::new, |nested| nested.type_name.into()),
        },
        default_value: field.default_value.into(),
    }
}
