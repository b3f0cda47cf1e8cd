//! Types and the values of constants.

use super::lexer::TokenKind;
use super::literal::Literal;
use super::parser::Parser;
use crate::{Element, Error, FieldType, Kind, Primitive, Shape, TypeName};

/// The error for nested arrays.
const NESTED: &str = "ROS 2 has no arrays of arrays: put the inner one into a struct";

impl<'a> Parser<'a> {
    /// The type of a member, a typedef or a constant.
    pub(super) fn type_spec(&mut self) -> Result<FieldType, Error> {
        let (word, line, column) = match self.token.kind {
            TokenKind::Word(word) => (word, self.token.line, self.token.column),
            TokenKind::Symbol("::") => return self.named_type(),
            _ => return Err(self.unexpected("a type")),
        };
        let primitive = match word {
            "boolean" => Primitive::Bool,
            "octet" => Primitive::Byte,
            "int8" => Primitive::Int8,
            "uint8" => Primitive::UInt8,
            "short" | "int16" => Primitive::Int16,
            "uint16" => Primitive::UInt16,
            "int32" => Primitive::Int32,
            "uint32" => Primitive::UInt32,
            "int64" => Primitive::Int64,
            "uint64" => Primitive::UInt64,
            "float" => Primitive::Float32,
            "double" => Primitive::Float64,
            "unsigned" => {
                self.advance()?;
                match self.token.kind {
                    TokenKind::Word("short") => Primitive::UInt16,
                    TokenKind::Word("long") => return self.long(Primitive::UInt32, Primitive::UInt64),
                    _ => return Err(self.unexpected("`short` or `long` behind `unsigned`")),
                }
            }
            "long" => return self.long(Primitive::Int32, Primitive::Int64),
            "string" => {
                self.advance()?;
                let element = Element::String { bound: self.string_bound()? };
                return Ok(FieldType { element, shape: Shape::Single });
            }
            "wstring" => {
                self.advance()?;
                let element = Element::WString { bound: self.string_bound()? };
                return Ok(FieldType { element, shape: Shape::Single });
            }
            "sequence" => return self.sequence(),
            "char" | "wchar" | "any" | "fixed" | "map" | "struct" | "union" | "enum" | "bitset"
            | "bitmask" => {
                let fault = format!("ROS 2 has no type for `{word}`");
                return Err(self.fault(line, column, fault));
            }
            _ => return self.named_type(),
        };
        self.advance()?;
        Ok(single(Element::Primitive(primitive)))
    }

    /// `long`, `long long`; the first word is the next token.
    fn long(&mut self, one: Primitive, two: Primitive) -> Result<FieldType, Error> {
        self.advance()?;
        let primitive = match self.token.kind {
            TokenKind::Word("long") => {
                self.advance()?;
                two
            }
            TokenKind::Word("double") => {
                let fault = "ROS 2 has no type for `long double`".into();
                return Err(self.fault(self.token.line, self.token.column, fault));
            }
            _ => one,
        };
        Ok(single(Element::Primitive(primitive)))
    }

    fn string_bound(&mut self) -> Result<Option<u64>, Error> {
        if !self.accept("<")? {
            return Ok(None);
        }
        let bound = self.size()?;
        self.expect(">")?;
        Ok(Some(bound))
    }

    fn sequence(&mut self) -> Result<FieldType, Error> {
        self.advance()?;
        self.expect("<")?;
        let (line, column) = (self.token.line, self.token.column);
        // Rejected before it is read, so that no text can nest without bound.
        if self.token.kind == TokenKind::Word("sequence") {
            return Err(self.fault(line, column, NESTED.into()));
        }
        let FieldType { element, shape } = self.type_spec()?;
        if shape != Shape::Single {
            return Err(self.fault(line, column, NESTED.into()));
        }
        let shape = if self.accept(",")? { Shape::Bounded(self.size()?) } else { Shape::Sequence };
        self.expect(">")?;
        Ok(FieldType { element, shape })
    }

    /// A name, followed by the size of an array if there is one.
    pub(super) fn declarator(&mut self, base: &FieldType) -> Result<(&'a str, FieldType), Error> {
        let name = self.identifier("a name")?;
        if self.token.kind != TokenKind::Symbol("[") {
            return Ok((name, base.clone()));
        }
        let (line, column) = (self.token.line, self.token.column);
        self.advance()?;
        let count = self.size()?;
        self.expect("]")?;
        if base.shape != Shape::Single || self.token.kind == TokenKind::Symbol("[") {
            return Err(self.fault(line, column, NESTED.into()));
        }
        Ok((name, FieldType { element: base.element.clone(), shape: Shape::Array(count) }))
    }

