//! Messages and services that rosidl derives from services and actions.
//!
//! # References
//! `rosidl_parser/rosidl_parser/definition.py`, branch jazzy: the classes `Service` and `Action`.

use crate::{
    ActionDefinition, Constant, Element, Field, FieldType, Kind, MessageDefinition, Place, Primitive,
    ServiceDefinition, Shape, TypeName, Value,
};

/// The message that service introspection publishes: who and when, and the request or response if contents
/// are enabled.
pub(crate) fn event_of(service: &ServiceDefinition) -> MessageDefinition {
    let info = TypeName::new("service_msgs", Kind::Message, "ServiceEventInfo");
    let content = |message: &MessageDefinition| FieldType {
        element: Element::Message(message.name.clone()),
        shape: Shape::Bounded(1),
    };
    let fields = vec![
        ("info", single(Element::Message(info))),
        ("request", content(&service.request)),
        ("response", content(&service.response)),
    ];
    message(service.name.with_suffix("_Event"), fields, &service.origin)
}

/// The services and the message with which the two ends of an action communicate.
pub(crate) struct ActionParts {
    /// `<name>_SendGoal`.
    pub(crate) send_goal: ServiceDefinition,
    /// `<name>_GetResult`.
    pub(crate) get_result: ServiceDefinition,
    /// `<name>_FeedbackMessage`.
    pub(crate) feedback_message: MessageDefinition,
}

pub(crate) fn parts_of(action: &ActionDefinition) -> ActionParts {
    let goal_id = || {
        ("goal_id", single(Element::Message(TypeName::new("unique_identifier_msgs", Kind::Message, "UUID"))))
    };
    let stamp = Element::Message(TypeName::new("builtin_interfaces", Kind::Message, "Time"));
    let part = |message: &MessageDefinition| single(Element::Message(message.name.clone()));
    let origin = &action.origin;
    ActionParts {
        send_goal: service(
            action.name.with_suffix("_SendGoal"),
            vec![goal_id(), ("goal", part(&action.goal))],
            vec![("accepted", single(Element::Primitive(Primitive::Bool))), ("stamp", single(stamp))],
            origin,
        ),
        get_result: service(
            action.name.with_suffix("_GetResult"),
            vec![goal_id()],
            vec![("status", single(Element::Primitive(Primitive::Int8))), ("result", part(&action.result))],
            origin,
        ),
        feedback_message: message(
            action.name.with_suffix("_FeedbackMessage"),
            vec![goal_id(), ("feedback", part(&action.feedback))],
            origin,
        ),
    }
}

/// Types used by the parts above that the definition texts of services and actions leave out.
pub(crate) const IMPLIED: [(&str, &str); 3] = [
    (
        "service_msgs/msg/ServiceEventInfo",
        "uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\nint64 sequence_number\n",
    ),
    ("unique_identifier_msgs/msg/UUID", "uint8[16] uuid\n"),
    ("builtin_interfaces/msg/Time", "int32 sec\nuint32 nanosec\n"),
];

type Member = (&'static str, FieldType);

fn single(element: Element) -> FieldType {
    FieldType { element, shape: Shape::Single }
}

fn service(name: TypeName, request: Vec<Member>, response: Vec<Member>, origin: &str) -> ServiceDefinition {
    let request = message(name.with_suffix("_Request"), request, origin);
    let response = message(name.with_suffix("_Response"), response, origin);
    ServiceDefinition {
        text: format!("{}---\n{}", request.text, response.text),
        request,
        response,
        name,
        origin: origin.into(),
    }
}

/// A message with the text that its author would have written.
fn message(name: TypeName, members: Vec<Member>, origin: &str) -> MessageDefinition {
    let text = members.iter().map(|(field, field_type)| format!("{field_type} {field}\n")).collect();
    let place = Place { origin: origin.into(), line: 1, column: 1 };
    let fields = members.into_iter().map(|(field, field_type)| Field {
        name: field.into(),
        field_type,
        default: None,
        comment: Vec::new(),
        place: place.clone(),
    });
    MessageDefinition {
        name,
        comment: Vec::new(),
        fields: fields.collect(),
        constants: Vec::new(),
        text,
        origin: origin.into(),
    }
}

/// Constants and fields, one per line. A constant or default that a `.msg` file cannot express (a string with
/// `#` or control characters, which IDL permits) is left out.
pub(crate) fn of(message: &MessageDefinition) -> String {
    let constants = message.constants.iter().filter_map(constant);
    constants.chain(message.fields.iter().map(field)).collect()
}

fn constant(constant: &Constant) -> Option<String> {
    let element = FieldType { element: constant.element.clone(), shape: Shape::Single };
    Some(format!("{element} {}={}\n", constant.name, literal(&constant.value)?))
}

fn field(field: &Field) -> String {
    let Field { field_type, name, default, .. } = field;
    match default.as_ref().and_then(literal) {
        Some(value) => format!("{field_type} {name} {value}\n"),
        None => format!("{field_type} {name}\n"),
    }
}

fn literal(value: &Value) -> Option<String> {
    Some(match value {
        Value::Bool(value) => value.to_string(),
        Value::Integer(value) => value.to_string(),
        Value::Float(value) => format!("{value:?}"),
        Value::Text(text) if text.contains(|c: char| c == '#' || c.is_control()) => return None,
        Value::Text(text) => {
            let quote = if text.contains('"') && !text.contains('\'') { '\'' } else { '"' };
            format!("{quote}{}{quote}", text.replace(quote, &format!("\\{quote}")))
        }
        Value::List(values) => {
            // In a list, backslashes occur only before quotes.
            let is_plain = |value: &&Value| !matches!(value, Value::Text(text) if text.contains('\\'));
            let items = values.iter().map(|value| literal(Some(value).filter(is_plain)?));
            format!("[{}]", items.collect::<Option<Vec<_>>>()?.join(", "))
        }
    })
}

/// Removes the bound of a string: constants have no bounds.
pub(crate) fn without_bound(element: Element) -> Element {
    match element {
        Element::String { .. } => Element::String { bound: None },
        Element::WString { .. } => Element::WString { bound: None },
        other => other,
    }
}
