//! Reads definition texts from bags and other sources.

use std::str::FromStr;

use super::is_rule;
use crate::definition::MOST_MEMBERS_OF_TEXT;
use crate::derived::IMPLIED;
use crate::idl::parse_idl_from;
use crate::parse::{Source, parse_action_from, parse_message_from, parse_service_from};
use crate::{Catalog, Definition, Element, Error, Kind, Place, TypeName};

/// The language of a definition text, named as in bags.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DefinitionEncoding {
    /// `ros2msg`: the language of `.msg` files.
    Ros2Msg,
    /// `ros2idl`: the language of `.idl` files.
    Ros2Idl,
}

impl DefinitionEncoding {
    /// `ros2msg` or `ros2idl`.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Ros2Msg => "ros2msg",
            Self::Ros2Idl => "ros2idl",
        }
    }
}

impl FromStr for DefinitionEncoding {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let known = [Self::Ros2Msg, Self::Ros2Idl];
        known.into_iter().find(|of| of.as_str() == text).ok_or_else(|| Error::Encoding(text.into()))
    }
}

impl Catalog {
    /// Adds the definitions in a definition text: the type `name` and, after lines of `=`, its dependencies.
    /// Such a line is followed by `MSG: package/Type`, `SRV: package/srv/Type`, `ACTION: package/action/Type`
    /// or `IDL: package/msg/Type`.
    ///
    /// Fields and constants may have any name, as in IDL and ROS 1.
    ///
    /// A text that starts with such a line defines what that line names: for service events, rosbag2 stores
    /// the service. Types that it leaves out, such as `service_msgs/msg/ServiceEventInfo`, are added.
    ///
    /// # Errors
    /// Returns an error if a part is not a definition, or a name already has a different definition. Line
    /// numbers count from the top of the text.
    ///
    /// # Examples
    /// ```
    /// use downbeat_msgs_definitions::{Catalog, DefinitionEncoding, TypeName};
    ///
    /// let text = format!("Leg[] legs\n\n{}\nMSG: legs/Leg\nfloat64[] angles\n", "=".repeat(80));
    /// let name: TypeName = "legs/msg/Legs".parse()?;
    /// let mut catalog = Catalog::new();
    /// catalog.add_definition_text(&name, DefinitionEncoding::Ros2Msg, &text, "walk.mcap")?;
    /// catalog.check_type(&name)?;
    /// assert_eq!(catalog.definition_text(&name)?, text);
    /// # Ok::<(), downbeat_msgs_definitions::Error>(())
    /// ```
    pub fn add_definition_text(
        &mut self,
        name: &TypeName,
        encoding: DefinitionEncoding,
        text: &str,
        origin: &str,
    ) -> Result<(), Error> {
        let mut members = 0;
        for block in blocks(text, origin)? {
            self.add_block(name, encoding, block, origin, &mut members)?;
        }
        self.add_implied()
    }

    /// Like [`Catalog::add_definition_text`], for a text that may be damaged: adds the parts of it that are
    /// definitions, and returns the errors of the others.
    pub fn add_readable_definitions(
        &mut self,
        name: &TypeName,
        encoding: DefinitionEncoding,
        text: &str,
        origin: &str,
    ) -> Vec<Error> {
        let mut errors = Vec::new();
        match blocks(text, origin) {
            Ok(blocks) => {
                let mut members = 0;
                for block in blocks {
                    errors.extend(self.add_block(name, encoding, block, origin, &mut members).err());
                }
            }
            Err(error) => errors.push(error),
        }
        errors.extend(self.add_implied().err());
        errors
    }

