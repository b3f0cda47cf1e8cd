//! Definitions from type descriptions, such as those a remote node returns.

use std::collections::{BTreeMap, HashSet};

use super::{FieldTypeDescription, IndividualTypeDescription, TypeDescription, primitive_of};
use crate::name::is_identifier;
use crate::{
    ActionDefinition, Catalog, Definition, Element, Error, Field, FieldType, Kind, MessageDefinition, Place,
    ServiceDefinition, Shape, TypeName, derived,
};

impl Catalog {
    /// Adds the types of a description; `origin` names it in errors. Descriptions have neither constants nor
    /// comments, and their defaults are ignored, so definitions from files contain more.
    ///
    /// # Errors
    /// [`Error::Description`] if it describes something that ROS 2 does not support; [`Error::DefinedTwice`]
    /// if a type already has a different definition, for example one with constants or defaults.
    ///
    /// # Examples
    /// ```
    /// use downbeat_msgs_definitions::{Catalog, TypeName};
    ///
    /// let mut theirs = Catalog::new();
    /// theirs.add_message("legs/msg/Leg".parse()?, "float64[<=6] angles\n", "Leg.msg")?;
    /// let name: TypeName = "legs/msg/Leg".parse()?;
    /// let description = theirs.type_description(&name)?;
    ///
    /// let mut ours = Catalog::new();
    /// ours.add_type_description(&description, "/walker")?;
    /// assert_eq!(ours.type_hash(&name)?, theirs.type_hash(&name)?);
    /// assert_eq!(ours.definition_text(&name)?, "float64[<=6] angles\n");
    /// # Ok::<(), downbeat_msgs_definitions::Error>(())
    /// ```
    pub fn add_type_description(&mut self, description: &TypeDescription, origin: &str) -> Result<(), Error> {
        let mut messages = BTreeMap::new();
        // Services and actions are described by their parts; their names are enough.
        let mut wholes = Vec::new();
        let all =
            [&description.type_description].into_iter().chain(&description.referenced_type_descriptions);
        for described in all {
            let name: TypeName = described.type_name.parse().map_err(|error: Error| Error::Description {
                origin: origin.into(),
                type_name: described.type_name.clone(),
                field: None,
                message: error.to_string(),
            })?;
            if is_whole(&name) {
                wholes.push(name);
            } else {
                messages.insert(name.clone(), message_of(name, described, origin)?);
            }
        }
        // Actions contain their services.
        let (actions, services): (Vec<TypeName>, Vec<TypeName>) =
            wholes.into_iter().partition(|name| name.kind == Kind::Action && !name.name.contains('_'));
        for name in actions {
            let [goal, result, feedback] =
                parts(&messages, &name, ["_Goal", "_Result", "_Feedback"], origin)?;
            let text = format!("{}---\n{}---\n{}", goal.text, result.text, feedback.text);
            let origin = origin.into();
            self.insert_definition(Definition::Action(ActionDefinition {
                name,
                goal,
                result,
                feedback,
                text,
                origin,
            }))?;
        }
        for name in services {
            let [request, response] = parts(&messages, &name, ["_Request", "_Response"], origin)?;
            let text = format!("{}---\n{}", request.text, response.text);
            let origin = origin.into();
            self.insert_definition(Definition::Service(ServiceDefinition {
                name,
                request,
                response,
                text,
                origin,
            }))?;
        }
        messages.into_values().try_for_each(|message| self.insert_definition(Definition::Message(message)))
    }
}

/// Returns whether it names a service or an action rather than a part of one.
fn is_whole(name: &TypeName) -> bool {
    let is_service_of_action = name.name.ends_with("_SendGoal") || name.name.ends_with("_GetResult");
    name.kind != Kind::Message && (!name.name.contains('_') || is_service_of_action)
}

fn parts<const N: usize>(
    messages: &BTreeMap<TypeName, MessageDefinition>,
    whole: &TypeName,
    suffixes: [&str; N],
    origin: &str,
) -> Result<[MessageDefinition; N], Error> {
    let found: Vec<MessageDefinition> =
        suffixes.iter().filter_map(|suffix| messages.get(&whole.with_suffix(suffix)).cloned()).collect();
    found.try_into().map_err(|_| Error::Description {
        origin: origin.into(),
        type_name: whole.to_string(),
        field: None,
        message: format!("requires descriptions of its parts: {}", suffixes.join(", ")),
    })
}

fn message_of(
    name: TypeName,
    described: &IndividualTypeDescription,
    origin: &str,
) -> Result<MessageDefinition, Error> {
    let mut fields = Vec::new();
    let mut names = HashSet::new();
    for (field, field_type) in &described.fields {
        let fault = |message: String| Error::Description {
            origin: origin.into(),
            type_name: described.type_name.clone(),
            field: Some(field.clone()),
            message,
        };
        if !is_identifier(field) {
            return Err(fault(
                "has an invalid name: expected letters, digits and underscores, a letter first".into(),
            ));
        }
        if !names.insert(field) {
            return Err(fault("is defined twice".into()));
        }
        let place = Place { origin: origin.into(), line: fields.len() + 1, column: 1 };
        let field_type = field_type_of(field_type).map_err(fault)?;
        fields.push(Field { name: field.clone(), field_type, default: None, comment: Vec::new(), place });
    }
    if let [(field, field_type)] = described.fields.as_slice()
        && field == super::PLACEHOLDER
        && *field_type == super::placeholder_type()
    {
        fields.clear();
    }
    let mut message = MessageDefinition {
        name,
        comment: Vec::new(),
        fields,
        constants: Vec::new(),
        text: String::new(),
        origin: origin.into(),
    };
    message.text = derived::of(&message);
    Ok(message)
}

