//! Rules as they are written: `from:=to`, `node:from:=to`, `__node:=name`, and `name:=value` for parameters.
//!
//! # References
//! `_rcl_parse_remap_rule` and `_rcl_parse_param_rule` in `rcl/src/rcl/arguments.c` (branch jazzy).

use super::lexer::{Lexeme, Lexer};
use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// One remapping rule, as `ros2 run` takes it after `-r`.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct RemapRule {
    /// The name, without namespace, of the only node to which it applies.
    pub node: Option<String>,
    /// What it says.
    pub remap: Remap,
}

/// What a remapping rule says.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Remap {
    /// `__node:=name`: the node has this name.
    Node(String),
    /// `__ns:=/namespace`: the node is in this namespace.
    Namespace(String),
    /// `from:=to`: where one name is meant, another is used.
    Name {
        /// Whether topics, services or both are meant.
        of: Named,
        /// The name that a program uses: absolute, relative or private.
        from: String,
        /// The new name.
        to: String,
    },
}

/// What a remapped name is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Named {
    /// A topic: `rostopic://from:=to`.
    Topic,
    /// A service: `rosservice://from:=to`.
    Service,
    /// Either: `from:=to`.
    Either,
}

/// A value of a parameter, as `ros2 run` takes it after `-p`.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct ParameterRule {
    /// The only node to which it applies; as in rclcpp it is in the namespace `/`.
    pub node: Option<String>,
    /// The parameter.
    pub name: String,
    /// Its value in YAML.
    pub value: String,
}

/// A text that is no rule.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("\"{rule}\" is no {kind}: {reason}")]
pub struct RuleError {
    kind: &'static str,
    rule: String,
    reason: String,
}

impl FromStr for RemapRule {
    type Err = RuleError;

    fn from_str(text: &str) -> Result<Self, RuleError> {
        let mut parser = Parser { kind: "remapping rule", text, lexer: Lexer::new(text) };
        let node = parser.node_prefix();
        let remap = match parser.lexer.peek() {
            Lexeme::Node => parser.node()?,
            Lexeme::Namespace => parser.namespace()?,
            _ => parser.name()?,
        };
        parser.expect(Lexeme::End, "the end")?;
        Ok(Self { node, remap })
    }
}

impl FromStr for ParameterRule {
    type Err = RuleError;

    fn from_str(text: &str) -> Result<Self, RuleError> {
        let mut parser = Parser { kind: "value of a parameter", text, lexer: Lexer::new(text) };
        let node = parser.node_prefix();
        let start = parser.lexer.at();
        loop {
            parser.parameter_part()?;
            if parser.lexer.take_if(Lexeme::Dot).is_none() {
                break;
            }
        }
        let name = text[start..parser.lexer.at()].to_owned();
        parser.expect(Lexeme::Separator, "\":=\"")?;
        Ok(Self { node, name, value: parser.lexer.rest().to_owned() })
    }
}

impl fmt::Display for RemapRule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(node) = &self.node {
            write!(f, "{node}:")?;
        }
        match &self.remap {
            Remap::Node(name) => write!(f, "__node:={name}"),
            Remap::Namespace(namespace) => write!(f, "__ns:={namespace}"),
            Remap::Name { of, from, to } => {
                let url = match of {
                    Named::Topic => "rostopic://",
                    Named::Service => "rosservice://",
                    Named::Either => "",
                };
                write!(f, "{url}{from}:={to}")
            }
        }
    }
}

/// Descends through the words of a rule, one function for each of rcl's.
struct Parser<'a> {
    kind: &'static str,
    text: &'a str,
    lexer: Lexer<'a>,
}

