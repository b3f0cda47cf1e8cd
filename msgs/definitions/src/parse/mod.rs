//! From the text of a `.msg`, `.srv` or `.action` file to its definition.
//!
//! The grammar is that of `rosidl_adapter/parser.py`: one field or constant a line, a comment from the first `#` on
//! (quoted or not), tabs count as spaces. What is accepted beyond it: spaces before a type, and `=` within a default.

mod line;
pub(crate) mod literal;

use crate::{ActionDefinition, Error, Kind, MessageDefinition, Place, ServiceDefinition, TypeName};

/// Parses the text of a `.msg` file. `origin` names it in errors.
///
/// # Errors
/// [`Error::Syntax`] with the place of the first line that is not understood.
pub fn parse_message(name: TypeName, text: &str, origin: &str) -> Result<MessageDefinition, Error> {
    parse_message_from(name, text, origin, 1)
}

/// Parses the text of a `.srv` file. `origin` names it in errors.
///
/// # Errors
/// [`Error::Separators`] if request and response are not told apart, [`Error::Kind`] if the name is not that of a service,
/// [`Error::Syntax`] for any other fault.
pub fn parse_service(name: TypeName, text: &str, origin: &str) -> Result<ServiceDefinition, Error> {
    parse_service_from(name, text, origin, 1)
}

/// Parses the text of an `.action` file. `origin` names it in errors.
///
/// # Errors
/// [`Error::Separators`] if goal, result and feedback are not told apart, [`Error::Kind`] if the name is not that of an
/// action, [`Error::Syntax`] for any other fault.
pub fn parse_action(name: TypeName, text: &str, origin: &str) -> Result<ActionDefinition, Error> {
    parse_action_from(name, text, origin, 1)
}

/// As [`parse_message`], of a text whose first line is the line `first_line` of `origin`.
pub(crate) fn parse_message_from(
    name: TypeName,
    text: &str,
    origin: &str,
    first_line: usize,
) -> Result<MessageDefinition, Error> {
    line::parse_message(name, text, origin, first_line)
}

/// As [`parse_service`], of a part of a file.
pub(crate) fn parse_service_from(
    name: TypeName,
    text: &str,
    origin: &str,
    first_line: usize,
) -> Result<ServiceDefinition, Error> {
    check_kind(&name, Kind::Service, origin)?;
    let [request, response] =
        sections(text, origin, first_line, "a service is a request and a response", "one line `---`")?;
    Ok(ServiceDefinition {
        request: request.parse(name.with_suffix("_Request"), origin)?,
        response: response.parse(name.with_suffix("_Response"), origin)?,
        name,
        text: text.into(),
        origin: origin.into(),
    })
}

/// As [`parse_action`], of a part of a file.
pub(crate) fn parse_action_from(
    name: TypeName,
    text: &str,
    origin: &str,
    first_line: usize,
) -> Result<ActionDefinition, Error> {
    let [goal, result, feedback] = sections(
        text,
        origin,
        first_line,
        "an action is a goal, a result and a feedback",
        "two lines `---`",
    )?;
    Ok(ActionDefinition {
        goal: goal.parse(name.with_suffix("_Goal"), origin)?,
        result: result.parse(name.with_suffix("_Result"), origin)?,
        feedback: feedback.parse(name.with_suffix("_Feedback"), origin)?,
        name,
        text: text.into(),
        origin: origin.into(),
    })
}

fn check_kind(name: &TypeName, expected: Kind, origin: &str) -> Result<(), Error> {
    if name.kind == expected && !name.name.contains('_') {
        return Ok(());
    }
    Err(Error::Kind { origin: origin.into(), name: Box::new(name.clone()), expected: expected.as_str() })
}

/// One message of a file that holds several.
struct Section {
    first_line: usize,
    text: String,
}

impl Section {
    fn parse(&self, name: TypeName, origin: &str) -> Result<MessageDefinition, Error> {
        line::parse_message(name, &self.text, origin, self.first_line)
    }
}

fn sections<const N: usize>(
    text: &str,
    origin: &str,
    first_line: usize,
    what: &'static str,
    expected: &'static str,
) -> Result<[Section; N], Error> {
    let mut sections = vec![Section { first_line, text: String::new() }];
    let mut end = first_line;
    for (line, number) in text.lines().zip(first_line..) {
        end = number;
        if line == "---" {
            sections.push(Section { first_line: number + 1, text: String::new() });
        } else if let Some(section) = sections.last_mut() {
            section.text.push_str(line);
            section.text.push('\n');
        }
    }
    let found = sections.len() - 1;
    let line = sections.get(N).map_or(end, |surplus| surplus.first_line - 1);
    sections.try_into().map_err(|_| {
        let place = Place { origin: origin.into(), line, column: 1 };
        Error::Separators { place, what, expected, found }
    })
}

#[cfg(test)]
mod tests;
