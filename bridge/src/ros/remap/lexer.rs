//! The words of remapping and parameter rules.
//!
//! # References
//! `rcl/src/rcl/lexer.c` (branch jazzy).

/// A word of a rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Lexeme {
    /// `~/`
    TildeSlash,
    /// `rosservice://`
    ServiceUrl,
    /// `rostopic://`
    TopicUrl,
    /// `:`
    Colon,
    /// `__node` or `__name`
    Node,
    /// `__ns`
    Namespace,
    /// `:=`
    Separator,
    /// `\1` to `\9`
    BackReference,
    /// Letters, digits and single underscores.
    Token,
    /// `/`
    Slash,
    /// `*`
    WildOne,
    /// `**`
    WildMany,
    /// `.`
    Dot,
    /// Nothing is left.
    End,
    /// Nothing of the above.
    Unknown,
}

/// Splits a text into words, one at a time: what stands behind the separator of a parameter rule is no word.
pub(super) struct Lexer<'a> {
    text: &'a str,
    at: usize,
}

impl<'a> Lexer<'a> {
    pub(super) fn new(text: &'a str) -> Self {
        Self { text, at: 0 }
    }

    /// What has not been taken yet.
    pub(super) fn rest(&self) -> &'a str {
        &self.text[self.at..]
    }

    /// How many bytes have been taken.
    pub(super) fn at(&self) -> usize {
        self.at
    }

    pub(super) fn peek(&self) -> Lexeme {
        lex(self.rest()).0
    }

    /// The word after the next.
    pub(super) fn peek_second(&self) -> Lexeme {
        let rest = self.rest();
        lex(&rest[lex(rest).1..]).0
    }

    /// Takes the next word.
    pub(super) fn take(&mut self) -> &'a str {
        let rest = self.rest();
        let (_, length) = lex(rest);
        self.at += length;
        &rest[..length]
    }

    /// Takes the next word if it is of that kind.
    pub(super) fn take_if(&mut self, wanted: Lexeme) -> Option<&'a str> {
        (self.peek() == wanted).then(|| self.take())
    }
}

/// The first word of a text and its length in bytes.
fn lex(text: &str) -> (Lexeme, usize) {
    const FIXED: [(&str, Lexeme); 13] = [
        ("rostopic://", Lexeme::TopicUrl),
        ("rosservice://", Lexeme::ServiceUrl),
        ("__node", Lexeme::Node),
        ("__name", Lexeme::Node),
        ("__ns", Lexeme::Namespace),
        ("__", Lexeme::Unknown),
        ("~/", Lexeme::TildeSlash),
        (":=", Lexeme::Separator),
        (":", Lexeme::Colon),
        ("/", Lexeme::Slash),
        ("**", Lexeme::WildMany),
        ("*", Lexeme::WildOne),
        (".", Lexeme::Dot),
    ];
    if let Some((fixed, lexeme)) = FIXED.iter().find(|(fixed, _)| text.starts_with(fixed)) {
        return (*lexeme, fixed.len());
    }
    match text.as_bytes() {
        [] => (Lexeme::End, 0),
        [b'\\', b'1'..=b'9', ..] => (Lexeme::BackReference, 2),
        [b'a'..=b'z' | b'A'..=b'Z' | b'_', ..] => (Lexeme::Token, token_length(text.as_bytes())),
        _ => (Lexeme::Unknown, text.chars().next().map_or(0, char::len_utf8)),
    }
}

/// A token ends before the second of two underscores.
fn token_length(text: &[u8]) -> usize {
    let is_in_token = |(position, byte): (usize, &u8)| match byte {
        b'_' => position == 0 || text[position - 1] != b'_',
        other => other.is_ascii_alphanumeric(),
    };
    text.iter().enumerate().position(|byte| !is_in_token(byte)).unwrap_or(text.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(text: &str) -> Vec<(Lexeme, &str)> {
        let mut lexer = Lexer::new(text);
        let mut words = Vec::new();
        while lexer.peek() != Lexeme::End {
            words.push((lexer.peek(), lexer.take()));
        }
        words
    }

    #[test]
    fn words_are_those_of_rcl() {
        use Lexeme::*;
        for (text, expected) in [
            ("foo:=bar", vec![(Token, "foo"), (Separator, ":="), (Token, "bar")]),
            (
                "n:__ns:=/a",
                vec![
                    (Token, "n"),
                    (Colon, ":"),
                    (Namespace, "__ns"),
                    (Separator, ":="),
                    (Slash, "/"),
                    (Token, "a"),
                ],
            ),
            ("__name", vec![(Node, "__name")]),
            ("__nod", vec![(Unknown, "__"), (Token, "nod")]),
            ("rostopic", vec![(Token, "rostopic")]),
            ("rostopic:/x", vec![(Token, "rostopic"), (Colon, ":"), (Slash, "/"), (Token, "x")]),
            ("rostopic:///x", vec![(TopicUrl, "rostopic://"), (Slash, "/"), (Token, "x")]),
            ("rosservice://r", vec![(ServiceUrl, "rosservice://"), (Token, "r")]),
            ("~/a", vec![(TildeSlash, "~/"), (Token, "a")]),
            ("~a", vec![(Unknown, "~"), (Token, "a")]),
            ("a_b_1", vec![(Token, "a_b_1")]),
            ("a__b", vec![(Token, "a_"), (Token, "_b")]),
            ("_", vec![(Token, "_")]),
            ("***", vec![(WildMany, "**"), (WildOne, "*")]),
            ("a.b\\7", vec![(Token, "a"), (Dot, "."), (Token, "b"), (BackReference, "\\7")]),
            ("1a", vec![(Unknown, "1"), (Token, "a")]),
            ("ä", vec![(Unknown, "ä")]),
        ] {
            assert_eq!(words(text), expected, "{text}");
        }
    }
}