    fn add_block(
        &mut self,
        root: &TypeName,
        encoding: DefinitionEncoding,
        block: Block<'_>,
        origin: &str,
        members: &mut usize,
    ) -> Result<(), Error> {
        if *members > MOST_MEMBERS_OF_TEXT {
            return Err(Error::Syntax {
                place: Place { origin: origin.into(), line: block.first_line, column: 1 },
                message: format!(
                    "a text of more than {MOST_MEMBERS_OF_TEXT} fields and constants is not supported"
                ),
            });
        }
        let (keyword, name) = match block.head {
            Some(head) => head,
            None => Keyword::of(root, encoding, block.text),
        };
        let definitions = keyword.parse(name, block.text, origin, block.first_line)?;
        *members += definitions.iter().map(Definition::members).sum::<usize>();
        definitions.into_iter().try_for_each(|definition| self.insert_definition(definition))
    }

    /// Adds types that parts of services and actions refer to, if they are missing.
    fn add_implied(&mut self) -> Result<(), Error> {
        for (name, text) in IMPLIED {
            let name: TypeName = name.parse()?;
            let element = Element::Message(name.clone());
            let is_referred_to = self
                .messages()
                .flat_map(|message| &message.fields)
                .any(|field| field.field_type.element == element);
            if is_referred_to && self.find_message(&name).is_none() {
                self.add_message(name, text, "implied by services and actions")?;
            }
        }
        Ok(())
    }
}

/// The kind of a block.
#[derive(Clone, Copy)]
enum Keyword {
    Message,
    Service,
    Action,
    Idl,
}

impl Keyword {
    /// The kind of a block without a header, and the name of what it defines. A part of a service or an
    /// action is a message itself, unless the text is that of the whole file.
    fn of(name: &TypeName, encoding: DefinitionEncoding, text: &str) -> (Self, TypeName) {
        let is_whole = !name.name.contains('_') || text.lines().any(|line| line == "---");
        let keyword = match name.kind {
            _ if encoding == DefinitionEncoding::Ros2Idl => Self::Idl,
            Kind::Service if is_whole => Self::Service,
            Kind::Action if is_whole => Self::Action,
            _ => return (Self::Message, name.clone()),
        };
        let stem = name.name.split('_').next().unwrap_or_default();
        (keyword, TypeName::new(&name.package, name.kind, stem))
    }

    fn parse(self, name: TypeName, text: &str, origin: &str, line: usize) -> Result<Vec<Definition>, Error> {
        let source = Source::definition_text(origin, line);
        Ok(vec![match self {
            Self::Message => Definition::Message(parse_message_from(name, text, source)?),
            Self::Service => Definition::Service(parse_service_from(name, text, source)?),
            Self::Action => Definition::Action(parse_action_from(name, text, source)?),
            Self::Idl => return parse_idl_from(text, origin, line),
        }])
    }
}

struct Block<'a> {
    /// Usually `None` for the first block.
    head: Option<(Keyword, TypeName)>,
    text: &'a str,
    first_line: usize,
}

fn blocks<'a>(text: &'a str, origin: &str) -> Result<Vec<Block<'a>>, Error> {
    let mut blocks = Vec::new();
    let (mut head, mut start, mut first_line) = (None, 0, 1);
    let mut at = 0;
    let mut lines = text.split_inclusive('\n').enumerate();
    while let Some((index, line)) = lines.next() {
        let rule_at = at;
        at += line.len();
        if !is_rule(line) {
            continue;
        }
        // The line break before the rule belongs to the rule. If a text starts with a rule, nothing precedes
        // it.
        if head.is_some() || rule_at > 0 {
            let text = &text[start..rule_at];
            let text = text.strip_suffix('\n').map_or(text, |text| text.strip_suffix('\r').unwrap_or(text));
            blocks.push(Block { head: head.take(), text, first_line });
        }
        let line = lines.next().map_or("", |(_, line)| line);
        at += line.len();
        head = Some(parse_head(line, origin, index + 2)?);
        (start, first_line) = (at, index + 3);
    }
    blocks.push(Block { head, text: &text[start..], first_line });
    Ok(blocks)
}