fn field_type_of(described: &FieldTypeDescription) -> Result<FieldType, String> {
    let FieldTypeDescription { type_id, capacity, string_capacity, nested_type_name } = described;
    let size = |size: u64| match size {
        1..=0xffff_ffff => Ok(size),
        _ => Err(format!("has the size {size}, which must be from 1 to {}", u32::MAX)),
    };
    let (base, shape) = match type_id {
        0..=48 => (*type_id, Shape::Single),
        49..=96 => (type_id - 48, Shape::Array(size(*capacity)?)),
        97..=144 => (type_id - 96, Shape::Bounded(size(*capacity)?)),
        145.. => (type_id - 144, Shape::Sequence),
    };
    let element = match base {
        1 => match nested_type_name.parse() {
            Ok(name) => Element::Message(name),
            Err(error) => return Err(format!("has a type with an invalid name: {error}")),
        },
        17 => Element::String { bound: None },
        18 => Element::WString { bound: None },
        21 => Element::String { bound: Some(size(*string_capacity)?) },
        22 => Element::WString { bound: Some(size(*string_capacity)?) },
        _ => match primitive_of(base) {
            Some(primitive) => Element::Primitive(primitive),
            None => return Err(format!("has the type {type_id}, which no definition can express")),
        },
    };
    Ok(FieldType { element, shape })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::super::{FieldTypeDescription, IndividualTypeDescription, TypeDescription};
    use crate::{Catalog, TypeName};

    const EVERYTHING: &str = "bool a\nbyte b\nint8 c\nuint8 d\nint16[2] e\nuint16[] f\nint32[<=3] g\nuint32 h\nint64 i\nuint64 j\n\
                              float32 k\nfloat64 l\nstring m\nstring<=4 n\nwstring[] o\nwstring<=5[<=6] p\na/B[7] q\n";

    #[test]
    fn a_description_defines_the_same_types() {
        let mut theirs = Catalog::new();
        theirs.add_message("a/msg/B".parse().unwrap(), "", "").unwrap();
        theirs.add_message("a/msg/A".parse().unwrap(), EVERYTHING, "").unwrap();
        theirs.add_service("a/srv/S".parse().unwrap(), "B b\n---\nA a\n", "").unwrap();
        theirs.add_action("a/action/F".parse().unwrap(), "B b\n---\nA a\n---\n", "").unwrap();
        for (name, text) in crate::derived::IMPLIED {
            theirs.add_message(name.parse().unwrap(), text, "").unwrap();
        }
        for name in ["a/msg/A", "a/msg/B", "a/srv/S", "a/srv/S_Event", "a/action/F", "a/action/F_SendGoal"] {
            let name: TypeName = name.parse().unwrap();
            let description = theirs.type_description(&name).unwrap();
            let mut ours = Catalog::new();
            ours.add_type_description(&description, "node").unwrap();
            ours.check_type(&name).unwrap();
            assert_eq!(ours.type_description(&name).unwrap(), description);
            assert!(ours.definition_text(&name).is_ok());
        }
        let mut ours = Catalog::new();
        ours.add_type_description(&theirs.type_description(&"a/msg/A".parse().unwrap()).unwrap(), "node")
            .unwrap();
        assert_eq!(ours.message(&"a/msg/A".parse().unwrap()).unwrap().text, EVERYTHING);
    }

    #[test]
    fn what_no_definition_can_express_is_refused() {
        let of = |type_name: &str, name: &str, field: FieldTypeDescription| {
            let type_description =
                IndividualTypeDescription { type_name: type_name.into(), fields: vec![(name.into(), field)] };
            let description = TypeDescription { type_description, referenced_type_descriptions: Vec::new() };
            Catalog::new().add_type_description(&description, "node").unwrap_err().to_string()
        };
        let field =
            |type_id, capacity| FieldTypeDescription { type_id, capacity, ..FieldTypeDescription::default() };
        assert!(
            of("A", "x", field(2, 0))
                .starts_with("node: the description of `A` `A` is not an interface name")
        );
        for (name, field, fault) in [
            ("x\"", field(2, 0), "has an invalid name"),
            ("", field(2, 0), "has an invalid name"),
            ("x", field(0, 0), "has the type 0, which"),
            ("x", field(12, 0), "has the type 12, which"),
            ("x", field(255, 0), "has the type 255, which"),
            ("x", field(50, 0), "has the size 0, which must"),
            ("x", field(98, 1 << 32), "has the size 4294967296, which must"),
            ("x", field(21, 0), "has the size 0, which must"),
            ("x", field(1, 0), "has a type with an invalid name"),
        ] {
            let error = of("a/msg/A", name, field);
            let start = format!("node: the description of `a/msg/A`, field `{name}`, {fault}");
            assert!(error.starts_with(&start), "{error}");
        }
        assert_eq!(
            of("a/srv/S", "x", field(2, 0)),
            "node: the description of `a/srv/S` requires descriptions of its parts: _Request, _Response"
        );
    }
}
