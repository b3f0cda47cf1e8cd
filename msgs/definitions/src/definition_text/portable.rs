//! Definition texts in the form that all readers of bags understand.
//!
//! The files of packages contain what some readers (`rosbags` of PyPI among them) misread: they compute
//! another hash than the one that ROS 2 publishes, and refuse the whole bag. Each rule here replaces the type
//! of a field by another name of the same type; comments, spaces and line numbers stay.

use std::borrow::Cow;

use super::is_rule;
use crate::{Kind, TypeName};

/// Returns the definition text `text` of the message `name`, with its dependencies, in the portable form:
/// - `char` is `uint8`, of which it is an alias;
/// - parts of services and actions are named in full, `package/action/Walk_Feedback`;
/// - types in the text of such a part, and types called `Header`, are named with their package;
/// - lines end with a line feed.
///
/// The text need not be valid. Texts with headers other than `MSG` are returned as they are.
#[must_use]
pub fn portable_definition_text<'a>(name: &TypeName, text: &'a str) -> Cow<'a, str> {
    let mut portable = String::new();
    // Up to here `portable` has the text.
    let mut copied = 0;
    let mut owner = Cow::Borrowed(name);
    let (mut at, mut follows_rule) = (0, false);
    for line in text.split_inclusive('\n') {
        let start = at;
        at += line.len();
        let content = line.trim_end_matches(['\r', '\n']);
        let replaced = if follows_rule {
            match content.split_once(':') {
                Some(("MSG", short)) => {
                    let short = short.trim();
                    let full = full_name(short);
                    let written = full.as_ref().map(|full| format!("MSG: {}", full.in_texts()));
                    owner = Cow::Owned(full.unwrap_or_else(|| TypeName::new("", Kind::Message, short)));
                    written.filter(|written| written != content)
                }
                _ => return Cow::Borrowed(text),
            }
        } else {
            portable_line(&owner, content)
        };
        follows_rule = is_rule(content);
        if replaced.is_some() || line.ends_with("\r\n") {
            portable.push_str(&text[copied..start]);
            portable.push_str(replaced.as_deref().unwrap_or(content));
            portable.push_str(if line.ends_with('\n') { "\n" } else { "" });
            copied = at;
        }
    }
    if copied == 0 {
        return Cow::Borrowed(text);
    }
    portable.push_str(&text[copied..]);
    Cow::Owned(portable)
}

/// The portable form of a line in the text of `owner`; `None` if it is the line itself.
fn portable_line(owner: &TypeName, line: &str) -> Option<String> {
    let start = line.len() - line.trim_start_matches([' ', '\t']).len();
    let length = line[start..].find([' ', '\t', '[', '<', '#', '=']).unwrap_or(line.len() - start);
    let (word, rest) = line[start..].split_at(length);
    let replaced = if word == "char" {
        "uint8".to_owned()
    } else if word.contains('/') {
        let full = full_name(word).filter(|full| full.kind != Kind::Message);
        full.map(|full| full.in_texts()).filter(|full| full != word)?
    } else {
        let is_misread = owner.kind != Kind::Message || word == "Header";
        let is_type = word.starts_with(|first: char| first.is_ascii_uppercase()) && !owner.package.is_empty();
        let full = Some(word).filter(|_| is_misread && is_type);
        full.and_then(|word| TypeName::from_short(&owner.package, word))?.in_texts()
    };
    Some(format!("{}{replaced}{rest}", &line[..start]))
}

/// The type that a definition text names with its package.
fn full_name(text: &str) -> Option<TypeName> {
    let (package, name) = text.split_once('/')?;
    if name.contains('/') { text.parse().ok() } else { TypeName::from_short(package, name) }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::super::RULE;
    use super::portable_definition_text;

    fn portable(name: &str, text: &str) -> String {
        portable_definition_text(&name.parse().unwrap(), text).into_owned()
    }

    #[test]
    fn a_portable_text_is_returned_as_it_is() {
        let text = format!("# char\nint8 CHAR=1\nLeg[] legs # char\n\n{RULE}\nMSG: a/Leg\nstring char\n");
        assert!(matches!(
            portable_definition_text(&"a/msg/A".parse().unwrap(), &text),
            std::borrow::Cow::Borrowed(same) if same == text
        ));
    }

    #[test]
    fn types_that_readers_misread_are_replaced_and_the_rest_stays() {
        assert_eq!(
            portable(
                "a/msg/A",
                "char c # char\r\n\tchar[4]  d\nchar X=97\nHeader h\nHeader[<=2] i\nB b\nstd_msgs/Header j"
            ),
            "uint8 c # char\n\tuint8[4]  d\nuint8 X=97\na/Header h\na/Header[<=2] i\nB b\nstd_msgs/Header j"
        );
    }

    #[test]
    fn parts_of_actions_are_named_in_full_and_so_are_the_types_in_them() {
        let old = format!(
            "b/UUID id\na/W_Feedback feedback\n\n{RULE}\nMSG: a/W_Feedback\nLeg[2] l\nbool b\n\n{RULE}\nMSG: a/Leg\nB b\n"
        );
        let new = format!(
            "b/UUID id\na/action/W_Feedback feedback\n\n{RULE}\nMSG: a/action/W_Feedback\na/Leg[2] l\nbool b\n\n{RULE}\nMSG: a/Leg\nB b\n"
        );
        assert_eq!(portable("a/action/W_FeedbackMessage", &old), new);
        assert_eq!(portable("a/action/W_FeedbackMessage", &new), new);
    }

    #[test]
    fn no_text_makes_it_panic() {
        for text in [
            "",
            "=",
            "===",
            "===\n",
            "===\nMSG:",
            "===\nMSG: /\nchar",
            "é char",
            "char",
            "\r\n",
            "char\r",
            "/",
        ] {
            portable("a/msg/A", text);
            portable("a/action/A_Goal", &format!("{text}\n{text}"));
        }
    }
}
