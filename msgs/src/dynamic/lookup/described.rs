//! Definitions from replies to `get_type_description`.

use std::collections::BTreeMap;

use downbeat_msgs_definitions::{
    Catalog, Error, FieldTypeDescription, IndividualTypeDescription, Kind, TypeDescription, TypeName,
};

use super::{DefinitionSource, Found, find_complete};
use crate::carried;
use crate::dynamic::TypeError;
use crate::dynamic::compile::catalog_of;
use crate::type_description_interfaces::msg;

/// Types that remote nodes have described.
///
/// ```
/// use downbeat_msgs::definitions::TypeName;
/// use downbeat_msgs::dynamic::{Definitions, DescribedTypes};
/// use downbeat_msgs::type_description_interfaces::msg::TypeDescription;
///
/// // What a node would answer; the hash comes with the topic.
/// let name: TypeName = "std_msgs/msg/Header".parse()?;
/// let ours = downbeat_msgs::carried().type_description(&name)?;
/// let (answer, hash) = (TypeDescription::from(&ours), ours.hash());
///
/// let mut described = DescribedTypes::new("/camera");
/// described.add(&answer, &hash)?;
/// assert!(Definitions::new().with(described).find("std_msgs/msg/Header").is_ok());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// Descriptions have no constants; their defaults are ignored.
#[derive(Clone, Debug, Default)]
pub struct DescribedTypes {
    description: String,
    catalogs: BTreeMap<TypeName, Catalog>,
}

impl DescribedTypes {
    /// Starts without types; `description` names the node in errors.
    #[must_use]
    pub fn new(description: &str) -> Self {
        Self { description: description.into(), catalogs: BTreeMap::new() }
    }

    /// Adds a type described by a node. `announced` is the RIHS01 hash of the requested type, as announced by
    /// the endpoint of the topic or sent in the request.
    ///
    /// # Errors
    /// Returns an error if the description is invalid, or its hash differs.
    pub fn add(&mut self, description: &msg::TypeDescription, announced: &str) -> Result<(), TypeError> {
        let described = TypeDescription::from(description);
        let found = described.hash();
        let type_name = &described.type_description.type_name;
        if found != announced {
            return Err(TypeError::Hash { name: type_name.clone(), expected: announced.into(), found });
        }
        let name: TypeName = type_name.parse()?;
        let mut catalog = Catalog::new();
        catalog.add_type_description(&described, &self.description)?;
        self.catalogs.insert(name, catalog);
        Ok(())
    }
}

impl DefinitionSource for DescribedTypes {
    fn description(&self) -> String {
        self.description.clone()
    }

    fn find(&self, name: &TypeName) -> Result<Found<'_>, Error> {
        Ok(find_complete(&self.catalogs, name, "it has described"))
    }
}

impl From<&msg::TypeDescription> for TypeDescription {
    /// Without default values, which are not part of a type's hash.
    fn from(message: &msg::TypeDescription) -> Self {
        Self {
            type_description: individual(&message.type_description),
            referenced_type_descriptions: message
                .referenced_type_descriptions
                .iter()
                .map(individual)
                .collect(),
        }
    }
}

impl From<&TypeDescription> for msg::TypeDescription {
    /// A node's reply; default values are empty.
    fn from(description: &TypeDescription) -> Self {
        let referenced = description.referenced_type_descriptions.iter();
        Self {
            type_description: individual_message(&description.type_description),
            referenced_type_descriptions: referenced.map(individual_message).collect(),
        }
    }
}

fn individual(message: &msg::IndividualTypeDescription) -> IndividualTypeDescription {
    let fields = message.fields.iter().map(|field| {
        let of = &field.r#type;
        let field_type = FieldTypeDescription {
            type_id: of.type_id,
            capacity: of.capacity,
            string_capacity: of.string_capacity,
            nested_type_name: of.nested_type_name.clone(),
        };
        (field.name.clone(), field_type)
    });
    IndividualTypeDescription { type_name: message.type_name.clone(), fields: fields.collect() }
}

fn individual_message(description: &IndividualTypeDescription) -> msg::IndividualTypeDescription {
    let fields = description.fields.iter().map(|(name, of)| msg::Field {
        name: name.clone(),
        r#type: msg::FieldType {
            type_id: of.type_id,
            capacity: of.capacity,
            string_capacity: of.string_capacity,
            nested_type_name: of.nested_type_name.clone(),
        },
        default_value: String::new(),
    });
    msg::IndividualTypeDescription { type_name: description.type_name.clone(), fields: fields.collect() }
}

/// The schemas of a bag, or of another source of complete definition texts.
///
/// Schemas are independent of each other: a bag may have been merged from bags with different definitions of
/// the same message.
#[derive(Clone, Debug, Default)]
pub struct Schemas {
    description: String,
    catalogs: BTreeMap<TypeName, Catalog>,
}

impl Schemas {
    /// Starts without schemas; `description` names their source in errors.
    #[must_use]
    pub fn new(description: &str) -> Self {
        Self { description: description.into(), catalogs: BTreeMap::new() }
    }

    /// Adds the definition text of a type; `encoding` is `ros2msg` or `ros2idl`, or `unknown` for the schema
    /// of a service's events. It replaces an existing one.
    ///
    /// # Errors
    /// Returns an error if the name, the encoding or the text is invalid.
    pub fn add(&mut self, name: &str, encoding: &str, text: &str) -> Result<(), Error> {
        let name: TypeName = name.parse()?;
        let mut catalog = catalog_of(&name, encoding, text, &format!("{}, {name}", self.description))?;
        if name.kind != Kind::Message {
            // The text of a service or an action lacks what only its derived messages refer to.
            let messages: Vec<TypeName> = catalog.messages().map(|message| message.name.clone()).collect();
            for missing in
                messages.iter().flat_map(|message| catalog.missing_for(message)).collect::<Vec<_>>()
            {
                catalog.add_missing_from(carried(), &missing);
            }
        }
        self.catalogs.insert(name, catalog);
        Ok(())
    }
}

impl DefinitionSource for Schemas {
    fn description(&self) -> String {
        self.description.clone()
    }

    fn find(&self, name: &TypeName) -> Result<Found<'_>, Error> {
        Ok(find_complete(&self.catalogs, name, "it has"))
    }
}
