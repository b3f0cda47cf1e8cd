//! Splits an IDL text into tokens.
//!
//! # References
//! OMG IDL 4.2, clause 7.2 (lexical conventions) and 7.3 (preprocessing).

use std::str::Chars;

use crate::{Error, Place};

/// A token with its position.
#[derive(Clone, Debug)]
pub(super) struct Token<'a> {
    pub(super) kind: TokenKind<'a>,
    pub(super) line: usize,
    pub(super) column: usize,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum TokenKind<'a> {
    /// An identifier or keyword.
    Word(&'a str),
    /// Begins with a digit or with a `.` before one.
    Number(&'a str),
    /// A string literal, its escapes resolved.
    Text(String),
    /// `::` or a single character.
    Symbol(&'a str),
    /// The end of the text.
    End,
}

impl TokenKind<'_> {
    /// The token as quoted in error messages.
    pub(super) fn quoted(&self) -> String {
        match self {
            Self::Word(text) | Self::Number(text) | Self::Symbol(text) => format!("`{text}`"),
            Self::Text(text) => format!("the string {text:?}"),
            Self::End => "the end of the text".into(),
        }
    }
}

/// Reads one token after the other.
pub(super) struct Lexer<'a> {
    rest: Chars<'a>,
    origin: &'a str,
    line: usize,
    column: usize,
}

impl<'a> Lexer<'a> {
    /// Creates a lexer for a text that starts at line `first_line` of `origin`.
    pub(super) fn new(text: &'a str, origin: &'a str, first_line: usize) -> Self {
        Self { rest: text.chars(), origin, line: first_line, column: 1 }
    }

    pub(super) fn place(&self, line: usize, column: usize) -> Place {
        Place { origin: self.origin.into(), line, column }
    }

    /// Returns the next token; at the end, always [`TokenKind::End`].
    pub(super) fn next(&mut self) -> Result<Token<'a>, Error> {
        self.skip_space()?;
        let (line, column) = (self.line, self.column);
        let text = self.rest.as_str();
        let kind = match self.peek() {
            None => TokenKind::End,
            Some('"') => TokenKind::Text(self.text(line, column)?),
            Some('L') if text.starts_with("L\"") => {
                self.advance();
                TokenKind::Text(self.text(line, column)?)
            }
            Some(first) if first.is_ascii_alphabetic() => {
                TokenKind::Word(self.take_while(|c| c.is_ascii_alphanumeric() || c == '_'))
            }
            Some(first) if first.is_ascii_digit() || (first == '.' && is_digit_at(text, 1)) => {
                TokenKind::Number(self.number())
            }
            Some(':') if text.starts_with("::") => TokenKind::Symbol(self.take(2)),
            Some(_) => TokenKind::Symbol(self.take(1)),
        };
        Ok(Token { kind, line, column })
    }

    fn peek(&self) -> Option<char> {
        self.rest.clone().next()
    }

    fn advance(&mut self) -> Option<char> {
        let character = self.rest.next()?;
        if character == '\n' {
            self.line += 1;
            self.column = 1;
        } else {
            self.column += 1;
        }
        Some(character)
    }

    fn take(&mut self, count: usize) -> &'a str {
        let text = self.rest.as_str();
        for _ in 0..count {
            self.advance();
        }
        &text[..text.len() - self.rest.as_str().len()]
    }

    fn take_while(&mut self, holds: impl Fn(char) -> bool) -> &'a str {
        let text = self.rest.as_str();
        while self.peek().is_some_and(&holds) {
            self.advance();
        }
        &text[..text.len() - self.rest.as_str().len()]
    }

    /// Skips spaces, comments and preprocessor lines. `#include` and `#pragma` are ignored: references are
    /// looked up by name.
    fn skip_space(&mut self) -> Result<(), Error> {
        loop {
            self.take_while(char::is_whitespace);
            let text = self.rest.as_str();
            let (line, column) = (self.line, self.column);
            if text.starts_with("//") {
                self.take_while(|c| c != '\n');
            } else if let Some(comment) = text.strip_prefix("/*") {
                let Some(end) = comment.find("*/") else {
                    return Err(self.fault(line, column, "the comment `/*` is not closed by `*/`".into()));
                };
                self.take(text[..end + 4].chars().count());
            } else if text.starts_with('#') {
                let directive = self.take_while(|c| c != '\n').trim_end();
                let word = directive[1..].trim_start();
                if !word.starts_with("include") && !word.starts_with("pragma") {
                    return Err(self.fault(
                        line,
                        column,
                        format!("`{directive}`: only the preprocessor lines `#include` and `#pragma` are supported"),
                    ));
                }
            } else {
                return Ok(());
            }
        }
    }

    fn number(&mut self) -> &'a str {
        let text = self.rest.as_str();
        let is_hexadecimal = text.starts_with("0x") || text.starts_with("0X");
        let mut before = ' ';
        while let Some(character) = self.peek() {
            let is_sign_of_exponent =
                matches!(character, '+' | '-') && matches!(before, 'e' | 'E') && !is_hexadecimal;
            if !character.is_ascii_alphanumeric() && character != '.' && !is_sign_of_exponent {
                break;
            }
            before = character;
            self.advance();
        }
        &text[..text.len() - self.rest.as_str().len()]
    }

    fn text(&mut self, line: usize, column: usize) -> Result<String, Error> {
        let open = "the string is not closed by `\"` on its line";
        self.advance();
        let mut value = String::new();
        loop {
            match self.advance() {
                None | Some('\n') => return Err(self.fault(line, column, open.into())),
                Some('"') => return Ok(value),
                Some('\\') => self.escape(&mut value, line, column)?,
                Some(character) => value.push(character),
            }
        }
    }

    /// Reads the character after a backslash (table 7-9).
    fn escape(&mut self, value: &mut String, line: usize, column: usize) -> Result<(), Error> {
        let (at_line, at_column) = (self.line, self.column);
        let numeric = |text: &str, radix| u32::from_str_radix(text, radix).ok().and_then(char::from_u32);
        let character = match self.advance() {
            None | Some('\n') => {
                return Err(self.fault(line, column, "the string ends with a backslash".into()));
            }
            Some('n') => Some('\n'),
            Some('t') => Some('\t'),
            Some('v') => Some('\u{b}'),
            Some('b') => Some('\u{8}'),
            Some('r') => Some('\r'),
            Some('f') => Some('\u{c}'),
            Some('a') => Some('\u{7}'),
            Some(same @ ('\\' | '?' | '\'' | '"')) => Some(same),
            Some('x') => numeric(self.digits(2, 16), 16),
            Some('u') => numeric(self.digits(4, 16), 16),
            Some(first @ '0'..='7') => {
                let more = self.digits(2, 8);
                numeric(&format!("{first}{more}"), 8)
            }
            // rosidl keeps unknown escapes as well.
            Some(other) => {
                value.push('\\');
                Some(other)
            }
        };
        let fault =
            || self.fault(at_line, at_column, "the escape after this backslash is not a character".into());
        value.push(character.ok_or_else(fault)?);
        Ok(())
    }

    fn digits(&mut self, most: usize, radix: u32) -> &'a str {
        let count = self.rest.clone().take(most).take_while(|c| c.is_digit(radix)).count();
        self.take(count)
    }

    fn fault(&self, line: usize, column: usize, message: String) -> Error {
        Error::Syntax { place: self.place(line, column), message }
    }
}

fn is_digit_at(text: &str, index: usize) -> bool {
    text.as_bytes().get(index).is_some_and(u8::is_ascii_digit)
}
