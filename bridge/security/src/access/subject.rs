//! Names of subjects as text, as certificates and permissions write them (RFC 2253).

/// The attributes of a name. Names are equal whatever the case of the types and the spaces around the parts.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Subject(Vec<(String, String)>);

impl Subject {
    /// Reads `CN=/talker, O=robots`; `None` if a part has no type or no value.
    pub fn parse(text: &str) -> Option<Self> {
        parts(text).map(attribute).collect::<Option<_>>().map(Self)
    }
}

/// The parts between commas that no backslash precedes.
fn parts(text: &str) -> impl Iterator<Item = &str> {
    let mut is_escaped = false;
    text.split(move |character| {
        let is_separator = character == ',' && !is_escaped;
        is_escaped = character == '\\' && !is_escaped;
        is_separator
    })
}

fn attribute(part: &str) -> Option<(String, String)> {
    let (kind, value) = part.split_once('=')?;
    let (kind, value) = (kind.trim(), value.trim());
    let is_whole = !kind.is_empty() && !value.is_empty();
    is_whole.then(|| (kind.to_ascii_lowercase(), value.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_equal_whatever_the_spaces_between_their_parts() {
        let name = Subject::parse("emailAddress=a@b.c,CN=Main Publisher,O=eProsima").unwrap();
        assert_eq!(
            Subject::parse(" emailaddress=a@b.c, CN=Main Publisher , O = eProsima "),
            Some(name.clone())
        );
        for other in ["CN=Main Publisher", "emailAddress=a@b.c,CN=main publisher,O=eProsima"] {
            assert_ne!(Subject::parse(other), Some(name.clone()), "{other}");
        }
        assert_ne!(Subject::parse("O=eProsima,CN=Main Publisher,emailAddress=a@b.c"), Some(name));
    }

    #[test]
    fn a_comma_after_a_backslash_belongs_to_the_value() {
        assert_ne!(Subject::parse("O=a\\,CN=b"), Subject::parse("O=a\\,,CN=b"));
        assert_eq!(Subject::parse("O=a\\,CN=b").unwrap().0.len(), 1);
        assert_eq!(Subject::parse("O=a\\\\,CN=b").unwrap().0.len(), 2);
        for text in ["", "CN", "CN=", "=a", "CN=a,,O=b"] {
            assert_eq!(Subject::parse(text), None, "{text}");
        }
    }
}
