//! The definitions of recorded types: what a bag says, completed by what is known elsewhere.

use std::collections::BTreeMap;

use downbeat_msgs_definitions::{Catalog, DefinitionEncoding, Element, MessageDefinition, TypeName};

use super::{Definitions, TypeDefinition, TypeLookupError, unusable};
use crate::dynamic::{DynamicType, TypeError};

/// The name of the bag's own text in errors.
const TEXT: &str = "its definition text";

/// The definition of a recorded type.
#[derive(Clone, Debug)]
pub struct RecordedDefinition {
    /// The type, with the complete text.
    pub definition: TypeDefinition,
    /// What was taken from elsewhere and why, as a sentence; `None` if the recorded text is complete.
    pub taken: Option<String>,
}

impl Definitions {
    /// The definition of a type of which a bag has a text, perhaps an incomplete or damaged one, and perhaps
    /// the hash.
    ///
    /// A text that is complete is used as it is, unless it has another hash than the recorded one and a
    /// source has the latter. If it lacks types that it refers to, they are taken from these sources; if it
    /// cannot be read, or there is none, the whole definition is. What is taken has to agree with the hash
    /// or, without a hash, with the fields that could be read. `encoding` is that of the text in the bag,
    /// empty if there is none.
    ///
    /// # Errors
    /// Returns an error if the text is not a definition and no source has one that agrees.
    ///
    /// # Examples
    /// ```
    /// use downbeat_msgs::dynamic::Definitions;
    ///
    /// let known = Definitions::new().with_carried();
    /// let text = "std_msgs/Header header\nfloat64[] angles\n";
    /// let found = known.recorded("legs/msg/Leg", "ros2msg", text, "")?;
    /// assert!(found.definition.text.contains("MSG: std_msgs/Header"));
    /// assert!(found.taken.is_some_and(|taken| taken.contains("std_msgs/msg/Header")));
    /// # Ok::<(), downbeat_msgs::dynamic::TypeLookupError>(())
    /// ```
    pub fn recorded(
        &self,
        name: &str,
        encoding: &str,
        text: &str,
        hash: &str,
    ) -> Result<RecordedDefinition, TypeLookupError> {
        let name: TypeName = name.parse().map_err(|error| TypeLookupError::Name(Box::new(error)))?;
        if text.is_empty() {
            return self.without_text(&name, encoding, hash);
        }
        let is_idl = encoding == "ros2idl";
        let language = if is_idl { DefinitionEncoding::Ros2Idl } else { DefinitionEncoding::Ros2Msg };
        let mut catalog = Catalog::new();
        let mut faults = catalog.add_readable_definitions(&name, language, text, TEXT);
        let read =
            if faults.is_empty() { compiled(&catalog, &name) } else { Err(faults.swap_remove(0).into()) };
        let problem = match read {
            Ok(definition) => {
                let is_other = !hash.is_empty() && definition.hash != hash;
                let found = Some(&name).filter(|_| is_other).and_then(|name| self.whole(name).ok());
                let found = found.filter(|(found, _)| found.hash == hash);
                return Ok(found.map_or(RecordedDefinition { definition, taken: None }, |(definition, place)| {
                    let taken = format!("the definition of {name} with the recorded hash, which that of its text is not, is taken from {place}");
                    RecordedDefinition { definition, taken: Some(taken) }
                }));
            }
            Err(problem) => problem,
        };
        let own = catalog.message(&name).ok().cloned();
        if let Some(found) = self.completed(&name, catalog, hash) {
            return Ok(found);
        }
        let agrees = |definition: &TypeDefinition| match (hash, &own) {
            ("", None) => true,
            ("", Some(own)) => has_fields_of(&definition.message_type, own),
            (hash, _) => definition.hash == hash,
        };
        match self.whole(&name) {
            Ok((definition, place)) if agrees(&definition) => {
                let taken = format!("the definition of {name} is taken from {place}: {problem}");
                Ok(RecordedDefinition { definition, taken: Some(taken) })
            }
            _ => Err(unusable(&name, TEXT, problem)),
        }
    }

    /// Without a text, or with an empty one, which is the definition of an empty message that no source
    /// knows.
    fn without_text(
        &self,
        name: &TypeName,
        encoding: &str,
        hash: &str,
    ) -> Result<RecordedDefinition, TypeLookupError> {
        let found = self.whole(name).and_then(|(definition, place)| {
            if !hash.is_empty() && definition.hash != hash {
                let (expected, found) = (hash.to_owned(), definition.hash);
                return Err(unusable(
                    name,
                    &place,
                    TypeError::Hash { name: name.to_string(), expected, found },
                ));
            }
            let taken =
                Some(format!("the definition of {name}, of which there is no text, is taken from {place}"));
            Ok(RecordedDefinition { definition, taken })
        });
        let mut catalog = Catalog::new();
        match found {
            Err(_) if encoding == "ros2msg" && catalog.add_message(name.clone(), "", TEXT).is_ok() => {
                let empty =
                    compiled(&catalog, name).ok().filter(|empty| hash.is_empty() || empty.hash == hash);
                empty.map_or(found, |definition| Ok(RecordedDefinition { definition, taken: None }))
            }
            Ok(mut found)
                if encoding == "ros2msg" && found.definition.message_type.fields().next().is_none() =>
            {
                found.taken = None;
                Ok(found)
            }
            found => found,
        }
    }

