//! Parses `.msg`, `.srv` and `.action` files.
//!
//! The grammar is that of `rosidl_adapter/parser.py`: one field or constant per line, a comment starts at the
//! first `#` (quoted or not), tabs count as spaces. In addition, spaces before a type and `=` within a
//! default are accepted.

mod line;
pub(crate) mod literal;
mod name;

use crate::{ActionDefinition, Error, Kind, MessageDefinition, Place, ServiceDefinition, TypeName};

/// Parses the text of a `.msg` file. `origin` names it in errors.
///
/// # Errors
/// [`Error::Syntax`] with the position of the first invalid line.
pub fn parse_message(name: TypeName, text: &str, origin: &str) -> Result<MessageDefinition, Error> {
    parse_message_from(name, text, Source::file(origin))
}

/// Parses the text of a `.srv` file. `origin` names it in errors.
///
/// # Errors
/// [`Error::Separators`] if request and response are not separated, [`Error::Kind`] if the name is not that
/// of a service, [`Error::Syntax`] for any other fault.
pub fn parse_service(name: TypeName, text: &str, origin: &str) -> Result<ServiceDefinition, Error> {
    parse_service_from(name, text, Source::file(origin))
}

/// Parses the text of an `.action` file. `origin` names it in errors.
///
/// # Errors
/// [`Error::Separators`] if goal, result and feedback are not separated, [`Error::Kind`] if the name is not
/// that of an action, [`Error::Syntax`] for any other fault.
pub fn parse_action(name: TypeName, text: &str, origin: &str) -> Result<ActionDefinition, Error> {
    parse_action_from(name, text, Source::file(origin))
}

/// The source of a text.
#[derive(Clone, Copy)]
pub(crate) struct Source<'a> {
    origin: &'a str,
    first_line: usize,
    names: Names,
}

/// The permitted names of fields and constants.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Names {
    /// Those that rosidl permits in files.
    OfFiles,
    /// Letters, digits and underscores, a letter first, as in IDL and ROS 1, so that bags of other recorders
    /// can be read.
    Any,
}

impl<'a> Source<'a> {
    /// A complete file.
    pub(crate) fn file(origin: &'a str) -> Self {
        Self { origin, first_line: 1, names: Names::OfFiles }
    }

    /// A definition text, or a part of one that starts at that line.
    pub(crate) fn definition_text(origin: &'a str, first_line: usize) -> Self {
        Self { origin, first_line, names: Names::Any }
    }

    fn place(self, line: usize, column: usize) -> Place {
        Place { origin: self.origin.into(), line, column }
    }
}

/// Like [`parse_message`], for a text from any source.
pub(crate) fn parse_message_from(
    name: TypeName,
    text: &str,
    source: Source<'_>,
) -> Result<MessageDefinition, Error> {
    line::parse_message(name, text, source)
}

/// Like [`parse_service`], for a text from any source.
pub(crate) fn parse_service_from(
    name: TypeName,
    text: &str,
    source: Source<'_>,
) -> Result<ServiceDefinition, Error> {
    check_kind(&name, Kind::Service, source)?;
    let [request, response] =
        sections(text, source, "a service is a request and a response", "one line `---`")?;
    Ok(ServiceDefinition {
        request: request.parse(name.with_suffix("_Request"), source)?,
        response: response.parse(name.with_suffix("_Response"), source)?,
        name,
        text: text.into(),
        origin: source.origin.into(),
    })
}

/// Like [`parse_action`], for a text from any source.
pub(crate) fn parse_action_from(
    name: TypeName,
    text: &str,
    source: Source<'_>,
) -> Result<ActionDefinition, Error> {
    let [goal, result, feedback] =
        sections(text, source, "an action is a goal, a result and a feedback", "two lines `---`")?;
    Ok(ActionDefinition {
        goal: goal.parse(name.with_suffix("_Goal"), source)?,
        result: result.parse(name.with_suffix("_Result"), source)?,
        feedback: feedback.parse(name.with_suffix("_Feedback"), source)?,
        name,
        text: text.into(),
        origin: source.origin.into(),
    })
}

fn check_kind(name: &TypeName, expected: Kind, source: Source<'_>) -> Result<(), Error> {
    if name.kind == expected && !name.name.contains('_') {
        return Ok(());
    }
    Err(Error::Kind {
        origin: source.origin.into(),
        name: Box::new(name.clone()),
        expected: expected.as_str(),
    })
}

/// One message of a file that holds several.
struct Section {
    first_line: usize,
    text: String,
}

impl Section {
    fn parse(&self, name: TypeName, source: Source<'_>) -> Result<MessageDefinition, Error> {
        line::parse_message(name, &self.text, Source { first_line: self.first_line, ..source })
    }
}

fn sections<const N: usize>(
    text: &str,
    source: Source<'_>,
    what: &'static str,
    expected: &'static str,
) -> Result<[Section; N], Error> {
    let mut sections = vec![Section { first_line: source.first_line, text: String::new() }];
    let mut end = source.first_line;
    for (line, number) in text.lines().zip(source.first_line..) {
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
    sections.try_into().map_err(|_| Error::Separators { place: source.place(line, 1), what, expected, found })
}

#[cfg(test)]
mod tests;
