//! The definition text of a message, assembled at compile time.

use super::const_text::{compare, digits, split_at_slash};
use super::{Description, Element, Field, FieldType, Shape};

/// The definition text of the message itself.
#[derive(Clone, Copy, Debug)]
pub enum OwnText {
    /// The text of its file.
    File(&'static str),
    /// Text derived from its fields, each after its comment; the comment of the message comes first. Comments
    /// are lines that start with `#` and end with a newline, or empty.
    Fields {
        /// The comment of the message.
        comment: &'static str,
        /// One comment for each field.
        comments: &'static [&'static str],
    },
}

/// Text of at most `N` bytes, and the length it would have without that limit.
pub struct Text<const N: usize> {
    bytes: [u8; N],
    length: usize,
}

/// The definition text of a message with these fields: its own text, then each message it depends on, once,
/// depth first and sorted by name. `N` is the length, which `definition::<0>` computes.
#[must_use]
pub const fn definition<const N: usize>(own: OwnText, fields: &'static [Field]) -> Text<N> {
    let mut text = Text { bytes: [0; N], length: 0 };
    match own {
        OwnText::File(own) => text.push(own),
        OwnText::Fields { comment, comments } => text.own(comment, comments, fields),
    }
    let mut seen = Seen { names: [""; MOST_DEPENDENCIES], count: 0 };
    text.dependencies(fields, &mut seen);
    text
}

impl<const N: usize> Text<N> {
    /// Its length, even if it exceeds `N`.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.length
    }

    /// Returns whether it is empty.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.length == 0
    }

    /// The text, which must fit into `N` bytes.
    #[must_use]
    pub const fn as_str(&self) -> &str {
        match std::str::from_utf8(&self.bytes) {
            Ok(text) if self.length == N => text,
            _ => panic!("the length of the buffer is not that of the text"),
        }
    }

    const fn push(&mut self, text: &str) {
        let mut index = 0;
        if N > 0 {
            while index < text.len() {
                self.bytes[self.length + index] = text.as_bytes()[index];
                index += 1;
            }
        }
        self.length += text.len();
    }

    const fn number(&mut self, number: u64) {
        let (digits, count) = digits(number);
        match std::str::from_utf8(digits.split_at(digits.len() - count).1) {
            Ok(text) => self.push(text),
            Err(_) => panic!("digits are ASCII"),
        }
    }

    const fn own(&mut self, comment: &str, comments: &[&str], fields: &[Field]) {
        self.push(comment);
        if !comment.is_empty() {
            self.push("\n"); // Separates it from the comment of the first field.
        }
        let mut index = 0;
        while index < fields.len() {
            self.push(comments[index]);
            self.field_type(&fields[index].field_type);
            self.push(" ");
            self.push(fields[index].name);
            self.push("\n");
            index += 1;
        }
    }

    /// Appends the type as in a definition.
    const fn field_type(&mut self, of: &FieldType) {
        match of.element {
            Element::Message(nested) => self.short_name(nested.type_name),
            Element::Primitive(primitive) => self.push(primitive.as_str()),
            Element::String { .. } => self.push("string"),
            Element::WString { .. } => self.push("wstring"),
        }
        if of.string_capacity() > 0 {
            self.push("<=");
            self.number(of.string_capacity());
        }
        match of.shape {
            Shape::Single => {}
            Shape::Array(count) => {
                self.push("[");
                self.number(count);
                self.push("]");
            }
            Shape::Bounded(count) => {
                self.push("[<=");
                self.number(count);
                self.push("]");
            }
            Shape::Sequence => self.push("[]"),
        }
    }

    /// `sensor_msgs/JointState` for `sensor_msgs/msg/JointState`; parts of services and actions are named in
    /// full.
    const fn short_name(&mut self, name: &str) {
        let (package, rest) = split_at_slash(name);
        let (kind, type_name) = split_at_slash(rest);
        if compare(kind, "msg") != 0 {
            return self.push(name);
        }
        self.push(package);
        self.push("/");
        self.push(type_name);
    }

    const fn dependencies(&mut self, fields: &'static [Field], seen: &mut Seen) {
        // Finds the next name each time: there are few, and sorting needs memory.
        let mut last = "";
        while let Some(nested) = next_nested(fields, last) {
            last = nested.type_name;
            if seen.insert(last) {
                self.push("\n");
                self.push(RULE);
                self.push("\nMSG: ");
                self.short_name(last);
                self.push("\n");
                self.push(own_text(nested.definition));
                self.dependencies(nested.fields, seen);
            }
        }
    }
}

/// The line before the name of each dependency.
const RULE: &str = "================================================================================";

const MOST_DEPENDENCIES: usize = 256;

/// Names of types that the text contains.
struct Seen {
    names: [&'static str; MOST_DEPENDENCIES],
    count: usize,
}

impl Seen {
    /// Returns whether it was new.
    const fn insert(&mut self, name: &'static str) -> bool {
        let mut index = 0;
        while index < self.count {
            if compare(self.names[index], name) == 0 {
                return false;
            }
            index += 1;
        }
        if self.count == MOST_DEPENDENCIES {
            panic!("the message refers to more than 256 other message types");
        }
        self.names[self.count] = name;
        self.count += 1;
        true
    }
}

/// The first message type of the fields whose name is greater than `last`.
const fn next_nested(fields: &'static [Field], last: &str) -> Option<&'static Description> {
    let mut best: Option<&'static Description> = None;
    let mut index = 0;
    while index < fields.len() {
        if let Some(nested) = fields[index].nested()
            && compare(nested.type_name, last) > 0
        {
            match best {
                Some(found) if compare(found.type_name, nested.type_name) <= 0 => {}
                _ => best = Some(nested),
            }
        }
        index += 1;
    }
    best
}

/// A definition text without its dependencies. The rule before them cannot be a line of a definition.
const fn own_text(definition: &'static str) -> &'static str {
    let bytes = definition.as_bytes();
    let mut start = 0;
    while start + RULE.len() < bytes.len() {
        if bytes[start] == b'\n' {
            let mut signs = 0;
            while signs < RULE.len() && bytes[start + 1 + signs] == b'=' {
                signs += 1;
            }
            if signs == RULE.len() {
                return definition.split_at(start).0;
            }
        }
        start += 1;
    }
    definition
}

#[cfg(test)]
mod tests {
    use super::{OwnText, definition, own_text};
    use crate::Message;

    #[test]
    fn the_text_of_every_message_is_the_one_it_was_generated_with() {
        let mut count = 0;
        macro_rules! check {
            ($($message:ty),* $(,)?) => {$(
                {
                    const LENGTH: usize = definition::<0>(OwnText::File(own_text(<$message>::DEFINITION)), <$message>::FIELDS).len();
                    let text = definition::<LENGTH>(OwnText::File(own_text(<$message>::DEFINITION)), <$message>::FIELDS);
                    assert_eq!(text.as_str(), <$message>::DEFINITION);
                    count += 1;
                }
            )*};
        }
        for_each_message!(check);
        assert!(count > 200, "only {count} were compared");
    }
}