    /// The definition with the types that it lacks; `None` if that does not make a type with this hash.
    fn completed(&self, name: &TypeName, mut catalog: Catalog, hash: &str) -> Option<RecordedDefinition> {
        let mut taken: BTreeMap<String, Vec<String>> = BTreeMap::new();
        catalog.message(name).ok()?;
        let missing = catalog.missing_for(name);
        for wanted in &missing {
            let (_, place, found) = self.gather(&wanted.to_string()).ok()?;
            catalog.add_missing_from(&found, wanted);
            taken.entry(place).or_default().push(wanted.to_string());
        }
        let definition = compiled(&catalog, name).ok()?;
        if taken.is_empty() || (!hash.is_empty() && definition.hash != hash) {
            return None;
        }
        let places: Vec<String> =
            taken.iter().map(|(place, names)| format!("{} from {place}", names.join(", "))).collect();
        let taken = format!("the definition of {name} lacks types, which are taken: {}", places.join("; "));
        Some(RecordedDefinition { definition, taken: Some(taken) })
    }

    /// The whole definition from a source, and the name of the source.
    fn whole(&self, name: &TypeName) -> Result<(TypeDefinition, String), TypeLookupError> {
        let (name, place, catalog) = self.gather(&name.to_string())?;
        let definition = compiled(&catalog, &name).map_err(|problem| unusable(&name, &place, problem))?;
        Ok((definition, place))
    }
}

fn compiled(catalog: &Catalog, name: &TypeName) -> Result<TypeDefinition, TypeError> {
    Ok(TypeDefinition {
        message_type: DynamicType::new(catalog, name)?,
        text: catalog.definition_text(name)?,
        hash: catalog.type_hash(name)?,
    })
}

/// Whether both have fields of the same names and types.
fn has_fields_of(of: &DynamicType, definition: &MessageDefinition) -> bool {
    let fields: Vec<_> = of.fields().collect();
    fields.len() == definition.fields.len()
        && fields.iter().zip(&definition.fields).all(|(one, two)| {
            let (one_type, two_type) = (one.field_type, &two.field_type);
            let is_same_element = match (&one_type.element, &two_type.element) {
                (Element::Primitive(one), Element::Primitive(two)) => one.type_id() == two.type_id(),
                (one, two) => one == two,
            };
            one.name == two.name && one_type.shape == two_type.shape && is_same_element
        })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use crate::Message;
    use crate::dynamic::Definitions;
    use crate::nav_msgs::msg::Path;
    use crate::std_msgs::msg::{Empty, Header};
    use crate::std_srvs::srv::SetBoolEvent;

    fn known() -> Definitions {
        Definitions::new().with_carried()
    }

    #[test]
    fn a_text_without_its_nested_types_is_completed() {
        let own = Path::DEFINITION.split("\n=====").next().unwrap();
        for hash in ["", Path::TYPE_HASH] {
            let found = known().recorded(Path::TYPE_NAME, "ros2msg", own, hash).unwrap();
            assert_eq!(found.definition.hash, Path::TYPE_HASH);
            let taken = found.taken.unwrap();
            assert!(taken.contains("geometry_msgs/msg/PoseStamped") && taken.contains("built-in"), "{taken}");
        }
        // Of a user's type, as long as the hash does not say otherwise.
        let text = "std_msgs/Header header\nint8 n\n";
        assert!(known().recorded("my_msgs/msg/A", "ros2msg", text, "").is_ok());
        let error =
            known().recorded("my_msgs/msg/A", "ros2msg", text, Path::TYPE_HASH).unwrap_err().to_string();
        assert!(
            error.contains("unknown type `std_msgs/msg/Header`") || error.contains("std_msgs/msg/Header"),
            "{error}"
        );
    }

    #[test]
    fn a_text_that_is_no_definition_gives_way_to_one_that_agrees() {
        for text in ["\u{0}garbage", "int7 x\n", "std_msgs/Header header\n\n====\nnonsense", "a b c d"] {
            for hash in ["", Header::TYPE_HASH] {
                let found = known().recorded(Header::TYPE_NAME, "ros2msg", text, hash).unwrap();
                assert!(found.taken.is_some() && found.definition.hash == Header::TYPE_HASH);
            }
            assert!(known().recorded(Header::TYPE_NAME, "ros2msg", text, Path::TYPE_HASH).is_err(), "{text}");
            assert!(known().recorded("my_msgs/msg/A", "ros2msg", text, "").is_err(), "{text}");
        }
        // Fields that can be read count.
        let other = "int8 x\nmy_msgs/Lost y\n";
        assert!(known().recorded(Header::TYPE_NAME, "ros2msg", other, "").is_err());
    }

    #[test]
    fn the_text_of_a_service_file_defines_its_event() {
        for text in [
            "bool data # on\n---\nbool success\nstring message\n",
            "bool data\n---\nbool success\nstring mess",
        ] {
            let found =
                known().recorded(SetBoolEvent::TYPE_NAME, "ros2msg", text, SetBoolEvent::TYPE_HASH).unwrap();
            assert_eq!(found.definition.hash, SetBoolEvent::TYPE_HASH, "{text}");
            assert_eq!(found.taken.is_none(), text.ends_with("message\n"), "{text}");
        }
    }

    #[test]
    fn an_empty_text_defines_an_empty_message_that_nobody_knows() {
        let found = known().recorded("my_msgs/msg/Nothing", "ros2msg", "", "").unwrap();
        assert!(found.taken.is_none() && found.definition.message_type.fields().next().is_none());
        assert!(known().recorded("my_msgs/msg/Nothing", "", "", "").is_err());
        assert!(known().recorded("my_msgs/msg/Nothing", "ros2msg", "", Header::TYPE_HASH).is_err());
        assert!(known().recorded(Empty::TYPE_NAME, "ros2msg", "", "").unwrap().taken.is_none());
        let header = known().recorded(Header::TYPE_NAME, "ros2msg", "", "").unwrap();
        assert!(header.taken.is_some() && header.definition.hash == Header::TYPE_HASH);
    }
}
