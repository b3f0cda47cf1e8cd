//! Parses `.idl` files.
//!
//! It supports what `rosidl_adapter` writes and what occurs in `ros2idl` schemas: modules, structs, typedefs,
//! constants, arrays, sequences, bounded strings, and the annotations `@verbatim`, `@default` and `@unit`;
//! other annotations are ignored. Types that ROS 2 does not have (enumerations, unions, maps, arrays of
//! arrays, `char`, `long double`) are errors.
//!
//! # References
//! OMG IDL 4.2; `rosidl_parser/rosidl_parser/grammar.lark` and `rosidl_adapter/rosidl_adapter/resource/*.em`,
//! branch jazzy.

mod lexer;
mod literal;
mod parser;
mod types;

use std::collections::BTreeMap;

use crate::derived;
use crate::{ActionDefinition, Error, Kind, MessageDefinition, Place, ServiceDefinition, TypeName};

/// An interface of any kind.
#[derive(Clone, Debug, PartialEq)]
pub enum Definition {
    /// A message.
    Message(MessageDefinition),
    /// A service.
    Service(ServiceDefinition),
    /// An action.
    Action(ActionDefinition),
}

impl Definition {
    /// The number of fields and constants of its parts.
    pub(crate) fn members(&self) -> usize {
        let of = |message: &MessageDefinition| message.fields.len() + message.constants.len();
        match self {
            Self::Message(message) => of(message),
            Self::Service(service) => of(&service.request) + of(&service.response),
            Self::Action(action) => of(&action.goal) + of(&action.result) + of(&action.feedback),
        }
    }

    /// Its name.
    #[must_use]
    pub fn name(&self) -> &TypeName {
        match self {
            Self::Message(message) => &message.name,
            Self::Service(service) => &service.name,
            Self::Action(action) => &action.name,
        }
    }
}

/// Parses the text of an `.idl` file. `origin` names it in errors.
///
/// A struct in `module package { module msg {` is a message; in a module `srv` the structs `X_Request` and
/// `X_Response` are the service `X`; in a module `action` the structs `X_Goal`, `X_Result` and `X_Feedback`
/// are the action `X`.
///
/// The `text` of the definitions is that of an equivalent `.msg`, `.srv` or `.action` file without comments.
///
/// # Errors
/// [`Error::Syntax`] with the position of the first unexpected token.
///
/// # Examples
/// ```
/// use downbeat_msgs_definitions::{Definition, parse_idl};
///
/// let text = "module legs { module msg { struct Leg { sequence<double, 6> angles; }; }; };";
/// let [Definition::Message(leg)] = &parse_idl(text, "Leg.idl")?[..] else { unreachable!() };
/// assert_eq!(leg.name.to_string(), "legs/msg/Leg");
/// assert_eq!(leg.fields[0].field_type.to_string(), "float64[<=6]");
/// assert_eq!(leg.text, "float64[<=6] angles\n");
/// # Ok::<(), downbeat_msgs_definitions::Error>(())
/// ```
pub fn parse_idl(text: &str, origin: &str) -> Result<Vec<Definition>, Error> {
    parse_with(text, origin, 1, |name, place, parts| {
        Ok(vec![match name.kind {
            Kind::Action => action(name.clone(), place, parts)?,
            _ => service(name.clone(), place, parts)?,
        }])
    })
}

/// Like [`parse_idl`], for a part of a definition text. There, structs of services and actions need not be
/// complete: a text has those that its root refers to, including those that rosidl derives (`X_Event`,
/// `X_FeedbackMessage`).
pub(crate) fn parse_idl_from(text: &str, origin: &str, first_line: usize) -> Result<Vec<Definition>, Error> {
    let parts = |name: &TypeName, place: Place, parts: Vec<MessageDefinition>| {
        let suffixes: &[&str] = match name.kind {
            Kind::Action => &["_Goal", "_Result", "_Feedback"],
            _ => &["_Request", "_Response"],
        };
        let (given, derived): (Vec<_>, Vec<_>) = parts.into_iter().partition(|part| {
            part.name.name.strip_prefix(&name.name).is_some_and(|suffix| suffixes.contains(&suffix))
        });
        let mut definitions: Vec<Definition> = derived.into_iter().map(Definition::Message).collect();
        if given.len() == suffixes.len() {
            definitions.push(match name.kind {
                Kind::Action => action(name.clone(), place, given)?,
                _ => service(name.clone(), place, given)?,
            });
        } else {
            definitions.extend(given.into_iter().map(Definition::Message));
        }
        Ok(definitions)
    };
    parse_with(text, origin, first_line, parts)
}

/// `whole` makes definitions of the structs of a service or an action.
fn parse_with(
    text: &str,
    origin: &str,
    first_line: usize,
    whole: impl Fn(&TypeName, Place, Vec<MessageDefinition>) -> Result<Vec<Definition>, Error>,
) -> Result<Vec<Definition>, Error> {
    let structs = parser::parse(text, origin, first_line)?;
    let mut definitions = Vec::new();
    // Services and actions by name: the position of the first part, and the parts.
    let mut wholes: BTreeMap<TypeName, (Place, Vec<MessageDefinition>)> = BTreeMap::new();
    for parser::Struct { mut message, place } in structs {
        message.text = derived::of(&message);
        if message.name.kind == Kind::Message {
            definitions.push(Definition::Message(message));
            continue;
        }
        let stem = message.name.name.split('_').next().unwrap_or_default();
        let name = TypeName::new(&message.name.package, message.name.kind, stem);
        wholes.entry(name).or_insert_with(|| (place, Vec::new())).1.push(message);
    }
    for (name, (place, parts)) in wholes {
        definitions.extend(whole(&name, place, parts)?);
    }
    Ok(definitions)
}

fn service(name: TypeName, place: Place, parts: Vec<MessageDefinition>) -> Result<Definition, Error> {
    let [request, response] = ordered(&name, ["_Request", "_Response"], &place, parts)?;
    Ok(Definition::Service(ServiceDefinition {
        text: format!("{}---\n{}", request.text, response.text),
        request,
        response,
        name,
        origin: place.origin,
    }))
}

fn action(name: TypeName, place: Place, parts: Vec<MessageDefinition>) -> Result<Definition, Error> {
    let [goal, result, feedback] = ordered(&name, ["_Goal", "_Result", "_Feedback"], &place, parts)?;
    Ok(Definition::Action(ActionDefinition {
        text: format!("{}---\n{}---\n{}", goal.text, result.text, feedback.text),
        goal,
        result,
        feedback,
        name,
        origin: place.origin,
    }))
}

fn ordered<const N: usize>(
    name: &TypeName,
    suffixes: [&str; N],
    place: &Place,
    mut parts: Vec<MessageDefinition>,
) -> Result<[MessageDefinition; N], Error> {
    let fault = || Error::Syntax {
        place: place.clone(),
        message: format!(
            "{name} needs exactly the structs {}",
            suffixes.map(|suffix| format!("`{}{suffix}`", name.name)).join(", ")
        ),
    };
    let position = |part: &MessageDefinition| {
        suffixes.iter().position(|suffix| part.name.name.strip_suffix(suffix) == Some(name.name.as_str()))
    };
    if parts.iter().any(|part| position(part).is_none()) {
        return Err(fault());
    }
    // The parser ensures that names are distinct, so N parts are the N expected ones.
    parts.sort_by_key(position);
    parts.try_into().map_err(|_| fault())
}

#[cfg(test)]
mod tests;