impl Parser<'_> {
    /// `node:`
    fn node_prefix(&mut self) -> Option<String> {
        if self.lexer.peek() != Lexeme::Token || self.lexer.peek_second() != Lexeme::Colon {
            return None;
        }
        let node = self.lexer.take().to_owned();
        self.lexer.take();
        Some(node)
    }

    /// `__node:=name`
    fn node(&mut self) -> Result<Remap, RuleError> {
        self.lexer.take();
        self.expect(Lexeme::Separator, "\":=\"")?;
        let what = "the name of a node, of letters, digits and single underscores";
        Ok(Remap::Node(self.expect(Lexeme::Token, what)?))
    }

    /// `__ns:=/a/b`; a slash at the end is for who makes the node to refuse.
    fn namespace(&mut self) -> Result<Remap, RuleError> {
        self.lexer.take();
        self.expect(Lexeme::Separator, "\":=\"")?;
        let start = self.lexer.at();
        self.expect(Lexeme::Slash, "a namespace that begins with \"/\"")?;
        while self.lexer.take_if(Lexeme::Token).is_some() && self.lexer.take_if(Lexeme::Slash).is_some() {}
        Ok(Remap::Namespace(self.text[start..self.lexer.at()].to_owned()))
    }

    /// `from:=to`
    fn name(&mut self) -> Result<Remap, RuleError> {
        let of = match self.lexer.peek() {
            Lexeme::TopicUrl => Named::Topic,
            Lexeme::ServiceUrl => Named::Service,
            _ => Named::Either,
        };
        if of != Named::Either {
            self.lexer.take();
        }
        let from = self.path(Lexeme::Separator)?;
        self.expect(Lexeme::Separator, "\":=\"")?;
        let to = self.path(Lexeme::End)?;
        Ok(Remap::Name { of, from, to })
    }

    /// `a/b`, `/a/b` or `~/a/b`, up to but without `end`.
    fn path(&mut self, end: Lexeme) -> Result<String, RuleError> {
        let start = self.lexer.at();
        if matches!(self.lexer.peek(), Lexeme::TildeSlash | Lexeme::Slash) {
            self.lexer.take();
        }
        self.expect(Lexeme::Token, "a name, of letters, digits and single underscores")?;
        while self.lexer.peek() != end {
            let what = if end == Lexeme::End { "\"/\" or the end" } else { "\"/\" or \":=\"" };
            self.expect(Lexeme::Slash, what)?;
            self.expect(Lexeme::Token, "a name, of letters, digits and single underscores")?;
        }
        Ok(self.text[start..self.lexer.at()].to_owned())
    }

    /// Tokens and slashes: a parameter of QoS has the name of a topic within its own.
    fn parameter_part(&mut self) -> Result<(), RuleError> {
        let is_part = |lexeme| matches!(lexeme, Lexeme::Token | Lexeme::Slash);
        if !is_part(self.lexer.peek()) {
            return Err(self.unexpected("the name of a parameter"));
        }
        while is_part(self.lexer.peek()) {
            self.lexer.take();
        }
        Ok(())
    }

    fn expect(&mut self, wanted: Lexeme, what: &str) -> Result<String, RuleError> {
        let word = self.lexer.take_if(wanted).map(str::to_owned);
        word.ok_or_else(|| self.unexpected(what))
    }

    fn unexpected(&self, what: &str) -> RuleError {
        let found = match self.lexer.peek() {
            Lexeme::WildOne | Lexeme::WildMany => {
                "a wildcard, which ROS 2 has not implemented here".to_owned()
            }
            Lexeme::BackReference => "a back reference, which ROS 2 has not implemented".to_owned(),
            Lexeme::End => "the end".to_owned(),
            _ => format!("\"{}\"", self.lexer.rest()),
        };
        let reason = format!("expected {what}, found {found}");
        RuleError { kind: self.kind, rule: self.text.to_owned(), reason }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn rule(text: &str) -> RemapRule {
        text.parse().unwrap_or_else(|error| panic!("{error}"))
    }

    /// From `check_known_vs_unknown_args` and `check_valid_args` in `rcl/test/rcl/test_arguments.cpp`.
    #[test]
    fn the_rules_that_rcl_accepts_are_accepted_and_written_back() {
        for text in [
            "__node:=node_name",
            "old_name:__node:=nodename123",
            "__ns:=/foo/bar",
            "__ns:=/",
            "_:=kq",
            "nodename:__ns:=/foobar",
            "foo:=bar",
            "~/foo:=~/bar",
            "/foo/bar:=bar",
            "foo:=/bar",
            "/foo123:=/bar123",
            "node:/foo123:=/bar123",
            "rostopic:=/foo/bar",
            "rosservice:=baz",
            "rostopic://rostopic:=rosservice",
            "rostopic:///rosservice:=rostopic",
            "rostopic:///foo/bar:=baz",
            "rosservice://~/a:=b",
        ] {
            assert_eq!(rule(text).to_string(), text);
        }
        assert_eq!(rule("a:__name:=b"), rule("a:__node:=b"));
        assert_eq!(rule("n:rostopic:///a:=b").node.as_deref(), Some("n"));
    }

    /// From `test_bad_remap_args` there, and the lexer.
    #[test]
    fn the_rules_that_rcl_refuses_are_refused_with_the_word_that_is_wrong() {
        for (text, expected) in [
            ("", "found the end"),
            (":=", "found \":=\""),
            ("foo:=", "found the end"),
            (":=bar", "found \":=bar\""),
            ("foo", "found the end"),
            ("foo:bar", "found the end"),
            ("__ns:=", "begins with \"/\""),
            ("__ns:=foo", "begins with \"/\""),
            ("__ns:=/foo//bar", "expected the end"),
            ("__node:=", "found the end"),
            ("__node:=/foo/bar", "found \"/foo/bar\""),
            ("__node:=a/b", "found \"/b\""),
            ("__name:=b__c", "found \"_c\""),
            ("f/:=bar", "found \":=bar\""),
            ("foo:=bar/", "found the end"),
            ("foo:=/b}ar", "found \"}ar\""),
            ("foo b:=bar", "found \" b:=bar\""),
            ("foo:=b__r", "found \"_r\""),
            ("~foo:=bar", "found \"~foo:=bar\""),
            ("foo:=~", "found \"~\""),
            ("1foo:=bar", "found \"1foo:=bar\""),
            ("rostopic://:=bar", "found \":=bar\""),
            ("a:b:c:=d", "found \":c:=d\""),
            ("/ns/node:a:=b", "found \":a:=b\""),
            ("foo:=bar:=baz", "found \":=baz\""),
            ("*:=bar", "wildcard"),
            ("foo:=/a/\\1", "back reference"),
        ] {
            let error = text.parse::<RemapRule>().unwrap_err().to_string();
            assert!(error.contains(expected) && error.contains(&format!("\"{text}\"")), "{error}");
        }
    }

    #[test]
    fn a_parameter_may_be_of_one_node_and_its_value_is_anything() {
        let rule = |text: &str| text.parse::<ParameterRule>().map(|rule| (rule.node, rule.name, rule.value));
        let parts = |node: Option<&str>, name: &str, value: &str| {
            Ok((node.map(str::to_owned), name.to_owned(), value.to_owned()))
        };
        assert_eq!(rule("foo:=bar"), parts(None, "foo", "bar"));
        assert_eq!(rule("node:foo.bar:=[1, 2]"), parts(Some("node"), "foo.bar", "[1, 2]"));
        let qos = "qos_overrides./foo/bar.publisher.history";
        assert_eq!(rule(&format!("{qos}:=keep_last")), parts(None, qos, "keep_last"));
        assert_eq!(rule("a:="), parts(None, "a", ""));
        assert_eq!(rule("a:=b:=c"), parts(None, "a", "b:=c"));
        for wrong in ["", "foo", ":=1", "foo.:=1", "a.*:=1", "a b:=1", "a:b:c:=1"] {
            assert!(rule(wrong).is_err(), "{wrong}");
        }
    }
}