    /// The name of a typedef or a struct.
    fn named_type(&mut self) -> Result<FieldType, Error> {
        let (line, column) = (self.token.line, self.token.column);
        let path = self.scoped_name()?;
        if let Some(known) = self.lookup(&self.typedefs, &path) {
            return Ok(known.clone());
        }
        let parts: Vec<&str> = path.trim_start_matches("::").split("::").collect();
        let (package, kind, name) = match (parts.as_slice(), self.scope.as_slice()) {
            ([package, kind, name], _) => (*package, *kind, *name),
            ([kind, name], [package, ..]) => (*package, *kind, *name),
            ([name], [package, kind, ..]) => (*package, *kind, *name),
            _ => ("", "", ""),
        };
        let kind = Kind::ALL.into_iter().find(|of| of.as_str() == kind);
        match kind.and_then(|kind| TypeName::checked(package, kind, name)) {
            Some(name) => Ok(single(Element::Message(name))),
            None => {
                let fault = format!(
                    "`{path}` is neither a type of IDL, nor a typedef above, nor a name such as `std_msgs::msg::Header`"
                );
                Err(self.fault(line, column, fault))
            }
        }
    }

    /// `a::b::c`, with a leading `::` if it starts at the outermost module.
    fn scoped_name(&mut self) -> Result<String, Error> {
        let mut path = String::new();
        if self.accept("::")? {
            path.push_str("::");
        }
        path.push_str(self.identifier("a name")?);
        while self.accept("::")? {
            path.push_str("::");
            path.push_str(self.identifier("a name after `::`")?);
        }
        Ok(path)
    }

    /// The number of elements or characters: a constant of at least 1.
    fn size(&mut self) -> Result<u64, Error> {
        let (line, column) = (self.token.line, self.token.column);
        match self.constant_value()? {
            Literal::Integer(value) if (1..=i128::from(u32::MAX)).contains(&value) => Ok(value as u64),
            other => {
                let found = match other {
                    Literal::Integer(value) => value.to_string(),
                    Literal::Float(value) => format!("{value:?}"),
                    Literal::Bool(value) => value.to_string(),
                    Literal::Text(text) => format!("{text:?}"),
                };
                let fault = format!("the size must be a number from 1 to {}, found {found}", u32::MAX);
                Err(self.fault(line, column, fault))
            }
        }
    }

    /// A literal with signs before it, or the name of a constant above.
    pub(super) fn constant_value(&mut self) -> Result<Literal, Error> {
        let (line, column) = (self.token.line, self.token.column);
        let mut is_negative = false;
        while let TokenKind::Symbol(sign @ ("-" | "+")) = self.token.kind {
            is_negative ^= sign == "-";
            self.advance()?;
        }
        let value = self.literal()?;
        if let TokenKind::Symbol(operator @ ("+" | "-" | "*" | "/" | "%" | "&" | "|" | "^")) = self.token.kind
        {
            let fault = format!(
                "expressions are not supported: replace the operands of `{operator}` with their value"
            );
            return Err(self.fault(self.token.line, self.token.column, fault));
        }
        if !is_negative {
            return Ok(value);
        }
        let fault = || self.fault(line, column, "only a number can have a sign".into());
        value.negated().ok_or_else(fault)
    }

    fn literal(&mut self) -> Result<Literal, Error> {
        let (line, column) = (self.token.line, self.token.column);
        match self.token.kind.clone() {
            TokenKind::Number(text) => {
                self.advance()?;
                let fault = || self.fault(line, column, format!("`{text}` is not a number"));
                Literal::number(text).ok_or_else(fault)
            }
            TokenKind::Text(mut text) => {
                self.advance()?;
                // Adjacent strings are concatenated.
                while let TokenKind::Text(more) = &self.token.kind {
                    text.push_str(more);
                    self.advance()?;
                }
                Ok(Literal::Text(text))
            }
            TokenKind::Word("TRUE") => self.advance().map(|()| Literal::Bool(true)),
            TokenKind::Word("FALSE") => self.advance().map(|()| Literal::Bool(false)),
            TokenKind::Word(_) | TokenKind::Symbol("::") => {
                let path = self.scoped_name()?;
                if let Some(value) = self.lookup(&self.values, &path) {
                    return Ok(value.clone());
                }
                match path.as_str() {
                    // rosidl_adapter writes them as Python does.
                    "inf" => Ok(Literal::Float(f64::INFINITY)),
                    "nan" => Ok(Literal::Float(f64::NAN)),
                    _ => Err(self.fault(
                        line,
                        column,
                        format!("`{path}` is neither a value nor a constant above"),
                    )),
                }
            }
            _ => Err(self.unexpected("a value")),
        }
    }
}

fn single(element: Element) -> FieldType {
    FieldType { element, shape: Shape::Single }
}