fn parse_head(line: &str, origin: &str, number: usize) -> Result<(Keyword, TypeName), Error> {
    let fault = |message: String| Error::Syntax {
        place: Place { origin: origin.into(), line: number, column: 1 },
        message,
    };
    let expected = || {
        fault(format!(
            "expected a line such as `MSG: package/Type` after the line of `=`, found `{}`",
            line.trim_end()
        ))
    };
    let (keyword, name) = line.split_once(':').ok_or_else(expected)?;
    let keyword = match keyword.trim() {
        "MSG" => Keyword::Message,
        "SRV" => Keyword::Service,
        "ACTION" => Keyword::Action,
        "IDL" => Keyword::Idl,
        _ => return Err(expected()),
    };
    let name = name.trim();
    let full_name = match name.split_once('/') {
        // Messages are named without `msg`.
        Some((package, name)) if !name.contains('/') => match keyword {
            Keyword::Message | Keyword::Idl => TypeName::from_short(package, name),
            Keyword::Service => TypeName::checked(package, Kind::Service, name),
            Keyword::Action => TypeName::checked(package, Kind::Action, name),
        },
        _ => name.parse().ok(),
    };
    let full_name = full_name.ok_or_else(|| fault(Error::Name(name.into()).to_string()))?;
    Ok((keyword, full_name))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::DefinitionEncoding::{Ros2Idl, Ros2Msg};
    use crate::{Catalog, Error};

    fn read(name: &str, encoding: super::DefinitionEncoding, text: &str) -> Result<Catalog, Error> {
        let mut catalog = Catalog::new();
        catalog.add_definition_text(&name.parse().unwrap(), encoding, text, "bag")?;
        Ok(catalog)
    }

    #[test]
    fn a_written_text_reads_back_the_same() {
        let mut catalog = Catalog::new();
        for (name, text) in [
            ("builtin_interfaces/msg/Time", "int32 sec\nuint32 nanosec\n"),
            (
                "service_msgs/msg/ServiceEventInfo",
                "uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\nint64 sequence_number\n",
            ),
            ("unique_identifier_msgs/msg/UUID", "uint8[16] uuid"),
            ("a/msg/Empty", ""),
            ("a/msg/Root", "builtin_interfaces/Time t\n\n# c\nEmpty e\n"),
        ] {
            catalog.add_message(name.parse().unwrap(), text, name).unwrap();
        }
        catalog.add_service("a/srv/S".parse().unwrap(), "Empty e\n---\nRoot r\n", "S").unwrap();
        catalog.add_action("a/action/A".parse().unwrap(), "Empty e\n---\nint8 x\n---\nRoot r", "A").unwrap();
        for name in [
            "a/msg/Root",
            "a/msg/Empty",
            "a/srv/S",
            "a/srv/S_Response",
            "a/action/A",
            "a/action/A_FeedbackMessage",
            "a/action/A_SendGoal_Event",
        ] {
            let name = name.parse().unwrap();
            let text = catalog.definition_text(&name).unwrap();
            let mut again = Catalog::new();
            again.add_definition_text(&name, Ros2Msg, &text, "bag").unwrap();
            assert_eq!(again.definition_text(&name).unwrap(), text, "{name}");
            again.check_type(&name).unwrap();
            assert_eq!(again.type_hash(&name).unwrap(), catalog.type_hash(&name).unwrap());
        }
    }

    #[test]
    fn a_text_of_idl_is_read() {
        let rule = "=".repeat(80);
        let text = format!(
            "{rule}\nIDL: a/msg/A\n#include \"a/msg/B.idl\"\nmodule a {{ module msg {{ struct A {{ a::msg::B b; }}; }}; }};\n\
             \n{rule}\nIDL: a/msg/B\nmodule a {{ module msg {{ struct B {{ int32 x; }}; }}; }};\n"
        );
        let catalog = read("a/msg/A", Ros2Idl, &text).unwrap();
        catalog.check().unwrap();
        assert_eq!(
            catalog.definition_text(&"a/msg/A".parse().unwrap()).unwrap(),
            format!("a/B b\n\n{rule}\nMSG: a/B\nint32 x\n")
        );
    }

    #[test]
    fn names_that_files_cannot_have_are_read() {
        let catalog = read("a/msg/A", Ros2Msg, "float64[9] K\nint8 k\nint8 kLow=1\n").unwrap();
        let message = catalog.message(&"a/msg/A".parse().unwrap()).unwrap();
        assert_eq!((message.fields[0].name.as_str(), message.constants[0].name.as_str()), ("K", "kLow"));
        assert!(read("a/msg/A", Ros2Msg, "int8 1\n").is_err());
        assert!(Catalog::new().add_message("a/msg/A".parse().unwrap(), "float64[9] K\n", "A.msg").is_err());
    }

    #[test]
    fn places_count_from_the_top_of_the_text() {
        let rule = "=".repeat(80);
        for (text, fault) in [
            (format!("B b\n\n{rule}\nMSG: a/B\nint8 x\nint9 y\n"), "bag:6:1: `int9` is neither"),
            (format!("B b\n{rule}\nB\n"), "bag:3:1: expected a line such as `MSG: package/Type`"),
            (format!("B b\n{rule}"), "bag:3:1: expected a line such as"),
            (format!("{rule}\nMSG: b\n"), "bag:2:1: `b` is not an interface name"),
            (format!("{rule}\nSRV: a/msg/S\n---\n"), "bag: a/msg/S cannot be the name of this definition"),
            (format!("{rule}\nSRV: a/S\nint8 x\n"), "bag:3:1: a service is a request and a response"),
            (format!("{rule}\nSRV: a/srv/S\n---\nint8\n"), "bag:4:5: expected a name"),
            (format!("{rule}\nIDL: a/msg/S\n\n  struct\n"), "bag:5:1: expected the name of the struct"),
        ] {
            let error = read("a/msg/A", Ros2Msg, &text).unwrap_err().to_string();
            assert!(error.starts_with(fault), "{text:?} gave {error}");
        }
    }

    #[test]
    fn a_text_with_more_fields_than_any_interface_is_refused_early() {
        let fields: String = (0..(1 << 16) + 1).map(|n| format!("int8 f{n}\n")).collect();
        let error = read("a/msg/A", Ros2Msg, &fields).unwrap_err().to_string();
        assert!(error.starts_with("bag:65537:1: a message of more than 65536 fields"), "{error}");
        let half: String = (0..60_000).map(|n| format!("int8 f{n}\n")).collect();
        let many: String = (0..5).map(|n| format!("\n=====\nMSG: a/B{n}\n{half}")).collect();
        let error = read("a/msg/A", Ros2Msg, &many).unwrap_err().to_string();
        assert!(error.contains("a text of more than 131072 fields"), "{error}");
        let members: String = (0..(1 << 16) + 1).map(|n| format!("int8 f{n};\n")).collect();
        let idl = format!("module a {{ module msg {{ struct A {{ {members} }}; }}; }};");
        assert!(
            read("a/msg/A", Ros2Idl, &idl).unwrap_err().to_string().contains("more than 65536"),
            "{idl:.20}"
        );
    }

    #[test]
    fn no_text_makes_reading_panic() {
        let rich = "B b\n\n=====\nMSG: a/B\r\nint8 x\n\n====\nIDL: a/msg/C\nmodule a{module msg{struct C{};};};\n\n===\nSRV: a/srv/D\n---\n";
        assert!(read("a/msg/A", Ros2Msg, rich).is_ok());
        for (at, character) in rich.char_indices() {
            for encoding in [Ros2Msg, Ros2Idl] {
                let _ = read("a/msg/A", encoding, &rich[..at]);
                for other in ["", "=", "===", "\n", "\r", ":", "/", "é"] {
                    let text = [&rich[..at], other, &rich[at + character.len_utf8()..]].concat();
                    let _ = read("a/msg/A", encoding, &text);
                }
            }
        }
    }
}
